#include "iris/tour/camera_path.h"

#include <gtest/gtest.h>

#include <cmath>

namespace iris::tour {
namespace {

using Eigen::Vector3d;

constexpr double kDegrees = M_PI / 180;

// A straight flight along x at 2 m/s for `seconds`, 10 frames a second, looking along z.
std::vector<PoseNode> line(double seconds) {
  std::vector<PoseNode> nodes;
  for (int i = 0; i <= static_cast<int>(10 * seconds + 0.5); ++i) {
    PoseNode node{.frame_idx = i, .stamp_ns = 5'000'000'000 + i * 100'000'000LL};
    node.world_from_cam.translation() = Vector3d(0.2 * i, 0, 0);
    nodes.push_back(node);
  }
  return nodes;
}

// A circle of radius r, one turn in `seconds`, looking outwards; the camera's y axis is the circle's axis.
std::vector<PoseNode> circle(double r, double seconds, int count) {
  std::vector<PoseNode> nodes;
  for (int i = 0; i <= count; ++i) {
    const double angle = 2 * M_PI * i / count;
    PoseNode node{.frame_idx = i, .stamp_ns = std::llround(seconds * i / count * 1e9)};
    node.world_from_cam.linear() = Eigen::AngleAxisd(angle, Vector3d::UnitY()).matrix();
    node.world_from_cam.translation() = r * (node.world_from_cam.linear() * Vector3d::UnitZ());
    nodes.push_back(node);
  }
  return nodes;
}

TEST(Along, ConstantVelocityStaysConstantVelocity) {
  TourOptions options;
  options.back = 1.5;
  options.above = 0.5;
  const CameraPath path = along(line(10), options, 4);
  EXPECT_NEAR(duration(path), 10, 1e-9);
  for (double t = 0; t <= 10; t += 0.37) {
    const Vector3d position = sample(path, t).world_from_cam.translation();
    EXPECT_NEAR((position - Vector3d(2 * t, -0.5, -1.5)).norm(), 0, 1e-6) << t;
  }
}

TEST(Along, LooksAtTheRecordedPointOfSight) {
  TourOptions options;
  options.back = 1.5;
  options.above = 0.5;
  const CameraPath path = along(line(10), options, 4);
  for (const CameraKeyframe& key : path.keyframes) {
    const Vector3d seen = Vector3d(2 * key.t, 0, 4);  // 4 m in front of the recording camera
    const Vector3d in_cam = key.world_from_cam.inverse() * seen;
    EXPECT_NEAR(in_cam.x() / in_cam.z(), 0, 1e-6);
    EXPECT_NEAR(in_cam.y() / in_cam.z(), 0, 1e-6);
    EXPECT_GT(in_cam.z(), 0);
    EXPECT_NEAR(key.fov, options.fov * kDegrees, 1e-12);
  }
}

TEST(Along, GaussianShrinksACircleAsTheoryHasIt) {
  // The mean of r exp(i w t) under a Gaussian of width s is r exp(-(w s)^2 / 2) exp(i w t); the mean direction stays.
  TourOptions options;
  options.back = 0;
  options.above = 0;
  options.smoothing = 1.2;
  const double r = 3, seconds = 10, w = 2 * M_PI / seconds;
  const CameraPath path = along(circle(r, seconds, 2000), options, 4);
  // Cut at three standard deviations: the closed form with the same cut.
  double sum = 0, total = 0;
  for (int i = -12; i <= 12; ++i) {
    const double x = 0.25 * i, weight = std::exp(-0.5 * x * x);
    sum += weight * std::cos(w * options.smoothing * x);
    total += weight;
  }
  EXPECT_NEAR(sum / total, std::exp(-0.5 * w * w * 1.44), 0.02);
  for (const double t : {4.0, 5.0, 6.3}) {  // three standard deviations from both ends
    const Pose pose = sample(path, t).world_from_cam;
    const Vector3d outwards(std::sin(w * t), 0, std::cos(w * t));
    EXPECT_NEAR((pose.translation() - r * sum / total * outwards).norm(), 0, 2e-3);
    EXPECT_NEAR((pose.linear().col(2) - outwards).norm(), 0, 1e-3);
  }
}

TEST(Along, ShakingIsCalmed) {
  std::vector<PoseNode> nodes = line(10);
  for (size_t i = 0; i < nodes.size(); ++i) nodes[i].world_from_cam.translation().y() = i % 2 ? 0.05 : -0.05;
  TourOptions options;
  options.back = options.above = 0;
  for (const CameraKeyframe& key : along(nodes, options, 4).keyframes) {
    if (key.t < 1.5 || key.t > 8.5) continue;  // the path begins and ends where the recording does
    EXPECT_LT(std::abs(key.world_from_cam.translation().y()), 0.02);
  }
  options.smoothing = 0;
  double largest = 0;
  for (const CameraKeyframe& key : along(nodes, options, 4).keyframes) {
    largest = std::max(largest, std::abs(key.world_from_cam.translation().y()));
  }
  EXPECT_NEAR(largest, 0.05, 1e-9);
}

TEST(Along, LengthIsThatOfTheRecordingWithinLimits) {
  const TourOptions options;
  EXPECT_NEAR(duration(along(line(3), options, 4)), 8, 1e-9);
  EXPECT_NEAR(duration(along(line(9), options, 4)), 9, 1e-9);
  EXPECT_NEAR(duration(along(line(60), options, 4)), 10, 1e-9);
  EXPECT_NEAR(duration(along(line(240), options, 4)), 30, 1e-9);
  TourOptions fixed;
  fixed.seconds = 4.5;
  EXPECT_NEAR(duration(along(line(60), fixed, 4)), 4.5, 1e-9);
}

TEST(Along, DistancesFollowTheScene) {
  const CameraPath path = along(line(10), {}, 6);
  const Vector3d offset = path.keyframes.front().world_from_cam.translation();
  EXPECT_NEAR(offset.z(), -2, 1e-9);
  EXPECT_NEAR(offset.y(), -0.75, 1e-9);
}

TEST(Along, OneNodeStandsStill) {
  const CameraPath path = along({line(1).front()}, {}, 4);
  ASSERT_GE(path.keyframes.size(), 2u);
  EXPECT_TRUE(path.keyframes.front().world_from_cam.isApprox(path.keyframes.back().world_from_cam));
}

TEST(Sample, InterpolatesAndClamps) {
  CameraPath path;
  path.keyframes.push_back({.t = 1, .world_from_cam = Pose::Identity(), .fov = 0.8});
  Pose turned = Pose::Identity();
  turned.linear() = Eigen::AngleAxisd(1.2, Vector3d(1, 2, -1).normalized()).matrix();
  turned.translation() = Vector3d(1, 2, 3);
  path.keyframes.push_back({.t = 3, .world_from_cam = turned, .fov = 1.0});
  const CameraKeyframe middle = sample(path, 1.5);
  EXPECT_NEAR((middle.world_from_cam.translation() - Vector3d(0.25, 0.5, 0.75)).norm(), 0, 1e-12);
  const Eigen::AngleAxisd rotation(Eigen::Matrix3d(middle.world_from_cam.linear()));
  EXPECT_NEAR(rotation.angle(), 0.3, 1e-12);
  EXPECT_NEAR(rotation.axis().dot(Vector3d(1, 2, -1).normalized()), 1, 1e-12);
  EXPECT_NEAR(middle.fov, 0.85, 1e-12);
  EXPECT_TRUE(sample(path, -5).world_from_cam.isApprox(Pose::Identity()));
  EXPECT_TRUE(sample(path, 99).world_from_cam.isApprox(turned));
}

TEST(RecordedPose, InterpolatesBetweenFrames) {
  const std::vector<PoseNode> nodes = line(2);
  EXPECT_NEAR(recorded_pose(nodes, 5'550'000'000).translation().x(), 1.1, 1e-9);
  EXPECT_NEAR(recorded_pose(nodes, 0).translation().x(), 0, 1e-12);
  EXPECT_NEAR(recorded_pose(nodes, 99'000'000'000).translation().x(), 4, 1e-12);
}

TEST(NovelCameraOfKeyframe, FieldOfViewSpansThePicture) {
  const NovelCamera camera = novel_camera({.t = 0, .world_from_cam = Pose::Identity(), .fov = 60 * kDegrees}, {});
  EXPECT_EQ(camera.width, 640);
  EXPECT_EQ(camera.height, 480);
  // Upper edge of the first row and lower edge of the last row are 60 degrees apart.
  EXPECT_NEAR(std::atan((camera.cy + 0.5) / camera.f) + std::atan((479.5 - camera.cy) / camera.f), 60 * kDegrees,
              1e-12);
  EXPECT_DOUBLE_EQ(camera.cx, 319.5);
}

}  // namespace
}  // namespace iris::tour
