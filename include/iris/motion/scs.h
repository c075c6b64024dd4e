// Camera motion between two stereo views from spatially consistent sets of corners (SCS, thesis ch. 5).
#pragma once

#include "iris/motion/features.h"
#include "iris/motion/scs_options.h"
#include "iris/types/motion_estimate.h"

namespace iris::motion {

// The motion of the camera from `prev` to `cur`. Nothing is predicted: the views may be any two that overlap, whatever
// their order in time. A failure is the estimate's status:
//   too_few_corners     one of the views has less than options.min_used corners;
//   too_few_consistent  no rigid motion explains options.min_used correspondences;
//   degenerate          the correspondences lie on a line or too close together to tell the rotation.
MotionEstimate estimate_motion(const ViewFeatures& prev, const ViewFeatures& cur, const RectifiedCamera& camera,
                               const ScsOptions& options);

}  // namespace iris::motion
