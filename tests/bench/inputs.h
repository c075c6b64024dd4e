// What the benchmarks work on: recordings if they are there, else rendered images of the same size.
#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "iris/geometry/stereo_calibration.h"
#include "iris/types/novel_view.h"
#include "iris/types/stereo_frame.h"
#include "iris/types/stereo_view.h"

namespace iris::bench {

// Stereo pairs of one camera that moves a little.
struct Sequence {
  std::string name;  // with the size
  RectifiedCamera camera;
  std::vector<StereoPair> pairs;
  std::vector<Pose> world_from_cam;  // z up, origin in the first camera
};

// Five pairs of 752x480: EuRoC MH_01 from frame 40 on, the first two being neighbours; else the room.
const Sequence& hand_held();

// Two neighbouring pairs of 1226x370, KITTI's street; null if that recording is not there.
const Sequence* street();

// Pairs of a textured room, rendered, along a made-up path.
Sequence render_sequence(const RectifiedCamera& camera, int frames);

// The views of hand_held() with the disparities that mwmf measures over 128 px.
const std::vector<std::shared_ptr<const StereoView>>& hand_held_views();

// Views for pictures of 640x480, and where these are taken: EuRoC MH_01, frame 40; the four nearest frames (1 to 3 cm
// away) and four that are 0.22 m away or more. The room if that recording is not there.
struct PictureSources {
  std::string name;
  NovelCamera camera;
  std::vector<std::shared_ptr<const StereoView>> near, far;
};
const PictureSources& picture_sources();

// The rig of EuRoC, 752x480, with its lens distortion.
StereoCalibration distorted_rig();

// A recording on disk: EuRoC MH_01, or a rendered one of 40 frames in a temporary folder.
const std::filesystem::path& recorded_session();
std::string recorded_session_name();

// A recording with the truth, rectified.
struct Recording {
  std::vector<StereoPair> pairs;
  std::vector<Pose> world_from_cam;  // of the pairs' cameras
  RectifiedCamera camera;
};
// `truth_file`: poses of the left camera as recorded (TUM) or as it is in the images (KITTI).
Recording read_recording(const std::filesystem::path& folder, const std::filesystem::path& truth_file);

}  // namespace iris::bench
