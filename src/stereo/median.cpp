#include "median.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

namespace iris::stereo {
namespace {

constexpr int kRowsPerChunk = 16;
constexpr int kBins = 1024;  // [px]
constexpr int kStep = 1;     // [px] smaller differences are left to the sub-pixel fit
constexpr double kGreyScale = 12;
constexpr int kMeasuredWeight = 100, kInterpolatedWeight = 60;

struct Weights {
  std::array<uint16_t, 256> measured, interpolated;
  Weights() {
    for (int i = 0; i < 256; ++i) {
      measured[i] = static_cast<uint16_t>(guide_weight(i, false));
      interpolated[i] = static_cast<uint16_t>(guide_weight(i, true));
    }
  }
};

// 255 where a step between neighbours is within kMedianRadius along both axes.
cv::Mat1b near_steps(const cv::Mat1f& disparity) {
  cv::Mat1b steps(disparity.size(), uchar{0});
  for (int y = 0; y < disparity.rows; ++y) {
    for (int x = 0; x < disparity.cols; ++x) {
      const float d = disparity(y, x);
      if (!(d > 0)) continue;
      const auto mark = [&](int v, int u) {
        if (disparity(v, u) > 0 && std::abs(disparity(v, u) - d) > kStep) steps(y, x) = steps(v, u) = 255;
      };
      if (x > 0) mark(y, x - 1);
      if (y > 0) mark(y - 1, x);
    }
  }
  cv::Mat1b near;
  cv::dilate(steps, near, cv::Mat1b(2 * kMedianRadius + 1, 2 * kMedianRadius + 1, uchar{1}));
  return near;
}

}  // namespace

int guide_weight(int grey_difference, bool interpolated) {
  return static_cast<int>(
      std::lround((interpolated ? kInterpolatedWeight : kMeasuredWeight) * std::exp(-grey_difference / kGreyScale)));
}

cv::Mat1f plain_median(const cv::Mat1f& disparity) {
  cv::Mat1f median, out = disparity.clone();
  cv::medianBlur(disparity, median, 5);
  cv::Mat1b whole = disparity > 0;
  cv::erode(whole, whole, cv::Mat1b(5, 5, uchar{1}), cv::Point(-1, -1), 1, cv::BORDER_CONSTANT, cv::Scalar(0));
  median.copyTo(out, whole);
  return out;
}

DisparityImage guided_median(const cv::Mat1b& left, const DisparityImage& image) {
  IRIS_CHECK(left.size() == image.disparity.size());
  static const Weights weights;
  const cv::Mat1f& disparity = image.disparity;
  const cv::Mat1b near = near_steps(disparity);
  cv::Mat1s bins(disparity.size());
  DisparityImage out{disparity.clone(), image.origin.clone()};
  parallel_chunks(0, disparity.rows, kRowsPerChunk, [&](int y0, int y1) {
    for (int y = y0; y < y1; ++y) {
      for (int x = 0; x < disparity.cols; ++x) {
        bins(y, x) = static_cast<int16_t>(
            disparity(y, x) > 0 ? std::min(kBins - 1, static_cast<int>(std::lround(disparity(y, x)))) : -1);
      }
    }
  });
  parallel_chunks(0, disparity.rows, kRowsPerChunk, [&](int y0, int y1) {
    std::vector<int> histogram(kBins, 0);
    for (int y = y0; y < y1; ++y) {
      const int top = std::max(0, y - kMedianRadius), bottom = std::min(disparity.rows - 1, y + kMedianRadius);
      for (int x = 0; x < disparity.cols; ++x) {
        if (near(y, x) == 0 || bins(y, x) < 0) continue;
        const int grey = left(y, x);
        const int begin = std::max(0, x - kMedianRadius), end = std::min(disparity.cols - 1, x + kMedianRadius);
        int low = kBins, high = 0, total = 0;
        for (int v = top; v <= bottom; ++v) {
          const int16_t* const bin = bins[v];
          const uint8_t* const origin = image.origin[v];
          const uint8_t* const greys = left[v];
          for (int u = begin + ((begin + v + x + y) & 1); u <= end; u += 2) {
            if (bin[u] < 0) continue;
            const bool measured = origin[u] <= static_cast<uint8_t>(DisparityOrigin::corrected);
            const int weight = (measured ? weights.measured : weights.interpolated)[std::abs(greys[u] - grey)];
            histogram[bin[u]] += weight;
            total += weight;
            low = std::min<int>(low, bin[u]);
            high = std::max<int>(high, bin[u]);
          }
        }
        int median = low;
        for (int sum = histogram[low]; 2 * sum < total;) sum += histogram[++median];
        std::fill(histogram.begin() + low, histogram.begin() + high + 1, 0);
        if (std::abs(static_cast<float>(median) - disparity(y, x)) <= kStep) continue;
        int nearest = 4 * kMedianRadius;
        for (int v = top; v <= bottom; ++v) {
          for (int u = begin + ((begin + v + x + y) & 1); u <= end; u += 2) {
            const int distance = std::abs(u - x) + std::abs(v - y);
            if (bins(v, u) != median || distance >= nearest) continue;
            nearest = distance;
            out.disparity(y, x) = disparity(v, u);
          }
        }
        if (image.origin(y, x) == static_cast<uint8_t>(DisparityOrigin::measured)) {
          out.origin(y, x) = static_cast<uint8_t>(DisparityOrigin::corrected);
        }
      }
    }
  });
  return out;
}

}  // namespace iris::stereo
