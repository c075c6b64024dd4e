#include "correlation.h"

#include <algorithm>
#include <cstddef>
#include <cstdlib>
#include <vector>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

// Candidates lie along the vectors: everything that a column of windows needs is then loaded from aligned addresses,
// and a window's sum follows from the one to its left. The rows of a block are worked on in tiles of columns, so that
// what must be kept from row to row stays in the cache; with x for the column and d for the candidate:
//   pixels[row][x][d]   what each pixel contributes, for the rows inside of the windows (8 bits);
//   columns[x][d]       sum over the window's height, updated from row to row (8 bits if they suffice);
//   windows[row][x][d]  sum over the whole window, for the rows that SAD5 needs;
//   costs[x][d]         SAD5 of the last kGroup columns.
// In one go along a row, each column goes through all of these steps up to the winner.
#ifndef IRIS_STEREO_CORRELATION_BLOCK
#define IRIS_STEREO_CORRELATION_BLOCK
namespace iris::stereo {

inline constexpr int kMaxLanes = 16;  // 16-bit lanes used at most: wider vectors gain nothing
inline constexpr int kGroup = 8;      // columns after which the search from the right takes part

// Rows of both images, with room beside them, and the rows of the output for rows y0 … y1 - 1.
struct CorrelationBlock {
  const MatchImage* left;
  const uint8_t* right;  // pixel (0, 0); mirrored: x grows towards lower addresses
  ptrdiff_t right_stride;
  ptrdiff_t right_plane;  // from the image to each of the three planes of its census
  bool census;
  int width, height;
  CorrelationParameters parameters;
  int tile;  // columns worked on together, a multiple of kGroup
  int y0, y1;
  Correlation* out;
};

}  // namespace iris::stereo
#endif  // IRIS_STEREO_CORRELATION_BLOCK

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "../src/stereo/correlation.cpp"  // seen from include/
#include <hwy/aligned_allocator.h>
#include <hwy/foreach_target.h>  // IWYU pragma: keep
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace iris::stereo::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using Tag16 = hn::CappedTag<uint16_t, kMaxLanes>;
using Vec16 = hn::Vec<Tag16>;
#if HWY_TARGET == HWY_SCALAR
using Tag8 = hn::Rebind<uint8_t, Tag16>;
#else
using Tag8 = hn::Repartition<uint8_t, Tag16>;
#endif
using Vec8 = hn::Vec<Tag8>;

// What one pixel of the left image contributes at as many consecutive candidates as a vector has bytes.
class DifferenceCost {
 public:
  HWY_INLINE DifferenceCost(const MatchImage& left, int y, int x, ptrdiff_t, int cap)
      : left_(hn::Set(Tag8(), left.grey[y][x])), cap_(hn::Set(Tag8(), static_cast<uint8_t>(cap))) {}
  HWY_INLINE Vec8 at(const uint8_t* right) const {
    const auto b = hn::LoadU(Tag8(), right);
    return hn::Min(hn::Sub(hn::Max(left_, b), hn::Min(left_, b)), cap_);
  }

 private:
  Vec8 left_, cap_;
};

class CensusCost {
 public:
  HWY_INLINE CensusCost(const MatchImage& left, int y, int x, ptrdiff_t right_plane, int cap)
      : difference_(left, y, x, right_plane, cap),
        a_(hn::Set(Tag8(), left.census[0][y][x])),
        b_(hn::Set(Tag8(), left.census[1][y][x])),
        c_(hn::Set(Tag8(), left.census[2][y][x])),
        right_plane_(right_plane) {}
  HWY_INLINE Vec8 at(const uint8_t* right) const {
    const Tag8 d8;
    const auto difference = difference_.at(right);
    // A full adder for each bit of the three bytes leaves two to be counted instead of three.
    const auto a = hn::Xor(a_, hn::LoadU(d8, right + right_plane_));
    const auto b = hn::Xor(b_, hn::LoadU(d8, right + 2 * right_plane_));
    const auto c = hn::Xor(c_, hn::LoadU(d8, right + 3 * right_plane_));
    const auto half = hn::Xor(a, b);
    const auto ones = hn::Xor(half, c);
    const auto twos = hn::Or(hn::And(a, b), hn::And(half, c));
    return hn::Add(hn::Add(weighted(ones, kOnes), weighted(twos, kTwos)), hn::Add(difference, difference));
  }

