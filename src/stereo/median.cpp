#include "median.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <utility>
#include <vector>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

#ifndef IRIS_STEREO_MEDIAN_CONSTANTS
#define IRIS_STEREO_MEDIAN_CONSTANTS
namespace iris::stereo {

inline constexpr int kTile = 32;       // columns worked on together
inline constexpr int kStep = 1;        // [px] smaller differences are left to the sub-pixel fit
inline constexpr int kGreyReach = 32;  // [grey levels]
inline constexpr int kBins = 1024;     // [px]
inline constexpr int kNoBin = -8192;   // farther from any bin than bins are from each other
inline constexpr int kMeasuredWeight = 5, kInterpolatedWeight = 3;

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
//
// Only where `wanted` is not 0 is the answer needed.
void outvoted(const int16_t* bin, const int16_t* grey, const int16_t* factor, ptrdiff_t stride, const uint8_t* wanted,
              int16_t* out) {
  const hn::CappedTag<int16_t, kTile> d;
  const hn::Rebind<uint8_t, decltype(d)> d8;
  const hn::RebindToUnsigned<decltype(d)> du;
  const auto reach = hn::Set(du, uint16_t{kGreyReach});
  const auto step = hn::Set(d, int16_t{kStep}), one = hn::Set(d, int16_t{1});
  for (int x = 0; x < kTile; x += static_cast<int>(hn::Lanes(d))) {
    if (hn::AllTrue(d8, hn::Eq(hn::LoadU(d8, wanted + x), hn::Zero(d8)))) continue;
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

// One row of what windows are made of. Returns the highest bin, at least 0.
int fill_planes(const uint8_t* left, const float* disparity, const uint8_t* origin, int width, int16_t* bin,
                int16_t* grey, int16_t* factor) {
  int highest = 0;
  const auto fill = [&](auto d, int x) HWY_ATTR {
    const hn::RebindToSigned<decltype(d)> di;
    const hn::Rebind<int16_t, decltype(d)> d16;
    const hn::Rebind<uint8_t, decltype(d)> d8;
    const auto value = hn::LoadU(d, disparity + x);
    const auto valid = hn::RebindMask(di, hn::Gt(value, hn::Zero(d)));
    const auto limited = hn::Min(hn::Add(value, hn::Set(d, 0.5f)), hn::Set(d, kBins - 1.0f));
    const auto bins = hn::IfThenElse(valid, hn::ConvertTo(di, limited), hn::Set(di, kNoBin));
    const auto of_origin = hn::PromoteTo(di, hn::LoadU(d8, origin + x));
    const auto measured = hn::Lt(of_origin, hn::Set(di, static_cast<int>(DisparityOrigin::corrected) + 1));
    const auto weight = hn::IfThenElse(measured, hn::Set(di, kMeasuredWeight), hn::Set(di, kInterpolatedWeight));
    hn::StoreU(hn::DemoteTo(d16, bins), d16, bin + x);
    hn::StoreU(hn::DemoteTo(d16, hn::PromoteTo(di, hn::LoadU(d8, left + x))), d16, grey + x);
    hn::StoreU(hn::DemoteTo(d16, hn::IfThenElseZero(valid, weight)), d16, factor + x);
    highest = std::max(highest, static_cast<int>(hn::GetLane(hn::MaxOfLanes(di, bins))));
  };
  const hn::ScalableTag<float> d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  int x = 0;
  for (; x + lanes <= width; x += lanes) fill(d, x);
  for (; x < width; ++x) fill(hn::CappedTag<float, 1>(), x);
  return highest;
}

// Of one pixel: the weighted median of the bins around it. The pointers are those of the upper left corner of its
// window. highest: of all bins.
int median_bin(const int16_t* bin, const int16_t* grey, const int16_t* factor, ptrdiff_t stride, int highest) {
  constexpr int kSide = 2 * kMedianRadius + 1;
  constexpr int kRow = 16;  // columns of a row in `weights`, without those that do not count
  const hn::CappedTag<int16_t, kRow> d;
  const hn::RebindToUnsigned<decltype(d)> du;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const ptrdiff_t centre = kMedianRadius * stride + kMedianRadius;
  const auto own_grey = hn::Set(d, grey[centre]);
  const auto reach = hn::Set(du, uint16_t{kGreyReach});
  alignas(2 * kRow) int16_t bins[kSide * kRow];
  alignas(2 * kRow) int16_t weights[kSide * kRow];
  static constexpr int16_t kCounts[kRow + 1] = {1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 0, 0, 0, 0, 0};
  static constexpr int16_t kOddCounts[kRow] = {0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 0, 0, 0, 0, 0};
  auto sum = hn::Zero(d);
  for (int j = 0; j < kSide; ++j) {
    for (int i = 0; i < kRow; i += lanes) {
      const ptrdiff_t at = j * stride + i;
      const auto difference = hn::BitCast(du, hn::Abs(hn::Sub(hn::LoadU(d, grey + at), own_grey)));
      const auto similar = hn::BitCast(d, hn::SaturatedSub(reach, difference));
      const auto counts = hn::LoadU(d, (j % 2 == 0 ? kCounts : kOddCounts) + i);
      const auto weight = hn::Mul(hn::Mul(similar, counts), hn::LoadU(d, factor + at));
      sum = hn::Add(sum, weight);
      hn::Store(weight, d, weights + j * kRow + i);
      hn::Store(hn::LoadU(d, bin + at), d, bins + j * kRow + i);
    }
  }
  const auto total_of = [&](hn::Vec<decltype(d)> v) HWY_ATTR {
#if HWY_TARGET == HWY_SCALAR
    return static_cast<int>(hn::GetLane(v));
#else
    const hn::Repartition<int32_t, decltype(d)> d32;
    // Lanes are positive: of each pair, the lower one is what remains without the upper.
    const auto pairs = hn::BitCast(d32, v);
    const auto upper = hn::ShiftRight<16>(pairs);
    const auto lower = hn::ShiftRight<16>(hn::ShiftLeft<16>(pairs));
    return static_cast<int>(hn::GetLane(hn::SumOfLanes(d32, hn::Add(lower, upper))));
#endif
  };
  const int total = total_of(sum);
  // The smallest bin up to which at least half of the weight lies.
  int low = 0, high = highest;
  while (low < high) {
    const int middle = (low + high) / 2;
    const auto next = hn::Set(d, static_cast<int16_t>(middle + 1));
    auto below = hn::Zero(d);
    for (int i = 0; i < kSide * kRow; i += lanes) {
      const auto counts = hn::Lt(hn::Load(d, bins + i), next);
      below = hn::Add(below, hn::IfThenElseZero(counts, hn::Load(d, weights + i)));
    }
    if (2 * total_of(below) >= total) {
      high = middle;
    } else {
      low = middle + 1;
    }
  }
  return low;
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
HWY_EXPORT(median_bin);
HWY_EXPORT(fill_planes);
HWY_EXPORT(find_steps);

namespace {

constexpr int kRowsPerChunk = 16;
constexpr int kRowsPerMedian = 40;  // with as many rows above and below as windows reach

// What windows of the rows y0 … y1 - 1 are made of, with kMedianRadius pixels of weight 0 around the image (and room
// for a tile behind). Row 0 is the image's row y0 - kMedianRadius.
struct Planes {
  cv::Mat1s bin, grey, factor;
  int highest = 0;  // of the bins

  Planes(const cv::Mat1b& left, const DisparityImage& image, int y0, int y1) {
    const cv::Size size(left.cols + 2 * kMedianRadius + kTile, y1 - y0 + 2 * kMedianRadius);
    for (cv::Mat1s* plane : {&bin, &grey, &factor}) plane->create(size);
    for (int v = 0; v < size.height; ++v) {
      const int y = y0 + v - kMedianRadius;
      const bool inside = y >= 0 && y < left.rows;
      for (const auto& [plane, nothing] : {std::pair{&bin, kNoBin}, std::pair{&grey, 0}, std::pair{&factor, 0}}) {
        int16_t* const row = (*plane)[v];
        std::fill_n(row, inside ? kMedianRadius : size.width, static_cast<int16_t>(nothing));
        if (inside) std::fill(row + kMedianRadius + left.cols, row + size.width, static_cast<int16_t>(nothing));
      }
      if (!inside) continue;
      const int row_highest =
          HWY_DYNAMIC_DISPATCH(fill_planes)(left[y], image.disparity[y], image.origin[y], left.cols,
                                            bin[v] + kMedianRadius, grey[v] + kMedianRadius, factor[v] + kMedianRadius);
      highest = std::max(highest, row_highest);
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

void guided_median(const cv::Mat1b& left, DisparityImage& image) {
  IRIS_CHECK(left.size() == image.disparity.size());
  const cv::Mat1f& disparity = image.disparity;
  const cv::Mat1b near = near_steps(disparity);
  // The window, its nearest pixels first.
  struct Tap {
    int row, column;
  };
  std::vector<Tap> taps;
  for (int j = -kMedianRadius; j <= kMedianRadius; ++j) {
    for (int i = -kMedianRadius + ((j + kMedianRadius) & 1); i <= kMedianRadius; i += 2) taps.push_back({j, i});
  }
  std::stable_sort(taps.begin(), taps.end(), [](const Tap& a, const Tap& b) {
    return std::abs(a.row) + std::abs(a.column) < std::abs(b.row) + std::abs(b.column);
  });
  // What changes, put in at the end: until then windows consist of what was there before.
  struct Change {
    int x, y;
    float disparity;
  };
  std::vector<std::vector<Change>> changes((disparity.rows + kRowsPerMedian - 1) / kRowsPerMedian);
  parallel_chunks(0, disparity.rows, kRowsPerMedian, [&](int y0, int y1) {
    const auto is_set = [](uint8_t value) { return value != 0; };
    std::optional<Planes> planes;
    std::vector<uint8_t> wanted(disparity.cols + kTile, 0);
    std::array<int16_t, kTile> loses;
    for (int y = y0; y < y1; ++y) {
      std::copy_n(near[y], disparity.cols, wanted.begin());
      for (int x0 = 0; x0 < disparity.cols; x0 += kTile) {
        const int x1 = std::min(x0 + kTile, disparity.cols);
        if (std::none_of(wanted.begin() + x0, wanted.begin() + x1, is_set)) continue;
        if (!planes) planes.emplace(left, image, y0, y1);
        const ptrdiff_t stride = static_cast<ptrdiff_t>(planes->bin.step1());
        const int16_t* const bin = planes->bin[y - y0];
        const int16_t* const grey = planes->grey[y - y0];
        const int16_t* const factor = planes->factor[y - y0];
        HWY_DYNAMIC_DISPATCH(outvoted)(bin + x0, grey + x0, factor + x0, stride, wanted.data() + x0, loses.data());
        for (int x = x0; x < x1; ++x) {
          if (wanted[x] == 0 || loses[x - x0] == 0 || !(disparity[y][x] > 0)) continue;
          const int median = HWY_DYNAMIC_DISPATCH(median_bin)(bin + x, grey + x, factor + x, stride, planes->highest);
          const int16_t* const own_bin = bin + kMedianRadius * (stride + 1) + x;
          const auto nearest = std::find_if(taps.begin(), taps.end(),
                                            [&](const Tap& t) { return own_bin[t.row * stride + t.column] == median; });
          changes[y0 / kRowsPerMedian].push_back({x, y, disparity(y + nearest->row, x + nearest->column)});
        }
      }
    }
  });
  for (const std::vector<Change>& of_chunk : changes) {
    for (const Change& change : of_chunk) {
      image.disparity(change.y, change.x) = change.disparity;
      uint8_t& origin = image.origin(change.y, change.x);
      if (origin == static_cast<uint8_t>(DisparityOrigin::measured)) {
        origin = static_cast<uint8_t>(DisparityOrigin::corrected);
      }
    }
  }
}

}  // namespace iris::stereo
#endif  // HWY_ONCE
