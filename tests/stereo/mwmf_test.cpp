#include "iris/stereo/mwmf.h"

#include <fmt/format.h>
#include <gmock/gmock.h>

#include <cmath>

#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/evaluate/disparities.h"
#include "support/stereo_pairs.h"

namespace iris::stereo {
namespace {

MwmfOptions with_range(int disparities) {
  MwmfOptions options;
  options.disparities = disparities;
  return options;
}

MwmfOptions with_preset(const std::string& name) {
  MwmfOptions options;
  options.preset = name;
  options.apply_preset();
  return options;
}

struct Score {
  evaluate::DisparityScore measured, dense;  // before and after interpolation
  double density() const { return measured.all.density(); }
  double wrong() const { return measured.all.wrong(1); }                // [%] off by more than 1 px
  double all() const { return dense.all.wrong_or_missing(1); }          // [%]
  double visible() const { return dense.visible.wrong_or_missing(1); }  // [%] of what both cameras see
};

Score score(const testing::TruthPair& pair, const DisparityImage& result, bool whole_pixels) {
  const cv::Mat1b hidden = testing::visible_in_both(pair.truth) == 0;
  const auto rate = [&](const DisparityImage& image) {
    return evaluate::score_disparities(image, pair.truth, hidden, {}, {.round = whole_pixels});
  };
  return {rate(testing::before_interpolation(result)), rate(result)};
}

enum class Pair { tsukuba, cones, motorcycle };

struct PresetCase {
  const char* preset;
  Pair pair;
  double dense, visible;  // [%] most that may be wrong
};

class Presets : public ::testing::TestWithParam<PresetCase> {};

// One setting for all pairs. The limits are the measured values, rounded up by one or two tenths.
TEST_P(Presets, AgainstPublicGroundTruth) {
  IRIS_NEEDS_TEST_DATA("middlebury");
  const PresetCase& c = GetParam();
  const bool tsukuba = c.pair == Pair::tsukuba;
  const testing::TruthPair pair =
      c.pair == Pair::motorcycle ? testing::motorcycle_pair() : testing::middlebury_pair(tsukuba ? "tsukuba" : "cones");
  MwmfOptions options = with_preset(c.preset);
  options.disparities = tsukuba ? 32 : 64;
  const Score s = score(pair, mwmf(pair.left, pair.right, options), tsukuba);
  RecordProperty("density", std::to_string(s.density()));
  RecordProperty("wrong", std::to_string(s.wrong()));
  RecordProperty("dense", std::to_string(s.all()));
  RecordProperty("visible", std::to_string(s.visible()));
  EXPECT_LE(s.all(), c.dense);
  EXPECT_LE(s.visible(), c.visible);
  if (c.pair != Pair::tsukuba) {
    EXPECT_LT(s.measured.subpixel.rms(), 0.26);
  } else if (options.preset != "thesis") {
    EXPECT_LE(s.wrong(), 2.5);
    EXPECT_GE(s.density(), options.preset == "default" ? 83 : 77);
  }
}

INSTANTIATE_TEST_SUITE_P(
    Middlebury, Presets,
    ::testing::Values(PresetCase{"thesis", Pair::tsukuba, 4.8, 3.6}, PresetCase{"default", Pair::tsukuba, 3.4, 2.5},
                      PresetCase{"default", Pair::cones, 10.1, 4.4}, PresetCase{"default", Pair::motorcycle, 9.9, 6.4},
                      PresetCase{"quality", Pair::tsukuba, 3.6, 2.8}, PresetCase{"quality", Pair::cones, 8.8, 3.4},
                      PresetCase{"quality", Pair::motorcycle, 7.7, 4.5}));

// The thesis reports 6.0 % wrong for plain correlation with the left/right check.
TEST(Mwmf, PlainCorrelationOfTheThesis) {
  IRIS_NEEDS_TEST_DATA("middlebury");
  const testing::TruthPair pair = testing::middlebury_pair("tsukuba");
  MwmfOptions options = with_preset("thesis");
  options.disparities = 32;
  options.windows = 1;
  options.window_width = options.window_height = 9;
  options.log_sigma = 1;
  options.min_margin = 0;
  options.borders = "off";
  options.min_segment = 0;
  options.interpolation = "off";
  EXPECT_NEAR(score(pair, mwmf(pair.left, pair.right, options), true).wrong(), 6.0, 0.2);
}

// OpenCV's matcher behind the same interface: labels, filters and interpolation are those of the other method.
TEST(Mwmf, SemiGlobalMatchingInPlaceOfCorrelation) {
  IRIS_NEEDS_TEST_DATA("middlebury");
  const testing::TruthPair pair = testing::middlebury_pair("cones");
  MwmfOptions options = with_range(64);
  options.method = "sgbm";
  const DisparityImage result = mwmf(pair.left, pair.right, options);
  EXPECT_EQ(cv::countNonZero(result.disparity == 0), 0);
  EXPECT_GT(cv::countNonZero(result.origin == static_cast<uchar>(DisparityOrigin::measured)), 0.7 * pair.left.total());
  const Score s = score(pair, result, false);
  RecordProperty("dense", std::to_string(s.all()));
  EXPECT_LT(s.all(), 14);
  EXPECT_LT(s.visible(), 8);
  options.min_disparity = 10;  // the nearest surfaces only
  options.interpolation = "off";
  const DisparityImage near = mwmf(pair.left, pair.right, options);
  for (const float d : near.disparity) ASSERT_TRUE(d == 0 || d >= 10);
}

TEST(Mwmf, EveryMeasureAndNumberOfWindowsFindsASlantedPlane) {
  const auto [left, right] = testing::slanted_pair(cv::Size(120, 60), 6.3, 0.03);
  for (const char* measure : {"sad", "census_sad", "census", "rank", "ssd", "ncc"}) {
    for (const int windows : {1, 5, 9, 25}) {
      for (const bool cut : {true, false}) {
        MwmfOptions options = with_range(16);
        options.measure = measure;
        options.windows = windows;
        options.window_width = options.window_height = windows == 25 ? 5 : 7;
        options.cut_windows = cut;
        options.min_margin = 0.01;
        const DisparityImage result = mwmf(left, right, options);
        int measured = 0;
        for (int y = 0; y < left.rows; ++y) {
          for (int x = 30; x < left.cols; ++x) {
            const float d = result.at(y, x, DisparityOrigin::measured);
            if (d <= 0) continue;
            ++measured;
            ASSERT_NEAR(d, 6.3 + 0.03 * x, 0.75) << measure << " " << windows << " " << x << " " << y;
          }
        }
        // Without cut windows a frame of up to 9 px stays empty.
        EXPECT_GT(measured, (cut ? 0.9 : 0.55) * 90 * 60) << measure << " " << windows << " " << cut;
      }
    }
  }
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

// Slanted planes of known disparity, with noise 45 dB below the contrast of the texture (40 grey levels RMS), and with
// the noise of a camera whose whole range of 255 grey levels is 45 dB above it.
TEST(Mwmf, SubPixelAccuracyOnSlantedPlanes) {
  for (const double signal : {40.0, 255.0}) {
    const std::vector<testing::TruthPair> planes = testing::slanted_planes(signal / std::pow(10, 45.0 / 20));
    for (const char* preset : {"default", "quality"}) {
      SCOPED_TRACE(fmt::format("{} {}", preset, signal));
      MwmfOptions options = with_preset(preset);
      options.disparities = 32;
      evaluate::DisparityScore score;
      for (const testing::TruthPair& plane : planes) {
        const DisparityImage result = testing::before_interpolation(mwmf(plane.left, plane.right, options));
        score.add(evaluate::score_disparities(result, plane.truth, {}, {}, {}));
      }
      RecordProperty(fmt::format("rms_{}_{}", preset, signal), std::to_string(score.subpixel.rms()));
      EXPECT_GT(score.all.density(), 95);
      EXPECT_EQ(score.all.bad[1], 0);
      EXPECT_LE(score.subpixel.rms(), 0.08);
      for (const evaluate::SubpixelScore& fraction : score.by_fraction) EXPECT_LE(std::abs(fraction.mean()), 0.02);
    }
  }
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
  options.reject_outermost = false;
  options.borders = "off";
  options.median = "off";
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

TEST(Mwmf, APresetIsWithinTheRangesAndLeavesTheSearchRangeAlone) {
  for (const char* name : {"thesis", "default", "quality"}) {
    MwmfOptions options;
    OptionSet set;
    options.declare(set);
    set.set_all({{"stereo.window_width", "11"}, {"stereo.disparities", "48"}, {"stereo.preset", name}});
    EXPECT_NO_THROW(set.validate());
    EXPECT_EQ(options.preset, name);
    EXPECT_EQ(options.disparities, 48);
    EXPECT_EQ(options.window_width, 11);
  }
  EXPECT_EQ(with_preset("thesis").borders, "halves");
  // The defaults are the preset of this name.
  MwmfOptions options, preset = with_preset("default");
  OptionSet a, b;
  options.declare(a);
  preset.declare(b);
  EXPECT_EQ(a.to_toml(), b.to_toml());
}

}  // namespace
}  // namespace iris::stereo
