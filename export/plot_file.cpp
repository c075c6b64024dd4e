#include "export/plot_file.h"

#include <cairo.h>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <opencv2/imgproc.hpp>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/workspace/view_files.h"

namespace iris::exporters {
namespace {

using Points = std::vector<Eigen::Vector2d>;
enum class Anchor { start, middle, end };

constexpr uint32_t kInk = 0x202020, kGrid = 0xe4e4e4, kWhite = 0xffffff;
constexpr double kFontSize = 13, kTitleSize = 16;

// What plots are drawn with. Pixels, y down.
class Canvas {
 public:
  virtual ~Canvas() = default;
  virtual void lines(const Points& points, uint32_t colour, double width, bool dashed) = 0;
  virtual void box(double x, double y, double w, double h, uint32_t colour) = 0;
  virtual void dot(const Eigen::Vector2d& at, double radius, uint32_t colour) = 0;
  // `turned`: reads upwards.
  virtual void text(double x, double y, const std::string& text, Anchor anchor, double size, bool turned) = 0;
  virtual void image(const cv::Mat3b& pixels, double x, double y, double w, double h) = 0;
  virtual void clip(double x, double y, double w, double h) = 0;
  virtual void unclip() = 0;
  virtual std::vector<unsigned char> bytes() = 0;
};

class CairoCanvas : public Canvas {
 public:
  CairoCanvas(int width, int height)
      : surface_(cairo_image_surface_create(CAIRO_FORMAT_RGB24, width, height), cairo_surface_destroy),
        context_(cairo_create(surface_.get()), cairo_destroy) {
    IRIS_CHECK(cairo_status(cr()) == CAIRO_STATUS_SUCCESS);
    cairo_select_font_face(cr(), "sans-serif", CAIRO_FONT_SLANT_NORMAL, CAIRO_FONT_WEIGHT_NORMAL);
    CairoCanvas::box(0, 0, width, height, kWhite);
  }

  void lines(const Points& points, uint32_t colour, double width, bool dashed) override {
    const double dashes[] = {6, 4};
    cairo_set_dash(cr(), dashes, dashed ? 2 : 0, 0);
    cairo_set_line_width(cr(), width);
    cairo_set_line_join(cr(), CAIRO_LINE_JOIN_ROUND);
    set_colour(colour);
    cairo_new_path(cr());  // text leaves a current point behind
    for (const Eigen::Vector2d& p : points) cairo_line_to(cr(), p.x(), p.y());
    cairo_stroke(cr());
  }
  void box(double x, double y, double w, double h, uint32_t colour) override {
    set_colour(colour);
    cairo_rectangle(cr(), x, y, w, h);
    cairo_fill(cr());
  }
  void dot(const Eigen::Vector2d& at, double radius, uint32_t colour) override {
    set_colour(colour);
    cairo_new_path(cr());
    cairo_arc(cr(), at.x(), at.y(), radius, 0, 2 * M_PI);
    cairo_fill(cr());
  }
  void text(double x, double y, const std::string& text, Anchor anchor, double size, bool turned) override {
    set_colour(kInk);
    cairo_set_font_size(cr(), size);
    cairo_text_extents_t extents;
    cairo_text_extents(cr(), text.c_str(), &extents);
    cairo_save(cr());
    cairo_translate(cr(), x, y);
    if (turned) cairo_rotate(cr(), -M_PI / 2);
    cairo_move_to(cr(), -0.5 * static_cast<int>(anchor) * extents.x_advance, 0);
    cairo_show_text(cr(), text.c_str());
    cairo_restore(cr());
  }
  void image(const cv::Mat3b& pixels, double x, double y, double w, double h) override {
    cv::Mat4b bgra;
    cv::cvtColor(pixels, bgra, cv::COLOR_BGR2BGRA);
    const std::unique_ptr<cairo_surface_t, decltype(&cairo_surface_destroy)> picture(
        cairo_image_surface_create_for_data(bgra.data, CAIRO_FORMAT_RGB24, bgra.cols, bgra.rows,
                                            static_cast<int>(bgra.step)),
        cairo_surface_destroy);
    cairo_save(cr());
    cairo_translate(cr(), x, y);
    cairo_scale(cr(), w / pixels.cols, h / pixels.rows);
    cairo_set_source_surface(cr(), picture.get(), 0, 0);
    // Enlarged pixels stay sharp squares; reduced ones are averaged.
    cairo_pattern_set_filter(cairo_get_source(cr()), w >= pixels.cols ? CAIRO_FILTER_NEAREST : CAIRO_FILTER_GOOD);
    cairo_paint(cr());
    cairo_restore(cr());
  }
  void clip(double x, double y, double w, double h) override {
    cairo_save(cr());
    cairo_rectangle(cr(), x, y, w, h);
    cairo_clip(cr());
  }
  void unclip() override { cairo_restore(cr()); }
  std::vector<unsigned char> bytes() override {
    std::vector<unsigned char> png;
    const auto append = [](void* target, const unsigned char* data, unsigned int size) {
      auto& to = *static_cast<std::vector<unsigned char>*>(target);
      to.insert(to.end(), data, data + size);
      return CAIRO_STATUS_SUCCESS;
    };
    IRIS_CHECK(cairo_surface_write_to_png_stream(surface_.get(), append, &png) == CAIRO_STATUS_SUCCESS);
    return png;
  }

