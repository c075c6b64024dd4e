// Chains the motions between views into poses (thesis 5.3.4, eq. 5.5). What to do about a failed motion, in order: the
// last few views, many more corners and SIFT, then (only if asked for) the last motion continued, then a new sub-map.
// A view that shows too little for any motion begins none: it gets no pose.
#pragma once

#include <algorithm>
#include <deque>
#include <optional>
#include <vector>

#include "iris/motion/rescue.h"
#include "iris/motion/scs.h"

namespace iris::motion {

struct ChainStep {
  // Against reference_frame; its status is ok, or guessed. For the first view of a sub-map, and for one without a pose:
  // why there is none.
  MotionEstimate estimate;
  std::vector<Correspondence> initial, consistent, used;  // of that estimate
  int reference_frame = -1;                               // frame_idx of the earlier view; -1: none
  Pose world_from_cam = Pose::Identity();                 // world = first camera of the sub-map
  int submap = 0;                                         // counts from 0
  bool new_submap = false;                                // this view is the first of its sub-map
  bool blind = false;    // too few corners to relate it to any view: no pose, no sub-map; the chain forgets it
  bool rescued = false;  // found by the second attempt (rescue.h)
};

class MotionChain {
 public:
  // What the chain must know of an earlier view to go on.
  struct Restored {
    int frame_idx = 0;
    ViewFeatures features;
    Pose world_from_cam = Pose::Identity();
    int submap = 0;
    bool guessed = false;      // by its estimate's status
    int reference_frame = -1;  // of its estimate
    Pose reference_from_cam = Pose::Identity();
  };

  MotionChain(const RectifiedCamera& camera, const ScsOptions& options) : camera_(camera), options_(options) {}

  // Goes on after earlier views, in their order: with the last kept_views() of them (or all, if fewer) and their
  // reference views exactly as if it had never been interrupted. `submaps`: how many sub-maps there are so far.
  void restore(std::vector<Restored> last_views, int submaps);

  // How many views the chain remembers, beside those that they rest at.
  int kept_views() const { return std::max(options_.retry_views + 1, options_.window); }

  // The pose of the next view. Its motion is estimated against the previous view (the one that this rests at, if it
  // rests) and, if that fails, against up to retry_views earlier ones, most recent first; then once more against the
  // last options.window views that do not rest. They may belong to an earlier sub-map: a few spoilt views (blur, a
  // hand before the lens) get no pose or become a sub-map of their own, and the path goes on behind them.
  ChainStep push(ViewFeatures features, int frame_idx);

  // The features of the view pushed last or of its reference_frame; null if there is no such view.
  const ViewFeatures* view(int frame_idx) const;

 private:
  struct View : Restored {
    std::optional<RescueFeatures> rescue = std::nullopt;  // made when first needed
    int rests_at = -1;                                    // frame_idx of the reference view; -1: it moved
  };

  bool find_motion(const ViewFeatures& features, ChainStep& step);
  bool rescue(const ViewFeatures& features, ChainStep& step);
  bool blind(const ViewFeatures& features) const;
  bool guess(int frame_idx, ChainStep& step) const;
  void measure_in_window(const ViewFeatures& features, ChainStep& step) const;
  const View* find(int frame_idx) const;
  int resting_place(const Restored& view) const;
  void settle(View& view);
  void forget();

  RectifiedCamera camera_;
  ScsOptions options_;
  std::deque<View> views_;  // the last kept_views(), one more after a push, and what these rest at
  int submaps_ = 0;
};

}  // namespace iris::motion
