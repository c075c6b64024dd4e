#include "iris/evaluate/disparities.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "iris/stereo/mwmf.h"
#include "support/stereo_pairs.h"

namespace iris::evaluate {
namespace {

TEST(Disparities, BadPixelsByHand) {
  const float inf = std::numeric_limits<float>::infinity();
  //                                 right 0.5   0.6  1.0  1.1  2.5  -4.1  none  unknown
  const cv::Mat1f truth = (cv::Mat1f(1, 10) << 10, 10, 10, 10, 10, 10, 10, 10, 0, inf);
  const cv::Mat1f disparity = (cv::Mat1f(1, 10) << 10, 10.5, 10.6, 11, 11.1, 12.5, 5.9, 0, 10, 10);
  const DisparityScore s = score_disparities({disparity, {}}, truth, {}, {}, {});
  EXPECT_EQ(s.all.known, 8);
  EXPECT_EQ(s.all.valid, 7);
  EXPECT_THAT(s.all.bad, ::testing::ElementsAre(5, 3, 2, 1));
  EXPECT_DOUBLE_EQ(s.all.density(), 87.5);
  EXPECT_DOUBLE_EQ(s.all.wrong(1), 37.5);
  EXPECT_DOUBLE_EQ(s.all.wrong_or_missing(1), 50);
  EXPECT_EQ(s.all.outliers_kitti, 1);
  EXPECT_EQ(s.subpixel.count, 4);
  EXPECT_NEAR(s.subpixel.mean(), 2.1 / 4, 1e-6);
  EXPECT_NEAR(s.subpixel.absolute(), 2.1 / 4, 1e-6);
  EXPECT_NEAR(s.subpixel.rms(), std::sqrt((0.25 + 0.36 + 1) / 4), 1e-6);
  EXPECT_EQ(s.at_borders.known, 0);
  EXPECT_EQ(s.elsewhere.known, 8);
  EXPECT_EQ(s.histogram[kHistogramBins / 2], 1);
  EXPECT_EQ(s.histogram[0], 1);  // -4.1

  const DisparityScore rounded = score_disparities({disparity, {}}, truth, {}, {}, {.round = true});
  // 10.6 and 11.1 become 11, 12.5 becomes 13, 5.9 becomes 6, 10.5 is rounded away from zero.
  EXPECT_THAT(rounded.all.bad, ::testing::ElementsAre(6, 2, 2, 0));
}

TEST(Disparities, MasksAndOriginsDivideThePixels) {
  const cv::Mat1f truth(1, 6, 20.0f);
  const cv::Mat1f disparity = (cv::Mat1f(1, 6) << 20, 22, 20.5, 20, 19, 23);
  const cv::Mat1b origin = (cv::Mat1b(1, 6) << 1, 1, 2, 3, 4, 4);
  const cv::Mat1b occluded = (cv::Mat1b(1, 6) << 0, 0, 0, 0, 255, 255);
  const cv::Mat1b border = (cv::Mat1b(1, 6) << 0, 255, 255, 0, 0, 0);
  DisparityScore s = score_disparities({disparity, origin}, truth, occluded, border, {});
  EXPECT_EQ(s.visible.known, 4);
  EXPECT_EQ(s.visible.bad[1], 1);
  EXPECT_EQ(s.occluded.known, 2);
  EXPECT_EQ(s.occluded.bad[1], 1);
  EXPECT_EQ(s.at_borders.known, 2);
  EXPECT_EQ(s.at_borders.bad[1], 1);
  EXPECT_EQ(s.elsewhere.bad[1], 1);
  EXPECT_EQ(s.by_origin[1].valid, 2);
  EXPECT_EQ(s.by_origin[1].count, 1);
  EXPECT_EQ(s.by_origin[2].rms(), 0.5);
  EXPECT_EQ(s.by_origin[4].mean(), -1);
  const DisparityScore once = s;
  s.add(once);
  EXPECT_EQ(s.images, 2);
  EXPECT_EQ(s.all.known, 12);
  EXPECT_EQ(s.by_origin[4].valid, 4);
  EXPECT_EQ(s.by_origin[4].mean(), -1);
  EXPECT_DOUBLE_EQ(s.all.wrong(1), once.all.wrong(1));
}

// An object of 10 x 10 px at (20, 20) in front of a background.
cv::Mat1f square() {
  cv::Mat1f truth(50, 50, 5.0f);
  truth(cv::Rect(20, 20, 10, 10)) = 15.0f;
  return truth;
}

TEST(Disparities, BordersOfASquare) {
  const DisparityOptions options{.border_distance = 3};
  const cv::Mat1b kinds = border_kinds(square(), options);
  // Three pixels on each side of each border.
  EXPECT_EQ(kinds(25, 16), 0);
  for (int x = 17; x <= 22; ++x) EXPECT_EQ(kinds(25, x), 1 + kBorderLeft) << x;
  EXPECT_EQ(kinds(25, 23), 0);
  EXPECT_EQ(kinds(25, 25), 0);
  for (int x = 27; x <= 32; ++x) EXPECT_EQ(kinds(25, x), 1 + kBorderRight) << x;
  EXPECT_EQ(kinds(25, 33), 0);
  for (int y = 17; y <= 22; ++y) EXPECT_EQ(kinds(y, 25), 1 + kBorderTop) << y;
  for (int y = 27; y <= 32; ++y) EXPECT_EQ(kinds(y, 25), 1 + kBorderBottom) << y;
  EXPECT_EQ(kinds(18, 18), 0);                // beside the corner: neither its row nor its column crosses the object
  EXPECT_EQ(kinds(20, 20), 1 + kBorderLeft);  // the corner touches both
  EXPECT_EQ(kinds(20, 21), 1 + kBorderTop);   // touches the top, one from the left
  // A gap of unknown pixels hides no jump, unless it is wide.
  cv::Mat1f gap = square();
  gap(cv::Rect(18, 0, 2, 50)) = 0.0f;
  EXPECT_EQ(border_kinds(gap, options)(25, 17), 1 + kBorderLeft);
  gap(cv::Rect(15, 0, 5, 50)) = 0.0f;
  EXPECT_EQ(border_kinds(gap, options)(25, 14), 0);
  // A slope is no jump.
  cv::Mat1f slope(5, 50);
  for (int x = 0; x < 50; ++x) slope.col(x) = 5.0f + 0.9f * static_cast<float>(x);
  EXPECT_EQ(cv::countNonZero(border_kinds(slope, options)), 0);
}

TEST(Disparities, ErrorsAtBordersByKind) {
  // The estimate shows the square 2 px too wide on its left and 1 px too short at its bottom.
  cv::Mat1f estimate(50, 50, 5.0f);
  estimate(cv::Rect(18, 20, 12, 9)) = 15.0f;
  const DisparityScore s = score_disparities({estimate, {}}, square(), {}, {}, {.border_distance = 3});
  // Row 20 to 28 left of the square: 2 x 9 px. Of the last row (29) 10 px are missing; its ends touch the left and
  // right border as well, and a tie goes to these.
  EXPECT_EQ(s.borders[kBorderLeft].wrong_object, 18);
  EXPECT_EQ(s.borders[kBorderLeft].wrong_background, 1);
  EXPECT_EQ(s.borders[kBorderRight].wrong_object, 0);
  EXPECT_EQ(s.borders[kBorderRight].wrong_background, 1);
  EXPECT_EQ(s.borders[kBorderBottom].wrong_background, 8);
  EXPECT_EQ(s.borders[kBorderTop].wrong_object + s.borders[kBorderTop].wrong_background, 0);
  EXPECT_EQ(s.at_borders.bad[1], 28);
  EXPECT_EQ(s.elsewhere.bad[1], 0);
  int64_t possible = 0;
  for (const BorderScore& border : s.borders) possible += border.possible;
  EXPECT_EQ(possible, s.at_borders.known);
  // 6 px across each of four sides of 10 px, the corners' inner 3 x 3 px counted once.
  EXPECT_EQ(possible, 4 * 6 * 10 - 4 * 9);
}

TEST(Disparities, PixelLockingIsSeenInTheFractions) {
  // An estimate that is drawn to whole pixels: d = t - 0.1 sin(2 pi t).
  cv::Mat1f truth(20, 1000), estimate(20, 1000);
  for (int y = 0; y < truth.rows; ++y) {
    for (int x = 0; x < truth.cols; ++x) {
      const double t = 10 + 0.01 * x + 0.0005 * y;
      truth(y, x) = static_cast<float>(t);
      estimate(y, x) = static_cast<float>(t - 0.1 * std::sin(2 * CV_PI * t));
    }
  }
  const DisparityScore s = score_disparities({estimate, {}}, truth, {}, {}, {});
  for (int i = 0; i < kFractionBins; ++i) {
    // Mean of the sine over a tenth of its period.
    const double a = 0.1 * i,
                 expected = -0.1 * (std::cos(2 * CV_PI * a) - std::cos(2 * CV_PI * (a + 0.1))) / (2 * CV_PI * 0.1);
    EXPECT_NEAR(s.by_fraction[static_cast<size_t>(i)].mean(), expected, 2e-3) << i;
  }
  EXPECT_NEAR(s.subpixel.rms(), 0.1 / std::sqrt(2.0), 1e-3);
}

TEST(Disparities, ColoursOfTheErrorPicture) {
  const cv::Mat1f truth = (cv::Mat1f(1, 5) << 10, 10, 10, 10, 0);
  const cv::Mat1f estimate = (cv::Mat1f(1, 5) << 10, 14, 2, 0, 3);
  const cv::Mat3b p = error_picture(estimate, truth, {});
  EXPECT_EQ(p(0, 0), cv::Vec3b(255, 255, 255));
  EXPECT_EQ(p(0, 1), cv::Vec3b(20, 20, 120));  // dark red
  EXPECT_EQ(p(0, 2), cv::Vec3b(120, 30, 20));  // dark blue
  EXPECT_EQ(p(0, 3), cv::Vec3b(0, 0, 0));
  EXPECT_EQ(p(0, 4), cv::Vec3b(150, 150, 150));
}

TEST(Disparities, TsukubaAsInTheThesis) {
  IRIS_NEEDS_TEST_DATA("middlebury");
  const auto pair = iris::testing::middlebury_pair("tsukuba");
  stereo::MwmfOptions mwmf;
  mwmf.disparities = 32;
  const DisparityScore s =
      score_disparities(stereo::mwmf(pair.left, pair.right, mwmf), pair.truth, {}, {}, {.round = true});
  EXPECT_EQ(s.all.known, 87696);  // without the frame of 18 px that has no truth
  EXPECT_LT(s.all.wrong_or_missing(1), 6);
  // Most errors are at borders, most of these make objects wider, and left and right borders have more than others
  // (thesis 3.1.4).
  EXPECT_GT(s.at_borders.bad[1], 2 * s.elsewhere.bad[1]);
  EXPECT_GT(s.borders[kBorderLeft].wrong_object, s.borders[kBorderLeft].wrong_background);
  EXPECT_GT(s.borders[kBorderLeft].wrong_object, s.borders[kBorderTop].wrong_object);
}

}  // namespace
}  // namespace iris::evaluate
