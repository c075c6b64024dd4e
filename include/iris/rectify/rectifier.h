// Rectification (thesis 2.4, equations 2.11-2.14): both images are resampled so that corresponding points lie in one
// row and the lens distortion is gone.
#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "iris/geometry/rectified_camera.h"
#include "iris/geometry/stereo_calibration.h"
#include "iris/types/stereo_frame.h"

namespace iris::rectify {

// The look-up tables are computed once; rectify() may then be called from many threads.
class Rectifier {
 public:
  // The calibration must be valid, sizes included and equal for both cameras (iris::validate).
  explicit Rectifier(const StereoCalibration& calibration);

  const RectifiedCamera& camera() const { return camera_; }

  // The recording comes rectified: images are handed on as they are, apart from the conversion to grey.
  bool passes_through() const { return passes_through_; }

  // Frame as recorded, of the calibration's size, CV_8UC1 or CV_8UC3. Bilinear; positions are rounded to 1/32 px (0.009
  // px standard deviation, a tenth of the best matching accuracy). What lies outside of the recorded image is 0.
  StereoPair rectify(const StereoFrame& frame) const;

  // Turns directions of the recorded left camera into those of the rectified left camera (identity if passes_through):
  // a pose of the recorded left camera is world_from_left = world_from_rect * rect_from_left.
  const Eigen::Matrix3d& rect_from_left() const { return rect_from_left_; }

  // Where a rectified pixel is looked up in the recorded image [px] (2.14). NaN if the camera cannot see there.
  Eigen::Vector2d left_source(const Eigen::Vector2d& rectified) const;
  Eigen::Vector2d right_source(const Eigen::Vector2d& rectified) const;

 private:
  StereoCalibration calibration_;
  RectifiedCamera camera_;
  bool passes_through_ = false;
  Eigen::Matrix3d rect_from_left_ = Eigen::Matrix3d::Identity();
  Eigen::Matrix3d rect_from_right_ = Eigen::Matrix3d::Identity();
  double max_left_angle_ = 0, max_right_angle_ = 0;  // [rad] beyond these the lens models fold back
  cv::Mat left_map_, left_map_fraction_, right_map_, right_map_fraction_;  // fixed-point tables of cv::remap
};

// Both images beside each other with horizontal lines through them, for the eye: a point and its partner must lie on
// one line. CV_8UC3.
cv::Mat rectified_pair_picture(const StereoPair& pair);

}  // namespace iris::rectify
