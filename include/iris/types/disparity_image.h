#pragma once

#include <cstdint>
#include <opencv2/core.hpp>

namespace iris {

// Where a disparity comes from. The order matters: a consumer accepts everything up to a level.
enum class DisparityOrigin : uint8_t {
  none = 0,
  measured = 1,          // winner of the correlation that passed all filters
  corrected = 2,         // measured, moved by the border correction
  within_segment = 3,    // interpolated between measurements of one segment
  between_segments = 4,  // filled from the background across a gap
};

// disparity [px], CV_32F, 0 = none; origin: one DisparityOrigin a pixel. One image serves motion (measured), mapping
// (up to within_segment) and tours (everything).
struct DisparityImage {
  cv::Mat1f disparity;
  cv::Mat1b origin;

  // Disparity at a pixel if its origin is not beyond `up_to`, else 0.
  float at(int y, int x, DisparityOrigin up_to) const {
    return origin(y, x) <= static_cast<uint8_t>(up_to) ? disparity(y, x) : 0.0f;
  }
};

}  // namespace iris
