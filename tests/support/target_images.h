// Exact images of flat calibration targets: rays are averaged over each pixel's area, then Gaussian noise is added
// (thesis figure 2.4).
#pragma once

#include <cmath>
#include <opencv2/aruco.hpp>
#include <opencv2/imgproc.hpp>
#include <random>
#include <vector>

#include "iris/calibrate/stereo.h"

namespace iris::testing {

// Grey value of the sheet at a point of its plane [m], origin in corner 0 of calibrate::target_points.
class Sheet {
 public:
  explicit Sheet(const calibrate::Target& target) : target_(target) {
    using calibrate::TargetKind;
    if (target.kind != TargetKind::charuco && target.kind != TargetKind::aprilgrid) return;
    const bool charuco = target.kind == TargetKind::charuco;
    const auto dictionary =
        cv::aruco::getPredefinedDictionary(charuco ? cv::aruco::DICT_4X4_50 : cv::aruco::DICT_APRILTAG_36h11);
    for (int id = 0; id < target.columns * target.rows; ++id) {
      if (charuco && id >= target.columns * target.rows / 2) break;
      cv::Mat marker;
      // One pixel a bit; Kalibr's tags have a border of two bits.
      dictionary->drawMarker(id, charuco ? 6 : 10, marker, charuco ? 1 : 2);
      markers_.push_back(marker);
    }
  }

  double grey(double x, double y) const {
    using calibrate::TargetKind;
    constexpr double kBlack = 30, kWhite = 230, kOutside = 120;
    const double s = target_.size, g = target_.gap;
    const int columns = target_.columns, rows = target_.rows;
    const auto beyond = [&](double x0, double y0, double x1, double y1, double margin) {
      return x < x0 - margin || y < y0 - margin || x > x1 + margin || y > y1 + margin;
    };
    switch (target_.kind) {
      case TargetKind::squares: {
        const double step = s + g;
        if (beyond(0, 0, columns * step - g, rows * step - g, g)) return kOutside;
        const int column = static_cast<int>(std::floor(x / step)), row = static_cast<int>(std::floor(y / step));
        const bool in =
            column >= 0 && row >= 0 && column < columns && row < rows && x - column * step < s && y - row * step < s;
        return in ? kBlack : kWhite;
      }
      case TargetKind::chessboard: {
        const int column = static_cast<int>(std::floor(x / s)), row = static_cast<int>(std::floor(y / s));
        if (beyond(-s, -s, columns * s, rows * s, s)) return kOutside;
        if (beyond(-s, -s, columns * s, rows * s, 0)) return kWhite;
        return (column + row) % 2 == 0 ? kBlack : kWhite;
      }
      case TargetKind::charuco: {
        const double u = x + s, v = y + s;  // from the outer corner
        if (beyond(-s, -s, (columns - 1) * s, (rows - 1) * s, s)) return kOutside;
        if (beyond(-s, -s, (columns - 1) * s, (rows - 1) * s, 0)) return kWhite;
        const int column = static_cast<int>(u / s), row = static_cast<int>(v / s);
        if ((column + row) % 2 == 0) return kBlack;
        const int id = (row * columns + column) / 2;
        const double gap = (s - target_.marker) / 2, bit = target_.marker / 6;
        const int i = static_cast<int>(std::floor((u - column * s - gap) / bit));
        const int j = static_cast<int>(std::floor((v - row * s - gap) / bit));
        if (i < 0 || j < 0 || i > 5 || j > 5) return kWhite;
        return markers_[static_cast<size_t>(id)](j, i) > 127 ? kWhite : kBlack;
      }
      case TargetKind::aprilgrid: {
        const double step = s + g, w = columns * step - g, h = rows * step - g;
        if (beyond(0, 0, w, h, 2 * g)) return kOutside;
        if (beyond(0, 0, w, h, g)) return kWhite;
        // The small squares in the gaps' crossings.
        const double column_at = (x + g) / step, row_at = (y + g) / step;
        const int column = static_cast<int>(std::floor(column_at)), row = static_cast<int>(std::floor(row_at));
        const double u = x - column * step, v = y - row * step;  // < 0 in the gap
        if (u < 0 && v < 0) return kBlack;
        if (u < 0 || v < 0 || column >= columns || row >= rows) return kWhite;
        const int id = (rows - 1 - row) * columns + column;
        const int i = std::min(9, static_cast<int>(u / s * 10)), j = std::min(9, static_cast<int>(v / s * 10));
        return markers_[static_cast<size_t>(id)](j, i) > 127 ? kWhite : kBlack;
      }
    }
    return 0;
  }

