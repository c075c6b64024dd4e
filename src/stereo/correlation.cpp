#include "correlation.h"

#include <hwy/aligned_allocator.h>

#include <algorithm>
#include <cstddef>
#include <cstdlib>
#include <memory>
#include <mutex>
#include <vector>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

// Candidates lie along the vectors: everything that a column of windows needs is then loaded from aligned addresses,
// and a window's sum follows from the one to its left. The rows of a block are worked on in tiles of columns, so that
// what must be kept from row to row stays in the cache; with x for the column and d for the candidate:
//   pixels[row][x][d]   what each pixel contributes, for the rows inside of the windows (8 bits);
//   columns[x][d]       sum over the window's height, updated from row to row;
//   running[d]          sum over the whole window, updated from column to column (16 bits);
//   windows[row][x][d]  the same divided, for the rows that SAD5 needs;
//   costs[x][d]         SAD5 of the last kGroup columns.
// In one go along a row, each column goes through all of these steps up to the winner. Columns, windows and costs have
// 8 bits if they suffice (twice the lanes, half the memory), else 16.
#ifndef IRIS_STEREO_CORRELATION_BLOCK
#define IRIS_STEREO_CORRELATION_BLOCK
namespace iris::stereo {

inline constexpr int kMaxLanes = 16;  // 16-bit lanes used at most, twice as many of 8 bits: wider vectors gain nothing
inline constexpr int kGroup = 8;      // columns after which the search from the right takes part

// Memory that one block after the other works in.
class Scratch {
 public:
  // Room for `count` values, unknown ones, until restart().
  template <class T>
  T* take(size_t count) {
    if (used_ == parts_.size()) parts_.emplace_back();
    Part& part = parts_[used_++];
    if (part.size < count * sizeof(T)) {
      part.size = count * sizeof(T);
      part.bytes = hwy::AllocateAligned<uint8_t>(part.size);
    }
    return reinterpret_cast<T*>(part.bytes.get());
  }
  template <class T>
  T* take_filled(size_t count, T value) {
    T* const values = take<T>(count);
    std::fill_n(values, count, value);
    return values;
  }
  void restart() { used_ = 0; }

  Correlation rows;

 private:
  struct Part {
    size_t size = 0;
    hwy::AlignedFreeUniquePtr<uint8_t[]> bytes;
  };
  std::vector<Part> parts_;
  size_t used_ = 0;
};

// Rows of both images, with room beside them, and where the output for the rows y0 … y1 - 1 goes.
struct CorrelationBlock {
  const MatchImage* left;
  const uint8_t* right;  // pixel (0, 0); mirrored: x grows towards lower addresses
  ptrdiff_t right_stride;
  ptrdiff_t right_plane;  // from the image to each of the three planes of its census
  bool census;
  bool bytes;  // suffice for columns, windows and costs
  int width, height;
  CorrelationParameters parameters;
  int tile;  // columns worked on together, a multiple of kGroup
  int y0, y1;
  Correlation* out;  // y1 - y0 rows
  Scratch* scratch;
};

}  // namespace iris::stereo
#endif  // IRIS_STEREO_CORRELATION_BLOCK

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "../src/stereo/correlation.cpp"  // seen from include/
#include <hwy/foreach_target.h>                             // IWYU pragma: keep
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
  struct Row {
    const uint8_t* grey;
    ptrdiff_t right_plane;
    int cap;
    Row(const MatchImage& left, int y, ptrdiff_t plane, int cap) : grey(left.grey[y]), right_plane(plane), cap(cap) {}
  };
  HWY_INLINE DifferenceCost(const Row& row, int x)
      : left_(hn::Set(Tag8(), row.grey[x])), cap_(hn::Set(Tag8(), static_cast<uint8_t>(row.cap))) {}
  HWY_INLINE Vec8 at(const uint8_t* right) const {
    const auto b = hn::LoadU(Tag8(), right);
    return hn::Min(hn::Sub(hn::Max(left_, b), hn::Min(left_, b)), cap_);
  }

 private:
  Vec8 left_, cap_;
};

