// MWMF stereo: dense disparities from a rectified pair by correlation over multiple windows, with several filters that
// reject wrong matches (thesis chapter 3).
#pragma once

#include <opencv2/core.hpp>
#include <string>

#include "iris/core/options.h"
#include "iris/types/disparity_image.h"

namespace iris::stereo {

struct MwmfOptions {
  int disparities = 0;                       // [px] search range, 0 = found from the recording (estimate_search_range)
  int min_disparity = 0;                     // [px] start of the search range; negative if the cameras squint
  std::string interpolation = "everywhere";  // off | within | everywhere (3.4.5)

  std::string measure = "census";  // census | difference: census bits and grey values, or grey values alone (3.4.2)
  double log_sigma = 1.0;          // [px] Laplacian of Gaussian on the grey values (3.4.1); 0 = off
  double difference_cap = 2.0;     // [grey levels] most that one pixel's difference counts; 0 = no cap of its own
  int window_width = 7;            // [px] correlation window (3.4.2); odd (an even number is raised by one)
  int window_height = 7;           // [px]

  double min_margin = 0.02;           // [grey levels per window pixel] smallest margin of the winner (3.4); 0 = off
  double left_right_tolerance = 1.0;  // [px] largest difference between both search directions (3.4.1); < 0 = off
  int min_segment = 100;              // [px] smaller segments are errors (3.4.1); 0 = off
  double segment_tolerance = 1.0;     // [px] step of disparity that separates segments

  void declare(OptionSet& set);
};

// Disparities of the left image: x_right = x_left - disparity. Both images have the same size and corresponding rows.
// Requires options.disparities > 0. Independent of the number of threads and of the instruction set, bit for bit.
//
// origin says whether a disparity was measured or interpolated; none = 0. A point that is measured at disparity 0 or
// less (infinitely far, or beyond with a camera that squints) gets kSmallestDisparity, because 0 means none.
DisparityImage mwmf(const cv::Mat1b& left, const cv::Mat1b& right, const MwmfOptions& options);

inline constexpr float kSmallestDisparity = 1.0f / 16;  // [px]

}  // namespace iris::stereo
