#include "iris/calibrate/calibration_writer.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cctype>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"

namespace iris::calibrate {
namespace {

namespace fs = std::filesystem;

std::string lower(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return std::tolower(c); });
  return text;
}

// Always with a point or an exponent: OpenCV's storage takes other numbers for whole ones.
std::string number(double value) {
  std::string text = fmt::format("{}", value);
  if (text.find_first_of(".en") == std::string::npos) text += ".";
  return text;
}

template <class Matrix>
std::string numbers(const Matrix& m) {
  std::string text;
  for (Eigen::Index row = 0; row < m.rows(); ++row) {
    for (Eigen::Index column = 0; column < m.cols(); ++column) {
      text += (text.empty() ? "" : ", ") + number(m(row, column));
    }
  }
  return text;
}

Eigen::VectorXd coefficients_of(const CameraModel& camera, size_t least) {
  Eigen::VectorXd values =
      Eigen::VectorXd::Zero(static_cast<Eigen::Index>(std::max(least, camera.coefficients.size())));
  std::copy(camera.coefficients.begin(), camera.coefficients.end(), values.data());
  return values;
}

bool fisheye(const StereoCalibration& c) { return c.left.distortion == Distortion::equidistant; }

struct Rectification {
  Eigen::Matrix3d left, right;                  // rectified from camera
  Eigen::Matrix<double, 3, 4> P_left, P_right;  // as this program rectifies (2.11-2.14)
};

Rectification rectification_of(const StereoCalibration& c) {
  Rectification r;
  r.left = rect_from_left_rotation(c);
  r.right = r.left * c.right_from_left.linear().transpose();
  const double f = rectified_focal_length(c);
  r.P_left << f, 0, (c.left.width - 1) / 2.0, 0, 0, f, (c.left.height - 1) / 2.0, 0, 0, 0, 1, 0;
  r.P_right = r.P_left;
  r.P_right(0, 3) = -f * c.right_centre_in_left().norm();
  return r;
}

std::string opencv_text(const StereoCalibration& c, const std::string& comment) {
  const auto matrix = [](const char* name, const auto& m) {
    return fmt::format("{}: !!opencv-matrix\n   rows: {}\n   cols: {}\n   dt: d\n   data: [ {} ]\n", name, m.rows(),
                       m.cols(), numbers(m));
  };
  std::string text = "%YAML:1.0\n---\n";
  if (!comment.empty()) text += "# " + comment + "\n";
  text += "# points of the left camera to the right one: P_right = R * P_left + T [m]; R1 R2 P1 P2: rectification\n";
  text += fmt::format("image_width: {}\nimage_height: {}\n", c.left.width, c.left.height);
  if (fisheye(c)) text += "distortion_model: fisheye\n";
  const Rectification r = rectification_of(c);
  const size_t least = fisheye(c) ? 4 : 5;
  text += matrix("M1", c.left.K) + matrix("D1", Eigen::MatrixXd(coefficients_of(c.left, least).transpose()));
  text += matrix("M2", c.right.K) + matrix("D2", Eigen::MatrixXd(coefficients_of(c.right, least).transpose()));
  text += matrix("R", Eigen::Matrix3d(c.right_from_left.linear())) +
          matrix("T", Eigen::Vector3d(c.right_from_left.translation()));
  text += matrix("R1", r.left) + matrix("R2", r.right) + matrix("P1", r.P_left) + matrix("P2", r.P_right);
  return text;
}

std::string kalibr_text(const StereoCalibration& c, const std::string& comment) {
  std::string text = comment.empty() ? "" : "# " + comment + "\n";
  for (const auto& [camera, name] : {std::pair(&c.left, "cam0"), std::pair(&c.right, "cam1")}) {
    text += fmt::format("{}:\n", name);
    if (camera == &c.right) {
      text += "  T_cn_cnm1:\n";
      for (int row = 0; row < 4; ++row) {
        text += "  - [" + numbers(Eigen::MatrixXd(c.right_from_left.matrix().row(row))) + "]\n";
      }
    }
    text += fmt::format(
        "  camera_model: pinhole\n  distortion_coeffs: [{}]\n  distortion_model: {}\n  intrinsics: [{}, {}, {}, {}]\n"
        "  resolution: [{}, {}]\n",
        numbers(coefficients_of(*camera, 4)), fisheye(c) ? "equidistant" : "radtan", number(camera->K(0, 0)),
        number(camera->K(1, 1)), number(camera->K(0, 2)), number(camera->K(1, 2)), camera->width, camera->height);
  }
  return text;
}

std::string ros_text(const CameraModel& camera, const char* name, const Eigen::Matrix3d& rect_from_cam,
                     const Eigen::Matrix<double, 3, 4>& P, const std::string& comment) {
  const bool is_fisheye = camera.distortion == Distortion::equidistant;
  const Eigen::VectorXd d = coefficients_of(camera, is_fisheye ? 4 : 5);
  const char* model = is_fisheye ? "equidistant" : d.size() == 8 ? "rational_polynomial" : "plumb_bob";
  const auto matrix = [](const char* key, const auto& m) {
    return fmt::format("{}:\n  rows: {}\n  cols: {}\n  data: [{}]\n", key, m.rows(), m.cols(), numbers(m));
  };
  return (comment.empty() ? "" : "# " + comment + "\n") +
         fmt::format("image_width: {}\nimage_height: {}\ncamera_name: {}\n", camera.width, camera.height, name) +
         matrix("camera_matrix", camera.K) + fmt::format("distortion_model: {}\n", model) +
         matrix("distortion_coefficients", Eigen::MatrixXd(d.transpose())) +
         matrix("rectification_matrix", rect_from_cam) + matrix("projection_matrix", P);
}