class CensusCost {
 public:
  struct Row : DifferenceCost::Row {
    const uint8_t *a, *b, *c;
    Row(const MatchImage& left, int y, ptrdiff_t plane, int cap)
        : DifferenceCost::Row(left, y, plane, cap), a(left.census[0][y]), b(left.census[1][y]), c(left.census[2][y]) {}
  };
  HWY_INLINE CensusCost(const Row& row, int x)
      : difference_(row, x),
        a_(hn::Set(Tag8(), row.a[x])),
        b_(hn::Set(Tag8(), row.b[x])),
        c_(hn::Set(Tag8(), row.c[x])),
        right_plane_(row.right_plane) {}
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

// Lanes of columns, windows and costs: uint8_t or uint16_t.
template <class T>
struct LanesOf {
  using Tag = Tag16;
};
template <>
struct LanesOf<uint8_t> {
  using Tag = Tag8;
};
template <class T>
using TagOf = typename LanesOf<T>::Tag;
template <class T>
inline constexpr T kNothing = static_cast<T>(-1);  // window or cost of what does not exist

// The lowest lanes of kGroup vectors, in the low bits of numbers in memory: [i] for vector i.
class LowestLanes {
 public:
  // Each step halves what remains of two vectors and puts it into one, or of one.
  HWY_INLINE explicit LowestLanes(Vec16* v) {
#if HWY_TARGET == HWY_SCALAR
    for (int i = 0; i < kGroup; ++i) at_[i] = hn::GetLane(v[i]);
#else
    const Tag16 d16;
    const hn::Repartition<uint64_t, Tag16> d64;
    int n = kGroup;
    if constexpr (kTwoBlocks) {  // vectors i and i + n
      n /= 2;
      for (int i = 0; i < n; ++i) {
        v[i] = hn::Min(hn::ConcatLowerLower(d16, v[i + n], v[i]), hn::ConcatUpperUpper(d16, v[i + n], v[i]));
      }
    }
    for (int i = 0; i < n; i += 2) {
      const auto a = hn::BitCast(d64, v[i]), b = hn::BitCast(d64, v[i + 1]);
      auto low =
          hn::Min(hn::BitCast(d16, hn::InterleaveLower(d64, a, b)), hn::BitCast(d16, hn::InterleaveUpper(d64, a, b)));
      low = hn::Min(low, hn::BitCast(d16, hn::ShiftRight<32>(hn::BitCast(d64, low))));
      low = hn::Min(low, hn::BitCast(d16, hn::ShiftRight<16>(hn::BitCast(d64, low))));
      hn::Store(hn::BitCast(d64, low), d64, at_ + (kTwoBlocks ? 2 * i : i));
    }
#endif
  }
  HWY_INLINE uint16_t operator[](int i) const {
    return static_cast<uint16_t>(at_[kTwoBlocks ? (i & 1) | ((i & 4) >> 1) | ((i & 2) << 1) : i]);
  }

 private:
  static constexpr bool kTwoBlocks = hn::MaxLanes(Tag16()) > 8;
  static_assert(kGroup == 8);
  alignas(64) uint64_t at_[kGroup];
};

// What remains of the costs of one pixel: for each lane the lowest two and the candidate of the lowest.
template <class T>
struct Lowest {
  alignas(2 * kMaxLanes) T best[2 * kMaxLanes / sizeof(T)];
  alignas(2 * kMaxLanes) T second[2 * kMaxLanes / sizeof(T)];
  alignas(2 * kMaxLanes) T best_d[2 * kMaxLanes / sizeof(T)];
};

// The windows around pixels of one row, candidate after candidate, pixel after pixel.
template <class T>
struct Windows {
  const T *middle, *upper_left, *upper_right, *lower_left;  // the fourth comes as a vector
};

// Costs of one pixel, candidate after candidate.
template <class T>
class Combination {
 public:
  using Tag = TagOf<T>;
  using Vector = hn::Vec<Tag>;
  HWY_INLINE Combination()
      : best_(hn::Set(Tag(), kNothing<T>)),
        second_(best_),
        best_d_(best_),
        d_(hn::Iota(Tag(), 0)),
        step_(hn::Set(Tag(), static_cast<T>(hn::Lanes(Tag())))) {}

  // The next candidates' costs: C0 + the two lowest of the four supporting windows (3.1). These are either both upper,
  // both lower, or the lower one of each: four comparisons (A.3). Sums saturate: nothing stays nothing. Bits of
  // `nothing` are set for what is no candidate.
  HWY_INLINE void add(const Windows<T>& windows, Vector lower_right, ptrdiff_t at, Vector nothing,
                      T* HWY_RESTRICT cost) {
    const Tag d;
    const auto a = hn::Load(d, windows.upper_left + at), b = hn::Load(d, windows.upper_right + at);
    const auto c = hn::Load(d, windows.lower_left + at);
    const auto mixed = hn::SaturatedAdd(hn::Min(a, b), hn::Min(c, lower_right));
    const auto two = hn::Min(hn::Min(hn::SaturatedAdd(a, b), hn::SaturatedAdd(c, lower_right)), mixed);
    const auto sum = hn::Or(hn::SaturatedAdd(hn::Load(d, windows.middle + at), two), nothing);
    hn::Store(sum, d, cost);
    const auto lower = hn::Min(best_, sum);
    second_ = hn::Min(second_, hn::Max(best_, sum));
    best_d_ = hn::IfThenElse(hn::Eq(lower, best_), best_d_, d_);
    best_ = lower;
    d_ = hn::Add(d_, step_);
  }

  HWY_INLINE void store(Lowest<T>* HWY_RESTRICT to) const {
    const Tag d;
    hn::Store(best_, d, to->best);
    hn::Store(second_, d, to->second);
    hn::Store(best_d_, d, to->best_d);
  }

