// Small rigid motions and their covariances.
#pragma once

#include "iris/geometry/pose.h"

namespace iris::loop {

// The covariance of (dt, dw), t' = t + dt, R' = exp(dw) R (as in MotionEstimate), as that of a twist (v, w) on the
// left, pose' = exp(v, w) pose, and back.
Matrix6d twist_covariance(const Pose& pose, const Matrix6d& covariance);
Matrix6d motion_covariance(const Pose& pose, const Matrix6d& twist_covariance);

// Takes a twist (v, w) given in frame a to frame b.
Matrix6d adjoint(const Pose& b_from_a);

// The twist whose exponential is the pose (its rotation below a full turn).
Vector6d twist_of(const Pose& pose);

// The pose after a step (dt, dw), made as a screw about the world's origin, whose twist is (dt - dw x t, dw): a common
// step of many poses then moves them as one rigid body, however large it is, and long chains bend without strain. To
// first order it is the plain perturbation.
Pose screwed(const Pose& pose, const Vector6d& step);

// Derivative of log(exp(d) exp(phi)) by d at d = 0.
Eigen::Matrix3d inverse_left_jacobian(const Eigen::Vector3d& phi);

// Logarithm of a rotation.
Eigen::Vector3d log_of(const Eigen::Matrix3d& rotation);

}  // namespace iris::loop
