#include "median.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

#ifndef IRIS_STEREO_MEDIAN_CONSTANTS
#define IRIS_STEREO_MEDIAN_CONSTANTS
namespace iris::stereo {

inline constexpr int kTile = 32;       // columns worked on together
inline constexpr int kStep = 1;        // [px] smaller differences are left to the sub-pixel fit
inline constexpr int kGreyReach = 32;  // [grey levels]

}  // namespace iris::stereo
#endif  // IRIS_STEREO_MEDIAN_CONSTANTS

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "../src/stereo/median.cpp"  // seen from include/
#include <hwy/foreach_target.h>                        // IWYU pragma: keep
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace iris::stereo::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// For kTile pixels: the weight of the pixels around each whose (rounded) disparity is within kStep of its own, minus
// the weight of all others. Positive: the median is one of these. The pointers are those of the upper left corner of
// the first pixel's window.
void majorities(const int16_t* bin, const int16_t* grey, const int16_t* factor, ptrdiff_t stride, int16_t* out) {
  const hn::CappedTag<int16_t, kTile> d;
  const auto reach = hn::Set(d, int16_t{kGreyReach}), beyond = hn::Set(d, int16_t{kStep + 1}), zero = hn::Zero(d);
  for (int x = 0; x < kTile; x += static_cast<int>(hn::Lanes(d))) {
    const ptrdiff_t centre = kMedianRadius * stride + kMedianRadius + x;
    const auto own_bin = hn::LoadU(d, bin + centre), own_grey = hn::LoadU(d, grey + centre);
    auto sum = zero;
    for (int j = 0; j <= 2 * kMedianRadius; ++j) {
      for (int i = j & 1; i <= 2 * kMedianRadius; i += 2) {
        const ptrdiff_t at = j * stride + i + x;
        const auto difference = hn::Abs(hn::Sub(hn::LoadU(d, grey + at), own_grey));
        const auto weight = hn::Mul(hn::Max(hn::Sub(reach, difference), zero), hn::LoadU(d, factor + at));
        const auto agrees = hn::Lt(hn::Abs(hn::Sub(hn::LoadU(d, bin + at), own_bin)), beyond);
        sum = hn::Add(sum, hn::IfThenElse(agrees, weight, hn::Neg(weight)));
      }
    }
    hn::StoreU(sum, d, out + x);
  }
}

}  // namespace iris::stereo::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace iris::stereo {

HWY_EXPORT(majorities);

namespace {

constexpr int kRowsPerChunk = 16;
constexpr int kBins = 1024;    // [px]
constexpr int kNoBin = -8192;  // farther from any bin than bins are from each other
constexpr int kMeasuredWeight = 5, kInterpolatedWeight = 3;

// What windows are made of, with kMedianRadius pixels of weight 0 around the image (and room for a tile behind).
struct Planes {
  cv::Mat1s bin, grey, factor;

  Planes(const cv::Mat1b& left, const DisparityImage& image) {
    const cv::Size size(left.cols + 2 * kMedianRadius + kTile, left.rows + 2 * kMedianRadius);
    bin = cv::Mat1s(size, int16_t{kNoBin});
    grey = cv::Mat1s(size, int16_t{0});
    factor = cv::Mat1s(size, int16_t{0});
    parallel_chunks(0, left.rows, kRowsPerChunk, [&](int y0, int y1) {
      for (int y = y0; y < y1; ++y) {
        const float* const d = image.disparity[y];
        const uint8_t* const origin = image.origin[y];
        for (int x = 0; x < left.cols; ++x) {
          const int v = y + kMedianRadius, u = x + kMedianRadius;
          grey(v, u) = left(y, x);
          if (!(d[x] > 0)) continue;
          const bool measured = origin[x] <= static_cast<uint8_t>(DisparityOrigin::corrected);
          bin(v, u) = static_cast<int16_t>(std::min(kBins - 1, static_cast<int>(d[x] + 0.5f)));
          factor(v, u) = measured ? kMeasuredWeight : kInterpolatedWeight;
        }
      }
    });
  }
};

// 255 where a step between neighbours is within kMedianRadius along both axes.
cv::Mat1b near_steps(const cv::Mat1f& disparity) {
  cv::Mat1b steps(disparity.size(), uchar{0}), near;
  const auto is_step = [](float a, float b) {
    return static_cast<uint8_t>((a > 0) & (b > 0) & (std::abs(a - b) > kStep) ? 255 : 0);
  };
  parallel_chunks(0, disparity.rows, kRowsPerChunk, [&](int y0, int y1) {
    for (int y = y0; y < y1; ++y) {
      const float* const d = disparity[y];
      uint8_t* const out = steps[y];
      for (int x = 1; x < disparity.cols; ++x) out[x] = is_step(d[x], d[x - 1]);
      for (int x = 1; x < disparity.cols; ++x) out[x - 1] |= is_step(d[x], d[x - 1]);
      for (const int other : {y - 1, y + 1}) {
        if (other < 0 || other >= disparity.rows) continue;
        const float* const e = disparity[other];
        for (int x = 0; x < disparity.cols; ++x) out[x] |= is_step(d[x], e[x]);
      }
    }
  });
  constexpr int kSide = 2 * kMedianRadius + 1;
  cv::dilate(steps, near, cv::getStructuringElement(cv::MORPH_RECT, cv::Size(kSide, kSide)));
  return near;
}

}  // namespace

