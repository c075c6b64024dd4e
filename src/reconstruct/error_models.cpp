#include "iris/reconstruct/error_models.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "iris/reconstruct/error_propagation.h"

namespace iris::reconstruct {

double spherical_error(const RectifiedCamera& camera, const Eigen::Vector3d& p, const Eigen::Vector3d& q,
                       const Pose& p_from_q, double pixel_error) {
  const double variance =
      (point_covariance(camera, p, pixel_error).trace() + point_covariance(camera, q, pixel_error).trace()) / 3;
  return (p - p_from_q * q).squaredNorm() / variance;
}

double ellipsoid_error(const RectifiedCamera& camera, const Eigen::Vector3d& p, const Eigen::Vector3d& q,
                       const Pose& p_from_q, double pixel_error) {
  const Eigen::Matrix3d& r = p_from_q.linear();
  const Eigen::Matrix3d covariance =
      point_covariance(camera, p, pixel_error) + r * point_covariance(camera, q, pixel_error) * r.transpose();
  const Eigen::Vector3d e = p - p_from_q * q;
  return e.dot(covariance.llt().solve(e));
}

Eigen::Vector3d drifted_centre(const RectifiedCamera& camera, const Eigen::Vector3d& point, double error_px) {
  const Eigen::Vector3d b(camera.baseline / 2, 0, 0);
  const double relative = error_px * point.z() / (camera.f * camera.baseline);  // error over disparity
  return (point - b) / (1 - std::min(2 * relative * relative, 0.25)) + b;
}

double drift_error(const RectifiedCamera& camera, const Eigen::Vector3d& p, const Eigen::Vector3d& q,
                   const Pose& p_from_q, double pixel_error) {
  double square = ellipsoid_error(camera, p, q, p_from_q, pixel_error);
  for (int iteration = 0; iteration < 20; ++iteration) {
    const double error_px = pixel_error * std::sqrt(square / 2);  // half of the squared error for each view
    const double next = ellipsoid_error(camera, drifted_centre(camera, p, error_px),
                                        drifted_centre(camera, q, error_px), p_from_q, pixel_error);
    const bool converged = std::abs(next - square) <= 1e-9 * square;
    square = next;
    if (converged) break;
  }
  return square;
}

Eigen::Vector3d image_coordinates(const RectifiedCamera& camera, const Eigen::Vector3d& point) {
  return Eigen::Vector3d(point.x(), std::numbers::sqrt2 * point.y(), point.x() - camera.baseline) *
         (camera.f / point.z());
}

Eigen::Matrix3d image_jacobian(const RectifiedCamera& camera, const Eigen::Vector3d& point) {
  const double s = camera.f / point.z();
  const Eigen::Vector3d by_z = -image_coordinates(camera, point) / point.z();
  Eigen::Matrix3d jacobian;
  jacobian << s, 0, by_z.x(),                //
      0, std::numbers::sqrt2 * s, by_z.y(),  //
      s, 0, by_z.z();
  return jacobian;
}

ImageError image_error(const RectifiedCamera& camera, const Eigen::Vector3d& p, const Eigen::Vector3d& q,
                       const Pose& p_from_q, double pixel_error) {
  const Eigen::Vector3d seen_p = image_coordinates(camera, p), seen_q = image_coordinates(camera, q);
  const auto square_at = [&](const Eigen::Vector3d& v) {
    const Eigen::Vector3d v_in_p = p_from_q * v;
    if (v.z() <= 0 || v_in_p.z() <= 0) return std::numeric_limits<double>::infinity();
    return (image_coordinates(camera, v) - seen_q).squaredNorm() +
           (image_coordinates(camera, v_in_p) - seen_p).squaredNorm();
  };
  // Gauss-Newton from q; a step that makes it worse is halved.
  ImageError result{square_at(q), q};
  for (int iteration = 0; iteration < 20 && std::isfinite(result.square); ++iteration) {
    const Eigen::Vector3d v_in_p = p_from_q * result.best;
    const Eigen::Matrix3d jq = image_jacobian(camera, result.best);
    const Eigen::Matrix3d jp = image_jacobian(camera, v_in_p) * p_from_q.linear();
    const Eigen::Vector3d gradient = jq.transpose() * (image_coordinates(camera, result.best) - seen_q) +
                                     jp.transpose() * (image_coordinates(camera, v_in_p) - seen_p);
    Eigen::Vector3d step = (jq.transpose() * jq + jp.transpose() * jp).ldlt().solve(-gradient);
    const bool converged = step.squaredNorm() <= 1e-18 * result.best.squaredNorm();
    bool better = false;
    for (int halving = 0; halving < 8 && !better; ++halving, step /= 2) {
      const double square = square_at(result.best + step);
      if (square <= result.square) {
        result = {square, result.best + step};
        better = true;
      }
    }
    if (converged || !better) break;
  }
  result.square /= pixel_error * pixel_error;
  return result;
}

}  // namespace iris::reconstruct