 private:
  static_assert(kGreyWeight == 2);
#if HWY_TARGET == HWY_SCALAR
  static constexpr int kOnes = kCensusWeight, kTwos = 2 * kCensusWeight;
  static HWY_INLINE Vec8 weighted(Vec8 bits, int weight) {
    const Tag8 d8;
    return hn::Set(d8, static_cast<uint8_t>(weight * hn::GetLane(hn::PopulationCount(bits))));
  }
#else
  // Weight times the number of bits of each half of a byte.
  static constexpr int kOne = kCensusWeight, kTwo = 2 * kOne;
  alignas(16) static constexpr uint8_t kOnes[16] = {0,        kOne,     kOne,     2 * kOne, kOne,     2 * kOne,
                                                    2 * kOne, 3 * kOne, kOne,     2 * kOne, 2 * kOne, 3 * kOne,
                                                    2 * kOne, 3 * kOne, 3 * kOne, 4 * kOne};
  alignas(16) static constexpr uint8_t kTwos[16] = {0,        kTwo,     kTwo,     2 * kTwo, kTwo,     2 * kTwo,
                                                    2 * kTwo, 3 * kTwo, kTwo,     2 * kTwo, 2 * kTwo, 3 * kTwo,
                                                    2 * kTwo, 3 * kTwo, 3 * kTwo, 4 * kTwo};
  static HWY_INLINE Vec8 weighted(Vec8 bits, const uint8_t* table) {
    const Tag8 d8;
    const hn::Repartition<uint16_t, Tag8> wide;
    const auto weights = hn::LoadDup128(d8, table);
    const auto low = hn::Set(d8, uint8_t{15});
    const auto high_bits = hn::And(hn::BitCast(d8, hn::ShiftRight<4>(hn::BitCast(wide, bits))), low);
    return hn::Add(hn::TableLookupBytes(weights, hn::And(bits, low)), hn::TableLookupBytes(weights, high_bits));
  }
#endif
  DifferenceCost difference_;
  Vec8 a_, b_, c_;
  ptrdiff_t right_plane_;
};

template <class D>
HWY_INLINE uint16_t lowest_lane(D d, hn::Vec<D> v) {
#if !HWY_HAVE_SCALABLE && HWY_TARGET != HWY_SCALAR
  if constexpr (hn::MaxLanes(D()) > 8) {
    const hn::Half<D> half;
    return lowest_lane(half, hn::Min(hn::LowerHalf(half, v), hn::UpperHalf(half, v)));
  }
#endif
  return hn::GetLane(hn::MinOfLanes(d, v));
}

// The windows of one pixel, at all candidates.
struct Windows {
  const uint16_t *middle, *upper_left, *upper_right, *lower_left, *lower_right;
};

// What remains of the costs of one pixel: for each lane the lowest two and the candidate of the lowest.
struct Lowest {
  alignas(2 * kMaxLanes) uint16_t best[kMaxLanes];
  alignas(2 * kMaxLanes) uint16_t second[kMaxLanes];
  alignas(2 * kMaxLanes) uint16_t best_d[kMaxLanes];
};

