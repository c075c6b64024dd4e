#include "export/evaluation_plots.h"

#include <algorithm>

#include "export/plot_file.h"

namespace iris::exporters {
namespace fs = std::filesystem;
namespace {

using evaluate::StampedPose;
using evaluate::Trajectory;
using evaluate::TrajectoryErrors;

constexpr double kDegrees = 180 / M_PI;

// A plot twice: PNG and SVG.
void write_both(const fs::path& folder, const std::string& name, const Plot& plot) {
  write_plot(folder / (name + ".png"), plot);
  write_plot(folder / (name + ".svg"), plot);
}

}  // namespace

void plot_trajectory(const fs::path& folder, const TrajectoryErrors& errors, const Trajectory& truth, int forward,
                     bool has_time) {
  PlotSeries true_path{.name = "truth", .colour = kGrey, .style = PlotSeries::Style::dashed};
  PlotSeries path{.name = "estimate", .colour = kVermillion};
  PlotSeries start{.name = "start", .colour = kGreen, .style = PlotSeries::Style::points};
  PlotSeries translation{.name = "", .colour = kVermillion}, rotation{.name = "", .colour = kBlue};
  const int64_t first = errors.pairs.front().stamp_ns, last = errors.pairs.back().stamp_ns;
  for (const StampedPose& pose : truth) {
    if (pose.stamp_ns < first || pose.stamp_ns > last) continue;
    true_path.points.emplace_back(pose.world_from_cam.translation()(0), pose.world_from_cam.translation()(forward));
  }
  for (size_t i = 0; i < errors.pairs.size(); ++i) {
    const Eigen::Vector3d p = errors.alignment.apply(errors.pairs[i].estimate).translation();
    path.points.emplace_back(p(0), p(forward));
    const double t = static_cast<double>(errors.pairs[i].stamp_ns - first) * 1e-9;
    translation.points.emplace_back(t, 1000 * errors.translations[i]);
    rotation.points.emplace_back(t, kDegrees * errors.rotations[i]);
  }
  start.points.push_back(path.points.front());
  write_both(folder, "trajectory_path",
             {.title = "Path from above, in the world of the truth",
              .x_label = "x [m]",
              .y_label = forward == 1 ? "y [m]" : "z [m]",
              .series = {true_path, path, start},
              .equal_axes = true});
  const std::string time = has_time ? "time [s]" : "frame";
  write_both(folder, "trajectory_translation_error",
             {.title = "Error of the position after alignment",
              .x_label = time,
              .y_label = "error [mm]",
              .series = {translation},
              .y_from_zero = true});
  write_both(folder, "trajectory_rotation_error",
             {.title = "Error of the rotation after alignment",
              .x_label = time,
              .y_label = "error [deg]",
              .series = {rotation},
              .y_from_zero = true});
}

void plot_disparities(const fs::path& folder, const evaluate::DisparityScore& score) {
  PlotSeries bars{.name = "", .colour = kBlue, .style = PlotSeries::Style::bars, .bar_width = 0.09};
  const double valid = std::max<double>(1, static_cast<double>(score.all.valid));
  for (int i = 0; i < evaluate::kHistogramBins; ++i) {
    const int tenths = i - evaluate::kHistogramBins / 2;
    bars.points.emplace_back(0.1 * tenths, 100 * static_cast<double>(score.histogram[static_cast<size_t>(i)]) / valid);
  }
  write_both(folder, "disparity_histogram",
             {.title = "Errors of the disparities (the outer bars hold all that are larger)",
              .x_label = "estimate - truth [px]",
              .y_label = "share of the estimated pixels [%]",
              .series = {bars},
              .y_from_zero = true});
  PlotSeries bias{.name = "mean error", .colour = kVermillion}, rms{.name = "RMS", .colour = kBlue};
  for (int i = 0; i < evaluate::kFractionBins; ++i) {
    const evaluate::SubpixelScore& s = score.by_fraction[static_cast<size_t>(i)];
    if (s.count == 0) continue;
    bias.points.emplace_back((i + 0.5) / evaluate::kFractionBins, s.mean());
    rms.points.emplace_back((i + 0.5) / evaluate::kFractionBins, s.rms());
  }
  write_both(folder, "disparity_pixel_locking",
             {.title = "Errors up to 1 px by the fractional part of the true disparity",
              .x_label = "fractional part [px]",
              .y_label = "error [px]",
              .series = {bias, rms},
              .y_from_zero = true});
}

void plot_error_picture(const fs::path& folder, const std::string& name, const cv::Mat1f& estimate,
                        const cv::Mat1f& truth, const evaluate::DisparityOptions& options) {
  const int w = truth.cols, h = truth.rows;
  write_both(folder, name,
             {.title = "Errors of the disparity image",
              .x_label = "column [px]",
              .y_label = "row [px]",
              .image = PlotImage{.pixels = evaluate::error_picture(estimate, truth, options),
                                 .left = 0,
                                 .right = double(w),
                                 .bottom = double(h),
                                 .top = 0},
              .swatches = {{0xffffff, "right"},
                           {0xfaaa50, "1 px too near"},
                           {0x781414, "4 px or more too near"},
                           {0x78bef0, "1 px too far"},
                           {0x141e78, "4 px or more too far"},
                           {0x000000, "no estimate"},
                           {0x969696, "no truth"}},
              .equal_axes = true,
              .width = 1100,
              .height = std::clamp(100 + 800 * h / w, 300, 1400)});
}

void plot_map(const fs::path& folder, const evaluate::GridMap& estimate, const evaluate::GridMap& truth,
              const Pose& truth_from_estimate, const evaluate::MapOptions& options) {
  const double width = truth.cells.cols * truth.resolution, height = truth.cells.rows * truth.resolution;
  write_both(folder, "map_errors",
             {.title = "Map against the true plan",
              .x_label = "x [m]",
              .y_label = "y [m]",
              .image = PlotImage{.pixels = evaluate::map_picture(estimate, truth, truth_from_estimate, options),
                                 .left = truth.origin_x,
                                 .right = truth.origin_x + width,
                                 .bottom = truth.origin_y,
                                 .top = truth.origin_y + height},
              .swatches = {{0x00783c, "found"},
                           {0xf09600, "missing"},
                           {0xd21e28, "false"},
                           {0x969696, "not judged"},
                           {0xffffff, "free in the map"},
                           {0xe1e1e1, "free in the plan only"},
                           {0xb4bec8, "unknown"}},
              .equal_axes = true,
              .width = 1100,
              .height = 850});
}

}  // namespace iris::exporters
