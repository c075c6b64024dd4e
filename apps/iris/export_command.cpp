// iris export OUT --only map,octree,…: writes products again from a finished run.
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <memory>

#include "apps/iris/command.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"

namespace iris::app {
namespace {

struct Export {
  explicit Export(CLI::App& command) : arguments(command, {"mapping", "map", "sheet", "octree", "scene"}) {}
  std::string out;
  std::vector<std::string> only;
  Arguments arguments;
};

// The names people use on the command line, and the stages that make them.
const std::vector<std::pair<std::string, std::string>> kProducts = {
    {"map", "map"}, {"octree", "octree"}, {"gltf", "scene"}, {"trajectory", "trajectory"}};

int run(Export& state) {
  for (const std::string& name : state.only) {
    const bool known = std::any_of(kProducts.begin(), kProducts.end(), [&](const auto& p) { return p.first == name; });
    if (!known) throw UsageError(fmt::format("--only {}: unknown; choose from map, octree, gltf, trajectory", name));
  }
  auto workspace = workspace::Workspace::open(state.out);
  state.arguments.resolve(workspace.folder() / "options.toml");
  if (!workspace.stage("loop")) {
    throw InputError(state.out, "its run is not finished", "finish it first with the same 'iris run' command");
  }
  std::vector<pipeline::Stage> wanted;
  for (pipeline::Stage& stage : exporters::product_stages(state.arguments.options)) {
    for (const auto& [product, name] : kProducts) {
      if (name != stage.name) continue;
      if (state.only.empty() || std::find(state.only.begin(), state.only.end(), product) != state.only.end()) {
        wanted.push_back(stage);
      }
    }
  }
  with_threads(state.arguments.threads(),
               [&] { pipeline::run_stages(wanted, state.arguments.set, workspace, state.arguments.control()); });

  // What was not written again still stands on the options of its own run.
  exporters::RunOptions saved;
  OptionSet saved_set;
  saved.declare(saved_set);
  saved_set.read_toml(workspace.folder() / "options.toml");
  for (const pipeline::Stage& stage : wanted) {
    for (const OptionSet::Option& option : state.arguments.set.options()) {
      const std::string section = option.name.substr(0, option.name.find('.'));
      if (std::find(stage.sections.begin(), stage.sections.end(), section) != stage.sections.end()) {
        saved_set.set(option.name, to_text(option));
      }
    }
  }
  write_options(workspace.folder(), saved_set);
  return kGood;
}

}  // namespace

Command add_export(CLI::App& program) {
  CLI::App* command = program.add_subcommand(
      "export", "Writes maps, octree, scene or trajectories of a finished run again, with other options.");
  auto state = std::make_shared<Export>(*command);
  command->add_option("OUT", state->out, "Output folder of a run")->required();
  command->add_option("--only", state->only, "What to write; default: everything")
      ->type_name("map,octree,gltf,trajectory")
      ->delimiter(',');
  return [state] { return run(*state); };
}

}  // namespace iris::app
