// Many views of one surface become one: each point of a view is moved along its line of sight to where all views that
// see it agree, and dropped if others look through it.
#pragma once

#include <memory>
#include <vector>

#include "iris/core/options.h"
#include "iris/types/stereo_view.h"

namespace iris::reconstruct {

struct FusionOptions {
  double pixel_error = 0.1;  // [px] standard deviation of image coordinates, the dp of (4.14)
  double min_disparity = 4;  // [px] points of smaller disparity are far away and uncertain (thesis 6.3)
  double max_range = 40;  // [m] farther points are left out: their error grows with the square of the distance (4.24)
  int step = 2;           // [px] every n-th row and column gives points
  int neighbours = 12;    // other views that each view is compared with
  double gate = 3;        // [standard deviations] views that differ by less measure the same surface

  void declare(OptionSet& set);  // section "cloud"
};

// A pixel of a view after fusion.
struct FusedPixel {
  int x = 0, y = 0;     // [px]
  float disparity = 0;  // [px] information-weighted mean of all views that agree, as this view would measure it
  float sigma = 0;      // [px] its standard deviation
  float slope_x = 0, slope_y = 0;  // [px/px] of the disparity: the surface's tilt
  int agree = 0;                   // other views that measure the same surface
  int through = 0;                 // other views that see a surface behind: this one cannot be there
};

struct FusedView {
  std::vector<FusedPixel> pixels;  // those of `step` that have a disparity, row by row
  // Differences between this view and the others, in the standard deviations that pixel_error gives them; what differs
  // by more than `gate` times `error_scale` is not among them.
  std::vector<float> differences;
};

// `view` against `others`, all in one world. With P the point of a pixel and q the point that another view measures
// where P appears in it, q is carried along the surface (a plane in disparity space: d = slope_x x + slope_y y + c) to
// P's line of sight: what that view says of the pixel's disparity. Its variance follows from those of the four image
// coordinates (table 4.1). Disparities up to within_segment are used.
// Sigma is by covariance intersection with equal parts (Julier, Uhlmann 1997): the mean of the views' information, not
// its sum. Views that match the same texture, and whose poses come from the same corners, err alike to an unknown
// degree, so that their number promises nothing: in a simulated apartment the errors of points that 3 and that 10 views
// agree on are the same.
// `error_scale`: errors are so many times larger than pixel_error says (see error_scale_of).
FusedView fuse_view(const StereoView& view, const std::vector<std::shared_ptr<const StereoView>>& others,
                    const FusionOptions& options, double error_scale = 1);

// How many times larger the errors of this recording are than pixel_error says: the median of the absolute differences
// over that of a normal distribution. 1 if there are none.
double error_scale_of(std::vector<float> differences);

// Indices into `cameras` (all views' poses in one world) of the views that see most of what `view` sees, best first; at
// most options.neighbours. Counted by points of the view that fall into the other's image, less if that one sees them
// from much nearer or farther. Ties by the smaller index.
struct PlacedCamera {
  RectifiedCamera camera;
  Pose world_from_cam = Pose::Identity();
};
std::vector<int> overlapping_views(const StereoView& view, const std::vector<PlacedCamera>& cameras, int view_idx,
                                   const FusionOptions& options);

}  // namespace iris::reconstruct
