#include "iris/core/progress.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

namespace iris {
namespace {

using ::testing::EndsWith;
using ::testing::HasSubstr;
using ::testing::MatchesRegex;
using ::testing::StartsWith;

// What a task of `total` steps prints when it begins at `first`.
std::string output(ProgressStyle style, int first, int total) {
  ::testing::internal::CaptureStderr();
  {
    Progress progress(style, "stereo", total);
    for (int done = first; done <= total; ++done) progress.update(done);
  }
  return ::testing::internal::GetCapturedStderr();
}

TEST(Progress, QuietPrintsNothing) { EXPECT_EQ(output(ProgressStyle::quiet, 0, 5), ""); }

TEST(Progress, LinesEndWithTheWholeTask) {
  const std::string text = output(ProgressStyle::lines, 0, 5);
  EXPECT_THAT(text, StartsWith("stereo"));
  EXPECT_THAT(text, HasSubstr(" 5/5 "));
  EXPECT_THAT(text, EndsWith("\n"));
  EXPECT_THAT(text, ::testing::Not(HasSubstr("\r")));
}

TEST(Progress, TheBarStaysOnOneLineUntilTheEnd) {
  const std::string text = output(ProgressStyle::bar, 0, 5);
  EXPECT_THAT(text, StartsWith("\r["));
  EXPECT_THAT(text, HasSubstr("[==============================]"));
  EXPECT_EQ(text.find('\n'), text.size() - 1);
}

TEST(Progress, JsonIsOneObjectALine) {
  const std::string text = output(ProgressStyle::json, 2, 5);
  EXPECT_THAT(text, MatchesRegex("(\\{\"task\":\"stereo\",\"done\":[0-9]+,\"total\":5,\"rate\":[0-9.]+,"
                                 "\"seconds_left\":[0-9.]+\\}\n)+"));
  EXPECT_THAT(text, HasSubstr("\"done\":5,"));
}

TEST(Progress, ARateIsShownOnceThereIsOne) {
  EXPECT_THAT(output(ProgressStyle::lines, 0, 0), ::testing::Not(HasSubstr("/s")));
  EXPECT_THAT(output(ProgressStyle::lines, 0, 5), HasSubstr("/s"));
}

TEST(Progress, ATaskWithoutStepsIsDone) {
  EXPECT_THAT(output(ProgressStyle::bar, 0, 0), HasSubstr("[==============================]"));
}

}  // namespace
}  // namespace iris
