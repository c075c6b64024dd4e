// Camera paths drawn elsewhere: nerfstudio's camera_path.json.
#pragma once

#include <filesystem>

#include "iris/types/novel_view.h"

namespace iris::tour {

struct CameraPathFile {
  CameraPath path;
  int width = 0, height = 0;  // [px] 0 = not given
  double fps = 0;             // [1/s] 0 = not given
  Projection projection = Projection::pinhole;
};

// The whole file. Its cameras look along -z with y up; ours look along z with y down. Each entry is one frame: n of
// them in `seconds`, the first at 0. Throws InputError that names the entry.
CameraPathFile read_camera_path_file(const std::filesystem::path& file);

}  // namespace iris::tour
