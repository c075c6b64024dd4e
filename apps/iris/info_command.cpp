// iris info SESSION|OUT: what is there.
#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <memory>

#include "apps/iris/command.h"
#include "iris/core/error.h"
#include "iris/pipeline/frames.h"

namespace iris::app {
namespace fs = std::filesystem;
namespace {

struct Info {
  explicit Info(CLI::App& command) : arguments(command, {"session"}) {}
  std::string path;
  Arguments arguments;
};

// `no_calibration`: why there is none; empty = there is one.
void print_session(const session::Session& session, const std::string& no_calibration) {
  const StereoCalibration& calibration = session.calibration();
  fmt::print("session      {}\n", session.folder().string());
  fmt::print("kind         {}\n", session.kind());
  fmt::print("frames       {}\n", session.size());
  if (session.size() > 1 && !session.has_stamps()) {
    fmt::print("duration     unknown: no time stamps\n");
  } else if (session.size() > 1) {
    const double seconds = static_cast<double>(session.stamp_ns(session.size() - 1) - session.stamp_ns(0)) * 1e-9;
    fmt::print("duration     {:.1f} s, {:.2f} frames a second\n", seconds,
               (session.size() - 1) / std::max(seconds, 1e-9));
  }
  fmt::print("images       {} x {} px{}\n", calibration.left.width, calibration.left.height,
             calibration.rectified ? ", recorded rectified" : "");
  if (no_calibration.empty()) {
    const RectifiedCamera camera = rectify::Rectifier(calibration).camera();
    fmt::print("calibration  {}\n", calibration.source);
    fmt::print("rectified    f {:.2f} px, baseline {:.4f} m\n", camera.f, camera.baseline);
  } else {
    fmt::print("calibration  none that can be used: {}\n", no_calibration);
    fmt::print("             of images of a target 'iris calibrate' makes one\n");
  }
  for (const std::string& note : session.notes()) fmt::print("note         {}\n", note);
}

// Recordings can be looked at before they are calibrated, and recordings of a target are what calibrations come from. A
// calibration that was asked for must be good, though.
void print_session(const std::string& path, session::SessionOptions options) {
  std::string no_calibration;
  std::unique_ptr<session::Session> session;
  try {
    session = session::open_session(path, options);
  } catch (const InputError& error) {
    if (!options.calibration.empty()) throw;
    no_calibration = error.what();
    options.needs_calibration = false;
    session = session::open_session(path, options);  // if something else is wrong it says so again
  }
  print_session(*session, no_calibration);
}

// The numbers of thesis 5.4 for each frame, then their means.
void print_motions(const workspace::Workspace& workspace) {
  fmt::print("\nframe  submap  against  corners  initial  consistent  used  rms px\n");
  int motions = 0, least_used = 0;
  double corners = 0, initial = 0, consistent = 0, used = 0, rms = 0;
  workspace.for_each_frame([&](const workspace::FrameRecord& record) {
    if (record.state != workspace::FrameState::posed) {
      fmt::print("{:5}  {}: {}\n", record.frame_idx,
                 record.state == workspace::FrameState::blind ? "shows too little" : "not readable", record.message);
      return;
    }
    const MotionEstimate& m = record.motion;
    const bool begins = record.reference_frame < 0;
    std::string note;
    if (begins) {
      note = record.submap == 0 ? "begins the path" : fmt::format("begins a sub-map: {}", name_of(m.status));
    } else if (m.status != MotionStatus::ok) {
      note = name_of(m.status);
    }
    fmt::print("{:5}  {:6}  {:>7}  {:7}  {:7}  {:10}  {:4}  {:6.3f}  {}\n", record.frame_idx, record.submap,
               begins ? "-" : std::to_string(record.reference_frame), m.corners, m.initial, m.consistent, m.used,
               m.rms_px, note);
    if (begins || m.status != MotionStatus::ok) return;
    ++motions;
    least_used = motions == 1 ? m.used : std::min(least_used, m.used);
    corners += m.corners;
    initial += m.initial;
    consistent += m.consistent;
    used += m.used;
    rms += m.rms_px;
  });
  if (motions == 0) return;
  const double n = motions;
  fmt::print(
      " mean                  {:7.0f}  {:7.0f}  {:10.0f}  {:4.0f}  {:6.3f}  {} motions, never less than {} pairs\n",
      corners / n, initial / n, consistent / n, used / n, rms / n, motions, least_used);
}

// Every pair of views that was looked at, and what became of it.
void print_loops(const workspace::Workspace& workspace) {
  const std::vector<workspace::LoopRecord> loops = workspace.loops();
  if (loops.empty()) return;
  fmt::print("\nloop           pairs  consistent  error  verdict\n");
  int accepted = 0;
  for (const workspace::LoopRecord& loop : loops) {
    const bool good = loop.edge.verdict == loop::LoopVerdict::accepted;
    accepted += good;
    fmt::print("{:5} - {:5}  {:5}  {:10}  {:>5}  {}\n", loop.edge.i, loop.edge.j, loop.edge.used, loop.edge.consistent,
               good ? fmt::format("{:.2f}", loop.error) : "-", name_of(loop.edge.verdict));
  }
  fmt::print(" {} of {} accepted; error: what is left after refinement, in standard deviations\n", accepted,
             loops.size());
}

void print_output(const workspace::Workspace& workspace) {
  const workspace::Poses poses = workspace.stage("loop") ? workspace::Poses::refined : workspace::Poses::odometry;
  const pipeline::FramesSummary summary = pipeline::summarise_frames(workspace, poses);
  fmt::print("output       {}\n", workspace.folder().string());
  fmt::print("session      {}\n", workspace.session_folder());
  fmt::print("frames       {}: {} with a pose, {} unreadable, {} that show too little, {} sub-map{}\n", summary.frames,
             summary.posed, summary.unreadable, summary.blind, summary.submaps, summary.submaps == 1 ? "" : "s");
  if (!summary.rows_text.empty()) fmt::print("warning      {}\n", summary.rows_text);
  if (const std::string text = summary.too_near_text(); !text.empty()) fmt::print("warning      {}\n", text);
  fmt::print("path         {:.3f} m\n", summary.path_length);
  fmt::print("views        {}\n", summary.views);
  if (const std::string text = workspace.calibration().text; !text.empty()) fmt::print("calibration  {}\n", text);
  for (const workspace::WorldRecord& world : workspace.worlds()) {
    fmt::print("up           sub-map {}: {}\n", world.submap, world.alignment);
  }
  for (const char* name :
       {"frames", "loop", "trajectory", "map", "octree", "cloud", "mesh", "scene", "tour", "report"}) {
    const auto record = workspace.stage(name);
    fmt::print("stage        {:<10} {}\n", name, record ? "done" : "not finished");
    if (!record) continue;
    for (const std::string& file : record->outputs) {
      if (file.find("frames/") == std::string::npos) fmt::print("               {}\n", file);
    }
  }
  print_motions(workspace);
  print_loops(workspace);
}

int info(Info& info) {
  info.arguments.resolve();
  if (fs::exists(fs::path(info.path) / "workspace.db")) {
    print_output(workspace::Workspace::open(info.path, workspace::Workspace::Access::read_only));
  } else {
    print_session(info.path, info.arguments.options.library.session);
  }
  return kGood;
}

}  // namespace

Command add_info(CLI::App& program) {
  CLI::App* command = program.add_subcommand(
      "info", "What is there: a recorded session, or the output of a run with a table of its motions.");
  auto state = std::make_shared<Info>(*command);
  command->add_option("PATH", state->path, "Recorded session or output folder")->type_name("SESSION|OUT")->required();
  return [state] { return info(*state); };
}

}  // namespace iris::app
