// Where the recordings with ground truth lie, and how a test says that it needs one.
#pragma once

#include <gtest/gtest.h>

#include <filesystem>

namespace iris::testing {

inline std::filesystem::path test_data(const std::string& name) { return std::filesystem::path(IRIS_TEST_DATA) / name; }

}  // namespace iris::testing

// Ends the test with 'skipped: …' if the recording is not there.
#define IRIS_NEEDS_TEST_DATA(name)                                                                          \
  if (!std::filesystem::exists(::iris::testing::test_data(name))) {                                         \
    GTEST_SKIP() << "skipped: no " << ::iris::testing::test_data(name).string() << " (set IRIS_TEST_DATA)"; \
  }