std::string sensor_text(const CameraModel& camera, const Pose& body_from_cam, const std::string& comment) {
  return fmt::format(
      "sensor_type: camera\n{}T_BS:\n  cols: 4\n  rows: 4\n  data: [{}]\nresolution: [{}, {}]\ncamera_model: pinhole\n"
      "intrinsics: [{}, {}, {}, {}]\ndistortion_model: {}\ndistortion_coefficients: [{}]\n",
      comment.empty() ? "" : "# " + comment + "\n", numbers(Eigen::Matrix4d(body_from_cam.matrix())), camera.width,
      camera.height, number(camera.K(0, 0)), number(camera.K(1, 1)), number(camera.K(0, 2)), number(camera.K(1, 2)),
      camera.distortion == Distortion::equidistant ? "equidistant" : "radial-tangential",
      numbers(coefficients_of(camera, 4)));
}

void require_four_coefficients(const StereoCalibration& c, const char* format) {
  for (const CameraModel* camera : {&c.left, &c.right}) {
    if (std::any_of(camera->coefficients.begin() +
                        static_cast<std::ptrdiff_t>(std::min<size_t>(4, camera->coefficients.size())),
                    camera->coefficients.end(), [](double k) { return k != 0; })) {
      throw UsageError(
          fmt::format("{} files hold four distortion coefficients, this calibration has {}; choose "
                      "--calibrate.distortion radtan4 or fisheye, or --format opencv or ros",
                      format, camera->coefficients.size()));
    }
  }
}

StereoCalibration with_four_coefficients(StereoCalibration c) {
  for (CameraModel* camera : {&c.left, &c.right}) {
    if (camera->coefficients.size() > 4) camera->coefficients.resize(4);
  }
  return c;
}

// x.yaml -> x_left.yaml and x_right.yaml; left.yaml -> left.yaml and right.yaml.
std::pair<fs::path, fs::path> ros_paths(const fs::path& path) {
  const std::string name = path.filename().string();
  for (const auto& [left, right] : {std::pair("left", "right"), std::pair("Left", "Right")}) {
    const size_t at = name.rfind(left);
    if (at == std::string::npos) continue;
    std::string other = name;
    other.replace(at, std::string(left).size(), right);
    return {path, path.parent_path() / other};
  }
  const std::string extension = path.has_extension() ? path.extension().string() : ".yaml";
  const std::string stem = path.stem().string();
  return {path.parent_path() / (stem + "_left" + extension), path.parent_path() / (stem + "_right" + extension)};
}

}  // namespace

FileFormat file_format(const std::string& name, const fs::path& path) {
  if (name == "opencv") return FileFormat::opencv;
  if (name == "kalibr") return FileFormat::kalibr;
  if (name == "ros") return FileFormat::ros;
  if (name == "euroc") return FileFormat::euroc;
  if (!name.empty()) {
    throw UsageError(fmt::format("'{}' is no format of calibrations; choose from opencv, kalibr, ros, euroc", name));
  }
  const std::string file = lower(path.filename().string());
  if (file.find("camchain") != std::string::npos) return FileFormat::kalibr;
  if (file.find("camera_info") != std::string::npos) return FileFormat::ros;
  if (file == "sensor.yaml" || path.extension().empty()) return FileFormat::euroc;
  const std::string extension = lower(path.extension().string());
  if (extension != ".yaml" && extension != ".yml") {
    throw UsageError(fmt::format("'{}': calibrations are written as .yaml or .yml", path.string()));
  }
  return FileFormat::opencv;
}

bool holds_k3(FileFormat format) { return format == FileFormat::opencv || format == FileFormat::ros; }

std::vector<fs::path> write_calibration(const fs::path& path, FileFormat format, const StereoCalibration& calibration,
                                        const std::string& comment) {
  IRIS_CHECK(calibration.left.distortion == calibration.right.distortion);
  IRIS_CHECK(calibration.left.K(0, 1) == 0 && calibration.right.K(0, 1) == 0);
  switch (format) {
    case FileFormat::opencv:
      write_file(path, opencv_text(calibration, comment));
      return {path};
    case FileFormat::kalibr:
      require_four_coefficients(calibration, "Kalibr");
      write_file(path, kalibr_text(with_four_coefficients(calibration), comment));
      return {path};
    case FileFormat::ros: {
      const auto [left, right] = ros_paths(path);
      const Rectification r = rectification_of(calibration);
      write_file(left, ros_text(calibration.left, "left", r.left, r.P_left, comment));
      write_file(right, ros_text(calibration.right, "right", r.right, r.P_right, comment));
      return {left, right};
    }
    case FileFormat::euroc: {
      require_four_coefficients(calibration, "EuRoC");
      const StereoCalibration c = with_four_coefficients(calibration);
      fs::path folder = path;
      if (folder.filename() == "sensor.yaml") folder = folder.parent_path().parent_path();
      const fs::path left = folder / "cam0" / "sensor.yaml", right = folder / "cam1" / "sensor.yaml";
      write_file(left, sensor_text(c.left, Pose::Identity(), comment));
      write_file(right, sensor_text(c.right, c.right_from_left.inverse(), comment));
      return {left, right};
    }
  }
  throw Bug("no such format");
}

}  // namespace iris::calibrate
