#include "export/plot_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"

namespace iris::exporters {
namespace {

constexpr uint32_t kGrid = 0xe4e4e4;
constexpr double kFontSize = 13, kTitleSize = 16;

struct Range {
  double low = std::numeric_limits<double>::infinity(), high = -std::numeric_limits<double>::infinity();
  void include(double v) {
    if (!std::isfinite(v)) return;
    low = std::min(low, v);
    high = std::max(high, v);
  }
  double length() const { return high - low; }
  // Never empty, with a margin at both ends.
  void widen(double part) {
    if (!(low <= high)) low = 0, high = 1;
    if (low == high) low -= 0.5, high += 0.5;
    const double margin = part * length();
    low -= margin;
    high += margin;
  }
};

std::vector<double> ticks_of(const Range& range, double step) {
  std::vector<double> ticks;
  for (double i = std::ceil(range.low / step - 1e-9); i * step <= range.high + 1e-9 * step; ++i) {
    ticks.push_back(i * step + 0.0);
  }
  return ticks;
}

// Digits behind the point as the step needs them.
std::string tick_text(double value, double step) {
  const int digits = std::max(0, static_cast<int>(-std::floor(std::log10(step) + 1e-9)));
  return fmt::format("{:.{}f}", std::abs(value) < 1e-9 * step ? 0.0 : value, digits);
}

void draw(Canvas& canvas, const Plot& plot) {
  size_t longest = 0;
  int entries = static_cast<int>(plot.swatches.size());
  for (const PlotSwatch& swatch : plot.swatches) longest = std::max(longest, swatch.text.size());
  for (const PlotSeries& series : plot.series) {
    if (series.name.empty()) continue;
    longest = std::max(longest, series.name.size());
    ++entries;
  }
  constexpr double kLeft = 78, kTop = 44, kBottom = 58, kLine = 22;
  const double legend = entries > 0 ? 56 + 0.56 * kFontSize * static_cast<double>(longest) : 24;
  double x0 = kLeft, y0 = kTop;
  double w = std::max(100.0, plot.width - kLeft - legend), h = std::max(100.0, plot.height - kTop - kBottom);

  Range x, y;  // y: high is on top
  double sign_y = 1;
  if (plot.image) {
    x = {plot.image->left, plot.image->right};
    y = {std::min(plot.image->bottom, plot.image->top), std::max(plot.image->bottom, plot.image->top)};
    if (plot.image->bottom > plot.image->top) sign_y = -1;
  } else {
    for (const PlotSeries& series : plot.series) {
      const bool bars = series.style == PlotSeries::Style::bars;
      for (const Eigen::Vector2d& p : series.points) {
        x.include(p.x() - (bars ? series.bar_width / 2 : 0));
        x.include(p.x() + (bars ? series.bar_width / 2 : 0));
        y.include(p.y());
        if (bars) y.include(0);
      }
    }
    x.widen(0.03);
    if (plot.y_from_zero) y.include(0);
    y.widen(0.06);
    if (plot.y_from_zero && y.low < 0 && y.low > -0.1 * y.length()) y.low = 0;
  }
  if (plot.equal_axes) {
    const double scale = std::min(w / x.length(), h / y.length());
    if (plot.image) {
      w = scale * x.length();
      h = scale * y.length();
    } else {
      const double more_x = w / scale - x.length(), more_y = h / scale - y.length();
      x = {x.low - more_x / 2, x.high + more_x / 2};
      y = {y.low - more_y / 2, y.high + more_y / 2};
    }
  }
  const auto at = [&](double px, double py) {
    const double part = (py - y.low) / y.length();
    return Eigen::Vector2d(x0 + (px - x.low) / x.length() * w, y0 + (sign_y > 0 ? 1 - part : part) * h);
  };

  // Axes. Lines along the middle of pixels are sharp.
  const auto crisp = [](double v) { return std::floor(v) + 0.5; };
  const double step_x = round_step(80 * x.length() / w), step_y = round_step(50 * y.length() / h);
  for (const double tick : ticks_of(x, step_x)) {
    const double column = crisp(at(tick, y.low).x());
    canvas.line({{column, y0}, {column, y0 + h}}, kGrid, 1);
    canvas.text(column, y0 + h + 18, tick_text(tick, step_x), {.size = kFontSize, .anchor = Anchor::middle});
  }
  for (const double tick : ticks_of(y, step_y)) {
    const double row = crisp(at(x.low, tick).y());
    canvas.line({{x0, row}, {x0 + w, row}}, kGrid, 1);
    canvas.text(x0 - 8, row + 4, tick_text(tick, step_y), {.size = kFontSize, .anchor = Anchor::end});
  }
  canvas.text(x0 + w / 2, y0 + h + 42, plot.x_label, {.size = kFontSize, .anchor = Anchor::middle});
  canvas.text(18, y0 + h / 2, plot.y_label, {.size = kFontSize, .anchor = Anchor::middle, .turned = true});
  canvas.text(x0, kTop - 18, plot.title, {.size = kTitleSize});

  canvas.clip(x0, y0, w, h);
  if (plot.image) canvas.image(plot.image->pixels, x0, y0, w, h);
  for (const PlotSeries& series : plot.series) {
    std::vector<Eigen::Vector2d> run;
    const auto end_run = [&] {
      if (run.size() > 1) canvas.line(run, series.colour, 1.8, series.style == PlotSeries::Style::dashed);
      run.clear();
    };
    for (const Eigen::Vector2d& p : series.points) {
      if (!p.allFinite()) {
        end_run();
        continue;
      }
      if (series.style == PlotSeries::Style::points) {
        canvas.dot(at(p.x(), p.y()), 2.5, series.colour);
      } else if (series.style == PlotSeries::Style::bars) {
        const Eigen::Vector2d a = at(p.x() - series.bar_width / 2, p.y()), b = at(p.x() + series.bar_width / 2, 0);
        canvas.box(a.x(), std::min(a.y(), b.y()), b.x() - a.x(), std::abs(b.y() - a.y()), series.colour);
      } else {
        run.push_back(at(p.x(), p.y()));
      }
    }
    end_run();
  }
  canvas.unclip();
  const double right = crisp(x0 + w), bottom = crisp(y0 + h);
  canvas.frame(crisp(x0), crisp(y0), right - crisp(x0), bottom - crisp(y0), kInk, 1);

  double row = y0 + 12;
  const double left = x0 + w + 14;
  for (const PlotSeries& series : plot.series) {
    if (series.name.empty()) continue;
    if (series.style == PlotSeries::Style::points) {
      canvas.dot({left + 10, row - 4}, 3, series.colour);
    } else if (series.style == PlotSeries::Style::bars) {
      canvas.box(left + 2, row - 11, 16, 13, series.colour);
    } else {
      canvas.line({{left, row - 4}, {left + 20, row - 4}}, series.colour, 2, series.style == PlotSeries::Style::dashed);
    }
    canvas.text(left + 28, row, series.name, {.size = kFontSize});
    row += kLine;
  }
  for (const PlotSwatch& swatch : plot.swatches) {
    canvas.box(left + 1, row - 12, 18, 15, kInk);
    canvas.box(left + 2, row - 11, 16, 13, swatch.colour);
    canvas.text(left + 28, row, swatch.text, {.size = kFontSize});
    row += kLine;
  }
}

}  // namespace

void write_plot(const std::filesystem::path& path, const Plot& plot) {
  IRIS_CHECK(plot.width > 0 && plot.height > 0 && (!plot.image || !plot.image->pixels.empty()));
  std::unique_ptr<Canvas> canvas;
  if (path.extension() == ".svg") {
    canvas = svg_canvas(plot.width, plot.height, "px");
  } else {
    IRIS_CHECK(path.extension() == ".png");
    canvas = png_canvas(plot.width, plot.height, 1);
  }
  draw(*canvas, plot);
  write_file(path, canvas->bytes());
}

}  // namespace iris::exporters
