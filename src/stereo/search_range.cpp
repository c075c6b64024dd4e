#include "iris/stereo/search_range.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "iris/core/error.h"

namespace iris::stereo {
namespace {

constexpr int kLargestRange = 512;  // [px]
constexpr double kSurface = 0.002;  // smallest surface that counts, as a fraction of a frame
// Part of the measured pixels that the range covers. The rest is what comes extremely near for a moment, and wrong
// matches, which spread over the whole search; both would double the work for every frame.
constexpr double kCovered = 0.997;

// Settings under which wrong matches are few although the search is wide; they do not depend on how the user wants the
// images to be compared afterwards.
MwmfOptions wide_search(const MwmfOptions& options, cv::Size half_size) {
  MwmfOptions wide;
  wide.min_disparity = options.min_disparity / 2;
  wide.disparities = std::max(8, std::min(kLargestRange / 2, half_size.width / 2));
  wide.interpolation = "off";
  wide.measure = "census_sad";
  wide.window_width = wide.window_height = 7;
  wide.log_sigma = 1;
  wide.difference_cap = 2;
  wide.min_margin = 0.16;
  wide.left_right_tolerance = 0;
  wide.borders = "off";
  wide.median = "off";
  wide.min_segment = std::max(1, static_cast<int>(std::lround(kSurface * half_size.area())));
  return wide;
}

}  // namespace

SearchRange estimate_search_range(const std::vector<StereoPair>& sample_pairs, const MwmfOptions& options) {
  SearchRange range;
  std::vector<int> histogram(2 * kLargestRange, 0);  // of disparities [px] above min_disparity
  for (const StereoPair& pair : sample_pairs) {
    cv::Mat1b left, right;
    cv::resize(pair.left, left, cv::Size(), 0.5, 0.5, cv::INTER_AREA);
    cv::resize(pair.right, right, cv::Size(), 0.5, 0.5, cv::INTER_AREA);
    const DisparityImage measured = mwmf(left, right, wide_search(options, left.size()));
    for (int y = 0; y < left.rows; ++y) {
      for (int x = 0; x < left.cols; ++x) {
        if (measured.origin(y, x) == static_cast<uint8_t>(DisparityOrigin::none)) continue;
        const int above = static_cast<int>(std::ceil(2 * measured.disparity(y, x))) - options.min_disparity;
        ++histogram[static_cast<size_t>(std::clamp(above, 0, 2 * kLargestRange - 1))];
        ++range.matches;
      }
    }
  }
  if (range.matches > 0) {
    const auto beyond_allowed = static_cast<int64_t>((1 - kCovered) * range.matches);
    int needed = 2 * kLargestRange - 1;
    for (int64_t beyond = histogram[static_cast<size_t>(needed)]; needed > 0 && beyond <= beyond_allowed;) {
      beyond += histogram[static_cast<size_t>(--needed)];
    }
    range.largest = static_cast<float>(options.min_disparity + needed);
    range.disparities = std::clamp(16 * ((needed + 2 + 15) / 16), 16, kLargestRange);
    int64_t beyond = 0;
    for (int d = range.disparities; d < 2 * kLargestRange; ++d) beyond += histogram[static_cast<size_t>(d)];
    range.beyond = static_cast<double>(beyond) / range.matches;
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
