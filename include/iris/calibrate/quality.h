// How good a calibration is, and what is wrong with its images.
#pragma once

#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "iris/calibrate/stereo.h"

namespace iris::calibrate {

// Row of the right image minus row of the left one, after rectification (2.11-2.14), of every corner that both images
// of the view show [px].
std::vector<double> vertical_errors(const StereoCalibration& calibration, const TargetView& view);

// Vertical errors of pairs that the calibration was not made from: the pairs are split into parts, each part is
// rectified by a calibration from all others. NaN if too few pairs are left for that.
struct CrossValidation {
  double rms = 0, mean = 0;  // [px] root mean square, mean of the absolute values
  double worst_pair = 0;     // [px] largest RMS of a pair
  int pairs = 0, corners = 0;
};
CrossValidation cross_validate(const std::vector<TargetView>& views, const Target& target,
                               const StereoCalibrationResult& result, const CalibrateOptions& options);

// Standard deviations of measured depths, root mean square over the image [m].
struct DepthError {
  double depth = 0;        // [m]
  double calibration = 0;  // from the covariance of the calibration
  double matching = 0;     // from disparities with an error of sqrt(2) * pixel_error (4.21)
  double total() const;
};
// For depths of 1 to 10 m. `pixel_error`: of an image coordinate [px]; the thesis uses 0.1.
std::vector<DepthError> depth_errors(const StereoCalibrationResult& result, double pixel_error = 0.1);

// Number of corners in each cell of the image, `columns` x `rows` cells.
cv::Mat1i coverage(const std::vector<TargetView>& views, bool left, int width, int height, int columns, int rows);

// What to do better, in sentences, the gravest first. Empty: nothing to complain about.
std::vector<std::string> warnings(const std::vector<TargetView>& views, const Target& target,
                                  const StereoCalibrationResult& result, const CrossValidation& validation);

}  // namespace iris::calibrate
