#include "corner_kernels.h"

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <limits>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

#ifndef IRIS_MOTION_CORNER_KERNELS_SHARED
#define IRIS_MOTION_CORNER_KERNELS_SHARED
namespace iris::motion {

inline constexpr int kWindowReach = 5;                  // [px] half of the Gaussian window
inline constexpr int kHarrisBorder = kWindowReach + 1;  // [px] and the gradient's neighbour
// exp(-k^2 / 8), so that their sum over the window is 1.
inline constexpr float kGaussian[kWindowReach + 1] = {0.2005654142388208f,  0.17699835683135567f, 0.12164907301380959f,
                                                      0.06511405659938266f, 0.02714357714347937f, 0.00881222929256228f};
inline constexpr float kKappa = 0.04f;
inline constexpr float kUnit = 1.0f / 4096;  // gradients are kept 8 times as large

struct HarrisRows {
  const cv::Mat1b* image;
  cv::Mat1f* response;
  int y0, y1;
};

// Patches are compared in groups of eight bytes.
inline constexpr int kWords = (kPatchSize * kPatchSize + 7) / 8;
inline constexpr int kIndexBits = 32;

// Both sums and indices in one number: the lowest number is the lowest sum and among these the lowest index.
struct PatchComparison {
  const uint64_t* a;   // kWords a patch
  int a_begin, a_end;  // patches of a to compare
  const uint64_t* b;   // `lanes` patches in turns: word 0 of each, word 1 of each, …
  int b_blocks;        // so many times
  int64_t* best_of_a;  // from a_begin on
  int64_t* best_of_b;  // lanes * b_blocks
};

}  // namespace iris::motion
#endif  // IRIS_MOTION_CORNER_KERNELS_SHARED

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "../src/motion/corner_kernels.cpp"  // seen from include/
#include <hwy/foreach_target.h>                                // IWYU pragma: keep
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace iris::motion::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// No vector is longer than this many bytes.
inline constexpr int kMaxBytes = 64;

using Float = hn::CappedTag<float, kMaxBytes / 4>;
using VecFloat = hn::Vec<Float>;

// The eleven values at steps of `stride`, weighted; the same order of additions on every machine.
HWY_INLINE VecFloat smoothed(const float* const* at, ptrdiff_t offset) {
  const Float d;
  auto sum = hn::Mul(hn::Set(d, kGaussian[0]), hn::LoadU(d, at[kWindowReach] + offset));
  for (int k = 1; k <= kWindowReach; ++k) {
    const auto both = hn::Add(hn::LoadU(d, at[kWindowReach - k] + offset), hn::LoadU(d, at[kWindowReach + k] + offset));
    sum = hn::Add(sum, hn::Mul(hn::Set(d, kGaussian[k]), both));
  }
  return sum;
}

