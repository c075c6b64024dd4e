// Which way is up. A path has no gravity of its own: its world is the first camera's, however that was held. The
// dominant horizontal surfaces (floor, ceiling) that the stored views measured tell it, else the plane of the path.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "iris/core/options.h"
#include "iris/types/pose_graph.h"
#include "iris/types/stereo_view.h"

namespace iris::loop {

struct AlignmentOptions {
  // floor: the dominant horizontal surfaces, if there are none the path; path: the plane that the camera moved in, if
  // there is none the first camera; first-camera: upright as it was; x,y,z: the direction of up in the first camera's
  // frame (x right, y down, z forward), e.g. from an inertial sensor.
  std::string up = "floor";

  void declare(OptionSet& set);  // section "loop"
};

struct Alignment {
  // World: z up, x the horizontal part of the first camera's viewing direction; x = y = 0 at the first camera; z = 0 at
  // the floor if it was found, else at the first camera.
  Pose world_from_graph = Pose::Identity();
  bool floor_found = false;
  double camera_height = 0;  // [m] of the first camera above z = 0
  double tilt = 0;           // [rad] between up and the first camera's own up
  bool guessed = false;      // the surfaces that were to tell what is up did not
  std::string used;          // which rule and how well it holds, or why another one had to do; for people
};

// Throws UsageError if options.up is none of what it may be.
void check(const AlignmentOptions& options);

// nodes: of one sub-map, not empty, the first one being the first camera. view_frames: frame_idx of stored views, each
// a node; view: gives them, called from several threads at once (their own poses are not used; at most 150 are asked
// for). Throws UsageError if options.up is none of the above.
Alignment align(const std::vector<PoseNode>& nodes, const std::vector<int>& view_frames,
                const std::function<StereoView(int frame_idx)>& view, const AlignmentOptions& options);

}  // namespace iris::loop
