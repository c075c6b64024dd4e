// Segment-based interpolation of invalid disparities (thesis 3.4.5).
#pragma once

#include "filters.h"
#include "iris/types/disparity_image.h"

namespace iris::stereo {

enum class Interpolation { off, within, everywhere };

// Every valid disparity is kept (origin measured). An invalid pixel looks for the nearest valid disparity to the left,
// right, above and below, and at the segments they belong to.
//   * All four of one segment: the mean of the linear interpolations along the row and along the column (3.5-3.7);
//     origin within_segment.
//   * Otherwise, if `everywhere`, origin between_segments:
//       - no valid pixel to the left: the right neighbour (this strip is seen by the left camera alone);
//       - row and column both lead to one segment by (3.5), (3.6): the mean of both (3.7);
//       - otherwise the second smallest of the neighbours. The thesis takes the smallest, the background; one wrong
//         small disparity among the four then spreads over the gap.
DisparityImage interpolate(const cv::Mat1f& disparity, const Segments& segments, Interpolation mode);

}  // namespace iris::stereo