// In tiles of columns, so that the rows a window needs stay in the first level of the cache.
void harris_rows(const HarrisRows& work) {
  constexpr int kTile = 128;
  constexpr int kRing = 2 * kWindowReach + 1;
  constexpr int kWide = kTile + 2 * kWindowReach + kMaxBytes / 4;  // products, and a vector's overhang
  const Float d;
  const hn::Rebind<int32_t, Float> d32;
  const hn::Rebind<uint8_t, Float> d8;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const cv::Mat1b& image = *work.image;
  uint8_t grey[3][kWide + 2 + kMaxBytes / 4] = {};
  float products[3][kWide + kMaxBytes / 4] = {};
  float ring[kRing][3][kTile + kMaxBytes / 4];
  float result[kTile + kMaxBytes / 4];
  const int x_end = image.cols - kHarrisBorder;
  for (int x0 = kHarrisBorder; x0 < x_end; x0 += kTile) {
    const int count = std::min(kTile, x_end - x0);
    const auto take_row = [&](int y) {
      std::copy_n(image[y] + x0 - kHarrisBorder, count + 2 * kHarrisBorder, grey[y % 3]);
    };
    take_row(work.y0 - kHarrisBorder);
    take_row(work.y0 - kHarrisBorder + 1);
    for (int row = work.y0 - kWindowReach; row < work.y1 + kWindowReach; ++row) {
      take_row(row + 1);
      const uint8_t *above = grey[(row - 1) % 3], *here = grey[row % 3], *below = grey[(row + 1) % 3];
      for (int i = 0; i < count + 2 * kWindowReach; i += lanes) {
        const auto at = [&](const uint8_t* line, int u) { return hn::PromoteTo(d32, hn::LoadU(d8, line + i + u)); };
        const auto a0 = at(above, 0), a1 = at(above, 1), a2 = at(above, 2), h0 = at(here, 0), h2 = at(here, 2),
                   b0 = at(below, 0), b1 = at(below, 1), b2 = at(below, 2);
        const auto falling = hn::Sub(b2, a0), rising = hn::Sub(a2, b0);
        const auto across = hn::Sub(h2, h0), down = hn::Sub(b1, a1);
        const auto dx = hn::ConvertTo(d, hn::Add(hn::Add(falling, rising), hn::Add(across, across)));
        const auto dy = hn::ConvertTo(d, hn::Add(hn::Sub(falling, rising), hn::Add(down, down)));
        hn::StoreU(hn::Mul(dx, dx), d, products[0] + i);
        hn::StoreU(hn::Mul(dx, dy), d, products[1] + i);
        hn::StoreU(hn::Mul(dy, dy), d, products[2] + i);
      }
      for (int k = 0; k < 3; ++k) {
        const float* columns[kRing];
        for (int j = 0; j < kRing; ++j) columns[j] = products[k] + j;
        float* const to = ring[row % kRing][k];
        for (int i = 0; i < count; i += lanes) hn::StoreU(smoothed(columns, i), d, to + i);
      }
      const int y = row - kWindowReach;
      if (y < work.y0) continue;
      const float* rows[3][kRing];
      for (int k = 0; k < 3; ++k)
        for (int j = 0; j < kRing; ++j) rows[k][j] = ring[(y - kWindowReach + j) % kRing][k];
      for (int i = 0; i < count; i += lanes) {
        const auto xx = smoothed(rows[0], i), xy = smoothed(rows[1], i), yy = smoothed(rows[2], i);
        const auto trace = hn::Add(xx, yy);
        const auto determinant = hn::Sub(hn::Mul(xx, yy), hn::Mul(xy, xy));
        const auto response = hn::Sub(determinant, hn::Mul(hn::Set(d, kKappa), hn::Mul(trace, trace)));
        hn::StoreU(hn::Mul(response, hn::Set(d, kUnit)), d, result + i);
      }
      std::copy_n(result, count, (*work.response)[y] + x0);
    }
  }
}

// Indices first <= x < end of a row's maxima. Reads up to a vector beyond `end`.
int maxima_of_row(const float* above, const float* here, const float* below, int first, int end, float threshold,
                  int* found) {
  const Float d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const auto least = hn::Set(d, threshold);
  int count = 0;
  for (int x = first; x < end; x += lanes) {
    const auto value = hn::LoadU(d, here + x);
    const auto strong = hn::Ge(value, least);
    if (hn::AllFalse(d, strong)) continue;
    const auto at = [&](const float* row, int u) { return hn::LoadU(d, row + x + u); };
    const auto before = hn::Max(hn::Max(at(above, -1), at(above, 0)), hn::Max(at(above, 1), at(here, -1)));
    const auto after = hn::Max(hn::Max(at(below, -1), at(below, 0)), hn::Max(at(below, 1), at(here, 1)));
    const auto is_maximum = hn::And(strong, hn::And(hn::Gt(value, before), hn::Ge(value, after)));
    if (hn::AllFalse(d, is_maximum)) continue;
    uint8_t bits[8] = {};
    hn::StoreMaskBits(d, is_maximum, bits);
    for (int i = 0; i < lanes && x + i < end; ++i) {
      if (bits[i / 8] >> (i % 8) & 1) found[count++] = x + i;
    }
  }
  return count;
}

