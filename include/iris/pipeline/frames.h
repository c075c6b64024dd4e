// The streaming stage: every frame of the session is read, rectified, matched and registered; views are stored.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "iris/pipeline/options.h"
#include "iris/pipeline/pipeline.h"
#include "iris/rectify/rectifier.h"
#include "iris/session/session.h"

namespace iris::pipeline {

// Poses that are known of a session's frames: world_from_cam of the rectified left camera, one a frame in their order.
using KnownPoses = std::vector<std::optional<Pose>>;

// From the text of a file of poses of the recorded left camera: TUM, by time stamps (evaluate::associate), or KITTI,
// one line a recorded frame. Throws InputError that names `path` if it is malformed or knows fewer than two frames.
KnownPoses known_poses(std::string_view text, const std::filesystem::path& path, const session::Session& session,
                       const session::SessionOptions& options);

// Frames flow through a bounded pipeline (read, rectify, match and corners in parallel; motion in order), so that
// memory does not depend on their number. After an interruption the stage goes on behind the last committed frame with
// a result equal, bit for bit, to that of an uninterrupted run. The session and the options must outlive the stage.
// With known poses no motion is estimated: these are the path, one sub-map, and frames without one have no pose.
Stage frames_stage(const session::Session& session, const Options& options, KnownPoses known = {});

// What the stages after `frames` and the reports need to know of it.
struct FramesSummary {
  int frames = 0;         // in the session
  int posed = 0;          // with a pose
  int unreadable = 0;     // skipped: the image files are damaged
  int blind = 0;          // skipped: they show too little to be placed
  int too_near = 0;       // show surfaces that are probably nearer than the search range reaches
  int disparities = 0;    // of the search range
  std::string rows_text;  // where rows of the rectified images do not correspond, in a sentence; empty if they do
  int submaps = 0;
  int largest_submap = 0;  // the one with most poses (the first of several)
  int views = 0;
  double path_length = 0;  // [m] over all sub-maps

  // What to do about surfaces that are too near, in a sentence; empty without such.
  std::string too_near_text() const;
  bool complete() const { return unreadable == 0 && submaps <= 1; }
};
FramesSummary summarise_frames(const workspace::Workspace& workspace, workspace::Poses poses);

}  // namespace iris::pipeline
