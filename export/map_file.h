// The map from above as files: for people, for ROS/Nav2, for geographic information systems.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "iris/core/options.h"
#include "iris/mapping/flog.h"
#include "iris/types/pose_graph.h"

namespace iris::exporters {

struct MapFileOptions {
  std::string mode = "trinary";  // trinary or scale: how map.yaml tells ROS/Nav2 to read its picture
  bool layers = true;            // a map for each layer of heights too

  void declare(OptionSet& set);  // section "map"
};

// One layer of the map as a map of its own, over the same rectangle of cells.
mapping::MapRaster layer_raster(const mapping::MapRaster& map, int layer);

// Writes into `folder`, each file whole or not at all (throws InputError):
//   map.pgm             254 free, 0 occupied, 205 unknown; row 0 is the largest y
//   map.yaml            what ROS/Nav2 reads; `origin` is the lower-left corner of the lower-left cell. World frame [m],
//                       x right, y up in the image. Trinary: map.pgm, which comes back as 0, 100 and -1. Scale:
//                       map_scale.png, transparent where unknown (-1), dark enough for 100 where occupied, and the
//                       darker the less safe (raster.U) where free: 0 to 77
//   map_layer<k>.yaml   the same for the layers' rasters, if there are any, with map_layer<k>.pgm or
//                       map_layer<k>_scale.png; layer 0 is the lowest
//   map.png             the cells in grey (grey_cells), of the same size and without decorations
//   map.pgw             world file of map.pgm and map.png (copied under the name that the picture's extension asks for)
//   map_picture.png     map.png enlarged with the camera's path, start, end, axes, scale bar and legend
//   layers.png          the same with heights in colour: each cell shows the layer of the largest map value
// `submap`: which poses of `graph` belong to the map; the path is drawn through them in the order of their frames.
// Files of layers and of the other mode that an earlier call left are removed.
void write_map(const std::filesystem::path& folder, const mapping::MapRaster& raster,
               const std::vector<mapping::MapRaster>& layers, const PoseGraph& graph, int submap,
               const MapFileOptions& options);

}  // namespace iris::exporters
