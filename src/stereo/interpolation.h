// Segment-based interpolation of invalid disparities (thesis 3.4.5).
#pragma once

#include "filters.h"
#include "iris/types/disparity_image.h"

namespace iris::stereo {

enum class Interpolation { off, within, everywhere };

struct InterpolationParameters {
  Interpolation mode = Interpolation::everywhere;
  bool second_smallest = true;  // between segments; else the smallest, as in the thesis
  bool left_from_right = true;  // runs at the left edge continue their right neighbour alone
  bool hidden_strips = true;    // strips that an object hides from the right camera continue their left neighbour
};

// Every valid disparity is kept; its origin is measured, or corrected where `corrected` (empty = nowhere) is not 0. An
// invalid pixel looks for the nearest valid disparity to the left, right, above and below, and at the segments they
// belong to.
//   * hidden_strips and the gap in its row is a strip that the object at its right end hides from the right camera: the
//     left neighbour. The right neighbour is nearer than the left one then, and the gap at most 6 px wider than the
//     step of disparity, half a window on either side. Within one segment (an object that stands on the floor) the step
//     is more than 2 px and at least half as large as the gap. Origin as below.
//   * All four of one segment: the mean of the linear interpolations along the row and along the column (3.5-3.7);
//     origin within_segment.
//   * Otherwise, if `everywhere`, origin between_segments:
//       - left_from_right and no valid pixel to the left: the right neighbour (this strip is seen by the left camera
//         alone);
//       - row and column both lead to one segment by (3.5), (3.6): the mean of both (3.7);
//       - otherwise the smallest of the neighbours, the background; or the second smallest: one wrong small disparity
//         among the four then does not spread over the gap.
//
// source (may be null): for each filled pixel the segment whose disparity it has, -1 elsewhere.
DisparityImage interpolate(const cv::Mat1f& disparity, const cv::Mat1b& corrected, const Segments& segments,
                           const InterpolationParameters& parameters, cv::Mat1i* source = nullptr);

}  // namespace iris::stereo
