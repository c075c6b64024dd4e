// Loop closures of a session: candidates, their verification, their consistency.
#pragma once

#include <functional>
#include <vector>

#include "iris/loop/verification.h"
#include "iris/types/pose_graph.h"
#include "iris/types/stereo_view.h"

namespace iris::loop {

struct FindLoopsControl {
  std::function<void(int done, int total)> progress;  // of views described, of candidates compared, then of those
                                                      // compared again with SIFT; may be empty
  std::function<bool()> stopped;                      // asked now and then; true: Interrupted is thrown; may be empty
};

// All candidates that were tried, each with its verdict, ordered by (i, j); those accepted are loops.
// graph: poses and odometry. view_frames: frame_idx of the stored views, ascending, each a node of the graph. view: the
// stored view of a frame; called from several threads at once, and more than once for each view unless all fit into
// options.cache_mb. The result is the same for any number of threads.
// Memory: the cache, and about 10 kB a view (128 MB for descriptors at most).
std::vector<LoopEdge> find_loops(const PoseGraph& graph, const std::vector<int>& view_frames,
                                 const std::function<StereoView(int frame_idx)>& view, const RectifiedCamera& camera,
                                 const LoopOptions& options, const motion::ScsOptions& scs,
                                 const FindLoopsControl& control = {});

}  // namespace iris::loop
