#include "iris/motion/minimise.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>

#include "iris/motion/track.h"
#include "iris/reconstruct/error_models.h"
#include "iris/reconstruct/error_propagation.h"

namespace iris::motion {
namespace {

// Adds one pair: its squared error, and gradient and Hessian of half of it.
// Returns rho'.
double add(MotionCost& cost, double square, const Vector6d& gradient, const Matrix6d& hessian, double huber) {
  const double error = std::sqrt(square);
  const double weight = huber > 0 && error > huber ? huber / error : 1;
  cost.value += weight < 1 ? 2 * huber * error - huber * huber : square;
  cost.gradient += weight * gradient;
  cost.hessian += weight * hessian;
  return weight;
}

void add_ellipsoid(MotionCost& cost, const PointPair& pair, const Eigen::Matrix3d& prev_covariance,
                   const Eigen::Matrix3d& cur_covariance, double huber, const Pose& prev_from_cur,
                   std::vector<Vector6d>* contributions = nullptr) {
  const Eigen::Matrix3d& r = prev_from_cur.linear();
  const Eigen::Vector3d turned = r * pair.cur;
  const Eigen::Vector3d e = pair.prev - turned - prev_from_cur.translation();
  const Eigen::Matrix3d turned_covariance = r * cur_covariance * r.transpose();
  const Eigen::Matrix3d information = (prev_covariance + turned_covariance).inverse();
  const Eigen::Vector3d a = information * e;
  Eigen::Matrix<double, 3, 6> jacobian;  // of e
  jacobian << -Eigen::Matrix3d::Identity(), cross_matrix(turned);
  Vector6d gradient = jacobian.transpose() * a;
  gradient.tail<3>() -= (turned_covariance * a).cross(a);  // the covariance of the current point turns as well
  const double weight = add(cost, e.dot(a), gradient, jacobian.transpose() * information * jacobian, huber);
  if (contributions) contributions->push_back(weight * gradient);
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

namespace {

// Covariance and variance factor of a finished minimisation.
MinimisedMotion finished(MinimisedMotion result, const RectifiedCamera& camera, const std::vector<PointPair>& pairs,
                         const Matrix6d& hessian, const std::vector<Vector6d>& contributions) {
  result.prev_from_cur.linear() = nearest_rotation(result.prev_from_cur.linear());
  const Eigen::LLT<Matrix6d> solver(hessian);
  if (solver.info() != Eigen::Success) {
    result.converged = false;
    return result;
  }
  std::vector<Eigen::Vector2d> places;
  for (const PointPair& pair : pairs) places.emplace_back(camera.project(pair.cur).head<2>());
  Matrix6d sum = Matrix6d::Zero();
  for (size_t i = 0; i < pairs.size(); ++i) {
    Vector6d neighbours = contributions[i] / 2;
    for (size_t k = 0; k < i; ++k) {
      if ((places[i] - places[k]).cwiseAbs().maxCoeff() < kTrackWindow) neighbours += contributions[k];
    }
    sum += contributions[i] * neighbours.transpose();
  }
  const double freedom = 3.0 * static_cast<double>(pairs.size()) - 6;
  if (freedom > 0) {
    const double mean = solver.solve(sum + sum.transpose()).trace() / 6;
    result.variance_factor = mean * (freedom + 6) / freedom;
  }
  // Few residuals may be small by chance: never more certain than pixel_error promises.
  result.covariance = std::max(1.0, result.variance_factor) * solver.solve(Matrix6d::Identity());
  return result;
}

// The squared step in standard deviations of the estimate below which it has come to rest.
constexpr double kRest = 1e-10;

MinimisedMotion minimise_ellipsoid(const RectifiedCamera& camera, const std::vector<PointPair>& pairs,
                                   double pixel_error, double huber, const Pose& guess) {
  std::vector<std::pair<Eigen::Matrix3d, Eigen::Matrix3d>> covariances;
  for (const PointPair& pair : pairs) {
    covariances.emplace_back(reconstruct::point_covariance(camera, pair.prev, pixel_error),
                             reconstruct::point_covariance(camera, pair.cur, pixel_error));
  }
  const auto cost_at = [&](const Pose& motion, std::vector<Vector6d>* contributions = nullptr) {
    MotionCost cost;
    for (size_t i = 0; i < pairs.size(); ++i) {
      add_ellipsoid(cost, pairs[i], covariances[i].first, covariances[i].second, huber, motion, contributions);
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
  std::vector<Vector6d> contributions;
  cost = cost_at(result.prev_from_cur, &contributions);
  return finished(result, camera, pairs, cost.hessian, contributions);
}

// One point of the two-view bundle adjustment (4.7, 4.8).
struct ImagePoint {
  Eigen::Vector3d seen_prev, seen_cur;  // measured image coordinates [px]
  Eigen::Vector3d point;                // in the current camera [m]
  Pose seeing_from_prev;                // of the camera that saw seen_prev
  Eigen::Matrix3d whitening;            // as in PointPair
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

std::vector<ImagePoint> image_points(const RectifiedCamera& camera, const std::vector<PointPair>& pairs) {
  std::vector<ImagePoint> points(pairs.size());
  for (size_t i = 0; i < pairs.size(); ++i) {
    points[i].seen_prev = reconstruct::image_coordinates(camera, pairs[i].prev);
    points[i].seen_cur = reconstruct::image_coordinates(camera, pairs[i].cur);
    points[i].point = pairs[i].cur;
    points[i].seeing_from_prev = pairs[i].prev_from_seeing.inverse();
    points[i].whitening = pairs[i].whitening;
  }
  return points;
}

// Squared error in units of pixel_error^2; infinite if the point lies behind a camera.
double image_square(const RectifiedCamera& camera, const ImagePoint& point, const Eigen::Vector3d& at,
                    double pixel_error, const Pose& prev_from_cur) {
  const Eigen::Vector3d in_prev = point.seeing_from_prev * (prev_from_cur * at);
  if (!(at.z() > 0) || !(in_prev.z() > 0)) return std::numeric_limits<double>::infinity();
  return ((point.whitening * (reconstruct::image_coordinates(camera, in_prev) - point.seen_prev)).squaredNorm() +
          (point.whitening * (reconstruct::image_coordinates(camera, at) - point.seen_cur)).squaredNorm()) /
         (pixel_error * pixel_error);
}

double robust(double square, double huber) {
  return huber > 0 && square > huber * huber ? 2 * huber * std::sqrt(square) - huber * huber : square;
}

// Gradient and Hessian of the motion with all points eliminated by their 3x3 Schur complements; each point keeps what
// its own step needs.
MotionCost linearise(const RectifiedCamera& camera, std::vector<ImagePoint>& points, double pixel_error, double huber,
                     double damping, const Pose& prev_from_cur, std::vector<Vector6d>* contributions = nullptr) {
  MotionCost cost;
  const double scale = 1 / pixel_error;
  const Eigen::Matrix3d& r = prev_from_cur.linear();
  for (ImagePoint& point : points) {
    point.turned = r * point.point;
    const Eigen::Vector3d in_prev = point.seeing_from_prev * (point.turned + prev_from_cur.translation());
    const Eigen::Matrix3d w = scale * point.whitening;
    const Eigen::Vector3d of_prev = w * (reconstruct::image_coordinates(camera, in_prev) - point.seen_prev);
    const Eigen::Vector3d of_cur = w * (reconstruct::image_coordinates(camera, point.point) - point.seen_cur);
    const Eigen::Matrix3d by_prev = w * reconstruct::image_jacobian(camera, in_prev) * point.seeing_from_prev.linear();
    const Eigen::Matrix3d by_cur = w * reconstruct::image_jacobian(camera, point.point) * r.transpose();
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
    const double weight = add(cost, of_prev.squaredNorm() + of_cur.squaredNorm(), gradient, reduced, huber);
    if (contributions) contributions->push_back(weight * gradient);
  }
  return cost;
}

// Over the motion and all points jointly.
MinimisedMotion minimise_image(const RectifiedCamera& camera, const std::vector<PointPair>& pairs, double pixel_error,
                               double huber, const Pose& guess) {
  MinimisedMotion result{.converged = false, .prev_from_cur = guess};
  std::vector<ImagePoint> points = image_points(camera, pairs);
  std::vector<Eigen::Vector3d> moved(pairs.size());
  double value = 0;
  for (size_t i = 0; i < pairs.size(); ++i) {
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
  std::vector<Vector6d> contributions;
  const MotionCost cost = linearise(camera, points, pixel_error, huber, 0, result.prev_from_cur, &contributions);
  return finished(result, camera, pairs, cost.hessian, contributions);
}

// The cost with every point where its own error is least.
MotionCost image_cost(const RectifiedCamera& camera, const std::vector<PointPair>& pairs, double pixel_error,
                      double huber, const Pose& prev_from_cur) {
  std::vector<ImagePoint> points = image_points(camera, pairs);
  for (ImagePoint& point : points) {
    if (!std::isfinite(image_square(camera, point, point.point, pixel_error, prev_from_cur))) {
      return {.value = std::numeric_limits<double>::infinity()};
    }
  }
  constexpr int kSteps = 20;
  for (int step = 0; step < kSteps; ++step) {
    linearise(camera, points, pixel_error, 0, 0, prev_from_cur);
    for (ImagePoint& point : points) {
      Eigen::Vector3d move = prev_from_cur.linear().transpose() * point.step_for(Vector6d::Zero());
      const double before = image_square(camera, point, point.point, pixel_error, prev_from_cur);
      for (int halving = 0; halving < 8; ++halving, move /= 2) {
        if (image_square(camera, point, point.point + move, pixel_error, prev_from_cur) > before) continue;
        point.point += move;
        break;
      }
    }
  }
  return linearise(camera, points, pixel_error, huber, 0, prev_from_cur);
}

}  // namespace

MotionCost motion_cost(const RectifiedCamera& camera, const std::vector<PointPair>& pairs, ErrorModel model,
                       double pixel_error, double huber, const Pose& prev_from_cur) {
  if (model == ErrorModel::image) return image_cost(camera, pairs, pixel_error, huber, prev_from_cur);
  MotionCost cost;
  for (const PointPair& pair : pairs) {
    add_ellipsoid(cost, pair, reconstruct::point_covariance(camera, pair.prev, pixel_error),
                  reconstruct::point_covariance(camera, pair.cur, pixel_error), huber, prev_from_cur);
  }
  return cost;
}

MinimisedMotion minimise_motion(const RectifiedCamera& camera, const std::vector<PointPair>& pairs, ErrorModel model,
                                double pixel_error, double huber, const Pose& guess) {
  return model == ErrorModel::image ? minimise_image(camera, pairs, pixel_error, huber, guess)
                                    : minimise_ellipsoid(camera, pairs, pixel_error, huber, guess);
}

}  // namespace iris::motion
