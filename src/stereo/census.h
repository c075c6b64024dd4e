// How the grey values around each pixel are ordered.
#pragma once

#include <array>
#include <opencv2/core.hpp>

namespace iris::stereo {

// Census transform in 5x5 windows: bit k % 8 of plane k / 8 tells whether the k-th neighbour (0 … 23, row by row from
// above, without the centre) is darker than the pixel. The image continues with its border pixels. Brightness and
// contrast of a camera do not change it.
using Census = std::array<cv::Mat1b, 3>;
Census census_transform(const cv::Mat1b& image);

// Rank transform: how many of the neighbours are darker, 0 … 24.
cv::Mat1b rank_transform(const Census& census);

}  // namespace iris::stereo
