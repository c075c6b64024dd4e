#include "iris/geometry/camera_model.h"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

#include "iris/core/error.h"

namespace iris {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// All eight coefficients, absent ones 0: k1 k2 p1 p2 k3 k4 k5 k6.
std::array<double, 8> padded(const std::vector<double>& coefficients) {
  std::array<double, 8> k{};
  IRIS_CHECK(coefficients.size() <= k.size());
  std::copy(coefficients.begin(), coefficients.end(), k.begin());
  return k;
}

// Distorted normalised coordinates and their derivative by the undistorted ones.
struct RadialTangential {
  std::array<double, 8> k;

  Eigen::Vector2d apply(const Eigen::Vector2d& u, Eigen::Matrix2d* derivative) const {
    const auto [k1, k2, p1, p2, k3, k4, k5, k6] = k;
    const double x = u.x(), y = u.y(), r2 = u.squaredNorm();
    const double above = 1 + r2 * (k1 + r2 * (k2 + r2 * k3));
    const double below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6));
    const double radial = above / below;
    if (derivative) {
      const double above_by_r2 = k1 + r2 * (2 * k2 + 3 * r2 * k3);
      const double below_by_r2 = k4 + r2 * (2 * k5 + 3 * r2 * k6);
      const double by_r2 = (above_by_r2 * below - above * below_by_r2) / (below * below);
      const double mixed = 2 * x * y * by_r2 + 2 * p1 * x + 2 * p2 * y;
      *derivative << radial + 2 * x * x * by_r2 + 2 * p1 * y + 6 * p2 * x, mixed,  //
          mixed, radial + 2 * y * y * by_r2 + 6 * p1 * y + 2 * p2 * x;
    }
    return {x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y};
  }
};

double equidistant_radius(const std::array<double, 8>& k, double theta) {
  const double t2 = theta * theta;
  return theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))));
}

double equidistant_slope(const std::array<double, 8>& k, double theta) {
  const double t2 = theta * theta;
  return 1 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])));
}

// True if `radius_of` grows at samples all the way from 0 to `end`: a solution found at `end` is then the inner one.
template <class RadiusOf>
bool grows_up_to(double end, const RadiusOf& radius_of) {
  constexpr int kSamples = 32;
  double previous = 0;
  for (int i = 1; i <= kSamples; ++i) {
    const double radius = radius_of(end * i / kSamples);
    if (!(radius > previous)) return false;
    previous = radius;
  }
  return true;
}

std::array<double, 8> radial_part(std::array<double, 8> k) {
  k[2] = k[3] = 0;
  return k;
}

Eigen::Vector2d to_pixel(const Eigen::Matrix3d& K, const Eigen::Vector2d& distorted) {
  return {K(0, 0) * distorted.x() + K(0, 1) * distorted.y() + K(0, 2), K(1, 1) * distorted.y() + K(1, 2)};
}

}  // namespace

bool CameraModel::distorted() const {
  return distortion == Distortion::equidistant ||
         std::any_of(coefficients.begin(), coefficients.end(), [](double c) { return c != 0; });
}

Eigen::Vector2d CameraModel::project(const Eigen::Vector3d& point_in_cam) const {
  const std::array<double, 8> k = padded(coefficients);
  if (distortion == Distortion::equidistant) {
    const double r = point_in_cam.head<2>().norm();
    if (r == 0) return point_in_cam.z() > 0 ? to_pixel(K, {0, 0}) : Eigen::Vector2d(kNaN, kNaN);
    const double theta = std::atan2(r, point_in_cam.z());
    return to_pixel(K, point_in_cam.head<2>() * (equidistant_radius(k, theta) / r));
  }
  if (!(point_in_cam.z() > 0)) return {kNaN, kNaN};
  return to_pixel(K, RadialTangential{k}.apply(point_in_cam.head<2>() / point_in_cam.z(), nullptr));
}

Eigen::Vector3d CameraModel::unproject(const Eigen::Vector2d& pixel) const {
  const std::array<double, 8> k = padded(coefficients);
  const double y = (pixel.y() - K(1, 2)) / K(1, 1);
  const Eigen::Vector2d target((pixel.x() - K(0, 2) - K(0, 1) * y) / K(0, 0), y);
  constexpr int kIterations = 50;
  constexpr double kConverged = 1e-13;
  if (distortion == Distortion::equidistant) {
    const double r = target.norm();
    if (r == 0) return Eigen::Vector3d::UnitZ();
    double theta = r;
    for (int i = 0; i < kIterations; ++i) {
      const double step = (equidistant_radius(k, theta) - r) / equidistant_slope(k, theta);
      theta = std::clamp(theta - step, 0.0, std::numbers::pi);
      if (std::abs(step) < kConverged) break;
    }
    const bool inner = grows_up_to(theta, [&](double angle) { return equidistant_radius(k, angle); });
    if (!(std::abs(equidistant_radius(k, theta) - r) < 1e-9) || !inner) return {kNaN, kNaN, kNaN};
    return {std::sin(theta) * target.x() / r, std::sin(theta) * target.y() / r, std::cos(theta)};
  }
  const RadialTangential lens{k};
  Eigen::Vector2d u = target;
  Eigen::Matrix2d derivative;
  Eigen::Vector2d residual = lens.apply(u, &derivative) - target;
  for (int i = 0; i < kIterations && residual.norm() > kConverged; ++i) {
    // Newton with halved steps: a full step may leave the part of the plane where the model can be inverted.
    const Eigen::Vector2d step = derivative.inverse() * residual;
    double scale = 1;
    Eigen::Vector2d next = u - step;
    while (scale > 1e-6 && !((lens.apply(next, nullptr) - target).norm() < residual.norm())) {
      scale /= 2;
      next = u - scale * step;
    }
    if (scale <= 1e-6) break;
    u = next;
    residual = lens.apply(u, &derivative) - target;
  }
  const RadialTangential radial{radial_part(k)};
  const bool inner = u.norm() == 0 || grows_up_to(u.norm(), [&](double r) {
                       return radial.apply({r, 0}, nullptr).x();
                     });
  if (!(residual.norm() < 1e-9) || !inner) return {kNaN, kNaN, kNaN};
  return Eigen::Vector3d(u.x(), u.y(), 1).normalized();
}

double CameraModel::max_angle() const {
  const std::array<double, 8> k = padded(coefficients);
  constexpr int kSteps = 2000;
  if (distortion == Distortion::equidistant) {
    for (int i = 1; i <= kSteps; ++i) {
      const double theta = std::numbers::pi * i / kSteps;
      if (equidistant_slope(k, theta) <= 0) return std::numbers::pi * (i - 1) / kSteps;
    }
    return std::numbers::pi;
  }
  // Steps of equal angle up to just below a right angle. Rational models turn where their denominator changes sign,
  // too.
  const RadialTangential radial{radial_part(k)};
  const double end = std::numbers::pi / 2;
  double previous = 0;
  for (int i = 1; i < kSteps; ++i) {
    const double r = std::tan(end * i / kSteps);
    const double distorted_radius = radial.apply({r, 0}, nullptr).x();
    if (!(distorted_radius > previous)) return end * (i - 1) / kSteps;
    previous = distorted_radius;
  }
  return end;
}

}  // namespace iris
