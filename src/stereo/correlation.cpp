#include "correlation.h"

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <vector>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

// The rows of a block are worked on in tiles of columns, so that everything between the images and the winners stays in
// the cache: for each candidate d, with x along the vectors,
//   columns[d][x]    sum of capped differences over the window's height, updated from row to row;
//   window[y][d][x]  sum over the whole window, kept for the rows that SAD5 needs;
//   cost[d][x]       SAD5 of the current row.
#ifndef IRIS_STEREO_CORRELATION_BLOCK
#define IRIS_STEREO_CORRELATION_BLOCK
namespace iris::stereo {

inline constexpr int kMaxLanes = 32;  // 16-bit lanes used at most

// Rows of both images, with room beside them, and the rows of the output for rows y0 … y1 - 1.
struct CorrelationBlock {
  const uint8_t* left;  // pixel (0, 0)
  const uint8_t* right;
  ptrdiff_t left_stride, right_stride;
  ptrdiff_t left_plane, right_plane;  // from the image to each of the three planes of its census
  bool census;
  int width, height;
  CorrelationParameters parameters;
  int tile;  // columns worked on together, a multiple of kMaxLanes
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
#if HWY_TARGET == HWY_SCALAR
using Tag8 = hn::Rebind<uint8_t, Tag16>;
#else
using Tag8 = hn::Repartition<uint8_t, Tag16>;
#endif
using Vec8 = hn::Vec<Tag8>;

// What one pixel contributes, for as many columns as a vector has bytes.
struct DifferenceCost {
  static constexpr int kPlanes = 1;
  static HWY_INLINE Vec8 at(const uint8_t* left, const uint8_t* right, ptrdiff_t, ptrdiff_t, Vec8 cap) {
    const Tag8 d8;
    const auto a = hn::LoadU(d8, left), b = hn::LoadU(d8, right);
    return hn::Min(hn::Sub(hn::Max(a, b), hn::Min(a, b)), cap);
  }
};
struct CensusCost {
  static constexpr int kPlanes = 4;
  static HWY_INLINE Vec8 at(const uint8_t* left, const uint8_t* right, ptrdiff_t left_plane, ptrdiff_t right_plane,
                            Vec8 cap) {
    const Tag8 d8;
    const auto difference = DifferenceCost::at(left, right, 0, 0, cap);
    const auto bits = [&](int plane) {
      return hn::Xor(hn::LoadU(d8, left + plane * left_plane), hn::LoadU(d8, right + plane * right_plane));
    };
    // A full adder for each bit of the three bytes leaves two to be counted instead of three.
    const auto a = bits(1), b = bits(2), c = bits(3);
    const auto half = hn::Xor(a, b);
    const auto ones = hn::PopulationCount(hn::Xor(half, c));
    const auto twos = hn::PopulationCount(hn::Or(hn::And(a, b), hn::And(half, c)));
    const auto count = hn::Add(ones, hn::Add(twos, twos));
    const auto count2 = hn::Add(count, count);
    static_assert(kCensusWeight == 5 && kGreyWeight == 2);
    return hn::Add(hn::Add(count, hn::Add(count2, count2)), hn::Add(difference, difference));
  }
};

// One row of both images at one candidate.
struct RowPair {
  const uint8_t* left;
  const uint8_t* right;
};

// sums += costs of the row that enters the window - costs of the row that leaves it (if there is one).
template <class Cost, bool kLeaves>
HWY_INLINE void move_columns(const CorrelationBlock& block, RowPair enters, RowPair leaves, int n, uint16_t* sums) {
  const Tag16 d16;
  const Tag8 d8;
  const hn::Rebind<uint8_t, Tag16> half8;
  const auto cap = hn::Set(d8, static_cast<uint8_t>(block.parameters.cap));
  const auto add = [&](hn::Vec<decltype(half8)> in, hn::Vec<decltype(half8)> out, uint16_t* to) {
    auto sum = hn::Add(hn::LoadU(d16, to), hn::PromoteTo(d16, in));
    if (kLeaves) sum = hn::Sub(sum, hn::PromoteTo(d16, out));
    hn::StoreU(sum, d16, to);
  };
  for (int i = 0; i < n; i += static_cast<int>(hn::Lanes(d8))) {
    const auto in = Cost::at(enters.left + i, enters.right + i, block.left_plane, block.right_plane, cap);
    auto out = in;
    if (kLeaves) out = Cost::at(leaves.left + i, leaves.right + i, block.left_plane, block.right_plane, cap);
#if HWY_TARGET == HWY_SCALAR
    add(in, out, sums + i);
#else
    add(hn::LowerHalf(half8, in), hn::LowerHalf(half8, out), sums + i);
    add(hn::UpperHalf(half8, in), hn::UpperHalf(half8, out), sums + i + hn::Lanes(d16));
#endif
  }
}

// out[i] = in[i] + … + in[i + 2 half], by way of sums of pairs. kHalf = 0: any.
template <int kHalf>
HWY_INLINE void box_row(const uint16_t* in, int half, int n, uint16_t* pairs, uint16_t* out) {
  const Tag16 d16;
  const int lanes = static_cast<int>(hn::Lanes(d16));
  if (kHalf != 0) half = kHalf;
  for (int i = 0; i < n + 2 * half - 2; i += lanes) {
    hn::StoreU(hn::Add(hn::LoadU(d16, in + i), hn::LoadU(d16, in + i + 1)), d16, pairs + i);
  }
  for (int i = 0; i < n; i += lanes) {
    auto sum = hn::LoadU(d16, in + i + 2 * half);
    for (int k = 0; k < half; ++k) sum = hn::Add(sum, hn::LoadU(d16, pairs + i + 2 * k));
    hn::StoreU(sum, d16, out + i);
  }
}

// C0 + the two lowest of the four supporting windows (3.1). The two lowest are either both upper, both lower, or the
// lower one of each: four comparisons (A.3). Sums saturate: kNone stays kNone.
HWY_INLINE void sad5_row(const uint16_t* middle, const uint16_t* upper, const uint16_t* lower, int offset, int n,
                         uint16_t* cost) {
  const Tag16 d16;
  const int lanes = static_cast<int>(hn::Lanes(d16));
  for (int i = 0; i < n; i += lanes) {
    const auto a = hn::LoadU(d16, upper + i), b = hn::LoadU(d16, upper + i + 2 * offset);
    const auto c = hn::LoadU(d16, lower + i), e = hn::LoadU(d16, lower + i + 2 * offset);
    const auto mixed = hn::SaturatedAdd(hn::Min(a, b), hn::Min(c, e));
    const auto two = hn::Min(hn::Min(hn::SaturatedAdd(a, b), hn::SaturatedAdd(c, e)), mixed);
    hn::StoreU(hn::SaturatedAdd(hn::LoadU(d16, middle + i + offset), two), d16, cost + i);
  }
}

// Winner, its cost and the second minimum (3.4) for each column of the tile. In ascending order of d, the lowest cost
// up to d - 2 is known whenever a new winner appears.
HWY_INLINE void select_left(const uint16_t* cost, ptrdiff_t stride, int disparities, int n, uint16_t* winner,
                            uint16_t* winner_cost, uint16_t* second) {
  const Tag16 d16;
  const hn::RebindToSigned<Tag16> di16;
  const int lanes = static_cast<int>(hn::Lanes(d16));
  const auto none = hn::Set(d16, Correlation::kNone);
  const auto one = hn::Set(di16, 1);
  for (int i = 0; i < n; i += lanes) {
    auto best = none, second_best = none, best_d = none;
    auto until_1 = none, until_2 = none;  // lowest cost up to d - 1 and d - 2
    const uint16_t* p = cost + i;
    for (int d = 0; d < disparities; ++d, p += stride) {
      const auto c = hn::LoadU(d16, p);
      const auto vd = hn::Set(d16, static_cast<uint16_t>(d));
      const auto lower = hn::Min(best, c);
      const auto keep = hn::Eq(lower, best);
      // best_d = 65535 before the first winner: d + 1 > 1 counts as far, but all costs so far were kNone.
      const auto far = hn::RebindMask(d16, hn::Gt(hn::BitCast(di16, hn::Sub(vd, best_d)), one));
      const auto candidate = hn::IfThenElse(far, c, none);
      second_best = hn::IfThenElse(keep, hn::Min(second_best, candidate), until_2);
      best_d = hn::IfThenElse(keep, best_d, vd);
      best = lower;
      until_2 = until_1;
      until_1 = best;
    }
    hn::StoreU(best_d, d16, winner + i);
    hn::StoreU(best, d16, winner_cost + i);
    hn::StoreU(second_best, d16, second + i);
  }
}

// The search from the right image, as far as this tile takes part in it: pixel k of the right image meets column
// k + min_disparity + d of the left one. cost has kMaxLanes columns of kNone on both sides of the tile.
HWY_INLINE void select_right(const uint16_t* cost, ptrdiff_t stride, const CorrelationBlock& block, int disparities,
                             int x0, int x1, uint16_t* best, uint16_t* best_d) {
  const Tag16 d16;
  const int lanes = static_cast<int>(hn::Lanes(d16));
  const int min_disparity = block.parameters.min_disparity;
  for (int k = 0; k < block.width; k += lanes) {
    const int x = k + min_disparity;
    const int d_begin = std::max(0, x0 - lanes + 1 - x), d_end = std::min(disparities, x1 - x);
    if (d_begin >= d_end) continue;
    auto b = hn::LoadU(d16, best + k);
    auto bd = hn::LoadU(d16, best_d + k);
    const uint16_t* p = cost + (x + d_begin - x0) + d_begin * stride;
    for (int d = d_begin; d < d_end; ++d, p += stride + 1) {
      const auto lower = hn::Min(b, hn::LoadU(d16, p));
      bd = hn::IfThenElse(hn::Eq(lower, b), bd, hn::Set(d16, static_cast<uint16_t>(d)));
      b = lower;
    }
    hn::StoreU(b, d16, best + k);
    hn::StoreU(bd, d16, best_d + k);
  }
}

template <class Cost>
void correlate_rows(const CorrelationBlock& block) {
  const CorrelationParameters& p = block.parameters;
  const int lanes = static_cast<int>(hn::Lanes(Tag16()));
  const int rx = p.window_width / 2, ry = p.window_height / 2;
  const int n_window = (block.tile + 2 * rx + lanes - 1) / lanes * lanes;
  const int n_columns = (n_window + 2 * rx + 2 * lanes - 1) / (2 * lanes) * (2 * lanes);
  const int ring = 2 * ry + 1;
  // Strides that are no multiple of a page keep the candidates of one pixel out of one cache set.
  const ptrdiff_t column_stride = n_columns + kMaxLanes;
  const ptrdiff_t window_stride = n_window + kMaxLanes;
  const ptrdiff_t cost_stride = block.tile + 2 * kMaxLanes;
  const size_t ring_stride = window_stride * p.disparities;
  const auto columns = hwy::AllocateAligned<uint16_t>(column_stride * p.disparities);
  const auto windows = hwy::AllocateAligned<uint16_t>(ring_stride * ring);
  const auto costs = hwy::AllocateAligned<uint16_t>(cost_stride * p.disparities);
  const auto pairs = hwy::AllocateAligned<uint16_t>(column_stride);
  const auto selected = hwy::AllocateAligned<uint16_t>(3 * static_cast<size_t>(block.tile));
  uint16_t* const winner = selected.get();
  uint16_t* const winner_cost = winner + block.tile;
  uint16_t* const second = winner_cost + block.tile;
  // State of the search from the right, for every row of the block.
  const int right_stride = block.width + kMaxLanes;
  const size_t right_size = static_cast<size_t>(right_stride) * (block.y1 - block.y0);
  std::vector<uint16_t> right_best(right_size, Correlation::kNone), right_d(right_size, Correlation::kNone);
  std::fill(costs.get(), costs.get() + cost_stride * p.disparities, Correlation::kNone);

  for (int x0 = 0; x0 < block.width; x0 += block.tile) {
    const int x1 = std::min(x0 + block.tile, block.width);
    const int disparities =
        std::clamp(x1 - p.min_disparity, 0, p.disparities);  // others have no partner for any column
    const int x_columns = x0 - 2 * rx, x_windows = x0 - rx;  // image column of index 0

    // Sums over whole windows of row y for all candidates; the columns' sums are moved there from row y - 1 or, for
    // the first row, built.
    const auto window_row = [&](int y, bool first) {
      for (int d = 0; d < disparities; ++d) {
        uint16_t* sums = columns.get() + column_stride * d;
        const auto rows = [&](int row) {
          const int inside = std::clamp(row, 0, block.height - 1);
          return RowPair{block.left + block.left_stride * inside + x_columns,
                         block.right + block.right_stride * inside + x_columns - p.min_disparity - d};
        };
        if (first) {
          std::fill(sums, sums + n_columns, uint16_t{0});
          for (int k = -ry; k <= ry; ++k) move_columns<Cost, false>(block, rows(y + k), {}, n_columns, sums);
        } else {
          move_columns<Cost, true>(block, rows(y + ry), rows(y - ry - 1), n_columns, sums);
        }
        // Columns a … b have a partner; the others must not contribute.
        const int a = std::max(0, p.min_disparity + d);
        const int b = std::min(block.width - 1, block.width - 1 + p.min_disparity + d);
        const int zero_end = std::clamp(a - x_columns, 0, n_columns);
        const int zero_begin = std::clamp(b + 1 - x_columns, zero_end, n_columns);
        std::fill(sums, sums + zero_end, uint16_t{0});
        std::fill(sums + zero_begin, sums + n_columns, uint16_t{0});

        uint16_t* out = windows.get() + ring_stride * (y % ring) + window_stride * d;
        switch (rx) {
          case 3:
            box_row<3>(sums, rx, n_window, pairs.get(), out);
            break;
          case 4:
            box_row<4>(sums, rx, n_window, pairs.get(), out);
            break;
          default:
            box_row<0>(sums, rx, n_window, pairs.get(), out);
        }
        const auto scale = [&](int x) {  // a cut window
          const unsigned visible = std::min(x + rx, b) - std::max(x - rx, a) + 1;
          uint16_t& sum = out[x - x_windows];
          sum = static_cast<uint16_t>(sum * static_cast<unsigned>(p.window_width) / visible);
        };
        const int begin = x_windows, end = x_windows + n_window;
        const int inner_begin = std::max(a + rx, begin), inner_end = std::min(b - rx + 1, end);
        for (int x = std::max(a, begin); x <= std::min({b, inner_begin - 1, end - 1}); ++x) scale(x);
        for (int x = std::max({inner_begin, inner_end, a, begin}); x <= std::min(b, end - 1); ++x) scale(x);
        std::fill(out, out + std::clamp(a - begin, 0, n_window), Correlation::kNone);
        std::fill(out + std::clamp(b + 1 - begin, 0, n_window), out + n_window, Correlation::kNone);
      }
    };

    const int first_row = std::max(0, block.y0 - ry);
    for (int y_window = first_row; y_window < block.y1 + ry; ++y_window) {
      if (y_window < block.height) window_row(y_window, y_window == first_row);
      const int y = y_window - ry;
      if (y < block.y0) continue;
      const auto window = [&](int row, int d) {
        return windows.get() + ring_stride * (std::clamp(row, 0, block.height - 1) % ring) + window_stride * d;
      };
      uint16_t* const cost = costs.get() + kMaxLanes;
      for (int d = 0; d < disparities; ++d) {
        uint16_t* row = cost + cost_stride * d;
        sad5_row(window(y, d), window(y - ry, d), window(y + ry, d), rx, block.tile, row);
      }
      select_left(cost, cost_stride, disparities, block.tile, winner, winner_cost, second);
      const size_t right_row = static_cast<size_t>(right_stride) * (y - block.y0);
      select_right(cost, cost_stride, block, disparities, x0, x1, &right_best[right_row], &right_d[right_row]);

      const int n = x1 - x0;
      std::memcpy(block.out->winner[y] + x0, winner, n * sizeof(uint16_t));
      std::memcpy(block.out->cost[y] + x0, winner_cost, n * sizeof(uint16_t));
      std::memcpy(block.out->second[y] + x0, second, n * sizeof(uint16_t));
      uint16_t* const before = block.out->before[y] + x0;
      uint16_t* const after = block.out->after[y] + x0;
      for (int i = 0; i < n; ++i) {
        const uint16_t* at = cost + i + cost_stride * winner[i];
        const bool found = winner[i] != Correlation::kNone;
        before[i] = found && winner[i] > 0 ? at[-cost_stride] : Correlation::kNone;
        after[i] = found && winner[i] + 1 < disparities ? at[cost_stride] : Correlation::kNone;
      }
    }
  }
  for (int y = block.y0; y < block.y1; ++y) {
    std::memcpy(block.out->right_winner[y], &right_d[static_cast<size_t>(right_stride) * (y - block.y0)],
                block.width * sizeof(uint16_t));
  }
}

void correlate_block(const CorrelationBlock& block) {
  if (block.census) {
    correlate_rows<CensusCost>(block);
  } else {
    correlate_rows<DifferenceCost>(block);
  }
}

}  // namespace iris::stereo::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace iris::stereo {

HWY_EXPORT(correlate_block);

namespace {

// Copies of an image and, if wanted, of its census, with `before` and `after` columns of room on the sides.
struct Padded {
  ptrdiff_t stride, plane;
  std::vector<uint8_t> bytes;
  const uint8_t* origin;

