#include "semi_global.h"

#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>

#include "iris/core/error.h"

namespace iris::stereo {

cv::Mat1f semi_global(const cv::Mat1b& left, const cv::Mat1b& right, int disparities, int min_disparity, int window,
                      double left_right_tolerance, float smallest) {
  IRIS_CHECK(disparities > 0 && window % 2 == 1 && left.size() == right.size());
  constexpr int kUnits = 16;                       // of OpenCV's disparities per pixel
  const int range = (disparities + 15) / 16 * 16;  // a multiple of 16 is wanted
  // OpenCV gives no disparities to a strip of the range's width at the left: the images are widened by their border.
  const int room = std::max(0, min_disparity + range);
  cv::Mat1b wide_left, wide_right;
  cv::copyMakeBorder(left, wide_left, 0, 0, room, 0, cv::BORDER_REPLICATE);
  cv::copyMakeBorder(right, wide_right, 0, 0, room, 0, cv::BORDER_REPLICATE);
  const int area = window * window;
  const int tolerance = left_right_tolerance < 0 ? -1 : static_cast<int>(std::lround(left_right_tolerance));
  const auto matcher = cv::StereoSGBM::create(min_disparity, range, window, 8 * area, 32 * area, tolerance, 63, 10, 0,
                                              0, cv::StereoSGBM::MODE_SGBM);
  cv::Mat1s coded;
  matcher->compute(wide_left, wide_right, coded);
  cv::Mat1f disparity(left.size());
  for (int y = 0; y < left.rows; ++y) {
    for (int x = 0; x < left.cols; ++x) {
      const int code = coded(y, x + room);
      // The partner must lie in the image, not in the border that was put before it.
      const bool valid =
          code >= min_disparity * kUnits && code < (min_disparity + disparities) * kUnits && x * kUnits - code >= 0;
      disparity(y, x) = valid ? std::max(static_cast<float>(code) / kUnits, smallest) : 0.0f;
    }
  }
  return disparity;
}

}  // namespace iris::stereo
