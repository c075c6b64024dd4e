// The last minimisation of the camera motion over an error model (thesis 4.4 and 5.3.4).
#pragma once

#include <functional>
#include <utility>
#include <vector>

#include "iris/geometry/pose.h"
#include "iris/geometry/rectified_camera.h"

namespace iris::motion {

enum class ErrorModel { ellipsoid, image };

// The two reconstructions of one point: in the previous and in the current camera [m].
struct PointPair {
  Eigen::Vector3d prev, cur;
  // For the image based model: what the differences of the image coordinates (x_left, sqrt(2) y, x_right) [px] are
  // multiplied by to have variance pixel_error^2 each, in either view.
  Eigen::Matrix3d whitening = Eigen::Matrix3d::Identity();
  // For the image based model: `prev` may have been seen by another camera than the previous one, from there.
  Pose prev_from_seeing = Pose::Identity();
};

// A sum over all pairs of rho(e^2), e^2 the model's squared error in units of pixel_error^2, and its derivatives by the
// perturbation (dt, dw): T + dt, exp(dw) R. The gradient is exact; the Hessian is Gauss and Newton's.
struct MotionCost {
  double value = 0;
  Vector6d gradient = Vector6d::Zero();  // of value / 2
  Matrix6d hessian = Matrix6d::Zero();   // of value / 2
};

// rho is Huber's function: e^2 up to e = huber, then 2 huber e - huber^2; huber <= 0: no limit.
// ellipsoid: (4.15), both points' covariances at the given rotation.
// image: (4.7, 4.8), each point's best position being eliminated (3x3 Schur complement).
MotionCost motion_cost(const RectifiedCamera& camera, const std::vector<PointPair>& pairs, ErrorModel model,
                       double pixel_error, double huber, const Pose& prev_from_cur);

struct MinimisedMotion {
  bool converged = false;
  Pose prev_from_cur = Pose::Identity();
  Matrix6d covariance = Matrix6d::Zero();  // as in MotionEstimate
  double variance_factor = 1;              // see minimise_motion
  int iterations = 0;
};

// Levenberg-Marquardt from a first guess. The covariance is the inverse of the Hessian H, times the variance factor if
// that is above 1. That factor is how much larger the errors of the motion are than H says, by what the residuals show:
// the mean over all directions of H^-1 S, where S is the sum of g_i g_k^T over all pairs i and k (also i = k) that lie
// so close together in the image that their surroundings overlap, and g_i is what pair i contributes to the gradient.
// It accounts for residuals that are larger than pixel_error, and for errors that neighbours share.
// Not converged: the Hessian is singular, or the step does not vanish within 100 iterations.
MinimisedMotion minimise_motion(const RectifiedCamera& camera, const std::vector<PointPair>& pairs, ErrorModel model,
                                double pixel_error, double huber, const Pose& guess);

// The pose moved by (dt, dw): T + dt, exp(dw) R.
Pose perturbed(const Pose& pose, const Vector6d& step);

// The matrix of the cross product: cross_matrix(v) w = v x w.
Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v);

}  // namespace iris::motion
