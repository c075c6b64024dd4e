#include "export/canvas.h"

#include <cairo-pdf.h>
#include <cairo.h>
#include <fmt/format.h>

#include <cmath>
#include <opencv2/imgproc.hpp>

#include "export/html.h"
#include "iris/core/error.h"
#include "iris/workspace/view_files.h"

namespace iris::exporters {
namespace {

using Points = std::vector<Eigen::Vector2d>;
using Surface = std::unique_ptr<cairo_surface_t, decltype(&cairo_surface_destroy)>;

constexpr double kDash = 3.3, kDashGap = 2.2;  // [widths of the line]

cairo_status_t append(void* target, const unsigned char* data, unsigned int size) {
  auto& bytes = *static_cast<std::vector<unsigned char>*>(target);
  bytes.insert(bytes.end(), data, data + size);
  return CAIRO_STATUS_SUCCESS;
}

class CairoCanvas : public Canvas {
 public:
  CairoCanvas(Surface surface, double scale)
      : surface_(std::move(surface)), context_(cairo_create(surface_.get()), cairo_destroy) {
    IRIS_CHECK(cairo_status(cr()) == CAIRO_STATUS_SUCCESS);
    cairo_scale(cr(), scale, scale);
    cairo_set_line_join(cr(), CAIRO_LINE_JOIN_ROUND);
    cairo_set_source_rgb(cr(), 1, 1, 1);
    cairo_paint(cr());
  }

  void line(const Points& points, uint32_t colour, double width, bool dashed) override {
    const double dashes[] = {kDash * width, kDashGap * width};
    cairo_set_dash(cr(), dashes, dashed ? 2 : 0, 0);
    cairo_set_line_width(cr(), width);
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
  void text(double x, double y, const std::string& text, const TextStyle& style) override {
    set_colour(style.colour);
    cairo_select_font_face(cr(), "sans-serif", CAIRO_FONT_SLANT_NORMAL,
                           style.bold ? CAIRO_FONT_WEIGHT_BOLD : CAIRO_FONT_WEIGHT_NORMAL);
    cairo_set_font_size(cr(), style.size);
    cairo_text_extents_t extents;
    cairo_text_extents(cr(), text.c_str(), &extents);
    cairo_save(cr());
    cairo_translate(cr(), x, y);
    if (style.turned) cairo_rotate(cr(), -M_PI / 2);
    cairo_move_to(cr(), -0.5 * static_cast<int>(style.anchor) * extents.x_advance, 0);
    cairo_show_text(cr(), text.c_str());
    cairo_restore(cr());
  }
  void image(const cv::Mat3b& pixels, double x, double y, double w, double h) override {
    cv::Mat4b bgra;
    cv::cvtColor(pixels, bgra, cv::COLOR_BGR2BGRA);
    // Made by Cairo, not over our memory: a PDF reads it when it is finished.
    const Surface picture(cairo_image_surface_create(CAIRO_FORMAT_RGB24, bgra.cols, bgra.rows), cairo_surface_destroy);
    IRIS_CHECK(cairo_surface_status(picture.get()) == CAIRO_STATUS_SUCCESS);
    bgra.copyTo(cv::Mat4b(bgra.rows, bgra.cols,
                          reinterpret_cast<cv::Vec4b*>(cairo_image_surface_get_data(picture.get())),
                          static_cast<size_t>(cairo_image_surface_get_stride(picture.get()))));
    cairo_surface_mark_dirty(picture.get());
    cairo_save(cr());
    cairo_translate(cr(), x, y);
    cairo_scale(cr(), w / pixels.cols, h / pixels.rows);
    cairo_set_source_surface(cr(), picture.get(), 0, 0);
    double columns = 1, ignored = 0;  // of the surface, that a pixel covers
    cairo_user_to_device_distance(cr(), &columns, &ignored);
    cairo_pattern_set_filter(cairo_get_source(cr()), columns >= 1 ? CAIRO_FILTER_NEAREST : CAIRO_FILTER_GOOD);
    cairo_paint(cr());
    cairo_restore(cr());
  }
  void clip(double x, double y, double w, double h) override {
    cairo_save(cr());
    cairo_rectangle(cr(), x, y, w, h);
    cairo_clip(cr());
  }
  void unclip() override { cairo_restore(cr()); }

 protected:
  cairo_surface_t* surface() const { return surface_.get(); }
  void finish() {
    context_.reset();
    cairo_surface_finish(surface_.get());
    IRIS_CHECK(cairo_surface_status(surface_.get()) == CAIRO_STATUS_SUCCESS);
  }

 private:
  cairo_t* cr() const { return context_.get(); }
  void set_colour(uint32_t rgb) {
    cairo_set_source_rgb(cr(), (rgb >> 16 & 255) / 255.0, (rgb >> 8 & 255) / 255.0, (rgb & 255) / 255.0);
  }
  Surface surface_;
  std::unique_ptr<cairo_t, decltype(&cairo_destroy)> context_;
};

class PngCanvas : public CairoCanvas {
 public:
  PngCanvas(double width, double height, double scale)
      : CairoCanvas(Surface(cairo_image_surface_create(CAIRO_FORMAT_RGB24, static_cast<int>(std::lround(width * scale)),
                                                       static_cast<int>(std::lround(height * scale))),
                            cairo_surface_destroy),
                    scale) {}
  std::vector<unsigned char> bytes() override {
    std::vector<unsigned char> png;
    IRIS_CHECK(cairo_surface_write_to_png_stream(surface(), append, &png) == CAIRO_STATUS_SUCCESS);
    return png;
  }
};

// Holds what the surface writes to: must be there before the surface and outlive it.
struct PdfBytes {
  std::vector<unsigned char> bytes_;
};

class PdfCanvas : private PdfBytes, public CairoCanvas {
 public:
  PdfCanvas(double width, double height, const std::string& title, const std::string& date)
      : CairoCanvas(Surface(cairo_pdf_surface_create_for_stream(append, &bytes_, width * kPoints, height * kPoints),
                            cairo_surface_destroy),
                    kPoints) {
    cairo_pdf_surface_set_metadata(surface(), CAIRO_PDF_METADATA_TITLE, title.c_str());
    cairo_pdf_surface_set_metadata(surface(), CAIRO_PDF_METADATA_CREATOR, "iris " IRIS_VERSION);
    cairo_pdf_surface_set_metadata(surface(), CAIRO_PDF_METADATA_CREATE_DATE, date.c_str());
  }
  ~PdfCanvas() override {
    if (!finished_) finish();
  }
  std::vector<unsigned char> bytes() override {
    finish();
    finished_ = true;
    return std::move(bytes_);
  }

