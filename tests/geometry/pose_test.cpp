#include "iris/geometry/pose.h"

#include <gtest/gtest.h>

#include <numbers>

namespace iris {
namespace {

TEST(RotationAngle, EqualsTheAngleItWasMadeFrom) {
  const Eigen::Vector3d axis = Eigen::Vector3d(1, -2, 0.5).normalized();
  for (const double angle : {0.0, 1e-9, 1e-4, 0.3, 1.5, 3.0, std::numbers::pi - 1e-9, std::numbers::pi}) {
    // The rounding of the matrix entries limits the angle near pi to about the root of the machine's epsilon.
    EXPECT_NEAR(rotation_angle(Eigen::AngleAxisd(angle, axis).toRotationMatrix()), angle, 1e-7);
  }
}

TEST(NearestRotation, RestoresARotationAndNeverAReflection) {
  const Eigen::Matrix3d r = Eigen::AngleAxisd(0.7, Eigen::Vector3d(0.2, 0.9, -0.3).normalized()).toRotationMatrix();
  Eigen::Matrix3d noisy = r;
  noisy(0, 1) += 1e-6;
  noisy(2, 0) -= 2e-6;
  EXPECT_LT((nearest_rotation(noisy) - r).norm(), 4e-6);
  EXPECT_NEAR(nearest_rotation(-r).determinant(), 1.0, 1e-12);
}

TEST(ZUpFromCamera, TakesForwardToXAndDownToMinusZ) {
  const Pose pose = z_up_from_camera();
  EXPECT_EQ((pose * Eigen::Vector3d(1, 2, 3) - Eigen::Vector3d(3, -1, -2)).norm(), 0);
  EXPECT_EQ(pose.linear().determinant(), 1);
}

}  // namespace
}  // namespace iris