// C0 + the two lowest of the four supporting windows (3.1). The two lowest are either both upper, both lower, or the
// lower one of each: four comparisons (A.3). Sums saturate: kNone stays kNone. If vectors reach beyond the last
// candidate (kPadded), no_candidate is kNone there, 0 elsewhere.
template <bool kPadded>
HWY_INLINE void sad5(const Windows windows, const uint16_t* HWY_RESTRICT no_candidate, int end,
                     uint16_t* HWY_RESTRICT cost, Lowest* HWY_RESTRICT lowest) {
  const Tag16 d16;
  const int lanes = static_cast<int>(hn::Lanes(d16));
  const auto step = hn::Set(d16, static_cast<uint16_t>(lanes));
  auto best = hn::Set(d16, Correlation::kNone);
  auto second = best, best_d = best, vd = hn::Iota(d16, 0);
  for (int d = 0; d < end; d += lanes) {
    const auto a = hn::Load(d16, windows.upper_left + d), b = hn::Load(d16, windows.upper_right + d);
    const auto c = hn::Load(d16, windows.lower_left + d), e = hn::Load(d16, windows.lower_right + d);
    const auto mixed = hn::SaturatedAdd(hn::Min(a, b), hn::Min(c, e));
    const auto two = hn::Min(hn::Min(hn::SaturatedAdd(a, b), hn::SaturatedAdd(c, e)), mixed);
    auto sum = hn::SaturatedAdd(hn::Load(d16, windows.middle + d), two);
    if constexpr (kPadded) sum = hn::Or(sum, hn::LoadU(d16, no_candidate + d));
    hn::Store(sum, d16, cost + d);
    const auto lower = hn::Min(best, sum);
    second = hn::Min(second, hn::Max(best, sum));
    best_d = hn::IfThenElse(hn::Eq(lower, best), best_d, vd);
    best = lower;
    vd = hn::Add(vd, step);
  }
  hn::Store(best, d16, lowest->best);
  hn::Store(second, d16, lowest->second);
  hn::Store(best_d, d16, lowest->best_d);
}

struct Selected {
  uint16_t winner, cost, second;
};

// Winner, its cost and the second minimum (3.4). The winner and its neighbours are in different lanes: in each of the
// three, it is the second lowest cost that counts if the lowest is that of the winner or its neighbour.
HWY_INLINE Selected select_left(const Lowest& lowest, const uint16_t* cost, int end) {
  const Tag16 d16;
  const auto none = hn::Set(d16, Correlation::kNone);
  const auto best = hn::Load(d16, lowest.best), best_d = hn::Load(d16, lowest.best_d);
  Selected out;
  out.cost = lowest_lane(d16, best);
  out.winner = lowest_lane(d16, hn::IfThenElse(hn::Eq(best, hn::Set(d16, out.cost)), best_d, none));
  if (hn::Lanes(d16) < 3) {
    out.second = Correlation::kNone;
    for (int d = 0; d < end; ++d) {
      if (std::abs(d - out.winner) > 1) out.second = std::min(out.second, cost[d]);
    }
    return out;
  }
  const auto from_before = hn::Sub(best_d, hn::Set(d16, static_cast<uint16_t>(out.winner - 1)));
  const auto near = hn::Eq(hn::Min(from_before, hn::Set(d16, uint16_t{2})), from_before);
  out.second = lowest_lane(d16, hn::IfThenElse(near, hn::Load(d16, lowest.second), best));
  return out;
}

// The search from the right image, as far as kGroup columns of the left one take part in it: right pixels lie along
// the vectors as the candidates do in the first of the columns, and meet the next candidate in the next column.
HWY_INLINE void search_right(const uint16_t* cost, ptrdiff_t cost_stride, int begin, int end, uint16_t* best,
                             uint16_t* best_d) {
  const Tag16 d16;
  const auto one = hn::Set(d16, uint16_t{1}), lane = hn::Iota(d16, 0);
  for (int i = begin; i < end; i += static_cast<int>(hn::Lanes(d16))) {
    auto b = hn::LoadU(d16, best + i);
    auto bd = hn::LoadU(d16, best_d + i);
    auto d = hn::Add(lane, hn::Set(d16, static_cast<uint16_t>(i)));
    for (int k = 0; k < kGroup; ++k) {
      const auto lower = hn::Min(b, hn::LoadU(d16, cost + i + k * (cost_stride + 1)));
      bd = hn::IfThenElse(hn::Eq(lower, b), bd, d);
      b = lower;
      d = hn::Add(d, one);
    }
    hn::StoreU(b, d16, best + i);
    hn::StoreU(bd, d16, best_d + i);
  }
}

