// Whether two views show what a motion between them lets expect. Repeated texture, or few pairs that fit each other by
// chance, give motions that their own pairs confirm and everything else contradicts.
#pragma once

#include "iris/geometry/pose.h"
#include "iris/motion/features.h"

namespace iris::motion {

struct Agreement {
  // Corners of the previous view where the current one shows a surface at the predicted disparity: these should be
  // found there again.
  int expected = 0;
  // Measured points of either view, on a grid, that the other one measures too or looks through: it sees something
  // behind them.
  int agreeing = 0, against = 0;

  double contradiction() const { return against == 0 ? 0 : static_cast<double>(against) / (agreeing + against); }
};

Agreement agreement(const ViewFeatures& prev, const ViewFeatures& cur, const Pose& prev_from_cur,
                    const RectifiedCamera& camera);

}  // namespace iris::motion
