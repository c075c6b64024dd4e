#include "iris/geometry/stereo_calibration.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <cmath>
#include <numbers>

#include "iris/core/error.h"

namespace iris {
namespace {

void validate_camera(const CameraModel& camera, const char* side, const std::filesystem::path& file,
                     bool size_may_be_unknown) {
  const auto fail = [&](const std::string& problem, const std::string& remedy) {
    throw InputError(file, fmt::format("the {} camera {}", side, problem), remedy);
  };
  bool finite = camera.K.allFinite();
  for (const double c : camera.coefficients) finite = finite && std::isfinite(c);
  if (!finite)
    fail("has values that are no numbers (NaN or infinite)", "calibrate again: the calibration did not converge");
  if (camera.K(0, 0) <= 0 || camera.K(1, 1) <= 0) {
    fail(fmt::format("has focal lengths {} and {} px", camera.K(0, 0), camera.K(1, 1)),
         "both must be positive; check the order of the values");
  }
  if (camera.K(1, 0) != 0 || camera.K(2, 0) != 0 || camera.K(2, 1) != 0 || camera.K(2, 2) != 1) {
    fail("has a camera matrix that is not of the form [fx s cx; 0 fy cy; 0 0 1]",
         "check the order of its values: they are stored row by row");
  }
  const size_t count = camera.coefficients.size();
  const bool good_count = camera.distortion == Distortion::equidistant
                              ? count == 0 || count == 4
                              : count == 0 || count == 2 || count == 4 || count == 5 || count == 8;
  if (!good_count) {
    fail(fmt::format("has {} distortion coefficients", count),
         camera.distortion == Distortion::equidistant
             ? "the equidistant model has 4: k1 k2 k3 k4"
             : "the radial-tangential model has 4, 5 or 8: k1 k2 p1 p2 [k3 [k4 k5 k6]]");
  }
  const bool unknown = camera.width == 0 && camera.height == 0;
  if ((camera.width <= 0 || camera.height <= 0) && !(unknown && size_may_be_unknown)) {
    fail(fmt::format("has the image size {}x{}", camera.width, camera.height),
         "the size must be that of the recorded images");
  }
}

}  // namespace

Eigen::Matrix3d rect_from_left_rotation(const StereoCalibration& calibration) {
  const Eigen::Vector3d T_s = calibration.right_centre_in_left();
  Eigen::Matrix3d rotation;
  const Eigen::Vector3d e1 = T_s.normalized();
  const Eigen::Vector3d e2 = Eigen::Vector3d(-T_s.y(), T_s.x(), 0).normalized();
  rotation.row(0) = e1;
  rotation.row(1) = e2;
  rotation.row(2) = e1.cross(e2);
  return rotation;
}

double rectified_focal_length(const StereoCalibration& c) {
  return (c.left.K(0, 0) + c.left.K(1, 1) + c.right.K(0, 0) + c.right.K(1, 1)) / 4;
}

bool is_rectified(const StereoCalibration& c) {
  if (c.left.distorted() || c.right.distorted()) return false;
  const double f = c.left.K(0, 0);
  const auto same = [&](double a, double b) { return std::abs(a - b) <= 1e-9 * f; };
  if (!same(c.left.K(1, 1), f) || !same(c.right.K(0, 0), f) || !same(c.right.K(1, 1), f)) return false;
  if (!same(c.left.K(1, 2), c.right.K(1, 2)) || c.left.K(0, 1) != 0 || c.right.K(0, 1) != 0) return false;
  const Eigen::Vector3d& t = c.right_from_left.translation();
  return rotation_angle(c.right_from_left) < 1e-9 && std::hypot(t.y(), t.z()) <= 1e-9 * std::abs(t.x());
}

void validate(const StereoCalibration& c, const std::filesystem::path& file, bool size_may_be_unknown) {
  validate_camera(c.left, "left", file, size_may_be_unknown);
  validate_camera(c.right, "right", file, size_may_be_unknown);
  if (!c.right_from_left.matrix().allFinite() || !std::isfinite(c.disparity_offset)) {
    throw InputError(file, "the transform between the cameras has values that are no numbers (NaN or infinite)",
                     "calibrate again: the calibration did not converge");
  }
  const Eigen::Matrix3d R = c.right_from_left.linear();
  const double departure = (R.transpose() * R - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (departure > 1e-3 || R.determinant() < 0) {
    throw InputError(file,
                     fmt::format("the rotation between the cameras is no rotation (R'R differs from 1 by {:.2g}, "
                                 "determinant {:.3g})",
                                 departure, R.determinant()),
                     "check the nine values of R and their order (row by row)");
  }
  constexpr double kMaxAngle = 60 * std::numbers::pi / 180;
  if (rotation_angle(R) > kMaxAngle) {
    throw InputError(file,
                     fmt::format("the cameras look {:.0f} degrees apart", rotation_angle(R) * 180 / std::numbers::pi),
                     "a stereo pair looks in one direction; check which transform the file stores");
  }
  const Eigen::Vector3d centre = c.right_centre_in_left();
  if (centre.norm() < 1e-6) {
    throw InputError(file, fmt::format("the baseline is {:.3g} m", centre.norm()),
                     "the translation between the cameras must be given in metres and cannot be 0");
  }
  if (std::abs(centre.x()) < std::hypot(centre.y(), centre.z())) {
    throw InputError(
        file,
        fmt::format("the right camera stands at ({:.4g}, {:.4g}, {:.4g}) m in the left camera's frame: "
                    "not beside it",
                    centre.x(), centre.y(), centre.z()),
        "cameras above or behind each other are not supported; if they stand side by side, the transform is "
        "stored in another direction than this format defines");
  }
  if (centre.x() < 0) {
    throw InputError(
        file,
        fmt::format("the right camera stands {:.4g} m to the left of the left one (negative baseline)", -centre.x()),
        "left and right seem swapped, or the transform is stored in the opposite direction: "
        "P_right = R P_left + T has a negative first value of T");
  }
}

std::string to_text(const StereoCalibration& c) {
  std::string text;
  const auto camera = [&](const char* name, const CameraModel& model) {
    text += fmt::format("{} {}x{} {} K", name, model.width, model.height,
                        model.distortion == Distortion::equidistant ? "equidistant" : "radial_tangential");
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) text += fmt::format(" {:.17g}", model.K(i, j));
    }
    text += " D";
    for (const double k : model.coefficients) text += fmt::format(" {:.17g}", k);
    text += '\n';
  };
  camera("left", c.left);
  camera("right", c.right);
  text += "right_from_left";
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 4; ++j) text += fmt::format(" {:.17g}", c.right_from_left.matrix()(i, j));
  }
  return text + fmt::format("\nrectified {} disparity_offset {:.17g}\n", c.rectified, c.disparity_offset);
}

}  // namespace iris
