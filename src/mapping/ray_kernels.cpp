#include "ray_kernels.h"

#include <algorithm>
#include <cmath>

#include "iris/types/flog_map.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "../src/mapping/ray_kernels.cpp"  // seen from include/
#include <hwy/foreach_target.h>                              // IWYU pragma: keep
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace iris::mapping::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using D = hn::CappedTag<double, Ways::kMost>;
using I = hn::RebindToSigned<D>;
using F = hn::Rebind<float, D>;
using Doubles = hn::Vec<D>;
using Ints = hn::Vec<I>;

constexpr double kOneMetre = 4294967296.0;  // distances along a ray are integers, 2^-32 m

// [boxes/m] slower than this no ray moves along an axis, so that all distances fit: a deviation of 2e-6 boxes in 20 m.
constexpr double kSlowest = 1e-7;

HWY_INLINE Doubles set(double value) { return hn::Set(D(), value); }
HWY_INLINE Ints fixed(Doubles metres) { return hn::ConvertTo(I(), hn::Mul(metres, set(kOneMetre))); }

// Follows hn::Lanes(D()) ways from number `first` on, those before ways.count.
template <bool kEmpty>
HWY_INLINE void walk(const WalkGrid& grid, const Ways& ways, size_t first, BlockSums& sums) {
  const D d;
  const I di;
  const Ints zero = hn::Zero(di);
  const BoxLayout& layout = sums.layout();
  const int in_block_shift = layout.in_block_shift();
  const int64_t in_block_mask = (int64_t{1} << in_block_shift) - 1;

  // Velocities [boxes/m] and their inverses, 2^-32 m per box.
  Doubles direction[3], velocity[3], inverse[3];
  for (int a = 0; a < 3; ++a) {
    direction[a] = hn::PromoteTo(d, hn::Load(F(), ways.direction[a] + first));
    const Doubles v = hn::Mul(direction[a], set(grid.inverse_box[a]));
    velocity[a] = hn::IfThenElse(hn::Lt(hn::Abs(v), set(kSlowest)), hn::CopySign(set(kSlowest), v), v);
    inverse[a] = hn::Div(set(kOneMetre), velocity[a]);
  }
  const auto metres_of = [&](const float* lanes) { return hn::PromoteTo(d, hn::Load(F(), lanes + first)); };
  const Doubles way_from = metres_of(ways.from), way_end = metres_of(ways.end);
  Doubles from = way_from, last = way_end;
  if (grid.clip_z) {
    const Doubles metres = hn::Mul(inverse[2], set(1 / kOneMetre));
    const Doubles t0 = hn::Mul(set(-grid.start[2]), metres);
    const Doubles t1 = hn::Mul(set(layout.boxes[2] - grid.start[2]), metres);
    from = hn::Max(from, hn::Min(t0, t1));
    last = hn::Min(last, hn::Max(t0, t1));
  }
  const Ints lane = hn::Add(hn::Iota(di, 0), hn::Set(di, static_cast<int64_t>(first)));
  auto alive =
      hn::And(hn::Lt(lane, hn::Set(di, static_cast<int64_t>(ways.count))), hn::RebindMask(di, hn::Lt(from, last)));
  if (hn::AllFalse(di, alive)) return;

  // From here on integers: distance along the ray to the next plane of each axis and between two planes (Amanatides and
  // Woo). `foot`: distance of the point that is nearest to the middle of the box.
  Ints next[3], delta[3], place[3], step[3], field[3], move[3];
  Doubles foot_metres = hn::Zero(d);
  int low_shift = BoxLayout::kBoxShift, high_shift = in_block_shift;
  for (int a = 0; a < 3; ++a) {
    const auto forward = hn::Gt(velocity[a], hn::Zero(d));
    const Doubles at = hn::Add(set(grid.start[a]), hn::Mul(velocity[a], from));
    const Ints box = hn::Min(hn::Max(hn::ConvertTo(di, at), zero), hn::Set(di, layout.boxes[a] - 1));
    const Doubles box_d = hn::ConvertTo(d, box);
    const Doubles plane = hn::Add(box_d, hn::IfThenElseZero(forward, set(1)));
    next[a] = hn::ConvertTo(di, hn::Mul(hn::Sub(plane, set(grid.start[a])), inverse[a]));
    delta[a] = hn::ConvertTo(di, hn::Abs(inverse[a]));
    const Doubles along = hn::Mul(direction[a], set(grid.box[a]));
    foot_metres = hn::Add(foot_metres, hn::Mul(hn::Add(box_d, set(0.5 - grid.start[a])), along));
    move[a] = fixed(hn::Abs(along));
    // The number's bits in their two fields; a step carries from one into the other over what is between: + 1 with all
    // bits between set, which is - fields.
    const int low_bits = layout.block_shift[a];
    const int64_t low = ((int64_t{1} << low_bits) - 1) << low_shift;
    const int64_t high =
        a == 2 ? -(int64_t{1} << high_shift) : ((int64_t{1} << layout.blocks_shift[a]) - 1) << high_shift;
    const Ints in_block = hn::And(box, hn::Set(di, (int64_t{1} << low_bits) - 1));
    const Ints block = hn::Sub(box, in_block);
    place[a] = hn::Or(hn::ShiftLeftSame(in_block, low_shift), hn::ShiftLeftSame(block, high_shift - low_bits));
    field[a] = hn::Set(di, low | high);
    const int64_t lowest = int64_t{1} << (low != 0 ? low_shift : high_shift);
    step[a] = hn::IfThenElse(hn::RebindMask(di, forward), hn::Set(di, -(low | high)), hn::Set(di, -lowest));
    low_shift += low_bits;
    if (a < 2) high_shift += layout.blocks_shift[a];
  }
  // z is the highest field.
  const Ints z_end = hn::Set(di, static_cast<int64_t>(layout.blocks_z()) << high_shift);
  Ints foot = fixed(foot_metres);
  const Ints end = fixed(way_end);
  Ints xy = hn::Min(next[0], next[1]), out = hn::Min(xy, next[2]), t = fixed(from);
  // The part before has counted the box in which this one begins if its foot lies there.
  const auto counted =
      hn::And(hn::RebindMask(di, hn::And(hn::Gt(way_from, hn::Zero(d)), hn::Eq(way_from, from))), hn::Lt(foot, t));
  t = hn::IfThenElse(counted, out, t);

  const Ints spare = hn::Set(di, static_cast<int64_t>(sums.spare()));
  const Ints length = kEmpty ? zero : fixed(metres_of(ways.length));
  const Doubles error = metres_of(ways.error);
  const Ints empty_to = kEmpty ? zero : hn::Sub(length, fixed(error));
  const Doubles scale = kEmpty ? error : hn::Div(set(1 / kOneMetre), error);
  const Ints one_ray = kEmpty
                           ? hn::ShiftLeft<kRayShift>(hn::Load(di, reinterpret_cast<const int64_t*>(ways.rays) + first))
                           : hn::Set(di, static_cast<int64_t>(kOneRay));
  alignas(64) int64_t blocks[Ways::kMost], offsets[Ways::kMost], rays[Ways::kMost], pairs[2 * Ways::kMost];
  hn::Store(one_ray, di, rays);
  BoxSum* const* const table = sums.table();
  const auto sum_in = [&](int64_t block_idx, int64_t offset) {
    BoxSum* block = table[block_idx];
    if (HWY_UNLIKELY(block == nullptr)) block = sums.allocate(static_cast<size_t>(block_idx));
    return reinterpret_cast<uint64_t*>(reinterpret_cast<char*>(block) + offset);
  };
  for (;;) {
    // Rays that only touch a box do not cross it.
    const Ints r = hn::Min(hn::Max(foot, t), out);
    const auto passes = hn::Gt(out, t);
    alive = hn::AndNot(hn::AndNot(hn::Lt(r, end), passes), alive);
    if (hn::AllFalse(di, alive)) return;
    const auto counts = hn::And(passes, alive);
    const Ints here = hn::Or(hn::Or(place[0], place[1]), place[2]);
    hn::Store(hn::IfThenElse(counts, hn::ShiftRightSame(here, in_block_shift), spare), di, blocks);
    hn::Store(hn::And(here, hn::Set(di, in_block_mask)), di, offsets);
    // Neighbouring rays mostly cross the same box: one sum for all of them.
    const int64_t box = hn::GetLane(here);
    const bool same = hn::AllTrue(di, hn::Or(hn::Not(counts), hn::Eq(here, hn::Set(di, box))));
    if (same && hn::AllFalse(di, counts)) {
      // Nothing to add.
    } else if (kEmpty || hn::AllFalse(di, hn::And(counts, hn::Gt(r, empty_to)))) {
      if (same) {
        *sum_in(box >> in_block_shift, box & in_block_mask) +=
            static_cast<uint64_t>(hn::GetLane(hn::SumOfLanes(di, hn::IfThenElseZero(counts, one_ray))));
      } else {
        for (size_t i = 0; i < hn::Lanes(d); ++i) *sum_in(blocks[i], offsets[i]) += static_cast<uint64_t>(rays[i]);
      }
    } else {
      // (6.1)
      const Doubles s = hn::Mul(hn::ConvertTo(d, hn::Sub(length, r)), scale);
      const Doubles one = set(1), half = set(0.5), unit = set(FlogCell::kOne);
      const Doubles lack = hn::Sub(one, hn::Min(hn::Max(s, hn::Zero(d)), one));
      const Doubles occupied = hn::Max(hn::Sub(one, hn::Abs(s)), hn::Zero(d));
      const Ints rays_and_lack = hn::Or(one_ray, hn::ConvertTo(di, hn::Add(hn::Mul(lack, unit), half)));
      const Ints occupied_units = hn::ConvertTo(di, hn::Add(hn::Mul(occupied, unit), half));
      if (same) {
        uint64_t* const sum = sum_in(box >> in_block_shift, box & in_block_mask);
        sum[0] += static_cast<uint64_t>(hn::GetLane(hn::SumOfLanes(di, hn::IfThenElseZero(counts, rays_and_lack))));
        sum[1] += static_cast<uint64_t>(hn::GetLane(hn::SumOfLanes(di, hn::IfThenElseZero(counts, occupied_units))));
      } else {
        hn::StoreInterleaved2(rays_and_lack, occupied_units, di, pairs);
        for (size_t i = 0; i < hn::Lanes(d); ++i) {
          uint64_t* const sum = sum_in(blocks[i], offsets[i]);
          const uint64_t first_sum = sum[0] + static_cast<uint64_t>(pairs[2 * i]),
                         second_sum = sum[1] + static_cast<uint64_t>(pairs[2 * i + 1]);
          sum[0] = first_sum;
          sum[1] = second_sum;
        }
      }
    }
    // Into the next box. Masks instead of branches: which plane comes next cannot be predicted.
    const auto is_z = hn::Not(hn::Lt(xy, next[2]));
    const auto is_x = hn::AndNot(is_z, hn::Lt(next[0], next[1]));
    const auto is_y = hn::Not(hn::Or(is_z, is_x));
    t = out;
    const auto advance = [&](int a, auto mask) {
      next[a] = hn::Add(next[a], hn::IfThenElseZero(mask, delta[a]));
      foot = hn::Add(foot, hn::IfThenElseZero(mask, move[a]));
      place[a] = hn::And(hn::Add(place[a], hn::IfThenElseZero(mask, step[a])), field[a]);
    };
    advance(0, is_x);
    advance(1, is_y);
    advance(2, is_z);
    alive = hn::And(alive, hn::AndNot(hn::Lt(place[2], zero), hn::Lt(place[2], z_end)));
    xy = hn::Min(next[0], next[1]);
    out = hn::Min(xy, next[2]);
  }
}

