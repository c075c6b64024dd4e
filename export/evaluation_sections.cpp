#include "export/evaluation_sections.h"

#include <fmt/format.h>

#include <cmath>
#include <limits>
#include <utility>

namespace iris::exporters {
namespace {

constexpr double kDegrees = 180 / M_PI;
constexpr size_t kOnePixel = 1;  // in evaluate::kBadThresholds

template <class Integer>
double count(Integer n) {
  return static_cast<double>(n);
}

// Part of a whole [%].
double percent(double part, double whole) {
  return whole > 0 ? 100 * part / whole : std::numeric_limits<double>::quiet_NaN();
}

void add_spread(FigureTable& table, const std::string& what, const std::string& unit, double factor,
                const evaluate::Spread& spread) {
  if (spread.count == 0) return;
  table.rows.push_back({what, unit, factor * spread.rmse, factor * spread.mean, factor * spread.median,
                        factor * spread.max, count(spread.count)});
}

FigureTable error_table(const evaluate::TrajectoryErrors& errors, bool has_time) {
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
  return table;
}

FigureTable drift_table(const evaluate::TrajectoryErrors& errors) {
  FigureTable table{.name = "drift",
                    .title = errors.true_path >= 200
                                 ? "Drift over segments of the path (KITTI's lengths)"
                                 : "Drift over segments of the path (lengths scaled to a short path)",
                    .columns = {{"length_m", "length m", 2},
                                {"segments", "segments", 0},
                                {"translation_percent", "translation %", 3},
                                {"rotation_deg_per_m", "rotation deg/m", 4}}};
  for (const evaluate::SegmentDrift& d : errors.drift) {
    table.rows.push_back({d.length, count(d.segments), 100 * d.translation, d.rotation * kDegrees});
  }
  return table;
}

void add_motions(FigureSection& section, const evaluate::Consistency& c) {
  section.notes.push_back("NEES: errors of the truth count as errors of the motion");
  auto& f = section.figures;
  f.push_back({"nees_edges", "motions whose stated covariance is judged (NEES)", count(c.edges), ""});
  f.push_back({"nees_skipped", "motions left out", count(c.skipped), ""});
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

FigureTable region_table(const evaluate::DisparityScore& score) {
  FigureTable table{.name = "regions",
                    .title = "Wrong pixels [% of those with truth] by threshold; + = wrong or missing",
                    .columns = {{"region", "", 0}, {"known", "pixels", 0}, {"density", "density", 2}}};
  for (const double threshold : evaluate::kBadThresholds) {
    table.columns.push_back({fmt::format("wrong_{:g}px", threshold), fmt::format("{:g} px", threshold), 2});
  }
  for (const double threshold : evaluate::kBadThresholds) {
    table.columns.push_back({fmt::format("wrong_or_missing_{:g}px", threshold), fmt::format("{:g} px+", threshold), 2});
  }
  const auto add = [&](const std::string& name, const evaluate::RegionScore& region) {
    std::vector<std::variant<std::string, double>> row = {name, count(region.known), region.density()};
    for (size_t i = 0; i < evaluate::kBadThresholds.size(); ++i) row.emplace_back(region.wrong(i));
    for (size_t i = 0; i < evaluate::kBadThresholds.size(); ++i) row.emplace_back(region.wrong_or_missing(i));
    table.rows.push_back(std::move(row));
  };
  add("all", score.all);
  if (score.has_occlusion) {
    add("seen by both cameras", score.visible);
    add("occluded", score.occluded);
  }
  add("near borders", score.at_borders);
  add("elsewhere", score.elsewhere);
  return table;
}

FigureTable border_table(const evaluate::DisparityScore& score, const evaluate::DisparityOptions& options) {
  FigureTable table{.name = "borders",
                    .title = fmt::format("Errors above 1 px within {} px of object borders [% of all pixels with "
                                         "truth] (thesis table 3.2)",
                                         options.border_distance),
                    .columns = {{"border", "border", 0},
                                {"wrong_object", "wrong object", 3},
                                {"wrong_background", "wrong background", 3},
                                {"possible", "possible", 3},
                                {"fraction", "fraction", 3}}};
  constexpr const char* kNames[] = {"left", "right", "top", "bottom"};
  const double known = count(score.all.known);
  for (size_t i = 0; i < score.borders.size(); ++i) {
    const evaluate::BorderScore& b = score.borders[i];
    const double wrong = count(b.wrong_object + b.wrong_background), possible = count(b.possible);
    table.rows.push_back({std::string(kNames[i]), percent(count(b.wrong_object), known),
                          percent(count(b.wrong_background), known), percent(possible, known),
                          percent(wrong, possible) / 100});
  }
  return table;
}

FigureTable origin_table(const evaluate::DisparityScore& score) {
  FigureTable table{.name = "subpixel",
                    .title = "Sub-pixel error (errors up to 1 px) by origin [px]",
                    .columns = {{"origin", "origin", 0},
                                {"valid", "valid", 0},
                                {"within", "up to 1 px", 0},
                                {"wrong_percent", "wrong %", 2},
                                {"rms", "RMS", 3},
                                {"mean_absolute", "mean size", 3},
                                {"bias", "bias", 3}}};
  const auto add = [&](const std::string& name, const evaluate::SubpixelScore& s) {
    if (s.valid == 0) return;
    table.rows.push_back({name, count(s.valid), count(s.count), percent(count(s.valid - s.count), count(s.valid)),
                          s.rms(), s.absolute(), s.mean()});
  };
  add("all", score.subpixel);
  constexpr const char* kOrigins[] = {"none", "measured", "corrected", "within segments", "between segments"};
  for (size_t i = 0; i < score.by_origin.size(); ++i) add(kOrigins[i], score.by_origin[i]);
  return table;
}

FigureTable locking_table(const evaluate::DisparityScore& score) {
  FigureTable table{
      .name = "pixel_locking",
      .title = std::string("Error by the fractional part of the true disparity (pixel locking) [px]") +
               (score.has_origin ? ", measured pixels" : ""),
      .columns = {
          {"from", "from", 1}, {"to", "to", 1}, {"pixels", "pixels", 0}, {"bias", "bias", 4}, {"rms", "RMS", 4}}};
  for (int i = 0; i < evaluate::kFractionBins; ++i) {
    const evaluate::SubpixelScore& s = score.by_fraction[static_cast<size_t>(i)];
    if (s.count == 0) continue;
    table.rows.push_back({static_cast<double>(i) / evaluate::kFractionBins,
                          static_cast<double>(i + 1) / evaluate::kFractionBins, count(s.count), s.mean(), s.rms()});
  }
  return table;
}

}  // namespace

FigureSection trajectory_section(const evaluate::TrajectoryErrors& errors, const evaluate::TrajectoryOptions& options,
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
  f.push_back({"poses", "poses compared", count(errors.pairs.size()), ""});
  f.push_back({"poses_without_truth", "poses without truth", count(errors.unmatched), ""});
  f.push_back({"true_path", "length of the true path", errors.true_path, "m"});
  f.push_back({"estimated_path", "length of the estimated path", errors.estimated_path, "m"});
  if (has_time) f.push_back({"duration", "duration", errors.duration, "s"});
  f.push_back({"ate_rmse", "absolute error of the position (ATE), RMS", errors.absolute.translation.rmse, "m"});
  f.push_back(
      {"ate_rotation_rmse", "absolute error of the rotation, RMS", errors.absolute.rotation.rmse * kDegrees, "deg"});
  f.push_back({"scale_error", "scale error (+ = estimated lengths are too long)", 100 * errors.scale_error, "%"});
  f.push_back({"camera_rotation", "constant turn between true and estimated camera (taken out)",
               rotation_angle(errors.estimate_from_truth_cam) * kDegrees, "deg"});
  f.push_back({"closing_translation", "first to last view: translation error", errors.closing_translation, "m"});
  f.push_back({"closing_translation_percent", "first to last view: of the path",
               percent(errors.closing_translation, errors.true_path), "%"});
  f.push_back({"closing_rotation", "first to last view: rotation error", errors.closing_rotation * kDegrees, "deg"});
  f.push_back({"closing_gap", "first to last view: true distance", errors.true_gap, "m"});
  if (errors.mean_drift.segments > 0) {
    f.push_back({"drift_translation", "drift over segments, translation", 100 * errors.mean_drift.translation, "%"});
    f.push_back({"drift_rotation", "drift over segments, rotation", errors.mean_drift.rotation * kDegrees, "deg/m"});
  }
  section.tables.push_back(error_table(errors, has_time));
  section.tables.push_back(drift_table(errors));
  return section;
}

void add_consistency(FigureSection& section, const evaluate::Consistency& motions, const evaluate::Consistency& loops,
                     const evaluate::Consistency& poses) {
  if (motions.edges > 0) {
    add_motions(section, motions);
  } else {
    section.notes.push_back("no motion with truth on both sides: its covariances cannot be judged");
  }
  auto& f = section.figures;
  if (poses.edges > 0) {
    f.push_back({"pose_nees_mean", "NEES of the poses against the first, mean (6 expected)", poses.mean, "1"});
    f.push_back({"pose_nees_median", "NEES of the poses against the first, median (5.35 expected)", poses.median, "1"});
  }
  if (loops.edges == 0) return;
  f.push_back({"loop_edges", "loops whose stated covariance is judged", count(loops.edges), ""});
  f.push_back({"loop_nees_mean", "NEES of the loops, mean (6 expected)", loops.mean, "1"});
  f.push_back({"loop_share_within", "loops within their 95 % band", 100 * loops.share_within, "%"});
}

FigureSection disparity_section(const evaluate::DisparityScore& score, const evaluate::DisparityOptions& options) {
  FigureSection section{.name = "disparities", .title = "Disparities"};
  section.notes.push_back(fmt::format("{} image{} against truth{}; 'wrong' = off by more than the threshold",
                                      score.images, score.images == 1 ? "" : "s",
                                      options.round ? ", rounded to whole pixels" : ""));
  const evaluate::RegionScore& all = score.all;
  const auto share = [&](int64_t n) { return percent(count(n), count(all.known)); };
  auto& f = section.figures;
  f.push_back({"images", "images", count(score.images), ""});
  f.push_back({"known", "pixels with truth", count(all.known), ""});
  f.push_back({"density", "of them with an estimate", all.density(), "%"});
  f.push_back({"wrong_1px", "wrong by more than 1 px", all.wrong(kOnePixel), "%"});
  f.push_back({"wrong_or_missing_1px", "wrong by more than 1 px or missing", all.wrong_or_missing(kOnePixel), "%"});
  f.push_back({"correct", "correct (thesis table 3.1)", share(all.valid - all.bad[kOnePixel]), "%"});
  f.push_back({"invalid", "invalid", share(all.known - all.valid), "%"});
  f.push_back({"border_errors", "errors at borders", share(score.at_borders.bad[kOnePixel]), "%"});
  f.push_back({"other_errors", "other errors", share(score.elsewhere.bad[kOnePixel]), "%"});
  f.push_back({"outliers_kitti", "off by more than 3 px and 5 %", share(all.outliers_kitti), "%"});
  f.push_back({"subpixel_rms", "RMS of the errors up to 1 px", score.subpixel.rms(), "px"});
  f.push_back({"subpixel_mean_absolute", "mean size of the errors up to 1 px", score.subpixel.absolute(), "px"});
  f.push_back({"subpixel_bias", "mean of the errors up to 1 px (+ = too near)", score.subpixel.mean(), "px"});
  section.tables = {region_table(score), border_table(score, options), origin_table(score), locking_table(score)};
  return section;
}

FigureSection cloud_section(const evaluate::CloudErrors& errors, const evaluate::CloudOptions& options) {
  FigureSection section{.name = "cloud", .title = "Point cloud", .notes = {}, .figures = {}, .tables = {}};
  section.notes.push_back(fmt::format(
      "near: measured from within {:g} m; covered: a point within {:g} m of a true point of textured surface "
      "that a camera saw",
      options.near_range, options.reach));
  auto& f = section.figures;
  f.push_back({"points", "points", count(errors.distance.count), ""});
  f.push_back({"distance_median", "distance to the true surface, median", errors.distance.median, "m"});
  f.push_back({"distance_rmse", "distance to the true surface, RMS", errors.distance.rmse, "m"});
  f.push_back({"near_points", "near points", count(errors.near_distance.count), ""});
  f.push_back({"near_distance_median", "distance of near points, median", errors.near_distance.median, "m"});
  f.push_back({"near_distance_rmse", "distance of near points, RMS", errors.near_distance.rmse, "m"});
  f.push_back({"within_sigma", "points within their stated sigma (68 % expected)", 100 * errors.within_sigma, "%"});
  f.push_back({"within_two_sigma", "points within twice that (95 % expected)", 100 * errors.within_two_sigma, "%"});
  f.push_back({"near_within_sigma", "near points within sigma", 100 * errors.near_within_sigma, "%"});
  f.push_back({"near_within_two_sigma", "near points within two sigma", 100 * errors.near_within_two_sigma, "%"});
  f.push_back({"true_points", "true points that were seen", count(errors.seen), ""});
  f.push_back({"covered", "covered", percent(errors.covered, errors.seen), "%"});
  return section;
}

FigureSection map_section(const evaluate::MapErrors& errors, double cell, const evaluate::MapOptions& options) {
  FigureSection section{.name = "map", .title = "Map"};
  section.notes.push_back(fmt::format("cells match within {} cell{} of the true plan ({:g} m each) in each direction",
                                      options.tolerance, options.tolerance == 1 ? "" : "s", cell));
  section.notes.push_back("surfaces without texture or that no camera saw count neither as missing nor as false");
  auto& f = section.figures;
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
  f.push_back({"free_unseen", "of them where no camera saw that it is free", count(errors.free_unseen), ""});
  f.push_back({"true_free", "free cells of the plan", count(errors.true_free), ""});
  const auto thickness = [&](const std::string& key, const std::string& what, const std::string& faces,
                             const evaluate::MapErrors::Thickness& of) {
    f.push_back({faces, "faces of " + what + " with anything in the map", count(of.faces), ""});
    f.push_back({key + "_mean", "thickness of " + what + " in the map [cells], mean", of.mean, "1"});
    f.push_back({key + "_median", "median [cells]", of.median, "1"});
    f.push_back({key + "_95", "of 95 % of them at most [cells]", of.most, "1"});
  };
  thickness("thickness", "true walls", "faces", errors.faces);
  thickness("wall_thickness", "bare straight walls", "wall_faces", errors.walls);
  f.push_back({"distance_median", "occupied cells to the nearest true one, median", errors.distance_median, "m"});
  f.push_back({"distance_mean", "occupied cells to the nearest true one, mean", errors.distance_mean, "m"});
  f.push_back({"distance_rms", "occupied cells to the nearest true one, RMS", errors.distance_rms, "m"});
  return section;
}

FigureSection image_section(const evaluate::ImageErrors& errors, cv::Size size, bool colour) {
  FigureSection section{.name = "image", .title = "Image"};
  section.notes.push_back(
      fmt::format("{} x {} px compared in {}; SSIM on grey values, Gaussian window 11 x 11 px of deviation 1.5 px, "
                  "K1 0.01, K2 0.03",
                  size.width, size.height, colour ? "colour" : "grey"));
  section.figures = {{"pixels", "pixels compared", count(errors.pixels), ""},
                     {"coverage", "coverage", errors.coverage, "%"},
                     {"psnr", "PSNR", errors.psnr, "dB"},
                     {"ssim", "SSIM", errors.ssim, "1"},
                     {"rmse", "RMS difference", std::sqrt(errors.mse), "grey"}};
  return section;
}

}  // namespace iris::exporters
