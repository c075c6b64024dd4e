// Semi-global matching, as OpenCV has it, for comparison with correlation and for scenes with little texture.
#pragma once

#include <opencv2/core.hpp>

namespace iris::stereo {

// Disparities [px] of the left image, 0 = none, to 1/16 px; searched from `min_disparity` on. Ambiguous and one-sided
// matches are dropped as OpenCV does it: second minimum less than 10 % above the first, left/right check with
// `left_right_tolerance` [px] (negative = off). `window`: odd side of the matched blocks. Values below `smallest` are
// set to it. One thread.
cv::Mat1f semi_global(const cv::Mat1b& left, const cv::Mat1b& right, int disparities, int min_disparity, int window,
                      double left_right_tolerance, float smallest);

}  // namespace iris::stereo
