// Medians of the finished disparities.
#pragma once

#include <opencv2/core.hpp>

#include "iris/types/disparity_image.h"

namespace iris::stereo {

// Median over 5x5 pixels, for those whose 5x5 neighbours are all valid (> 0) and inside of the image; others stay.
cv::Mat1f plain_median(const cv::Mat1f& disparity);

// What counts for the guided median of a pixel: pixels of its window whose row and column differ from its own by an
// even number in all (half of them), each with the weight guide_weight(difference of grey value, interpolated or not).
inline constexpr int kMedianRadius = 5;  // [px]
int guide_weight(int grey_difference, bool interpolated);

// Median guided by the left image: next to steps of disparity, where windows and interpolation leave ragged borders,
// pixels of similar grey value share a disparity. A pixel that has a step of more than 1 px between neighbours within
// kMedianRadius, and whose rounded disparity is more than 1 px away from the weighted median of the rounded ones
// around it, takes the disparity of the nearest pixel at the median. Its origin becomes corrected if it was measured
// and stays otherwise; pixels without disparity stay so.
void guided_median(const cv::Mat1b& left, DisparityImage& image);

}  // namespace iris::stereo
