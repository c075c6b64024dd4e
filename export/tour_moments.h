// The stereo view of any recorded moment, for dynamic novel views (thesis 8.3.3): runs store a view only when the
// camera has moved, but a scene that changes looks different every moment.
#pragma once

#include <memory>
#include <vector>

#include "export/products.h"

namespace iris::exporters {

class Moments {
 public:
  virtual ~Moments() = default;
  // The view of the last recorded frame that is not later than the moment (or of the first one). May be called from
  // several threads.
  virtual std::shared_ptr<const StereoView> view(int64_t stamp_ns) const = 0;
};

// Of the frames of `nodes` (one sub-map, in order): read from the session that the run was made of, rectified and
// matched anew, with the run's options and its refined poses. If the session is no longer there, the stored views are
// used, with a warning. `options` must outlive the result; `stored` too.
std::unique_ptr<Moments> open_moments(const workspace::Workspace& workspace, const RunOptions& options,
                                      const std::vector<PoseNode>& nodes, const views::ViewStore& stored);

// The stored views themselves: the last one that is not later than the moment.
std::unique_ptr<Moments> stored_moments(const std::vector<PoseNode>& nodes, const views::ViewStore& stored);

}  // namespace iris::exporters
