// The range of disparities that a recording needs.
#pragma once

#include <vector>

#include "iris/stereo/mwmf.h"
#include "iris/types/stereo_frame.h"

namespace iris::stereo {

struct SearchRange {
  int disparities = 64;  // [px] number of disparities to search from options.min_disparity on; a multiple of 16
  int matches = 0;    // measured pixels (of the images at half size) that this rests on; 0 = nothing could be matched,
                      // `disparities` is then a guess
  float largest = 0;  // [px] disparity that 99.7 % of the matches do not exceed
  double beyond = 0;  // fraction of the matches that are nearer than the range reaches
};

// Correlates sample pairs at half their size over a range up to min(512, width / 2) px and takes the range that
// holds 99.7 % of what is measured on surfaces of at least 0.2 % of a frame, with strict filters. A dozen pairs spread
// over the recording do. Of the options, min_disparity alone is used.
SearchRange estimate_search_range(const std::vector<StereoPair>& sample_pairs, const MwmfOptions& options);

// Fraction of the measured pixels whose disparity is within 2 px of the upper end of the search range: nearly none as
// long as the range is wide enough. 0 if nothing was measured.
double fraction_at_limit(const DisparityImage& disparity, const MwmfOptions& options);

}  // namespace iris::stereo