HWY_ATTR void see_row(const SightRow& row, int y, RayBand& band) {
  const D d;
  const F df;
  const Doubles zero = hn::Zero(d), one = set(1), f_t = set(row.f_t);
  RayBand::Level& pixels = band.levels[0];
  const size_t begin = static_cast<size_t>(y) * band.stride();
  auto low_x = hn::Set(df, band.low[0]), low_y = hn::Set(df, band.low[1]), low_z = hn::Set(df, band.low[2]);
  auto high_x = hn::Set(df, band.high[0]), high_y = hn::Set(df, band.high[1]), high_z = hn::Set(df, band.high[2]);
  for (size_t i = 0; i < band.columns; i += hn::Lanes(d)) {
    const auto to = [&](hn::Vec<F> v, std::vector<float>& lanes) { hn::StoreU(v, df, lanes.data() + begin + i); };
    const Doubles measured = hn::PromoteTo(d, hn::LoadU(df, band.disparity.data() + begin + i));
    const Doubles disparities = hn::Add(measured, set(row.disparity_offset));
    auto valid = hn::And(hn::Gt(measured, zero), hn::Gt(disparities, zero));
    const Doubles x = hn::Add(hn::Iota(d, 0), set(static_cast<double>(i)));
    Doubles sight[3];  // to the point at depth 1
    for (int a = 0; a < 3; ++a) sight[a] = hn::MulAdd(x, set(row.column_step[a]), set(row.first[a]));
    const Doubles square = hn::MulAdd(sight[0], sight[0], hn::MulAdd(sight[1], sight[1], hn::Mul(sight[2], sight[2])));
    const Doubles stretch = hn::Sqrt(square), shrink = hn::Div(one, stretch);
    const Doubles z = hn::Div(f_t, hn::IfThenElse(valid, disparities, one)), length = hn::Mul(stretch, z);
    const Doubles error = hn::Max(hn::Mul(hn::Mul(set(row.error_scale), z), length), set(row.min_error));
    // Far points only tell where it is free. Below half a pixel their error exceeds their distance: they tell nothing.
    const auto far = hn::Lt(disparities, set(row.min_disparity));
    const Doubles empty_to = hn::Sub(length, error);
    const Doubles far_end = hn::Min(hn::Mul(stretch, set(row.farthest_z)), empty_to);
    const Doubles end = hn::Min(hn::IfThenElse(far, far_end, hn::Add(length, error)), set(row.max_range));
    valid = hn::And(valid, hn::Gt(end, zero));
    const auto narrow = [&](Doubles v) { return hn::DemoteTo(df, hn::IfThenElseZero(valid, v)); };
    const auto ends = narrow(end);
    const auto dx = narrow(hn::Mul(sight[0], shrink)), dy = narrow(hn::Mul(sight[1], shrink)),
               dz = narrow(hn::Mul(sight[2], shrink));
    to(dx, pixels.direction[0]);
    to(dy, pixels.direction[1]);
    to(dz, pixels.direction[2]);
    to(narrow(one), pixels.rays);
    to(hn::DemoteTo(df, hn::IfThenElse(valid, hn::Min(empty_to, end), set(RayBand::kFarAway))), pixels.empty_to);
    to(narrow(length), band.length);
    to(narrow(error), band.error);
    to(ends, band.end);
    const auto at_x = hn::Mul(dx, ends), at_y = hn::Mul(dy, ends), at_z = hn::Mul(dz, ends);
    low_x = hn::Min(low_x, at_x), low_y = hn::Min(low_y, at_y), low_z = hn::Min(low_z, at_z);
    high_x = hn::Max(high_x, at_x), high_y = hn::Max(high_y, at_y), high_z = hn::Max(high_z, at_z);
  }
  band.low[0] = hn::GetLane(hn::MinOfLanes(df, low_x));
  band.low[1] = hn::GetLane(hn::MinOfLanes(df, low_y));
  band.low[2] = hn::GetLane(hn::MinOfLanes(df, low_z));
  band.high[0] = hn::GetLane(hn::MaxOfLanes(df, high_x));
  band.high[1] = hn::GetLane(hn::MaxOfLanes(df, high_y));
  band.high[2] = hn::GetLane(hn::MaxOfLanes(df, high_z));
}