 private:
  cairo_t* cr() const { return context_.get(); }
  void set_colour(uint32_t rgb) {
    cairo_set_source_rgb(cr(), (rgb >> 16 & 255) / 255.0, (rgb >> 8 & 255) / 255.0, (rgb & 255) / 255.0);
  }
  std::unique_ptr<cairo_surface_t, decltype(&cairo_surface_destroy)> surface_;
  std::unique_ptr<cairo_t, decltype(&cairo_destroy)> context_;
};

std::string base64(const std::vector<unsigned char>& bytes) {
  constexpr char kDigits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  for (size_t i = 0; i < bytes.size(); i += 3) {
    const size_t n = std::min<size_t>(3, bytes.size() - i);
    uint32_t value = 0;
    for (size_t k = 0; k < 3; ++k) value = value << 8 | (k < n ? bytes[i + k] : 0u);
    for (size_t k = 0; k < 4; ++k) text += k <= n ? kDigits[value >> (18 - 6 * k) & 63] : '=';
  }
  return text;
}

// Cairo's SVG surface turns text into outlines; this one keeps it.
class SvgCanvas : public Canvas {
 public:
  SvgCanvas(int width, int height) {
    text_ = fmt::format(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<svg xmlns=\"http://www.w3.org/2000/svg\" "
        "xmlns:xlink=\"http://www.w3.org/1999/xlink\" width=\"{0}\" height=\"{1}\" viewBox=\"0 0 {0} {1}\" "
        "font-family=\"sans-serif\">\n<rect width=\"{0}\" height=\"{1}\" fill=\"#ffffff\"/>\n",
        width, height);
  }

  void lines(const Points& points, uint32_t colour, double width, bool dashed) override {
    text_ += "<polyline points=\"";
    for (const Eigen::Vector2d& p : points) text_ += fmt::format("{:.2f},{:.2f} ", p.x(), p.y());
    text_ += fmt::format("\" fill=\"none\" stroke=\"#{:06x}\" stroke-width=\"{}\" stroke-linejoin=\"round\"{}/>\n",
                         colour, width, dashed ? " stroke-dasharray=\"6 4\"" : "");
  }
  void box(double x, double y, double w, double h, uint32_t colour) override {
    text_ += fmt::format("<rect x=\"{:.2f}\" y=\"{:.2f}\" width=\"{:.2f}\" height=\"{:.2f}\" fill=\"#{:06x}\"/>\n", x,
                         y, w, h, colour);
  }
  void dot(const Eigen::Vector2d& at, double radius, uint32_t colour) override {
    text_ += fmt::format("<circle cx=\"{:.2f}\" cy=\"{:.2f}\" r=\"{}\" fill=\"#{:06x}\"/>\n", at.x(), at.y(), radius,
                         colour);
  }
  void text(double x, double y, const std::string& text, Anchor anchor, double size, bool turned) override {
    constexpr const char* kAnchors[] = {"start", "middle", "end"};
    std::string safe;
    for (const char c : text) {
      if (c == '&') {
        safe += "&amp;";
      } else if (c == '<') {
        safe += "&lt;";
      } else {
        safe += c;
      }
    }
    text_ += fmt::format("<text x=\"{0:.2f}\" y=\"{1:.2f}\" font-size=\"{2}\" text-anchor=\"{3}\" fill=\"#{4:06x}\"", x,
                         y, size, kAnchors[static_cast<int>(anchor)], kInk);
    if (turned) text_ += fmt::format(" transform=\"rotate(-90 {:.2f} {:.2f})\"", x, y);
    text_ += fmt::format(">{}</text>\n", safe);
  }
  void image(const cv::Mat3b& pixels, double x, double y, double w, double h) override {
    text_ += fmt::format(
        "<image x=\"{:.2f}\" y=\"{:.2f}\" width=\"{:.2f}\" height=\"{:.2f}\" preserveAspectRatio=\"none\" "
        "style=\"image-rendering:pixelated\" xlink:href=\"data:image/png;base64,{}\"/>\n",
        x, y, w, h, base64(workspace::encode_png(pixels)));
  }
  void clip(double x, double y, double w, double h) override {
    text_ += fmt::format(
        "<clipPath id=\"area\"><rect x=\"{:.2f}\" y=\"{:.2f}\" width=\"{:.2f}\" height=\"{:.2f}\"/></clipPath>\n"
        "<g clip-path=\"url(#area)\">\n",
        x, y, w, h);
  }
  void unclip() override { text_ += "</g>\n"; }
  std::vector<unsigned char> bytes() override {
    const std::string all = text_ + "</svg>\n";
    return {all.begin(), all.end()};
  }

