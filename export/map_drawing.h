// What map pictures and sheets have in common: cells in colour, path, metre grid, legend and scale bar on a canvas.
#pragma once

#include <string>
#include <vector>

#include "export/canvas.h"
#include "iris/mapping/flog.h"
#include "iris/types/pose_graph.h"

namespace iris::exporters {

constexpr uint32_t kUnknownCell = 0xbacee2;  // light blue, darker than white by a third in no channel

// The map's cells in grey as the thesis draws them (white = free, black = occupied), unknown ones light blue; one pixel
// a cell. It shows the map value without the confidence K, which decides what is known instead: a cell far away never
// collects the rays of a near one, and whole streets would be nearly white.
cv::Mat3b grey_cells(const mapping::MapRaster& raster);

// Each cell in the colour of the layer with the largest map value: from dark blue (low) over teal to orange (high),
// which differ in brightness as well, for every kind of colour vision.
cv::Mat3b layer_cells(const mapping::MapRaster& raster);

struct LegendEntry {
  enum class Mark { box, line, dashed, dot, square };
  uint32_t colour = 0;
  std::string text;
  Mark mark = Mark::box;
};
std::vector<LegendEntry> grey_legend();
std::vector<LegendEntry> layer_legend(const mapping::MapRaster& raster);
// Of what draw_path draws.
std::vector<LegendEntry> path_legend(const PoseGraph& graph, int submap, bool loops);
// Empty, or which sub-map of several this is: "sub-map 0 of 3: 240 of 325 poses".
std::string submap_text(const PoseGraph& graph, int submap);

// The part of the world that a picture must show [m]: known cells, whole ones, and the path.
struct MapExtent {
  double x0 = 0, y0 = 0, x1 = 0, y1 = 0;
  double width() const { return x1 - x0; }
  double height() const { return y1 - y0; }
};
MapExtent extent_of(const mapping::MapRaster& raster, const PoseGraph& graph, int submap);

// Where the world lies on a canvas.
struct MapPlace {
  double left = 0, bottom = 0;  // [units] on the canvas of the world's point (x, y)
  double x = 0, y = 0;          // [m]
  double units_per_metre = 1;
  Eigen::Vector2d at(double world_x, double world_y) const {
    return {left + (world_x - x) * units_per_metre, bottom - (world_y - y) * units_per_metre};
  }
};

// `size`: [units] of small text; everything else is drawn in proportion to it.
void draw_cells(Canvas& canvas, const MapPlace& place, const mapping::MapRaster& raster, const cv::Mat3b& cells);
// The poses of one sub-map in the order of their frames, its loops if asked for, its start and its end. Both can be
// seen where they coincide; their marks are small where the path is.
void draw_path(Canvas& canvas, const MapPlace& place, const PoseGraph& graph, int submap, bool loops, double size);
// Names and numbers along the lower and the left border of the box, lines across it if asked for; a line each `step`
// metres. They take 3.5 `size` on both sides.
void draw_axes(Canvas& canvas, const MapPlace& place, const cv::Rect2d& box, double step, bool lines, double size);
// Returns the height it takes.
double draw_legend(Canvas& canvas, double x, double y, const std::vector<LegendEntry>& entries, double size);
// A bar of four parts, `length` metres long, with its numbers above.
void draw_scale_bar(Canvas& canvas, double x, double y, double length, double units_per_metre, double size);

}  // namespace iris::exporters
