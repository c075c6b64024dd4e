// Filters that reject wrong matches, and the sub-pixel fit (thesis 3.4.1, 3.4.3).
#pragma once

#include <opencv2/core.hpp>

#include "correlation.h"

namespace iris::stereo {

// Correlation function error filter (3.4): rejects a winner (sets it to Correlation::kNone) if the second minimum is
// less than `min_margin` [cost units] above it, or if there is none to compare with (at the very edge of the image).
void reject_ambiguous(const Correlation& correlation, int min_margin, cv::Mat1w& winner);

// Rejects winners whose partner is the outermost column of the right image: the candidate behind it does not exist, so
// that nobody knows whether the cost still falls. Nearly all of them are pixels that the right camera does not see.
void reject_outermost(int min_disparity, cv::Mat1w& winner);

// Left/right check: rejects a winner if the search from the right image, at the corresponding pixel, found a disparity
// that differs by more than `tolerance` [px].
void reject_one_sided(const cv::Mat1w& right_winner, int min_disparity, double tolerance, cv::Mat1w& winner);

// What is fitted to the costs of the winner and its two neighbours.
enum class SubPixel {
  off,
  parabola,  // as in the thesis
  v,         // two lines of equal slope: sums of absolute differences grow linearly around their minimum
};

// Disparities [px] of the remaining winners, 0 = none: the minimum of the fitted function. At the ends of the search
// range without refinement. Values below `smallest` are set to it. `disparity` has the size of `winner`.
void refine(const Correlation& correlation, const cv::Mat1w& winner, int min_disparity, SubPixel fit, float smallest,
            cv::Mat1f disparity);

// Takes the pull towards (or away from) whole pixels out of refined disparities. Costs do not grow exactly linearly, so
// that a surface at phase p between two pixels is measured at p - A sin(2 pi p), with an A that depends on texture,
// filter and cap. Phases are spread evenly over the pixels of a slanting or rugged scene, then the mean of
// cos(2 pi measured) is pi A to first order, and A follows from the disparities themselves. It is estimated for each
// whole disparity; as far as these estimates contradict each other (frontal planes, whose phases are not spread), A is
// lowered, in the end to 0.
void equalise(const cv::Mat1w& winner, int min_disparity, cv::Mat1f& disparity);

// Labels of 4-connected segments of valid disparities (> 0) whose neighbours differ by at most `tolerance` [px];
// -1 = invalid. Labels count from 0 in the order of each segment's first pixel. `sizes` [px] per label. `runs`: of
// pixels of one segment next to each other in a row, begin … end - 1, row by row.
struct Segments {
  struct Run {
    int y, begin, end, label;
  };
  cv::Mat1i label;
  std::vector<int> sizes;
  std::vector<Run> runs;
};
Segments find_segments(const cv::Mat1f& disparity, double tolerance);

// Segment filter: disparities of segments smaller than `min_size` [px] become 0, their labels -1.
void reject_small(int min_size, cv::Mat1f& disparity, Segments& segments);

}  // namespace iris::stereo