void rank_square(const uint8_t* pixels, ptrdiff_t stride, uint8_t* ranks) {
  using Bytes = hn::CappedTag<uint8_t, 32>;
  const Bytes d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  constexpr int kWidth = 32;  // a whole number of vectors; what lies beyond the patch is overwritten by the next row
  uint8_t square[kPatchSpan][kWidth + kRankWindow + 5] = {};
  for (int j = 0; j < kPatchSpan; ++j) std::copy_n(pixels + j * stride, kPatchSpan, square[j]);
  uint8_t rows[(kPatchSize - 1) * kPatchSize + kWidth];
  for (int j = 0; j < kPatchSize; ++j) {
    for (int i = 0; i < kPatchSize; i += lanes) {
      const auto centre = hn::LoadU(d, square[j + kRankWindow / 2] + kRankWindow / 2 + i);
      auto rank = hn::Zero(d);
      for (int v = 0; v < kRankWindow; ++v) {
        for (int u = 0; u < kRankWindow; ++u) {
          const auto darker = hn::Lt(hn::LoadU(d, square[j + v] + u + i), centre);
          rank = hn::Sub(rank, hn::VecFromMask(d, darker));
        }
      }
      hn::StoreU(rank, d, rows + j * kPatchSize + i);
    }
  }
  std::copy_n(rows, kPatchSize * kPatchSize, ranks);
}

#if HWY_TARGET == HWY_SCALAR
int word_lanes() { return 1; }

void compare_patches(const PatchComparison& work) {
  for (int i = work.a_begin; i < work.a_end; ++i) {
    for (int j = 0; j < work.b_blocks; ++j) {
      const auto* p = reinterpret_cast<const uint8_t*>(work.a + static_cast<ptrdiff_t>(i) * kWords);
      const auto* q = reinterpret_cast<const uint8_t*>(work.b + static_cast<ptrdiff_t>(j) * kWords);
      int64_t sum = 0;
      for (int k = 0; k < 8 * kWords; ++k) sum += std::abs(p[k] - q[k]);
      int64_t &of_a = work.best_of_a[i - work.a_begin], &of_b = work.best_of_b[j];
      of_a = std::min(of_a, (sum << kIndexBits) + j);
      of_b = std::min(of_b, (sum << kIndexBits) + i);
    }
  }
}
#else
using Bytes = hn::CappedTag<uint8_t, kMaxBytes>;
using Words = hn::Repartition<int64_t, Bytes>;
using VecBytes = hn::Vec<Bytes>;
using VecWords = hn::Vec<Words>;

int word_lanes() { return static_cast<int>(hn::Lanes(Words())); }

// Sums of the absolute differences of each eight bytes.
HWY_INLINE VecWords sums_of_differences(VecBytes a, VecBytes b) {
#if HWY_TARGET == HWY_AVX3 || HWY_TARGET == HWY_AVX3_DL
  return VecWords{_mm512_sad_epu8(a.raw, b.raw)};
#elif HWY_TARGET == HWY_AVX2
  return VecWords{_mm256_sad_epu8(a.raw, b.raw)};
#elif HWY_TARGET == HWY_SSE4 || HWY_TARGET == HWY_SSSE3
  return VecWords{_mm_sad_epu8(a.raw, b.raw)};
#else
  const auto difference = hn::Or(hn::SaturatedSub(a, b), hn::SaturatedSub(b, a));
  return hn::BitCast(Words(), hn::SumsOf8(difference));
#endif
}

