#include "iris/stereo/search_range.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "iris/core/error.h"

namespace iris::stereo {
namespace {

constexpr int kLargestRange = 512;   // [px]
constexpr double kSurface = 0.001;   // smallest surface that counts, as a fraction of a frame
constexpr double kMarginFactor = 2;  // the search is wide, so that wrong matches are more likely than in mwmf itself

}  // namespace

SearchRange estimate_search_range(const std::vector<StereoPair>& sample_pairs, const MwmfOptions& options) {
  SearchRange range;
  for (const StereoPair& pair : sample_pairs) {
    cv::Mat1b left, right;
    cv::resize(pair.left, left, cv::Size(), 0.5, 0.5, cv::INTER_AREA);
    cv::resize(pair.right, right, cv::Size(), 0.5, 0.5, cv::INTER_AREA);
    MwmfOptions wide = options;
    wide.min_disparity = options.min_disparity / 2;
    wide.disparities = std::max(8, std::min(kLargestRange / 2, left.cols / 2));
    wide.interpolation = "off";
    wide.min_margin = kMarginFactor * options.min_margin;
    wide.min_segment = std::max(1, static_cast<int>(std::lround(kSurface * left.total())));
    const DisparityImage measured = mwmf(left, right, wide);
    range.matches += cv::countNonZero(measured.origin);
    double largest = 0;
    cv::minMaxLoc(measured.disparity, nullptr, &largest);
    range.largest = std::max(range.largest, static_cast<float>(2 * largest));
  }
  if (range.matches > 0) {
    const double needed = (range.largest - options.min_disparity) * 1.1 + 4;
    range.disparities = std::clamp(16 * static_cast<int>(std::ceil(needed / 16)), 16, kLargestRange);
  }
  return range;
}

double fraction_at_limit(const DisparityImage& disparity, const MwmfOptions& options) {
  const float limit = static_cast<float>(options.min_disparity + options.disparities - 1 - 2);
  int measured = 0, at_limit = 0;
  for (int y = 0; y < disparity.disparity.rows; ++y) {
    for (int x = 0; x < disparity.disparity.cols; ++x) {
      if (disparity.origin(y, x) != static_cast<uint8_t>(DisparityOrigin::measured)) continue;
      ++measured;
      at_limit += disparity.disparity(y, x) >= limit;
    }
  }
  return measured == 0 ? 0.0 : static_cast<double>(at_limit) / measured;
}

}  // namespace iris::stereo
