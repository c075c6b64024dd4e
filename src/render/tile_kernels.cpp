#include "tile_kernels.h"

#include <cmath>

#include "iris/types/disparity_image.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "../src/render/tile_kernels.cpp"  // seen from include/
#include <hwy/foreach_target.h>                              // IWYU pragma: keep
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace iris::render::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using Tag = hn::CappedTag<float, kTilePixels>;
using IntTag = hn::RebindToSigned<Tag>;
using WordTag = hn::RebindToUnsigned<Tag>;
using Floats = hn::Vec<Tag>;
using Ints = hn::Vec<IntTag>;
using Mask = hn::Mask<Tag>;

HWY_INLINE Floats set(float value) { return hn::Set(Tag(), value); }

// The whole pixel left of (above) a coordinate, such that another one follows.
HWY_INLINE Ints pixel_before(Floats at, int count) {
  const IntTag di;
  const int last = count > 1 ? count - 2 : 0;
  return hn::Min(hn::Max(hn::ConvertTo(di, at), hn::Zero(di)), hn::Set(di, last));
}

// Between two neighbours, or the nearer one if they belong to different objects.
HWY_INLINE Floats joined(Floats a, Floats b, Floats part, Floats max_step) {
  const auto zero = hn::Zero(Tag());
  const auto connected = hn::And(hn::And(hn::Gt(a, zero), hn::Gt(b, zero)), hn::Le(hn::Abs(hn::Sub(a, b)), max_step));
  const auto nearer = hn::IfThenElse(hn::Lt(part, set(0.5f)), a, b);
  return hn::IfThenElse(connected, hn::MulAdd(part, hn::Sub(b, a), a), nearer);
}

HWY_INLINE Floats disparity_at(const TileSource& source, Floats x, Floats y, Floats max_step) {
  const Tag d;
  const IntTag di;
  const auto x0 = pixel_before(x, source.width), y0 = pixel_before(y, source.height);
  const auto fx = hn::Sub(x, hn::ConvertTo(d, x0)), fy = hn::Sub(y, hn::ConvertTo(d, y0));
  const int right = source.width > 1 ? 1 : 0;
  const ptrdiff_t down = source.height > 1 ? source.disparity_stride : 0;
  const auto index = hn::Add(hn::Mul(y0, hn::Set(di, static_cast<int>(source.disparity_stride))), x0);
  const auto a = joined(hn::GatherIndex(d, source.disparity, index), hn::GatherIndex(d, source.disparity + down, index),
                        fy, max_step);
  const auto b = joined(hn::GatherIndex(d, source.disparity + right, index),
                        hn::GatherIndex(d, source.disparity + right + down, index), fy, max_step);
  return joined(a, b, fx, max_step);
}

