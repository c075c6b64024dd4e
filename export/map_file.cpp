#include "export/map_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <memory>
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

constexpr double kOccupiedThreshold = 0.65;

// Grey levels between the thresholds become 0 to 100 in scale mode, those above the upper one 100. ROS 1 asks for
// transparency only between the thresholds: unknown cells get a grey that lies there.
std::vector<unsigned char> scale_png_of(const MapRaster& raster) {
  cv::Mat4b pixels(raster.height, raster.width, cv::Vec4b(205, 205, 205, 0));
  for (int y = 0; y < raster.height; ++y) {
    for (int x = 0; x < raster.width; ++x) {
      const auto state = static_cast<MapState>(raster.state(y, x));
      if (state == MapState::unknown) continue;
      const double shade = 255 * (1 - static_cast<double>(raster.U(y, x)));
      // 89 and 90 lie on either side of the threshold.
      const double grey = state == MapState::occupied ? std::min(shade, 89.0) : std::max(shade, 90.0);
      const auto level = cv::saturate_cast<uint8_t>(grey);
      pixels(y, x) = cv::Vec4b(level, level, level, 255);
    }
  }
  return workspace::encode_png(pixels);
}

// Nav2 compares strictly. Trinary: 205 gives an occupancy of 0.19608, which must not fall below free_thresh. Scale:
// nothing but white is below it, so that grey levels are kept.
std::string yaml_of(const MapRaster& raster, const std::string& image, const std::string& mode) {
  const bool scale = mode == "scale";
  std::string text = fmt::format(
      "image: {}\nmode: {}\nresolution: {}\norigin: [{}, {}, 0]\nnegate: 0\noccupied_thresh: "
      "{}\nfree_thresh: {}\n",
      image, mode, raster.cell, raster.origin_x, raster.origin_y, kOccupiedThreshold, scale ? 0.002 : 0.196);
  if (!raster.layer_bounds.empty()) {
    text += fmt::format("# what stands between z = {:g} m and {:g} m of the world\n", raster.layer_bounds.front(),
                        raster.layer_bounds.back());
  }
  return text;
}

// NAME.yaml and what it refers to.
void write_ros_map(const std::filesystem::path& folder, const std::string& name, const MapRaster& raster,
                   const std::string& mode) {
  const std::string image = name + (mode == "scale" ? "_scale.png" : ".pgm");
  if (mode == "scale") {
    write_file(folder / image, scale_png_of(raster));
  } else {
    write_file(folder / image, pgm_of(raster));
  }
  write_file(folder / (name + ".yaml"), yaml_of(raster, image, mode));
}

void remove_old(const std::filesystem::path& folder) {
  std::error_code ignored;
  std::vector<std::filesystem::path> old;
  for (const auto& entry : std::filesystem::directory_iterator(folder, ignored)) {
    const std::string name = entry.path().filename().string();
    if (name.starts_with("map_layer") || name == "map_scale.png") old.push_back(entry.path());
  }
  for (const auto& path : old) std::filesystem::remove(path, ignored);
}

std::string world_file_of(const MapRaster& raster) {
  return fmt::format("{}\n0\n0\n{}\n{:.15g}\n{:.15g}\n", raster.cell, -raster.cell, raster.x_of(0), raster.y_of(0));
}

// Pixels a cell of the pictures for people: as many as fit, whole ones; below one in the largest maps.
double zoom_of(double longest_side) {               // [cells]
  constexpr double kUsual = 1300, kLargest = 4000;  // [px]
  if (longest_side <= kLargest) return std::clamp(std::floor(kUsual / longest_side), 1.0, 16.0);
  return 1 / std::ceil(longest_side / kLargest);
}

