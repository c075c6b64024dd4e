#include "export/evaluation.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <set>
#include <utility>

#include "export/plot_file.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/evaluate/images.h"
#include "iris/pipeline/frames.h"
#include "iris/session/image_file.h"
#include "iris/workspace/workspace.h"

namespace iris::exporters {
namespace fs = std::filesystem;
namespace {

using evaluate::StampedPose;
using evaluate::Trajectory;
using evaluate::TrajectoryErrors;

constexpr double kDegrees = 180 / M_PI;
constexpr const char* kGiveTruth = "give a session that holds truth/, its truth folder, or a file of truth";

// --- reading
// ----------------------------------------------------------------------------------------------------------

void require_file(const fs::path& path) {
  if (!fs::exists(path)) throw InputError(path, "there is no such file", "check the name");
}

std::string size_text(cv::Size size) { return fmt::format("{} x {} px", size.width, size.height); }

void require_size(const fs::path& path, cv::Size size, cv::Size expected, const std::string& other) {
  if (size == expected) return;
  throw InputError(path, fmt::format("is {}, but {} is {}", size_text(size), other, size_text(expected)),
                   "give truth and result of the same images");
}

// Portable float map with one channel; rows from the bottom up. The sign of its scale is the byte order, its value has
// no meaning for disparities.
cv::Mat1f read_pfm(const fs::path& path) {
  const std::string bytes = read_file(path);
  int width = 0, height = 0, header = 0;
  double scale = 0;
  if (std::sscanf(bytes.c_str(), "Pf %d %d %lf%n", &width, &height, &scale, &header) != 3 || width < 1 || height < 1 ||
      width > 100000 || height > 100000 || scale == 0) {
    throw InputError(path, "is no PFM file with one channel", "give a PFM file that begins with 'Pf'");
  }
  const size_t start = static_cast<size_t>(header) + 1, row_bytes = static_cast<size_t>(width) * sizeof(float);
  if (bytes.size() < start + row_bytes * static_cast<size_t>(height)) {
    throw InputError(path, "is cut off", "copy the file again");
  }
  cv::Mat1f image(height, width);
  for (int y = 0; y < height; ++y) {
    float* row = image[height - 1 - y];
    std::memcpy(row, bytes.data() + start + static_cast<size_t>(y) * row_bytes, row_bytes);
    if (scale > 0) {
      for (int x = 0; x < width; ++x) {
        uint32_t bits = 0;
        std::memcpy(&bits, row + x, sizeof bits);
        bits = __builtin_bswap32(bits);
        std::memcpy(row + x, &bits, sizeof bits);
      }
    }
  }
  return image;
}

// Disparities [px], 0 = unknown. `scale`: grey levels a pixel, 0 = 256 for 16-bit images.
cv::Mat1f read_disparity(const fs::path& path, double scale) {
  require_file(path);
  cv::Mat1f disparity;
  if (path.extension() == ".pfm" || path.extension() == ".PFM") {
    disparity = read_pfm(path);
  } else {
    const cv::Mat image = session::read_image(path);
    if (image.channels() != 1) {
      throw InputError(path, "is a colour image",
                       "give disparities as grey values: 16-bit PNG (x 256), 8-bit PGM or PFM");
    }
    if (scale == 0 && image.depth() == CV_8U) {
      throw InputError(path, "has 8 bits a pixel, and nothing says how many grey levels are a pixel of disparity",
                       "give --truth-scale (Middlebury: 16 for Tsukuba, 4 for Cones and Teddy)");
    }
    image.convertTo(disparity, CV_32F, 1 / (scale > 0 ? scale : 256));
  }
  for (float& d : disparity) {
    if (!std::isfinite(d) || d < 0) d = 0;
  }
  return disparity;
}

// Empty if there is no such file.
cv::Mat1b read_mask(const fs::path& path, cv::Size size) {
  if (!fs::exists(path)) return {};
  cv::Mat image = session::read_image(path);
  require_size(path, image.size(), size, "the disparity image");
  if (image.channels() != 1 || image.depth() != CV_8U) {
    throw InputError(path, "is no mask", "give an 8-bit grey image with 255 where it is set");
  }
  return image;
}

Trajectory indexed(const std::vector<std::optional<Pose>>& poses, const std::function<int64_t(size_t)>& stamp_of) {
  Trajectory trajectory;
  for (size_t i = 0; i < poses.size(); ++i) {
    if (poses[i]) trajectory.push_back({stamp_of(i), *poses[i]});
  }
  return trajectory;
}

std::string range_text(const Trajectory& trajectory) {
  return fmt::format("{:.3f} … {:.3f} s", static_cast<double>(trajectory.front().stamp_ns) * 1e-9,
                     static_cast<double>(trajectory.back().stamp_ns) * 1e-9);
}

void require_common_time(const fs::path& estimate_path, const Trajectory& estimate, const fs::path& truth_path,
                         const Trajectory& truth) {
  const size_t pairs = evaluate::associate(estimate, truth).size();
  if (pairs >= 2) return;
  throw InputError(truth_path,
                   fmt::format("has the true pose of {} of the {} poses only: it covers {}, the poses of {} cover {}",
                               pairs, estimate.size(), range_text(truth), estimate_path.string(), range_text(estimate)),
                   "give the truth of the session that was reconstructed");
}

evaluate::GridMap read_map(const fs::path& path, bool plan) {
  require_file(path);
  const evaluate::RosMapHeader header = evaluate::parse_ros_map(read_file(path), path);
  const fs::path image_path = path.parent_path() / header.image;
  require_file(image_path);
  const cv::Mat image = session::read_image(image_path);
  if (image.channels() != 1 || image.depth() != CV_8U) {
    throw InputError(image_path, "is no 8-bit grey image", "give a map in ROS's trinary mode");
  }
  return evaluate::grid_map(image, header, plan);
}

// --- trajectories
// -----------------------------------------------------------------------------------------------------

void add_spread(FigureTable& table, const std::string& what, const std::string& unit, double factor,
                const evaluate::Spread& spread) {
  if (spread.count == 0) return;
  table.rows.push_back({what, unit, factor * spread.rmse, factor * spread.mean, factor * spread.median,
                        factor * spread.max, static_cast<double>(spread.count)});
}

FigureSection trajectory_section(const TrajectoryErrors& errors, const evaluate::TrajectoryOptions& options,
                                 bool has_time) {
  FigureSection section{.name = "trajectory", .title = "Trajectory"};
  section.notes.push_back(fmt::format("positions aligned by {} (Umeyama); {} poses compared, {} without truth",
                                      options.with_scale ? "turn, shift and scale" : "turn and shift",
                                      errors.pairs.size(), errors.unmatched));
  if (errors.rotation_from_orientations) {
    section.notes.push_back(
        "the path is nearly a line or hardly longer than its errors: its turn is taken from the orientations");
  }
  if (!has_time) section.notes.push_back("KITTI poses carry no times: compared by line");
  auto& f = section.figures;
  f.push_back({"poses", "poses compared", static_cast<double>(errors.pairs.size()), ""});
  f.push_back({"poses_without_truth", "poses without truth", static_cast<double>(errors.unmatched), ""});
  f.push_back({"true_path", "length of the true path", errors.true_path, "m"});
  f.push_back({"estimated_path", "length of the estimated path", errors.estimated_path, "m"});
  if (has_time) f.push_back({"duration", "duration", errors.duration, "s"});
  f.push_back({"ate_rmse", "absolute error of the position (ATE), RMS", errors.absolute.translation.rmse, "m"});
  f.push_back(
      {"ate_rotation_rmse", "absolute error of the rotation, RMS", errors.absolute.rotation.rmse * kDegrees, "deg"});
  f.push_back({"scale_error", "estimated lengths are too long by", 100 * errors.scale_error, "%"});
  f.push_back({"camera_rotation", "constant turn between true and estimated camera (taken out)",
               rotation_angle(errors.estimate_from_truth_cam) * kDegrees, "deg"});
  f.push_back({"closing_translation", "first to last view: translation error", errors.closing_translation, "m"});
  f.push_back({"closing_translation_percent", "first to last view: of the path",
               errors.true_path > 0 ? 100 * errors.closing_translation / errors.true_path : 0, "%"});
  f.push_back({"closing_rotation", "first to last view: rotation error", errors.closing_rotation * kDegrees, "deg"});
  f.push_back({"closing_gap", "first to last view: true distance", errors.true_gap, "m"});
  if (errors.mean_drift.segments > 0) {
    f.push_back({"drift_translation", "drift over segments, translation", 100 * errors.mean_drift.translation, "%"});
    f.push_back({"drift_rotation", "drift over segments, rotation", errors.mean_drift.rotation * kDegrees, "deg/m"});
  }

  FigureTable table{.name = "errors",
                    .title = "Absolute and relative errors",
                    .columns = {{"measure", "", 0},
                                {"unit", "", 0},
                                {"rmse", "RMS", 3},
                                {"mean", "mean", 3},
                                {"median", "median", 3},
                                {"max", "max", 3},
                                {"count", "count", 0}}};
  add_spread(table, "position after alignment", "mm", 1000, errors.absolute.translation);
  add_spread(table, "rotation after alignment", "deg", kDegrees, errors.absolute.rotation);
  const auto relative = [&](const std::string& over, const evaluate::MotionError& error) {
    add_spread(table, "motion over " + over + ", translation", "mm", 1000, error.translation);
    add_spread(table, "motion over " + over + ", rotation", "deg", kDegrees, error.rotation);
  };
  relative("1 frame", errors.per_frame);
  if (has_time) relative("1 s", errors.per_second);
  relative("1 m of path", errors.per_metre);
  section.tables.push_back(std::move(table));

  FigureTable drift{.name = "drift",
                    .title = errors.true_path >= 200
                                 ? "Drift over segments of the path (KITTI's lengths)"
                                 : "Drift over segments of the path (lengths scaled to a short path)",
                    .columns = {{"length_m", "length m", 2},
                                {"segments", "segments", 0},
                                {"translation_percent", "translation %", 3},
                                {"rotation_deg_per_m", "rotation deg/m", 4}}};
  for (const evaluate::SegmentDrift& d : errors.drift) {
    drift.rows.push_back({d.length, static_cast<double>(d.segments), 100 * d.translation, d.rotation * kDegrees});
  }
  section.tables.push_back(std::move(drift));
  return section;
}

void add_consistency(FigureSection& section, const evaluate::Consistency& c) {
  if (c.edges == 0) {
    section.notes.push_back("no motion with truth on both sides: its covariances cannot be judged");
    return;
  }
  section.notes.push_back("NEES: errors of the truth count as errors of the motion");
  auto& f = section.figures;
  f.push_back({"nees_edges", "motions whose stated covariance is judged (NEES)", static_cast<double>(c.edges), ""});
  f.push_back({"nees_skipped", "motions left out", static_cast<double>(c.skipped), ""});
  f.push_back({"nees_mean", "NEES, mean (6 if the covariances are right)", c.mean, "1"});
  f.push_back({"nees_median", "NEES, median (5.35 expected)", c.median, "1"});
  f.push_back({"nees_mean_low", "95 % band of the mean: from", c.mean_low, "1"});
  f.push_back({"nees_mean_high", "95 % band of the mean: to", c.mean_high, "1"});
  f.push_back({"nees_share_within", "motions within their 95 % band", 100 * c.share_within, "%"});
  f.push_back({"nees_share_above", "motions above it (2.5 % expected)", 100 * c.share_above, "%"});
  f.push_back({"nees_translation_mean", "NEES of the translation, mean (3 expected)", c.translation_mean, "1"});
  f.push_back({"nees_rotation_mean", "NEES of the rotation, mean (3 expected)", c.rotation_mean, "1"});
  f.push_back({"translation_factor", "true errors / stated deviations, translation", c.translation_factor, "1"});
  f.push_back({"rotation_factor", "true errors / stated deviations, rotation", c.rotation_factor, "1"});
}

// A plot twice: PNG and SVG.
void write_both(const fs::path& folder, const std::string& name, const Plot& plot) {
  write_plot(folder / (name + ".png"), plot);
  write_plot(folder / (name + ".svg"), plot);
}

// `forward`: index of the axis that is drawn upwards (1 in a z-up world, 2 in a camera's).
void plot_trajectory(const fs::path& folder, const TrajectoryErrors& errors, const Trajectory& truth, int forward,
                     bool has_time) {
  PlotSeries true_path{.name = "truth", .colour = kPlotGrey, .style = PlotSeries::Style::dashed};
  PlotSeries path{.name = "estimate", .colour = kPlotVermillion};
  PlotSeries start{.name = "start", .colour = kPlotGreen, .style = PlotSeries::Style::points};
  PlotSeries translation{.name = "", .colour = kPlotVermillion}, rotation{.name = "", .colour = kPlotBlue};
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

// --- disparities
// ------------------------------------------------------------------------------------------------------

FigureSection disparity_section(const evaluate::DisparityScore& score, const evaluate::DisparityOptions& options) {
  constexpr size_t kOnePixel = 1;  // in kBadThresholds
  FigureSection section{.name = "disparities", .title = "Disparities"};
  section.notes.push_back(fmt::format("{} image{} against truth{}; 'wrong' = off by more than the threshold",
                                      score.images, score.images == 1 ? "" : "s",
                                      options.round ? ", rounded to whole pixels" : ""));
  auto& f = section.figures;
  f.push_back({"images", "images", static_cast<double>(score.images), ""});
  f.push_back({"known", "pixels with truth", static_cast<double>(score.all.known), ""});
  f.push_back({"density", "of them with an estimate", score.all.density(), "%"});
  f.push_back({"wrong_1px", "wrong by more than 1 px", score.all.wrong(kOnePixel), "%"});
  f.push_back(
      {"wrong_or_missing_1px", "wrong by more than 1 px or missing", score.all.wrong_or_missing(kOnePixel), "%"});
  const auto percent = [&](int64_t n) {
    return score.all.known > 0 ? 100.0 * static_cast<double>(n) / static_cast<double>(score.all.known) : 0.0;
  };
  f.push_back({"correct", "correct (thesis table 3.1)", percent(score.all.valid - score.all.bad[kOnePixel]), "%"});
  f.push_back({"invalid", "invalid", percent(score.all.known - score.all.valid), "%"});
  f.push_back({"border_errors", "errors at borders", percent(score.at_borders.bad[kOnePixel]), "%"});
  f.push_back({"other_errors", "other errors", percent(score.elsewhere.bad[kOnePixel]), "%"});
  f.push_back({"outliers_kitti", "off by more than 3 px and 5 %", percent(score.all.outliers_kitti), "%"});
  f.push_back({"subpixel_rms", "RMS of the errors up to 1 px", score.subpixel.rms(), "px"});
  f.push_back({"subpixel_mean_absolute", "mean size of the errors up to 1 px", score.subpixel.absolute(), "px"});
  f.push_back({"subpixel_bias", "mean of the errors up to 1 px (+ = too near)", score.subpixel.mean(), "px"});

  FigureTable regions{.name = "regions",
                      .title = "Wrong pixels [% of those with truth], without and with the missing ones",
                      .columns = {{"region", "", 0}, {"known", "pixels", 0}, {"density", "density", 2}}};
  for (const double threshold : evaluate::kBadThresholds) {
    regions.columns.push_back({fmt::format("wrong_{:g}px", threshold), fmt::format(">{:g} px", threshold), 2});
  }
  for (const double threshold : evaluate::kBadThresholds) {
    regions.columns.push_back(
        {fmt::format("wrong_or_missing_{:g}px", threshold), fmt::format("or none {:g}", threshold), 2});
  }
  const auto add_region = [&](const std::string& name, const evaluate::RegionScore& region) {
    std::vector<std::variant<std::string, double>> row = {name, static_cast<double>(region.known), region.density()};
    for (size_t i = 0; i < evaluate::kBadThresholds.size(); ++i) row.emplace_back(region.wrong(i));
    for (size_t i = 0; i < evaluate::kBadThresholds.size(); ++i) row.emplace_back(region.wrong_or_missing(i));
    regions.rows.push_back(std::move(row));
  };
  add_region("all", score.all);
  if (score.has_occlusion) {
    add_region("seen by both cameras", score.visible);
    add_region("occluded", score.occluded);
  }
  add_region("near borders", score.at_borders);
  add_region("elsewhere", score.elsewhere);
  section.tables.push_back(std::move(regions));

  FigureTable borders{
      .name = "borders",
      .title = fmt::format("Errors above 1 px within {} px of object borders [% of all pixels with truth] "
                           "(thesis table 3.2)",
                           options.border_distance),
      .columns = {{"border", "border", 0},
                  {"wrong_object", "wrong object", 3},
                  {"wrong_background", "wrong background", 3},
                  {"possible", "possible", 3},
                  {"fraction", "fraction", 3}}};
  constexpr const char* kBorderNames[] = {"left", "right", "top", "bottom"};
  for (size_t i = 0; i < score.borders.size(); ++i) {
    const evaluate::BorderScore& b = score.borders[i];
    const double fraction =
        b.possible > 0 ? static_cast<double>(b.wrong_object + b.wrong_background) / static_cast<double>(b.possible) : 0;
    borders.rows.push_back({std::string(kBorderNames[i]), percent(b.wrong_object), percent(b.wrong_background),
                            percent(b.possible), fraction});
  }
  section.tables.push_back(std::move(borders));

  FigureTable origins{.name = "subpixel",
                      .title = "Sub-pixel error (errors up to 1 px) by origin [px]",
                      .columns = {{"origin", "origin", 0},
                                  {"valid", "valid", 0},
                                  {"within", "up to 1 px", 0},
                                  {"wrong_percent", "wrong %", 2},
                                  {"rms", "RMS", 3},
                                  {"mean_absolute", "mean size", 3},
                                  {"bias", "bias", 3}}};
  const auto add_origin = [&](const std::string& name, const evaluate::SubpixelScore& s) {
    if (s.valid == 0) return;
    const double wrong = 100.0 * static_cast<double>(s.valid - s.count) / static_cast<double>(s.valid);
    origins.rows.push_back(
        {name, static_cast<double>(s.valid), static_cast<double>(s.count), wrong, s.rms(), s.absolute(), s.mean()});
  };
  add_origin("all", score.subpixel);
  constexpr const char* kOrigins[] = {"none", "measured", "corrected", "within segments", "between segments"};
  for (size_t i = 0; i < score.by_origin.size(); ++i) add_origin(kOrigins[i], score.by_origin[i]);
  section.tables.push_back(std::move(origins));

  FigureTable locking{
      .name = "pixel_locking",
      .title = std::string("Error by the fractional part of the true disparity (pixel locking) [px]") +
               (score.has_origin ? ", measured pixels" : ""),
      .columns = {
          {"from", "from", 1}, {"to", "to", 1}, {"pixels", "pixels", 0}, {"bias", "bias", 4}, {"rms", "RMS", 4}}};
  for (int i = 0; i < evaluate::kFractionBins; ++i) {
    const evaluate::SubpixelScore& s = score.by_fraction[static_cast<size_t>(i)];
    if (s.count == 0) continue;
    locking.rows.push_back({static_cast<double>(i) / evaluate::kFractionBins,
                            static_cast<double>(i + 1) / evaluate::kFractionBins, static_cast<double>(s.count),
                            s.mean(), s.rms()});
  }
  section.tables.push_back(std::move(locking));
  return section;
}

void plot_disparities(const fs::path& folder, const evaluate::DisparityScore& score) {
  PlotSeries bars{.name = "", .colour = kPlotBlue, .style = PlotSeries::Style::bars, .bar_width = 0.09};
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
  PlotSeries bias{.name = "mean error", .colour = kPlotVermillion}, rms{.name = "RMS", .colour = kPlotBlue};
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

struct DisparityPair {
  DisparityImage estimate;
  cv::Mat1f truth;
  fs::path truth_path;
};

evaluate::DisparityScore score_pair(const DisparityPair& pair, const std::string& estimate_name,
                                    const evaluate::DisparityOptions& options) {
  require_size(pair.truth_path, pair.truth.size(), pair.estimate.disparity.size(), estimate_name);
  const fs::path truth_folder = pair.truth_path.parent_path().parent_path(), file = pair.truth_path.filename();
  const bool in_folder = pair.truth_path.parent_path().filename() == "disparity";
  const auto mask = [&](const char* name) {
    return in_folder ? read_mask(truth_folder / name / file, pair.truth.size()) : cv::Mat1b();
  };
  return evaluate::score_disparities(pair.estimate, pair.truth, mask("occlusion"), mask("discontinuity"), options);
}

// --- map and images
// ---------------------------------------------------------------------------------------------------

FigureSection map_section(const evaluate::MapErrors& errors, const evaluate::GridMap& truth,
                          const evaluate::MapOptions& options) {
  FigureSection section{.name = "map", .title = "Map"};
  section.notes.push_back(fmt::format("cells match within {} cell{} of the true plan ({:g} m each) in each direction",
                                      options.tolerance, options.tolerance == 1 ? "" : "s", truth.resolution));
  section.notes.push_back("surfaces without texture or that no camera saw count neither as missing nor as false");
  auto& f = section.figures;
  const auto count = [](int64_t n) { return static_cast<double>(n); };
  f.push_back({"occupied_precision", "occupied cells that are right (precision)", errors.occupied_precision(), "%"});
  f.push_back({"occupied_recall", "seen, textured surfaces that are found (recall)", errors.occupied_recall(), "%"});
  f.push_back({"free_precision", "free cells that are right (precision)", errors.free_precision(), "%"});
  f.push_back({"free_recall", "free cells that are found (recall)", errors.free_recall(), "%"});
  f.push_back({"occupied", "occupied cells of the map", count(errors.occupied), ""});
  f.push_back(
      {"occupied_not_judged", "of them at surfaces that are not judged", count(errors.occupied_not_judged), ""});
  f.push_back({"occupied_outside", "of them outside of the plan (wrong)", count(errors.occupied_outside), ""});
  f.push_back({"true_occupied", "seen, textured cells of the plan", count(errors.true_occupied), ""});
  f.push_back({"free", "free cells of the map", count(errors.free), ""});
  f.push_back({"free_wrong", "of them holes in true surfaces", count(errors.free_wrong), ""});
  f.push_back({"true_free", "free cells of the plan", count(errors.true_free), ""});
  f.push_back({"distance_median", "occupied cells to the nearest true one, median", errors.distance_median, "m"});
  f.push_back({"distance_mean", "occupied cells to the nearest true one, mean", errors.distance_mean, "m"});
  f.push_back({"distance_rms", "occupied cells to the nearest true one, RMS", errors.distance_rms, "m"});
  return section;
}

FigureSection evaluate_map_files(const EvaluationRequest& request, const fs::path& estimate_path,
                                 const fs::path& truth_path, const Pose& truth_from_estimate) {
  const evaluate::GridMap estimate = read_map(estimate_path, false), truth = read_map(truth_path, true);
  const evaluate::MapErrors errors = evaluate::evaluate_map(estimate, truth, truth_from_estimate, request.map);
  if (!request.plots.empty()) {
    const double width = truth.cells.cols * truth.resolution, height = truth.cells.rows * truth.resolution;
    write_both(request.plots, "map_errors",
               {.title = "Map against the true plan",
                .x_label = "x [m]",
                .y_label = "y [m]",
                .image = PlotImage{.pixels = evaluate::map_picture(estimate, truth, truth_from_estimate, request.map),
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
  return map_section(errors, truth, request.map);
}

FigureSection evaluate_images(const EvaluationRequest& request) {
  require_file(request.estimate);
  require_file(request.truth);
  cv::Mat estimate = session::read_image(request.estimate), truth = session::read_image(request.truth);
  require_size(request.truth, truth.size(), estimate.size(), request.estimate.string());
  for (const auto& [path, image] : {std::pair(request.estimate, estimate), std::pair(request.truth, truth)}) {
    if (image.depth() != CV_8U) throw InputError(path, "has 16 bits a value", "convert it to an 8-bit image");
  }
  cv::Mat1b mask;
  if (request.mask == "black") {
    std::vector<cv::Mat1b> channels;
    cv::split(estimate, channels);
    mask = channels[0];
    for (const cv::Mat1b& channel : channels) mask = mask | channel;
  } else if (!request.mask.empty()) {
    require_file(request.mask);
    mask = read_mask(request.mask, estimate.size());
  }
  if (estimate.channels() != truth.channels()) {
    if (estimate.channels() == 3) cv::cvtColor(estimate, estimate, cv::COLOR_BGR2GRAY);
    if (truth.channels() == 3) cv::cvtColor(truth, truth, cv::COLOR_BGR2GRAY);
  }
  const evaluate::ImageErrors errors = evaluate::compare_images(estimate, truth, mask);
  if (errors.pixels == 0) throw InputError(request.estimate, "the mask leaves no pixel", "give another --mask");
  FigureSection section{.name = "image", .title = "Image"};
  section.notes.push_back(
      fmt::format("{} compared in {}; SSIM on grey values, Gaussian window 11 x 11 px of deviation "
                  "1.5 px, K1 0.01, K2 0.03",
                  size_text(truth.size()), truth.channels() == 3 ? "colour" : "grey"));
  section.figures = {{"pixels", "pixels compared", static_cast<double>(errors.pixels), ""},
                     {"coverage", "coverage", errors.coverage, "%"},
                     {"psnr", "PSNR", errors.psnr, "dB"},
                     {"ssim", "SSIM", errors.ssim, "1"},
                     {"rmse", "RMS difference", std::sqrt(errors.mse), "grey"}};
  return section;
}

// --- what is asked for
// ------------------------------------------------------------------------------------------------

// The output of a run.
class OutputFolder {
 public:
  OutputFolder(const EvaluationRequest& request, Evaluation& evaluation)
      : request_(request),
        evaluation_(evaluation),
        workspace_(workspace::Workspace::open(request.estimate, workspace::Workspace::Access::read_only)) {
    workspace_.for_each_frame(
        [&](const workspace::FrameRecord& record) { stamps_[record.frame_idx] = record.stamp_ns; });
  }

  // False if no sub-map has two poses.
  bool evaluate_trajectories(const fs::path& truth_path) {
    const std::string text = read_file(truth_path);
    const bool kitti = evaluate::is_kitti(text);
    truth_ = kitti ? kitti_truth(evaluate::parse_kitti(text, truth_path)) : evaluate::parse_tum(text, truth_path);
    const std::vector<SubMap> submaps = read_submaps();
    const SubMap& main = submaps.front();
    if (main.poses.size() < 2) {
      evaluation_.sections.push_back(
          {.name = "trajectory",
           .title = "Trajectory",
           .notes = {"no sub-map has two poses: neither path nor map can be compared; 'iris info OUT' says why"},
           .figures = {{"submap_count", "sub-maps", static_cast<double>(submaps.size()), ""}},
           .tables = {}});
      return false;
    }
    require_common_time(main.path, main.poses, truth_path, truth_);
    const TrajectoryErrors errors = evaluate::evaluate_trajectory(main.poses, truth_, request_.trajectory);
    bool ignored = false;
    truth_from_estimate_ = evaluate::align_worlds(errors.pairs, false, ignored).truth_from_estimate;

    FigureSection section = trajectory_section(errors, request_.trajectory, true);
    section.notes.insert(section.notes.begin(), fmt::format("{} against {}", main.path.string(), truth_path.string()));
    add_edges(section, submaps, errors);
    if (submaps.size() > 1) add_submaps(section, submaps);
    evaluation_.sections.push_back(std::move(section));
    if (!request_.plots.empty()) plot_trajectory(request_.plots, errors, truth_, kitti ? 2 : 1, true);
    return true;
  }

  void evaluate_disparities(const fs::path& folder) {
    const auto views = workspace_.views(pipeline::world_from_submap(), -1, 0);
    const int n = static_cast<int>(views->summaries().size());
    std::vector<int> frames_with_truth;
    evaluate::DisparityScore score;
    std::vector<int> indices;
    for (int i = 0; i < n; ++i) {
      if (fs::exists(truth_file(folder, views->summaries()[static_cast<size_t>(i)].frame_idx))) indices.push_back(i);
    }
    if (indices.empty()) {
      throw InputError(
          folder, fmt::format("has no disparity image of any of the {} views of {}", n, request_.estimate.string()),
          "give the truth of the session that was reconstructed");
    }
    std::vector<int> shown = request_.views;
    if (shown.empty()) {
      for (const size_t i : {size_t{0}, indices.size() / 2, indices.size() - 1}) {
        shown.push_back(views->summaries()[static_cast<size_t>(indices[i])].frame_idx);
      }
    }
    const auto pair_of = [&](int index) {
      const auto view = views->load(index);
      DisparityPair pair{.estimate = view->disparity, .truth_path = truth_file(folder, view->frame_idx)};
      pair.truth = read_disparity(pair.truth_path, request_.truth_scale);
      return pair;
    };
    std::vector<evaluate::DisparityScore> scores(indices.size());
    parallel_chunks(0, static_cast<int>(indices.size()), 1, [&](int i, int) {
      const int index = indices[static_cast<size_t>(i)];
      const int frame_idx = views->summaries()[static_cast<size_t>(index)].frame_idx;
      scores[static_cast<size_t>(i)] = score_pair(
          pair_of(index), fmt::format("view {:06} of {}", frame_idx, request_.estimate.string()), request_.disparity);
    });
    for (const evaluate::DisparityScore& one : scores) score.add(one);
    for (const int index : indices) {
      const int frame_idx = views->summaries()[static_cast<size_t>(index)].frame_idx;
      frames_with_truth.push_back(frame_idx);
      if (request_.plots.empty() || std::find(shown.begin(), shown.end(), frame_idx) == shown.end()) continue;
      const DisparityPair pair = pair_of(index);
      plot_error_picture(request_.plots, fmt::format("disparity_error_{:06}", frame_idx), pair.estimate.disparity,
                         pair.truth, request_.disparity);
    }
    for (const int frame : request_.views) {
      if (std::find(frames_with_truth.begin(), frames_with_truth.end(), frame) == frames_with_truth.end()) {
        throw InputError(request_.estimate, fmt::format("frame {} has no stored view with truth", frame),
                         "choose another --view; OUT/views names those that are stored");
      }
    }
    FigureSection section = disparity_section(score, request_.disparity);
    if (static_cast<int>(indices.size()) < n) {
      section.notes.push_back(fmt::format("{} of the {} stored views have no truth", n - score.images, n));
    }
    evaluation_.sections.push_back(std::move(section));
    if (!request_.plots.empty()) plot_disparities(request_.plots, score);
  }

  void evaluate_map(const fs::path& plan) {
    const fs::path map = request_.estimate / "map" / "map.yaml";
    if (!fs::exists(map)) return;
    evaluation_.sections.push_back(evaluate_map_files(request_, map, plan, truth_from_estimate_));
  }

 private:
  struct SubMap {
    fs::path path;
    Trajectory poses;
  };

  static fs::path truth_file(const fs::path& folder, int frame_idx) {
    return folder / fmt::format("{:06}.png", frame_idx);
  }

  Trajectory kitti_truth(const std::vector<std::optional<Pose>>& poses) const {
    Trajectory truth;
    for (const auto& [frame_idx, stamp] : stamps_) {
      const auto i = static_cast<size_t>(frame_idx);
      if (i < poses.size() && poses[i]) truth.push_back({stamp, *poses[i]});
    }
    if (truth.empty()) throw InputError(request_.truth, "has no pose of any frame", kGiveTruth);
    return truth;
  }

  // The main one first, then by their numbers of poses.
  std::vector<SubMap> read_submaps() const {
    const fs::path folder = request_.estimate / "trajectory", main = folder / "tum.txt";
    if (!fs::exists(main)) {
      throw InputError(main, "there is no such file",
                       "finish the run: 'iris run SESSION -o OUT' goes on where it stopped");
    }
    std::vector<SubMap> submaps = {{main, evaluate::parse_tum(read_file(main), main)}};
    std::vector<fs::path> others;
    for (const auto& entry : fs::directory_iterator(folder)) {
      if (entry.path().filename().string().starts_with("tum_submap")) others.push_back(entry.path());
    }
    std::sort(others.begin(), others.end());
    for (const fs::path& path : others) submaps.push_back({path, evaluate::parse_tum(read_file(path), path)});
    std::stable_sort(submaps.begin() + 1, submaps.end(),
                     [](const SubMap& a, const SubMap& b) { return a.poses.size() > b.poses.size(); });
    return submaps;
  }

  void add_edges(FigureSection& section, const std::vector<SubMap>& submaps, const TrajectoryErrors& errors) const {
    const fs::path path = request_.estimate / "trajectory" / "graph.g2o";
    if (!fs::exists(path)) {
      section.notes.push_back(path.string() + " is missing: the stated covariances are not judged");
      return;
    }
    std::map<int64_t, Pose> true_poses;
    for (const SubMap& submap : submaps) {
      for (const evaluate::PosePair& pair : evaluate::associate(submap.poses, truth_)) {
        Pose pose = pair.truth;
        pose.linear() = pair.truth.linear() * errors.estimate_from_truth_cam.transpose();
        true_poses[pair.stamp_ns] = pose;
      }
    }
    // The file does not tell measured motions from loops.
    std::set<std::pair<int, int>> odometry;
    for (const PoseEdge& edge : workspace_.pose_graph(pipeline::world_from_submap()).edges) {
      if (edge.kind == PoseEdgeKind::odometry) odometry.emplace(edge.i, edge.j);
    }
    std::vector<evaluate::MotionEdge> motions, loops;
    for (const evaluate::GraphEdge& edge : evaluate::parse_g2o_edges(read_file(path), path)) {
      if (!stamps_.contains(edge.i) || !stamps_.contains(edge.j)) {
        throw InputError(path,
                         fmt::format("has an edge between frames {} and {} that the run does not have", edge.i, edge.j),
                         "'iris export OUT --only trajectory' writes it again");
      }
      (odometry.contains({edge.i, edge.j}) ? motions : loops)
          .push_back({stamps_.at(edge.i), stamps_.at(edge.j), edge.i_from_j, edge.information});
    }
    add_consistency(section, evaluate::evaluate_consistency(motions, true_poses));
    const evaluate::Consistency of_loops = evaluate::evaluate_consistency(loops, true_poses);
    if (of_loops.edges == 0) return;
    auto& f = section.figures;
    f.push_back({"loop_edges", "loops whose stated covariance is judged", static_cast<double>(of_loops.edges), ""});
    f.push_back({"loop_nees_mean", "NEES of the loops, mean (6 expected)", of_loops.mean, "1"});
    f.push_back({"loop_share_within", "loops within their 95 % band", 100 * of_loops.share_within, "%"});
  }

  void add_submaps(FigureSection& section, const std::vector<SubMap>& submaps) const {
    constexpr size_t kEnough = 3;
    FigureTable table{.name = "submaps",
                      .title = "Sub-maps, each aligned by itself",
                      .columns = {{"file", "file", 0},
                                  {"poses", "poses", 0},
                                  {"path_m", "path m", 3},
                                  {"ate_rmse_mm", "ATE mm", 2},
                                  {"ate_rotation_rmse_deg", "rotation deg", 3},
                                  {"drift_percent", "drift %", 3},
                                  {"closing_percent", "closing %", 3}}};
    int small = 0;
    for (const SubMap& submap : submaps) {
      if (evaluate::associate(submap.poses, truth_).size() < kEnough) {
        ++small;
        continue;
      }
      const TrajectoryErrors e = evaluate::evaluate_trajectory(submap.poses, truth_, request_.trajectory);
      table.rows.push_back({submap.path.filename().string(), static_cast<double>(e.pairs.size()), e.true_path,
                            1000 * e.absolute.translation.rmse, kDegrees * e.absolute.rotation.rmse,
                            100 * e.mean_drift.translation,
                            e.true_path > 0 ? 100 * e.closing_translation / e.true_path : 0.0});
    }
    section.figures.push_back({"submap_count", "sub-maps", static_cast<double>(submaps.size()), ""});
    if (small > 0)
      section.notes.push_back(fmt::format("{} sub-maps have fewer than {} poses with truth", small, kEnough));
    section.tables.push_back(std::move(table));
  }

  const EvaluationRequest& request_;
  Evaluation& evaluation_;
  workspace::Workspace workspace_;
  std::map<int, int64_t> stamps_;
  Trajectory truth_;
  Pose truth_from_estimate_ = Pose::Identity();
};

void evaluate_output(const EvaluationRequest& request, Evaluation& evaluation) {
  OutputFolder output(request, evaluation);
  if (!fs::is_directory(request.truth)) {
    require_file(request.truth);
    const std::string extension = request.truth.extension().string();
    if (extension != ".tum" && extension != ".txt" && extension != ".csv") {
      throw InputError(request.truth, "is no path of a camera",
                       "for maps and disparities give the session or its truth folder");
    }
    output.evaluate_trajectories(request.truth);
    return;
  }
  const fs::path folder = fs::is_directory(request.truth / "truth") ? request.truth / "truth" : request.truth;
  fs::path path = folder / "trajectory.tum";
  if (!fs::exists(path)) path = folder / "poses.txt";
  const bool has_path = fs::exists(path);
  const bool is_aligned = has_path && output.evaluate_trajectories(path);
  if (fs::is_directory(folder / "disparity")) output.evaluate_disparities(folder / "disparity");
  if (fs::exists(folder / "plan.yaml")) {
    if (!has_path) {
      throw InputError(folder, "has plan.yaml, but no trajectory.tum",
                       "the map is laid on the plan by the path: add it");
    }
    if (is_aligned) output.evaluate_map(folder / "plan.yaml");
  }
  if (evaluation.sections.empty()) {
    throw InputError(folder, "holds neither trajectory.tum, poses.txt nor disparity/", kGiveTruth);
  }
}

void evaluate_trajectory_files(const EvaluationRequest& request, Evaluation& evaluation) {
  require_file(request.estimate);
  require_file(request.truth);
  const std::string estimate_text = read_file(request.estimate), truth_text = read_file(request.truth);
  const bool kitti = evaluate::is_kitti(estimate_text);
  if (kitti != evaluate::is_kitti(truth_text)) {
    throw InputError(request.truth, "one of the two files has KITTI poses, without times, the other has times",
                     "evaluate the output folder instead, which knows the time of each frame");
  }
  constexpr auto kStampOfLine = [](size_t i) { return static_cast<int64_t>(i) * 1'000'000'000; };
  const Trajectory estimate = kitti ? indexed(evaluate::parse_kitti(estimate_text, request.estimate), kStampOfLine)
                                    : evaluate::parse_tum(estimate_text, request.estimate);
  const Trajectory truth = kitti ? indexed(evaluate::parse_kitti(truth_text, request.truth), kStampOfLine)
                                 : evaluate::parse_tum(truth_text, request.truth);
  require_common_time(request.estimate, estimate, request.truth, truth);
  const TrajectoryErrors errors = evaluate::evaluate_trajectory(estimate, truth, request.trajectory);
  evaluation.sections.push_back(trajectory_section(errors, request.trajectory, !kitti));
  if (!request.plots.empty()) plot_trajectory(request.plots, errors, truth, kitti ? 2 : 1, !kitti);
}

void evaluate_disparity_files(const EvaluationRequest& request, Evaluation& evaluation) {
  DisparityPair pair{.truth_path = request.truth};
  pair.estimate.disparity = read_disparity(request.estimate, 0);
  pair.truth = read_disparity(request.truth, request.truth_scale);
  const std::string name = request.estimate.filename().string(), ending = ".disparity.png";
  if (name.ends_with(ending)) {
    pair.estimate.origin =
        read_mask(request.estimate.parent_path() / (name.substr(0, name.size() - ending.size()) + ".origin.png"),
                  pair.estimate.disparity.size());
  }
  const evaluate::DisparityScore score = score_pair(pair, request.estimate.string(), request.disparity);
  if (score.all.known == 0)
    throw InputError(request.truth, "has no known disparity", "check --truth-scale and the file");
  evaluation.sections.push_back(disparity_section(score, request.disparity));
  if (request.plots.empty()) return;
  plot_disparities(request.plots, score);
  plot_error_picture(request.plots, "disparity_error", pair.estimate.disparity, pair.truth, request.disparity);
}

std::string kind_of(const fs::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  if (extension == ".txt" || extension == ".tum" || extension == ".csv") return "trajectory";
  if (extension == ".yaml" || extension == ".yml") return "map";
  if (extension == ".pfm") return "disparity";
  if (!session::is_image_file(path)) {
    throw InputError(path, "of this kind nothing can be evaluated",
                     "give an output folder, a trajectory (.txt, .tum, .csv), a disparity image (16-bit .png, .pfm), a "
                     "map.yaml or an image, or say --kind");
  }
  return session::read_image(path).depth() == CV_16U ? "disparity" : "image";
}

// --- text
// -------------------------------------------------------------------------------------------------------------

std::string value_text(const Figure& figure) {
  const double v = figure.value;
  if (std::isinf(v)) return "infinite";
  if (std::isnan(v)) return "-";
  if (figure.unit.empty()) return fmt::format("{:.0f}", v);
  if (figure.unit == "m") {
    return std::abs(v) < 0.1 ? fmt::format("{:.2f} mm", 1000 * v) : fmt::format("{:.3f} m", v);
  }
  if (figure.unit == "deg/m") return fmt::format("{:.4f} deg/m", v);
  if (figure.unit == "1") return fmt::format("{:.3f}", v);
  const int digits = figure.unit == "deg" || figure.unit == "px" ? 3 : 2;
  return fmt::format("{:.{}f} {}", v, digits, figure.unit);
}

std::string cell_text(const std::variant<std::string, double>& cell, int digits) {
  if (const auto* text = std::get_if<std::string>(&cell)) return *text;
  const double value = std::get<double>(cell);
  return std::isfinite(value) ? fmt::format("{:.{}f}", value, digits) : "-";
}

std::string table_text(const FigureTable& table) {
  std::vector<std::vector<std::string>> lines(1);
  for (const FigureTable::Column& column : table.columns) lines[0].push_back(column.label);
  for (const auto& row : table.rows) {
    lines.emplace_back();
    for (size_t i = 0; i < row.size(); ++i) lines.back().push_back(cell_text(row[i], table.columns[i].digits));
  }
  std::vector<size_t> widths(table.columns.size());
  for (const auto& line : lines) {
    for (size_t i = 0; i < line.size(); ++i) widths[i] = std::max(widths[i], line[i].size());
  }
  std::string text = fmt::format("\n  {}\n", table.title);
  for (const auto& line : lines) {
    std::string row = " ";
    for (size_t i = 0; i < line.size(); ++i) {
      // Words to the left, numbers to the right.
      const bool words = !table.rows.empty() && std::holds_alternative<std::string>(table.rows[0][i]);
      row += words ? fmt::format(" {:<{}} ", line[i], widths[i]) : fmt::format(" {:>{}} ", line[i], widths[i]);
    }
    row.erase(row.find_last_not_of(' ') + 1);
    text += row + "\n";
  }
  return text;
}

}  // namespace

std::string Evaluation::text() const {
  std::string text;
  for (const FigureSection& section : sections) {
    if (!text.empty()) text += "\n";
    text += section.title + "\n";
    for (const std::string& note : section.notes) text += fmt::format("  ({})\n", note);
    size_t width = 0;
    for (const Figure& figure : section.figures) width = std::max(width, figure.label.size());
    for (const Figure& figure : section.figures) {
      text += fmt::format("  {:<{}}  {:>14}\n", figure.label, width, value_text(figure));
    }
    for (const FigureTable& table : section.tables) {
      if (!table.rows.empty()) text += table_text(table);
    }
  }
  return text;
}

std::string Evaluation::json() const {
  nlohmann::ordered_json root;
  root["estimate"] = estimate;
  root["truth"] = truth;
  const auto number = [](double v) { return std::isfinite(v) ? nlohmann::ordered_json(v) : nlohmann::ordered_json(); };
  for (const FigureSection& section : sections) {
    nlohmann::ordered_json& out = root[section.name];
    out["notes"] = section.notes;
    for (const Figure& figure : section.figures) out[figure.name] = number(figure.value);
    for (const FigureTable& table : section.tables) {
      nlohmann::ordered_json rows = nlohmann::ordered_json::array();
      for (const auto& row : table.rows) {
        nlohmann::ordered_json entry;
        for (size_t i = 0; i < row.size(); ++i) {
          const auto* word = std::get_if<std::string>(&row[i]);
          entry[table.columns[i].name] = word ? nlohmann::ordered_json(*word) : number(std::get<double>(row[i]));
        }
        rows.push_back(std::move(entry));
      }
      out[table.name] = std::move(rows);
    }
  }
  return root.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

Evaluation evaluate_files(const EvaluationRequest& request) {
  Evaluation evaluation{.estimate = request.estimate.string(), .truth = request.truth.string(), .sections = {}};
  if (!fs::exists(request.estimate))
    throw InputError(request.estimate, "there is no such file or folder", "check the name");
  if (!fs::exists(request.truth)) throw InputError(request.truth, "there is no such file or folder", kGiveTruth);
  if (fs::is_directory(request.estimate)) {
    if (!fs::exists(request.estimate / "workspace.db")) {
      throw InputError(request.estimate, "is no output folder of a run",
                       "give OUT of 'iris run SESSION -o OUT', or a file");
    }
    evaluate_output(request, evaluation);
    return evaluation;
  }
  if (fs::is_directory(request.truth)) {
    throw InputError(request.truth, "is a folder, but a single file is evaluated",
                     "give the file of truth that belongs to it");
  }
  const std::string kind = request.kind == "auto" ? kind_of(request.estimate) : request.kind;
  if (kind == "trajectory") {
    evaluate_trajectory_files(request, evaluation);
  } else if (kind == "disparity") {
    evaluate_disparity_files(request, evaluation);
  } else if (kind == "map") {
    FigureSection section = evaluate_map_files(request, request.estimate, request.truth, Pose::Identity());
    section.notes.push_back("both maps are taken to be in the same world; evaluate the output folder to align them");
    evaluation.sections.push_back(std::move(section));
  } else {
    evaluation.sections.push_back(evaluate_images(request));
  }
  return evaluation;
}

}  // namespace iris::exporters
