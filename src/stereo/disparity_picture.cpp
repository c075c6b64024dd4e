#include "iris/stereo/disparity_picture.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "iris/core/error.h"

namespace iris::stereo {
namespace {

// The ends and some steps between of a scale whose lightness grows evenly (after "viridis"), RGB in [0, 255].
constexpr std::array<std::array<double, 3>, 9> kScale = {{{68, 1, 84},
                                                          {71, 44, 122},
                                                          {59, 81, 139},
                                                          {44, 113, 142},
                                                          {33, 144, 141},
                                                          {39, 173, 129},
                                                          {92, 200, 99},
                                                          {170, 220, 50},
                                                          {253, 231, 37}}};

}  // namespace

cv::Mat3b disparity_picture(const cv::Mat1f& disparity, double max) {
  IRIS_CHECK(max > 0);
  std::array<cv::Vec3b, 256> table;
  for (int i = 0; i < 256; ++i) {
    const double position = i / 255.0 * (kScale.size() - 1);
    const size_t low = std::min(static_cast<size_t>(position), kScale.size() - 2);
    for (int c = 0; c < 3; ++c) {
      const double value = kScale[low][c] + (position - low) * (kScale[low + 1][c] - kScale[low][c]);
      table[i][2 - c] = cv::saturate_cast<uchar>(value);
    }
  }
  cv::Mat3b picture(disparity.size(), cv::Vec3b(0, 0, 0));
  for (int y = 0; y < disparity.rows; ++y) {
    for (int x = 0; x < disparity.cols; ++x) {
      if (!(disparity(y, x) > 0)) continue;
      const double fraction = std::min(1.0, disparity(y, x) / max);
      picture(y, x) = table[static_cast<int>(std::lround(fraction * 255))];
    }
  }
  return picture;
}

}  // namespace iris::stereo