HWY_ATTR LineMeeting walk_line(const float* disparity, ptrdiff_t stride, int width, int height, const Line& line,
                               float max_step) {
  const Tag d;
  const IntTag di;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const auto zero = hn::Zero(d);
  const float dx = line.x1 - line.x0, dy = line.y1 - line.y0, dd = line.d1 - line.d0;
  const bool by_x = std::abs(dx) >= std::abs(dy);
  const float length = by_x ? std::abs(dx) : std::abs(dy), per_pixel = 1 / length;
  const float major0 = by_x ? line.x0 : line.y0, major1 = by_x ? line.x1 : line.y1;
  const int direction = major1 > major0 ? 1 : -1;
  // To the next whole pixel beyond both ends.
  const auto up = [](float value) {
    const int below = static_cast<int>(value);
    return below + (static_cast<float>(below) < value ? 1 : 0);
  };
  const int first = direction > 0 ? static_cast<int>(major0) : up(major0);
  const int last = direction > 0 ? up(major1) : static_cast<int>(major1);
  const int steps = (last - first) * direction;
  const float before = (major0 - static_cast<float>(first)) * static_cast<float>(direction);  // [px] to the begin
  const float minor_step = (by_x ? dy : dx) * per_pixel, d_step = dd * per_pixel;
  const float minor_first = (by_x ? line.y0 : line.x0) - before * minor_step, d_first = line.d0 - before * d_step;
  const int row = static_cast<int>(stride), count = by_x ? height : width;
  const int major_stride = by_x ? 1 : row, minor_stride = by_x ? row : 1;
  const float* start = disparity + first * static_cast<ptrdiff_t>(major_stride);
  const float* start_beside = start + (count > 1 ? minor_stride : 0);

  // Each lane is a sample; pairs of neighbouring lanes are judged, so that vectors overlap by one sample. Lanes beyond
  // the last sample repeat it, and meet nothing.
  const auto lane = hn::Iota(di, 0);
  const auto following = hn::IndicesFromVec(d, hn::Min(hn::Add(lane, hn::Set(di, 1)), hn::Set(di, lanes - 1)));
  for (int i = 0; i < steps; i += lanes - 1) {
    const auto step = hn::Min(hn::Add(lane, hn::Set(di, i)), hn::Set(di, steps));
    const auto at = hn::ConvertTo(d, step);
    const auto minor =
        hn::Min(hn::Max(hn::MulAdd(at, set(minor_step), set(minor_first)), zero), set(static_cast<float>(count - 1)));
    const auto beside = pixel_before(minor, count);
    const auto index =
        hn::Add(hn::Mul(step, hn::Set(di, direction * major_stride)), hn::Mul(beside, hn::Set(di, minor_stride)));
    const auto image = joined(hn::GatherIndex(d, start, index), hn::GatherIndex(d, start_beside, index),
                              hn::Sub(minor, hn::ConvertTo(d, beside)), set(max_step));
    const auto delta = hn::Sub(hn::MulAdd(at, set(d_step), set(d_first)), image);  // (7.9)
    const auto next_image = hn::TableLookupLanes(image, following), next = hn::TableLookupLanes(delta, following);
    // Connected is what is continuous in the disparity *image*: where the novel camera is near the source, the ray's
    // own disparity may change by any amount a pixel.
    const auto connected = hn::And(hn::And(hn::Gt(image, zero), hn::Gt(next_image, zero)),
                                   hn::Le(hn::Abs(hn::Sub(image, next_image)), set(max_step)));
    const auto surface = hn::And(hn::Gt(delta, zero), hn::Le(next, zero));
    const auto back = hn::And(hn::Lt(delta, zero), hn::Ge(next, zero));
    const auto meets = hn::And(connected, hn::Or(surface, back));
    if (hn::AllFalse(d, meets)) continue;
    const auto part = hn::Div(delta, hn::IfThenElse(meets, hn::Sub(delta, next), set(1)));
    const auto travelled = hn::Add(at, hn::Sub(part, set(before)));
    const auto on_line = hn::And(hn::Ge(travelled, set(-1e-3f)), hn::Le(travelled, set(length + 1e-3f)));
    const intptr_t found = hn::FindFirstTrue(d, hn::And(meets, on_line));
    if (found < 0) continue;
    TileFloats all_travelled, all_delta;
    hn::Store(travelled, d, all_travelled.at);
    hn::Store(delta, d, all_delta.at);
    return {.side = all_delta.at[found] > 0 ? 1 : -1, .travelled = all_travelled.at[found]};
  }
  return {};
}

HWY_ATTR void find_lines(const TileSource& source, const TileRays& rays, TileLines& lines) {
  const Tag d;
  const float* r = source.rotation;
  const auto tz = set(source.translation[2]);
  const auto per_baseline = set(1 / source.baseline);
  for (size_t i = 0; i < kTileRays; i += hn::Lanes(d)) {
    const auto ray_x = hn::Load(d, rays.x + i), ray_y = hn::Load(d, rays.y + i), ray_z = hn::Load(d, rays.z + i);
    const auto turned = [&](int row) {
      return hn::MulAdd(set(r[3 * row]), ray_x,
                        hn::MulAdd(set(r[3 * row + 1]), ray_y, hn::Mul(set(r[3 * row + 2]), ray_z)));
    };
    const auto qx = turned(0), qy = turned(1), qz = turned(2);
    const auto square = hn::MulAdd(qx, qx, hn::MulAdd(qy, qy, hn::Mul(qz, qz)));
    const auto good = hn::Gt(qz, hn::Sqrt(hn::Mul(set(0.1f), square)));
    const auto per_qz = hn::IfThenElseZero(good, hn::Div(set(1), hn::IfThenElse(good, qz, set(1))));
    const auto slope_x = hn::Mul(qx, per_qz), slope_y = hn::Mul(qy, per_qz);
    hn::Store(hn::MulAdd(set(source.f), slope_x, set(source.cx)), d, lines.x0 + i);
    hn::Store(hn::MulAdd(set(source.f), slope_y, set(source.cy)), d, lines.y0 + i);
    hn::Store(hn::Mul(hn::NegMulAdd(tz, slope_x, set(source.translation[0])), per_baseline), d, lines.mx + i);
    hn::Store(hn::Mul(hn::NegMulAdd(tz, slope_y, set(source.translation[1])), per_baseline), d, lines.my + i);
    hn::Store(per_qz, d, lines.per_qz + i);
  }
}

