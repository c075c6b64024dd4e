// Correlation of a rectified pair with multiple supporting windows (thesis 3.4.2), in 16-bit integers.
#pragma once

#include <cstdint>
#include <functional>
#include <opencv2/core.hpp>

#include "census.h"

namespace iris::stereo {

// One image of a pair as it is compared.
struct MatchImage {
  cv::Mat1b grey;  // filtered or not
  Census census;   // empty planes = compare grey values only
};

// What one pixel contributes to the cost of a window:
//   without census  min(|left - right|, cap)
//   with census     5 * (number of census bits that differ) + 2 * min(|left - right|, cap)
inline constexpr int kCensusWeight = 5, kGreyWeight = 2;

struct CorrelationParameters {
  int disparities = 0;    // candidates are min_disparity + 0 … disparities - 1
  int min_disparity = 0;  // [px]
  int window_width = 9;   // [px] odd
  int window_height = 7;  // [px] odd
  int cap = 255;          // [grey levels]
  int shift = 0;          // sums over a window are divided by 2^shift and truncated
};

// The largest cap for which one pixel's contribution fits into 8 bits and a cost (the sum over three windows) into 16.
// Negative if the windows are too large for any.
int largest_cap(int window_width, int window_height, bool census);

// The smallest shift for which costs (without census) fit into 8 bits, so that the search takes half the time; 0 if
// even a column of a window does not fit.
int shift_for_bytes(int window_width, int window_height, int cap);

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
Correlation correlate(const MatchImage& left, const MatchImage& right, const CorrelationParameters& parameters);

// The same without images of all: next(y0, rows) gets the rows from y0 on as soon as they are known, from several
// threads at once, each row one time. It may change them.
using CorrelationSink = std::function<void(int y0, Correlation& rows)>;
void correlate(const MatchImage& left, const MatchImage& right, const CorrelationParameters& parameters,
               const CorrelationSink& next);

}  // namespace iris::stereo
