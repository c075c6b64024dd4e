// What takes the time of corners and their comparison, compiled for several instruction sets; every one of them gives
// the same bits.
#pragma once

#include <cstddef>
#include <cstdint>
#include <opencv2/core.hpp>
#include <vector>

#include "iris/motion/features.h"

namespace iris::motion {

constexpr int kPatchBorder = kPatchSize / 2 + kRankWindow / 2;  // [px] what a Rank patch needs around its centre
constexpr int kPatchSpan = 2 * kPatchBorder + 1;                // [px] side of the square that takes part in one

struct Maximum {
  int x = 0, y = 0;
  float value = 0;
};

// Pixels at least `border` >= 1 px inside the image whose value is at least `threshold` and above that of their eight
// neighbours, in reading order; of equal neighbours the first one counts.
std::vector<Maximum> local_maxima(const cv::Mat1f& values, float threshold, int border);

// The Rank patch of a square of kPatchSpan x kPatchSpan pixels, `stride` bytes from row to row.
RankPatch rank_of_square(const uint8_t* pixels, ptrdiff_t stride);

// The least different one of a set of patches.
struct NearestPatch {
  int difference = 0;  // sum of absolute differences
  int index = -1;      // -1: there is none; the lowest among equals
};

struct NearestPatches {
  std::vector<NearestPatch> of_a, of_b;  // nearest in b of each in a, and the other way round
};

NearestPatches nearest_patches(const std::vector<RankPatch>& a, const std::vector<RankPatch>& b);

}  // namespace iris::motion
