#include "export/calibration_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "export/canvas.h"
#include "export/html.h"
#include "iris/core/atomic_file.h"

namespace iris::exporters {
namespace {

using calibrate::TargetView;
using Vec = Eigen::Vector2d;

std::string picture(Canvas& canvas, const std::string& what) {
  return fmt::format("<img alt=\"{0}\" src=\"data:image/svg+xml;base64,{1}\">", html::escape(what),
                     html::base64(canvas.bytes()));
}

constexpr double kScale = 100;  // residuals are drawn so many times as long

// Cells that no corner covers are tinted; each corner with its residual.
std::string residual_picture(const CalibrationReport& report, bool left) {
  const CameraModel& camera = left ? report.result.calibration.left : report.result.calibration.right;
  constexpr double kWidth = 560, kMargin = 8, kFoot = 26;
  const double scale = kWidth / camera.width, height = camera.height * scale;
  const auto canvas = svg_canvas(kWidth + 2 * kMargin, height + 2 * kMargin + kFoot, "px");
  constexpr int kColumns = 8, kRows = 6;
  constexpr uint32_t kEmpty = 0xf6dcd0, kSeen = 0xf2f6f9;
  const cv::Mat1i counts = calibrate::coverage(report.views, left, camera.width, camera.height, kColumns, kRows);
  for (int y = 0; y < kRows; ++y) {
    for (int x = 0; x < kColumns; ++x) {
      const double w = kWidth / kColumns, h = height / kRows;
      canvas->box(kMargin + x * w, kMargin + y * h, w, h, counts(y, x) == 0 ? kEmpty : kSeen);
    }
  }
  canvas->clip(kMargin, kMargin, kWidth, height);
  for (size_t v = 0; v < report.views.size(); ++v) {
    const auto& corners = left ? report.views[v].left : report.views[v].right;
    const auto& residuals = left ? report.result.errors[v].left : report.result.errors[v].right;
    for (size_t i = 0; i < corners.size(); ++i) {
      const Vec at = scale * (corners.points[i] + Vec(0.5, 0.5)) + Vec(kMargin, kMargin);
      canvas->line({at, at + scale * kScale * residuals[i]}, kVermillion, 1);
      canvas->dot(at, 1.1, kBlue);
    }
  }
  canvas->unclip();
  canvas->frame(kMargin, kMargin, kWidth, height, kGrey, 1);
  // A bar for the length of residuals.
  const double bar = round_step(0.4 * 60 / (scale * kScale)), y = kMargin + height + 17;
  canvas->line({{kMargin, y}, {kMargin + bar * scale * kScale, y}}, kVermillion, 2);
  canvas->text(kMargin + bar * scale * kScale + 8, y + 4, fmt::format("{:g} px; tinted: no corners", bar),
               {.size = 12});
  return picture(*canvas, left ? "residuals of the left image" : "residuals of the right image");
}

std::string depth_picture(const std::vector<calibrate::DepthError>& depths) {
  constexpr double kWidth = 520, kHeight = 260, kLeft = 62, kTop = 14, kRight = 12, kBottom = 42;
  const auto canvas = svg_canvas(kWidth, kHeight, "px");
  double most = 0;
  for (const auto& d : depths) {
    if (std::isfinite(d.total())) most = std::max(most, 100 * d.total());
  }
  if (most <= 0) most = 1;
  const double w = kWidth - kLeft - kRight, h = kHeight - kTop - kBottom;
  const auto at = [&](double metres, double cm) {
    return Vec(kLeft + w * metres / 10, kTop + h * (1 - cm / (1.05 * most)));
  };
  const double step = round_step(most / 5);
  for (double cm = 0; cm <= 1.05 * most; cm += step) {
    canvas->line({at(0, cm), at(10, cm)}, 0xe4e4e4, 1);
    canvas->text(kLeft - 6, at(0, cm).y() + 4, fmt::format("{:g}", cm), {.size = 12, .anchor = Anchor::end});
  }
  for (int metres = 0; metres <= 10; metres += 2) {
    canvas->text(at(metres, 0).x(), kTop + h + 17, fmt::format("{}", metres), {.size = 12, .anchor = Anchor::middle});
  }
  const auto curve = [&](auto value, uint32_t colour, bool dashed) {
    std::vector<Vec> points = {at(0, 0)};
    for (const auto& d : depths) {
      if (std::isfinite(value(d))) points.push_back(at(d.depth, 100 * value(d)));
    }
    canvas->line(points, colour, 2, dashed);
  };
  curve([](const auto& d) { return d.matching; }, kBlue, true);
  curve([](const auto& d) { return d.calibration; }, kVermillion, false);
  curve([](const auto& d) { return d.total(); }, kInk, false);
  canvas->text(kLeft + 10, kTop + 14, "total", {.size = 12, .bold = true, .colour = kInk});
  canvas->text(kLeft + 10, kTop + 30, "from this calibration", {.size = 12, .colour = kVermillion});
  canvas->text(kLeft + 10, kTop + 46, "from matching (0.1 px, dashed)", {.size = 12, .colour = kBlue});
  canvas->text(kLeft + w / 2, kHeight - 6, "depth [m]", {.size = 12, .anchor = Anchor::middle});
  canvas->text(14, kTop + h / 2, "depth error [cm]", {.size = 12, .anchor = Anchor::middle, .turned = true});
  return picture(*canvas, "expected depth errors");
}

std::string row(const std::vector<std::string>& cells, const char* tag = "td") {
  std::string text = "<tr>";
  for (const std::string& cell : cells) text += fmt::format("<{0}>{1}</{0}>", tag, cell);
  return text + "</tr>\n";
}

std::string pixels(double value) { return std::isfinite(value) ? fmt::format("{:.3f} px", value) : "-"; }

// "521.30 ± 0.05": two digits of the deviation.
std::string with_sigma(const calibrate::Parameter& p) {
  const int digits = p.sigma > 0 ? std::clamp(1 - static_cast<int>(std::floor(std::log10(p.sigma))), 0, 8) : 3;
  return fmt::format("{:.{}f}</td><td>± {:.{}f}", p.value, digits, p.sigma, digits);
}

}  // namespace

std::string calibration_report_html(const CalibrationReport& report) {
  const calibrate::StereoCalibrationResult& r = report.result;
  const double baseline = r.calibration.right_centre_in_left().norm();
  std::string html = fmt::format("<p>{}, images of {} x {} px. {}.</p>\n", html::escape(report.target),
                                 r.calibration.left.width, r.calibration.left.height, html::escape(report.images));
  html += "<div class=big>";
  const auto big = [&](const std::string& value, const char* label) {
    html += fmt::format("<div><b>{}</b>{}</div>", value, label);
  };
  big(pixels(r.rms), "RMS of the corners");
  big(pixels(report.validation.rms), "rows of unseen pairs (RMS)");
  big(fmt::format("{:.2f} mm", 1000 * baseline), "baseline");
  big(fmt::format("{:.2f} px", rectified_focal_length(r.calibration)), "focal length, rectified");
  html += "</div>\n";
  if (report.warnings.empty()) {
    html += "<div class=good>Nothing to complain about.</div>\n";
  } else {
    html += "<div class=warning><b>What to do better</b><ul>\n";
    for (const std::string& warning : report.warnings) html += "<li>" + html::escape(warning) + "</li>\n";
    html += "</ul></div>\n";
  }

  html += "<h2>Errors</h2>\n<table class=numbers>\n";
  html += row({"", "left", "right", "both"}, "th");
  html += row(
      {"views", fmt::format("{}", r.left_views), fmt::format("{}", r.right_views), fmt::format("{} pairs", r.pairs)});
  html += row({"RMS, both cameras calibrated together", pixels(r.left_rms), pixels(r.right_rms), pixels(r.rms)});
  html +=
      row({"RMS before that: each camera calibrated alone, the rig as one pair shows it", "", "", pixels(r.start_rms)});
  html += row({"standard deviation of a coordinate", "", "", pixels(r.sigma)});
  html += "</table>\n";
  html += r.sheet_along > 0
              ? fmt::format(
                    "<p>The target is uneven: its corners lie {:.2f} mm beside their places and {:.2f} mm above "
                    "or below its plane (RMS). The images show it, and the calibration allows for it.</p>\n",
                    1000 * r.sheet_along, 1000 * r.sheet_across)
              : "<p>The target is flat and as large as stated, as far as the images tell.</p>\n";
  html += fmt::format(
      "<p>Rows after rectification, of {} corners in {} pairs, each rectified by a calibration that did not use it "
      "(cross-validation): RMS <b>{}</b>, mean of the absolute values {}, worst pair {}. Stereo wants less than 0.2 "
      "px.</p>\n",
      report.validation.corners, report.validation.pairs, pixels(report.validation.rms), pixels(report.validation.mean),
      pixels(report.validation.worst_pair));

  html += "<h2>Residuals and coverage</h2>\n<div class=columns>\n";
  for (const bool left : {true, false}) {
    html += fmt::format("<figure>{}<figcaption>{} image: residuals {} times as long</figcaption></figure>\n",
                        residual_picture(report, left), left ? "Left" : "Right", kScale);
  }
  html +=
      "</div>\n<p>Residuals that point the same way over parts of the image mean that the lens model "
      "does not fit; without any order they are noise.</p>\n";

  html += "<h2>Expected depth errors</h2>\n<div class=columns><figure>" + depth_picture(report.depths) +
          "</figure>\n<table class=numbers>\n";
  html += row({"depth", "from this calibration", "from matching", "total"}, "th");
  const auto length = [](double metres) {
    return !std::isfinite(metres) ? std::string("-")
           : metres < 0.1         ? fmt::format("{:.1f} mm", 1000 * metres)
                                  : fmt::format("{:.1f} cm", 100 * metres);
  };
  for (const auto& d : report.depths) {
    html += row({fmt::format("{:.0f} m", d.depth), length(d.calibration), length(d.matching), length(d.total())});
  }
  html +=
      "</table></div>\n<p>Standard deviations over the image. Errors from the calibration are the same "
      "in "
      "every frame of a recording; those from matching average out.</p>\n";

  html += "<h2>Parameters and their standard deviations</h2>\n<div class=columns>\n";
  const size_t per_camera = 4 + r.calibration.left.coefficients.size();
  for (const auto& [begin, end] : {std::pair(size_t{0}, per_camera), std::pair(per_camera, 2 * per_camera),
                                   std::pair(2 * per_camera, r.parameters.size())}) {
    html += "<table class=numbers>\n";
    for (size_t i = begin; i < end; ++i) {
      html +=
          row({html::escape(r.parameters[i].name), with_sigma(r.parameters[i]), html::escape(r.parameters[i].unit)});
    }
    html += "</table>\n";
  }
  html +=
      "</div>\n<p>Rotation vector and translation take points of the left camera to the right one: "
      "P_right = R P_left + T.</p>\n";

  html += "<h2>Views</h2>\n<table class=numbers>\n";
  html += row({"view", "corners left", "right", "RMS left", "right", "rows", "distance"}, "th");
  std::vector<double> worst;
  for (const auto& e : r.errors) worst.push_back(std::max(e.left_rms, e.right_rms));
  std::vector<double> sorted = worst;
  std::sort(sorted.begin(), sorted.end());
  for (size_t v = 0; v < report.views.size(); ++v) {
    const TargetView& view = report.views[v];
    const std::vector<double> rows = calibrate::vertical_errors(r.calibration, view);
    double sum = 0;
    for (const double e : rows) sum += e * e;
    const auto seen = [&](size_t count, double value) { return count == 0 ? std::string("not seen") : pixels(value); };
    std::string line =
        row({html::escape(view.name), fmt::format("{}", view.left.size()), fmt::format("{}", view.right.size()),
             seen(view.left.size(), r.errors[v].left_rms), seen(view.right.size(), r.errors[v].right_rms),
             rows.empty() ? "-" : pixels(std::sqrt(sum / static_cast<double>(rows.size()))),
             fmt::format("{:.2f} m", r.left_from_grid[v].translation().z())});
    if (worst[v] > 3 * sorted[sorted.size() / 2]) line.replace(0, 4, "<tr class=bad>");
    html += line;
  }
  return html::page("Stereo calibration", html + "</table>\n");
}

void write_calibration_report(const std::filesystem::path& path, const CalibrationReport& report) {
  write_file(path, calibration_report_html(report));
}

}  // namespace iris::exporters
