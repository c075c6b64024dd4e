// Calibration of a stereo rig from corners of a target (thesis 2.3): each camera alone by Zhang's method, then both
// cameras, the transform between them and all poses of the target together (2.8). A real target is neither flat nor
// exactly printed: where the images show it, the places of its corners are estimated along (not in the thesis).
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "iris/calibrate/detect.h"
#include "iris/calibrate/options.h"
#include "iris/calibrate/target.h"
#include "iris/geometry/pose.h"
#include "iris/geometry/stereo_calibration.h"

namespace iris::calibrate {

// The target as both cameras saw it at one moment. One side may be empty: the view then helps the other camera alone.
struct TargetView {
  std::string name;  // for messages: the left image
  Corners left, right;
  double left_blur = 0, right_blur = 0;  // [px] as in Detection
  bool is_pair() const { return !left.empty() && !right.empty(); }
};

struct ViewSelection {
  std::vector<TargetView> views;
  int unseen = 0, blurred = 0, duplicates = 0, surplus = 0;  // views left out, and why
};

// Leaves out views in which no camera sees the target, blurred ones, those that show the same as an earlier one, and
// of more than options.max_pairs those that differ least from the others.
ViewSelection select_views(std::vector<TargetView> views, const CalibrateOptions& options);

// One calibrated number.
struct Parameter {
  std::string name;             // "left fx"
  std::string unit;             // "px", "mm", "deg", "" for distortion
  double value = 0, sigma = 0;  // sigma: standard deviation from the covariance of (2.8)
};

// What makes a calibration, in this order: fx fy cx cy and the coefficients of the left camera, the same of the right
// one, rotation vector [rad] and translation [m] of right_from_left.
Eigen::VectorXd parameters_of(const StereoCalibration& calibration);
// The other way round. `like`: sizes and lens models.
StereoCalibration with_parameters(const StereoCalibration& like, const Eigen::VectorXd& parameters);

struct ViewErrors {
  double left_rms = 0, right_rms = 0;        // [px] of the distances between corner and projection; 0 = not seen
  std::vector<Eigen::Vector2d> left, right;  // [px] corner - projection, in the order of the view's corners
};

struct StereoCalibrationResult {
  enum class Status { ok, too_few_views, inconsistent, mirrored, no_fit };
  Status status = Status::ok;
  std::string problem, remedy;  // in words, unless ok

  StereoCalibration calibration;
  std::vector<Pose> left_from_grid;             // of each view
  std::vector<ViewErrors> errors;               // of each view
  double start_rms = 0;                         // [px] before (2.8): cameras calibrated alone, rig of one pair
  double rms = 0, left_rms = 0, right_rms = 0;  // [px] over all corners, afterwards
  std::vector<Eigen::Vector3d> sheet;           // [m] where the corners are on the sheet, by number
  double sheet_along = 0,
         sheet_across = 0;     // [m] RMS of how far that is beside target_points; 0 = the sheet is perfect
  double sigma = 0;            // [px] standard deviation of one coordinate of a corner
  Eigen::MatrixXd covariance;  // of parameters_of(calibration)
  std::vector<Parameter> parameters;
  int pairs = 0, left_views = 0, right_views = 0, corners = 0;
};

// All views' images have this size. Deterministic. `start`: begin with this calibration instead of Zhang's method (for
// cross-validation), if not null.
StereoCalibrationResult calibrate_stereo(const std::vector<TargetView>& views, const Target& target, int width,
                                         int height, const CalibrateOptions& options,
                                         const StereoCalibration* start = nullptr);

}  // namespace iris::calibrate
