// Camera paths in files: the project's own JSON, and nerfstudio's camera_path.json.
//
// The project's own:
//   {
//     "width": 640, "height": 480, "fps": 25,     optional: pixels, pictures a second
//     "fov": 50,                                  optional: vertical field of view [degrees]; a keyframe may have its
//     own "seconds": 12,                              optional: length, where keyframes have no "t" "interpolation":
//     "spline",                  optional: spline (default) or linear "ease": 1, optional: [s] of gathering and losing
//     speed "keyframes": [
//       {"t": 0, "position": [0, 0, 1.4], "look_at": [2, 0, 1.2], "caption": "The hall"},
//       {"t": 4, "position": [3, 0, 1.4], "yaw": 90, "pitch": -10, "roll": 0, "fov": 60},
//       {"t": 8, "position": [3, 2, 1.4], "quaternion": [x, y, z, w]}
//     ]
//   }
// World: that of the run, z up, metres. Each keyframe looks at a point ("look_at"), or in a direction: "yaw" [degrees]
// from x to y, "pitch" up, "roll" clockwise (all 0 where left out), or has the rotation that takes the camera's axes (x
// right, y down, z forward) to the world's. "t" [s] ascends; all keyframes have one, or none: then the path is flown
// with the speed of a walk. A caption stands from its keyframe to the next caption; an empty one ends it.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "iris/tour/camera_path.h"
#include "iris/types/novel_view.h"

namespace iris::tour {

struct Caption {
  double t = 0;      // [s] on the path, from when
  std::string text;  // empty = nothing from here on
};

struct CameraPathFile {
  CameraPath path;
  int width = 0, height = 0;  // [px] 0 = not given
  double fps = 0;             // [1/s] 0 = not given
  Projection projection = Projection::pinhole;
  std::vector<Caption> captions;
};

// The whole file. nerfstudio's cameras look along -z with y up; ours look along z with y down. Each of its entries is
// one frame: n of them in `seconds`, the first at 0. `options`: field of view, speed and ease where the file has none,
// and a length that wins over the file's. Throws InputError that names the entry.
CameraPathFile read_camera_path_file(const std::filesystem::path& file, const TourOptions& options = {});

}  // namespace iris::tour
