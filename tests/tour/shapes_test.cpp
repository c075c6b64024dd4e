// Orbits, turns, following, splines and eased speed.
#include <gtest/gtest.h>

#include <numbers>
#include <random>

#include "iris/tour/camera_path.h"
#include "iris/tour/frames.h"
#include "iris/tour/panorama.h"
#include "iris/tour/scene.h"
#include "support/ray_scene.h"

namespace iris::tour {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kDegrees = std::numbers::pi / 180;

TEST(Looking, IsLevelAndLooksThere) {
  std::mt19937 random(2);
  std::normal_distribution<double> normal;
  for (int i = 0; i < 100; ++i) {
    const Vector3d direction(normal(random), normal(random), normal(random));
    const Pose pose = looking({1, 2, 3}, direction);
    EXPECT_TRUE((pose.linear() * pose.linear().transpose()).isIdentity(1e-12));
    EXPECT_NEAR(pose.linear().determinant(), 1, 1e-12);
    EXPECT_LT((pose.linear().col(2) - direction.normalized()).norm(), 1e-12);
    EXPECT_NEAR(pose.linear()(2, 0), 0, 1e-12);  // rows are horizontal
    EXPECT_LE(pose.linear()(2, 1), 0);           // down is down
  }
  EXPECT_TRUE(looking({0, 0, 0}, {0, 0, 1}).linear().isUnitary(1e-12));
}

TEST(Orbit, GoesRoundOnceLookingAtTheCentre) {
  TourOptions options;
  options.turns = -1;
  const Vector3d centre(1, 2, 0.5);
  const CameraPath path = orbit(centre, 3, 1.5, {1, 10, 7}, options);
  EXPECT_DOUBLE_EQ(duration(path), 12);
  double turned = 0;
  for (size_t i = 0; i < path.keyframes.size(); ++i) {
    const Pose& pose = path.keyframes[i].world_from_cam;
    EXPECT_NEAR((pose.translation() - centre).head<2>().norm(), 3, 1e-12);
    EXPECT_NEAR(pose.translation().z(), 1.5, 1e-12);
    const Vector3d in_cam = pose.inverse() * centre;
    EXPECT_NEAR(in_cam.head<2>().norm(), 0, 1e-12);
    EXPECT_GT(in_cam.z(), 0);
    if (i == 0) continue;
    const Vector3d a = path.keyframes[i - 1].world_from_cam.translation() - centre, b = pose.translation() - centre;
    turned += std::atan2(a.x() * b.y() - a.y() * b.x(), a.head<2>().dot(b.head<2>()));
  }
  EXPECT_NEAR(turned, -2 * std::numbers::pi, 1e-9);
  EXPECT_NEAR((path.keyframes.front().world_from_cam.translation() - Vector3d(1, 5, 1.5)).norm(), 0, 1e-12);
}

TEST(TurnAround, SeesEveryDirection) {
  TourOptions options;
  options.seconds = 4;
  const CameraPath path = turn_around({1, 2, 1.5}, 0.3, options);
  const CameraKeyframe quarter = sample(path, 1);
  EXPECT_NEAR(std::atan2(quarter.world_from_cam.linear()(1, 2), quarter.world_from_cam.linear()(0, 2)),
              0.3 + std::numbers::pi / 2, 1e-3);
  EXPECT_EQ(quarter.world_from_cam.translation(), Vector3d(1, 2, 1.5));
}

TEST(Follow, StaysRoundWhatTheRecordingCameraLooksAt) {
  std::vector<PoseNode> nodes;
  for (int i = 0; i < 20; ++i) {
    nodes.push_back({.frame_idx = i,
                     .stamp_ns = i * 100'000'000LL,
                     .world_from_cam = looking({0.1 * i, 0, 1}, {std::cos(0.05 * i), std::sin(0.05 * i), 0})});
  }
  TourOptions options;
  options.swing = 60;
  options.rise = 20;
  const CameraPath path = follow(nodes, options, 2, false);
  EXPECT_NEAR(duration(path), 1.9, 1e-9);
  for (const CameraKeyframe& key : path.keyframes) {
    const Pose recording = recorded_pose(nodes, std::llround(key.t * 1e9));
    const Vector3d target = recording * Vector3d(0, 0, 2);
    EXPECT_LT((key.world_from_cam.inverse() * target - Vector3d(0, 0, 2)).norm(), 1e-9);
    const Vector3d place = recording.inverse() * key.world_from_cam.translation();
    EXPECT_GT(place.x(), 0);  // to the right of it
    EXPECT_LT(place.y(), 0);  // above it
    EXPECT_NEAR(rotation_angle(Pose(recording.inverse() * key.world_from_cam)),
                std::acos(0.25 *
                              (1 + std::cos(60 * kDegrees) + std::cos(20 * kDegrees) +
                               std::cos(60 * kDegrees) * std::cos(20 * kDegrees)) *
                              2 -
                          1),
                1e-9);  // two turns about perpendicular axes: cos(a/2) = cos(s/2) cos(r/2)
  }
  const CameraPath still = follow(nodes, options, 2, true);
  for (const CameraKeyframe& key : still.keyframes) {
    EXPECT_TRUE(key.world_from_cam.isApprox(path.keyframes.front().world_from_cam, 1e-12));
  }
}

CameraPath curve(int keys, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  CameraPath path;
  path.interpolation = CameraPath::Interpolation::spline;
  double t = 0;
  Pose pose = Pose::Identity();
  for (int i = 0; i < keys; ++i) {
    path.keyframes.push_back({.t = t, .world_from_cam = pose, .fov = 0.8 + 0.1 * i});
    t += 0.5 + 0.3 * std::abs(normal(random));
    pose.translation() += Vector3d(normal(random), normal(random), normal(random));
    pose.rotate(Eigen::AngleAxisd(0.5, Vector3d(normal(random), normal(random), normal(random)).normalized()));
  }
  return path;
}

TEST(Spline, PassesThroughItsKeyframesSmoothly) {
  const CameraPath path = curve(6, 4);
  constexpr double h = 1e-5;
  for (size_t i = 0; i < path.keyframes.size(); ++i) {
    const CameraKeyframe& key = path.keyframes[i];
    EXPECT_TRUE(sample(path, key.t).world_from_cam.isApprox(key.world_from_cam, 1e-9));
    EXPECT_NEAR(sample(path, key.t).fov, key.fov, 1e-9);
    if (i == 0 || i + 1 == path.keyframes.size()) continue;
    // The velocities on both sides of a keyframe agree; one-sided differences are wrong by h times the acceleration.
    const Pose before = sample(path, key.t - h).world_from_cam, after = sample(path, key.t + h).world_from_cam;
    const Vector3d v0 = (key.world_from_cam.translation() - before.translation()) / h;
    const Vector3d v1 = (after.translation() - key.world_from_cam.translation()) / h;
    EXPECT_LT((v1 - v0).norm(), 1e-3 * (1 + v0.norm()));
    const auto rate = [&](const Pose& a, const Pose& b) {
      const Eigen::AngleAxisd turn(Eigen::Matrix3d(a.linear().transpose() * b.linear()));
      return Vector3d(turn.angle() / h * turn.axis());
    };
    EXPECT_LT((rate(key.world_from_cam, after) - rate(before, key.world_from_cam)).norm(), 2e-3);
  }
}

TEST(Spline, IsExactForParabolasAndTurnsAboutOneAxis) {
  // Positions of uniform acceleration, a turn of constant speed: the curve through unevenly spaced samples is the
  // motion itself.
  const auto truth = [](double t) {
    Pose pose = Pose::Identity();
    pose.linear() = Eigen::AngleAxisd(0.4 * t, Vector3d(1, 2, -1).normalized()).matrix();
    pose.translation() = Vector3d(1, -2, 3) + t * Vector3d(0.5, 0.2, -1) + t * t * Vector3d(-0.1, 0.3, 0.2);
    return pose;
  };
  CameraPath path;
  path.interpolation = CameraPath::Interpolation::spline;
  for (const double t : {0.0, 0.7, 1.1, 2.6, 3.0}) {
    path.keyframes.push_back({.t = t, .world_from_cam = truth(t), .fov = 1});
  }
  for (double t = 0; t <= 3; t += 0.01) {
    EXPECT_TRUE(sample(path, t).world_from_cam.isApprox(truth(t), 1e-9)) << t;
  }
}

TEST(Ease, BeginsAndEndsAtRestAndTakesAsLong) {
  CameraPath path;
  path.ease = 2;
  path.keyframes = {{.t = 5}, {.t = 15}};
  EXPECT_DOUBLE_EQ(eased_time(path, 0), 5);
  EXPECT_NEAR(eased_time(path, 10), 15, 1e-12);
  EXPECT_NEAR(eased_time(path, 5), 10, 1e-12);
  constexpr double h = 1e-4;
  const auto speed = [&](double t) { return (eased_time(path, t + h) - eased_time(path, t - h)) / (2 * h); };
  EXPECT_LT(speed(2 * h), 1e-4);
  EXPECT_LT(speed(10 - 2 * h), 1e-4);
  EXPECT_NEAR(speed(1), 0.5 * 10.0 / 8, 1e-3);  // half of full speed in the middle of the ramp
  EXPECT_NEAR(speed(5), 10.0 / 8, 1e-6);
  for (double t = 0.01; t < 10; t += 0.01) {
    EXPECT_GT(eased_time(path, t), eased_time(path, t - 0.01));
    EXPECT_NEAR(eased_time(path, t) + eased_time(path, 10 - t), 20, 1e-9);
  }
  path.ease = 0;
  EXPECT_DOUBLE_EQ(eased_time(path, 3.3), 8.3);
  path.ease = 100;  // no longer than half of the path
  EXPECT_NEAR(eased_time(path, 10), 15, 1e-12);
}

TEST(LookedAt, IsTheObjectThatTheCamerasStandRound) {
  // A pillar in a large room; cameras round it look at it, others look at a wall.
  testing::RayScene scene;
  using V = Vector3d;
  scene.rectangles = {{V(-6, -6, 0), V(12, 0, 0), V(0, 0, 3), 0.1},  {V(-6, 6, 0), V(12, 0, 0), V(0, 0, 3), 0.9},
                      {V(-6, -6, 0), V(0, 12, 0), V(0, 0, 3), 1.7},  {V(6, -6, 0), V(0, 12, 0), V(0, 0, 3), 2.3},
                      {V(0.8, 0.8, 0), V(0.4, 0, 0), V(0, 0, 3), 3}, {V(0.8, 1.2, 0), V(0.4, 0, 0), V(0, 0, 3), 4},
                      {V(0.8, 0.8, 0), V(0, 0.4, 0), V(0, 0, 3), 5}, {V(1.2, 0.8, 0), V(0, 0.4, 0), V(0, 0, 3), 6}};
  std::vector<StereoView> views;
  for (int i = 0; i < 8; ++i) {
    const V position(1 + 2 * std::cos(0.25 * i), 1 + 2 * std::sin(0.25 * i), 1.5);
    views.push_back(scene.view(testing::scene_camera(), looking(position, V(1, 1, 1.5) - position), i));
  }
  for (int i = 8; i < 13; ++i) {
    views.push_back(scene.view(testing::scene_camera(), looking({-3, -3.0 + i * 0.2, 1.5}, {-1, 0, 0}), i));
  }
  const views::MemoryViewStore store(views);
  const auto found = most_looked_at(store, 0);
  ASSERT_TRUE(found);
  EXPECT_LT((found->point - V(1, 1, 1.5)).head<2>().norm(), 0.35);  // on its surface
  EXPECT_GE(found->views, 6);
  EXPECT_NEAR(found->distance, 1.8, 0.2);
  EXPECT_FALSE(most_looked_at(store, 7));
}

mapping::MapRaster open_map(int width, int height) {
  mapping::MapRaster raster{.cell = 0.1, .origin_x = 0, .origin_y = 0, .width = width, .height = height};
  raster.state = cv::Mat1b(height, width, static_cast<uint8_t>(mapping::MapState::free));
  return raster;
}

TEST(FreeRadius, IsTheLargestThatIsFree) {
  const FreeSpace space(open_map(80, 60));
  EXPECT_NEAR(free_radius(space, {4, 3}, 5), 3, 0.11);
  EXPECT_NEAR(free_radius(space, {4, 3}, 2), 2, 1e-12);
}

TEST(Panoramas, SpreadOverThePathAndReachEachOther) {
  // An L-shaped corridor, 1 m wide: 8 m along x, then 6 m along y.
  mapping::MapRaster raster = open_map(90, 80);
  raster.state = static_cast<uint8_t>(mapping::MapState::occupied);
  const auto clear = [&](int x0, int y0, int x1, int y1) {
    raster.state(cv::Rect(x0, raster.height - y1, x1 - x0, y1 - y0)) = static_cast<uint8_t>(mapping::MapState::free);
  };
  clear(5, 5, 85, 15);
  clear(75, 5, 85, 75);
  const FreeSpace space(raster);
  std::vector<PoseNode> nodes;
  const auto add = [&](double x, double y) {
    nodes.push_back({.frame_idx = static_cast<int>(nodes.size()), .world_from_cam = looking({x, y, 1.4}, {1, 0, 0})});
  };
  for (double x = 1; x < 8; x += 0.1) add(x, 1);
  for (double y = 1; y < 7; y += 0.1) add(8, y);
  PanoramaOptions options;
  options.spacing = 2.5;
  const std::vector<Vector2d> places = panorama_places(space, nodes, options);
  EXPECT_GE(places.size(), 5u);
  EXPECT_LE(places.size(), 7u);
  for (const Vector2d& place : places) EXPECT_TRUE(space.free(place));
  // From everywhere on the path one sees a panorama.
  for (const PoseNode& node : nodes) {
    const Vector2d at = node.world_from_cam.translation().head<2>();
    if (!space.free(at)) continue;
    EXPECT_TRUE(std::any_of(places.begin(), places.end(), [&](const Vector2d& p) { return space.straight(p, at, 0); }));
  }
  for (size_t i = 0; i < places.size(); ++i) {
    for (size_t k = 0; k < i; ++k) EXPECT_GE((places[i] - places[k]).norm(), 0.5 * options.spacing);
  }
  const std::vector<PanoramaNode> linked = link_panoramas(space, places, options);
  std::vector<int> reached = {0};
  for (size_t i = 0; i < reached.size(); ++i) {
    for (const int k : linked[static_cast<size_t>(reached[i])].links) {
      EXPECT_TRUE(
          space.straight(linked[static_cast<size_t>(reached[i])].position, linked[static_cast<size_t>(k)].position, 0));
      const auto& back = linked[static_cast<size_t>(k)].links;
      EXPECT_NE(std::find(back.begin(), back.end(), reached[i]), back.end());
      if (std::find(reached.begin(), reached.end(), k) == reached.end()) reached.push_back(k);
    }
  }
  EXPECT_EQ(reached.size(), places.size());
  options.nodes = 3;
  EXPECT_LE(panorama_places(space, nodes, options).size(), 3u);

  // Places that do not see each other are linked all the same if there is no other way, beyond the reach too (9.2 m).
  const std::vector<PanoramaNode> apart = link_panoramas(space, {{1, 1}, {8, 7}}, options);
  EXPECT_EQ(apart[0].links, std::vector<int>{1});
}

}  // namespace
}  // namespace iris::tour
