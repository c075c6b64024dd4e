// Filters of single winners and the sub-pixel fit, row by row in vectors.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <functional>
#include <vector>

#include "filters.h"
#include "iris/core/parallel.h"

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

void reject_one_sided_row(const uint16_t* right_winner, int width, int min_disparity, int largest, uint16_t* winner) {
  const hn::ScalableTag<int32_t> d;
  const hn::Rebind<uint16_t, decltype(d)> d16;
  const int lanes = static_cast<int>(hn::Lanes(d));
  int x = 0;
  if (lanes > 1) {
    const auto none = hn::Set(d, int{Correlation::kNone}), zero = hn::Zero(d), one = hn::Set(d, 1);
    for (; x + lanes <= width; x += lanes) {
      const auto w = hn::PromoteTo(d, hn::LoadU(d16, winner + x));
      const auto shifted = hn::Sub(hn::Iota(d, x - min_disparity), w);
      const auto partner = hn::IfThenElse(hn::Eq(w, none), zero, shifted);
      // Two pixels are read at once: the partner, and the one before it unless it is the first.
      const auto offset = hn::Max(hn::Sub(hn::Add(partner, partner), hn::Set(d, 2)), zero);
      const auto two = hn::GatherOffset(d, reinterpret_cast<const int32_t*>(right_winner), offset);
      const auto low = hn::And(two, none), high = hn::And(hn::ShiftRight<16>(two), none);
      const auto from_right = hn::IfThenElse(hn::Lt(partner, one), low, high);
      const auto differs = hn::Gt(hn::Abs(hn::Sub(from_right, w)), hn::Set(d, largest));
      hn::StoreU(hn::DemoteTo(d16, hn::IfThenElse(differs, none, w)), d16, winner + x);
    }
  }
  for (; x < width; ++x) {
    const int partner = winner[x] == Correlation::kNone ? 0 : x - min_disparity - winner[x];
    if (std::abs(right_winner[partner] - winner[x]) > largest) winner[x] = Correlation::kNone;
  }
}

// Phases of disparities between whole pixels, -1/2 … 1/2, as indices 0 … steps; steps + 1 for pixels without disparity
// and for the smallest disparity, which stands for infinity.
template <class D>
HWY_INLINE auto phase_index(D d, const uint16_t* winner, const float* disparity, int min_disparity, int steps) {
  const hn::RebindToSigned<D> di;
  const hn::Rebind<uint16_t, D> d16;
  const auto half = hn::Set(d, 0.5f);
  const auto w = hn::Add(hn::PromoteTo(di, hn::LoadU(d16, winner)), hn::Set(di, min_disparity));
  const auto phase = hn::Add(hn::Sub(hn::LoadU(d, disparity), hn::ConvertTo(d, w)), half);
  const auto inside = hn::And(hn::Ge(phase, hn::Zero(d)), hn::Le(phase, hn::Set(d, 1.0f)));
  const auto scaled = hn::Add(hn::Mul(phase, hn::Set(d, static_cast<float>(steps))), half);
  const auto nearest = hn::ConvertTo(di, hn::IfThenElseZero(inside, scaled));
  return hn::IfThenElse(hn::RebindMask(di, inside), nearest, hn::Set(di, steps + 1));
}

void phase_indices(const uint16_t* winner, const float* disparity, int width, int min_disparity, int steps,
                   int32_t* index) {
  for_row<float>(width, [&](auto d, int x) HWY_ATTR {
    const hn::RebindToSigned<decltype(d)> di;
    hn::StoreU(phase_index(d, winner + x, disparity + x, min_disparity, steps), di, index + x);
  });
}

// correction: of the phases 0 … steps, and of others.
void correct_phases(const uint16_t* winner, int width, int min_disparity, int steps, const float* correction,
                    float* disparity) {
  for_row<float>(width, [&](auto d, int x) HWY_ATTR {
    const auto index = phase_index(d, winner + x, disparity + x, min_disparity, steps);
    hn::StoreU(hn::Add(hn::LoadU(d, disparity + x), hn::GatherIndex(d, correction, index)), d, disparity + x);
  });
}

}  // namespace iris::stereo::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace iris::stereo {

HWY_EXPORT(reject_ambiguous_row);
HWY_EXPORT(reject_outermost_row);
HWY_EXPORT(refine_row);
HWY_EXPORT(reject_one_sided_row);
HWY_EXPORT(phase_indices);
HWY_EXPORT(correct_phases);

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

void reject_one_sided(const cv::Mat1w& right_winner, int min_disparity, double tolerance, cv::Mat1w& winner) {
  const int largest = static_cast<int>(std::floor(tolerance));
  for (int y = 0; y < winner.rows; ++y) {
    HWY_DYNAMIC_DISPATCH(reject_one_sided_row)(right_winner[y], winner.cols, min_disparity, largest, winner[y]);
  }
}

