#include "export/map_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"

namespace iris::exporters {
namespace {

using mapping::MapRaster;
using mapping::MapState;

const cv::Vec3b kUnknown(226, 206, 186);  // BGR: light blue, darker than white by a third in no channel
const cv::Scalar kInk(40, 40, 40);
const cv::Scalar kPath(0, 94, 213);    // vermillion
const cv::Scalar kStart(115, 158, 0);  // bluish green
const cv::Scalar kEnd(178, 114, 0);    // blue

bool is(const MapRaster& raster, int y, int x, MapState state) {
  return raster.state(y, x) == static_cast<uint8_t>(state);
}

void write_png(const std::filesystem::path& path, const cv::Mat& image) {
  std::vector<unsigned char> bytes;
  IRIS_CHECK(cv::imencode(".png", image, bytes));
  write_file(path, bytes);
}

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

cv::Mat3b grey_picture(const MapRaster& raster) {
  cv::Mat3b picture(raster.height, raster.width, kUnknown);
  for (int y = 0; y < raster.height; ++y) {
    for (int x = 0; x < raster.width; ++x) {
      if (is(raster, y, x, MapState::unknown)) continue;
      picture(y, x) = cv::Vec3b::all(cv::saturate_cast<uint8_t>(255 * (1 - raster.U(y, x))));
    }
  }
  return picture;
}

// From dark blue (low) over teal to orange (high): differs in brightness as well, for every kind of colour vision.
cv::Vec3b layer_colour(int layer, int layers) {
  const std::array<cv::Vec3d, 3> anchors = {cv::Vec3d(107, 42, 27), cv::Vec3d(145, 150, 20), cv::Vec3d(0, 159, 240)};
  const double position = layers == 1 ? 1 : 2.0 * layer / (layers - 1);
  const size_t i = std::min<size_t>(1, static_cast<size_t>(position));
  const double part = position - static_cast<double>(i);
  return cv::Vec3b(anchors[i] * (1 - part) + anchors[i + 1] * part);
}

cv::Mat3b layer_picture(const MapRaster& raster) {
  const int layers = static_cast<int>(raster.layer_U.size());
  cv::Mat3b picture(raster.height, raster.width, kUnknown);
  for (int y = 0; y < raster.height; ++y) {
    for (int x = 0; x < raster.width; ++x) {
      if (is(raster, y, x, MapState::unknown)) continue;
      int best = 0;
      for (int k = 1; k < layers; ++k) {
        if (raster.layer_U[static_cast<size_t>(k)](y, x) > raster.layer_U[static_cast<size_t>(best)](y, x)) best = k;
      }
      const double strength = raster.layer_U[static_cast<size_t>(best)](y, x);
      const cv::Vec3d colour = layer_colour(best, layers);
      picture(y, x) = cv::Vec3b(cv::Vec3d::all(255) * (1 - strength) + colour * strength);
    }
  }
  return picture;
}

struct LegendEntry {
  cv::Scalar colour;
  std::string text;
};

// 1, 2 or 5 times a power of ten, not below `least`.
double round_length(double least) {
  double power = std::pow(10.0, std::floor(std::log10(least)));
  for (const double step : {1.0, 2.0, 5.0}) {
    if (step * power >= least * (1 - 1e-9)) return step * power;
  }
  return 10 * power;
}

// The cells enlarged, with the path, axes in metres, a scale bar and a legend on the right.
cv::Mat3b decorate(const MapRaster& raster, const cv::Mat3b& cells, const PoseGraph& graph, int submap,
                   std::vector<LegendEntry> legend) {
  constexpr int kFont = cv::FONT_HERSHEY_SIMPLEX;
  constexpr double kText = 0.45;
  constexpr int kLeft = 70, kTop = 30, kBottom = 60, kRight = 250, kLine = 22;
  const int zoom = std::clamp(1000 / std::max(raster.width, raster.height), 1, 16);
  const int w = raster.width * zoom, h = raster.height * zoom;
  legend.push_back({kPath, "camera path"});
  legend.push_back({kStart, "start (circle)"});
  legend.push_back({kEnd, "end (square)"});
  const int tall = std::max(h, kLine * (static_cast<int>(legend.size()) + 5));
  cv::Mat3b picture(kTop + tall + kBottom, kLeft + w + kRight, cv::Vec3b::all(255));
  cv::Mat3b enlarged;
  cv::resize(cells, enlarged, {w, h}, 0, 0, cv::INTER_NEAREST);
  enlarged.copyTo(picture(cv::Rect(kLeft, kTop, w, h)));

  // World [m] to picture; shift: sixteenths of a pixel for smooth lines.
  constexpr int kShift = 4;
  const auto at = [&](double x, double y) {
    const double column = kLeft + (x - raster.origin_x) / raster.cell * zoom;
    const double row = kTop + h - (y - raster.origin_y) / raster.cell * zoom;
    const auto fixed = [](double v) { return static_cast<int>(std::lround((v - 0.5) * (1 << kShift))); };
    return cv::Point(fixed(column), fixed(row));
  };
  std::vector<cv::Point> path;
  for (const PoseNode& node : graph.nodes) {
    if (node.submap != submap) continue;
    path.push_back(at(node.world_from_cam.translation().x(), node.world_from_cam.translation().y()));
  }
  cv::Mat3b inside = picture(cv::Rect(0, 0, picture.cols, picture.rows));
  if (!path.empty()) {
    cv::polylines(inside, path, false, kPath, 2, cv::LINE_AA, kShift);
    cv::circle(inside, path.front(), 6 << kShift, kStart, cv::FILLED, cv::LINE_AA, kShift);
    const cv::Point corner(5 << kShift, 5 << kShift);
    cv::rectangle(inside, path.back() - corner, path.back() + corner, kEnd, cv::FILLED, cv::LINE_AA, kShift);
  }

  // Axes.
  cv::rectangle(picture, cv::Rect(kLeft - 1, kTop - 1, w + 2, h + 2), kInk);
  const double tick = round_length(90.0 / zoom * raster.cell);
  const auto label = [&](double value) { return fmt::format("{:g}", std::round(value / tick) * tick + 0.0); };
  for (double x = std::ceil(raster.origin_x / tick) * tick; x <= raster.origin_x + raster.width * raster.cell;
       x += tick) {
    const int column = kLeft + static_cast<int>(std::lround((x - raster.origin_x) / raster.cell * zoom));
    cv::line(picture, {column, kTop + h}, {column, kTop + h + 5}, kInk);
    cv::putText(picture, label(x), {column - 8, kTop + h + 20}, kFont, kText, kInk, 1, cv::LINE_AA);
  }
  for (double y = std::ceil(raster.origin_y / tick) * tick; y <= raster.origin_y + raster.height * raster.cell;
       y += tick) {
    const int row = kTop + h - static_cast<int>(std::lround((y - raster.origin_y) / raster.cell * zoom));
    cv::line(picture, {kLeft - 6, row}, {kLeft - 1, row}, kInk);
    cv::putText(picture, label(y), {kLeft - 50, row + 5}, kFont, kText, kInk, 1, cv::LINE_AA);
  }
  cv::putText(picture, "x [m] ->   (world frame, z up, seen from above)", {kLeft, kTop + h + 42}, kFont, kText, kInk, 1,
              cv::LINE_AA);
  cv::putText(picture, "y [m] up", {4, kTop - 12}, kFont, kText, kInk, 1, cv::LINE_AA);

  // Legend and scale bar.
  const int left = kLeft + w + 20;
  int row = kTop + kLine / 2;
  for (const LegendEntry& entry : legend) {
    cv::rectangle(picture, cv::Rect(left, row - 7, 16, 14), entry.colour, cv::FILLED);
    cv::rectangle(picture, cv::Rect(left, row - 7, 16, 14), kInk);
    cv::putText(picture, entry.text, {left + 24, row + 5}, kFont, kText, kInk, 1, cv::LINE_AA);
    row += kLine;
  }
  const double bar = round_length(60.0 / zoom * raster.cell);
  const int pixels = static_cast<int>(std::lround(bar / raster.cell * zoom));
  row += kLine;
  cv::line(picture, {left, row}, {left + pixels, row}, kInk, 3);
  cv::putText(picture, fmt::format("{:g} m", bar), {left, row + 20}, kFont, kText, kInk, 1, cv::LINE_AA);
  cv::putText(picture, fmt::format("cell {:g} m", raster.cell), {left, row + 42}, kFont, kText, kInk, 1, cv::LINE_AA);
  return picture;
}

}  // namespace

void write_map(const std::filesystem::path& folder, const MapRaster& raster, const PoseGraph& graph, int submap) {
  IRIS_CHECK(raster.width > 0 && raster.height > 0 && raster.cell > 0);
  const cv::Mat3b grey = grey_picture(raster);
  write_file(folder / "map.pgm", pgm_of(raster));
  write_file(folder / "map.yaml", yaml_of(raster));
  write_file(folder / "map.pgw", world_file_of(raster));
  write_png(folder / "map.png", grey);
  const cv::Scalar unknown(kUnknown);
  write_png(folder / "map_picture.png", decorate(raster, grey, graph, submap,
                                                 {{cv::Scalar::all(255), "free"},
                                                  {cv::Scalar::all(128), "uncertain or partly filled"},
                                                  {cv::Scalar::all(0), "occupied"},
                                                  {unknown, "unknown"}}));
  std::vector<LegendEntry> legend;
  const int layers = static_cast<int>(raster.layer_U.size());
  for (int k = layers - 1; k >= 0; --k) {
    const auto i = static_cast<size_t>(k);
    legend.push_back({cv::Scalar(layer_colour(k, layers)),
                      fmt::format("z {:.2f} .. {:.2f} m", raster.layer_bounds[i], raster.layer_bounds[i + 1])});
  }
  legend.push_back({cv::Scalar::all(255), "free"});
  legend.push_back({unknown, "unknown"});
  write_png(folder / "layers.png", decorate(raster, layer_picture(raster), graph, submap, std::move(legend)));
}

}  // namespace iris::exporters
