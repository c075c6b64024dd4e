// The recorded scene as a 3-D model that any glTF viewer opens: scene.glb (glTF 2.0, binary).
#pragma once

#include <filesystem>
#include <string>

#include "iris/pipeline/pipeline.h"
#include "iris/types/pose_graph.h"
#include "iris/views/view_store.h"

namespace iris {
class OptionSet;
}

namespace iris::exporters {

struct SceneOptions {
  double voxel = 0.02;         // [m] edge of the cubes that thin the points: one point a cube
  double max_range = 40;       // [m] points farther than this from their camera are left out: their error grows with
                               // the square of the distance (thesis 4.24)
  double min_disparity = 4;    // [px] likewise points of smaller disparity, as in the map (thesis 6.3)
  int max_points = 2'000'000;  // budget of points and thereby of memory and file size; the cubes' edge is doubled until
                               // the points fit

  void declare(OptionSet& set);  // section "scene"
};

// Writes the stored views' coloured points, the path of the camera and the places of the recording cameras.
//   * Nodes: `world` (rotates z up to glTF's y up) > `submap_<k>` > `points`, `path` (all poses of the graph),
//   `cameras`
//     (a pyramid for each stored view, as high as the baseline is long). What is empty has no node.
//     Everything below submap_<k> is in metres in the world frame of that sub-map (z up).
//   * Sub-maps have no known relation: so that they do not cover each other they stand side by side along x, moved by
//   the
//     translation of their node alone (none for the first).
//   * A point is the mean of its cube's disparities up to within_segment, weighted by 1/(error of the distance)^2
//     (4.24). Cubes in the order in which they are first touched: the same input gives the same bytes.
//   * Colours are 16-bit linear light, as glTF demands: 8 bits would leave too few dark levels.
//   * asset.extras: session, software, version, units, up axis and the edge of the cubes as used.
// Memory: about 0.1 kB for each of max_points and a handful of views, however long the session.
// Throws InputError if a view is damaged or the file cannot be written, Interrupted if `control` asks to stop; never
// leaves half a file.
void write_scene(const std::filesystem::path& glb, const PoseGraph& graph, const views::ViewStore& views,
                 const SceneOptions& options, const std::string& session_name,
                 const pipeline::RunControl& control = {});

}  // namespace iris::exporters
