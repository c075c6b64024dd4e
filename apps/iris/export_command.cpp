// iris export OUT --only map,octree,…: writes products again from a finished run.
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <memory>
#include <set>

#include "apps/iris/command.h"
#include "export/view_exports.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"

namespace iris::app {
namespace {

struct Export {
  explicit Export(CLI::App& command)
      : arguments(command, {"mapping", "map", "sheet", "octree", "cloud", "mesh", "scene", "tour"}) {}
  std::string out;
  std::vector<std::string> only;
  Arguments arguments;
};

// The names people use on the command line, and the stages that make them.
struct Product {
  std::string name, stage;
  bool part_of_run = true;  // others are written only if asked for
};
const std::vector<Product> kProducts = {{"trajectory", "trajectory"},
                                        {"map", "map"},
                                        {"octree", "octree"},
                                        {"cloud", "cloud"},
                                        {"mesh", "mesh"},
                                        {"gltf", "scene"},
                                        {"report", "report"},
                                        {"colmap", "colmap", false},
                                        {"nerfstudio", "nerfstudio", false}};

std::vector<std::string> product_names() {
  std::vector<std::string> names;
  for (const Product& product : kProducts) names.push_back(product.name);
  return names;
}

// Those that were asked for, in order, with what they are made from; what is finished will not be written again.
std::vector<pipeline::Stage> wanted_stages(std::vector<pipeline::Stage> stages, const std::vector<std::string>& only,
                                           const workspace::Workspace& workspace) {
  std::set<std::string> names;
  for (const Product& product : kProducts) {
    const bool asked = std::find(only.begin(), only.end(), product.name) != only.end();
    if (asked || (only.empty() && product.part_of_run)) names.insert(product.stage);
  }
  if (workspace.stage("report")) names.insert("report");  // it is to tell of what is there now
  for (auto stage = stages.rbegin(); stage != stages.rend(); ++stage) {
    if (stage->name != "report" && names.contains(stage->name)) names.insert(stage->after.begin(), stage->after.end());
  }
  std::vector<pipeline::Stage> wanted;
  for (pipeline::Stage& stage : stages) {
    if (!names.contains(stage.name)) continue;
    // The report of an unfinished run tells of what there is.
    std::erase_if(stage.after,
                  [&](const std::string& name) { return !names.contains(name) && !workspace.stage(name); });
    wanted.push_back(std::move(stage));
  }
  return wanted;
}

int run(Export& state) {
  const std::vector<std::string> known = product_names();
  for (const std::string& name : state.only) {
    if (std::find(known.begin(), known.end(), name) != known.end()) continue;
    throw UsageError(fmt::format("--only {}: unknown; choose from {}", name, fmt::join(known, ", ")));
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
  saved_set.read_saved_toml(workspace.folder() / "options.toml");
  std::vector<pipeline::Stage> stages = exporters::product_stages(state.arguments.options, saved_set);
  for (pipeline::Stage& stage : exporters::view_export_stages()) stages.push_back(std::move(stage));
  const std::vector<pipeline::Stage> wanted = wanted_stages(std::move(stages), state.only, workspace);
  for (const pipeline::Stage& stage : wanted) {
    for (const OptionSet::Option& option : state.arguments.set.options()) {
      const std::string section = option.name.substr(0, option.name.find('.'));
      if (std::find(stage.sections.begin(), stage.sections.end(), section) != stage.sections.end()) {
        saved_set.set(option.name, to_text(option));
      }
    }
  }
  with_threads(state.arguments.threads(),
               [&] { pipeline::run_stages(wanted, state.arguments.set, workspace, state.arguments.control()); });
  write_options(workspace.folder(), saved_set);
  return kGood;
}

}  // namespace

Command add_export(CLI::App& program) {
  CLI::App* command = program.add_subcommand(
      "export", "Writes products of a finished run again, with other options; or its views for COLMAP and nerfstudio.");
  auto state = std::make_shared<Export>(*command);
  command->add_option("OUT", state->out, "Output folder of a run")->required();
  command->add_option("--only", state->only, "What to write; default: everything but colmap, nerfstudio and the tour")
      ->type_name(fmt::format("{}", fmt::join(product_names(), ",")))
      ->delimiter(',');
  return [state] { return run(*state); };
}

}  // namespace iris::app