int guide_weight(int grey_difference, bool interpolated) {
  return std::max(0, kGreyReach - grey_difference) * (interpolated ? kInterpolatedWeight : kMeasuredWeight);
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
  const cv::Mat1f& disparity = image.disparity;
  const cv::Mat1b near = near_steps(disparity);
  const Planes planes(left, image);
  DisparityImage out{disparity.clone(), image.origin.clone()};
  // The window, its nearest pixels first.
  struct Tap {
    int row, column;
    ptrdiff_t at;  // in the planes
  };
  std::vector<Tap> taps;
  for (int j = -kMedianRadius; j <= kMedianRadius; ++j) {
    for (int i = -kMedianRadius + ((j + kMedianRadius) & 1); i <= kMedianRadius; i += 2) {
      taps.push_back({j, i, j * static_cast<ptrdiff_t>(planes.bin.step1()) + i});
    }
  }
  std::stable_sort(taps.begin(), taps.end(), [](const Tap& a, const Tap& b) {
    return std::abs(a.row) + std::abs(a.column) < std::abs(b.row) + std::abs(b.column);
  });
  parallel_chunks(0, disparity.rows, kRowsPerChunk, [&](int y0, int y1) {
    std::vector<int> histogram(kBins, 0);
    std::array<int16_t, kTile> majority;
    // Of the pixel (x, y), whose own disparity has no majority.
    const auto settle = [&](int x, int y) {
      const int16_t* const bin = planes.bin[y + kMedianRadius] + x + kMedianRadius;
      const int16_t* const grey = planes.grey[y + kMedianRadius] + x + kMedianRadius;
      const int16_t* const factor = planes.factor[y + kMedianRadius] + x + kMedianRadius;
      int low = kBins, high = 0, total = 0;
      for (const Tap& tap : taps) {
        if (factor[tap.at] == 0) continue;
        const int weight = std::max(0, kGreyReach - std::abs(grey[tap.at] - *grey)) * factor[tap.at];
        histogram[bin[tap.at]] += weight;
        total += weight;
        low = std::min<int>(low, bin[tap.at]);
        high = std::max<int>(high, bin[tap.at]);
      }
      int median = low;
      for (int sum = histogram[low]; 2 * sum < total;) sum += histogram[++median];
      std::fill(histogram.begin() + low, histogram.begin() + high + 1, 0);
      if (std::abs(median - *bin) <= kStep) return;
      const auto nearest = std::find_if(taps.begin(), taps.end(), [&](const Tap& t) { return bin[t.at] == median; });
      out.disparity(y, x) = disparity(y + nearest->row, x + nearest->column);
      if (image.origin(y, x) == static_cast<uint8_t>(DisparityOrigin::measured)) {
        out.origin(y, x) = static_cast<uint8_t>(DisparityOrigin::corrected);
      }
    };
    for (int y = y0; y < y1; ++y) {
      for (int x0 = 0; x0 < disparity.cols; x0 += kTile) {
        const int x1 = std::min(x0 + kTile, disparity.cols);
        const uint8_t* const wanted = near[y];
        if (std::none_of(wanted + x0, wanted + x1, [](uint8_t value) { return value != 0; })) continue;
        HWY_DYNAMIC_DISPATCH(majorities)
        (planes.bin[y] + x0, planes.grey[y] + x0, planes.factor[y] + x0, static_cast<ptrdiff_t>(planes.bin.step1()),
         majority.data());
        for (int x = x0; x < x1; ++x) {
          if (wanted[x] != 0 && disparity(y, x) > 0 && majority[x - x0] <= 0) settle(x, y);
        }
      }
    }
  });
  return out;
}

}  // namespace iris::stereo
#endif  // HWY_ONCE