 private:
  Vector best_, second_, best_d_, d_, step_;
};

// Second minima (3.4): their lowest lane is the second minimum. The winner and its neighbours are in different lanes:
// in each of the three, it is the second lowest cost that counts if the lowest is that of the winner or its neighbour.
template <class T>
HWY_INLINE hn::Vec<TagOf<T>> rivals(const Lowest<T>& lowest, T winner) {
  const TagOf<T> d;
  const auto best_d = hn::Load(d, lowest.best_d), winners = hn::Set(d, winner);
  const auto away = hn::Sub(hn::Max(best_d, winners), hn::Min(best_d, winners));
  const auto near = hn::Eq(hn::Min(away, hn::Set(d, T{1})), away);
  return hn::IfThenElse(near, hn::Load(d, lowest.second), hn::Load(d, lowest.best));
}

// Of kGroup pixels: the lowest costs, the smallest candidates that have them (0 if there is none), the second minima.
template <class T>
struct Selected {
  T cost[kGroup], winner[kGroup], second[kGroup];
};
HWY_INLINE void find_lowest(const Lowest<uint16_t>* lowest, Selected<uint16_t>* HWY_RESTRICT to) {
  const Tag16 d;
  const auto none = hn::Set(d, kNothing<uint16_t>);
  Vec16 v[kGroup];
  for (int i = 0; i < kGroup; ++i) v[i] = hn::Load(d, lowest[i].best);
  const LowestLanes costs(v);
  for (int i = 0; i < kGroup; ++i) {
    const auto wins = hn::Eq(hn::Load(d, lowest[i].best), hn::Set(d, costs[i]));
    v[i] = hn::IfThenElse(wins, hn::Load(d, lowest[i].best_d), none);
  }
  const LowestLanes winners(v);
  for (int i = 0; i < kGroup; ++i) {
    to->cost[i] = costs[i];
    to->winner[i] = costs[i] == kNothing<uint16_t> ? 0 : winners[i];
    v[i] = rivals(lowest[i], to->winner[i]);
  }
  const LowestLanes seconds(v);
  for (int i = 0; i < kGroup; ++i) to->second[i] = seconds[i];
}
#if HWY_TARGET != HWY_SCALAR
HWY_INLINE void find_lowest(const Lowest<uint8_t>* lowest, Selected<uint8_t>* HWY_RESTRICT to) {
  const Tag8 d;
  const Tag16 d16;
  const auto low_byte = hn::Set(d16, uint16_t{255});
  Vec16 v[kGroup];
  for (int i = 0; i < kGroup; ++i) {  // cost and candidate in one number
    const auto best = hn::Load(d, lowest[i].best), best_d = hn::Load(d, lowest[i].best_d);
    v[i] = hn::Min(hn::BitCast(d16, hn::InterleaveLower(d, best_d, best)),
                   hn::BitCast(d16, hn::InterleaveUpper(d, best_d, best)));
  }
  const LowestLanes both(v);
  for (int i = 0; i < kGroup; ++i) {
    const uint16_t value = both[i];
    to->cost[i] = static_cast<uint8_t>(value >> 8);
    to->winner[i] = static_cast<uint8_t>(value >= 0xFF00 ? 0 : value);
    const auto pairs = hn::BitCast(d16, rivals(lowest[i], to->winner[i]));
    v[i] = hn::Min(hn::And(pairs, low_byte), hn::ShiftRight<8>(pairs));
  }
  const LowestLanes seconds(v);
  for (int i = 0; i < kGroup; ++i) to->second[i] = static_cast<uint8_t>(seconds[i]);
}
#endif

// The rows of the output.
struct OutputRows {
  uint16_t *winner, *cost, *second, *before, *after;
};

// kGroup values.
using TagOut = hn::CappedTag<uint16_t, kGroup>;
HWY_INLINE hn::Vec<TagOut> load_out(const uint16_t* values) { return hn::LoadU(TagOut(), values); }
HWY_INLINE hn::Vec<TagOut> load_out(const uint8_t* values) {
  return hn::PromoteTo(TagOut(), hn::LoadU(hn::Rebind<uint8_t, TagOut>(), values));
}

// The pixels x … x + n - 1 of a group, with costs at so many candidates.
template <class T>
HWY_NOINLINE void select(const Lowest<T>* lowest, const T* costs, ptrdiff_t cost_stride, int candidates, int x, int n,
                         const OutputRows& to) {
  const TagOut d;
  Selected<T> selected;
  find_lowest(lowest, &selected);
  T before[kGroup], after[kGroup];
  for (int i = 0; i < kGroup; ++i) {
    const T* const at_winner = costs + cost_stride * i + selected.winner[i];
    before[i] = at_winner[-1];
    after[i] = at_winner[1];
  }
  if (hn::Lanes(Tag16()) < 3) {  // too few for rivals()
    for (int i = 0; i < kGroup; ++i) {
      selected.second[i] = kNothing<T>;
      for (int k = 0; k < candidates; ++k) {
        const T cost = costs[cost_stride * i + k];
        if (std::abs(k - selected.winner[i]) > 1) selected.second[i] = std::min(selected.second[i], cost);
      }
    }
  }
  const auto write = [&](const T* value, const T* known, uint16_t* out) HWY_ATTR {
    uint16_t few[kGroup];
    uint16_t* const at = n == kGroup ? out + x : few;
    for (int i = 0; i < kGroup; i += static_cast<int>(hn::Lanes(d))) {
      const auto exists = hn::Ne(load_out(known + i), hn::Set(d, uint16_t{kNothing<T>}));
      hn::StoreU(hn::IfThenElse(exists, load_out(value + i), hn::Set(d, Correlation::kNone)), d, at + i);
    }
    if (n < kGroup) std::copy_n(few, n, out + x);
  };
  write(selected.winner, selected.cost, to.winner);
  write(selected.cost, selected.cost, to.cost);
  write(selected.second, selected.second, to.second);
  write(before, before, to.before);
  write(after, after, to.after);
}

// The search from the right image, as far as kGroup columns of the left one, from x on, take part in it: right pixels
// lie along the vectors as the candidates do in the first of the columns, and meet the next candidate in the next
// column. best_x: the last bits of the column where the lowest cost was.
template <class T>
HWY_INLINE void search_right(const T* cost, ptrdiff_t cost_stride, int x, int end, T* best, T* best_x) {
  const TagOf<T> d;
  for (int i = 1 - kGroup; i < end; i += static_cast<int>(hn::Lanes(d))) {
    auto b = hn::LoadU(d, best + i);
    auto bx = hn::LoadU(d, best_x + i);
    for (int k = 0; k < kGroup; ++k) {
      const auto lower = hn::Min(b, hn::LoadU(d, cost + i + k * (cost_stride + 1)));
      bx = hn::IfThenElse(hn::Eq(lower, b), bx, hn::Set(d, static_cast<T>(x + k)));
      b = lower;
    }
    hn::StoreU(b, d, best + i);
    hn::StoreU(bx, d, best_x + i);
  }
}

// As many values as a vector of 16-bit numbers holds.
HWY_INLINE Vec16 load_wide(const uint16_t* values) { return hn::LoadU(Tag16(), values); }
HWY_INLINE Vec16 load_wide(const uint8_t* values) {
  return hn::PromoteTo(Tag16(), hn::LoadU(hn::Rebind<uint8_t, Tag16>(), values));
}

// The winners of a row of the right image. best, best_x: as in search_right, pixel x at index -x.
template <class T>
void store_right(const T* best, const T* best_x, int width, int min_disparity, uint16_t* HWY_RESTRICT out) {
  const Tag16 d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const auto mask = hn::Set(d, uint16_t{kNothing<T>}), none = hn::Set(d, Correlation::kNone);
  for (int x = 0; x < width; x += lanes) {
    const int at = std::min(x, std::max(0, width - lanes));  // the last vector overlaps the one before it
    const ptrdiff_t last = -(at + lanes - 1);
    const auto of_pixel =
        hn::Add(hn::Iota(d, static_cast<uint16_t>(at)), hn::Set(d, static_cast<uint16_t>(min_disparity)));
    const auto found = hn::Sub(hn::Reverse(d, load_wide(best_x + last)), of_pixel);
    const auto exists = hn::Ne(hn::Reverse(d, load_wide(best + last)), mask);
    const auto winner = hn::IfThenElse(exists, hn::And(found, mask), none);
    if (at + lanes <= width) {
      hn::StoreU(winner, d, out + at);
    } else {
      uint16_t narrow[kMaxLanes];
      hn::StoreU(winner, d, narrow);
      std::copy_n(narrow, width, out);
    }
  }
}

// Where the sums of one column are, at all candidates; those of another one of its row are `at` values further on.
template <class T>
struct Column {
  const uint8_t* right;  // at the first candidate
  uint8_t* pixel;        // contributions of the row that leaves the window; replaced by those that enter
  T* sums;               // over the window's height
  const T* leaves;       // sums of the column that leaves the window
  uint16_t* running;     // sums over the window (of each vector of bytes, the even candidates come first)
  T* window;             // these, divided by 2^shift
  int shift;
};

// The window moves on: the sums of a column enter, others leave. Returns what was stored as its sums.
HWY_INLINE Vec16 move_window(const Column<uint16_t>& c, Vec16 enters, ptrdiff_t at, int d) {
  const Tag16 d16;
  const auto whole = hn::Add(hn::Load(d16, c.running + d), hn::Sub(enters, hn::Load(d16, c.leaves + at + d)));
  hn::Store(whole, d16, c.running + d);
  const auto window = hn::ShiftRightSame(whole, c.shift);
  hn::Store(window, d16, c.window + at + d);
  return window;
}

// As many sums as one vector of bytes holds, from those of the row above: contributions `in` enter, `out` leave.
template <bool kWindows, class Next>
HWY_INLINE void move_sums(const Column<uint16_t>& c, Vec8 in, Vec8 out, ptrdiff_t at, int begin, const Next& next) {
  const Tag16 d16;
  const auto half = [&](Vec16 in16, Vec16 out16, int d) HWY_ATTR {
    const auto sum = hn::Sub(hn::Add(hn::Load(d16, c.sums + at + d), in16), out16);
    hn::Store(sum, d16, c.sums + at + d);
    if constexpr (kWindows) next(move_window(c, sum, at, d), d);
  };
#if HWY_TARGET == HWY_SCALAR
  half(hn::PromoteTo(d16, in), hn::PromoteTo(d16, out), begin);
#else
  const hn::Rebind<uint8_t, Tag16> d8;
  const int lanes = static_cast<int>(hn::Lanes(d16));
  half(hn::PromoteTo(d16, hn::LowerHalf(d8, in)), hn::PromoteTo(d16, hn::LowerHalf(d8, out)), begin);
  half(hn::PromoteTo(d16, hn::UpperHalf(d8, in)), hn::PromoteTo(d16, hn::UpperHalf(d8, out)), begin + lanes);
#endif
}

#if HWY_TARGET != HWY_SCALAR  // whose vectors of 16 bits cannot be taken for vectors of bytes

HWY_INLINE Vec8 move_window(const Column<uint8_t>& c, Vec8 enters, ptrdiff_t at, int d) {
  const Tag16 d16;
  const Tag8 d8;
  const auto low_byte = hn::Set(d16, uint16_t{255});
  const auto in = hn::BitCast(d16, enters), out = hn::BitCast(d16, hn::Load(d8, c.leaves + at + d));
  uint16_t* const running = c.running + d;
  uint16_t* const running_odd = running + hn::Lanes(d16);
  const auto even = hn::Add(hn::Load(d16, running), hn::Sub(hn::And(in, low_byte), hn::And(out, low_byte)));
  const auto odd = hn::Add(hn::Load(d16, running_odd), hn::Sub(hn::ShiftRight<8>(in), hn::ShiftRight<8>(out)));
  hn::Store(even, d16, running);
  hn::Store(odd, d16, running_odd);
  const auto high = hn::AndNot(low_byte, hn::ShiftLeftSame(odd, 8 - c.shift));
  const auto window = hn::BitCast(d8, hn::Or(hn::ShiftRightSame(even, c.shift), high));
  hn::Store(window, d8, c.window + at + d);
  return window;
}

template <bool kWindows, class Next>
HWY_INLINE void move_sums(const Column<uint8_t>& c, Vec8 in, Vec8 out, ptrdiff_t at, int d, const Next& next) {
  const Tag8 d8;
  const auto sum = hn::Add(hn::Load(d8, c.sums + at + d), hn::Sub(in, out));  // modulo 256
  hn::Store(sum, d8, c.sums + at + d);
  if constexpr (kWindows) next(move_window(c, sum, at, d), d);
}

#endif

// The sums of a column become those of the next row; contributions are what `masked` leaves of them. If kWindows, the
// window moves on to this column; its sums go to next(sums, candidate) as well. Else nothing leaves the column.
template <bool kWindows, class Cost, class T, class Mask, class Next>
HWY_INLINE void move_column(const Cost& cost, const Column<T>& c, const uint8_t* right, ptrdiff_t at, int end,
                            const Mask& masked, const Next& next) {
  const Tag8 d8;
  for (int d = 0; d < end; d += static_cast<int>(hn::Lanes(d8))) {
    const auto in = masked(cost.at(right + d), d);
    const auto out = hn::Load(d8, c.pixel + at + d);
    hn::Store(in, d8, c.pixel + at + d);
    move_sums<kWindows>(c, in, kWindows ? out : hn::Zero(d8), at, d, next);
  }
}

template <class Cost, class T>
void correlate_rows(const CorrelationBlock& block) {
  const CorrelationParameters& p = block.parameters;
  const TagOf<T> tag;
  const Tag8 d8;
  const int lanes = static_cast<int>(hn::Lanes(tag)), lanes8 = static_cast<int>(hn::Lanes(d8));
  const int rx = p.window_width / 2, ry = p.window_height / 2;
  const int ring = 2 * ry + 1;
  const ptrdiff_t stride = (p.disparities + lanes8 - 1) / lanes8 * lanes8;  // of candidates, per column
  const int n_columns = block.tile + 4 * rx, n_windows = block.tile + 2 * rx;
  const ptrdiff_t window_ring = stride * n_windows, pixel_ring = stride * n_columns;
  constexpr int kBeside = 2 * kMaxLanes;  // what vectors may reach beyond either end of a row of costs
  const ptrdiff_t cost_stride = stride + 2 * kBeside;
  Scratch& scratch = *block.scratch;
  uint8_t* const pixels = scratch.take<uint8_t>(pixel_ring * ring);
  const ptrdiff_t columns_size = stride * (n_columns + 2 * rx + 1);
  T* const columns_store = scratch.take<T>(columns_size);
  T* const columns = columns_store + stride * (2 * rx + 1);  // zeros before it
  T* const windows = scratch.take<T>(window_ring * ring);
  T* const unused = scratch.take<T>(stride);  // windows that nobody asks for
  uint16_t* const running = scratch.take<uint16_t>(stride);
  T* const costs = scratch.take_filled(cost_stride * (kGroup + 1), kNothing<T>) + kBeside;
  // Masks: all bits set from index stride to 2 stride; nothing from index `disparities`.
  uint8_t* const mask = scratch.take_filled(3 * stride + lanes8, uint8_t{0});
  std::fill_n(mask + stride, stride, uint8_t{255});
  T* const no_candidate = scratch.take_filled(stride, T{0});
  std::fill(no_candidate + p.disparities, no_candidate + stride, kNothing<T>);
  // Nothing outside of the indices stride to 2 stride, 0 in them.
  T* const no_window = scratch.take_filled(3 * stride + lanes, kNothing<T>);
  std::fill_n(no_window + stride, stride, T{0});
  // Window's width / columns inside, in units of 2^-kEnlargeBits and rounded up: products with sums of 16 bits are
  // exact when truncated, since no fraction is closer to 1 than 1 / columns.
  constexpr int kEnlargeBits = 40;
  uint64_t* const enlarge = scratch.take<uint64_t>(p.window_width + 1);
  for (int i = 1; i <= p.window_width; ++i) {
    enlarge[i] = ((uint64_t{1} << kEnlargeBits) * p.window_width + i - 1) / i;
  }
  // State of the search from the right, for every row of the block. Mirrored: pixel x has index right_origin - x.
  const int right_origin = block.width + std::abs(p.min_disparity) + kBeside;
  const ptrdiff_t right_stride = right_origin + std::abs(p.min_disparity) + stride + kBeside;
  T* const right_best = scratch.take_filled(right_stride * (block.y1 - block.y0), kNothing<T>);
  T* const right_x = scratch.take_filled(right_stride * (block.y1 - block.y0), T{0});

  // Candidates first … last have a partner for column x of the image. Others are beyond either side.
  const auto first_candidate = [&](int x) {
    return std::clamp(x - p.min_disparity - (block.width - 1), 0, p.disparities);
  };
  const auto last_candidate = [&](int x) { return std::clamp(x - p.min_disparity, -1, p.disparities - 1); };
  int* const first_of = scratch.take<int>(block.width);
  int* const last_of = scratch.take<int>(block.width);
  for (int x = 0; x < block.width; ++x) {
    first_of[x] = first_candidate(x);
    last_of[x] = last_candidate(x);
  }
  // All candidates of the columns up to x are before this one.
  const int n_ends = block.width + 2 * rx + block.tile;
  int* const candidates_end = scratch.take<int>(n_ends);
  for (int x = 0; x < n_ends; ++x) {
    candidates_end[x] = (last_candidate(std::min(x, block.width - 1)) + lanes8) / lanes8 * lanes8;
  }
  int* const slot = scratch.take<int>(block.height + 2 * ry);  // of row - ry in the rings
  for (int i = 0; i < block.height + 2 * ry; ++i) slot[i] = i % ring;
  Lowest<T> lowest[kGroup] = {};

  for (int x0 = 0; x0 < block.width; x0 += block.tile) {
    const int x1 = std::min(x0 + block.tile, block.width);
    const int x_columns = x0 - 2 * rx, x_windows = x0 - rx;  // image column of index 0
    std::fill_n(columns_store, columns_size, T{0});
    for (int i = 0; i < ring; ++i) {  // beyond the sides of the image there are no windows
      T* const row = windows + window_ring * i;
      std::fill_n(row, stride * std::clamp(-x_windows, 0, n_windows), kNothing<T>);
      const int outside = std::clamp(block.width - x_windows, 0, n_windows);
      std::fill(row + stride * outside, row + window_ring, kNothing<T>);
    }

    // Column x_columns of the windows that end at image row `row`.
    const auto first_column = [&](int row) -> Column<T> {
      const int inside = std::clamp(row, 0, block.height - 1);
      return {.right = block.right + block.right_stride * inside - (x_columns - p.min_disparity),
              .pixel = pixels + pixel_ring * slot[row + ry],
              .sums = columns,
              .leaves = columns - stride * (2 * rx + 1),
              .running = running,
              .window = nullptr,
              .shift = p.shift};
    };
    const auto column_at = [&](const Column<T>& first, int x, T* window) HWY_ATTR -> Column<T> {
      const ptrdiff_t i = x - x_columns;
      return {.right = first.right - i,
              .pixel = first.pixel + stride * i,
              .sums = first.sums + stride * i,
              .leaves = first.leaves + stride * i,
              .running = first.running,
              .window = window,
              .shift = first.shift};
    };
    const auto left_row = [&](int row) {
      return typename Cost::Row(*block.left, std::clamp(row, 0, block.height - 1), block.right_plane, p.cap);
    };
    const auto all = [](Vec8 in, int) HWY_ATTR { return in; };
    const auto ignore = [](auto, int) {};
    const auto move = [&]<bool kWindows>(const typename Cost::Row& left, const Column<T>& first, int x,
                                         T* window) HWY_ATTR {
      const uint8_t* const from_first = mask + stride - first_of[x];
      const uint8_t* const to_last = mask + 2 * stride - (last_of[x] + 1);
      const auto existing = [&](Vec8 in, int d) HWY_ATTR {
        return hn::And(in, hn::And(hn::LoadU(d8, from_first + d), hn::LoadU(d8, to_last + d)));
      };
      const Column<T> column = column_at(first, x, window);
      move_column<kWindows>(Cost(left, x), column, column.right, 0, candidates_end[x], existing, ignore);
    };

    // Where all candidates of a window's last column exist, and the window is kept and not cut.
    const int whole_begin = std::max({x0, 2 * rx, 2 * rx + p.min_disparity + p.disparities - 1});
    const int whole_end = block.width + std::min(0, p.min_disparity);

    // Sums over the windows of row y that end at column x_end.
    const auto window_column = [&](const typename Cost::Row& left, const Column<T>& first_of_row, int y,
                                   int x_end) HWY_ATTR {
      const int x = x_end - rx;
      T* const kept = windows + window_ring * slot[y + ry] + stride * (x - x_windows);
      if (x_end >= whole_begin && x_end < whole_end) {
        const Column<T> column = column_at(first_of_row, x_end, kept);
        move_column<true>(Cost(left, x_end), column, column.right, 0, static_cast<int>(stride), all, ignore);
        return;
      }
      const bool wanted = x >= x_windows && x >= 0 && x < block.width;
      T* const window = wanted ? kept : unused;
      const int end = candidates_end[x_end];
      if (x_end >= block.width) {
        const Column<T> column = column_at(first_of_row, x_end, window);
        for (int d = 0; d < end; d += lanes) move_window(column, hn::Zero(tag), 0, d);
      } else {
        move.template operator()<true>(left, first_of_row, x_end, window);
      }
      if (!wanted) return;
      const int first = first_of[x], last = last_of[x];
      for (int d = 0; d < end; d += lanes) {
        const auto before = hn::LoadU(tag, no_window + stride - first + d);
        const auto behind = hn::LoadU(tag, no_window + 2 * stride - (last + 1) + d);
        hn::Store(hn::Or(hn::Load(tag, window + d), hn::Or(before, behind)), tag, window + d);
      }
      const auto scale = [&](int d) {  // a cut window
        const int a = std::max(0, p.min_disparity + d);
        const int b = std::min(block.width - 1, block.width - 1 + p.min_disparity + d);
        const int visible = std::min(x + rx, b) - std::max(x - rx, a) + 1;
        const int at = sizeof(T) == 2 ? d : d / lanes * lanes + d % 2 * (lanes / 2) + d % lanes / 2;
        window[d] = static_cast<T>((running[at] * enlarge[visible]) >> kEnlargeBits >> p.shift);
      };
      // Not cut: those that have a partner for both ends of the window.
      const bool inside = x >= rx && x + rx < block.width;
      const int cut_end = inside ? std::clamp(first_of[x + rx], first, last + 1) : last + 1;
      const int cut_begin = inside ? std::clamp(last_of[x - rx] + 1, cut_end, last + 1) : last + 1;
      for (int d = first; d < cut_end; ++d) scale(d);
      for (int d = cut_begin; d <= last; ++d) scale(d);
    };

    const auto window_row = [&](int row) {
      return windows + window_ring * slot[std::clamp(row, 0, block.height - 1) + ry];
    };
    const int first_row = std::max(0, block.y0 - ry);
    std::fill_n(pixels + pixel_ring * slot[first_row + 2 * ry], pixel_ring, uint8_t{0});  // leave the first windows
    for (int row = first_row - ry; row < first_row + ry; ++row) {
      const typename Cost::Row left = left_row(row);
      const Column<T> first = first_column(row);
      for (int x = std::max(0, x_columns); x < std::min(x1 + 2 * rx, block.width); ++x) {
        move.template operator()<false>(left, first, x, nullptr);
      }
    }
    for (int y_windows = first_row; y_windows < block.y1 + ry; ++y_windows) {
      const int y = y_windows - ry;
      const bool has_windows = y_windows < block.height;
      const typename Cost::Row left = left_row(y_windows + ry);
      const Column<T> first = first_column(std::min(y_windows, block.height - 1) + ry);
      std::fill_n(running, stride, uint16_t{0});
      if (y < block.y0) {
        for (int x_end = std::max(0, x_columns); x_end < x1 + 2 * rx; ++x_end) {
          window_column(left, first, y_windows, x_end);
        }
        continue;
      }
      if (has_windows) {
        for (int x_end = std::max(0, x_columns); x_end < x0 + 2 * rx; ++x_end) {
          window_column(left, first, y_windows, x_end);
        }
      }
      T* const lower_right = window_row(y + ry) + 2 * rx * stride;
      const Windows<T> around = {.middle = window_row(y) + rx * stride,
                                 .upper_left = window_row(y - ry),
                                 .upper_right = window_row(y - ry) + 2 * rx * stride,
                                 .lower_left = window_row(y + ry)};
      Correlation& rows = *block.out;
      const int row = y - block.y0;
      const OutputRows out = {rows.winner[row], rows.cost[row], rows.second[row], rows.before[row], rows.after[row]};
      const Column<T> fused = column_at(first, x0 + 2 * rx, lower_right);
      for (int group = x0; group < x1; group += kGroup) {
        const int group_end = std::min(group + kGroup, x1);
        for (int x = group; x < group_end; ++x) {
          const int x_end = x + 2 * rx;
          const ptrdiff_t at = stride * (x - x0);
          T* const cost = costs + cost_stride * (x - group);
          Combination<T> combination;
          if (has_windows && x_end >= whole_begin && x_end < whole_end) {
            const auto combine = [&](auto window, int d) HWY_ATTR {
              combination.add(around, window, at + d, hn::LoadU(tag, no_candidate + d), cost + d);
            };
            move_column<true>(Cost(left, x_end), fused, fused.right - (x - x0), at, static_cast<int>(stride), all,
                              combine);
          } else {
            if (has_windows) window_column(left, first, y_windows, x_end);
            const int end = candidates_end[x];
            for (int d = 0; d < end; d += lanes) {
              combination.add(around, hn::Load(tag, lower_right + at + d), at + d, hn::LoadU(tag, no_candidate + d),
                              cost + d);
            }
            std::fill(cost + end, cost + stride, kNothing<T>);
          }
          combination.store(&lowest[x - group]);
        }
        for (int i = group_end - group; i < kGroup; ++i) std::fill_n(costs + cost_stride * i, stride, kNothing<T>);
        select(lowest, costs, cost_stride, static_cast<int>(stride), group, group_end - group, out);
        const int end = candidates_end[group_end - 1];
        const ptrdiff_t at = right_stride * (y - block.y0) + right_origin - group + p.min_disparity;
        search_right(costs, cost_stride, group, end, &right_best[at], &right_x[at]);
      }
    }
  }
  for (int row = 0; row < block.y1 - block.y0; ++row) {
    const ptrdiff_t at = right_stride * row + right_origin;
    store_right(right_best + at, right_x + at, block.width, p.min_disparity, block.out->right_winner[row]);
  }
}

void correlate_block(const CorrelationBlock& block) {
  if (block.census) {
    correlate_rows<CensusCost, uint16_t>(block);
    return;
  }
#if HWY_TARGET != HWY_SCALAR
  if (block.bytes) {
    correlate_rows<DifferenceCost, uint8_t>(block);
    return;
  }
#endif
  correlate_rows<DifferenceCost, uint16_t>(block);
}

}  // namespace iris::stereo::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace iris::stereo {