 private:
  static constexpr double kPoints = 72 / 25.4;  // a millimetre
  bool finished_ = false;
};

// Cairo's SVG surface turns text into outlines; this one keeps it.
class SvgCanvas : public Canvas {
 public:
  SvgCanvas(double width, double height, const std::string& unit) {
    text_ = fmt::format(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<svg xmlns=\"http://www.w3.org/2000/svg\" "
        "xmlns:xlink=\"http://www.w3.org/1999/xlink\" width=\"{0}{2}\" height=\"{1}{2}\" viewBox=\"0 0 {0} {1}\" "
        "font-family=\"sans-serif\">\n<rect width=\"{0}\" height=\"{1}\" fill=\"#ffffff\"/>\n",
        width, height, unit);
  }

  void line(const Points& points, uint32_t colour, double width, bool dashed) override {
    text_ += "<polyline points=\"";
    for (const Eigen::Vector2d& p : points) text_ += fmt::format("{:.3f},{:.3f} ", p.x(), p.y());
    text_ += fmt::format(
        "\" fill=\"none\" stroke=\"#{:06x}\" stroke-width=\"{}\" stroke-linejoin=\"round\"{}/>\n", colour, width,
        dashed ? fmt::format(" stroke-dasharray=\"{:.3f} {:.3f}\"", kDash * width, kDashGap * width) : "");
  }
  void box(double x, double y, double w, double h, uint32_t colour) override {
    text_ += fmt::format("<rect x=\"{:.3f}\" y=\"{:.3f}\" width=\"{:.3f}\" height=\"{:.3f}\" fill=\"#{:06x}\"/>\n", x,
                         y, w, h, colour);
  }
  void dot(const Eigen::Vector2d& at, double radius, uint32_t colour) override {
    text_ += fmt::format("<circle cx=\"{:.3f}\" cy=\"{:.3f}\" r=\"{}\" fill=\"#{:06x}\"/>\n", at.x(), at.y(), radius,
                         colour);
  }
  void text(double x, double y, const std::string& text, const TextStyle& style) override {
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
    text_ += fmt::format("<text x=\"{0:.3f}\" y=\"{1:.3f}\" font-size=\"{2}\" text-anchor=\"{3}\" fill=\"#{4:06x}\"", x,
                         y, style.size, kAnchors[static_cast<int>(style.anchor)], style.colour);
    if (style.bold) text_ += " font-weight=\"bold\"";
    if (style.turned) text_ += fmt::format(" transform=\"rotate(-90 {:.3f} {:.3f})\"", x, y);
    text_ += fmt::format(">{}</text>\n", safe);
  }
  void image(const cv::Mat3b& pixels, double x, double y, double w, double h) override {
    text_ += fmt::format(
        "<image x=\"{:.3f}\" y=\"{:.3f}\" width=\"{:.3f}\" height=\"{:.3f}\" preserveAspectRatio=\"none\" "
        "style=\"image-rendering:pixelated\" xlink:href=\"data:image/png;base64,{}\"/>\n",
        x, y, w, h, html::base64(workspace::encode_png(pixels)));
  }
  void clip(double x, double y, double w, double h) override {
    ++clips_;
    text_ += fmt::format(
        "<clipPath id=\"area{4}\"><rect x=\"{0:.3f}\" y=\"{1:.3f}\" width=\"{2:.3f}\" height=\"{3:.3f}\"/></clipPath>\n"
        "<g clip-path=\"url(#area{4})\">\n",
        x, y, w, h, clips_);
  }
  void unclip() override { text_ += "</g>\n"; }
  std::vector<unsigned char> bytes() override {
    const std::string all = text_ + "</svg>\n";
    return {all.begin(), all.end()};
  }

 private:
  std::string text_;
  int clips_ = 0;
};

}  // namespace

void Canvas::frame(double x, double y, double w, double h, uint32_t colour, double width) {
  line({{x, y}, {x + w, y}, {x + w, y + h}, {x, y + h}, {x, y}}, colour, width);
}

std::unique_ptr<Canvas> png_canvas(double width, double height, double pixels_per_unit) {
  return std::make_unique<PngCanvas>(width, height, pixels_per_unit);
}

std::unique_ptr<Canvas> svg_canvas(double width, double height, const std::string& unit) {
  return std::make_unique<SvgCanvas>(width, height, unit);
}

std::unique_ptr<Canvas> pdf_canvas(double width, double height, const std::string& title, const std::string& date) {
  return std::make_unique<PdfCanvas>(width, height, title, date);
}

double round_step(double least) {
  const double power = std::pow(10.0, std::floor(std::log10(least)));
  for (const double step : {1.0, 2.0, 5.0}) {
    if (step * power >= least * (1 - 1e-9)) return step * power;
  }
  return 10 * power;
}

}  // namespace iris::exporters
