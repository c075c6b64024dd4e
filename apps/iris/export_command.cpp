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
    {"map", "map"}, {"octree", "octree"}, {"gltf", "scene"}, {"trajectory", "trajectory"}, {"report", "report"}};

int run(Export& state) {
  for (const std::string& name : state.only) {
    const bool known = std::any_of(kProducts.begin(), kProducts.end(), [&](const auto& p) { return p.first == name; });
    if (!known)
      throw UsageError(fmt::format("--only {}: unknown; choose from map, octree, gltf, trajectory, report", name));
  }
  auto workspace = workspace::Workspace::open(state.out);
  state.arguments.resolve(workspace.folder() / "options.toml");
  if (!workspace.stage("loop")) {
    throw InputError(state.out, "its run is not finished", "finish it first with the same 'iris run' command");
  }
  // What is not written again still stands on the options of its own run.
  exporters::RunOptions saved;
  OptionSet saved_set;
  saved.declare(saved_set);
  saved_set.read_toml(workspace.folder() / "options.toml");
  std::vector<pipeline::Stage> wanted;
  for (pipeline::Stage& stage : exporters::product_stages(state.arguments.options, saved_set)) {
    const auto product =
        std::find_if(kProducts.begin(), kProducts.end(), [&](const auto& p) { return p.second == stage.name; });
    if (product == kProducts.end()) continue;
    // The report is to tell of what is there now.
    const bool report = stage.name == "report" && workspace.stage("report");
    const bool asked = std::find(state.only.begin(), state.only.end(), product->first) != state.only.end();
    if (!state.only.empty() && !asked && !report) continue;
    // Of an unfinished run, what is there.
    std::erase_if(stage.after, [&](const std::string& earlier) {
      return !workspace.stage(earlier) &&
             std::none_of(wanted.begin(), wanted.end(), [&](const auto& other) { return other.name == earlier; });
    });
    for (const OptionSet::Option& option : state.arguments.set.options()) {
      const std::string section = option.name.substr(0, option.name.find('.'));
      if (std::find(stage.sections.begin(), stage.sections.end(), section) != stage.sections.end()) {
        saved_set.set(option.name, to_text(option));
      }
    }
    wanted.push_back(std::move(stage));
  }
  with_threads(state.arguments.threads(),
               [&] { pipeline::run_stages(wanted, state.arguments.set, workspace, state.arguments.control()); });
  write_options(workspace.folder(), saved_set);
  return kGood;
}

}  // namespace

Command add_export(CLI::App& program) {
  CLI::App* command = program.add_subcommand(
      "export", "Writes maps, octree, scene, trajectories or the report of a finished run again, with other options.");
  auto state = std::make_shared<Export>(*command);
  command->add_option("OUT", state->out, "Output folder of a run")->required();
  command->add_option("--only", state->only, "What to write; default: everything")
      ->type_name("map,octree,gltf,trajectory,report")
      ->delimiter(',');
  return [state] { return run(*state); };
}

}  // namespace iris::app