HWY_EXPORT(correlate_block);

namespace {

constexpr int kRowsPerMirror = 64;

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
    parallel_chunks(0, image.grey.rows, kRowsPerMirror, [&](int y0, int y1) {
      for (int y = y0; y < y1; ++y) {
        uint8_t* row = bytes.data() + before + y * stride;
        std::reverse_copy(image.grey[y], image.grey[y] + image.grey.cols, row);
        for (int i = 0; i < 3 && !image.census[0].empty(); ++i) {
          const uint8_t* const bits = image.census[i][y];
          std::reverse_copy(bits, bits + image.grey.cols, row + (i + 1) * plane);
        }
      }
    });
  }
};

constexpr cv::Mat1w Correlation::*kImages[] = {&Correlation::winner, &Correlation::cost,  &Correlation::second,
                                               &Correlation::before, &Correlation::after, &Correlation::right_winner};

// Whether 8 bits suffice for sums over a column, divided sums over a window and costs.
bool fits_bytes(const CorrelationParameters& p) {
  return p.window_height * p.cap <= 255 && p.shift <= 8 &&
         (p.window_width * p.window_height * p.cap) >> p.shift <= 254 / 3;
}

}  // namespace

int largest_cap(int window_width, int window_height, bool census) {
  const int of_pixel = std::min(255, (Correlation::kNone - 1) / (3 * window_width * window_height));
  return census ? (of_pixel - 24 * kCensusWeight) / kGreyWeight : of_pixel;
}

