// Disparities and masks against closed forms.
#include <gtest/gtest.h>

#include <cmath>

#include "iris/rectify/rectifier.h"
#include "iris/simulate/simulator.h"
#include "simulate/simple_scenes.h"

namespace iris::simulate {
namespace {

struct Plane {
  const char* name;
  Eigen::Vector3d normal;  // of the plane normal . p = distance, in the left camera's frame
  double distance;
  const char* lens;
};

class PlaneTruth : public ::testing::TestWithParam<Plane> {};

// The point of the plane that the recorded left pixel sees, projected into the recorded right camera, is where the
// rectified right pixel at x - disparity is looked up. The calibration alone is the truth: rectification and renderer
// are both checked.
TEST_P(PlaneTruth, DisparityLeadsToTheSamePointInTheRecordedRightImage) {
  const Plane plane = GetParam();
  const SimulateOptions options = plain_options(plane.lens);
  const Eigen::Vector3d a = plane.normal.unitOrthogonal(), b = plane.normal.cross(a);
  // Somewhere in the world, looking somewhere.
  Pose world_from_left = shifted(12, -7, 3);
  world_from_left.linear() = Eigen::AngleAxisd(1.1, Eigen::Vector3d(0.3, -0.5, 0.8).normalized()).toRotationMatrix();
  SceneObject object = rectangle(plane.normal * plane.distance - 30 * a - 30 * b, 60 * a, 60 * b);
  for (Eigen::Vector3f& vertex : object.mesh.vertices) vertex = (world_from_left * vertex.cast<double>()).cast<float>();
  const Simulator simulator(scene_of({object}), still_path(world_from_left), options);
  const FrameTruth truth = simulator.truth(0);
  const StereoCalibration& rig = simulator.calibration();
  const rectify::Rectifier rectifier(rig);
  int checked = 0, seen_by_both = 0;
  double worst = 0;
  for (int y = 0; y < options.height; ++y) {
    for (int x = 0; x < options.width; ++x) {
      const Eigen::Vector2d left = rectifier.left_source(Eigen::Vector2d(x, y));
      const bool inside =
          left.x() >= 0 && left.y() >= 0 && left.x() <= options.width - 1 && left.y() <= options.height - 1;
      const double d = static_cast<double>(truth.disparity(y, x));
      if (!inside) {
        ASSERT_EQ(d, 0);
        continue;
      }
      const Eigen::Vector3d ray = rig.left.unproject(left);
      const Eigen::Vector3d point = ray * plane.distance / plane.normal.dot(ray);
      const Eigen::Vector2d right = rig.right.project(rig.right_from_left * point);
      worst = std::max(worst, (rectifier.right_source(Eigen::Vector2d(x - d, y)) - right).norm());
      ++checked;
      const bool in_right = right.x() >= 0 && right.y() >= 0 && right.x() <= options.width - 1 &&
                            right.y() <= options.height - 1 && x - d >= 0;
      // Within 2 px of the border, the mask of whole pixels may decide otherwise.
      const double to_border =
          std::min({right.x(), right.y(), options.width - 1 - right.x(), options.height - 1 - right.y(), x - d});
      ASSERT_TRUE(std::abs(to_border) < 2 || (truth.occluded(y, x) == 0) == in_right) << x << " " << y;
      seen_by_both += in_right;
      ASSERT_EQ(truth.textured(y, x), 255);
    }
  }
  EXPECT_GT(checked, options.width * options.height * 9 / 10);
  EXPECT_GT(seen_by_both, checked / 2);
  // The corners of the rectangle are floats: 30 m have 1e-6 m, of 2 m that is 5e-7, of a disparity of 10 px 5e-6 px.
  EXPECT_LT(worst, 1e-4);
}

INSTANTIATE_TEST_SUITE_P(
    Planes, PlaneTruth,
    ::testing::Values(Plane{"frontal_ideal", {0, 0, 1}, 2, "ideal"}, Plane{"frontal_real", {0, 0, 1}, 2, "real"},
                      Plane{"slanted_ideal", Eigen::Vector3d(0.5, -0.3, 0.8).normalized(), 1.5, "ideal"},
                      Plane{"slanted_real", Eigen::Vector3d(-0.4, 0.45, 0.8).normalized(), 1.5, "real"}),
    [](const auto& test) { return test.param.name; });

// A square before a wall, seen by the ideal rig: what stands where, and who sees it, is elementary geometry.
struct SquareBeforeWall {
  double half = 0.3137, square_depth = 1.2, wall_depth = 3;
  RectifiedCamera camera;

