// iris tour OUT --path along|P.json -o FILE: another tour through a finished run.
#include <spdlog/spdlog.h>

#include <memory>

#include "apps/iris/command.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"

namespace iris::app {
namespace {

struct Tour {
  explicit Tour(CLI::App& command) : arguments(command, {"render", "tour"}) {}
  std::string out, path = "along", video, frames;
  Arguments arguments;
};

int run(Tour& state) {
  if (!state.video.ends_with(".mp4")) throw UsageError("-o " + state.video + ": the video's name must end in .mp4");
  auto workspace = workspace::Workspace::open(state.out);
  state.arguments.resolve(workspace.folder() / "options.toml");
  if (!workspace.stage("loop")) {
    throw InputError(state.out, "its run is not finished", "finish it first with the same 'iris run' command");
  }
  with_threads(state.arguments.threads(), [&] {
    const int frames =
        exporters::write_tour(workspace, state.arguments.options, state.path == "along" ? "" : state.path, state.video,
                              state.frames, state.arguments.control());
    spdlog::info("{}: {} frames", state.video, frames);
  });
  return kGood;
}

}  // namespace

Command add_tour(CLI::App& program) {
  CLI::App* command = program.add_subcommand(
      "tour", "Renders a tour through a finished run: along the recorded path or along a camera path of your own.");
  auto state = std::make_shared<Tour>(*command);
  command->add_option("OUT", state->out, "Output folder of a run")->required();
  command
      ->add_option("--path", state->path,
                   "'along' the recorded path, or a nerfstudio camera_path.json in the world of the run (z up, m)")
      ->type_name("along|P.json")
      ->capture_default_str();
  command->add_option("-o,--output", state->video, "Video to write (MP4, H.264)")
      ->type_name("FILE.mp4")
      ->check(kNotEmpty)
      ->required();
  command->add_option("--frames", state->frames, "Folder for the frames as PNG files")->type_name("DIR");
  return [state] { return run(*state); };
}

}  // namespace iris::app