// A patch of a against as many of b as there are lanes, four patches of a at a time: each vector of b is loaded once
// for all of them.
void compare_patches(const PatchComparison& work) {
  constexpr int kTogether = 4;
  const Bytes d8;
  const Words d64;
  const int lanes = word_lanes();
  const auto lesser = [](VecWords a, VecWords b) { return hn::IfThenElse(hn::Lt(a, b), a, b); };
  for (int i = work.a_begin; i < work.a_end; i += kTogether) {
    const int64_t* a[kTogether];
    for (int k = 0; k < kTogether; ++k) {
      a[k] =
          reinterpret_cast<const int64_t*>(work.a) + static_cast<ptrdiff_t>(std::min(i + k, work.a_end - 1)) * kWords;
    }
    auto best0 = hn::Set(d64, std::numeric_limits<int64_t>::max()), best1 = best0, best2 = best0, best3 = best0;
    for (int block = 0; block < work.b_blocks; ++block) {
      const auto* b = reinterpret_cast<const int64_t*>(work.b) + static_cast<ptrdiff_t>(block) * kWords * lanes;
      auto sum0 = hn::Zero(d64), sum1 = sum0, sum2 = sum0, sum3 = sum0;
      for (int word = 0; word < kWords; ++word) {
        const auto of_b = hn::BitCast(d8, hn::LoadU(d64, b + static_cast<ptrdiff_t>(word) * lanes));
        const auto differences = [&](int k) {
          return sums_of_differences(hn::BitCast(d8, hn::Set(d64, a[k][word])), of_b);
        };
        sum0 = hn::Add(sum0, differences(0));
        sum1 = hn::Add(sum1, differences(1));
        sum2 = hn::Add(sum2, differences(2));
        sum3 = hn::Add(sum3, differences(3));
      }
      sum0 = hn::ShiftLeft<kIndexBits>(sum0);
      sum1 = hn::ShiftLeft<kIndexBits>(sum1);
      sum2 = hn::ShiftLeft<kIndexBits>(sum2);
      sum3 = hn::ShiftLeft<kIndexBits>(sum3);
      const auto index = hn::Iota(d64, static_cast<int64_t>(block) * lanes);
      best0 = lesser(hn::Add(sum0, index), best0);
      best1 = lesser(hn::Add(sum1, index), best1);
      best2 = lesser(hn::Add(sum2, index), best2);
      best3 = lesser(hn::Add(sum3, index), best3);
      // The last patch stands in for those missing behind it, at no other index than its own.
      const auto number = [&](int k) { return hn::Set(d64, std::min(i + k, work.a_end - 1)); };
      int64_t* const of_b = work.best_of_b + static_cast<ptrdiff_t>(block) * lanes;
      auto best = hn::LoadU(d64, of_b);
      best = lesser(hn::Add(sum0, number(0)), best);
      best = lesser(hn::Add(sum1, number(1)), best);
      best = lesser(hn::Add(sum2, number(2)), best);
      best = lesser(hn::Add(sum3, number(3)), best);
      hn::StoreU(best, d64, of_b);
    }
    const auto least_of = [&](VecWords best) {
      int64_t values[kMaxBytes / 8];
      hn::StoreU(best, d64, values);
      return *std::min_element(values, values + lanes);
    };
    const int64_t least[kTogether] = {least_of(best0), least_of(best1), least_of(best2), least_of(best3)};
    for (int k = 0; k < kTogether && i + k < work.a_end; ++k) work.best_of_a[i + k - work.a_begin] = least[k];
  }
}
#endif  // HWY_TARGET == HWY_SCALAR

}  // namespace iris::motion::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace iris::motion {

HWY_EXPORT(harris_rows);
HWY_EXPORT(maxima_of_row);
HWY_EXPORT(rank_square);
HWY_EXPORT(word_lanes);
HWY_EXPORT(compare_patches);

cv::Mat1f harris_response(const cv::Mat1b& image) {
  constexpr int kRowsPerChunk = 120;  // each begins with twelve rows that it shares with its neighbour
  cv::Mat1f response(image.size(), 0.0f);
  if (image.cols <= 2 * kHarrisBorder) return response;
  parallel_chunks(kHarrisBorder, image.rows - kHarrisBorder, kRowsPerChunk, [&](int y0, int y1) {
    HWY_DYNAMIC_DISPATCH(harris_rows)({.image = &image, .response = &response, .y0 = y0, .y1 = y1});
  });
  return response;
}

std::vector<Maximum> local_maxima(const cv::Mat1f& values, float threshold, int border) {
  IRIS_CHECK(border >= 1);
  std::vector<Maximum> maxima;
  if (values.cols <= 2 * border || values.rows <= 2 * border) return maxima;
  constexpr int kOverhang = 16;
  const int width = values.cols + kOverhang;
  std::vector<float> last_rows(3 * static_cast<size_t>(width));  // of the image: no vector may leave it
  std::vector<int> found(values.cols);
  for (int y = border; y < values.rows - border; ++y) {
    const float* rows[3] = {values[y - 1], values[y], values[y + 1]};
    if (y + 2 >= values.rows) {
      for (int i = 0; i < 3; ++i) {
        rows[i] = std::copy_n(rows[i], values.cols, &last_rows[static_cast<size_t>(i) * width]) - values.cols;
      }
    }
    const int count = HWY_DYNAMIC_DISPATCH(maxima_of_row)(rows[0], rows[1], rows[2], border, values.cols - border,
                                                          threshold, found.data());
    for (int i = 0; i < count; ++i) maxima.push_back({found[i], y, rows[1][found[i]]});
  }
  return maxima;
}