  Eigen::Vector3d ray(int x, int y) const { return {(x - camera.cx) / camera.f, (y - camera.cy) / camera.f, 1}; }
  bool on_square(int x, int y) const {
    const Eigen::Vector3d p = ray(x, y) * square_depth;
    return std::abs(p.x()) < half && std::abs(p.y()) < half;
  }
  double disparity(int x, int y) const {
    return camera.f * camera.baseline / (on_square(x, y) ? square_depth : wall_depth);
  }
  bool occluded(int x, int y) const {
    if (x - disparity(x, y) < 0) return true;
    if (on_square(x, y)) return false;
    const Eigen::Vector3d p = ray(x, y) * wall_depth, eye(camera.baseline, 0, 0);
    const Eigen::Vector3d passing = eye + (p - eye) * square_depth / wall_depth;
    return std::abs(passing.x()) < half && std::abs(passing.y()) < half;
  }
  bool discontinuity(int x, int y) const {
    for (int v = std::max(0, y - 3); v <= std::min(camera.height - 1, y + 3); ++v) {
      for (int u = std::max(0, x - 3); u <= std::min(camera.width - 1, x + 3); ++u) {
        for (const auto& [du, dv] : {std::pair(1, 0), {-1, 0}, {0, 1}, {0, -1}}) {
          if (u + du < 0 || v + dv < 0 || u + du >= camera.width || v + dv >= camera.height) continue;
          if (std::abs(disparity(u, v) - disparity(u + du, v + dv)) > 1) return true;
        }
      }
    }
    return false;
  }
};

TEST(Truth, OcclusionAndDiscontinuityOfASquareBeforeAWall) {
  SquareBeforeWall expected;
  SceneObject square = rectangle({-expected.half, -expected.half, expected.square_depth}, {2 * expected.half, 0, 0},
                                 {0, 2 * expected.half, 0});
  square.textured = false;
  const SceneObject wall = rectangle({-20, -20, expected.wall_depth}, {40, 0, 0}, {0, 40, 0});
  const Simulator simulator(scene_of({square, wall}), still_path(), plain_options("ideal"));
  expected.camera = simulator.rectified_camera();
  const FrameTruth truth = simulator.truth(0);
  int wrong = 0, hidden = 0, discontinuous = 0;
  for (int y = 0; y < truth.disparity.rows; ++y) {
    for (int x = 0; x < truth.disparity.cols; ++x) {
      EXPECT_NEAR(static_cast<double>(truth.disparity(y, x)), expected.disparity(x, y), 1e-4);
      wrong += (truth.occluded(y, x) != 0) != expected.occluded(x, y);
      wrong += (truth.discontinuity(y, x) != 0) != expected.discontinuity(x, y);
      wrong += (truth.textured(y, x) == 0) != expected.on_square(x, y);
      hidden += truth.occluded(y, x) != 0;
      discontinuous += truth.discontinuity(y, x) != 0;
    }
  }
  EXPECT_EQ(wrong, 0);
  // The strip beside the square (f b (1/1.2 - 1/3) wide) and the left border (f b / 3 wide).
  EXPECT_GT(hidden, 1000);
  EXPECT_GT(discontinuous, 1000);
}

TEST(Truth, SkyHasNoDisparity) {
  // The lower half of the image is a floor, the upper half nothing; the world is the camera's frame: y points down.
  const SceneObject floor = rectangle({-50, 1, 0.1}, {100, 0, 0}, {0, 0, 4});
  SimulateOptions options = plain_options("ideal");
  const Simulator simulator(scene_of({floor}), still_path(), options);
  const RectifiedCamera& camera = simulator.rectified_camera();
  const FrameTruth truth = simulator.truth(0);
  for (int y = 0; y < options.height; ++y) {
    const double depth = camera.f / (y - camera.cy);
    const bool floor_there = depth > 0.1 && depth < 4.1;
    for (int x = 0; x < options.width; x += 7) {
      ASSERT_NEAR(static_cast<double>(truth.disparity(y, x)), floor_there ? camera.f * camera.baseline / depth : 0,
                  1e-4);
      ASSERT_EQ(truth.textured(y, x) != 0, floor_there);
    }
  }
  // The end of the floor, 4.1 m away, has a disparity of more than 1 px: a jump against the sky.
  const int last = static_cast<int>(std::ceil(camera.cy + camera.f / 4.1));
  EXPECT_EQ(truth.discontinuity(last, 100), 255);
  EXPECT_EQ(truth.discontinuity(last - 10, 100), 0);
}

TEST(Truth, FollowsMovingObjects) {
  // A wall that comes nearer, 1 m/s; its mesh lies in its own frame, turned.
  SceneObject wall = rectangle({-20, 0, -20}, {40, 0, 0}, {0, 0, 40});
  wall.world_from_object = [](double t) {
    Pose pose = shifted(0, 0, 4 - t);
    pose.linear() = Eigen::AngleAxisd(CV_PI / 2, Eigen::Vector3d::UnitX()).toRotationMatrix();
    return pose;
  };
  SimulateOptions options = plain_options("ideal");
  options.frames = 5;
  options.rate = 2;
  const Simulator simulator(scene_of({wall}), still_path(), options);
  const RectifiedCamera& camera = simulator.rectified_camera();
  for (const int frame : {3, 0, 4}) {
    const double expected = camera.f * camera.baseline / (4 - frame / 2.0);
    const FrameTruth truth = simulator.truth(frame);
    EXPECT_NEAR(static_cast<double>(truth.disparity(20, 100)), expected, 1e-4);
    EXPECT_NEAR(static_cast<double>(truth.disparity(180, 300)), expected, 1e-4);
  }
}

}  // namespace
}  // namespace iris::simulate