// Each second value of both rows and their neighbours.
template <class Combine>
HWY_INLINE void halve(const std::vector<float>& from, size_t stride, std::vector<float>& to, size_t to_stride, int rows,
                      const Combine& combine) {
  for (int y = 0; y < rows; ++y) {
    const float* HWY_RESTRICT a = from.data() + 2 * static_cast<size_t>(y) * stride;
    const float* HWY_RESTRICT b = a + stride;
    float* HWY_RESTRICT out = to.data() + static_cast<size_t>(y) * to_stride;
    for (size_t x = 0; x < to_stride; ++x) {
      out[x] = combine(combine(a[2 * x], a[2 * x + 1]), combine(b[2 * x], b[2 * x + 1]));
    }
  }
}

HWY_ATTR void sum_levels(RayBand& band) {
  const auto sum = [](float a, float b) { return a + b; };
  const auto least = [](float a, float b) { return a < b ? a : b; };
  for (int l = 1; l <= RayBand::kLevels; ++l) {
    const RayBand::Level& from = band.levels[l - 1];
    RayBand::Level& to = band.levels[l];
    const int rows = RayBand::kRows >> l;
    for (int a = 0; a < 3; ++a) halve(from.direction[a], from.stride, to.direction[a], to.stride, rows, sum);
    halve(from.rays, from.stride, to.rays, to.stride, rows, sum);
    halve(from.empty_to, from.stride, to.empty_to, to.stride, rows, least);
  }
}

