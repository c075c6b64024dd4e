#include "iris/calibrate/quality.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>

#include "iris/core/error.h"

namespace iris::calibrate {
namespace {

using Vec = Eigen::Vector2d;
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kDegrees = 180 / std::numbers::pi;

// A recorded image point in the rectified image, relative to the principal point [px].
Vec rectified(const CameraModel& camera, const Eigen::Matrix3d& rect_from_cam, double f, const Vec& pixel) {
  const Eigen::Vector3d ray = rect_from_cam * camera.unproject(pixel);
  return f * ray.head<2>() / ray.z();
}

// Depth [m] that the calibration gives to a pair of recorded image points.
double depth_of(const StereoCalibration& c, const Vec& left, const Vec& right) {
  const Eigen::Matrix3d rect = rect_from_left_rotation(c);
  const double f = rectified_focal_length(c);
  const double disparity = rectified(c.left, rect, f, left).x() -
                           rectified(c.right, rect * c.right_from_left.linear().transpose(), f, right).x();
  return f * c.right_centre_in_left().norm() / disparity;
}

double rms_of(const std::vector<double>& values) {
  double sum = 0;
  for (const double v : values) sum += v * v;
  return values.empty() ? 0 : std::sqrt(sum / static_cast<double>(values.size()));
}

constexpr const char* kPlaces[3][3] = {{"upper left", "top", "upper right"},
                                       {"left side", "middle", "right side"},
                                       {"lower left", "bottom", "lower right"}};

// Names of the ninths of the image of which at least as large a share has no corners as of the whole image (so there
// is always one); a cell belongs to the ninth of its centre.
std::vector<std::string> weak_places(const cv::Mat1i& cells) {
  const auto ninth = [](int i, int count) { return (2 * i + 1) * 3 / (2 * count); };
  int size[3][3] = {}, empty[3][3] = {};
  for (int y = 0; y < cells.rows; ++y) {
    for (int x = 0; x < cells.cols; ++x) {
      ++size[ninth(y, cells.rows)][ninth(x, cells.cols)];
      empty[ninth(y, cells.rows)][ninth(x, cells.cols)] += cells(y, x) == 0;
    }
  }
  const int all = static_cast<int>(cells.total()), all_empty = all - cv::countNonZero(cells);
  std::vector<std::string> names;
  for (int y = 0; y < 3; ++y) {
    for (int x = 0; x < 3; ++x) {
      if (empty[y][x] * all >= all_empty * size[y][x]) names.push_back(kPlaces[y][x]);
    }
  }
  return names;
}

}  // namespace

double DepthError::total() const { return std::hypot(calibration, matching); }

std::vector<double> vertical_errors(const StereoCalibration& c, const TargetView& view) {
  std::map<int, Vec> right;
  for (size_t i = 0; i < view.right.size(); ++i) right[view.right.ids[i]] = view.right.points[i];
  const Eigen::Matrix3d rect = rect_from_left_rotation(c);
  const Eigen::Matrix3d rect_from_right = rect * c.right_from_left.linear().transpose();
  const double f = rectified_focal_length(c);
  std::vector<double> errors;
  for (size_t i = 0; i < view.left.size(); ++i) {
    const auto partner = right.find(view.left.ids[i]);
    if (partner == right.end()) continue;
    const double error = rectified(c.right, rect_from_right, f, partner->second).y() -
                         rectified(c.left, rect, f, view.left.points[i]).y();
    if (std::isfinite(error)) errors.push_back(error);
  }
  return errors;
}

CrossValidation cross_validate(const std::vector<TargetView>& views, const Target& target,
                               const StereoCalibrationResult& result, const CalibrateOptions& options) {
  CrossValidation validation{.rms = kNaN, .mean = kNaN, .worst_pair = kNaN};
  std::vector<size_t> pairs;
  for (size_t v = 0; v < views.size(); ++v) {
    if (views[v].is_pair()) pairs.push_back(v);
  }
  const int folds = std::min(options.folds, static_cast<int>(pairs.size()));
  std::vector<double> errors;
  double worst = 0;
  for (int fold = 0; fold < folds; ++fold) {
    std::vector<TargetView> used;
    std::vector<size_t> left_out;
    for (size_t v = 0, pair = 0; v < views.size(); ++v) {
      const bool out = views[v].is_pair() && static_cast<int>(pair++ % static_cast<size_t>(folds)) == fold;
      if (out) {
        left_out.push_back(v);
      } else {
        used.push_back(views[v]);
      }
    }
    const StereoCalibrationResult other = calibrate_stereo(
        used, target, result.calibration.left.width, result.calibration.left.height, options, &result.calibration);
    if (other.status != StereoCalibrationResult::Status::ok) continue;
    for (const size_t v : left_out) {
      const std::vector<double> pair = vertical_errors(other.calibration, views[v]);
      if (pair.empty()) continue;
      worst = std::max(worst, rms_of(pair));
      errors.insert(errors.end(), pair.begin(), pair.end());
      ++validation.pairs;
    }
  }
  if (errors.empty()) return validation;
  validation.corners = static_cast<int>(errors.size());
  validation.rms = rms_of(errors);
  validation.worst_pair = worst;
  validation.mean = 0;
  for (const double e : errors) validation.mean += std::abs(e) / static_cast<double>(errors.size());
  return validation;
}

std::vector<DepthError> depth_errors(const StereoCalibrationResult& result, double pixel_error) {
  const StereoCalibration& c = result.calibration;
  const Eigen::VectorXd values = parameters_of(c);
  const Eigen::Matrix3d rect = rect_from_left_rotation(c);
  const double f = rectified_focal_length(c), baseline = c.right_centre_in_left().norm();
  std::vector<DepthError> errors;
  for (int metres = 1; metres <= 10; ++metres) {
    const double z = metres;
    double by_calibration = 0;
    int count = 0;
    for (const double x : {-0.35, 0.0, 0.35}) {
      for (const double y : {-0.35, 0.0, 0.35}) {
        const Eigen::Vector3d in_rect(x * c.left.width / f * z, y * c.left.height / f * z, z);
        const Eigen::Vector3d in_left = rect.transpose() * in_rect;
        const Vec left = c.left.project(in_left), right = c.right.project(c.right_from_left * in_left);
        const bool seen = left.allFinite() && right.allFinite() && right.x() >= 0 && right.x() < c.right.width;
        if (!seen) continue;
        Eigen::VectorXd gradient(values.size());
        for (Eigen::Index i = 0; i < values.size(); ++i) {
          const double step = 0.1 * std::sqrt(result.covariance(i, i));
          Eigen::VectorXd up = values, down = values;
          up(i) += step;
          down(i) -= step;
          gradient(i) =
              (depth_of(with_parameters(c, up), left, right) - depth_of(with_parameters(c, down), left, right)) /
              (2 * step);
        }
        by_calibration += gradient.dot(result.covariance * gradient);
        ++count;
      }
    }
    errors.push_back({.depth = z,
                      .calibration = count == 0 ? kNaN : std::sqrt(std::max(0.0, by_calibration / count)),
                      .matching = pixel_error * std::numbers::sqrt2 * z * z / (f * baseline)});
  }
  return errors;
}

cv::Mat1i coverage(const std::vector<TargetView>& views, bool left, int width, int height, int columns, int rows) {
  cv::Mat1i counts(rows, columns, 0);
  for (const TargetView& view : views) {
    for (const Vec& p : (left ? view.left : view.right).points) {
      const int x = std::clamp(static_cast<int>((p.x() + 0.5) * columns / width), 0, columns - 1);
      const int y = std::clamp(static_cast<int>((p.y() + 0.5) * rows / height), 0, rows - 1);
      ++counts(y, x);
    }
  }
  return counts;
}

std::vector<std::string> warnings(const std::vector<TargetView>& views, const Target& target,
                                  const StereoCalibrationResult& result, const CrossValidation& validation) {
  std::vector<std::string> texts;
  const auto warn = [&](std::string text) { texts.push_back(std::move(text)); };
  if (result.pairs < 5) warn(fmt::format("only {} pairs: take at least 5, better 15", result.pairs));
  constexpr double kGoodRms = 0.5, kGoodRows = 0.2;  // [px]; the thesis reached 0.12 and 0.10 to 0.16
  if (result.rms > kGoodRms) {
    warn(
        fmt::format("the corners are {:.2f} px off (RMS): blurred or badly lit images, a target that is not flat, or "
                    "a lens model with too few coefficients",
                    result.rms));
  }
  if (validation.rms > kGoodRows) {
    warn(fmt::format("rows of unseen pairs differ by {:.2f} px after rectification: stereo wants less than {} px",
                     validation.rms, kGoodRows));
  }
  if (std::isnan(validation.rms))
    warn("there are too few pairs to test the calibration with pairs it was not made from");

  // The sheet's normal tells how it was tilted; z points away from the viewer.
  double left = 0, right = 0, up = 0, down = 0, near = 1e300, far = 0;
  const std::vector<Eigen::Vector3d> sheet = target_points(target);
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& p : sheet) middle += p / static_cast<double>(sheet.size());
  for (const Pose& pose : result.left_from_grid) {
    const Eigen::Vector3d normal = pose.linear().col(2);
    const double yaw = std::atan2(normal.x(), normal.z()), pitch = std::atan2(normal.y(), normal.z());
    left = std::max(left, yaw);  // its front then looks to the viewer's left
    right = std::max(right, -yaw);
    down = std::max(down, -pitch);
    up = std::max(up, pitch);
    const double z = (pose * middle).z();
    near = std::min(near, z);
    far = std::max(far, z);
  }
  constexpr double kTilt = 12 / kDegrees;
  std::vector<std::string> missing;
  for (const auto& [most, name] : {std::pair(left, "to the left"), std::pair(right, "to the right"),
                                   std::pair(up, "upwards"), std::pair(down, "downwards")}) {
    if (most < kTilt) missing.push_back(name);
  }
  if (!missing.empty()) {
    warn(
        fmt::format("no views of the target tilted {} (by more than {:.0f} degrees): focal lengths and principal "
                    "points are weak",
                    fmt::join(missing, ", "), kTilt * kDegrees));
  }
  if (far < 1.3 * near) {
    warn(fmt::format("all views are from about the same distance ({:.2f} to {:.2f} m): move nearer and farther", near,
                     far));
  }
  for (const bool is_left : {true, false}) {
    const CameraModel& camera = is_left ? result.calibration.left : result.calibration.right;
    const cv::Mat1i counts = coverage(views, is_left, camera.width, camera.height, 3, 3);
    std::vector<std::string> empty;
    for (int y = 0; y < 3; ++y) {
      for (int x = 0; x < 3; ++x) {
        if (counts(y, x) == 0) empty.push_back(kPlaces[y][x]);
      }
    }
    if (!empty.empty()) {
      warn(fmt::format("no corners in the {} of the {} image: its lens distortion is unknown there",
                       fmt::join(empty, ", "), is_left ? "left" : "right"));
    }
    // Finer: the cells that the report shows.
    const cv::Mat1i cells = coverage(views, is_left, camera.width, camera.height, 8, 6);
    const double covered = static_cast<double>(cv::countNonZero(cells)) / static_cast<double>(cells.total());
    constexpr double kCovered = 0.75;
    if (empty.empty() && covered < kCovered) {
      warn(
          fmt::format("corners cover {:.0f} % of the {} image only, too little in the {}: its lens distortion is a "
                      "guess there",
                      100 * covered, is_left ? "left" : "right", fmt::join(weak_places(cells), ", ")));
    }
    const size_t first = is_left ? 0 : 4 + camera.coefficients.size();
    const Parameter& focal = result.parameters[first];
    constexpr double kWeak = 0.005;
    if (focal.sigma > kWeak * focal.value) {
      warn(fmt::format("the focal length of the {} camera is known to {:.1f} % only: tilt the target more, come nearer",
                       is_left ? "left" : "right", 100 * focal.sigma / focal.value));
    }
  }
  std::vector<double> rms;
  for (const ViewErrors& view : result.errors) rms.push_back(std::max(view.left_rms, view.right_rms));
  std::vector<double> sorted = rms;
  std::sort(sorted.begin(), sorted.end());
  const double usual = sorted[sorted.size() / 2];
  for (size_t v = 0; v < rms.size(); ++v) {
    constexpr double kTimes = 3, kLeast = 0.3;
    if (rms[v] < kTimes * usual || rms[v] < kLeast) continue;
    warn(fmt::format(
        "{} fits badly ({:.2f} px, usual are {:.2f} px): a wrong corner, a target that moved between left and "
        "right image, or blur; leave it out and compare",
        views[v].name, rms[v], usual));
  }
  return texts;
}

}  // namespace iris::calibrate