 private:
  calibrate::Target target_;
  std::vector<cv::Mat1b> markers_;
};

// Renders sheets for one camera; the rays of its pixels' corners are computed once.
class TargetRenderer {
 public:
  explicit TargetRenderer(const CameraModel& camera) : camera_(camera) {
    for (int y = 0; y <= camera.height; ++y) {
      for (int x = 0; x <= camera.width; ++x) rays_.push_back(camera.unproject({x - 0.5, y - 0.5}));
    }
  }

  // `snr` [dB]: 20 log10(255 / standard deviation of the noise); 0 = none. `blur` [px]: Gaussian, before the noise.
  cv::Mat1b render(const Sheet& sheet, const Pose& cam_from_sheet, double snr, unsigned seed, double blur = 0) const {
    const Eigen::Matrix3d rotation = cam_from_sheet.linear().transpose();
    const Eigen::Vector3d centre = -(rotation * cam_from_sheet.translation());
    cv::Mat1f image(camera_.height, camera_.width);
    for (int y = 0; y < camera_.height; ++y) {
      for (int x = 0; x < camera_.width; ++x) {
        const size_t at = static_cast<size_t>(y) * static_cast<size_t>(camera_.width + 1) + static_cast<size_t>(x);
        const size_t below = at + static_cast<size_t>(camera_.width) + 1;
        const auto grey = [&](double u, double v) {
          const Eigen::Vector3d ray = rotation * ((1 - v) * ((1 - u) * rays_[at] + u * rays_[at + 1]) +
                                                  v * ((1 - u) * rays_[below] + u * rays_[below + 1]));
          const double s = -centre.z() / ray.z();
          return sheet.grey(centre.x() + s * ray.x(), centre.y() + s * ray.y());
        };
        // Where the pixel's corners and middle agree, nothing runs through it. Elsewhere so many rays that borders are
        // exact to a hundredth of a pixel.
        const double first = grey(0, 0);
        if (grey(1, 0) == first && grey(0, 1) == first && grey(1, 1) == first && grey(0.5, 0.5) == first) {
          image(y, x) = static_cast<float>(first);
          continue;
        }
        constexpr int kRays = 24;  // in each direction
        double sum = 0;
        for (int j = 0; j < kRays; ++j) {
          for (int i = 0; i < kRays; ++i) sum += grey((i + 0.5) / kRays, (j + 0.5) / kRays);
        }
        image(y, x) = static_cast<float>(sum / (kRays * kRays));
      }
    }
    if (blur > 0) cv::GaussianBlur(image, image, {0, 0}, blur);
    cv::Mat1b out(image.size());
    std::mt19937 random(seed);
    std::normal_distribution<float> noise(0, snr > 0 ? static_cast<float>(255 / std::pow(10, snr / 20)) : 1e-6f);
    for (int y = 0; y < image.rows; ++y) {
      for (int x = 0; x < image.cols; ++x) out(y, x) = cv::saturate_cast<uchar>(image(y, x) + noise(random));
    }
    return out;
  }

