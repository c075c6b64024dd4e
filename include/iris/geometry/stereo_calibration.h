// A calibrated stereo rig as recorded, before rectification.
#pragma once

#include <filesystem>
#include <string>

#include "iris/geometry/camera_model.h"
#include "iris/geometry/pose.h"

namespace iris {

// P_right = right_from_left * P_left [m], the convention of OpenCV and Kalibr. The thesis (2.2) writes
// P_r = R_s (P_l - T_s): R_s = right_from_left.linear(), T_s = right_centre_in_left().
struct StereoCalibration {
  CameraModel left, right;
  Pose right_from_left = Pose::Identity();
  bool rectified = false;       // the images come rectified: no distortion, no rotation, rows correspond
  double disparity_offset = 0;  // [px] added to measured disparities beyond what the two principal points say
  std::string source;           // file it was read from, for messages

  // Where the right camera stands, in the left camera's frame [m]: (baseline, ~0, ~0).
  Eigen::Vector3d right_centre_in_left() const { return right_from_left.inverse().translation(); }
};

// Turns directions of the left camera into those of the rectified cameras: rows e1, e2, e3 of (2.11-2.13). e1 points to
// the right camera, e2 is perpendicular to it and to the left optical axis.
Eigen::Matrix3d rect_from_left_rotation(const StereoCalibration& calibration);

// The common focal length of the rectified cameras [px]: the mean of the four of both cameras (thesis 2.4).
double rectified_focal_length(const StereoCalibration& calibration);

// True if the values themselves say that the images need no rectification: no distortion, equal square focal lengths,
// equal rows of the principal points, identity rotation, translation along x.
bool is_rectified(const StereoCalibration& calibration);

// Throws InputError that names `file` if the calibration cannot be one: numbers that are none, no focal length, a
// wrong count of coefficients, a rotation that is none, cameras that look apart, zero baseline, a right camera left of
// the left one, or (unless `size_may_be_unknown`: many formats do not store it) an image size of 0.
void validate(const StereoCalibration& calibration, const std::filesystem::path& file,
              bool size_may_be_unknown = false);

// All values as text with full precision, without `source`: equal texts compute the same.
std::string to_text(const StereoCalibration& calibration);

}  // namespace iris
