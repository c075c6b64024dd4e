// Camera motion between two stereo views from spatially consistent sets of corners (SCS, thesis ch. 5).
#pragma once

#include <vector>

#include "iris/motion/correspondences.h"
#include "iris/motion/features.h"
#include "iris/motion/scs_options.h"
#include "iris/types/motion_estimate.h"

namespace iris::motion {

// The motion of the camera from `prev` to `cur`. Nothing is predicted from earlier motions: the views may be any two
// that overlap, whatever their order in time. A failure is the estimate's status:
//   too_few_corners     one of the views has less than options.min_used corners;
//   too_few_consistent  no rigid motion explains options.min_used correspondences and agrees with what else the views
//                       show (agreement.h);
//   degenerate          the correspondences lie on a line, too close together or too far away to tell the motion;
//   ambiguous           two sets of correspondences of similar size tell different motions.
MotionEstimate estimate_motion(const ViewFeatures& prev, const ViewFeatures& cur, const RectifiedCamera& camera,
                               const ScsOptions& options);

// An estimate with the correspondences it comes from.
struct TracedMotion {
  MotionEstimate estimate;
  std::vector<Correspondence> initial, consistent, used;
};
TracedMotion trace_motion(const ViewFeatures& prev, const ViewFeatures& cur, const RectifiedCamera& camera,
                          const ScsOptions& options);

// The motion that most of the given correspondences agree on; `roll` [rad]: what the current view, known
// beforehand, is to be turned clockwise by to stand like the previous one. estimate.corners stays 0.
TracedMotion motion_from(const std::vector<Correspondence>& initial, double roll, const RectifiedCamera& camera,
                         const ScsOptions& options);

// All corners looked for again where a successful motion predicts them; returns the better of both.
TracedMotion with_predicted(const TracedMotion& motion, const ViewFeatures& prev, const ViewFeatures& cur,
                            const RectifiedCamera& camera, const ScsOptions& options);

// The same; too_few_consistent if the corners and disparities of the two views do not bear the motion out.
TracedMotion confirmed(const TracedMotion& motion, const ViewFeatures& prev, const ViewFeatures& cur,
                       const RectifiedCamera& camera, const ScsOptions& options);

// An earlier view whose pose relative to the previous one is known.
struct WindowView {
  const ViewFeatures* features;
  Pose prev_from_view;
};

// A successful motion measured once more, against the previous view and the others at once: the current pose and the
// positions of all points are those of the least image based error over all views, the other poses being given.
// Corners of the others are looked for where the motion predicts them. Other error models leave the motion as it is.
TracedMotion with_window(const TracedMotion& motion, const std::vector<WindowView>& others, const ViewFeatures& cur,
                         const RectifiedCamera& camera, const ScsOptions& options);

}  // namespace iris::motion
