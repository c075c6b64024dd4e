#include "export/sheet_file.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <map>

#include "export/map_drawing.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"

namespace iris::exporters {
namespace {

using mapping::MapRaster;

// All lengths on paper in millimetres.
constexpr double kMargin = 8;  // around everything: what office printers can do
constexpr double kAxis = 10;   // for numbers on the left of the map and below it
constexpr double kBlock = 50;  // height of the title block
constexpr double kGap = 3;     // between map and title block
constexpr double kText = 2.6;  // fonts
constexpr double kTitle = 5;
constexpr double kDotsPerInch = 200;  // of the PNG

struct Paper {
  double width = 0, height = 0;
  // Of the frame around the map.
  cv::Rect2d map_box() const {
    return {kMargin + kAxis, kMargin, width - 2 * kMargin - kAxis, height - 2 * kMargin - kBlock - kGap - kAxis};
  }
};

Paper paper_of(const std::string& name, bool landscape) {
  const Paper portrait = name == "a3" ? Paper{297, 420} : name == "letter" ? Paper{215.9, 279.4} : Paper{210, 297};
  return landscape ? Paper{portrait.height, portrait.width} : portrait;
}

// 1 : this is the largest scale at which the extent fits.
double least_denominator(const MapExtent& extent, const Paper& paper) {
  const cv::Rect2d box = paper.map_box();
  return 1000 * std::max(extent.width() / box.width, extent.height() / box.height);
}

// The scales of rulers for plans: 1, 1.25, 2, 2.5, 5 or 7.5 times a power of ten.
int round_denominator(double least) {
  for (double power = 10;; power *= 10) {
    for (const double step : {1.0, 1.25, 2.0, 2.5, 5.0, 7.5}) {
      const double denominator = step * power;
      if (denominator == std::floor(denominator) && denominator >= least * (1 - 1e-9)) {
        return static_cast<int>(denominator);
      }
    }
  }
}

// The size at which a text fits into a width; letters are at most this wide on average.
double fitting(double size, const std::string& text, double width, bool bold = false) {
  const double letter = bold ? 0.68 : 0.58;  // [sizes] of DejaVu Sans, the widest of the usual fonts
  return std::min(size, width / (letter * static_cast<double>(std::max<size_t>(1, text.size()))));
}

void draw_title_block(Canvas& canvas, const cv::Rect2d& box, const std::string& title,
                      const std::vector<std::pair<std::string, std::string>>& lines,
                      const std::vector<LegendEntry>& legend, int scale, double cell, double grid_step) {
  canvas.frame(box.x, box.y, box.width, box.height, kInk, 0.35);
  const double legend_width = 44, facts_width = box.width - 2 * legend_width;
  const double second = box.x + facts_width, third = second + legend_width;
  for (const double x : {second, third}) canvas.line({{x, box.y}, {x, box.y + box.height}}, kInk, 0.2);

  canvas.text(box.x + 3, box.y + 7, title, {.size = fitting(kTitle, title, facts_width - 6, true), .bold = true});
  double row = box.y + 13;
  const double pitch =
      std::min(1.5 * kText, (box.height - 14) / static_cast<double>(std::max<size_t>(1, lines.size())));
  for (const auto& [name, value] : lines) {
    const double size = std::min(kText, pitch / 1.2);
    canvas.text(box.x + 3, row, name, {.size = size, .colour = 0x606060});
    canvas.text(box.x + 26, row, value, {.size = fitting(size, value, facts_width - 28)});
    row += pitch;
  }

  const double legend_size = std::min(kText, (box.height - 6) / (1.65 * static_cast<double>(legend.size())));
  draw_legend(canvas, second + 3, box.y + 3, legend, legend_size);

  const double units = 1000.0 / scale;  // [mm / m]
  double length = round_step(0.25 * (legend_width - 10) / units);
  while (2 * length * units <= legend_width - 10) length *= 2;
  canvas.text(third + 3, box.y + 7, fmt::format("1 : {}", scale), {.size = kTitle, .bold = true});
  draw_scale_bar(canvas, third + 4, box.y + 11, length, units, kText);
  const std::vector<std::string> notes = {fmt::format("map cell {:g} m, grid {:g} m", cell, grid_step),
                                          "x, y in metres, z up,", "seen from above"};
  row = box.y + 24;
  for (const std::string& note : notes) {
    canvas.text(third + 3, row, note, {.size = kText});
    row += 1.5 * kText;
  }
}

}  // namespace

void SheetOptions::declare(OptionSet& set) {
  set.section("sheet");
  set.add("paper", paper, {"a4", "a3", "letter"}, "paper of the map sheet");
  set.add("orientation", orientation, {"auto", "landscape", "portrait"},
          "of the paper; auto takes the one that allows the larger scale");
  set.add("scale", scale, "", 0, 1000000, "1 : scale; 0 = the largest round one at which the map fits");
  set.add("cells", cells, {"grey", "heights"}, "cells in grey as in the thesis, or in the colour of their height");
  set.add("grid", grid, "draw a metre grid over the map");
  set.add("path", path, "draw the camera path over the map");
  set.add("loops", loops, "and the closed loops of the path");
  set.add("title", title, {}, "title of the sheet; empty = the session's name");
  set.add("note", note, {}, "a line of your own in the title block, as who made the sheet and for what");
}

std::optional<ClosingError> closing_error(const PoseGraph& odometry, const PoseGraph& refined, int submap) {
  std::map<int, const PoseNode*> chained;
  std::map<int, double> way;  // [m] to each frame, from the first of its chained sub-map
  const PoseNode* last = nullptr;
  for (const PoseNode& node : odometry.nodes) {
    const bool goes_on = last && last->submap == node.submap;
    way[node.frame_idx] =
        goes_on ? way[last->frame_idx] + (node.world_from_cam.translation() - last->world_from_cam.translation()).norm()
                : 0;
    chained[node.frame_idx] = last = &node;
  }
  std::map<int, int> submap_of_frame;
  for (const PoseNode& node : refined.nodes) submap_of_frame[node.frame_idx] = node.submap;
  std::optional<ClosingError> result;
  int loops = 0;
  for (const PoseEdge& edge : refined.edges) {
    if (edge.kind != PoseEdgeKind::loop || submap_of_frame.at(edge.i) != submap) continue;
    const PoseNode &i = *chained.at(edge.i), &j = *chained.at(edge.j);
    if (i.submap != j.submap) continue;
    const double between = std::abs(way.at(edge.j) - way.at(edge.i));
    if (2 * edge.i_from_j.translation().norm() > between) continue;  // the path goes on, it does not come back
    ++loops;
    if (result && between <= result->way) continue;
    const Pose i_from_j = i.world_from_cam.inverse() * j.world_from_cam;
    result = ClosingError{.i = edge.i,
                          .j = edge.j,
                          .error = (i_from_j.translation() - edge.i_from_j.translation()).norm(),
                          .sigma = std::sqrt(edge.information.inverse().topLeftCorner<3, 3>().trace()),
                          .way = between};
  }
  if (result) result->loops = loops;
  return result;
}

void write_sheet(const std::filesystem::path& folder, const MapRaster& raster, const PoseGraph& graph, int submap,
                 const SheetFacts& facts, const SheetOptions& options) {
  const MapExtent extent = extent_of(raster, graph, submap);
  const Paper upright = paper_of(options.paper, false), across = paper_of(options.paper, true);
  bool landscape = options.orientation == "landscape";
  if (options.orientation == "auto") {
    const int scale_across = round_denominator(least_denominator(extent, across));
    const int scale_upright = round_denominator(least_denominator(extent, upright));
    landscape = scale_across != scale_upright ? scale_across < scale_upright : extent.width() >= extent.height();
  }
  const Paper paper = landscape ? across : upright;
  const double least = least_denominator(extent, paper);
  const int scale = options.scale > 0 ? options.scale : round_denominator(least);
  if (scale < least * (1 - 1e-9)) {
    throw InputError(folder / "sheet.pdf",
                     fmt::format("the map of {:.1f} m x {:.1f} m does not fit on {} at 1 : {}", extent.width(),
                                 extent.height(), options.paper, scale),
                     fmt::format("give --sheet.scale {} or 0, or larger paper", round_denominator(least)));
  }

  const cv::Rect2d box = paper.map_box();
  const double units = 1000.0 / scale;
  const MapPlace place{.left = box.x + (box.width - extent.width() * units) / 2,
                       .bottom = box.y + box.height - (box.height - extent.height() * units) / 2,
                       .x = extent.x0,
                       .y = extent.y0,
                       .units_per_metre = units};
  const bool heights = options.cells == "heights";
  const cv::Mat3b cells = heights ? layer_cells(raster) : grey_cells(raster);
  std::vector<LegendEntry> legend = heights ? layer_legend(raster) : grey_legend();
  if (options.path) {
    const std::vector<LegendEntry> more = path_legend(graph, submap, options.loops);
    legend.insert(legend.end(), more.begin(), more.end());
  }
  const std::string title = options.title.empty() ? facts.title : options.title;
  const double grid_step = round_step(12 / units);
  std::vector<std::pair<std::string, std::string>> lines = facts.lines;
  if (!options.note.empty()) lines.insert(lines.begin(), {"Note", options.note});

  const auto draw = [&](Canvas& canvas) {
    canvas.box(box.x, box.y, box.width, box.height, kUnknownCell);
    canvas.clip(box.x, box.y, box.width, box.height);
    draw_cells(canvas, place, raster, cells);
    canvas.unclip();
    draw_axes(canvas, place, box, grid_step, options.grid, kText);
    if (options.path) {
      canvas.clip(box.x, box.y, box.width, box.height);
      draw_path(canvas, place, graph, submap, options.loops, kText);
      canvas.unclip();
    }
    draw_title_block(canvas, {kMargin, paper.height - kMargin - kBlock, paper.width - 2 * kMargin, kBlock}, title,
                     lines, legend, scale, raster.cell, grid_step);
    return canvas.bytes();
  };
  write_file(folder / "sheet.pdf", draw(*pdf_canvas(paper.width, paper.height, title, facts.date)));
  write_file(folder / "sheet.svg", draw(*svg_canvas(paper.width, paper.height, "mm")));
  write_file(folder / "sheet.png", draw(*png_canvas(paper.width, paper.height, kDotsPerInch / 25.4)));
}

}  // namespace iris::exporters
