// Paths of the virtual camera of a tour (thesis 8.2).
#pragma once

#include <vector>

#include "iris/core/options.h"
#include "iris/types/novel_view.h"
#include "iris/types/pose_graph.h"

namespace iris::tour {

struct TourOptions {
  int width = 640;       // [px] even (the video format wants it)
  int height = 480;      // [px] even
  double fps = 10;       // [1/s] frames of the tour per second
  double seconds = 0;    // [s] length of the tour; 0 = automatic: the recording's own length, at least 8 and at most 10
  double max_speed = 8;  // [times] but the automatic length shows a long recording at most so many times faster
  double back = -1;      // [m] the virtual camera flies so far behind the recording one; < 0 = automatic
  double above = -1;     // [m] and so far above it; < 0 = automatic
  double smoothing = 0.7;   // [s] standard deviation of the Gaussian that calms the recorded motion, in recorded time
  double fov = 50;          // [deg] vertical field of view of the virtual camera
  bool draw_camera = true;  // the recording camera as a pyramid
  bool draw_path = true;    // the recorded path as a line
  void declare(OptionSet& set);
};

// The recorded path, smoothed, flown after by a virtual camera behind and above that looks where the recording camera
// looks: at the point `scene_depth` [m] (median depth of the scene) in front of it. "Above" and "behind" are those of
// the smoothed recording camera, so that no assumption about the world's axes is needed. Keyframes as dense as the
// frames. `nodes`: one sub-map, in order, not empty.
CameraPath along(const std::vector<PoseNode>& nodes, const TourOptions& options, double scene_depth);

// Length of a path [s].
double duration(const CameraPath& path);

// Camera at time t [s], clamped to the path: positions linearly, orientations along the shortest arc.
CameraKeyframe sample(const CameraPath& path, double t);

// Pose of the recording camera at a moment [ns], clamped to the nodes; interpolated likewise.
Pose recorded_pose(const std::vector<PoseNode>& nodes, int64_t stamp_ns);

// The pinhole camera of a keyframe.
NovelCamera novel_camera(const CameraKeyframe& keyframe, const TourOptions& options);

// Moves `from` (part 0) to `to` (part 1).
Pose interpolate(const Pose& from, const Pose& to, double part);

}  // namespace iris::tour
