#include "iris/loop/twist.h"

#include <cmath>

#include "iris/motion/minimise.h"

namespace iris::loop {

using motion::cross_matrix;

Matrix6d twist_covariance(const Pose& pose, const Matrix6d& covariance) {
  Matrix6d twist_from_motion = Matrix6d::Identity();  // v = dt + t x dw
  twist_from_motion.topRightCorner<3, 3>() = cross_matrix(pose.translation());
  return twist_from_motion * covariance * twist_from_motion.transpose();
}

Matrix6d motion_covariance(const Pose& pose, const Matrix6d& twist_covariance) {
  Matrix6d motion_from_twist = Matrix6d::Identity();
  motion_from_twist.topRightCorner<3, 3>() = -cross_matrix(pose.translation());
  return motion_from_twist * twist_covariance * motion_from_twist.transpose();
}

Matrix6d adjoint(const Pose& b_from_a) {
  Matrix6d result = Matrix6d::Zero();
  result.topLeftCorner<3, 3>() = result.bottomRightCorner<3, 3>() = b_from_a.linear();
  result.topRightCorner<3, 3>() = cross_matrix(b_from_a.translation()) * b_from_a.linear();
  return result;
}

Vector6d twist_of(const Pose& pose) {
  const Eigen::Vector3d phi = log_of(pose.linear());
  Vector6d twist;
  twist << inverse_left_jacobian(phi) * pose.translation(), phi;
  return twist;
}

Pose screwed(const Pose& pose, const Vector6d& step) {
  const Eigen::Vector3d w = step.tail<3>(), v = step.head<3>() - w.cross(pose.translation());
  const double angle = w.norm();
  Pose result = pose;
  if (angle < 1e-9) {
    result.translation() += step.head<3>();
  } else {
    const Eigen::Matrix3d turn = Eigen::AngleAxisd(angle, w / angle).toRotationMatrix();
    const Eigen::Vector3d wv = w.cross(v);
    result.translation() = turn * pose.translation() + v + (1 - std::cos(angle)) / (angle * angle) * wv +
                           (angle - std::sin(angle)) / (angle * angle * angle) * w.cross(wv);
    result.linear() = turn * pose.linear();
  }
  return result;
}

Eigen::Matrix3d inverse_left_jacobian(const Eigen::Vector3d& phi) {
  const double angle = phi.norm();
  const double factor = angle < 1e-4 ? 1.0 / 12 : (1 - 0.5 * angle / std::tan(0.5 * angle)) / (angle * angle);
  const Eigen::Matrix3d x = cross_matrix(phi);
  return Eigen::Matrix3d::Identity() - 0.5 * x + factor * x * x;
}

Eigen::Vector3d log_of(const Eigen::Matrix3d& rotation) {
  const Eigen::AngleAxisd turn(rotation);
  return turn.angle() * turn.axis();
}

}  // namespace iris::loop
