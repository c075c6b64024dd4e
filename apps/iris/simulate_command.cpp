// iris simulate SCENE -o SESSION: a recording with known truth.
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <filesystem>
#include <memory>

#include "apps/iris/command.h"
#include "export/mesh_file.h"
#include "export/session_file.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/simulate/scene.h"

namespace iris::app {
namespace {

struct Simulate {
  explicit Simulate(CLI::App& command) : arguments(command, {"simulate", "mapping"}) {}
  std::string scene, out;
  Arguments arguments;
};

int run(Simulate& state) {
  state.arguments.resolve();
  const simulate::SimulateOptions& options = state.arguments.simulate;
  // Names go before files: the session of 'boxes' may lie in a folder boxes.
  const std::vector<std::string>& names = simulate::scene_names();
  const bool is_model = std::find(names.begin(), names.end(), state.scene) == names.end();
  if (is_model && !std::filesystem::exists(state.scene)) {
    throw UsageError(fmt::format("there is neither a file nor a scene '{}'; the scenes are: {}", state.scene,
                                 fmt::join(names, ", ")));
  }
  const simulate::Scene scene = is_model ? simulate::scene_from_meshes(exporters::read_meshes(state.scene), state.scene)
                                         : simulate::make_scene(state.scene, options.seed);
  // A session is not continued with another version of the model.
  const std::string model = is_model ? fmt::format("# model: {}\n", fingerprint(read_file(state.scene))) : "";
  const simulate::SimulatedPath path = simulate::make_path(scene, options);
  spdlog::info(
      "{}: path '{}', {:.1f} m in {:.1f} s{}", scene.name, path.name, path.length, path.seconds,
      path.length > 0 ? fmt::format(", {:.2f} m/s on average (slower in turns)", path.length / path.seconds) : "");
  if (options.frames / options.rate > path.seconds + 1 && path.length > 0) {
    spdlog::warn("the path is shorter than {} frames: the camera rests at its end", options.frames);
  }
  with_threads(state.arguments.threads(), [&] {
    exporters::write_session(state.out, scene, options, state.arguments.options.library.mapping,
                             fmt::format("# iris simulate {} (version {})\n", state.scene, IRIS_VERSION) + model +
                                 state.arguments.set.to_toml({"simulate", "mapping"}),
                             state.arguments.control());
  });
  spdlog::info("{0}: reconstruct it with 'iris run {0} -o OUT', then compare with 'iris evaluate OUT --truth {0}'",
               state.out);
  return kGood;
}

}  // namespace

Command add_simulate(CLI::App& program) {
  CLI::App* command = program.add_subcommand(
      "simulate", "Renders a recorded session of a made-up place, with the truth beside it (SESSION/truth).");
  auto state = std::make_shared<Simulate>(*command);
  command
      ->add_option("SCENE", state->scene,
                   fmt::format("{}; or a mesh file (OBJ, PLY, glTF, …)", fmt::join(simulate::scene_names(), ", ")))
      ->required();
  command->add_option("-o,--output", state->out, "Session to write, in the layout of EuRoC")
      ->type_name("SESSION")
      ->check(kNotEmpty)
      ->required();
  return [state] { return run(*state); };
}

}  // namespace iris::app