  Padded(const MatchImage& image, int before, int after)
      : stride(image.grey.cols + before + after),
        plane(stride * image.grey.rows),
        bytes(static_cast<size_t>(plane) * (image.census[0].empty() ? 1 : 4)),
        origin(bytes.data() + before) {
    for (int y = 0; y < image.grey.rows; ++y) {
      uint8_t* row = bytes.data() + before + y * stride;
      std::copy_n(image.grey[y], image.grey.cols, row);
      for (int i = 0; i < 3 && !image.census[0].empty(); ++i) {
        std::copy_n(image.census[i][y], image.grey.cols, row + (i + 1) * plane);
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
  constexpr int kCacheBytes = 640 << 10;  // of the windows, the largest part of what a tile needs

  const int tile_for_cache = kCacheBytes / (2 * p.disparities * p.window_height);
  const int tiles =
      (size.width + std::max(tile_for_cache, 2 * kMaxLanes) - 1) / std::max(tile_for_cache, 2 * kMaxLanes);
  const int tile = ((size.width + tiles - 1) / tiles + kMaxLanes - 1) / kMaxLanes * kMaxLanes;

  const int beside = p.window_width;
  const int after = tile + 2 * p.window_width + 4 * kMaxLanes;
  const Padded padded_left(left, beside, after);
  const Padded padded_right(right, beside + std::max(0, p.min_disparity + p.disparities),
                            after + std::max(0, -p.min_disparity));
  Correlation out;
  for (cv::Mat1w* image : {&out.winner, &out.cost, &out.second, &out.before, &out.after, &out.right_winner}) {
    image->create(size);
  }
  parallel_chunks(0, size.height, kRowsPerBlock, [&](int y0, int y1) {
    const CorrelationBlock block = {.left = padded_left.origin,
                                    .right = padded_right.origin,
                                    .left_stride = padded_left.stride,
                                    .right_stride = padded_right.stride,
                                    .left_plane = padded_left.plane,
                                    .right_plane = padded_right.plane,
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
