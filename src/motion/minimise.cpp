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

Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

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

namespace {

// Covariance and variance factor of a finished minimisation.
MinimisedMotion finished(MinimisedMotion result, const Matrix6d& hessian, double squares, size_t pairs) {
  result.prev_from_cur.linear() = nearest_rotation(result.prev_from_cur.linear());
  const Eigen::LLT<Matrix6d> solver(hessian);
  if (solver.info() != Eigen::Success) {
    result.converged = false;
    return result;
  }
  // Few residuals may be small by chance: never more certain than pixel_error promises.
  const double freedom = 3.0 * static_cast<double>(pairs) - 6;
  if (freedom > 0) result.variance_factor = squares / freedom;
  result.covariance = std::max(1.0, result.variance_factor) * solver.solve(Matrix6d::Identity());
  return result;
}

// The squared step in standard deviations of the estimate below which it has come to rest.
constexpr double kRest = 1e-10;

MinimisedMotion minimise_ellipsoid(const RectifiedCamera& camera, const std::vector<PointPair>& pairs,
                                   double pixel_error, double huber, const Pose& guess) {
  std::vector<std::pair<Eigen::Matrix3d, Eigen::Matrix3d>> covariances;
  for (const auto& [p, q] : pairs) {
    covariances.emplace_back(reconstruct::point_covariance(camera, p, pixel_error),
                             reconstruct::point_covariance(camera, q, pixel_error));
  }
  const auto cost_at = [&](const Pose& motion) {
    MotionCost cost;
    for (size_t i = 0; i < pairs.size(); ++i) {
      add_ellipsoid(cost, pairs[i], covariances[i].first, covariances[i].second, huber, motion);
    }
    return cost;
  };
  MinimisedMotion result{.converged = false, .prev_from_cur = guess};
  MotionCost cost = cost_at(guess);
  double damping = 1e-6;
  for (; result.iterations < 100 && !result.converged && std::isfinite(cost.value); ++result.iterations) {
    Matrix6d damped = cost.hessian;
    damped.diagonal() *= 1 + damping;
    const Eigen::LLT<Matrix6d> solver(damped);
    if (solver.info() != Eigen::Success) return result;
    const Vector6d step = solver.solve(-cost.gradient);
    const bool tiny = step.dot(cost.hessian * step) < kRest;
    const Pose next = perturbed(result.prev_from_cur, step);
    const MotionCost next_cost = cost_at(next);
    if (next_cost.value <= cost.value) {
      result.prev_from_cur = next;
      cost = next_cost;
      damping = std::max(damping / 10, 1e-9);
    } else {
      damping *= 10;
    }
    result.converged = tiny || damping > 1e9;
  }
  return finished(result, cost.hessian, cost.squares, pairs.size());
}

// One point of the two-view bundle adjustment (4.7, 4.8).
struct ImagePoint {
  Eigen::Vector3d seen_prev, seen_cur;  // measured image coordinates [px]
  Eigen::Vector3d point;                // in the current camera [m]
  // Of the last linearisation, by the point in the previous camera:
  Eigen::Matrix3d prev_hessian;     // what the previous view contributes
  Eigen::Matrix3d inverse_hessian;  // of both views
  Eigen::Vector3d gradient;
  Eigen::Vector3d turned;  // R point
  // By how much the point must move in the previous camera if the motion makes this step.
  Eigen::Vector3d step_for(const Vector6d& step) const {
    return -inverse_hessian * (gradient + prev_hessian * (step.head<3>() + step.tail<3>().cross(turned)));
  }
};

// Squared error in units of pixel_error^2; infinite if the point lies behind a camera.
double image_square(const RectifiedCamera& camera, const ImagePoint& point, const Eigen::Vector3d& at,
                    double pixel_error, const Pose& prev_from_cur) {
  const Eigen::Vector3d in_prev = prev_from_cur * at;
  if (!(at.z() > 0) || !(in_prev.z() > 0)) return std::numeric_limits<double>::infinity();
  return ((reconstruct::image_coordinates(camera, in_prev) - point.seen_prev).squaredNorm() +
          (reconstruct::image_coordinates(camera, at) - point.seen_cur).squaredNorm()) /
         (pixel_error * pixel_error);
}

double robust(double square, double huber) {
  return huber > 0 && square > huber * huber ? 2 * huber * std::sqrt(square) - huber * huber : square;
}

// Gradient and Hessian of the motion with all points eliminated by their 3x3 Schur complements; each point keeps what
// its own step needs.
MotionCost linearise(const RectifiedCamera& camera, std::vector<ImagePoint>& points, double pixel_error, double huber,
                     double damping, const Pose& prev_from_cur) {
  MotionCost cost;
  const double scale = 1 / pixel_error;
  const Eigen::Matrix3d& r = prev_from_cur.linear();
  for (ImagePoint& point : points) {
    point.turned = r * point.point;
    const Eigen::Vector3d in_prev = point.turned + prev_from_cur.translation();
    const Eigen::Vector3d of_prev = scale * (reconstruct::image_coordinates(camera, in_prev) - point.seen_prev);
    const Eigen::Vector3d of_cur = scale * (reconstruct::image_coordinates(camera, point.point) - point.seen_cur);
    const Eigen::Matrix3d by_prev = scale * reconstruct::image_jacobian(camera, in_prev);
    const Eigen::Matrix3d by_cur = scale * reconstruct::image_jacobian(camera, point.point) * r.transpose();
    const Eigen::Vector3d prev_gradient = by_prev.transpose() * of_prev;
    point.prev_hessian = by_prev.transpose() * by_prev;
    Eigen::Matrix3d hessian = point.prev_hessian + by_cur.transpose() * by_cur;
    hessian.diagonal() *= 1 + damping;
    point.inverse_hessian = hessian.inverse();
    point.gradient = prev_gradient + by_cur.transpose() * of_cur;
    // The Schur complement, in the previous camera; the motion moves the point there by dt + dw x (R point).
    const Eigen::Matrix3d reduction = point.prev_hessian * point.inverse_hessian;
    const Eigen::Vector3d g = prev_gradient - reduction * point.gradient;
    const Eigen::Matrix3d h = point.prev_hessian - reduction * point.prev_hessian;
    const Eigen::Matrix3d x = cross_matrix(point.turned);
    Vector6d gradient;
    gradient << g, point.turned.cross(g);
    Matrix6d reduced;
    reduced.topLeftCorner<3, 3>() = h;
    reduced.bottomLeftCorner<3, 3>() = x * h;
    reduced.topRightCorner<3, 3>() = reduced.bottomLeftCorner<3, 3>().transpose();
    reduced.bottomRightCorner<3, 3>() = -reduced.bottomLeftCorner<3, 3>() * x;
    add(cost, of_prev.squaredNorm() + of_cur.squaredNorm(), gradient, reduced, huber);
  }
  return cost;
}

// Over the motion and all points jointly.
MinimisedMotion minimise_image(const RectifiedCamera& camera, const std::vector<PointPair>& pairs, double pixel_error,
                               double huber, const Pose& guess) {
  MinimisedMotion result{.converged = false, .prev_from_cur = guess};
  std::vector<ImagePoint> points(pairs.size());
  std::vector<Eigen::Vector3d> moved(pairs.size());
  double value = 0;
  for (size_t i = 0; i < pairs.size(); ++i) {
    points[i].seen_prev = reconstruct::image_coordinates(camera, pairs[i].first);
    points[i].seen_cur = reconstruct::image_coordinates(camera, pairs[i].second);
    points[i].point = pairs[i].second;
    value += robust(image_square(camera, points[i], points[i].point, pixel_error, guess), huber);
  }
  double damping = 1e-6;
  for (; result.iterations < 100 && !result.converged && std::isfinite(value); ++result.iterations) {
    const MotionCost cost = linearise(camera, points, pixel_error, huber, damping, result.prev_from_cur);
    Matrix6d damped = cost.hessian;
    damped.diagonal() *= 1 + damping;
    const Eigen::LLT<Matrix6d> solver(damped);
    if (solver.info() != Eigen::Success) return result;
    const Vector6d step = solver.solve(-cost.gradient);
    // The points move even if the motion rests.
    double decrease = step.dot(cost.hessian * step);
    const Pose next = perturbed(result.prev_from_cur, step);
    double next_value = 0;
    for (size_t i = 0; i < points.size(); ++i) {
      const ImagePoint& point = points[i];
      decrease = std::max(decrease, point.gradient.dot(point.inverse_hessian * point.gradient));
      moved[i] = point.point + result.prev_from_cur.linear().transpose() * point.step_for(step);
      next_value += robust(image_square(camera, point, moved[i], pixel_error, next), huber);
    }
    if (next_value <= value) {
      for (size_t i = 0; i < points.size(); ++i) points[i].point = moved[i];
      result.prev_from_cur = next;
      value = next_value;
      damping = std::max(damping / 10, 1e-9);
    } else {
      damping *= 10;
    }
    result.converged = decrease < kRest || damping > 1e9;
  }
  const MotionCost cost = linearise(camera, points, pixel_error, huber, 0, result.prev_from_cur);
  return finished(result, cost.hessian, cost.squares, pairs.size());
}

}  // namespace

MinimisedMotion minimise_motion(const RectifiedCamera& camera, const std::vector<PointPair>& pairs, ErrorModel model,
                                double pixel_error, double huber, const Pose& guess) {
  return model == ErrorModel::image ? minimise_image(camera, pairs, pixel_error, huber, guess)
                                    : minimise_ellipsoid(camera, pairs, pixel_error, huber, guess);
}

}  // namespace iris::motion
