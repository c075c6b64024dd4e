// iris info SESSION|OUT: what is there.
#include <fmt/format.h>

#include <filesystem>
#include <memory>

#include "apps/iris/command.h"
#include "iris/pipeline/frames.h"

namespace iris::app {
namespace fs = std::filesystem;
namespace {

struct Info {
  explicit Info(CLI::App& command) : arguments(command, {"session"}) {}
  std::string path;
  Arguments arguments;
};

void print_session(const session::Session& session) {
  const StereoCalibration& calibration = session.calibration();
  fmt::print("session      {}\n", session.folder().string());
  fmt::print("kind         {}\n", session.kind());
  fmt::print("frames       {}\n", session.size());
  if (session.size() > 1) {
    const double seconds = static_cast<double>(session.stamp_ns(session.size() - 1) - session.stamp_ns(0)) * 1e-9;
    fmt::print("duration     {:.1f} s, {:.2f} frames a second\n", seconds,
               (session.size() - 1) / std::max(seconds, 1e-9));
  }
  fmt::print("images       {} x {} px{}\n", calibration.left.width, calibration.left.height,
             calibration.rectified ? ", recorded rectified" : "");
  const RectifiedCamera camera = rectify::Rectifier(calibration).camera();
  fmt::print("calibration  {}\n", calibration.source);
  fmt::print("rectified    f {:.2f} px, baseline {:.4f} m\n", camera.f, camera.baseline);
  for (const std::string& note : session.notes()) fmt::print("note         {}\n", note);
}

void print_output(const workspace::Workspace& workspace) {
  const pipeline::FramesSummary summary = pipeline::summarise_frames(workspace);
  fmt::print("output       {}\n", workspace.folder().string());
  fmt::print("session      {}\n", workspace.session_folder());
  fmt::print("frames       {}: {} with a pose, {} unreadable, {} sub-maps\n", summary.frames, summary.posed,
             summary.unreadable, summary.submaps);
  fmt::print("path         {:.3f} m\n", summary.path_length);
  fmt::print("views        {}\n", summary.views);
  for (const char* name : {"frames", "trajectory", "map", "octree", "scene", "tour"}) {
    const auto record = workspace.stage(name);
    fmt::print("stage        {:<10} {}\n", name, record ? "done" : "not finished");
    if (!record) continue;
    for (const std::string& file : record->outputs) {
      if (file.find("frames/") == std::string::npos) fmt::print("               {}\n", file);
    }
  }
  fmt::print("\nframe  submap  against  corners  initial  consistent  used  rms px\n");
  workspace.for_each_frame([](const workspace::FrameRecord& record) {
    if (!record.readable) {
      fmt::print("{:5}  not readable: {}\n", record.frame_idx, record.message);
    } else {
      const MotionEstimate& m = record.motion;
      fmt::print("{:5}  {:6}  {:>7}  {:7}  {:7}  {:10}  {:4}  {:6.3f}  {}\n", record.frame_idx, record.submap,
                 record.reference_frame < 0 ? "-" : std::to_string(record.reference_frame), m.corners, m.initial,
                 m.consistent, m.used, m.rms_px, record.reference_frame < 0 ? "begins a sub-map" : "");
    }
  });
}

int info(Info& info) {
  info.arguments.resolve();
  if (fs::exists(fs::path(info.path) / "workspace.db")) {
    print_output(workspace::Workspace::open(info.path, workspace::Workspace::Access::read_only));
  } else {
    print_session(*session::open_session(info.path, info.arguments.options.library.session));
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
