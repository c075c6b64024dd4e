#pragma once

#include "iris/geometry/pose.h"

namespace iris {

enum class MotionStatus { ok, too_few_corners, too_few_consistent, degenerate };

// Camera motion between two views.
struct MotionEstimate {
  MotionStatus status = MotionStatus::too_few_corners;
  Pose prev_from_cur = Pose::Identity();
  Matrix6d covariance = Matrix6d::Zero();  // translation [m], then rotation [rad], both as a left perturbation in
                                           // `prev`: t' = t + dt, R' = exp(dw) R
  int corners = 0;                         // usable corners of the current view
  int initial = 0;                         // correspondences before the consistency test
  int consistent = 0;                      // after it
  int used = 0;                            // after Chauvenet
  double rms_px = 0;                       // image-based residual per coordinate
};

}  // namespace iris