HWY_ATTR uint64_t settle(const TileSource& source, const TileLines& lines, const TileFloats& wanted, float max_step,
                         TileHits& hits) {
  constexpr float kSettled = 5e-4f;        // [px] a guess as good as this is taken
  constexpr float kDisparityError = 0.5f;  // [px] largest delta of the second sample
  constexpr float kFarthestGuess = 1.0f;   // [px] a guess that is farther away may belong to another surface
  const Tag d;
  const auto zero = hn::Zero(d), one = set(1);
  const auto steps = set(max_step);
  const auto tz = set(source.translation[2]);
  const auto offset = set(source.disparity_offset);
  const auto last_x = set(static_cast<float>(source.width - 1)), last_y = set(static_cast<float>(source.height - 1));
  uint64_t failed = 0;
  for (size_t i = 0; i < kTilePixels; i += hn::Lanes(d)) {
    const auto want = hn::Gt(hn::Load(d, wanted.at + i), zero);
    if (hn::AllFalse(d, want)) continue;
    const auto per_qz = hn::Load(d, lines.per_qz + i);
    auto good = hn::And(want, hn::Gt(per_qz, zero));
    const auto x0 = hn::Load(d, lines.x0 + i), y0 = hn::Load(d, lines.y0 + i);
    const auto mx = hn::Load(d, lines.mx + i), my = hn::Load(d, lines.my + i);
    const auto in_image = [&](Floats x, Floats y) {
      return hn::And(hn::And(hn::Ge(x, zero), hn::Le(x, last_x)), hn::And(hn::Ge(y, zero), hn::Le(y, last_y)));
    };

    auto disparity = hn::Load(d, hits.disparity.at + i);
    auto x = hn::MulAdd(mx, hn::Add(disparity, offset), x0), y = hn::MulAdd(my, hn::Add(disparity, offset), y0);
    good = hn::And(good, in_image(x, y));
    const auto image0 = disparity_at(source, hn::IfThenElseZero(good, x), hn::IfThenElseZero(good, y), steps);
    good = hn::And(good, hn::Gt(image0, zero));
    const auto delta0 = hn::Sub(disparity, image0);
    good = hn::And(good, hn::Le(hn::Abs(delta0), set(kFarthestGuess)));
    const auto unsettled = hn::And(good, hn::Gt(hn::Abs(delta0), set(kSettled)));
    if (!hn::AllFalse(d, unsettled)) {
      auto x1 = hn::MulAdd(mx, hn::Add(image0, offset), x0), y1 = hn::MulAdd(my, hn::Add(image0, offset), y0);
      const auto inner = hn::And(unsettled, in_image(x1, y1));
      const auto image1 = disparity_at(source, hn::IfThenElseZero(inner, x1), hn::IfThenElseZero(inner, y1), steps);
      const auto delta1 = hn::Sub(image0, image1);
      const auto close = hn::And(hn::And(inner, hn::Gt(image1, zero)), hn::Le(hn::Abs(delta1), set(kDisparityError)));
      // Root of the line through both samples; |delta0| > kSettled, so that a delta1 of half its size is no danger.
      const auto change = hn::Sub(delta0, delta1);
      const auto steady = hn::Gt(hn::Abs(change), hn::Mul(set(0.5f), hn::Abs(delta0)));
      const auto root = hn::NegMulAdd(delta1, hn::Div(delta0, hn::IfThenElse(steady, change, one)), image0);
      good = hn::Or(hn::AndNot(unsettled, good), hn::And(close, steady));
      disparity = hn::IfThenElse(unsettled, root, disparity);
      x = hn::MulAdd(mx, hn::Add(disparity, offset), x0);
      y = hn::MulAdd(my, hn::Add(disparity, offset), y0);
      good = hn::And(good, in_image(x, y));
    }
    const auto seen = hn::Add(disparity, offset);
    good = hn::And(good, hn::Gt(seen, zero));
    const auto depth = hn::Div(set(source.f * source.baseline), hn::IfThenElse(good, seen, one));
    const auto along = hn::Mul(hn::Sub(depth, tz), per_qz);
    const auto keep = [&](Floats value, float* to) { hn::Store(hn::IfThenElse(good, value, hn::Load(d, to)), d, to); };
    keep(disparity, hits.disparity.at + i);
    keep(x, hits.x.at + i);
    keep(y, hits.y.at + i);
    keep(along, hits.along.at + i);
    uint8_t bits[8 + (kTilePixels + 7) / 8] = {};
    hn::StoreMaskBits(d, hn::AndNot(good, want), bits);
    for (size_t k = 0; 8 * k < hn::Lanes(d); ++k) failed |= static_cast<uint64_t>(bits[k]) << (i + 8 * k);
  }
  return failed;
}

