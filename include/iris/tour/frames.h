// A camera path becomes a sequence of pictures.
#pragma once

#include <functional>
#include <vector>

#include "iris/render/dsnv.h"
#include "iris/tour/camera_path.h"
#include "iris/views/view_store.h"

namespace iris::tour {

// Median depth [m] of the scene before the stored views of a sub-map (from at most 16 of them, evenly chosen): what
// along() wants. 0 if no view has a disparity.
double scene_depth(const views::ViewStore& store, int submap);

// Number of frames of a path: one at its beginning, then one every 1/fps s.
int frame_count(const CameraPath& path, const TourOptions& options);

// Renders all frames of the path and hands them, in order, to `sink(frame_idx, frames, view)`. `nodes` are the recorded
// poses of one sub-map (at least one): only stored views of that sub-map are used, and the recorded path and the
// recording camera at its place of that moment are drawn into the pictures. The sink is called on one further thread
// while the next frames are rendered; only a few frames wait for it, and only a few source views are held. An exception
// of the sink ends the tour and is passed on. Same pictures for any number of threads.
void render_tour(const CameraPath& path, const std::vector<PoseNode>& nodes, const views::ViewStore& store,
                 const TourOptions& options, const render::DsnvOptions& dsnv,
                 const std::function<void(int frame_idx, int frames, const NovelView& view)>& sink);

}  // namespace iris::tour
