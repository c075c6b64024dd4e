// The map from above as files: for people, for ROS/Nav2, for geographic information systems.
#pragma once

#include <filesystem>

#include "iris/mapping/flog.h"
#include "iris/types/pose_graph.h"

namespace iris::exporters {

// Writes into `folder`, each file whole or not at all (throws InputError):
//   map.pgm, map.yaml   Nav2's trinary map: 254 free, 0 occupied, 205 unknown; `origin` is the lower-left corner of the
//                       lower-left cell; image row 0 is the largest y. World frame [m], x right, y up in the image.
//   map.png             the cells in grey (grey_cells), of the same size and without decorations
//   map.pgw             world file of map.pgm and map.png (copied under the name that the picture's extension asks for)
//   map_picture.png     map.png enlarged with the camera's path, start, end, axes, scale bar and legend
//   layers.png          the same with heights in colour: each cell shows the layer of the largest map value
// `submap`: which poses of `graph` belong to the map; the path is drawn through them in the order of their frames.
void write_map(const std::filesystem::path& folder, const mapping::MapRaster& raster, const PoseGraph& graph,
               int submap = 0);

}  // namespace iris::exporters