// Up to four bytes from an offset into an image of at least four bytes; none beyond its end is touched.
HWY_INLINE hn::Vec<WordTag> bytes_at(const uint8_t* image, Ints offset, Ints last) {
  const WordTag du;
  const auto from = hn::Min(offset, last);
  const auto word = hn::GatherOffset(du, reinterpret_cast<const uint32_t*>(image), from);
  return hn::Shr(word, hn::BitCast(du, hn::ShiftLeft<3>(hn::Sub(offset, from))));
}

template <int kByte>
HWY_INLINE Floats byte_of(hn::Vec<WordTag> word) {
  const IntTag di;
  return hn::ConvertTo(Tag(), hn::And(hn::BitCast(di, hn::ShiftRight<8 * kByte>(word)), hn::Set(di, 255)));
}

HWY_ATTR void fuse_by_agreement(const TileSource* sources, const TileHits* hits, size_t count, TilePixels& pixels) {
  constexpr float kDisparityError = 0.5f;  // [px] matching and pose error together
  constexpr float kRelativeError = 0.01f;  // of the depth in the novel view
  constexpr float kRim = 16;               // [px] towards its border a source fades out, which hides the seam
  const Tag d;
  const IntTag di;
  const auto zero = hn::Zero(d);
  TileFloats tolerances[kMostSources], trusts[kMostSources];  // a trust of 0: no candidate
  for (size_t i = 0; i < kTilePixels; i += hn::Lanes(d)) {
    auto any = hn::MaskFromVec(zero);
    for (size_t s = 0; s < count; ++s) {
      const TileSource& source = sources[s];
      const auto along = hn::Load(d, hits[s].along.at + i);
      const auto valid = hn::And(hn::Gt(hn::Load(d, hits[s].meeting.at + i), zero), hn::Gt(along, zero));
      auto trust = hn::IfThenElseZero(valid, set(1));
      if (!hn::AllFalse(d, valid)) {
        any = hn::Or(any, valid);
        const auto disparity = hn::Add(hn::Load(d, hits[s].disparity.at + i), set(source.disparity_offset));
        const auto per_disparity = hn::Div(set(1), hn::IfThenElse(valid, disparity, set(1)));
        const auto spread =
            hn::Mul(set(kDisparityError * source.f * source.baseline), hn::Mul(per_disparity, per_disparity));
        hn::Store(hn::MulAdd(set(kRelativeError), along, spread), d, tolerances[s].at + i);
        if (source.origin != nullptr) {
          const auto half = set(0.5f);
          const auto x = hn::ConvertTo(di, hn::Add(hn::Load(d, hits[s].x.at + i), half));
          const auto y = hn::ConvertTo(di, hn::Add(hn::Load(d, hits[s].y.at + i), half));
          const auto at = hn::Add(hn::Mul(y, hn::Set(di, static_cast<int>(source.origin_stride))), x);
          const int last = static_cast<int>((source.height - 1) * source.origin_stride + source.width - 4);
          const auto origin = byte_of<0>(bytes_at(source.origin, at, hn::Set(di, last)));
          const auto is = [&](DisparityOrigin value) { return hn::Eq(origin, set(static_cast<float>(value))); };
          trust = hn::IfThenElse(hn::And(valid, is(DisparityOrigin::within_segment)), set(0.7f), trust);
          trust = hn::IfThenElse(hn::And(valid, is(DisparityOrigin::between_segments)), set(0.3f), trust);
        }
      }
      hn::Store(trust, d, trusts[s].at + i);
    }
    auto blue = zero, green = zero, red = zero, depth = zero, total = zero, most = zero;
    auto winner = hn::Set(di, -1);
    if (!hn::AllFalse(d, any)) {
      auto best_votes = zero, best_along = set(1e30f), best_tolerance = zero;
      for (size_t s = 0; s < count; ++s) {
        const auto trust = hn::Load(d, trusts[s].at + i);
        const auto valid = hn::Gt(trust, zero);
        if (hn::AllFalse(d, valid)) continue;
        const auto along = hn::Load(d, hits[s].along.at + i), tolerance = hn::Load(d, tolerances[s].at + i);
        auto votes = trust;
        for (size_t j = 0; j < count; ++j) {
          if (j == s) continue;
          const auto other = hn::Load(d, trusts[j].at + i);
          if (hn::AllFalse(d, hn::Gt(other, zero))) continue;
          const auto apart = hn::Abs(hn::Sub(along, hn::Load(d, hits[j].along.at + i)));
          const auto agree = hn::Le(apart, hn::Add(tolerance, hn::Load(d, tolerances[j].at + i)));
          votes = hn::Add(votes, hn::IfThenElseZero(agree, other));
        }
        const auto margin = set(1e-4f);
        const auto more = hn::Gt(votes, hn::Add(best_votes, margin));
        const auto nearer = hn::And(hn::Gt(votes, hn::Sub(best_votes, margin)), hn::Lt(along, best_along));
        const auto better = hn::And(valid, hn::Or(more, nearer));
        best_votes = hn::IfThenElse(better, votes, best_votes);
        best_along = hn::IfThenElse(better, along, best_along);
        best_tolerance = hn::IfThenElse(better, tolerance, best_tolerance);
      }
      for (size_t s = 0; s < count; ++s) {
        const TileSource& source = sources[s];
        const auto trust = hn::Load(d, trusts[s].at + i);
        const auto valid = hn::Gt(trust, zero);
        if (hn::AllFalse(d, valid)) continue;
        const auto along = hn::Load(d, hits[s].along.at + i);
        const auto apart = hn::Abs(hn::Sub(along, best_along));
        const auto take = hn::And(valid, hn::Le(apart, hn::Add(best_tolerance, hn::Load(d, tolerances[s].at + i))));
        if (hn::AllFalse(d, take)) continue;
        const auto x = hn::Load(d, hits[s].x.at + i), y = hn::Load(d, hits[s].y.at + i);
        const auto to_border = hn::Min(hn::Min(x, hn::Sub(set(static_cast<float>(source.width - 1)), x)),
                                       hn::Min(y, hn::Sub(set(static_cast<float>(source.height - 1)), y)));
        const auto fade = hn::Min(hn::Max(hn::Mul(hn::Add(to_border, set(1)), set(1 / kRim)), set(0.05f)), set(1));
        const auto weight = hn::IfThenElseZero(
            take, hn::Div(hn::Mul(trust, fade), hn::MulAdd(set(0.02f), along, set(source.distance))));

        const auto x0 = pixel_before(x, source.width), y0 = pixel_before(y, source.height);
        const auto fx = hn::Sub(x, hn::ConvertTo(d, x0)), fy = hn::Sub(y, hn::ConvertTo(d, y0));
        const int right = source.width > 1 ? source.channels : 0;
        const int stride = static_cast<int>(source.image_stride);
        const int down = source.height > 1 ? stride : 0;
        const auto last = hn::Set(di, (source.height - 1) * stride + source.channels * source.width - 4);
        const auto at = hn::Add(hn::Mul(y0, hn::Set(di, stride)), hn::Mul(x0, hn::Set(di, source.channels)));
        const auto below = hn::Add(at, hn::Set(di, down));
        const auto mixed = [&](Floats a, Floats b, Floats c, Floats e) {
          const auto top = hn::MulAdd(fx, hn::Sub(b, a), a), bottom = hn::MulAdd(fx, hn::Sub(e, c), c);
          return hn::MulAdd(fy, hn::Sub(bottom, top), top);
        };
        const auto a = bytes_at(source.image, at, last), c = bytes_at(source.image, below, last);
        if (source.channels == 1) {
          const auto grey = right == 0 ? mixed(byte_of<0>(a), byte_of<0>(a), byte_of<0>(c), byte_of<0>(c))
                                       : mixed(byte_of<0>(a), byte_of<1>(a), byte_of<0>(c), byte_of<1>(c));
          blue = hn::MulAdd(weight, grey, blue);
          green = hn::MulAdd(weight, grey, green);
          red = hn::MulAdd(weight, grey, red);
        } else {
          const auto b = bytes_at(source.image, hn::Add(at, hn::Set(di, right)), last);
          const auto e = bytes_at(source.image, hn::Add(below, hn::Set(di, right)), last);
          blue = hn::MulAdd(weight, mixed(byte_of<0>(a), byte_of<0>(b), byte_of<0>(c), byte_of<0>(e)), blue);
          green = hn::MulAdd(weight, mixed(byte_of<1>(a), byte_of<1>(b), byte_of<1>(c), byte_of<1>(e)), green);
          red = hn::MulAdd(weight, mixed(byte_of<2>(a), byte_of<2>(b), byte_of<2>(c), byte_of<2>(e)), red);
        }
        depth = hn::MulAdd(weight, along, depth);
        total = hn::Add(total, weight);
        const auto leads = hn::Gt(weight, most);
        most = hn::Max(weight, most);
        winner = hn::IfThenElse(hn::RebindMask(di, leads), hn::Set(di, static_cast<int>(s)), winner);
      }
    }
    const auto share = hn::IfThenElseZero(any, hn::Div(set(1), hn::IfThenElse(any, total, set(1))));
    hn::Store(hn::Mul(blue, share), d, pixels.colour[0].at + i);
    hn::Store(hn::Mul(green, share), d, pixels.colour[1].at + i);
    hn::Store(hn::Mul(red, share), d, pixels.colour[2].at + i);
    hn::Store(hn::Mul(depth, share), d, pixels.depth.at + i);
    alignas(64) int32_t winners[kTilePixels];
    hn::Store(winner, di, winners);
    for (size_t k = 0; k < hn::Lanes(d); ++k) pixels.source[i + k] = static_cast<int16_t>(winners[k]);
  }
}

}  // namespace iris::render::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace iris::render {

HWY_EXPORT(walk_line);
HWY_EXPORT(find_lines);
HWY_EXPORT(settle);
HWY_EXPORT(fuse_by_agreement);

LineMeeting walk_line(const float* disparity, ptrdiff_t stride, int width, int height, const Line& line,
                      float max_step) {
  return HWY_DYNAMIC_DISPATCH(walk_line)(disparity, stride, width, height, line, max_step);
}

void find_lines(const TileSource& source, const TileRays& rays, TileLines& lines) {
  HWY_DYNAMIC_DISPATCH(find_lines)(source, rays, lines);
}

uint64_t settle(const TileSource& source, const TileLines& lines, const TileFloats& wanted, float max_step,
                TileHits& hits) {
  return HWY_DYNAMIC_DISPATCH(settle)(source, lines, wanted, max_step, hits);
}

void fuse_by_agreement(const TileSource* sources, const TileHits* hits, size_t count, TilePixels& pixels) {
  HWY_DYNAMIC_DISPATCH(fuse_by_agreement)(sources, hits, count, pixels);
}

}  // namespace iris::render
#endif
