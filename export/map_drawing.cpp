#include "export/map_drawing.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>

namespace iris::exporters {
namespace {

using mapping::MapRaster;
using mapping::MapState;

constexpr uint32_t kGridLine = 0x9fb2c4;

cv::Vec3b bgr(uint32_t rgb) {
  return {static_cast<uint8_t>(rgb & 255), static_cast<uint8_t>(rgb >> 8 & 255), static_cast<uint8_t>(rgb >> 16)};
}

uint32_t rgb(const cv::Vec3b& bgr) {
  return static_cast<uint32_t>(bgr[2]) << 16 | static_cast<uint32_t>(bgr[1]) << 8 | bgr[0];
}

bool is_unknown(const MapRaster& raster, int y, int x) {
  return raster.state(y, x) == static_cast<uint8_t>(MapState::unknown);
}

cv::Vec3b layer_colour(int layer, int layers) {
  const std::array<cv::Vec3d, 3> anchors = {cv::Vec3d(107, 42, 27), cv::Vec3d(145, 150, 20), cv::Vec3d(0, 159, 240)};
  const double position = layers == 1 ? 1 : 2.0 * layer / (layers - 1);
  const size_t i = std::min<size_t>(1, static_cast<size_t>(position));
  const double part = position - static_cast<double>(i);
  return cv::Vec3b(anchors[i] * (1 - part) + anchors[i + 1] * part);
}

}  // namespace

cv::Mat3b grey_cells(const MapRaster& raster) {
  cv::Mat3b cells(raster.height, raster.width, bgr(kUnknownCell));
  for (int y = 0; y < raster.height; ++y) {
    for (int x = 0; x < raster.width; ++x) {
      if (is_unknown(raster, y, x)) continue;
      cells(y, x) = cv::Vec3b::all(cv::saturate_cast<uint8_t>(255 * (1 - raster.U(y, x))));
    }
  }
  return cells;
}

cv::Mat3b layer_cells(const MapRaster& raster) {
  const int layers = static_cast<int>(raster.layer_U.size());
  cv::Mat3b cells(raster.height, raster.width, bgr(kUnknownCell));
  for (int y = 0; y < raster.height; ++y) {
    for (int x = 0; x < raster.width; ++x) {
      if (is_unknown(raster, y, x)) continue;
      int best = 0;
      for (int k = 1; k < layers; ++k) {
        if (raster.layer_U[static_cast<size_t>(k)](y, x) > raster.layer_U[static_cast<size_t>(best)](y, x)) best = k;
      }
      const double strength = raster.layer_U[static_cast<size_t>(best)](y, x);
      const cv::Vec3d colour = layer_colour(best, layers);
      cells(y, x) = cv::Vec3b(cv::Vec3d::all(255) * (1 - strength) + colour * strength);
    }
  }
  return cells;
}

std::vector<LegendEntry> grey_legend() {
  return {
      {0xffffff, "free"}, {0x808080, "uncertain or partly filled"}, {0x000000, "occupied"}, {kUnknownCell, "unknown"}};
}

std::vector<LegendEntry> layer_legend(const MapRaster& raster) {
  std::vector<LegendEntry> legend;
  const int layers = static_cast<int>(raster.layer_U.size());
  for (int k = layers - 1; k >= 0; --k) {
    const auto i = static_cast<size_t>(k);
    legend.push_back({rgb(layer_colour(k, layers)),
                      fmt::format("z {:.2f} to {:.2f} m", raster.layer_bounds[i], raster.layer_bounds[i + 1])});
  }
  legend.push_back({0xffffff, "free"});
  legend.push_back({kUnknownCell, "unknown"});
  return legend;
}

std::vector<LegendEntry> path_legend(const PoseGraph& graph, int submap, bool with_loops) {
  std::vector<LegendEntry> legend = {{kVermillion, "camera path", LegendEntry::Mark::line},
                                     {kGreen, "start", LegendEntry::Mark::dot},
                                     {kBlue, "end", LegendEntry::Mark::square}};
  std::map<int, int> submap_of_frame;
  for (const PoseNode& node : graph.nodes) submap_of_frame[node.frame_idx] = node.submap;
  const auto loops = std::count_if(graph.edges.begin(), graph.edges.end(), [&](const PoseEdge& edge) {
    return edge.kind == PoseEdgeKind::loop && submap_of_frame.at(edge.i) == submap;
  });
  if (with_loops && loops > 0)
    legend.push_back({kOrange, fmt::format("closed loops ({})", loops), LegendEntry::Mark::dashed});
  return legend;
}

std::string submap_text(const PoseGraph& graph, int submap) {
  std::map<int, int> poses;
  for (const PoseNode& node : graph.nodes) ++poses[node.submap];
  if (poses.size() < 2) return "";
  return fmt::format("sub-map {} of {}: {} of {} poses", submap, poses.size(), poses[submap], graph.nodes.size());
}

MapExtent extent_of(const MapRaster& raster, const PoseGraph& graph, int submap) {
  int left = raster.width, right = -1, top = raster.height, bottom = -1;
  for (int y = 0; y < raster.height; ++y) {
    for (int x = 0; x < raster.width; ++x) {
      if (!raster.known(y, x)) continue;
      left = std::min(left, x), right = std::max(right, x), top = std::min(top, y), bottom = std::max(bottom, y);
    }
  }
  if (right < 0) left = top = 0, right = raster.width - 1, bottom = raster.height - 1;
  MapExtent extent{.x0 = raster.x_of(left) - raster.cell / 2,
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

void draw_cells(Canvas& canvas, const MapPlace& place, const MapRaster& raster, const cv::Mat3b& cells) {
  const double w = raster.width * raster.cell, h = raster.height * raster.cell;
  const Eigen::Vector2d corner = place.at(raster.origin_x, raster.origin_y + h);
  canvas.image(cells, corner.x(), corner.y(), w * place.units_per_metre, h * place.units_per_metre);
}

void draw_path(Canvas& canvas, const MapPlace& place, const PoseGraph& graph, int submap, bool loops, double size) {
  std::vector<Eigen::Vector2d> path;
  Eigen::AlignedBox2d box;
  std::map<int, Eigen::Vector2d> position_of_frame;
  for (const PoseNode& node : graph.nodes) {
    if (node.submap != submap) continue;
    path.push_back(place.at(node.world_from_cam.translation().x(), node.world_from_cam.translation().y()));
    position_of_frame[node.frame_idx] = path.back();
    box.extend(path.back());
  }
  if (path.empty()) return;
  for (const PoseEdge& edge : graph.edges) {
    if (!loops || edge.kind != PoseEdgeKind::loop || !position_of_frame.contains(edge.i)) continue;
    canvas.line({position_of_frame.at(edge.i), position_of_frame.at(edge.j)}, kOrange, 0.1 * size, true);
  }
  const double r = std::clamp(box.diagonal().norm() / 8, 0.2 * size, 0.5 * size);
  canvas.line(path, kVermillion, std::min(0.16 * size, 0.5 * r));
  canvas.dot(path.front(), r, kGreen);
  const double half = 0.6 * r;
  canvas.box(path.back().x() - half, path.back().y() - half, 2 * half, 2 * half, kBlue);
}

void draw_axes(Canvas& canvas, const MapPlace& place, const cv::Rect2d& box, double step, bool lines, double size) {
  const int digits = std::max(0, static_cast<int>(-std::floor(std::log10(step) + 1e-9)));
  const double right = box.x + box.width, bottom = box.y + box.height, tick = 0.4 * size;
  const auto label = [&](double value) { return fmt::format("{:.{}f}", value + 0.0, digits); };
  const double x0 = place.x + (box.x - place.left) / place.units_per_metre;
  const double y0 = place.y + (place.bottom - bottom) / place.units_per_metre;
  for (double i = std::ceil(x0 / step - 1e-9);; ++i) {
    const double column = place.at(i * step, 0).x();
    if (column > right + 1e-9) break;
    if (lines) canvas.line({{column, box.y}, {column, bottom}}, kGridLine, 0.04 * size);
    canvas.line({{column, bottom}, {column, bottom + tick}}, kInk, 0.08 * size);
    canvas.text(column, bottom + tick + 1.1 * size, label(i * step), {.size = size, .anchor = Anchor::middle});
  }
  for (double i = std::ceil(y0 / step - 1e-9);; ++i) {
    const double row = place.at(0, i * step).y();
    if (row < box.y - 1e-9) break;
    if (lines) canvas.line({{box.x, row}, {right, row}}, kGridLine, 0.04 * size);
    canvas.line({{box.x - tick, row}, {box.x, row}}, kInk, 0.08 * size);
    canvas.text(box.x - 1.5 * tick, row + 0.35 * size, label(i * step), {.size = size, .anchor = Anchor::end});
  }
  canvas.frame(box.x, box.y, box.width, box.height, kInk, 0.1 * size);
  canvas.text(right, bottom + tick + 2.4 * size, "x [m]", {.size = size, .anchor = Anchor::end});
  canvas.text(box.x - 2.6 * size, box.y, "y [m]", {.size = size, .anchor = Anchor::end, .turned = true});
}

double draw_legend(Canvas& canvas, double x, double y, const std::vector<LegendEntry>& entries, double size) {
  const double pitch = 1.65 * size, wide = 1.7 * size, middle = 0.36 * size;
  double row = y + size;  // the base line of the text
  for (const LegendEntry& entry : entries) {
    switch (entry.mark) {
      case LegendEntry::Mark::box:
        canvas.box(x, row - 0.95 * size, wide, 1.2 * size, entry.colour);
        canvas.frame(x, row - 0.95 * size, wide, 1.2 * size, kInk, 0.06 * size);
        break;
      case LegendEntry::Mark::line:
      case LegendEntry::Mark::dashed:
        canvas.line({{x, row - middle}, {x + wide, row - middle}}, entry.colour, 0.16 * size,
                    entry.mark == LegendEntry::Mark::dashed);
        break;
      case LegendEntry::Mark::dot:
        canvas.dot({x + wide / 2, row - middle}, 0.5 * size, entry.colour);
        break;
      case LegendEntry::Mark::square:
        canvas.box(x + wide / 2 - 0.3 * size, row - middle - 0.3 * size, 0.6 * size, 0.6 * size, entry.colour);
        break;
    }
    canvas.text(x + 1.45 * wide, row, entry.text, {.size = size});
    row += pitch;
  }
  return pitch * static_cast<double>(entries.size());
}

void draw_scale_bar(Canvas& canvas, double x, double y, double length, double units_per_metre, double size) {
  const double part = length * units_per_metre / 4, high = 0.7 * size, top = y + 1.5 * size;
  for (int i = 0; i < 4; ++i) canvas.box(x + i * part, top, part, high, i % 2 == 0 ? kInk : kWhite);
  canvas.frame(x, top, 4 * part, high, kInk, 0.08 * size);
  for (const int i : {0, 2, 4}) {
    canvas.text(x + i * part, y + size, fmt::format("{:g}{}", length * i / 4, i == 4 ? " m" : ""),
                {.size = size, .anchor = i == 0 ? Anchor::start : Anchor::middle});
  }
}

}  // namespace iris::exporters
