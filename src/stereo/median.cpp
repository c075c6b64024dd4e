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

// For kTile pixels: not 0 where the weighted median is more than kStep away from the pixel's own (rounded) disparity:
// where what lies below weighs at least as much as all others, or what lies above more. The pointers are those of the
// upper left corner of the first pixel's window.
void outvoted(const int16_t* bin, const int16_t* grey, const int16_t* factor, ptrdiff_t stride, int16_t* out) {
  const hn::CappedTag<int16_t, kTile> d;
  const hn::RebindToUnsigned<decltype(d)> du;
  const auto reach = hn::Set(du, uint16_t{kGreyReach});
  const auto step = hn::Set(d, int16_t{kStep}), one = hn::Set(d, int16_t{1});
  for (int x = 0; x < kTile; x += static_cast<int>(hn::Lanes(d))) {
    const ptrdiff_t centre = kMedianRadius * stride + kMedianRadius + x;
    const auto own_grey = hn::LoadU(d, grey + centre), own_bin = hn::LoadU(d, bin + centre);
    const auto low = hn::Sub(own_bin, step), high = hn::Add(own_bin, step);
    auto all = hn::Zero(d), below = all, above = all;
    for (int j = 0; j <= 2 * kMedianRadius; ++j) {
      for (int i = j & 1; i <= 2 * kMedianRadius; i += 2) {
        const ptrdiff_t at = j * stride + i + x;
        const auto difference = hn::BitCast(du, hn::Abs(hn::Sub(hn::LoadU(d, grey + at), own_grey)));
        const auto similar = hn::BitCast(d, hn::SaturatedSub(reach, difference));
        const auto weight = hn::Mul(similar, hn::LoadU(d, factor + at));
        const auto other = hn::LoadU(d, bin + at);
        all = hn::Add(all, weight);
        below = hn::Add(below, hn::IfThenElseZero(hn::Lt(other, low), weight));
        above = hn::Add(above, hn::IfThenElseZero(hn::Gt(other, high), weight));
      }
    }
    const auto is_below = hn::Gt(hn::Add(hn::Add(below, below), one), all);
    const auto is_above = hn::Gt(hn::Add(above, above), all);
    hn::StoreU(hn::IfThenElseZero(hn::Or(is_below, is_above), one), d, out + x);
  }
}

// 255 where a pixel of a row differs by more than kStep from one of its four neighbours, else 0. Each row has a
// readable pixel on either side and a vector behind; pixels <= 0 have no step.
void find_steps(const float* above, const float* row, const float* below, int width, uint8_t* out) {
  const hn::ScalableTag<float> d;
  const hn::Rebind<int32_t, decltype(d)> di;
  const hn::Rebind<uint8_t, decltype(d)> d8;
  const auto largest = hn::Set(d, static_cast<float>(kStep)), zero = hn::Zero(d);
  for (int x = 0; x < width; x += static_cast<int>(hn::Lanes(d))) {
    const auto own = hn::LoadU(d, row + x);
    const auto step = [&](const float* other) {
      const auto value = hn::LoadU(d, other);
      return hn::And(hn::Gt(value, zero), hn::Gt(hn::Abs(hn::Sub(own, value)), largest));
    };
    const auto any = hn::Or(hn::Or(step(row + x - 1), step(row + x + 1)), hn::Or(step(above + x), step(below + x)));
    const auto found = hn::IfThenElseZero(hn::RebindMask(di, hn::And(any, hn::Gt(own, zero))), hn::Set(di, 255));
    hn::StoreU(hn::DemoteTo(d8, found), d8, out + x);
  }
}

}  // namespace iris::stereo::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace iris::stereo {

HWY_EXPORT(outvoted);
HWY_EXPORT(find_steps);

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
    for (cv::Mat1s* plane : {&bin, &grey, &factor}) plane->create(size);
    parallel_chunks(0, size.height, kRowsPerChunk, [&](int v0, int v1) {
      for (int v = v0; v < v1; ++v) {
        const int y = v - kMedianRadius;
        std::fill_n(bin[v], size.width, int16_t{kNoBin});
        std::fill_n(grey[v], size.width, int16_t{0});
        std::fill_n(factor[v], size.width, int16_t{0});
        if (y >= 0 && y < left.rows) fill(left[y], image.disparity[y], image.origin[y], left.cols, v);
      }
    });
  }

 private:
  void fill(const uint8_t* left, const float* d, const uint8_t* origin, int width, int v) {
    int16_t* const bins = bin[v] + kMedianRadius;
    int16_t* const greys = grey[v] + kMedianRadius;
    int16_t* const factors = factor[v] + kMedianRadius;
    for (int x = 0; x < width; ++x) {
      const int rounded = std::min(kBins - 1, static_cast<int>(d[x] + 0.5f));
      bins[x] = static_cast<int16_t>(d[x] > 0 ? rounded : kNoBin);
    }
    for (int x = 0; x < width; ++x) greys[x] = left[x];
    for (int x = 0; x < width; ++x) {
      const bool measured = origin[x] <= static_cast<uint8_t>(DisparityOrigin::corrected);
      const int weight = measured ? kMeasuredWeight : kInterpolatedWeight;
      factors[x] = static_cast<int16_t>(bins[x] >= 0 ? weight : 0);
    }
  }
};

// 255 where a step between neighbours is within kMedianRadius along both axes.
cv::Mat1b near_steps(const cv::Mat1f& disparity) {
  constexpr int kBefore = 16, kSlack = 64;  // of a row: a vector may reach beyond its end
  const int width = disparity.cols, height = disparity.rows;
  cv::Mat1b steps(disparity.size()), near;
  parallel_chunks(0, height, kRowsPerChunk, [&](int y0, int y1) {
    const size_t stride = width + kBefore + kSlack;
    std::vector<float> padded(stride * (y1 - y0 + 2), 0.0f);  // rows y0 - 1 … y1
    const auto row = [&](int y) { return &padded[stride * (y - y0 + 1) + kBefore]; };
    for (int y = std::max(0, y0 - 1); y < std::min(height, y1 + 1); ++y) std::copy_n(disparity[y], width, row(y));
    std::vector<uint8_t> found(width + kSlack);
    for (int y = y0; y < y1; ++y) {
      HWY_DYNAMIC_DISPATCH(find_steps)(row(y - 1), row(y), row(y + 1), width, found.data());
      std::copy_n(found.begin(), width, steps[y]);
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
    std::array<int16_t, kTile> loses;
    // Of the pixel (x, y), which does not agree with its neighbours.
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
        HWY_DYNAMIC_DISPATCH(outvoted)
        (planes.bin[y] + x0, planes.grey[y] + x0, planes.factor[y] + x0, static_cast<ptrdiff_t>(planes.bin.step1()),
         loses.data());
        for (int x = x0; x < x1; ++x) {
          if (wanted[x] != 0 && loses[x - x0] != 0 && disparity[y][x] > 0) settle(x, y);
        }
      }
    }
  });
  return out;
}

}  // namespace iris::stereo
#endif  // HWY_ONCE
