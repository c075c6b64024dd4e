// Disparities as a picture to look at.
#pragma once

#include <opencv2/core.hpp>

namespace iris::stereo {

// BGR: from dark blue (0) over green to yellow (`max` [px] and above), a scale of steadily growing brightness that
// colour- blind people can read as well; invalid (0) is black. Requires max > 0.
cv::Mat3b disparity_picture(const cv::Mat1f& disparity, double max);

}  // namespace iris::stereo