// The known cells enlarged, with the path, axes in metres, a scale bar and a legend on the right.
void write_picture(const std::filesystem::path& path, const MapRaster& raster, const cv::Mat3b& cells,
                   const PoseGraph& graph, int submap, std::vector<LegendEntry> legend) {
  constexpr double kText = 13, kLeft = 64, kTop = 20, kBottom = 78, kRight = 260, kLeast = 320;  // [px]
  for (LegendEntry& entry : path_legend(graph, submap, true)) legend.push_back(std::move(entry));
  MapExtent extent = extent_of(raster, graph, submap);
  const double margin = 2 * raster.cell;
  extent.x0 -= margin, extent.y0 -= margin, extent.x1 += margin, extent.y1 += margin;
  const double scale = zoom_of(std::max(extent.width(), extent.height()) / raster.cell) / raster.cell;  // [px/m]
  const cv::Rect2d box(kLeft, kTop, std::max(kLeast, extent.width() * scale), extent.height() * scale);
  const double tall = std::max(box.height, 1.65 * kText * static_cast<double>(legend.size()) + 5 * kText);
  const MapPlace place{
      .left = box.x, .bottom = box.y + box.height, .x = extent.x0, .y = extent.y0, .units_per_metre = scale};
  const auto canvas = png_canvas(kLeft + box.width + kRight, kTop + tall + kBottom, 1);
  canvas->box(box.x, box.y, box.width, box.height, kUnknownCell);
  canvas->clip(box.x, box.y, box.width, box.height);
  draw_cells(*canvas, place, raster, cells);
  draw_path(*canvas, place, graph, submap, true, kText);
  canvas->unclip();
  draw_axes(*canvas, place, box, round_step(80 / scale), false, kText);
  std::string caption = "world frame, z up, seen from above";
  if (const std::string text = submap_text(graph, submap); !text.empty()) caption += "; " + text;
  canvas->text(box.x, box.y + box.height + 60, caption, {.size = kText});
  const double left = box.x + box.width + 20;
  const double row = box.y + draw_legend(*canvas, left, box.y, legend, kText) + kText;
  // Four parts, 100 to 200 px together.
  double length = round_step(100 / scale);
  if (2 * length * scale <= 200) length *= 2;
  draw_scale_bar(*canvas, left + 4, row, length, scale, kText);
  canvas->text(left, row + 4 * kText, fmt::format("cell {:g} m", raster.cell), {.size = kText});
  write_file(path, canvas->bytes());
}

}  // namespace

void MapFileOptions::declare(OptionSet& set) {
  set.section("map");
  set.add("mode", mode, {"trinary", "scale"},
          "map.yaml for ROS/Nav2: trinary = free, occupied or unknown; scale = free cells keep how unsafe they are, as "
          "values from 0 to 77 below 100 = occupied");
  set.add("layers", layers, "a map for each layer of heights too: map_layer0.yaml is the lowest, see mapping.layers");
}

MapRaster layer_raster(const MapRaster& map, int layer) {
  IRIS_CHECK(layer >= 0 && layer < static_cast<int>(map.layer_state.size()));
  const auto k = static_cast<size_t>(layer);
  MapRaster raster = map;
  raster.layer_bounds = {map.layer_bounds[k], map.layer_bounds[k + 1]};
  raster.layer_M = {map.layer_M[k]};
  raster.layer_U = {map.layer_U[k]};
  raster.layer_state = {map.layer_state[k]};
  raster.M = map.layer_M[k];
  raster.U = map.layer_U[k];
  raster.state = map.layer_state[k];
  // Into new memory: assigned as an expression it would go into what the whole map's `known` still uses.
  raster.known = cv::Mat1b(raster.state != static_cast<uint8_t>(mapping::MapState::unknown));
  return raster;
}

void write_map(const std::filesystem::path& folder, const MapRaster& raster, const std::vector<MapRaster>& layers,
               const PoseGraph& graph, int submap, const MapFileOptions& options) {
  IRIS_CHECK(raster.width > 0 && raster.height > 0 && raster.cell > 0);
  remove_old(folder);
  const cv::Mat3b grey = grey_cells(raster);
  if (options.mode != "trinary") write_file(folder / "map.pgm", pgm_of(raster));
  write_ros_map(folder, "map", raster, options.mode);
  for (size_t k = 0; k < layers.size(); ++k) {
    write_ros_map(folder, fmt::format("map_layer{}", k), layers[k], options.mode);
  }
  write_file(folder / "map.pgw", world_file_of(raster));
  write_file(folder / "map.png", workspace::encode_png(grey));
  write_picture(folder / "map_picture.png", raster, grey, graph, submap, grey_legend());
  write_picture(folder / "layers.png", raster, layer_cells(raster), graph, submap, layer_legend(raster));
}

}  // namespace iris::exporters
