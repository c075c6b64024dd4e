// Chains the motions between views into poses (thesis 5.3.4, eq. 5.5). Never chains a guess: where no motion to an
// earlier view is found, a new sub-map begins.
#pragma once

#include <deque>
#include <vector>

#include "iris/motion/scs.h"

namespace iris::motion {

struct ChainStep {
  MotionEstimate estimate;   // against reference_frame; its status is not ok for the first view of a sub-map
  int reference_frame = -1;  // frame_idx of the earlier view; -1: none
  Pose world_from_cam = Pose::Identity();  // world = first camera of the sub-map
  int submap = 0;                          // counts from 0
  bool new_submap = false;                 // this view is the first of its sub-map
};

class MotionChain {
 public:
  // What the chain must know of an earlier view to go on.
  struct Restored {
    int frame_idx = 0;
    ViewFeatures features;
    Pose world_from_cam = Pose::Identity();
    int submap = 0;
  };

  MotionChain(const RectifiedCamera& camera, const ScsOptions& options) : camera_(camera), options_(options) {}

  // Goes on after earlier views, in their order: with the last retry_views + 1 of them (or all, if fewer) exactly as if
  // it had never been interrupted. `submaps`: how many sub-maps there are so far.
  void restore(std::vector<Restored> last_views, int submaps);

  // The pose of the next view. Its motion is estimated against the previous view and, if that fails, against up to
  // retry_views earlier ones, most recent first. They may belong to an earlier sub-map: a few spoilt views (blur, a
  // hand before the lens) become a sub-map of their own and the path goes on behind them.
  ChainStep push(ViewFeatures features, int frame_idx);

 private:
  RectifiedCamera camera_;
  ScsOptions options_;
  std::deque<Restored> views_;  // the last retry_views + 1
  int submaps_ = 0;
};

}  // namespace iris::motion
