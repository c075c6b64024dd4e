#include "export/cloud_fusion.h"

#include <gtest/gtest.h>

#include <atomic>
#include <cmath>

#include "export/cloud_filter.h"
#include "iris/core/error.h"
#include "iris/core/options.h"
#include "iris/core/parallel.h"
#include "support/box_room.h"

namespace iris::exporters {
namespace {

const RectifiedCamera kCamera{.f = 200, .cx = 119.5, .cy = 79.5, .baseline = 0.11, .width = 240, .height = 160};
const testing::BoxRoom kRoom;

// A camera that turns once round in the middle of the room.
std::vector<StereoView> round_views(int count, double noise) {
  std::vector<StereoView> views;
  for (int i = 0; i < count; ++i) {
    const double angle = 2 * M_PI * i / count;
    const Pose pose = testing::level_camera({0.3 * std::cos(angle), 0.3 * std::sin(angle), 0}, angle);
    views.push_back(testing::view_of(kRoom, kCamera, pose, noise, 100 + static_cast<uint32_t>(i)));
    views.back().frame_idx = i;
  }
  return views;
}

// Distance from the nearest wall, and the axis that it is across.
std::pair<double, int> wall_distance(const Eigen::Vector3f& point) {
  std::pair<double, int> best{1e9, 0};
  for (int a = 0; a < 3; ++a) {
    for (const double wall : {kRoom.low[a], kRoom.high[a]}) {
      if (std::abs(point[a] - wall) < best.first) best = {std::abs(point[a] - wall), a};
    }
  }
  return best;
}

TEST(CloudFusion, PointsLieOnTheWallsWithinSigma) {
  const CloudOptions options{.fusion = {.pixel_error = 0.1, .neighbours = 8}, .voxel = 0.03};
  const PointCloud cloud = fuse_cloud(views::MemoryViewStore(round_views(24, std::sqrt(2.0) * 0.1)), options);
  ASSERT_GT(cloud.points.size(), 10000u);
  EXPECT_EQ(cloud.edge, 0.03);
  int within = 0, within_two = 0, upright = 0;
  for (const CloudPoint& p : cloud.points) {
    const auto [distance, axis] = wall_distance(p.position);
    within += distance <= p.sigma;
    within_two += distance <= 2 * p.sigma;
    upright += std::abs(p.normal[axis]) > 0.9;
    EXPECT_NEAR(p.normal.norm(), 1, 1e-5);
    EXPECT_GE(p.views, 2);
    // Walls have blue 40 * wall, green 250 - 40 * wall, red 100.
    EXPECT_NEAR(p.rgb[0], 100, 2);
    // Normals point into the room.
    EXPECT_LT(p.normal.dot(p.position - Eigen::Vector3f(0.1f, 0, 0.1f)), 0.2);
  }
  const double count = static_cast<double>(cloud.points.size());
  // The errors are independent here, which sigma does not count on: more than 68 and 95 %.
  EXPECT_GT(within / count, 0.68);
  EXPECT_GT(within_two / count, 0.95);
  EXPECT_GT(upright / count, 0.9);
}

TEST(CloudFusion, WhatOthersSeeThroughIsDropped) {
  std::vector<StereoView> views = round_views(24, 0);
  // One view sees a box in the room that is not there.
  views[5].disparity.disparity(cv::Rect(100, 60, 40, 40)) += 8;
  const auto inside = [](const PointCloud& cloud) {
    int count = 0;
    for (const CloudPoint& p : cloud.points) count += wall_distance(p.position).first > 0.2;
    return count;
  };
  CloudOptions options{.fusion = {.neighbours = 8}, .voxel = 0.03, .outlier_points = 0};
  EXPECT_EQ(inside(fuse_cloud(views::MemoryViewStore(views), options)), 0);
  options.fusion.neighbours = 0;
  EXPECT_GT(inside(fuse_cloud(views::MemoryViewStore(views), options)), 30);
}

TEST(CloudFusion, BudgetDoublesTheCubes) {
  const views::MemoryViewStore views(round_views(12, 0));
  const size_t all = fuse_cloud(views, {.voxel = 0.03}).points.size();
  ASSERT_GT(all, 4000u);
  const PointCloud few = fuse_cloud(views, {.voxel = 0.03, .max_points = 3000});
  EXPECT_LE(few.points.size(), 3000u);
  EXPECT_GT(few.points.size(), 500u);
  EXPECT_GT(few.edge, 0.03);
  // Cubes that were merged hold what cubes of that size from the start do.
  const PointCloud direct = fuse_cloud(views, {.voxel = few.edge, .outlier_points = 0});
  const PointCloud merged = fuse_cloud(views, {.voxel = 0.03, .max_points = 3000, .outlier_points = 0});
  ASSERT_EQ(direct.points.size(), merged.points.size());
  for (size_t i = 0; i < direct.points.size(); ++i) {
    // Their own size counts in the weights of their points: the means differ by a small part of it.
    EXPECT_LT((direct.points[i].position - merged.points[i].position).norm(), few.edge / 10);
  }
}

TEST(CloudFusion, SameForAnyNumberOfThreadsAndStopsWhenAsked) {
  const views::MemoryViewStore views(round_views(12, 0.1));
  const CloudOptions options{.voxel = 0.05};
  PointCloud one, three;
  with_threads(1, [&] { one = fuse_cloud(views, options); });
  with_threads(3, [&] { three = fuse_cloud(views, options); });
  ASSERT_EQ(one.points.size(), three.points.size());
  for (size_t i = 0; i < one.points.size(); ++i) {
    EXPECT_EQ(one.points[i].position, three.points[i].position);
    EXPECT_EQ(one.points[i].normal, three.points[i].normal);
    EXPECT_EQ(one.points[i].sigma, three.points[i].sigma);
  }
  std::atomic<bool> stop = true;
  EXPECT_THROW(fuse_cloud(views, options, {.progress = ProgressStyle::quiet, .stop = &stop}), Interrupted);
}

TEST(CloudFusion, NothingGivesNothingAndOptionsAreDeclared) {
  EXPECT_TRUE(fuse_cloud(views::MemoryViewStore({}), {}).points.empty());
  CloudOptions options;
  OptionSet set;
  options.declare(set);
  set.validate();
  set.set("cloud.voxel", "0");
  EXPECT_THROW(set.validate(), UsageError);
}

TEST(CloudFilter, DropsWhatStandsAloneAndFitsNormals) {
  PointCloud cloud{.edge = 0.05, .points = {}};
  for (int y = 0; y < 60; ++y) {
    for (int x = 0; x < 60; ++x) {
      CloudPoint p;
      p.position = {0.05f * static_cast<float>(x), 0.05f * static_cast<float>(y), 0.025f * static_cast<float>(x)};
      p.normal = {0, 0, 1};
      cloud.points.push_back(p);
    }
  }
  const Eigen::Vector3f slanted = Eigen::Vector3f(-0.5f, 0, 1).normalized();
  CloudPoint alone;
  alone.position = {1, 1, 3};
  cloud.points.insert(cloud.points.begin() + 1000, alone);
  filter_cloud(cloud, 12, 3, 16);
  EXPECT_EQ(cloud.points.size(), 3600u);
  for (const CloudPoint& p : cloud.points) EXPECT_LT((p.normal - slanted).norm(), 1e-3);
}

}  // namespace
}  // namespace iris::exporters
