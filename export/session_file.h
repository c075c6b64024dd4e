// A simulated recording on disk: a session in the layout of EuRoC/ASL, and the truth beside it.
#pragma once

#include <filesystem>

#include "iris/mapping/flog.h"
#include "iris/pipeline/pipeline.h"
#include "iris/simulate/scene.h"

namespace iris::exporters {

// Renders the session into `folder`, each file whole or not at all:
//   mav0/cam0, mav0/cam1          images, data.csv, sensor.yaml; cam0 is the body frame
//   truth/trajectory.tum          world from left camera (as recorded) at the stamps of the frames
//   truth/disparity/FFFFFF.png    of the rectified left image, 16 bit, value = disparity x 256, 0 = nothing there
//   truth/occlusion/FFFFFF.png    255 where the right camera does not see the point
//   truth/discontinuity/FFFFFF.png  255 near jumps of the disparity
//   truth/textured/FFFFFF.png     255 where the surface has texture
//   truth/scene.glb               the place itself; what moves is where it was at the beginning
//   truth/plan.png, plan.yaml     what a map can find (simulate::PlanValue), as a map of ROS; world's x and y
//   truth/plan_<k>.png, .yaml     the same of layer k from below. Layers, cells and range are those of `mapping`,
//   heights
//                                 counted from the first camera as in a map of the recording
//   truth/options.toml            what was asked for
// Frames are rendered in parallel; the bytes depend on scene and options alone. Called again after an interruption, it
// goes on with the missing files. Throws InputError if the folder holds anything else; Interrupted.
// `options_text`: all options as TOML; equal texts mean equal sessions.
void write_session(const std::filesystem::path& folder, const simulate::Scene& scene,
                   const simulate::SimulateOptions& options, const mapping::FlogOptions& mapping,
                   const std::string& options_text, const pipeline::RunControl& control);

}  // namespace iris::exporters
