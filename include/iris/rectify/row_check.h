// Whether a calibration still fits a recording, told by the recording itself: corresponding points of rectified images
// must lie in one row. No target is needed.
#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>
#include <vector>

#include "iris/core/options.h"
#include "iris/geometry/stereo_calibration.h"
#include "iris/types/stereo_frame.h"

namespace iris::rectify {

struct RowCheckOptions {
  int frames = 30;            // frames looked at, spread over the recording
  int corners = 400;          // [per frame] at most so many are matched
  int rows = 12;              // [px] a partner is searched so far above and below the row
  double least_match = 0.85;  // normalised cross-correlation (window 15 x 15) that counts as a match
  double tolerance = 0.5;     // [px] RMS of the systematic vertical error up to which the calibration fits

  void declare(OptionSet& set);
};

// Corresponding points of the rectified images [px].
struct RowMatch {
  Eigen::Vector2d left, right;
  double error() const { return right.y() - left.y(); }
};

// Corners of the left image, found again in the right one within `rows` rows and a quarter of the width, and back.
std::vector<RowMatch> match_rows(const StereoPair& pair, const RowCheckOptions& options);

struct RowCheck {
  static constexpr int kColumns = 4, kRows = 3;
  int matches = 0;
  double median = 0;           // [px] right row - left row
  double median_absolute = 0;  // [px] with the errors of single matches
  double scatter = 0;          // [px] of single matches about the median of their cell (robust standard deviation)
  cv::Mat1d cells;             // [px] median in kColumns x kRows parts of the image; NaN = fewer than 10 matches
  double systematic = 0;       // [px] RMS of the cells' medians: what the calibration does wrong
  bool enough = false;         // matches in at least half of the cells
  bool fits = false;           // enough, and systematic <= tolerance
};
RowCheck check_rows(const std::vector<RowMatch>& matches, int width, int height, const RowCheckOptions& options);

// The turn of the right camera that brings the rows together. Its centre and both lenses stay as they are: what else is
// wrong with them remains. The turn about the vertical axis, which shifts all disparities, shows in the rows at the
// image's corners alone: it is taken to be smaller than about 0.1 degrees unless they say otherwise.
struct RotationRefinement {
  StereoCalibration calibration;
  Eigen::Vector3d turn = Eigen::Vector3d::Zero();   // [rad] about x, y, z of the right camera
  Eigen::Vector3d sigma = Eigen::Vector3d::Zero();  // [rad]
};
// `matches` are in images rectified by `calibration`.
RotationRefinement refine_rotation(const StereoCalibration& calibration, const std::vector<RowMatch>& matches);

}  // namespace iris::rectify
