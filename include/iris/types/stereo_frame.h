#pragma once

#include <cstdint>
#include <opencv2/core.hpp>

namespace iris {

// One recorded moment, as recorded: grey (CV_8UC1) or colour (CV_8UC3, BGR); 16-bit recordings are scaled to 8 by the
// reader.
struct StereoFrame {
  int frame_idx = 0;     // counts the paired frames of the session from 0
  int64_t stamp_ns = 0;  // time of the left image
  cv::Mat left, right;
};

// The same moment rectified: rows correspond, distortion is gone.
struct StereoPair {
  int frame_idx = 0;
  int64_t stamp_ns = 0;
  cv::Mat1b left, right;
  cv::Mat3b left_colour;  // BGR; empty if the recording is grey
};

}  // namespace iris
