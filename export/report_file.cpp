#include "export/report_file.h"

#include <fmt/chrono.h>
#include <fmt/format.h>

#include <cmath>
#include <ctime>
#include <filesystem>
#include <functional>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "export/html.h"
#include "export/plot_file.h"
#include "export/sheet_file.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/mapping/flog.h"
#include "iris/pipeline/frames.h"
#include "iris/stereo/disparity_picture.h"

namespace iris::exporters {
namespace fs = std::filesystem;
namespace {

using workspace::FrameRecord;
using workspace::FrameState;
using workspace::LoopRecord;
using workspace::Poses;
using workspace::Workspace;

// What a run is told apart by in the page.
struct Facts {
  std::string session;
  pipeline::FramesSummary summary;
  PoseGraph odometry, refined;
  std::vector<LoopRecord> loops;
  std::vector<FrameRecord> frames;
  RectifiedCamera camera;
};

Facts facts_of(const Workspace& workspace) {
  Facts facts{.session = fs::path(workspace.session_folder()).filename().string(),
              .summary = pipeline::summarise_frames(workspace, Poses::refined),
              .odometry = workspace.pose_graph(Poses::odometry),
              .refined = workspace.pose_graph(Poses::refined),
              .loops = workspace.loops()};
  workspace.for_each_frame([&](const FrameRecord& record) { facts.frames.push_back(record); });
  facts.camera = workspace.views(Poses::refined, -1, 0)->summaries().front().camera;
  return facts;
}

// [m] of a pose: root of the summed variances along the three axes.
double position_sigma(const PoseNode& node) { return std::sqrt(node.covariance.topLeftCorner<3, 3>().trace()); }

// Lengths as people say them.
std::string length_text(double metres) {
  if (metres < 0.1) return fmt::format("{:.1f} mm", 1000 * metres);
  return fmt::format("{:.2f} m", metres);
}

std::string size_text(std::uintmax_t bytes) {
  if (bytes < 1000) return fmt::format("{} B", bytes);
  if (bytes < 1000 * 1000) return fmt::format("{:.0f} kB", static_cast<double>(bytes) / 1e3);
  return fmt::format("{:.1f} MB", static_cast<double>(bytes) / 1e6);
}

std::string time_text(const Facts& facts) {
  constexpr int64_t kYear2000 = 946684800;  // recordings without a clock count from zero
  const std::time_t begin = facts.frames.front().stamp_ns / 1'000'000'000;
  const double seconds = 1e-9 * static_cast<double>(facts.frames.back().stamp_ns - facts.frames.front().stamp_ns);
  const std::string duration = fmt::format("{:.1f} s", seconds);
  return begin > kYear2000 ? fmt::format("{:%Y-%m-%d %H:%M} UTC, {}", fmt::gmtime(begin), duration) : duration;
}

// What a user must know before trusting the rest.
std::vector<std::string> warnings_of(const Workspace& workspace, const Facts& facts) {
  std::vector<std::string> warnings;
  const pipeline::FramesSummary& summary = facts.summary;
  if (!summary.rows_text.empty()) warnings.push_back("The " + summary.rows_text + ".");
  if (const workspace::CalibrationRecord calibration = workspace.calibration(); calibration.is_wrong) {
    warnings.push_back("The calibration does not fit this recording: " + calibration.text + ".");
  }
  if (summary.submaps > 1) {
    warnings.push_back(
        fmt::format("The path broke into {} sub-maps whose relation is unknown. All are kept; map, octree and tour "
                    "show the largest, sub-map {}.",
                    summary.submaps, summary.largest_submap));
  }
  if (summary.unreadable > 0) warnings.push_back(fmt::format("{} frames could not be read.", summary.unreadable));
  if (summary.blind > 0) {
    warnings.push_back(
        fmt::format("{} frames show too little to be placed (a covered lens, darkness, a bare wall).", summary.blind));
  }
  if (const std::string text = summary.too_near_text(); !text.empty()) warnings.push_back(text + ".");
  int guessed = 0;
  for (const PoseEdge& edge : facts.refined.edges) guessed += edge.kind == PoseEdgeKind::guessed;
  if (guessed > 0) warnings.push_back(fmt::format("{} motions are guesses, not measured.", guessed));
  for (const workspace::WorldRecord& world : workspace.worlds()) {
    if (const std::string text = world.guess_text(); !text.empty()) warnings.push_back("The " + text + ".");
  }
  return warnings;
}

std::string figures_table(const Workspace& workspace, const Facts& facts) {
  const pipeline::FramesSummary& summary = facts.summary;
  std::string rows;
  const auto row = [&rows](std::string_view name, const std::string& value) {
    rows += fmt::format("<tr><th>{}</th><td>{}</td></tr>\n", name, html::escape(value));
  };
  row("Recorded", time_text(facts));
  row("Frames", fmt::format("{} of {} with a pose, {} stored as views", summary.posed, summary.frames, summary.views));
  row("Camera", fmt::format("{} x {} px rectified, f {:.1f} px, baseline {:.1f} mm", facts.camera.width,
                            facts.camera.height, facts.camera.f, 1000 * facts.camera.baseline));
  if (const std::string text = workspace.calibration().text; !text.empty()) row("Calibration", text);
  row("Path", fmt::format("{:.2f} m", summary.path_length));
  const int accepted =
      static_cast<int>(std::count_if(facts.loops.begin(), facts.loops.end(), [](const LoopRecord& loop) {
        return loop.edge.verdict == loop::LoopVerdict::accepted;
      }));
  row("Loops", fmt::format("{} closed of {} looked at", accepted, facts.loops.size()));
  if (const auto closing = closing_error(facts.odometry, facts.refined, summary.largest_submap)) {
    row("Closing error",
        fmt::format("{} after {:.1f} m as chained ({:.2f} %), before the loops were closed",
                    length_text(closing->error), closing->way, 100 * closing->error / std::max(closing->way, 1e-9)));
  }
  double worst = 0;
  for (const PoseNode& node : facts.refined.nodes) worst = std::max(worst, position_sigma(node));
  row("Stated error",
      fmt::format("{} at the least certain pose (1 \u03c3, against the first pose)", length_text(worst)));
  for (const workspace::WorldRecord& world : workspace.worlds()) {
    row(workspace.worlds().size() > 1 ? fmt::format("Up, sub-map {}", world.submap) : "Up", world.alignment);
  }
  row("Software", "IRIS " IRIS_VERSION);
  return "<table class=facts>\n" + rows + "</table>\n";
}

std::string motions_table(const Facts& facts) {
  std::string rows;
  for (const FrameRecord& frame : facts.frames) {
    if (frame.state != FrameState::posed) {
      rows += fmt::format("<tr><td>{}</td><td colspan=7>{}: {}</td></tr>\n", frame.frame_idx,
                          frame.state == FrameState::blind ? "shows too little" : "not readable",
                          html::escape(frame.message));
      continue;
    }
    const MotionEstimate& m = frame.motion;
    const bool begins = frame.reference_frame < 0;
    rows += fmt::format(
        "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td>"
        "<td>{:.3f}</td></tr>\n",
        frame.frame_idx, frame.submap, begins ? "begins" : std::to_string(frame.reference_frame), m.corners, m.initial,
        m.consistent, m.used, m.rms_px);
  }
  return "<table><tr><th>frame</th><th>sub-map</th><th>against</th><th>corners</th><th>initial</th>"
         "<th>consistent</th><th>used</th><th>rms [px]</th></tr>\n" +
         rows + "</table>\n";
}

std::string loops_table(const Facts& facts) {
  std::string rows;
  for (const LoopRecord& loop : facts.loops) {
    const bool good = loop.edge.verdict == loop::LoopVerdict::accepted;
    rows += fmt::format("<tr{}><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>\n",
                        good ? "" : " class=rejected", loop.edge.i, loop.edge.j, loop.edge.used,
                        good ? fmt::format("{:.2f}", loop.error) : "", loop::name_of(loop.edge.verdict));
  }
  return "<table><tr><th>frame</th><th>frame</th><th>pairs</th><th>error left [\u03c3]</th><th>verdict</th></tr>\n" +
         rows + "</table>\n";
}

// Options of the run that differ from the defaults.
std::string options_table(const OptionSet& options) {
  std::string rows;
  for (const OptionSet::Option& option : options.options()) {
    const std::string text = to_text(option);
    if (text == option.default_text) continue;
    rows += fmt::format("<tr><td><code>{}</code></td><td>{}</td><td>{}</td></tr>\n", option.name, html::escape(text),
                        html::escape(option.default_text));
  }
  if (rows.empty()) return "<p>All options have their default values.</p>\n";
  return "<table><tr><th>option</th><th>value</th><th>default</th></tr>\n" + rows + "</table>\n";
}

// What a product is for, by its place in OUT.
struct Product {
  std::string_view file;
  const char* what;
  const char* opens;
};
constexpr Product kProducts[] = {
    {"map/sheet.pdf", "the map on paper, true to scale", "any PDF reader"},
    {"map/sheet.svg", "the same for drawing programs", "Inkscape, browsers"},
    {"map/sheet.png", "the same as a picture", "any picture viewer"},
    {"map/map_picture.png", "the map with path and legend", "any picture viewer"},
    {"map/layers.png", "the map, heights in colour", "any picture viewer"},
    {"map/map.yaml", "the map for robots", "ROS, Nav2 (map_server)"},
    {"map/map.png", "the map in grey, a pixel a cell", "QGIS and other GIS"},
    {"map/map.pgw", "world file of map.png", "QGIS and other GIS"},
    {"octree/map.ot", "coloured octree with log-odds", "OctoMap, octovis"},
    {"octree/map.bt", "octree, occupied and free", "OctoMap, MoveIt"},
    {"model/scene.glb", "3-D scene", "Blender, browsers, Windows 3D Viewer"},
    {"model/cloud.ply", "coloured points with normals and \u03c3", "CloudCompare, MeshLab"},
    {"model/cloud.pcd", "the same", "PCL"},
    {"model/mesh.ply", "surface", "MeshLab, Blender"},
    {"tour/tour.mp4", "virtual tour", "any video player"},
    {"trajectory/tum.txt", "path (TUM)", "evo"},
    {"trajectory/kitti.txt", "path (KITTI)", "evo, KITTI tools"},
    {"trajectory/graph.g2o", "pose graph with all edges", "g2o_viewer"},
    {"options.toml", "all options of this run", "iris --config"},
    {"log.txt", "what happened", "any editor"},
};

// The well-known products first, then whatever else the stages wrote, but for the pictures that a video is made of.
std::string products_table(const Workspace& workspace) {
  const fs::path out = workspace.folder();
  std::string rows;
  const auto row = [&](const std::string& file, const char* what, const char* opens) {
    if (!fs::exists(out / file)) return;
    // The log grows after the page is written.
    const std::string size = file == "log.txt" ? "" : size_text(fs::file_size(out / file));
    rows += fmt::format("<tr><td><a href=\"../{0}\">{0}</a></td><td>{1}</td><td>{2}</td><td>{3}</td></tr>\n",
                        html::escape(file), size, what, opens);
  };
  for (const Product& product : kProducts) row(std::string(product.file), product.what, product.opens);
  for (const char* stage : {"trajectory", "map", "octree", "cloud", "mesh", "scene", "colmap", "nerfstudio"}) {
    const auto record = workspace.stage(stage);
    if (!record) continue;
    constexpr size_t kMost = 12;  // of a stage: a folder of pictures is told by its first ones
    size_t shown = 0;
    for (const std::string& file : record->outputs) {
      const bool listed = std::any_of(std::begin(kProducts), std::end(kProducts),
                                      [&](const Product& product) { return product.file == file; });
      if (!listed && ++shown <= kMost) row(file, "", "");
    }
    if (shown > kMost)
      rows += fmt::format("<tr><td>… and {} more</td><td></td><td></td><td></td></tr>\n", shown - kMost);
  }
  return "<table><tr><th>file</th><th>size</th><th>what it is</th><th>opens with</th></tr>\n" + rows + "</table>\n";
}

// Plots over the frames; a frame without a value interrupts the line.
void write_plots(const fs::path& folder, const Facts& facts) {
  const double none = std::nan("");
  PlotSeries corners{.name = "usable corners", .points = {}, .colour = kGreen};
  PlotSeries used{.name = "pairs used", .points = {}, .colour = kBlue};
  for (const FrameRecord& frame : facts.frames) {
    const bool moved = frame.state == FrameState::posed && frame.reference_frame >= 0;
    corners.points.emplace_back(frame.frame_idx, frame.state == FrameState::posed ? frame.motion.corners : none);
    used.points.emplace_back(frame.frame_idx, moved ? frame.motion.used : none);
  }
  write_plot(folder / "motions.svg", {.title = "What each motion rests on",
                                      .x_label = "frame",
                                      .y_label = "number",
                                      .series = {corners, used},
                                      .y_from_zero = true,
                                      .height = 360});
  PlotSeries sigma{.name = "", .points = {}, .colour = kBlue};
  for (const PoseNode& node : facts.refined.nodes) {
    sigma.points.emplace_back(node.frame_idx, 1000 * position_sigma(node));
  }
  write_plot(folder / "errors.svg", {.title = "Stated error of the position against the first pose",
                                     .x_label = "frame",
                                     .y_label = "1 \u03c3 [mm]",
                                     .series = {sigma},
                                     .y_from_zero = true,
                                     .height = 360});
}

// The first, the middle and the last stored view: picture and disparities beside each other.
std::vector<std::string> write_view_pictures(const fs::path& folder, const Workspace& workspace) {
  const auto views = workspace.views(Poses::refined, -1, 0);
  const int count = static_cast<int>(views->summaries().size());
  std::vector<std::string> names;
  for (const int i : {0, count / 2, count - 1}) {
    const auto view = views->load(i);
    cv::Mat picture;
    if (view->image.channels() == 1) {
      cv::cvtColor(view->image, picture, cv::COLOR_GRAY2BGR);
    } else {
      picture = view->image;
    }
    const double max = views->summaries()[static_cast<size_t>(i)].max_disparity;
    cv::Mat3b disparities = stereo::disparity_picture(view->disparity.disparity, max > 0 ? max : 1);
    // What was not measured is dimmed.
    const cv::Mat1b filled = view->disparity.origin > static_cast<int>(DisparityOrigin::corrected);
    cv::Mat3b(disparities * 0.45).copyTo(disparities, filled);
    cv::hconcat(picture, disparities, picture);
    const std::string name = fmt::format("view_{:06}.jpg", view->frame_idx);
    if (std::find(names.begin(), names.end(), name) != names.end()) continue;  // of short recordings
    std::vector<uint8_t> jpeg;
    IRIS_CHECK(cv::imencode(".jpg", picture, jpeg, {cv::IMWRITE_JPEG_QUALITY, 88}));
    write_file(folder / name, jpeg);
    names.push_back(name);
  }
  return names;
}

}  // namespace

void write_report(const Workspace& workspace, const OptionSet& options) {
  const fs::path out = workspace.folder(), folder = out / "report";
  const Facts facts = facts_of(workspace);
  write_plots(folder, facts);
  const std::vector<std::string> view_pictures = write_view_pictures(folder, workspace);

  std::string body;
  for (const std::string& warning : warnings_of(workspace, facts)) {
    body += "<p class=warning>" + html::escape(warning) + "</p>\n";
  }
  body += figures_table(workspace, facts);
  const auto there = [&out](const char* file) { return fs::exists(out / file); };
  if (there("tour/tour.mp4")) {
    body += "<h2>Tour</h2>\n<video controls loop preload=metadata src=\"../tour/tour.mp4\"></video>\n";
  }
  if (there("map/map_picture.png")) {
    body += "<h2>Map</h2>\n<div class=pictures>\n" +
            html::figure("../map/map_picture.png", "From above, with the path of the camera.") +
            html::figure("../map/layers.png", "Heights of what stands there.") + "</div>\n";
    body += "<p>On paper: <a href=\"../map/sheet.pdf\">sheet.pdf</a>, true to scale.</p>\n";
  }
  body += "<h2>Path</h2>\n<div class=pictures>\n";
  if (there("trajectory/path.png")) {
    body += html::figure("../trajectory/path.png", "From above: as motions chained it, and as refined.");
  }
  body += html::figure("errors.svg", "How far off a pose may be, as the run itself states it.") +
          html::figure("motions.svg", "A motion that few pairs support is less certain.") + "</div>\n";
  body += "<h2>Stereo views</h2>\n<div class=pictures>\n";
  for (const std::string& name : view_pictures) {
    body +=
        html::figure(name, fmt::format("Frame {}: picture and disparities; dark: filled in, not measured; black: none.",
                                       std::stoi(name.substr(std::string("view_").size()))));
  }
  body += "</div>\n<h2>Files</h2>\n" + products_table(workspace);
  body += "<h2>Details</h2>\n";
  body += html::details("Options", options_table(options));
  if (!facts.loops.empty()) body += html::details("Loops", loops_table(facts));
  body += html::details("Motions", motions_table(facts));
  write_file(folder / "index.html", html::page(facts.session, body));
}

}  // namespace iris::exporters
