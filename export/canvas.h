// What plots, map pictures and sheets are drawn on. PNG and PDF are drawn by Cairo; SVG is written here, because
// Cairo's own turns text into outlines. In all of them text stays text where the format knows text.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

namespace iris::exporters {

// Colours that colour-blind people tell apart (Okabe and Ito), 0xRRGGBB.
constexpr uint32_t kBlue = 0x0072b2, kVermillion = 0xd55e00, kGreen = 0x009e73, kOrange = 0xe69f00, kGrey = 0x777777;
constexpr uint32_t kInk = 0x202020, kWhite = 0xffffff;

enum class Anchor { start, middle, end };

struct TextStyle {
  double size = 13;  // [units] of the font
  Anchor anchor = Anchor::start;
  bool bold = false;
  bool turned = false;  // reads upwards
  uint32_t colour = kInk;
};

// x to the right, y down, in the canvas's own units; white at first.
class Canvas {
 public:
  virtual ~Canvas() = default;
  // A line through the points; dashes are in proportion to its width.
  virtual void line(const std::vector<Eigen::Vector2d>& points, uint32_t colour, double width, bool dashed = false) = 0;
  virtual void box(double x, double y, double w, double h, uint32_t colour) = 0;
  virtual void dot(const Eigen::Vector2d& at, double radius, uint32_t colour) = 0;
  virtual void text(double x, double y, const std::string& text, const TextStyle& style) = 0;
  // Enlarged pixels stay sharp squares; reduced ones are averaged.
  virtual void image(const cv::Mat3b& pixels, double x, double y, double w, double h) = 0;
  virtual void clip(double x, double y, double w, double h) = 0;
  virtual void unclip() = 0;
  // The finished file. Nothing can be drawn afterwards.
  virtual std::vector<unsigned char> bytes() = 0;

  // The outline of a box.
  void frame(double x, double y, double w, double h, uint32_t colour, double width);
};

// Units are `pixels_per_unit` pixels.
std::unique_ptr<Canvas> png_canvas(double width, double height, double pixels_per_unit);
// Units are pixels ("px") or millimetres ("mm").
std::unique_ptr<Canvas> svg_canvas(double width, double height, const std::string& unit);
// Units are millimetres. `date`: of creation, as 2003-07-01T12:00:00Z; a fixed one gives the same bytes every time.
std::unique_ptr<Canvas> pdf_canvas(double width, double height, const std::string& title, const std::string& date);

// Steps of 1, 2 or 5 times a power of ten, not below `least`.
double round_step(double least);

}  // namespace iris::exporters
