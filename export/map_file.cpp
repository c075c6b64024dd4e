#include "export/map_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <string>
#include <vector>

#include "export/map_drawing.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/workspace/view_files.h"

namespace iris::exporters {
namespace {

using mapping::MapRaster;
using mapping::MapState;

std::string pgm_of(const MapRaster& raster) {
  std::string text = fmt::format("P5\n{} {}\n255\n", raster.width, raster.height);
  for (const uint8_t state : raster.state) {
    constexpr std::array<unsigned char, 3> kShades = {205, 254, 0};  // indexed by MapState
    text.push_back(static_cast<char>(kShades.at(state)));
  }
  return text;
}

// Nav2 compares strictly: 205 gives an occupancy of 0.19608, which must not fall below free_thresh.
std::string yaml_of(const MapRaster& raster) {
  return fmt::format(
      "image: map.pgm\nmode: trinary\nresolution: {}\norigin: [{}, {}, 0]\nnegate: 0\noccupied_thresh: 0.65\n"
      "free_thresh: 0.196\n",
      raster.cell, raster.origin_x, raster.origin_y);
}

std::string world_file_of(const MapRaster& raster) {
  return fmt::format("{}\n0\n0\n{}\n{}\n{}\n", raster.cell, -raster.cell, raster.x_of(0), raster.y_of(0));
}

// The cells enlarged, with the path, axes in metres, a scale bar and a legend on the right.
void write_picture(const std::filesystem::path& path, const MapRaster& raster, const cv::Mat3b& cells,
                   const PoseGraph& graph, int submap, std::vector<LegendEntry> legend) {
  constexpr double kText = 13, kLeft = 60, kTop = 34, kBottom = 60, kRight = 260;  // [px]
  const int zoom = std::clamp(1000 / std::max(raster.width, raster.height), 1, 16);
  for (LegendEntry& entry : path_legend(graph, submap)) legend.push_back(std::move(entry));
  const cv::Rect2d box(kLeft, kTop, raster.width * zoom, raster.height * zoom);
  const double tall = std::max(box.height, 2 * kText * static_cast<double>(legend.size() + 3));
  const MapPlace place{.left = box.x,
                       .bottom = box.y + box.height,
                       .x = raster.origin_x,
                       .y = raster.origin_y,
                       .units_per_metre = zoom / raster.cell};
  const auto canvas = png_canvas(kLeft + box.width + kRight, kTop + tall + kBottom, 1);
  draw_cells(*canvas, place, raster, cells);
  draw_axes(*canvas, place, box, round_step(80 / place.units_per_metre), false, kText);
  draw_path(*canvas, place, graph, submap, kText);
  canvas->text(box.x, box.y + box.height + 48, "x [m], y [m] upwards; world frame, z up, seen from above",
               {.size = kText});
  const double left = box.x + box.width + 20;
  const double row = box.y + draw_legend(*canvas, left, box.y, legend, kText) + kText;
  draw_scale_bar(*canvas, left, row, round_step(60 / place.units_per_metre), place.units_per_metre, kText);
  canvas->text(left, row + 4 * kText, fmt::format("cell {:g} m", raster.cell), {.size = kText});
  write_file(path, canvas->bytes());
}

}  // namespace

void write_map(const std::filesystem::path& folder, const MapRaster& raster, const PoseGraph& graph, int submap) {
  IRIS_CHECK(raster.width > 0 && raster.height > 0 && raster.cell > 0);
  const cv::Mat3b grey = grey_cells(raster);
  write_file(folder / "map.pgm", pgm_of(raster));
  write_file(folder / "map.yaml", yaml_of(raster));
  write_file(folder / "map.pgw", world_file_of(raster));
  write_file(folder / "map.png", workspace::encode_png(grey));
  write_picture(folder / "map_picture.png", raster, grey, graph, submap, grey_legend());
  write_picture(folder / "layers.png", raster, layer_cells(raster), graph, submap, layer_legend(raster));
}

}  // namespace iris::exporters