 private:
  CameraModel camera_;
  std::vector<Eigen::Vector3d> rays_;
};

// A rig as real ones are: distorted lenses, unequal cameras, a slightly turned right one.
inline StereoCalibration target_rig(Distortion distortion = Distortion::radial_tangential) {
  StereoCalibration c;
  c.left.width = c.right.width = 640;
  c.left.height = c.right.height = 480;
  c.left.K << 521.3, 0, 325.2, 0, 519.8, 236.4, 0, 0, 1;
  c.right.K << 524.6, 0, 314.7, 0, 523.9, 244.1, 0, 0, 1;
  c.left.distortion = c.right.distortion = distortion;
  if (distortion == Distortion::equidistant) {
    c.left.coefficients = {-0.012, 0.006, -0.004, 0.001};
    c.right.coefficients = {-0.015, 0.009, -0.006, 0.002};
  } else {
    c.left.coefficients = {-0.21, 0.07, 0.0006, -0.0004, 0.0};
    c.right.coefficients = {-0.22, 0.08, -0.0003, 0.0005, 0.0};
  }
  c.right_from_left.linear() =
      (Eigen::AngleAxisd(0.012, Eigen::Vector3d::UnitX()) * Eigen::AngleAxisd(-0.018, Eigen::Vector3d::UnitY()) *
       Eigen::AngleAxisd(0.008, Eigen::Vector3d::UnitZ()))
          .toRotationMatrix();
  c.right_from_left.translation() = -(c.right_from_left.linear() * Eigen::Vector3d(0.098, 0.0015, -0.002));
  return c;
}

// Poses of the sheet in the left camera's frame: tilted to all sides, in all parts of the image, seen whole by both.
inline std::vector<Pose> target_poses(const calibrate::Target& target, const StereoCalibration& rig, int count,
                                      unsigned seed) {
  const std::vector<Eigen::Vector3d> points = calibrate::target_points(target);
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  double extent = 0;
  for (const Eigen::Vector3d& p : points) middle += p / static_cast<double>(points.size());
  for (const Eigen::Vector3d& p : points) extent = std::max(extent, (p - middle).norm());
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> uniform(-1, 1);
  std::vector<Pose> poses;
  while (static_cast<int>(poses.size()) < count) {
    const double direction = M_PI * (0.25 + 0.5 * static_cast<double>(poses.size()) + 0.2 * uniform(random));
    const double tilt = 0.45 + 0.2 * uniform(random);
    Pose pose = Pose::Identity();
    pose.linear() = (Eigen::AngleAxisd(tilt, Eigen::Vector3d(std::cos(direction), std::sin(direction), 0)) *
                     Eigen::AngleAxisd(0.25 * uniform(random), Eigen::Vector3d::UnitZ()))
                        .toRotationMatrix();
    const double z = extent * (3.1 + 0.8 * uniform(random));
    pose.translation() =
        Eigen::Vector3d(0.05 + 0.35 * z * uniform(random), 0.25 * z * uniform(random), z) - pose.linear() * middle;
    bool seen = true;
    for (const Eigen::Vector3d& p : points) {
      for (const bool left : {true, false}) {
        const Eigen::Vector3d q = left ? pose * p : rig.right_from_left * (pose * p);
        const Eigen::Vector2d pixel = (left ? rig.left : rig.right).project(q);
        seen = seen && pixel.x() > 12 && pixel.y() > 12 && pixel.x() < rig.left.width - 13 &&
               pixel.y() < rig.left.height - 13;
      }
    }
    if (seen) poses.push_back(pose);
  }
  return poses;
}

// What both cameras would measure, with Gaussian noise [px] on each coordinate. `places`: where the sheet's corners
// really are, if not where they should be.
inline std::vector<calibrate::TargetView> target_views(const calibrate::Target& target, const StereoCalibration& rig,
                                                       const std::vector<Pose>& poses, double noise, unsigned seed,
                                                       const std::vector<Eigen::Vector3d>& places = {}) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal(0, 1);
  std::vector<calibrate::TargetView> views;
  const std::vector<Eigen::Vector3d> points = places.empty() ? calibrate::target_points(target) : places;
  for (const Pose& pose : poses) {
    calibrate::TargetView view;
    view.name = "view " + std::to_string(views.size());
    view.left_blur = view.right_blur = 2;
    for (size_t i = 0; i < points.size(); ++i) {
      for (const bool left : {true, false}) {
        const Eigen::Vector3d q = left ? pose * points[i] : rig.right_from_left * (pose * points[i]);
        const Eigen::Vector2d pixel = (left ? rig.left : rig.right).project(q);
        calibrate::Corners& corners = left ? view.left : view.right;
        corners.ids.push_back(static_cast<int>(i));
        const double dx = normal(random), dy = normal(random);
        corners.points.push_back(pixel + noise * Eigen::Vector2d(dx, dy));
      }
    }
    views.push_back(std::move(view));
  }
  return views;
}

}  // namespace iris::testing
