// The recorded scene as a 3-D model that any glTF viewer opens: scene.glb (glTF 2.0, binary).
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "export/cloud_fusion.h"
#include "iris/pipeline/pipeline.h"
#include "iris/types/novel_view.h"
#include "iris/types/point_cloud.h"
#include "iris/types/pose_graph.h"
#include "iris/views/view_store.h"

namespace iris {
class OptionSet;
}

namespace iris::exporters {

struct SceneOptions {
  double max_mb = 64;          // [MB] budget of the file: decides the size of textures and the number of triangles
  int max_points = 1'000'000;  // of the cloud; thinned to fit, and to a third of max_mb
  bool surfaces = true;        // textured surfaces of views
  double surface_error = 1;    // [standard deviations of the disparity] by which their triangles may differ
  double min_gain = 0.5;       // [%] of all places that a further view must add to get a surface
  int jpeg_quality = 85;

  void declare(OptionSet& set);  // section "scene"
};

// A picture on the ground, z = 0 of its sub-map.
struct GroundPicture {
  cv::Mat image;                 // row 0 is the largest y
  double x0 = 0, y0 = 0;         // [m] of its lower left corner
  double width = 0, height = 0;  // [m]
};

// What a scene shows of one sub-map. Pointers may be null; all stands in the sub-map's world (z up).
struct ScenePart {
  int submap = 0;
  const views::ViewStore* views = nullptr;  // of this sub-map alone
  const PointCloud* cloud = nullptr;
  std::optional<GroundPicture> ground;
  CameraPath tour;         // at most one part has one
  double tour_aspect = 1;  // width / height of its pictures
};

// Nodes, by name, each to be shown or hidden by itself; what is empty has no node:
//   world               turns z up to glTF's y up
//     submap_<k>        everything below is in metres in that sub-map's world (z up)
//       surfaces        surface_<frame>: what a view saw, textured with its image (view_surface.h), of as many views as
//                       show all there is; each place by the view that saw it from nearest
//       cloud           the fused points
//       path            all poses of the graph
//       cameras         lines: a pyramid for each stored view, as high as the baseline is long;
//                       camera_<frame>: the same as cameras to look through
//       map             the map, 0.1 m below the ground
//       tour            camera that flies the tour (animation "tour")
//   * Sub-maps have no known relation: so that they do not cover each other they stand side by side along x, moved by
//     the translation of their node alone (none for the first).
//   * Everything shows its own colours, whatever the light (KHR_materials_unlit). Surfaces show their front alone: from
//     outside one looks into the rooms.
//   * asset.extras: session, software, version, units, up axis, kept views and the edge of the cubes as used.
//   * Larger than max_mb: points are thinned, triangles made larger and textures smaller until it fits.
// The same input gives the same bytes for any number of threads. Memory: the file's size twice, and some views.
// Throws InputError if a view is damaged or the file cannot be written, Interrupted if `control` asks to stop; never
// leaves half a file.
void write_scene(const std::filesystem::path& glb, const PoseGraph& graph, const std::vector<ScenePart>& parts,
                 const SceneOptions& options, const CloudOptions& cloud_options, const std::string& session_name,
                 const pipeline::RunControl& control = {});

}  // namespace iris::exporters
