// Access to stored stereo views without holding all of them in memory.
#pragma once

#include <memory>
#include <vector>

#include "iris/types/stereo_view.h"

namespace iris::views {

// What selection needs to know of a view without reading its pictures.
struct ViewSummary {
  int frame_idx = 0;
  int submap = 0;
  RectifiedCamera camera;
  Pose world_from_cam = Pose::Identity();
  double min_disparity = 0;  // [px] smallest and largest valid disparity of the view: its depth range
  double max_disparity = 0;  // [px] 0 = the view has no valid disparity
};

// Views in the order of their frames. Implementations may be called from several threads.
class ViewStore {
 public:
  virtual ~ViewStore() = default;
  virtual const std::vector<ViewSummary>& summaries() const = 0;
  // The whole view; index into summaries(). Throws InputError if its files are damaged.
  virtual std::shared_ptr<const StereoView> load(int index) const = 0;
};

// All views in memory: for tests and small programs.
class MemoryViewStore : public ViewStore {
 public:
  explicit MemoryViewStore(std::vector<StereoView> views);
  const std::vector<ViewSummary>& summaries() const override { return summaries_; }
  std::shared_ptr<const StereoView> load(int index) const override { return views_[static_cast<size_t>(index)]; }

 private:
  std::vector<std::shared_ptr<const StereoView>> views_;
  std::vector<ViewSummary> summaries_;
};

// The summary of a view (scans its disparities).
ViewSummary summarise(const StereoView& view);

}  // namespace iris::views
