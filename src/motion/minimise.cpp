#include "iris/motion/minimise.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>

#include "iris/reconstruct/error_models.h"
#include "iris/reconstruct/error_propagation.h"

namespace iris::motion {
namespace {

Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

// Adds one pair: its squared error, and gradient and Hessian of half of it.
void add(MotionCost& cost, double square, const Vector6d& gradient, const Matrix6d& hessian, double huber) {
  const double error = std::sqrt(square);
  const double weight = huber > 0 && error > huber ? huber / error : 1;  // rho'
  cost.value += weight < 1 ? 2 * huber * error - huber * huber : square;
  cost.gradient += weight * gradient;
  cost.hessian += weight * hessian;
  cost.squares += weight * square;
}

void add_ellipsoid(MotionCost& cost, const PointPair& pair, const Eigen::Matrix3d& prev_covariance,
                   const Eigen::Matrix3d& cur_covariance, double huber, const Pose& prev_from_cur) {
  const Eigen::Matrix3d& r = prev_from_cur.linear();
  const Eigen::Vector3d turned = r * pair.second;
  const Eigen::Vector3d e = pair.first - turned - prev_from_cur.translation();
  const Eigen::Matrix3d turned_covariance = r * cur_covariance * r.transpose();
  const Eigen::Matrix3d information = (prev_covariance + turned_covariance).inverse();
  const Eigen::Vector3d a = information * e;
  Eigen::Matrix<double, 3, 6> jacobian;  // of e
  jacobian << -Eigen::Matrix3d::Identity(), cross_matrix(turned);
  Vector6d gradient = jacobian.transpose() * a;
  gradient.tail<3>() -= (turned_covariance * a).cross(a);  // the covariance of the current point turns as well
  add(cost, e.dot(a), gradient, jacobian.transpose() * information * jacobian, huber);
}

void add_image(MotionCost& cost, const RectifiedCamera& camera, const PointPair& pair, double pixel_error, double huber,
               const Pose& prev_from_cur) {
  const reconstruct::ImageError error =
      reconstruct::image_error(camera, pair.first, pair.second, prev_from_cur, pixel_error);
  const Eigen::Vector3d turned = prev_from_cur.linear() * error.best;
  const Eigen::Vector3d in_prev = turned + prev_from_cur.translation();
  if (!std::isfinite(error.square)) {
    cost.value = std::numeric_limits<double>::infinity();  // a point behind a camera: no step may lead here
    return;
  }
  const Eigen::Matrix3d by_prev = reconstruct::image_jacobian(camera, in_prev) / pixel_error;
  const Eigen::Matrix3d by_cur = reconstruct::image_jacobian(camera, error.best) / pixel_error;
  Eigen::Matrix<double, 3, 6> in_prev_by_motion;
  in_prev_by_motion << Eigen::Matrix3d::Identity(), -cross_matrix(turned);
  const Eigen::Matrix<double, 3, 6> a = by_prev * in_prev_by_motion;  // residuals in prev by the motion
  const Eigen::Matrix3d b = by_prev * prev_from_cur.linear();         // and by the point
  const Eigen::Vector3d residual =
      (reconstruct::image_coordinates(camera, in_prev) - reconstruct::image_coordinates(camera, pair.first)) /
      pixel_error;
  // At the best point the derivative by the point is 0, so that the gradient needs no elimination; the Hessian does.
  const Eigen::Matrix3d point_hessian = b.transpose() * b + by_cur.transpose() * by_cur;
  const Eigen::Matrix<double, 3, 6> coupling = b.transpose() * a;
  add(cost, error.square, a.transpose() * residual,
      a.transpose() * a - coupling.transpose() * point_hessian.inverse() * coupling, huber);
}

}  // namespace

Pose perturbed(const Pose& pose, const Vector6d& step) {
  Pose result = pose;
  result.translation() += step.head<3>();
  const double angle = step.tail<3>().norm();
  if (angle > 0) result.linear() = Eigen::AngleAxisd(angle, step.tail<3>() / angle).toRotationMatrix() * pose.linear();
  return result;
}

MotionCost motion_cost(const RectifiedCamera& camera, const std::vector<PointPair>& pairs, ErrorModel model,
                       double pixel_error, double huber, const Pose& prev_from_cur) {
  MotionCost cost;
  for (const PointPair& pair : pairs) {
    if (model == ErrorModel::ellipsoid) {
      add_ellipsoid(cost, pair, reconstruct::point_covariance(camera, pair.first, pixel_error),
                    reconstruct::point_covariance(camera, pair.second, pixel_error), huber, prev_from_cur);
    } else {
      add_image(cost, camera, pair, pixel_error, huber, prev_from_cur);
    }
  }
  return cost;
}

MinimisedMotion minimise_motion(const RectifiedCamera& camera, const std::vector<PointPair>& pairs, ErrorModel model,
                                double pixel_error, double huber, const Pose& guess) {
  MinimisedMotion result{.converged = false, .prev_from_cur = guess};
  MotionCost cost = motion_cost(camera, pairs, model, pixel_error, huber, guess);
  double damping = 1e-6;
  for (; result.iterations < 100 && !result.converged && std::isfinite(cost.value); ++result.iterations) {
    Matrix6d damped = cost.hessian;
    damped.diagonal() *= 1 + damping;
    const Eigen::LLT<Matrix6d> solver(damped);
    if (solver.info() != Eigen::Success) return result;
    const Vector6d step = solver.solve(-cost.gradient);
    // The squared step in standard deviations of the estimate: far below one it changes nothing.
    const bool tiny = step.dot(cost.hessian * step) < 1e-6;
    const Pose next = perturbed(result.prev_from_cur, step);
    const MotionCost next_cost = motion_cost(camera, pairs, model, pixel_error, huber, next);
    if (next_cost.value <= cost.value) {
      result.prev_from_cur = next;
      cost = next_cost;
      damping = std::max(damping / 10, 1e-9);
    } else {
      damping *= 10;
    }
    result.converged = tiny || damping > 1e9;
  }
  result.prev_from_cur.linear() = nearest_rotation(result.prev_from_cur.linear());
  const Eigen::LLT<Matrix6d> solver(cost.hessian);
  if (solver.info() != Eigen::Success) {
    result.converged = false;
    return result;
  }
  // Few residuals may be small by chance: never more certain than pixel_error promises.
  const double freedom = 3.0 * static_cast<double>(pairs.size()) - 6;
  const double factor = freedom > 0 ? std::max(1.0, cost.squares / freedom) : 1.0;
  result.covariance = factor * solver.solve(Matrix6d::Identity());
  return result;
}

}  // namespace iris::motion
