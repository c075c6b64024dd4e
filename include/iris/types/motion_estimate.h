#pragma once

#include "iris/geometry/pose.h"

namespace iris {

// ambiguous: two sets of correspondences of similar size contradict each other (repetitive texture).
// guessed: no motion was found, the one before was continued.
enum class MotionStatus { ok, too_few_corners, too_few_consistent, degenerate, ambiguous, guessed };

// "ok", "too few corners" …, for people.
inline const char* name_of(MotionStatus status) {
  switch (status) {
    case MotionStatus::ok:
      return "ok";
    case MotionStatus::too_few_corners:
      return "too few corners";
    case MotionStatus::too_few_consistent:
      return "too few consistent";
    case MotionStatus::degenerate:
      return "degenerate";
    case MotionStatus::ambiguous:
      return "ambiguous";
    case MotionStatus::guessed:
      return "guessed";
  }
  return "";
}

// Camera motion between two views.
struct MotionEstimate {
  MotionStatus status = MotionStatus::too_few_corners;
  Pose prev_from_cur = Pose::Identity();
  Matrix6d covariance = Matrix6d::Zero();  // translation [m], then rotation [rad], both as a left perturbation in
                                           // `prev`: t' = t + dt, R' = exp(dw) R
  int corners = 0;                         // usable corners of the current view
  int initial = 0;                         // correspondences before the consistency test
  int consistent = 0;                      // after it
  int used = 0;                            // of the last minimisation, after Chauvenet; with motion.predict these are
                                           // pairs found again where the first motion predicts them, mostly more
  double rms_px = 0;                       // image-based residual per coordinate
};

}  // namespace iris
