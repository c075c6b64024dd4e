#include "iris/motion/chain.h"

#include <utility>

namespace iris::motion {

void MotionChain::restore(std::vector<Restored> last_views, int submaps) {
  submaps_ = submaps;
  views_.assign(std::make_move_iterator(last_views.begin()), std::make_move_iterator(last_views.end()));
}

ChainStep MotionChain::push(ViewFeatures features, int frame_idx) {
  ChainStep step;
  bool found = false;
  int tried = 0;
  for (auto view = views_.rbegin(); view != views_.rend() && tried <= options_.retry_views; ++view, ++tried) {
    const MotionEstimate estimate = estimate_motion(view->features, features, camera_, options_);
    found = estimate.status == MotionStatus::ok;
    // After a failure the estimate against the previous view tells best what happened.
    if (found || tried == 0) step.estimate = estimate;
    if (!found) continue;
    step.reference_frame = view->frame_idx;
    step.submap = view->submap;
    step.world_from_cam = view->world_from_cam * estimate.prev_from_cur;  // (5.5)
    step.world_from_cam.linear() = nearest_rotation(step.world_from_cam.linear());
    break;
  }
  if (!found) {
    step.new_submap = true;
    step.submap = submaps_++;
    if (views_.empty()) step.estimate.corners = static_cast<int>(features.corners.size());
  }
  views_.push_back({frame_idx, std::move(features), step.world_from_cam, step.submap});
  while (static_cast<int>(views_.size()) > options_.retry_views + 1) views_.pop_front();
  return step;
}

}  // namespace iris::motion