// Where the sums of one column are, at all candidates. Sum: uint8_t or uint16_t.
template <class Sum>
struct Column {
  const uint8_t* right;       // at the first candidate
  uint8_t* pixel;             // contributions of the row that leaves the window; replaced by those that enter
  Sum* sums;                  // over the window's height
  const Sum* leaves;          // sums of the column that leaves the window
  const uint16_t* before;     // sums over the window one column before; may be `window`
  uint16_t* window;           // sums over the window
  const uint8_t* from_first;  // masks of the existing candidates
  const uint8_t* to_last;
};

// As many sums as a vector of 16-bit numbers holds.
HWY_INLINE Vec16 load_sums(const uint16_t* sums) { return hn::Load(Tag16(), sums); }
HWY_INLINE Vec16 load_sums(const uint8_t* sums) {
  return hn::PromoteTo(Tag16(), hn::Load(hn::Rebind<uint8_t, Tag16>(), sums));
}

template <bool kMasked, bool kWindows, class Cost, class Sum>
HWY_INLINE void move_column(const Cost& cost, const Column<Sum> c, int end) {
  const Tag16 d16;
  const Tag8 d8;
  const hn::Rebind<uint8_t, Tag16> half8;
  using Half8 = hn::Vec<decltype(half8)>;
  [[maybe_unused]] const int lanes = static_cast<int>(hn::Lanes(d16));
  Sum* HWY_RESTRICT const sums = c.sums;
  const auto to_window = [&](Vec16 sum, int d) {
    if constexpr (kWindows) {
      const auto whole = hn::Add(hn::Load(d16, c.before + d), hn::Sub(sum, load_sums(c.leaves + d)));
      hn::Store(whole, d16, c.window + d);
    }
  };
  const auto update = [&](Half8 in, Half8 out, int d) {
    if constexpr (sizeof(Sum) == 2) {
      const auto sum = hn::Sub(hn::Add(hn::Load(d16, sums + d), hn::PromoteTo(d16, in)), hn::PromoteTo(d16, out));
      hn::Store(sum, d16, sums + d);
      to_window(sum, d);
    }
  };
  for (int d = 0; d < end; d += static_cast<int>(hn::Lanes(d8))) {
    auto in = cost.at(c.right + d);
    if constexpr (kMasked) in = hn::And(in, hn::And(hn::LoadU(d8, c.from_first + d), hn::LoadU(d8, c.to_last + d)));
    const auto out = hn::Load(d8, c.pixel + d);
    hn::Store(in, d8, c.pixel + d);
    if constexpr (sizeof(Sum) == 1) {
      const auto sum = hn::Add(hn::Load(d8, sums + d), hn::Sub(in, out));  // modulo 256
      hn::Store(sum, d8, sums + d);
#if HWY_TARGET == HWY_SCALAR
      to_window(hn::PromoteTo(d16, sum), d);
#else
      to_window(hn::PromoteTo(d16, hn::LowerHalf(half8, sum)), d);
      if (d + lanes < end) to_window(hn::PromoteTo(d16, hn::UpperHalf(half8, sum)), d + lanes);
#endif
    } else {
#if HWY_TARGET == HWY_SCALAR
      update(in, out, d);
#else
      update(hn::LowerHalf(half8, in), hn::LowerHalf(half8, out), d);
      if (d + lanes < end) update(hn::UpperHalf(half8, in), hn::UpperHalf(half8, out), d + lanes);
#endif
    }
  }
}

