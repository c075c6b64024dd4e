#include "iris/stereo/search_range.h"

#include <gmock/gmock.h>

#include "iris/stereo/disparity_picture.h"
#include "support/stereo_pairs.h"

namespace iris::stereo {
namespace {

StereoPair make_pair_of(const std::pair<cv::Mat1b, cv::Mat1b>& images) {
  StereoPair pair;
  std::tie(pair.left, pair.right) = images;
  return pair;
}

// A small near object (0.4 % of the frame) before a far wall must be inside of the range.
TEST(SearchRange, SmallNearObjectIsInside) {
  auto [left, right] = testing::slanted_pair(cv::Size(640, 480), 12.0, 0.0, 1);
  const auto [near_left, near_right] = testing::slanted_pair(cv::Size(640, 480), 150.0, 0.0, 2);
  const cv::Rect object(400, 200, 36, 34);
  near_left(object).copyTo(left(object));
  near_right(object - cv::Point(150, 0)).copyTo(right(object - cv::Point(150, 0)));
  const SearchRange range = estimate_search_range({make_pair_of({left, right})}, MwmfOptions());
  EXPECT_GT(range.matches, 1000);
  EXPECT_NEAR(range.largest, 150, 3);
  EXPECT_GE(range.disparities, 160);
  EXPECT_LE(range.disparities, 192);
}

TEST(SearchRange, FarSceneNeedsLittle) {
  const SearchRange range =
      estimate_search_range({make_pair_of(testing::slanted_pair(cv::Size(640, 240), 10.0, 0.01, 3))}, MwmfOptions());
  EXPECT_NEAR(range.largest, 16.4, 2);
  EXPECT_EQ(range.disparities, 32);
}

TEST(SearchRange, NothingToMatchIsSaid) {
  const cv::Mat1b flat(240, 320, uchar{99});
  EXPECT_EQ(estimate_search_range({make_pair_of({flat, flat})}, MwmfOptions()).matches, 0);
  EXPECT_EQ(estimate_search_range({}, MwmfOptions()).matches, 0);
}

TEST(SearchRange, FractionAtLimitCountsMeasuredPixels) {
  MwmfOptions options;
  options.disparities = 64;
  DisparityImage image;
  image.disparity = (cv::Mat1f(1, 6) << 0, 10, 60.9f, 61, 63, 63);
  image.origin = (cv::Mat1b(1, 6) << 0, 1, 1, 1, 1, 4);
  EXPECT_DOUBLE_EQ(fraction_at_limit(image, options), 0.5);
  image.origin = 0;
  EXPECT_DOUBLE_EQ(fraction_at_limit(image, options), 0);
}

TEST(DisparityPicture, InvalidIsBlackAndBrightnessGrows) {
  cv::Mat1f d(1, 102);
  for (int i = 0; i < 102; ++i) d(0, i) = static_cast<float>(i);
  const cv::Mat3b picture = disparity_picture(d, 100);
  EXPECT_EQ(picture(0, 0), cv::Vec3b(0, 0, 0));
  const auto brightness = [&](int i) {
    const cv::Vec3b c = picture(0, i);
    return 0.114 * c[0] + 0.587 * c[1] + 0.299 * c[2];
  };
  for (int i = 2; i <= 100; ++i) EXPECT_GE(brightness(i), brightness(i - 1) - 0.6) << i;  // rounding of the channels
  EXPECT_GT(brightness(100), 4 * brightness(1));
  EXPECT_EQ(picture(0, 101), picture(0, 100));
}

}  // namespace
}  // namespace iris::stereo
