// Reads images of a calibration target and finds the target in them.
#pragma once

#include <filesystem>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "iris/calibrate/stereo.h"
#include "iris/pipeline/pipeline.h"
#include "iris/session/session.h"

namespace iris::pipeline {

struct CalibrationImages {
  int width = 0, height = 0;                 // [px] of all images
  std::vector<calibrate::TargetView> views;  // of all pairs of images that can be read, found or not
  int unreadable = 0;                        // pairs of which an image is damaged; left out
  std::vector<std::string> notes;            // for people: what was assumed or dropped
  std::vector<std::string> hints;            // why too little was found, each with the number of images
};

// `images`: sessions in any layout that session::open_session knows (no calibration needed), or image files of both
// cameras with left and right in their names. Frames are read and searched in parallel; the result does not depend on
// it. A pair with a damaged image is left out, with a note that names the file. Throws InputError: nothing readable,
// images of different sizes, files without partner; Interrupted.
CalibrationImages read_calibration_images(const std::vector<std::filesystem::path>& images,
                                          const session::SessionOptions& options, const calibrate::Target& target,
                                          const RunControl& control);

}  // namespace iris::pipeline