template <class Cost, class Sum>
void correlate_rows(const CorrelationBlock& block) {
  const CorrelationParameters& p = block.parameters;
  const Tag16 d16;
  const Tag8 d8;
  const int lanes = static_cast<int>(hn::Lanes(d16)), lanes8 = static_cast<int>(hn::Lanes(d8));
  const int rx = p.window_width / 2, ry = p.window_height / 2;
  const int ring = 2 * ry + 1;
  const ptrdiff_t stride = (p.disparities + lanes - 1) / lanes * lanes;      // of 16-bit values, per column
  const ptrdiff_t stride8 = (p.disparities + lanes8 - 1) / lanes8 * lanes8;  // of bytes
  const int n_columns = block.tile + 4 * rx, n_windows = block.tile + 2 * rx;
  const ptrdiff_t ring_stride = stride * n_windows, ring_stride8 = stride8 * n_columns;
  const ptrdiff_t cost_stride = stride + 2 * kMaxLanes;
  const auto pixels = hwy::AllocateAligned<uint8_t>(ring_stride8 * ring);
  const ptrdiff_t column_stride = sizeof(Sum) == 1 ? stride8 : stride;
  const auto columns_store = hwy::AllocateAligned<Sum>(column_stride * (n_columns + 2 * rx + 1));
  Sum* const columns = columns_store.get() + column_stride * (2 * rx + 1);  // zeros before it
  const auto windows = hwy::AllocateAligned<uint16_t>(ring_stride * ring);
  // Sums over the window one column before: there, or here if they are not kept or have been scaled since.
  const auto running = hwy::AllocateAligned<uint16_t>(stride);
  const uint16_t* before = running.get();
  const auto costs_store = hwy::AllocateAligned<uint16_t>(cost_stride * (kGroup + 1));
  uint16_t* const costs = costs_store.get() + kMaxLanes;
  std::fill(costs - kMaxLanes, costs - kMaxLanes + cost_stride * (kGroup + 1), Correlation::kNone);
  // Masks: all bits set from index stride8 to 2 stride8; kNone from index `disparities`.
  std::vector<uint8_t> mask(3 * stride8 + lanes8, 0);
  std::fill(mask.begin() + stride8, mask.begin() + 2 * stride8, uint8_t{255});
  std::vector<uint16_t> no_candidate(stride, 0);
  std::fill(no_candidate.begin() + p.disparities, no_candidate.end(), Correlation::kNone);
  // State of the search from the right, for every row of the block. Mirrored: pixel x has index right_origin - x.
  const int right_origin = block.width + std::abs(p.min_disparity) + 2 * kMaxLanes;
  const ptrdiff_t right_stride = right_origin + std::abs(p.min_disparity) + stride + 2 * kMaxLanes;
  const size_t right_size = static_cast<size_t>(right_stride) * (block.y1 - block.y0);
  std::vector<uint16_t> right_best(right_size, Correlation::kNone), right_d(right_size, Correlation::kNone);

  // Candidates first … last have a partner for column x of the image. Others are beyond either side.
  const auto first_candidate = [&](int x) {
    return std::clamp(x - p.min_disparity - (block.width - 1), 0, p.disparities);
  };
  const auto last_candidate = [&](int x) { return std::clamp(x - p.min_disparity, -1, p.disparities - 1); };
  // All candidates of the columns up to x are before this one.
  std::vector<int> candidates_end(block.width + 2 * rx + block.tile);
  for (int x = 0; x < static_cast<int>(candidates_end.size()); ++x) {
    candidates_end[x] = (last_candidate(std::min(x, block.width - 1)) + lanes) / lanes * lanes;
  }
  std::vector<int> slot(block.height + 2 * ry);  // of row - ry in the rings
  for (int i = 0; i < static_cast<int>(slot.size()); ++i) slot[i] = i % ring;
  Lowest lowest[kGroup];

  for (int x0 = 0; x0 < block.width; x0 += block.tile) {
    const int x1 = std::min(x0 + block.tile, block.width);
    const int x_columns = x0 - 2 * rx, x_windows = x0 - rx;  // image column of index 0
    std::fill(pixels.get(), pixels.get() + ring_stride8 * ring, uint8_t{0});
    std::fill(columns_store.get(), columns + column_stride * n_columns, Sum{0});
    std::fill(windows.get(), windows.get() + ring_stride * ring, Correlation::kNone);

    // The sums of column x for the windows of the row above become those of the row whose windows end at image row
    // `row`. If kWindows, the sums of the windows that end at column x go to `window`.
    const auto move = [&]<bool kWindows>(int row, int x, uint16_t* window) {
      const int inside = std::clamp(row, 0, block.height - 1);
      const Cost cost(*block.left, inside, x, block.right_plane, p.cap);
      Sum* const sums = columns + column_stride * (x - x_columns);
      const int first = first_candidate(x), last = last_candidate(x);
      const Column<Sum> column = {.right = block.right + block.right_stride * inside - (x - p.min_disparity),
                                  .pixel = pixels.get() + ring_stride8 * slot[row + ry] + stride8 * (x - x_columns),
                                  .sums = sums,
                                  .leaves = sums - column_stride * (2 * rx + 1),
                                  .before = before,
                                  .window = window,
                                  .from_first = mask.data() + stride8 - first,
                                  .to_last = mask.data() + 2 * stride8 - (last + 1)};
      if (first == 0 && last == p.disparities - 1) {
        move_column<false, kWindows>(cost, column, candidates_end[x]);
      } else {
        move_column<true, kWindows>(cost, column, candidates_end[x]);
      }
    };

    // Sums over the windows of row y that end at column x_end.
    const auto window_column = [&](int y, int x_end) {
      const int x = x_end - rx;
      const bool wanted = x >= x_windows && x >= 0 && x < block.width;
      uint16_t* const window =
          wanted ? windows.get() + ring_stride * slot[y + ry] + stride * (x - x_windows) : running.get();
      const int end = candidates_end[x_end];
      if (x_end >= block.width) {
        const Sum* const leaves = columns + column_stride * (x_end - x_columns - (2 * rx + 1));
        for (int d = 0; d < end; d += lanes) {
          hn::Store(hn::Sub(hn::Load(d16, before + d), load_sums(leaves + d)), d16, window + d);
        }
      } else {
        move.template operator()<true>(y + ry, x_end, window);
      }
      before = window;
      if (!wanted) return;
      const int first = first_candidate(x), last = last_candidate(x);
      const auto scale = [&](int d) {  // a cut window
        const int a = std::max(0, p.min_disparity + d);
        const int b = std::min(block.width - 1, block.width - 1 + p.min_disparity + d);
        const int visible = std::min(x + rx, b) - std::max(x - rx, a) + 1;
        // Truncation is exact: the dividend has less than 24 bits, and no fraction is close enough to 1 to be rounded
        // up.
        const float sum = static_cast<float>(window[d] * p.window_width);
        window[d] = static_cast<uint16_t>(static_cast<int>(sum / static_cast<float>(visible)));
      };
      // Not cut: those that have a partner for both ends of the window.
      const bool inside = x >= rx && x + rx < block.width;
      const int whole_begin = inside ? std::clamp(first_candidate(x + rx), first, last + 1) : last + 1;
      const int whole_end = inside ? std::clamp(last_candidate(x - rx) + 1, whole_begin, last + 1) : last + 1;
      if (whole_begin == 0 && whole_end == p.disparities) return;
      std::copy(window, window + end, running.get());
      before = running.get();
      for (int d = first; d < whole_begin; ++d) scale(d);
      for (int d = whole_end; d <= last; ++d) scale(d);
      std::fill(window, window + std::min(first, end), Correlation::kNone);
      if (last + 1 < p.disparities) std::fill(window + last + 1, window + end, Correlation::kNone);
    };

    // The same for columns of which all candidates exist, for windows that are kept and not cut.
    const int whole_begin = std::max({x0, 2 * rx, 2 * rx + p.min_disparity + p.disparities - 1});
    const int whole_end = block.width + std::min(0, p.min_disparity);
    const auto whole_column = [&](int y, int x_end) {
      const int row = y + ry, inside = std::min(row, block.height - 1);
      const Cost cost(*block.left, inside, x_end, block.right_plane, p.cap);
      const ptrdiff_t i = x_end - x_columns;
      const Column<Sum> column = {.right = block.right + block.right_stride * inside - (x_end - p.min_disparity),
                                  .pixel = pixels.get() + ring_stride8 * slot[row + ry] + stride8 * i,
                                  .sums = columns + column_stride * i,
                                  .leaves = columns + column_stride * (i - (2 * rx + 1)),
                                  .before = before,
                                  .window = windows.get() + ring_stride * slot[y + ry] + stride * (x_end - x0),
                                  .from_first = nullptr,
                                  .to_last = nullptr};
      move_column<false, true>(cost, column, static_cast<int>(stride));
      before = column.window;
    };

    const auto window_row = [&](int row) {
      return windows.get() + ring_stride * slot[std::clamp(row, 0, block.height - 1) + ry];
    };
    // The pixels x … x_end - 1 of a group.
    const auto select = [&](int y, int x, int x_end) {
      const int end = candidates_end[x_end - 1];
      uint16_t* HWY_RESTRICT const winner_row = block.out->winner[y];
      uint16_t* HWY_RESTRICT const cost_row = block.out->cost[y];
      uint16_t* HWY_RESTRICT const second_row = block.out->second[y];
      uint16_t* HWY_RESTRICT const before_row = block.out->before[y];
      uint16_t* HWY_RESTRICT const after_row = block.out->after[y];
      for (int i = 0; i < kGroup; ++i) {
        const int known = x + i < x_end ? candidates_end[x + i] : 0;
        if (known < stride) {
          std::fill(costs + cost_stride * i + known, costs + cost_stride * i + stride, Correlation::kNone);
        }
      }
      for (int i = 0; i < x_end - x; ++i) {
        const uint16_t* const cost = costs + cost_stride * i;
        const Selected selected = select_left(lowest[i], cost, candidates_end[x + i]);
        const bool found = selected.winner != Correlation::kNone;
        winner_row[x + i] = selected.winner;
        cost_row[x + i] = selected.cost;
        second_row[x + i] = selected.second;
        before_row[x + i] = found ? cost[selected.winner - 1] : Correlation::kNone;
        after_row[x + i] = found ? cost[selected.winner + 1] : Correlation::kNone;
      }
      const ptrdiff_t at = right_stride * (y - block.y0) + right_origin - x + p.min_disparity;
      search_right(costs, cost_stride, -(kGroup + lanes - 2) / lanes * lanes, end, &right_best[at], &right_d[at]);
    };

    const int first_row = std::max(0, block.y0 - ry);
    for (int row = first_row - ry; row < first_row + ry; ++row) {
      for (int x = std::max(0, x_columns); x < std::min(x1 + 2 * rx, block.width); ++x) {
        move.template operator()<false>(row, x, nullptr);
      }
    }
    for (int y_windows = first_row; y_windows < block.y1 + ry; ++y_windows) {
      const int y = y_windows - ry;
      const uint16_t* const middle = window_row(y);
      const uint16_t* const upper = window_row(y - ry);
      const uint16_t* const lower = window_row(y + ry);
      std::fill(running.get(), running.get() + stride, uint16_t{0});
      before = running.get();
      for (int x_end = std::max(0, x_columns); x_end < x1 + 2 * rx; ++x_end) {
        if (x_end >= whole_begin && x_end < whole_end && y_windows < block.height) {
          whole_column(y_windows, x_end);
        } else if (y_windows < block.height) {
          window_column(y_windows, x_end);
        }
        const int x = x_end - 2 * rx;
        if (y < block.y0 || x < x0) continue;
        const int in_group = (x - x0) % kGroup;
        const ptrdiff_t left_side = stride * (x - x0), right_side = left_side + 2 * rx * stride;
        const Windows around = {.middle = middle + left_side + rx * stride,
                                .upper_left = upper + left_side,
                                .upper_right = upper + right_side,
                                .lower_left = lower + left_side,
                                .lower_right = lower + right_side};
        uint16_t* const cost = costs + cost_stride * in_group;
        if (stride > p.disparities) {
          sad5<true>(around, no_candidate.data(), candidates_end[x], cost, &lowest[in_group]);
        } else {
          sad5<false>(around, nullptr, candidates_end[x], cost, &lowest[in_group]);
        }
        if (in_group == kGroup - 1 || x == x1 - 1) select(y, x - in_group, x + 1);
      }
    }
  }
  for (int y = block.y0; y < block.y1; ++y) {
    const uint16_t* const from = &right_d[right_stride * (y - block.y0) + right_origin];
    uint16_t* const to = block.out->right_winner[y];
    for (int x = 0; x < block.width; ++x) to[x] = from[-x];
  }
}

