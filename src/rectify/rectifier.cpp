#include "iris/rectify/rectifier.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

namespace iris::rectify {
namespace {

// A^-1 p of (2.14), turned into the recorded camera, through its lens.
Eigen::Vector2d source(const RectifiedCamera& rectified, const Eigen::Matrix3d& rect_from_cam,
                       const CameraModel& camera, double max_angle, const Eigen::Vector2d& pixel) {
  const Eigen::Vector3d ray((pixel.x() - rectified.cx) / rectified.f, (pixel.y() - rectified.cy) / rectified.f, 1);
  const Eigen::Vector3d in_cam = rect_from_cam.transpose() * ray;
  if (std::atan2(in_cam.head<2>().norm(), in_cam.z()) > max_angle) return Eigen::Vector2d::Constant(std::nan(""));
  return camera.project(in_cam);
}

template <class Source>
void fill_tables(int width, int height, const Source& source_of, cv::Mat& map, cv::Mat& fraction) {
  cv::Mat2f positions(height, width);
  parallel_chunks(0, height, 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; ++x) {
        // Far outside instead of NaN; within what the table's 16 bits can hold.
        constexpr double kOutside = -16000, kLimit = 16000;
        Eigen::Vector2d position = source_of(Eigen::Vector2d(x, y));
        if (!position.allFinite()) position = {kOutside, kOutside};
        positions(y, x) = {static_cast<float>(std::clamp(position.x(), -kLimit, kLimit)),
                           static_cast<float>(std::clamp(position.y(), -kLimit, kLimit))};
      }
    }
  });
  cv::convertMaps(positions, cv::noArray(), map, fraction, CV_16SC2);
}

cv::Mat1b grey_of(const cv::Mat& image) {
  if (image.channels() == 1) return image;
  cv::Mat1b grey;
  cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);
  return grey;
}

}  // namespace

Rectifier::Rectifier(const StereoCalibration& calibration)
    : calibration_(calibration),
      passes_through_(calibration.rectified),
      max_left_angle_(calibration.left.max_angle()),
      max_right_angle_(calibration.right.max_angle()) {
  const CameraModel &left = calibration.left, &right = calibration.right;
  IRIS_CHECK(left.width > 0 && left.height > 0 && left.width == right.width && left.height == right.height);
  camera_.width = left.width;
  camera_.height = left.height;
  camera_.disparity_offset = calibration.disparity_offset;
  if (passes_through_) {
    camera_.f = left.K(0, 0);
    camera_.cx = left.K(0, 2);
    camera_.cy = left.K(1, 2);
    camera_.baseline = calibration.right_centre_in_left().x();
    camera_.disparity_offset += right.K(0, 2) - left.K(0, 2);
    return;
  }
  camera_.f = rectified_focal_length(calibration);
  camera_.cx = (camera_.width - 1) / 2.0;
  camera_.cy = (camera_.height - 1) / 2.0;
  camera_.baseline = calibration.right_centre_in_left().norm();
  rect_from_left_ = rect_from_left_rotation(calibration);
  rect_from_right_ = rect_from_left_ * calibration.right_from_left.linear().transpose();
  fill_tables(
      camera_.width, camera_.height, [&](const Eigen::Vector2d& p) { return left_source(p); }, left_map_,
      left_map_fraction_);
  fill_tables(
      camera_.width, camera_.height, [&](const Eigen::Vector2d& p) { return right_source(p); }, right_map_,
      right_map_fraction_);
}

Eigen::Vector2d Rectifier::left_source(const Eigen::Vector2d& rectified) const {
  if (passes_through_) return rectified;
  return source(camera_, rect_from_left_, calibration_.left, max_left_angle_, rectified);
}

Eigen::Vector2d Rectifier::right_source(const Eigen::Vector2d& rectified) const {
  if (passes_through_) return rectified;
  return source(camera_, rect_from_right_, calibration_.right, max_right_angle_, rectified);
}

StereoPair Rectifier::rectify(const StereoFrame& frame) const {
  for (const cv::Mat* image : {&frame.left, &frame.right}) {
    IRIS_CHECK(image->type() == CV_8UC1 || image->type() == CV_8UC3);
    IRIS_CHECK(image->cols == camera_.width && image->rows == camera_.height);
  }
  StereoPair pair;
  pair.frame_idx = frame.frame_idx;
  pair.stamp_ns = frame.stamp_ns;
  const auto remapped = [&](const cv::Mat& image, const cv::Mat& map, const cv::Mat& fraction) {
    if (passes_through_) return image;
    cv::Mat result;
    cv::remap(image, result, map, fraction, cv::INTER_LINEAR, cv::BORDER_CONSTANT, cv::Scalar::all(0));
    return result;
  };
  pair.left = remapped(grey_of(frame.left), left_map_, left_map_fraction_);
  pair.right = remapped(grey_of(frame.right), right_map_, right_map_fraction_);
  if (frame.left.channels() == 3) pair.left_colour = remapped(frame.left, left_map_, left_map_fraction_);
  return pair;
}

cv::Mat rectified_pair_picture(const StereoPair& pair) {
  cv::Mat left = pair.left_colour, right;
  if (left.empty()) cv::cvtColor(pair.left, left, cv::COLOR_GRAY2BGR);
  cv::cvtColor(pair.right, right, cv::COLOR_GRAY2BGR);
  cv::Mat picture;
  cv::hconcat(left, right, picture);
  const int spacing = std::max(8, picture.rows / 20);
  for (int y = spacing / 2, line = 0; y < picture.rows; y += spacing, ++line) {
    const cv::Scalar colour = line % 2 == 0 ? cv::Scalar(0, 220, 0) : cv::Scalar(0, 160, 255);
    cv::line(picture, {0, y}, {picture.cols - 1, y}, colour, 1);
  }
  return picture;
}

}  // namespace iris::rectify
