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

double median_depth(const ViewStore& store, int samples) {
  std::vector<double> depths;
  const int count = static_cast<int>(store.summaries().size());
  samples = std::min(samples, count);
  for (int i = 0; i < samples; ++i) {
    const auto view = store.load(static_cast<int>(static_cast<int64_t>(count) * (2 * i + 1) / (2 * samples)));
    const RectifiedCamera& camera = view->camera;
    for (const float d : view->disparity.disparity) {
      if (d > 0) depths.push_back(camera.f * camera.baseline / (d + camera.disparity_offset));
    }
  }
  if (depths.empty()) return 0;
  const auto middle = depths.begin() + static_cast<std::ptrdiff_t>(depths.size() / 2);
  std::nth_element(depths.begin(), middle, depths.end());
  return *middle;
}

}  // namespace iris::views
