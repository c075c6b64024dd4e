#include "iris/reconstruct/fusion.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "support/box_room.h"

namespace iris::reconstruct {
namespace {

const RectifiedCamera kCamera{
    .f = 200, .cx = 119.5, .cy = 79.5, .baseline = 0.11, .disparity_offset = 0.25, .width = 240, .height = 160};

using Views = std::vector<std::shared_ptr<const StereoView>>;

// Views along a line that look at the same corner of the room, with independent noise of the disparity.
Views room_views(int count, double noise, double pitch = 0) {
  Views views;
  for (int i = 0; i < count; ++i) {
    const Pose pose = testing::level_camera({-0.8 + 0.15 * i, -0.3 + 0.07 * i, 0.1 * (i % 3)}, 0.3 - 0.03 * i, pitch);
    views.push_back(std::make_shared<StereoView>(testing::view_of({}, kCamera, pose, noise, 10 + i)));
  }
  return views;
}

FusedView fuse_first(const Views& views, const FusionOptions& options, double scale = 1) {
  return fuse_view(*views[0], Views(views.begin() + 1, views.end()), options, scale);
}

// Away from the room's edges, where disparities bend.
bool is_flat(const cv::Mat1f& d, int x, int y) {
  for (const auto& [dx, dy] : {std::pair(8, 0), std::pair(0, 8)}) {
    if (x < 8 || y < 8 || x >= d.cols - 8 || y >= d.rows - 8) return false;
    if (std::abs(d(y + dy, x + dx) + d(y - dy, x - dx) - 2 * d(y, x)) > 1e-3) return false;
  }
  return true;
}

TEST(Fusion, ExactViewsStayAsTheyAre) {
  const Views views = room_views(6, 0);
  const FusedView fused = fuse_first(views, {.step = 3});
  int agreeing = 0, flat = 0;
  for (const FusedPixel& pixel : fused.pixels) {
    if (!is_flat(views[0]->disparity.disparity, pixel.x, pixel.y)) continue;
    ++flat;
    // What interpolation between pixels of a plane in perspective leaves: nothing, disparity is linear; floats remain.
    EXPECT_NEAR(pixel.disparity, views[0]->disparity.disparity(pixel.y, pixel.x), 2e-3);
    EXPECT_EQ(pixel.through, 0);
    agreeing += pixel.agree >= 3;
  }
  EXPECT_GT(flat, 2000);
  EXPECT_GT(agreeing, flat * 7 / 10);  // the others look past its left and right
}

TEST(Fusion, SlopeIsThatOfThePlane) {
  const Views views = room_views(1, 0);
  const cv::Mat1f& d = views[0]->disparity.disparity;
  for (const FusedPixel& pixel : fuse_first(views, {.step = 2}).pixels) {
    if (!is_flat(d, pixel.x, pixel.y)) continue;
    // A weak pull to 0 shortens it by less than one percent.
    EXPECT_NEAR(pixel.slope_x, (d(pixel.y, pixel.x + 8) - d(pixel.y, pixel.x - 8)) / 16, 2e-3);
    EXPECT_NEAR(pixel.slope_y, (d(pixel.y + 8, pixel.x) - d(pixel.y - 8, pixel.x)) / 16, 2e-3);
  }
}

// Independent errors average out; sigma, which does not count on that, is the mean of the views'.
TEST(Fusion, ErrorsAverageOutAndSigmaDoesNotCountOnIt) {
  FusionOptions options{.pixel_error = 0.1, .step = 4};
  const Views views = room_views(8, std::sqrt(2.0) * 0.1);
  double before = 0, after = 0, sigma = 0;
  int count = 0;
  const StereoView exact = testing::view_of({}, kCamera, views[0]->world_from_cam);
  for (const FusedPixel& pixel : fuse_first(views, options).pixels) {
    if (!is_flat(exact.disparity.disparity, pixel.x, pixel.y) || pixel.agree < 4) continue;
    const double truth = exact.disparity.disparity(pixel.y, pixel.x);
    before += std::pow(views[0]->disparity.disparity(pixel.y, pixel.x) - truth, 2);
    after += std::pow(pixel.disparity - truth, 2);
    sigma += pixel.sigma;
    ++count;
  }
  ASSERT_GT(count, 1000);
  EXPECT_NEAR(std::sqrt(before / count), std::sqrt(2.0) * 0.1, 0.01);
  EXPECT_LT(after, before / 4);  // five views and more
  // Views that are nearer or see more parallax are worth more than the first one, all of the same order.
  EXPECT_GT(sigma / count, 0.08);
  EXPECT_LT(sigma / count, 0.15);
}

// A single view: its own error, and the same for two equal ones.
TEST(Fusion, SigmaOfEqualViewsIsTheirs) {
  const Views views = room_views(1, 0);
  const FusionOptions options{.pixel_error = 0.2, .step = 5};
  for (const FusedPixel& pixel : fuse_view(*views[0], {}, options, 1.5).pixels) {
    EXPECT_NEAR(pixel.sigma, 0.3 * std::sqrt(2.0), 1e-6);
  }
  for (const FusedPixel& pixel : fuse_view(*views[0], {views[0]}, options, 1.5).pixels) {
    EXPECT_NEAR(pixel.sigma, 0.3 * std::sqrt(2.0), 1e-3);
  }
}

TEST(Fusion, WhatOthersSeeThroughIsCounted) {
  const Views exact = room_views(6, 0);
  auto wrong = std::make_shared<StereoView>(*exact[0]);
  wrong->disparity.disparity = exact[0]->disparity.disparity.clone();
  const cv::Rect patch(100, 60, 24, 24);
  wrong->disparity.disparity(patch) += 4;  // something before the wall that is not there
  Views views = exact;
  views[0] = wrong;
  int inside = 0;
  for (const FusedPixel& pixel : fuse_first(views, {.step = 2}).pixels) {
    if (!(cv::Rect(104, 64, 16, 16).contains({pixel.x, pixel.y}))) continue;
    ++inside;
    EXPECT_EQ(pixel.agree, 0);
    EXPECT_GE(pixel.through, 3);
  }
  EXPECT_EQ(inside, 64);
}

TEST(Fusion, WhatStandsBeforeItSaysNothing) {
  // The other views see a near patch in front of everything: the first view's points are hidden, not contradicted.
  Views views = room_views(3, 0);
  for (size_t i = 1; i < views.size(); ++i) {
    auto hidden = std::make_shared<StereoView>(*views[i]);
    hidden->disparity.disparity = views[i]->disparity.disparity + 20;
    views[i] = hidden;
  }
  for (const FusedPixel& pixel : fuse_first(views, {.step = 5}).pixels) {
    EXPECT_EQ(pixel.through, 0);
    EXPECT_EQ(pixel.agree, 0);
    EXPECT_EQ(pixel.disparity, views[0]->disparity.disparity(pixel.y, pixel.x));
  }
}

TEST(Fusion, ErrorScaleIsMeasured) {
  const FusionOptions options{.pixel_error = 0.05, .step = 2, .gate = 20};
  const FusedView fused = fuse_first(room_views(6, 3 * std::sqrt(2.0) * 0.05), options);
  // 3, less what interpolation between four pixels averages away.
  const double scale = error_scale_of(fused.differences);
  EXPECT_GT(scale, 2.2);
  EXPECT_LT(scale, 3.2);
  EXPECT_EQ(error_scale_of({}), 1);
  std::vector<float> normal(100001);
  std::mt19937 random(3);
  std::normal_distribution<float> distribution(0, 1.7f);
  for (float& value : normal) value = distribution(random);
  EXPECT_NEAR(error_scale_of(normal), 1.7, 0.02);
}

TEST(Fusion, OnlyValidPixelsWithinReach) {
  Views views = room_views(1, 0);
  auto view = std::make_shared<StereoView>(*views[0]);
  view->disparity.origin = views[0]->disparity.origin.clone();
  view->disparity.origin(cv::Rect(0, 0, 240, 80)) = static_cast<uint8_t>(DisparityOrigin::between_segments);
  views[0] = view;
  const FusionOptions options{.min_disparity = 6, .max_range = 3.3, .step = 2};
  const FusedView fused = fuse_first(views, options);
  size_t expected = 0;
  for (int y = 81; y < 160; y += 2) {
    for (int x = 1; x < 240; x += 2) {
      const float d = view->disparity.disparity(y, x);
      expected += d + 0.25 >= 6 && kCamera.point(x, y, d).norm() <= 3.3;
    }
  }
  EXPECT_EQ(fused.pixels.size(), expected);
  EXPECT_GT(expected, 100u);
}

TEST(Fusion, OverlappingViewsAreThoseThatSeeTheSame) {
  const Views views = room_views(1, 0);
  std::vector<PlacedCamera> cameras = {
      {kCamera, views[0]->world_from_cam},
      {kCamera, testing::level_camera({-0.8, -0.3, 0}, 0.3 + 3.1)},   // turned away
      {kCamera, testing::level_camera({-0.7, -0.25, 0}, 0.3)},        // beside it
      {kCamera, testing::level_camera({-0.7, -0.25, 0}, 0.3 + 0.5)},  // half of it
      {kCamera, testing::level_camera({-50, -0.25, 0}, 0.3)},         // far away
  };
  EXPECT_EQ(overlapping_views(*views[0], cameras, 0, {}), (std::vector<int>{2, 3}));
  EXPECT_EQ(overlapping_views(*views[0], cameras, 0, {.neighbours = 1}), (std::vector<int>{2}));
}

}  // namespace
}  // namespace iris::reconstruct