RankPatch rank_of_square(const uint8_t* pixels, ptrdiff_t stride) {
  RankPatch patch{};
  HWY_DYNAMIC_DISPATCH(rank_square)(pixels, stride, patch.data());
  return patch;
}

RankPatch rank_patch(const cv::Mat1b& image, int x, int y) {
  IRIS_CHECK(x >= kPatchBorder && y >= kPatchBorder && x < image.cols - kPatchBorder && y < image.rows - kPatchBorder);
  return rank_of_square(image[y - kPatchBorder] + x - kPatchBorder, static_cast<ptrdiff_t>(image.step[0]));
}

NearestPatches nearest_patches(const std::vector<RankPatch>& a, const std::vector<RankPatch>& b) {
  static_assert(sizeof(RankPatch) >= 8 * kWords);
  constexpr int64_t kNone = std::numeric_limits<int64_t>::max();
  constexpr int kPatchesPerChunk = 128;
  const int n_a = static_cast<int>(a.size()), n_b = static_cast<int>(b.size());
  NearestPatches result{.of_a = std::vector<NearestPatch>(a.size()), .of_b = std::vector<NearestPatch>(b.size())};
  if (a.empty() || b.empty()) return result;

  const int lanes = HWY_DYNAMIC_DISPATCH(word_lanes)(), blocks = (n_b + lanes - 1) / lanes;
  std::vector<uint64_t> words_a(a.size() * kWords), words_b(static_cast<size_t>(blocks) * lanes * kWords);
  for (int i = 0; i < n_a; ++i) std::memcpy(&words_a[static_cast<size_t>(i) * kWords], a[i].data(), 8 * kWords);
  for (int j = 0; j < blocks * lanes; ++j) {
    // Behind the last patch it stands again: at a higher index it is nobody's nearest.
    const uint8_t* const bytes = b[std::min(j, n_b - 1)].data();
    uint64_t* const to = &words_b[static_cast<size_t>(j / lanes) * lanes * kWords + j % lanes];
    for (int word = 0; word < kWords; ++word) std::memcpy(to + static_cast<size_t>(word) * lanes, bytes + 8 * word, 8);
  }
  const int chunks = (n_a + kPatchesPerChunk - 1) / kPatchesPerChunk;
  std::vector<int64_t> best_of_a(a.size(), kNone);
  std::vector<int64_t> best_of_b(static_cast<size_t>(chunks) * blocks * lanes, kNone);
  parallel_chunks(0, n_a, kPatchesPerChunk, [&](int begin, int end) {
    HWY_DYNAMIC_DISPATCH(compare_patches)
    ({.a = words_a.data(),
      .a_begin = begin,
      .a_end = end,
      .b = words_b.data(),
      .b_blocks = blocks,
      .best_of_a = &best_of_a[begin],
      .best_of_b = &best_of_b[static_cast<size_t>(begin / kPatchesPerChunk) * blocks * lanes]});
  });
  const auto nearest = [](int64_t best) {
    return NearestPatch{static_cast<int>(best >> kIndexBits), static_cast<int>(best & 0xffffffff)};
  };
  for (int i = 0; i < n_a; ++i) result.of_a[i] = nearest(best_of_a[i]);
  for (int j = 0; j < n_b; ++j) {
    int64_t best = kNone;
    for (int chunk = 0; chunk < chunks; ++chunk) {
      best = std::min(best, best_of_b[static_cast<size_t>(chunk) * blocks * lanes + j]);
    }
    result.of_b[j] = nearest(best);
  }
  return result;
}

}  // namespace iris::motion
#endif  // HWY_ONCE
