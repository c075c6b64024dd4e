#include "iris/core/error.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace iris {
namespace {

TEST(InputError, NamesPathProblemAndRemedy) {
  const InputError error("a/calib.txt", "line 3 has 11 numbers", "write 12");
  EXPECT_STREQ(error.what(), "a/calib.txt: line 3 has 11 numbers; write 12");
  EXPECT_EQ(error.path(), "a/calib.txt");
  EXPECT_STREQ(InputError("x", "is empty", "").what(), "x: is empty");
}

TEST(Check, ThrowsABugThatNamesConditionAndPlace) {
  IRIS_CHECK(1 + 1 == 2);
  try {
    IRIS_CHECK(1 + 1 == 3);
    FAIL() << "no exception";
  } catch (const Bug& bug) {
    EXPECT_THAT(bug.what(), ::testing::HasSubstr("1 + 1 == 3"));
    EXPECT_THAT(bug.what(), ::testing::HasSubstr("error_test.cpp:"));
  }
}

}  // namespace
}  // namespace iris
