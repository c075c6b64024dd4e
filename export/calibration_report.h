// What a calibration is worth, as one web page with its pictures inside.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "iris/calibrate/quality.h"
#include "iris/calibrate/stereo.h"

namespace iris::exporters {

struct CalibrationReport {
  std::string target;                        // for people
  std::vector<calibrate::TargetView> views;  // those that were used
  calibrate::StereoCalibrationResult result;
  calibrate::CrossValidation validation;
  std::vector<calibrate::DepthError> depths;
  std::vector<std::string> warnings;
  std::string images;  // "14 of 20 pairs of images are used (…)"
};

// HTML that needs no other file and no network: errors, warnings, residuals and coverage of both images, parameters
// with their standard deviations, expected depth errors, errors of each view.
std::string calibration_report_html(const CalibrationReport& report);

// Whole or not at all (InputError).
void write_calibration_report(const std::filesystem::path& path, const CalibrationReport& report);

}  // namespace iris::exporters
