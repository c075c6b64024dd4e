// Correlation of a rectified pair with multiple supporting windows (thesis 3.4.2), in 16-bit integers.
#pragma once

#include <cstdint>
#include <opencv2/core.hpp>

namespace iris::stereo {

struct CorrelationParameters {
  int disparities = 0;    // candidates are min_disparity + 0 … disparities - 1
  int min_disparity = 0;  // [px]
  int window_width = 9;   // [px] odd
  int window_height = 7;  // [px] odd
  int cap = 255;          // a pixel contributes min(|left - right|, cap); 3 * width * height * cap must be < 65535
};

// What the filters need to know about each pixel of the left image. Disparities are indices 0 … disparities - 1, costs
// are sums over three windows (the middle one and the two best of the four supporting ones, equation 3.1).
struct Correlation {
  static constexpr uint16_t kNone = 65535;
  cv::Mat1w winner;        // index of the lowest cost (the smallest such index); kNone if there was no candidate
  cv::Mat1w cost;          // its cost
  cv::Mat1w second;        // lowest cost that is no direct neighbour of the winner (3.4); kNone if there is none
  cv::Mat1w before;        // cost at winner - 1; kNone if outside of the search range or of the image
  cv::Mat1w after;         // cost at winner + 1
  cv::Mat1w right_winner;  // for each pixel of the right image: the same search in the other direction
};

// Windows that reach beyond the sides of either image are cut there and their sums scaled to the full area; a window
// whose centre is outside does not exist. Above and below, the images continue with their border rows.
Correlation correlate(const cv::Mat1b& left, const cv::Mat1b& right, const CorrelationParameters& parameters);

}  // namespace iris::stereo
