// Plots as PNG and SVG.
#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <opencv2/core.hpp>
#include <optional>
#include <string>
#include <vector>

#include "export/canvas.h"

namespace iris::exporters {

struct PlotSeries {
  enum class Style { line, dashed, points, bars };
  std::string name;                     // in the legend; empty = not there
  std::vector<Eigen::Vector2d> points;  // a point that is not finite interrupts a line; bars stand on y = 0
  uint32_t colour = kBlue;
  Style style = Style::line;
  double bar_width = 0;  // in units of x
};

struct PlotImage {
  cv::Mat3b pixels;                                 // BGR; row 0 on top
  double left = 0, right = 1, bottom = 0, top = 1;  // the image's borders on the axes; bottom > top is allowed
};

struct PlotSwatch {
  uint32_t colour = 0;
  std::string text;
};

struct Plot {
  std::string title, x_label, y_label;
  std::vector<PlotSeries> series;
  std::optional<PlotImage> image;    // below the series; the axes then show exactly its extent
  std::vector<PlotSwatch> swatches;  // in the legend, below the series
  bool equal_axes = false;           // one unit is as long on both axes
  bool y_from_zero = false;
  int width = 900, height = 600;  // [px]
};

// By the extension: .png or .svg. Whole or not at all (InputError).
void write_plot(const std::filesystem::path& path, const Plot& plot);

}  // namespace iris::exporters
