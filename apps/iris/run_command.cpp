// iris run SESSION -o OUT: the main job.
#include <fmt/format.h>
#include <spdlog/sinks/basic_file_sink.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <memory>

#include "apps/iris/command.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/pipeline/frames.h"
#include "iris/pipeline/loop.h"

namespace iris::app {
namespace fs = std::filesystem;
namespace {

struct Run {
  explicit Run(CLI::App& command)
      : arguments(command, {"session", "stereo", "motion", "views", "loop", "mapping", "map", "sheet", "octree",
                            "cloud", "mesh", "scene", "render", "tour"}) {}
  std::string session, out, poses;
  bool debug_motion = false;
  Arguments arguments;
};

void log_to_file(const fs::path& path) {
  try {
    auto sink = std::make_shared<spdlog::sinks::basic_file_sink_mt>(path.string());
    sink->set_pattern("%Y-%m-%d %H:%M:%S.%e %l: %v");
    spdlog::default_logger()->sinks().push_back(sink);
    spdlog::default_logger()->flush_on(spdlog::level::info);
  } catch (const spdlog::spdlog_ex& error) {
    throw InputError(path, std::string("cannot be written (") + error.what() + ")", "check the folder's permissions");
  }
}

// Absolute, and the same however it was typed.
std::string session_name(const fs::path& folder) {
  const fs::path path = fs::absolute(folder).lexically_normal();
  return (path.has_filename() ? path : path.parent_path()).string();
}

int run(Run& run) {
  Arguments& arguments = run.arguments;
  arguments.resolve();
  const fs::path out = run.out;
  const auto session = session::open_session(run.session, arguments.options.library.session);
  auto workspace = workspace::Workspace::create(out, session_name(session->folder()), session->identity());
  log_to_file(out / "log.txt");
  spdlog::info("{}: {}, {} stereo frames", session->folder().string(), session->kind(), session->size());
  for (const std::string& note : session->notes()) spdlog::warn("{}", note);
  pipeline::KnownPoses known;
  if (!run.poses.empty()) {
    std::ifstream file(run.poses, std::ios::binary);
    if (!file) throw InputError(run.poses, "cannot be read", "give a file of poses (TUM or KITTI)");
    const std::string text{std::istreambuf_iterator<char>(file), {}};
    known = pipeline::known_poses(text, run.poses, *session, arguments.options.library.session);
    arguments.options.library.loop.enabled = false;  // what is given is not corrected
  }
  write_options(out, arguments.set);

  if (run.debug_motion) arguments.options.library.motion_pictures = out / "debug" / "motion";
  std::vector<pipeline::Stage> stages = {pipeline::frames_stage(*session, arguments.options.library, std::move(known)),
                                         pipeline::loop_stage(arguments.options.library)};
  for (pipeline::Stage& stage : exporters::product_stages(arguments.options, arguments.set))
    stages.push_back(std::move(stage));
  std::vector<std::string> ran;
  with_threads(arguments.threads(),
               [&] { ran = pipeline::run_stages(stages, arguments.set, workspace, arguments.control()); });
  if (run.debug_motion && std::find(ran.begin(), ran.end(), stages.front().name) == ran.end()) {
    spdlog::warn("--debug-motion: the motions were found by an earlier run; pictures of them come with a new folder");
  }

  const pipeline::FramesSummary summary = pipeline::summarise_frames(workspace, workspace::Poses::refined);
  spdlog::info("{} of {} frames have a pose, {:.2f} m of path, {} stored views", summary.posed, session->size(),
               summary.path_length, summary.views);
  if (summary.unreadable > 0) spdlog::warn("{} frames could not be read and were skipped", summary.unreadable);
  if (summary.blind > 0) {
    spdlog::warn("{} frames show too little to be placed (a covered lens, darkness, a bare wall) and have no pose",
                 summary.blind);
  }
  if (summary.submaps > 1) {
    spdlog::warn(
        "the path broke into {} sub-maps whose relation is unknown; all are kept, maps and tour show the largest "
        "(sub-map {})",
        summary.submaps, summary.largest_submap);
    if (4 * summary.submaps > summary.posed) {
      spdlog::warn(
          "most motions failed: see that the calibration is that of this recording ('iris rectify' must give images "
          "whose rows correspond), and that neighbouring frames show the same things");
    }
  }
  spdlog::info("look at {}/report/index.html: everything that was made, and how good it is", out.string());
  return summary.complete() ? kGood : kIncomplete;
}

}  // namespace

Command add_run(CLI::App& program) {
  CLI::App* command =
      program.add_subcommand("run",
                             "The main job: path, maps, octree, 3-D scene, tour and report of a recorded session.\n"
                             "The same command again resumes; with changed options it redoes only what they affect.");
  auto state = std::make_shared<Run>(*command);
  command
      ->add_option("SESSION", state->session,
                   "Recorded session: a folder (KITTI, EuRoC/ASL, two image folders, videos) or a video")
      ->required();
  command->add_option("-o,--output", state->out, "Output folder")->type_name("OUT")->check(kNotEmpty)->required();
  command
      ->add_option("--poses", state->poses,
                   "File of known poses of the recorded left camera (TUM with the recording's time stamps, or KITTI): "
                   "they are the path, nothing of it is estimated or corrected")
      ->type_name("FILE");
  command->add_flag("--debug-motion", state->debug_motion,
                    "Write a picture of each frame's corners and pairs to OUT/debug/motion");
  return [state] { return run(*state); };
}

}  // namespace iris::app
