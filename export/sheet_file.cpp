#include "export/sheet_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "export/map_drawing.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"

namespace iris::exporters {
namespace {

using mapping::MapRaster;

// All lengths on paper in millimetres.
constexpr double kMargin = 8;  // around everything: what office printers can do
constexpr double kAxis = 9;    // for numbers on the left of the map and below it
constexpr double kBlock = 44;  // height of the title block
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

// The part of the world that the sheet must show [m]: known cells and the path.
struct Extent {
  double x0 = 0, y0 = 0, x1 = 0, y1 = 0;
  double width() const { return x1 - x0; }
  double height() const { return y1 - y0; }
};

Extent extent_of(const MapRaster& raster, const PoseGraph& graph, int submap) {
  int left = raster.width, right = -1, top = raster.height, bottom = -1;
  for (int y = 0; y < raster.height; ++y) {
    for (int x = 0; x < raster.width; ++x) {
      if (!raster.known(y, x)) continue;
      left = std::min(left, x), right = std::max(right, x), top = std::min(top, y), bottom = std::max(bottom, y);
    }
  }
  if (right < 0) left = top = 0, right = raster.width - 1, bottom = raster.height - 1;
  Extent extent{.x0 = raster.x_of(left) - raster.cell / 2,
                .y0 = raster.y_of(bottom) - raster.cell / 2,
                .x1 = raster.x_of(right) + raster.cell / 2,
                .y1 = raster.y_of(top) + raster.cell / 2};
  for (const PoseNode& node : graph.nodes) {
    if (node.submap != submap) continue;
    const Eigen::Vector3d& p = node.world_from_cam.translation();
    extent.x0 = std::min(extent.x0, p.x()), extent.x1 = std::max(extent.x1, p.x());
    extent.y0 = std::min(extent.y0, p.y()), extent.y1 = std::max(extent.y1, p.y());
  }
  return extent;
}

// 1 : this is the largest scale at which the extent fits.
double least_denominator(const Extent& extent, const Paper& paper) {
  const cv::Rect2d box = paper.map_box();
  return 1000 * std::max(extent.width() / box.width, extent.height() / box.height);
}

// The scales of maps and plans: 1, 2, 2.5 or 5 times a power of ten.
int round_denominator(double least) {
  for (double power = 10;; power *= 10) {
    for (const double step : {1.0, 2.0, 2.5, 5.0}) {
      if (step * power >= least * (1 - 1e-9)) return static_cast<int>(std::lround(step * power));
    }
  }
}

void draw_title_block(Canvas& canvas, const cv::Rect2d& box, const std::string& title, const SheetFacts& facts,
                      const std::vector<LegendEntry>& legend, int scale, double cell, double grid_step) {
  canvas.frame(box.x, box.y, box.width, box.height, kInk, 0.35);
  const double legend_width = 44, facts_width = box.width - 2 * legend_width;
  const double second = box.x + facts_width, third = second + legend_width;
  for (const double x : {second, third}) canvas.line({{x, box.y}, {x, box.y + box.height}}, kInk, 0.2);

  canvas.text(box.x + 3, box.y + 7, title, {.size = kTitle, .bold = true});
  double row = box.y + 13;
  for (const auto& [name, value] : facts.lines) {
    canvas.text(box.x + 3, row, name, {.size = kText, .colour = 0x606060});
    canvas.text(box.x + 25, row, value, {.size = kText});
    row += 1.5 * kText;
  }

  draw_legend(canvas, second + 3, box.y + 3, legend, kText);

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
  set.add("path", path, "draw the camera path and its loops over the map");
  set.add("title", title, {}, "title of the sheet; empty = the session's name");
}

void write_sheet(const std::filesystem::path& folder, const MapRaster& raster, const PoseGraph& graph, int submap,
                 const SheetFacts& facts, const SheetOptions& options) {
  const Extent extent = extent_of(raster, graph, submap);
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
    const std::vector<LegendEntry> more = path_legend(graph, submap);
    legend.insert(legend.end(), more.begin(), more.end());
  }
  const std::string title = options.title.empty() ? facts.title : options.title;
  const double grid_step = round_step(12 / units);

  const auto draw = [&](Canvas& canvas) {
    canvas.box(box.x, box.y, box.width, box.height, kUnknownCell);
    canvas.clip(box.x, box.y, box.width, box.height);
    draw_cells(canvas, place, raster, cells);
    canvas.unclip();
    draw_axes(canvas, place, box, grid_step, options.grid, kText);
    if (options.path) {
      canvas.clip(box.x, box.y, box.width, box.height);
      draw_path(canvas, place, graph, submap, kText);
      canvas.unclip();
    }
    draw_title_block(canvas, {kMargin, paper.height - kMargin - kBlock, paper.width - 2 * kMargin, kBlock}, title,
                     facts, legend, scale, raster.cell, grid_step);
    return canvas.bytes();
  };
  write_file(folder / "sheet.pdf", draw(*pdf_canvas(paper.width, paper.height, title, facts.date)));
  write_file(folder / "sheet.svg", draw(*svg_canvas(paper.width, paper.height, "mm")));
  write_file(folder / "sheet.png", draw(*png_canvas(paper.width, paper.height, kDotsPerInch / 25.4)));
}

}  // namespace iris::exporters
