#include "iris/reconstruct/error_propagation.h"

#include <cmath>
#include <numbers>

namespace iris::reconstruct {

Eigen::Matrix<double, 3, 4> point_jacobian(const RectifiedCamera& camera, const Eigen::Vector3d& point) {
  const double t = camera.baseline;
  Eigen::Matrix<double, 3, 4> jacobian;
  jacobian << t - point.x(), 0, point.x(), 0,  //
      -point.y(), t / 2, point.y(), t / 2,     //
      -point.z(), 0, point.z(), 0;
  return jacobian * (point.z() / (camera.f * t));
}

Eigen::Matrix3d point_covariance(const RectifiedCamera& camera, const Eigen::Vector3d& point, double pixel_error) {
  const Eigen::Matrix<double, 3, 4> jacobian = point_jacobian(camera, point);
  return pixel_error * pixel_error * jacobian * jacobian.transpose();
}

Eigen::Vector3d coordinate_errors(const RectifiedCamera& camera, const Eigen::Vector3d& point, double pixel_error) {
  const double t = camera.baseline;
  const double scale = pixel_error * point.z() / (camera.f * t);
  return {scale * std::hypot(point.x(), point.x() - t), scale * std::sqrt(2 * point.y() * point.y() + t * t / 2),
          scale * std::numbers::sqrt2 * point.z()};
}

double range_error(const RectifiedCamera& camera, const Eigen::Vector3d& point, double pixel_error) {
  const double t = camera.baseline;
  const double square = point.squaredNorm();
  const double a = point.x() * t - square, b = point.y() * t;
  return pixel_error * point.z() / (std::sqrt(square) * camera.f * t) * std::sqrt(a * a + square * square + b * b / 2);
}

double approximate_range_error(const RectifiedCamera& camera, const Eigen::Vector3d& point, double pixel_error) {
  return pixel_error * std::numbers::sqrt2 * point.z() * point.norm() / (camera.f * camera.baseline);
}

double length_error(const RectifiedCamera& camera, const Eigen::Vector3d& p, const Eigen::Vector3d& q,
                    double pixel_error) {
  const double t = camera.baseline;
  const Eigen::Vector3d u = q - p;
  const double length = u.norm();
  if (length == 0) return 0;
  const double b = u.dot(q), a = t * u.x() - b;  // derivatives by q's x_left and x_right
  const double e = u.dot(p), d = t * u.x() - e;  // and by p's
  const double c = t * t * u.y() * u.y() / 2;    // y_left and y_right together
  return pixel_error / (length * camera.f * t) *
         std::sqrt(q.z() * q.z() * (a * a + b * b + c) + p.z() * p.z() * (d * d + e * e + c));
}

}  // namespace iris::reconstruct
