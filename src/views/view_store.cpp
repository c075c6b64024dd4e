#include "iris/views/view_store.h"

#include <algorithm>

namespace iris::views {

ViewSummary summarise(const StereoView& view) {
  ViewSummary summary{
      .frame_idx = view.frame_idx, .submap = view.submap, .camera = view.camera, .world_from_cam = view.world_from_cam};
  float low = 0, high = 0;
  for (const float d : view.disparity.disparity) {
    if (d <= 0) continue;
    low = low == 0 ? d : std::min(low, d);
    high = std::max(high, d);
  }
  summary.min_disparity = low;
  summary.max_disparity = high;
  return summary;
}

MemoryViewStore::MemoryViewStore(std::vector<StereoView> views) {
  for (StereoView& view : views) {
    summaries_.push_back(summarise(view));
    views_.push_back(std::make_shared<const StereoView>(std::move(view)));
  }
}

}  // namespace iris::views