void correlate_block(const CorrelationBlock& block) {
  const CorrelationParameters& p = block.parameters;
  if (block.census) {
    correlate_rows<CensusCost, uint16_t>(block);
  } else if (p.cap * p.window_height > 255) {
    correlate_rows<DifferenceCost, uint16_t>(block);
  } else {
    correlate_rows<DifferenceCost, uint8_t>(block);
  }
}

}  // namespace iris::stereo::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace iris::stereo {

HWY_EXPORT(correlate_block);

namespace {

// Copies of an image and, if wanted, of its census, each row mirrored, with `before` and `after` bytes of room.
struct Mirrored {
  ptrdiff_t stride, plane;
  std::vector<uint8_t> bytes;
  const uint8_t* origin;

  Mirrored(const MatchImage& image, int before, int after)
      : stride(image.grey.cols + before + after),
        plane(stride * image.grey.rows),
        bytes(static_cast<size_t>(plane) * (image.census[0].empty() ? 1 : 4)),
        origin(bytes.data() + before + image.grey.cols - 1) {
    for (int y = 0; y < image.grey.rows; ++y) {
      uint8_t* row = bytes.data() + before + y * stride;
      std::reverse_copy(image.grey[y], image.grey[y] + image.grey.cols, row);
      for (int i = 0; i < 3 && !image.census[0].empty(); ++i) {
        const uint8_t* const bits = image.census[i][y];
        std::reverse_copy(bits, bits + image.grey.cols, row + (i + 1) * plane);
      }
    }
  }
};

}  // namespace

