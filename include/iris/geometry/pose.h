// Rigid transforms. Always named b_from_a: x_in_b = b_from_a * x_in_a. Units: metres.
#pragma once

#include <Eigen/Geometry>

namespace iris {

using Pose = Eigen::Isometry3d;
using Matrix6d = Eigen::Matrix<double, 6, 6>;
using Vector6d = Eigen::Matrix<double, 6, 1>;

// Angle of the rotation, in [0, pi] rad.
double rotation_angle(const Eigen::Matrix3d& rotation);
inline double rotation_angle(const Pose& pose) { return rotation_angle(pose.linear()); }

// Nearest rotation to a matrix that is nearly one (keeps long chains of poses orthonormal).
Eigen::Matrix3d nearest_rotation(const Eigen::Matrix3d& matrix);

// Takes a level camera's frame (x right, y down, z forward) to a z-up frame with the same origin (x forward, y left, z
// up).
Pose z_up_from_camera();

}  // namespace iris
