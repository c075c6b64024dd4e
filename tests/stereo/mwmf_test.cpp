#include "iris/stereo/mwmf.h"

#include <gmock/gmock.h>

#include <cmath>

#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "support/stereo_pairs.h"

namespace iris::stereo {
namespace {

MwmfOptions with_range(int disparities) {
  MwmfOptions options;
  options.disparities = disparities;
  return options;
}

struct Score {
  double density = 0;    // [%] measured pixels of those with truth
  double wrong = 0;      // [%] measured and off by more than 1 px
  double dense = 0;      // [%] of all pixels with truth that are wrong or missing after interpolation
  double sub_pixel = 0;  // [px] RMS of the measured ones that are right
};

Score score(const testing::TruthPair& pair, const DisparityImage& result, bool whole_pixels) {
  int known = 0, measured = 0, wrong = 0, dense = 0, right = 0;
  double squares = 0;
  for (int y = 0; y < pair.truth.rows; ++y) {
    for (int x = 0; x < pair.truth.cols; ++x) {
      const float truth = pair.truth(y, x);
      if (truth <= 0) continue;
      const float d = whole_pixels ? std::round(result.disparity(y, x)) : result.disparity(y, x);
      const bool bad = !(d > 0) || std::abs(d - truth) > 1;
      const bool is_measured = result.at(y, x, DisparityOrigin::measured) > 0;
      ++known;
      dense += bad;
      measured += is_measured;
      wrong += is_measured && bad;
      if (is_measured && !bad) {
        ++right;
        squares += (d - truth) * (d - truth);
      }
    }
  }
  return {100.0 * measured / known, 100.0 * wrong / known, 100.0 * dense / known, std::sqrt(squares / right)};
}

// The limits are the measured values, rounded up by a few tenths.
TEST(Mwmf, Tsukuba) {
  IRIS_NEEDS_TEST_DATA("middlebury");
  const testing::TruthPair pair = testing::middlebury_pair("tsukuba");
  const Score s = score(pair, mwmf(pair.left, pair.right, with_range(32)), true);
  EXPECT_GT(s.density, 88);
  EXPECT_LT(s.wrong, 4.3);
  EXPECT_LT(s.dense, 6.0);
}

TEST(Mwmf, Cones) {
  IRIS_NEEDS_TEST_DATA("middlebury");
  const testing::TruthPair pair = testing::middlebury_pair("cones");
  const Score s = score(pair, mwmf(pair.left, pair.right, with_range(64)), false);
  EXPECT_GT(s.density, 87.5);
  EXPECT_LT(s.wrong, 4.4);
  EXPECT_LT(s.dense, 10.9);
  EXPECT_LT(s.sub_pixel, 0.19);
}

TEST(Mwmf, Motorcycle) {
  IRIS_NEEDS_TEST_DATA("middlebury");
  const testing::TruthPair pair = testing::motorcycle_pair();
  const Score s = score(pair, mwmf(pair.left, pair.right, with_range(80)), false);
  EXPECT_GT(s.density, 89);
  EXPECT_LT(s.wrong, 5.4);
  EXPECT_LT(s.dense, 11.7);
  EXPECT_LT(s.sub_pixel, 0.245);
}

// The thesis's measure, grey values alone.
TEST(Mwmf, ConesByDifferences) {
  IRIS_NEEDS_TEST_DATA("middlebury");
  const testing::TruthPair pair = testing::middlebury_pair("cones");
  MwmfOptions options = with_range(64);
  options.measure = "difference";
  options.difference_cap = 3;
  options.window_width = 9;
  const Score s = score(pair, mwmf(pair.left, pair.right, options), false);
  EXPECT_GT(s.density, 86);
  EXPECT_LT(s.wrong, 4.8);
  EXPECT_LT(s.dense, 12.4);
}

TEST(Mwmf, LargestWindowsFitIntoTheArithmetic) {
  const auto [left, right] = testing::slanted_pair(cv::Size(80, 40), 8.0, 0.0);
  MwmfOptions options = with_range(16);
  options.window_width = options.window_height = 13;
  EXPECT_GT(cv::countNonZero(mwmf(left, right, options).origin == 1), 0.7 * left.total());
}

TEST(Mwmf, DoesNotDependOnThreads) {
  const auto [left, right] = testing::slanted_pair(cv::Size(200, 150), 8.0, 0.03);
  DisparityImage one, many;
  with_threads(1, [&] { one = mwmf(left, right, with_range(32)); });
  with_threads(4, [&] { many = mwmf(left, right, with_range(32)); });
  EXPECT_EQ(cv::countNonZero(one.disparity != many.disparity), 0);
  EXPECT_EQ(cv::countNonZero(one.origin != many.origin), 0);
}

// A slanted plane of known disparity everywhere. The V-shaped fit pulls a little towards whole pixels or away from
// them, depending on the texture; stated here by its RMS error and mean (the bias over all phases).
TEST(Mwmf, SubPixelAccuracyOnASlantedPlane) {
  const double d0 = 6.3, slope = 0.04;
  const auto [left, right] = testing::slanted_pair(cv::Size(320, 120), d0, slope);
  const DisparityImage result = mwmf(left, right, with_range(32));
  int measured = 0, wrong = 0, counted = 0;
  double sum = 0, squares = 0;
  for (int y = 8; y < 112; ++y) {
    for (int x = 40; x < 312; ++x) {
      const float d = result.at(y, x, DisparityOrigin::measured);
      ++counted;
      if (d <= 0) continue;
      const double error = d - (d0 + slope * x);
      ++measured;
      wrong += std::abs(error) > 1;
      sum += error;
      squares += error * error;
    }
  }
  RecordProperty("density", std::to_string(static_cast<double>(measured) / counted));
  RecordProperty("rms", std::to_string(std::sqrt(squares / measured)));
  RecordProperty("bias", std::to_string(sum / measured));
  EXPECT_GT(measured, 0.95 * counted);
  EXPECT_EQ(wrong, 0);
  EXPECT_LT(std::sqrt(squares / measured), 0.15);
  EXPECT_LT(std::abs(sum / measured), 0.03);
}

TEST(Mwmf, NegativeDisparitiesAndInfinityBecomeTheSmallestOne) {
  const auto [left, right] = testing::slanted_pair(cv::Size(160, 60), 0.0, 0.0);
  MwmfOptions options = with_range(16);
  options.min_disparity = -4;
  const DisparityImage result = mwmf(left, right, options);
  EXPECT_GT(cv::countNonZero(result.disparity == kSmallestDisparity), 0.9 * left.total());
}

TEST(Mwmf, SwitchedOffFiltersLeaveEveryPixelMeasured) {
  const auto [left, right] = testing::slanted_pair(cv::Size(100, 60), 8.0, 0.0);
  MwmfOptions options = with_range(16);
  options.min_margin = 0;
  options.left_right_tolerance = -1;
  options.min_segment = 0;
  const DisparityImage result = mwmf(left, right, options);
  EXPECT_EQ(cv::countNonZero(result.origin != static_cast<uchar>(DisparityOrigin::measured)), 0);
  options.log_sigma = 0;
  options.difference_cap = 0;
  options.window_width = 8;  // raised to 9
  EXPECT_EQ(cv::countNonZero(mwmf(left, right, options).disparity == 0), 0);
}

TEST(Mwmf, FlatImagesHaveNoDisparities) {
  const cv::Mat1b flat(60, 100, uchar{80});
  EXPECT_EQ(cv::countNonZero(mwmf(flat, flat, with_range(32)).disparity), 0);
}

TEST(Mwmf, SizesMustAgreeAndTheRangeMustBeKnown) {
  const cv::Mat1b a(10, 10, uchar{0}), b(10, 11, uchar{0});
  EXPECT_THROW(mwmf(a, b, with_range(8)), Bug);
  EXPECT_THROW(mwmf(a, a, with_range(0)), Bug);
}

TEST(Mwmf, DefaultsAreWithinTheirRanges) {
  MwmfOptions options;
  OptionSet set;
  options.declare(set);
  EXPECT_NO_THROW(set.validate());
  set.set("stereo.disparities", "64");
  EXPECT_EQ(options.disparities, 64);
}

}  // namespace
}  // namespace iris::stereo