int largest_cap(int window_width, int window_height, bool census) {
  const int of_pixel = std::min(255, (Correlation::kNone - 1) / (3 * window_width * window_height));
  return census ? (of_pixel - 24 * kCensusWeight) / kGreyWeight : of_pixel;
}

Correlation correlate(const MatchImage& left, const MatchImage& right, const CorrelationParameters& p) {
  const cv::Size size = left.grey.size();
  const bool census = !left.census[0].empty();
  IRIS_CHECK(!left.grey.empty() && right.grey.size() == size);
  for (int i = 0; i < 3; ++i) {
    IRIS_CHECK(left.census[i].size() == (census ? size : cv::Size()) &&
               right.census[i].size() == left.census[i].size());
  }
  IRIS_CHECK(p.disparities > 0 && p.window_width % 2 == 1 && p.window_height % 2 == 1);
  IRIS_CHECK(p.cap >= 0 && p.cap <= largest_cap(p.window_width, p.window_height, census));
  constexpr int kRowsPerBlock = 64;
  constexpr int kCacheBytes = 480 << 10;  // of the windows and pixels, the largest part of what a tile needs

  const int tile_for_cache = std::max(kCacheBytes / (3 * p.disparities * p.window_height), 8 * kGroup);
  const int tiles = (size.width + tile_for_cache - 1) / tile_for_cache;
  const int tile = ((size.width + tiles - 1) / tiles + kGroup - 1) / kGroup * kGroup;

  const Mirrored mirrored_right(right, std::max(0, -p.min_disparity),
                                std::max(0, p.min_disparity) + p.disparities + 4 * kMaxLanes);
  Correlation out;
  for (cv::Mat1w* image : {&out.winner, &out.cost, &out.second, &out.before, &out.after, &out.right_winner}) {
    image->create(size);
  }
  parallel_chunks(0, size.height, kRowsPerBlock, [&](int y0, int y1) {
    const CorrelationBlock block = {.left = &left,
                                    .right = mirrored_right.origin,
                                    .right_stride = mirrored_right.stride,
                                    .right_plane = mirrored_right.plane,
                                    .census = census,
                                    .width = size.width,
                                    .height = size.height,
                                    .parameters = p,
                                    .tile = tile,
                                    .y0 = y0,
                                    .y1 = y1,
                                    .out = &out};
    HWY_DYNAMIC_DISPATCH(correlate_block)(block);
  });
  return out;
}

}  // namespace iris::stereo
#endif  // HWY_ONCE