 private:
  std::string text_;
};

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

// Steps of 1, 2 or 5 times a power of ten, at most about `count` of them.
double tick_step(double length, double count) {
  const double least = length / count, power = std::pow(10.0, std::floor(std::log10(least)));
  for (const double step : {1.0, 2.0, 5.0}) {
    if (step * power >= least * (1 - 1e-9)) return step * power;
  }
  return 10 * power;
}

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
  const double step_x = tick_step(x.length(), w / 80), step_y = tick_step(y.length(), h / 50);
  for (const double tick : ticks_of(x, step_x)) {
    const double column = crisp(at(tick, y.low).x());
    canvas.lines({{column, y0}, {column, y0 + h}}, kGrid, 1, false);
    canvas.text(column, y0 + h + 18, tick_text(tick, step_x), Anchor::middle, kFontSize, false);
  }
  for (const double tick : ticks_of(y, step_y)) {
    const double row = crisp(at(x.low, tick).y());
    canvas.lines({{x0, row}, {x0 + w, row}}, kGrid, 1, false);
    canvas.text(x0 - 8, row + 4, tick_text(tick, step_y), Anchor::end, kFontSize, false);
  }
  canvas.text(x0 + w / 2, y0 + h + 42, plot.x_label, Anchor::middle, kFontSize, false);
  canvas.text(18, y0 + h / 2, plot.y_label, Anchor::middle, kFontSize, true);
  canvas.text(x0, kTop - 18, plot.title, Anchor::start, kTitleSize, false);

  canvas.clip(x0, y0, w, h);
  if (plot.image) canvas.image(plot.image->pixels, x0, y0, w, h);
  for (const PlotSeries& series : plot.series) {
    Points run;
    const auto end_run = [&] {
      if (run.size() > 1) canvas.lines(run, series.colour, 1.8, series.style == PlotSeries::Style::dashed);
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
  canvas.lines(
      {{crisp(x0), crisp(y0)}, {right, crisp(y0)}, {right, bottom}, {crisp(x0), bottom}, {crisp(x0), crisp(y0)}}, kInk,
      1, false);

  double row = y0 + 12;
  const double left = x0 + w + 14;
  for (const PlotSeries& series : plot.series) {
    if (series.name.empty()) continue;
    if (series.style == PlotSeries::Style::points) {
      canvas.dot({left + 10, row - 4}, 3, series.colour);
    } else if (series.style == PlotSeries::Style::bars) {
      canvas.box(left + 2, row - 11, 16, 13, series.colour);
    } else {
      canvas.lines({{left, row - 4}, {left + 20, row - 4}}, series.colour, 2,
                   series.style == PlotSeries::Style::dashed);
    }
    canvas.text(left + 28, row, series.name, Anchor::start, kFontSize, false);
    row += kLine;
  }
  for (const PlotSwatch& swatch : plot.swatches) {
    canvas.box(left + 1, row - 12, 18, 15, kInk);
    canvas.box(left + 2, row - 11, 16, 13, swatch.colour);
    canvas.text(left + 28, row, swatch.text, Anchor::start, kFontSize, false);
    row += kLine;
  }
}

}  // namespace

void write_plot(const std::filesystem::path& path, const Plot& plot) {
  IRIS_CHECK(plot.width > 0 && plot.height > 0 && (!plot.image || !plot.image->pixels.empty()));
  std::unique_ptr<Canvas> canvas;
  if (path.extension() == ".svg") {
    canvas = std::make_unique<SvgCanvas>(plot.width, plot.height);
  } else {
    IRIS_CHECK(path.extension() == ".png");
    canvas = std::make_unique<CairoCanvas>(plot.width, plot.height);
  }
  draw(*canvas, plot);
  write_file(path, canvas->bytes());
}

}  // namespace iris::exporters
