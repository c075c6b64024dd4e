// The stages that write a run's products: trajectories, maps, octree, scene, tour and report.
#pragma once

#include <vector>

#include "export/cloud_fusion.h"
#include "export/map_file.h"
#include "export/octree_file.h"
#include "export/scene_file.h"
#include "export/sheet_file.h"
#include "export/surface.h"
#include "iris/pipeline/options.h"
#include "iris/pipeline/pipeline.h"
#include "iris/tour/panorama.h"

namespace iris::exporters {

// The options of a whole run.
struct RunOptions {
  pipeline::Options library;
  MapFileOptions map;
  OctreeOptions octree;
  CloudOptions cloud;
  MeshOptions mesh;
  SceneOptions scene;
  SheetOptions sheet;
  tour::PanoramaOptions panorama;

  void declare(OptionSet& set) {
    library.declare(set);
    map.declare(set);
    octree.declare(set);
    cloud.declare(set);
    mesh.declare(set);
    scene.declare(set);
    sheet.declare(set);
    panorama.declare(set);
  }
};

// In order; each needs the stage "frames". Map, octree and tour show the sub-map with most poses, the scene and the
// trajectories all of them. The report comes last and shows what the others made; it lists the options of `set` that
// are not the default. Options and set must outlive the stages.
std::vector<pipeline::Stage> product_stages(const RunOptions& options, const OptionSet& set);

// The layers of a sub-map's map: where no floor was found, it is taken to lie a usual camera height below the first
// camera.
mapping::FlogOptions map_options(const workspace::Workspace& workspace, const RunOptions& options, int submap);

}  // namespace iris::exporters
