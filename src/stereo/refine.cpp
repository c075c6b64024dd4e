// Filters of single winners and the sub-pixel fit, row by row in vectors.
#include <algorithm>
#include <cstdint>

#include "filters.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "../src/stereo/refine.cpp"  // seen from include/
#include <hwy/foreach_target.h>                        // IWYU pragma: keep
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace iris::stereo::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// step(tag, x) for all x of a row, of which the last ones may come one by one.
template <class T, class Step>
HWY_INLINE void for_row(int width, const Step& step) {
  const hn::ScalableTag<T> d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  int x = 0;
  for (; x + lanes <= width; x += lanes) step(d, x);
  for (; x < width; ++x) step(hn::CappedTag<T, 1>(), x);
}

void reject_ambiguous_row(const uint16_t* cost, const uint16_t* second, int width, int min_margin, uint16_t* winner) {
  for_row<uint16_t>(width, [&](auto d, int x) HWY_ATTR {
    const auto none = hn::Set(d, Correlation::kNone), rival = hn::LoadU(d, second + x);
    const auto margin = hn::SaturatedSub(rival, hn::LoadU(d, cost + x));
    const auto enough = hn::Set(d, static_cast<uint16_t>(std::clamp(min_margin, 0, 65535)));
    const auto sure = hn::And(hn::Eq(hn::Max(margin, enough), margin), hn::Ne(rival, none));
    hn::StoreU(hn::IfThenElse(sure, hn::LoadU(d, winner + x), none), d, winner + x);
  });
}

void reject_outermost_row(int width, int min_disparity, uint16_t* winner) {
  for_row<uint16_t>(width, [&](auto d, int x) HWY_ATTR {
    const auto column = hn::Iota(d, static_cast<uint16_t>(x)), last = hn::Set(d, static_cast<uint16_t>(width - 1));
    const auto w = hn::LoadU(d, winner + x), none = hn::Set(d, Correlation::kNone);
    const auto partner = hn::Sub(hn::Sub(column, hn::Set(d, static_cast<uint16_t>(min_disparity))), w);
    const auto at_left = hn::And(hn::Eq(partner, hn::Zero(d)), hn::Ne(column, hn::Zero(d)));
    const auto at_right = hn::And(hn::Eq(partner, last), hn::Ne(column, last));
    hn::StoreU(hn::IfThenElse(hn::Or(at_left, at_right), none, w), d, winner + x);
  });
}

void refine_row(const uint16_t* winner, const uint16_t* cost, const uint16_t* before, const uint16_t* after, int width,
                int min_disparity, SubPixel fit, float smallest, float* out) {
  const bool parabola = fit == SubPixel::parabola;
  const int none = fit == SubPixel::off ? 0 : Correlation::kNone;  // of the costs beside the winner
  for_row<float>(width, [&](auto d, int x) HWY_ATTR {
    const hn::RebindToSigned<decltype(d)> di;
    const hn::Rebind<uint16_t, decltype(d)> d16;
    const auto load = [&](const uint16_t* from) HWY_ATTR { return hn::PromoteTo(di, hn::LoadU(d16, from + x)); };
    const auto w = load(winner), here = load(cost), left = load(before), right = load(after);
    // V: the steeper side has the slope of both. Parabola: the mean of both sides' slopes is its curvature.
    const auto highest = hn::Max(left, right);
    const auto both = hn::Sub(parabola ? hn::Add(left, right) : hn::Add(highest, highest), hn::Add(here, here));
    const auto one = hn::Set(di, 1);
    const auto spread = hn::Max(both, one);
    const auto divisor = hn::ConvertTo(d, parabola ? hn::Add(spread, spread) : spread);
    const auto quotient = hn::Div(hn::ConvertTo(d, hn::Sub(left, right)), divisor);
    const auto inside = hn::And(hn::Lt(highest, hn::Set(di, none)), hn::Eq(spread, both));
    const auto whole = hn::ConvertTo(d, hn::Add(w, hn::Set(di, min_disparity)));
    const auto value = hn::Add(whole, hn::IfThenElseZero(hn::RebindMask(d, inside), quotient));
    const auto valid = hn::Lt(w, hn::Set(di, int{Correlation::kNone}));
    hn::StoreU(hn::IfThenElseZero(hn::RebindMask(d, valid), hn::Max(value, hn::Set(d, smallest))), d, out + x);
  });
}

}  // namespace iris::stereo::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace iris::stereo {

HWY_EXPORT(reject_ambiguous_row);
HWY_EXPORT(reject_outermost_row);
HWY_EXPORT(refine_row);

void reject_ambiguous(const Correlation& correlation, int min_margin, cv::Mat1w& winner) {
  for (int y = 0; y < winner.rows; ++y) {
    HWY_DYNAMIC_DISPATCH(reject_ambiguous_row)
    (correlation.cost[y], correlation.second[y], winner.cols, min_margin, winner[y]);
  }
}

void reject_outermost(int min_disparity, cv::Mat1w& winner) {
  for (int y = 0; y < winner.rows; ++y) {
    HWY_DYNAMIC_DISPATCH(reject_outermost_row)(winner.cols, min_disparity, winner[y]);
  }
}

void refine(const Correlation& correlation, const cv::Mat1w& winner, int min_disparity, SubPixel fit, float smallest,
            cv::Mat1f disparity) {
  for (int y = 0; y < winner.rows; ++y) {
    HWY_DYNAMIC_DISPATCH(refine_row)
    (winner[y], correlation.cost[y], correlation.before[y], correlation.after[y], winner.cols, min_disparity, fit,
     smallest, disparity[y]);
  }
}

}  // namespace iris::stereo
#endif  // HWY_ONCE