namespace {

constexpr int kRowsPerChunk = 32;
constexpr int kPhases = 64;  // per pixel of disparity, for the estimate of the pull

// A of equalise().
double estimate_pull(const cv::Mat1w& winner, int min_disparity, const cv::Mat1f& disparity) {
  constexpr double kLowest = -0.06, kHighest = 0.13;  // beyond these it is not texture that causes them
  // Of the phases of each whole disparity, one a chunk of rows. The last bin takes what does not count, as does the
  // first histogram: pixels without disparity; that of disparity w is the one after w.
  using Histogram = std::array<int, kPhases + 2>;
  constexpr int kRowsPerHistogram = 128;
  std::vector<std::vector<Histogram>> chunks((winner.rows + kRowsPerHistogram - 1) / kRowsPerHistogram);
  parallel_chunks(0, winner.rows, kRowsPerHistogram, [&](int y0, int y1) {
    std::vector<Histogram>& histograms = chunks[y0 / kRowsPerHistogram];
    std::vector<int> index(winner.cols);
    for (int y = y0; y < y1; ++y) {
      const uint16_t* w = winner[y];
      const int width = winner.cols;
      HWY_DYNAMIC_DISPATCH(phase_indices)(w, disparity[y], width, min_disparity, kPhases, index.data());
      uint16_t largest = 0;
      for (int x = 0; x < width; ++x) largest = std::max(largest, static_cast<uint16_t>(w[x] + 1));
      if (largest >= histograms.size()) histograms.resize(largest + 1, Histogram{});
      for (int x = 0; x < width; ++x) ++histograms[static_cast<uint16_t>(w[x] + 1)][index[x]];
    }
  });
  std::vector<Histogram> histograms;
  for (const std::vector<Histogram>& chunk : chunks) {
    if (chunk.size() > histograms.size()) histograms.resize(chunk.size(), Histogram{});
    for (size_t i = 0; i < chunk.size(); ++i) {
      std::transform(chunk[i].begin(), chunk[i].end(), histograms[i].begin(), histograms[i].begin(), std::plus());
    }
  }
  std::array<double, kPhases + 1> cosines;
  for (int i = 0; i <= kPhases; ++i) cosines[i] = std::cos(2 * CV_PI * (static_cast<double>(i) / kPhases - 0.5));
  struct Level {
    double pixels = 0, cosine = 0;
  };
  std::vector<Level> levels;
  double all = 0;
  for (size_t i = 1; i < histograms.size(); ++i) {
    const Histogram& histogram = histograms[i];
    Level level;
    for (int k = 0; k <= kPhases; ++k) {
      level.pixels += histogram[k];
      level.cosine += histogram[k] * cosines[k];
    }
    if (level.pixels == 0) continue;
    level.cosine /= level.pixels;
    all += level.pixels;
    levels.push_back(level);
  }
  if (levels.size() < 3) return 0;
  // A single large plane must not outvote all others.
  const double most = all / static_cast<double>(levels.size());
  double weights = 0, mean = 0, squares = 0;
  for (const Level& level : levels) {
    weights += std::min(level.pixels, most);
    mean += std::min(level.pixels, most) * level.cosine;
  }
  mean /= weights;
  for (const Level& level : levels) {
    const double term = std::min(level.pixels, most) / weights * (level.cosine - mean);
    squares += term * term;  // of the standard error of the mean
  }
  const double trust = mean == 0 ? 0 : std::max(0.0, 1 - squares / (mean * mean));
  return std::clamp(trust * mean / CV_PI, kLowest, kHighest);
}

}  // namespace

void equalise(const cv::Mat1w& winner, int min_disparity, cv::Mat1f& disparity) {
  const double pull = estimate_pull(winner, min_disparity, disparity);
  if (pull == 0) return;
  // Correction of a measured phase, tabulated: the p at which p - A sin(2 pi p) is the measured one.
  constexpr int kTable = 1024;
  std::array<float, kTable + 2> correction;  // the last one for pixels that stay
  correction.back() = 0;
  double phase = -0.5;  // of the measured phase before it, where Newton's method starts
  for (int i = 0; i <= kTable; ++i) {
    const double measured = static_cast<double>(i) / kTable - 0.5;
    for (int k = 0; k < 20; ++k) {  // a few suffice: 2 pi A < 1
      const double step = (phase - pull * std::sin(2 * CV_PI * phase) - measured) /
                          (1 - 2 * CV_PI * pull * std::cos(2 * CV_PI * phase));
      phase -= step;
      if (std::abs(step) < 1e-10) break;
    }
    correction[i] = static_cast<float>(phase - measured);
  }
  parallel_chunks(0, winner.rows, kRowsPerChunk, [&](int y0, int y1) {
    for (int y = y0; y < y1; ++y) {
      HWY_DYNAMIC_DISPATCH(correct_phases)
      (winner[y], winner.cols, min_disparity, kTable, correction.data(), disparity[y]);
    }
  });
}

}  // namespace iris::stereo
#endif  // HWY_ONCE
