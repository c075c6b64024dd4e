#include "iris/simulate/options.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

#include "iris/rectify/rectifier.h"

namespace iris::simulate {
namespace {

TEST(SimulateOptions, AreDeclaredOnceAndReadBack) {
  SimulateOptions options;
  OptionSet set;
  options.declare(set);
  EXPECT_EQ(set.options().size(), 18u);
  set.validate();
  set.set("simulate.baseline", "0.25");
  set.set("simulate.lens", "ideal");
  set.set("simulate.colour", "true");
  set.set("simulate.path", "circle");
  EXPECT_EQ(options.baseline, 0.25);
  EXPECT_EQ(options.lens, "ideal");
  EXPECT_TRUE(options.colour);
  EXPECT_EQ(options.path, "circle");
  set.validate();
  options.vignetting = 120;
  EXPECT_ANY_THROW(set.validate());
}

TEST(SimulatedRig, IdealLensIsRectifiedAndSeesTheFieldOfView) {
  SimulateOptions options;
  options.lens = "ideal";
  options.fov = 70;
  const StereoCalibration rig = simulated_rig(options);
  validate(rig, "rig");
  EXPECT_TRUE(rig.rectified);
  EXPECT_TRUE(is_rectified(rig));
  EXPECT_NEAR(rig.right_centre_in_left().x(), options.baseline, 1e-15);
  // Left and right border of the image: outer sides of the outer pixels.
  const Eigen::Vector3d left = rig.left.unproject({-0.5, (options.height - 1) / 2.0});
  const Eigen::Vector3d right = rig.left.unproject({options.width - 0.5, (options.height - 1) / 2.0});
  EXPECT_NEAR(std::acos(left.dot(right)) * 180 / std::numbers::pi, 70, 1e-9);
}

TEST(SimulatedRig, RealCamerasDifferAndMustBeRectified) {
  const SimulateOptions options;
  const StereoCalibration rig = simulated_rig(options);
  validate(rig, "rig");
  EXPECT_FALSE(rig.rectified);
  EXPECT_FALSE(is_rectified(rig));
  EXPECT_TRUE(rig.left.distorted() && rig.right.distorted());
  EXPECT_NE(rig.left.K, rig.right.K);
  EXPECT_NE(rig.left.K(0, 0), rig.left.K(1, 1));
  const double turn = rotation_angle(rig.right_from_left) * 180 / std::numbers::pi;
  EXPECT_GT(turn, 0.2);
  EXPECT_LT(turn, 1);
  EXPECT_NEAR(rig.right_centre_in_left().norm(), options.baseline, 1e-12);
  // Its rectified images are those of the ideal camera.
  const double f = options.width / 2.0 / std::tan(options.fov / 2 * std::numbers::pi / 180);
  const RectifiedCamera camera = rectify::Rectifier(rig).camera();
  EXPECT_NEAR(camera.f, f, 1e-9);
  EXPECT_NEAR(camera.baseline, options.baseline, 1e-12);
  // The lens can be inverted all over the image and beyond.
  for (const double x : {-10.0, 376.0, 762.0}) {
    for (const double y : {-10.0, 240.0, 490.0}) {
      const Eigen::Vector3d ray = rig.left.unproject({x, y});
      ASSERT_TRUE(ray.allFinite());
      EXPECT_LT((rig.left.project(ray) - Eigen::Vector2d(x, y)).norm(), 1e-8);
    }
  }
}

}  // namespace
}  // namespace iris::simulate
