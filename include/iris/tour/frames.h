// A camera path becomes a sequence of pictures.
#pragma once

#include <functional>
#include <memory>
#include <vector>

#include "iris/render/dsnv.h"
#include "iris/tour/camera_path.h"
#include "iris/types/triangle_mesh.h"
#include "iris/views/view_store.h"

namespace iris::tour {

// Number of frames of a path: one at its beginning, then one every 1/fps s.
int frame_count(const CameraPath& path, const TourOptions& options);

// What a frame shows, and when.
struct TourFrame {
  int frame_idx = 0;
  double seconds = 0;  // since the beginning of the tour
  NovelCamera camera;
  int64_t stamp_ns = 0;                          // the recorded moment
  Pose world_from_recording = Pose::Identity();  // the recording camera then
};
TourFrame tour_frame(const CameraPath& path, const std::vector<PoseNode>& nodes, const TourOptions& options,
                     int frame_idx);

// Where the robot's model (x forward, y left, z up, metres) is in the frame of the recording camera, from
// options.robot_camera. Throws UsageError.
Pose recording_from_robot(const TourOptions& options);

// What a tour may have besides.
struct TourExtras {
  std::vector<int> frames;          // which frames are rendered, in this order; empty = all
  std::vector<TriangleMesh> robot;  // [m] drawn at the recording camera's pose
  // Dynamic novel views (8.3.3): the one view that a frame is made from, instead of the stored ones; null = none.
  std::function<std::shared_ptr<const StereoView>(int64_t stamp_ns)> moment;
};

// Renders frames of the path and hands them, in order, to `sink(frame_idx, frames, view)`; `frames`: of the whole path.
// `nodes` are the recorded poses of one sub-map (at least one): only stored views of that sub-map are used, and the
// recorded path and the recording camera (and the robot) at its place of that moment are drawn into the pictures. The
// sink is called on one further thread while the next frames are rendered; only a few frames wait for it, and only a
// few source views are held. An exception of the sink ends the tour and is passed on. Same pictures for any number of
// threads.
void render_tour(const CameraPath& path, const std::vector<PoseNode>& nodes, const views::ViewStore& store,
                 const TourOptions& options, const render::DsnvOptions& dsnv,
                 const std::function<void(int frame_idx, int frames, const NovelView& view)>& sink,
                 const TourExtras& extras = {});

}  // namespace iris::tour