HWY_ATTR void follow_rays(const WalkGrid& grid, const Ways& ways, BlockSums& sums) {
  for (size_t i = 0; i < ways.count; i += hn::Lanes(D())) walk<false>(grid, ways, i, sums);
}

HWY_ATTR void follow_empty(const WalkGrid& grid, const Ways& ways, BlockSums& sums) {
  for (size_t i = 0; i < ways.count; i += hn::Lanes(D())) walk<true>(grid, ways, i, sums);
}

}  // namespace iris::mapping::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace iris::mapping {

HWY_EXPORT(see_row);
HWY_EXPORT(sum_levels);
HWY_EXPORT(follow_rays);
HWY_EXPORT(follow_empty);

BoxSum* BlockSums::allocate(size_t block) {
  constexpr size_t kChunk = 64;
  const size_t boxes = layout_.boxes_of_block();
  if (left_in_chunk_ == 0) {
    chunks_.push_back(std::make_unique<BoxSum[]>(kChunk * boxes));
    left_in_chunk_ = kChunk;
  }
  allocated_.push_back(static_cast<uint32_t>(block));
  return table_[block] = chunks_.back().get() + (kChunk - left_in_chunk_--) * boxes;
}

RayBand::RayBand(size_t columns_) : columns(columns_) {
  // Whole squares, and vectors may be wider than what is left of a row.
  size_t stride = (columns + kRows - 1) / kRows * kRows;
  for (int l = 0; l <= kLevels; ++l) {
    Level& level = levels[l];
    level.stride = stride >> l;
    const size_t count = level.stride * (kRows >> l);
    for (auto* values : {&level.direction[0], &level.direction[1], &level.direction[2], &level.rays, &level.empty_to}) {
      values->resize(count);
    }
  }
  for (auto* values : {&length, &error, &end, &disparity}) values->resize(stride * kRows);
  clear();
}

void RayBand::clear() {
  Level& pixels = levels[0];
  for (auto* values : {&pixels.direction[0], &pixels.direction[1], &pixels.direction[2], &pixels.rays, &length, &error,
                       &end, &disparity}) {
    std::fill(values->begin(), values->end(), 0.0f);
  }
  std::fill(pixels.empty_to.begin(), pixels.empty_to.end(), kFarAway);
  std::fill(low, low + 3, 0.0f);
  std::fill(high, high + 3, 0.0f);
}

void sight_row(const SightRow& row, int y, RayBand& band) { HWY_DYNAMIC_DISPATCH(see_row)(row, y, band); }

void sum_squares(RayBand& band) { HWY_DYNAMIC_DISPATCH(sum_levels)(band); }

void walk_rays(const WalkGrid& grid, Ways& ways, BlockSums& sums) {
  HWY_DYNAMIC_DISPATCH(follow_rays)(grid, ways, sums);
  ways.count = 0;
}

void walk_empty(const WalkGrid& grid, Ways& ways, BlockSums& sums) {
  HWY_DYNAMIC_DISPATCH(follow_empty)(grid, ways, sums);
  ways.count = 0;
}

}  // namespace iris::mapping
#endif
