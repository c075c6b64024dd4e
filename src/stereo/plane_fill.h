// Extrapolation of surfaces into large areas without disparities (asked for in thesis ch. 10): untextured walls and
// floors that slant.
#pragma once

#include <opencv2/core.hpp>

#include "filters.h"
#include "iris/types/disparity_image.h"

namespace iris::stereo {

struct PlaneFillParameters {
  int min_area = 400;        // [px] smaller gaps are left as they are
  int band = 24;             // [px] measured pixels at most so far away from the gap, along rows and columns, count
  int min_samples = 100;     // of a segment, for a plane
  double tolerance = 0.7;    // [px] most that a sample may be off the plane
  double min_inliers = 0.7;  // fraction of the samples that must not be
  double max_slope = 0.5;    // [px per px] of the plane, along rows and along columns
  double max_error = 0.1;    // [px] largest standard deviation of what is extrapolated
};

// Replaces, in large gaps, the constant disparity that between_segments pixels took from a segment by a plane
// d = a x + b y + c through that segment's measured disparities next to the gap. `measured` is what was interpolated
// (0 = gap), `source` names for each pixel of `filled` the segment that filled it (-1 = none).
//
// The plane is found by consensus (pixels next to objects often have the object's disparity) and fitted to what agrees
// with it. A pixel stays as it is if the segment has too few samples there, if they do not lie on a plane, if the plane
// is uncertain at the pixel, or if an end of the gap in its row or column is of the segment but clearly off the plane.
// No pixel gets a disparity below `smallest` or one nearer than these four ends.
void fill_planes(const cv::Mat1f& measured, const Segments& segments, const cv::Mat1i& source, float smallest,
                 const PlaneFillParameters& parameters, DisparityImage& filled);

}  // namespace iris::stereo
