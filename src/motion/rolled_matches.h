// Corners that look alike although the camera rolled about its optical axis by any angle and came nearer or went away
// (beyond thesis 5.3.2, whose comparison bears little of either).
#pragma once

#include <vector>

#include "iris/motion/features.h"

namespace iris::motion {

struct RolledMatch {
  int prev_corner = 0, cur_corner = 0;
  double roll = 0;  // [rad] by which the current surroundings, turned clockwise, look like the previous ones
};

// Matches with about the same roll.
struct RolledMatches {
  double roll = 0;  // [rad]
  std::vector<RolledMatch> matches;
};

// Surroundings are resampled: turned in steps of 30 degrees, and scaled by the ratio of the two corners' depths, which
// stereo knows. Each group holds the pairs that are each other's best match among three neighbouring rolls; the groups
// with most pairs that are so among all rolls first, at most `groups`.
std::vector<RolledMatches> rolled_matches(const ViewFeatures& prev, const ViewFeatures& cur, const ScsOptions& options,
                                          int groups);

}  // namespace iris::motion