int shift_for_bytes(int window_width, int window_height, int cap) {
  if (window_height * cap > 255) return 0;
  int shift = 0;
  while ((window_width * window_height * cap) >> shift > 254 / 3) ++shift;
  return shift;
}

void correlate(const MatchImage& left, const MatchImage& right, const CorrelationParameters& p,
               const CorrelationSink& next) {
  const cv::Size size = left.grey.size();
  const bool census = !left.census[0].empty();
  IRIS_CHECK(!left.grey.empty() && right.grey.size() == size);
  for (int i = 0; i < 3; ++i) {
    IRIS_CHECK(left.census[i].size() == (census ? size : cv::Size()) &&
               right.census[i].size() == left.census[i].size());
  }
  IRIS_CHECK(p.disparities > 0 && p.window_width % 2 == 1 && p.window_height % 2 == 1);
  IRIS_CHECK(p.cap >= 0 && p.cap <= largest_cap(p.window_width, p.window_height, census));
  constexpr int kRowsPerBlock = 96;  // at most; an even number of blocks of equal height occupies two threads best
  const int blocks = 2 * ((size.height + 2 * kRowsPerBlock - 1) / (2 * kRowsPerBlock));
  const int rows_per_block = (size.height + blocks - 1) / blocks;
  constexpr int kCacheBytes = 480 << 10;  // of the windows and pixels, the largest part of what a tile needs

  const bool bytes = fits_bytes(p) && !census && p.disparities <= 256;
  const int tile_for_cache = std::max(kCacheBytes / ((bytes ? 2 : 3) * p.disparities * p.window_height), 8 * kGroup);
  const int tiles = (size.width + tile_for_cache - 1) / tile_for_cache;
  const int tile = ((size.width + tiles - 1) / tiles + kGroup - 1) / kGroup * kGroup;

  const Mirrored mirrored_right(right, std::max(0, -p.min_disparity),
                                std::max(0, p.min_disparity) + p.disparities + 4 * kMaxLanes);
  // One for each thread at most, whoever it is.
  std::mutex mutex;
  std::vector<std::unique_ptr<Scratch>> idle;
  const auto take_scratch = [&] {
    const std::lock_guard lock(mutex);
    if (idle.empty()) return std::make_unique<Scratch>();
    std::unique_ptr<Scratch> scratch = std::move(idle.back());
    idle.pop_back();
    return scratch;
  };
  parallel_chunks(0, size.height, rows_per_block, [&](int y0, int y1) {
    std::unique_ptr<Scratch> scratch = take_scratch();
    scratch->restart();
    for (const auto image : kImages) (scratch->rows.*image).create(y1 - y0, size.width);
    const CorrelationBlock block = {.left = &left,
                                    .right = mirrored_right.origin,
                                    .right_stride = mirrored_right.stride,
                                    .right_plane = mirrored_right.plane,
                                    .census = census,
                                    .bytes = bytes,
                                    .width = size.width,
                                    .height = size.height,
                                    .parameters = p,
                                    .tile = tile,
                                    .y0 = y0,
                                    .y1 = y1,
                                    .out = &scratch->rows,
                                    .scratch = scratch.get()};
    HWY_DYNAMIC_DISPATCH(correlate_block)(block);
    next(y0, scratch->rows);
    const std::lock_guard lock(mutex);
    idle.push_back(std::move(scratch));
  });
}

Correlation correlate(const MatchImage& left, const MatchImage& right, const CorrelationParameters& parameters) {
  Correlation out;
  for (const auto image : kImages) (out.*image).create(left.grey.size());
  correlate(left, right, parameters, [&](int y0, const Correlation& rows) {
    for (const auto image : kImages) {
      const cv::Mat1w& from = rows.*image;
      from.copyTo((out.*image).rowRange(y0, y0 + from.rows));
    }
  });
  return out;
}

}  // namespace iris::stereo
#endif  // HWY_ONCE
