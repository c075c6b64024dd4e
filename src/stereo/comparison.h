// Correlation measures and window configurations that the thesis compares (3.4.2, 3.5.1), by one plain implementation:
// several times slower than correlate(), which does the best of them.
#pragma once

#include "correlation.h"

namespace iris::stereo {

inline constexpr int kNccUnits = 10000;  // of cost per unit of 1 - NCC

enum class Measure {
  sad,  // as in correlate(): capped absolute differences, with census bits if there are any
  ssd,  // squares of the capped differences
  ncc,  // kNccUnits * (1 - normalised cross correlation with the means removed), of each window
};

struct ComparisonParameters {
  CorrelationParameters correlation;
  Measure measure = Measure::sad;
  int windows = 5;  // 1, 5, 9 or 25: the middle one, + 2 best of 4 (3.1), + 4 best of 8 (3.2), + 8 best of 16 (3.3)
  bool cut = true;  // windows that reach beyond the images are cut and scaled as in correlate(); else a candidate
                    // exists only if all of its windows lie inside of both images
};

// Windows that a cost sums up: 1, 3, 5, 13.
int windows_in_cost(int windows);

// Costs are divided by 2^cost_shift to fit into 16 bits.
int cost_shift(const ComparisonParameters& parameters, bool census);

// The windows of the inner ring stand on the border of the middle one (half a window away), those of the outer ring
// twice as far.
Correlation compare(const MatchImage& left, const MatchImage& right, const ComparisonParameters& parameters);

}  // namespace iris::stereo
