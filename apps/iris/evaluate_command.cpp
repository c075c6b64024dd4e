// iris evaluate OUT|FILE --truth …: how near is it to the truth?
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <filesystem>
#include <memory>

#include "apps/iris/command.h"
#include "export/evaluation.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"

namespace iris::app {
namespace {

struct Evaluate {
  explicit Evaluate(CLI::App& command) : arguments(command, {}) {}
  exporters::EvaluationRequest request;
  std::string estimate, truth, json, plots;
  Arguments arguments;
  const CLI::App* command = nullptr;
};

// An option that would not be looked at is refused instead.
void check_options(const Evaluate& state) {
  const std::vector<std::string> kinds = exporters::compared_kinds(state.request);
  const bool folder = std::filesystem::is_directory(state.estimate);
  const auto given = [&](const char* name) { return state.command->get_option(name)->count() > 0; };
  if (folder && given("--kind")) throw UsageError("--kind is for files; " + state.estimate + " is a folder");
  if (!folder && given("--view")) throw UsageError("--view is for output folders; " + state.estimate + " is a file");
  // The groups of the help and the kinds that they belong to.
  const std::vector<std::pair<std::string, std::string>> groups = {
      {"Trajectories", "trajectory"}, {"Disparities", "disparity"}, {"Maps", "map"}, {"Pictures", "image"}};
  for (const CLI::Option* option : state.command->get_options()) {
    for (const auto& [group, kind] : groups) {
      if (option->get_group() != group || option->count() == 0) continue;
      if (std::find(kinds.begin(), kinds.end(), kind) != kinds.end()) continue;
      throw UsageError(fmt::format("{} is for the kind '{}'; compared {}: {}", option->get_name(), kind,
                                   kinds.size() > 1 ? "are" : "is", fmt::join(kinds, ", ")));
    }
  }
}

int run(Evaluate& state) {
  state.arguments.resolve();
  state.request.estimate = state.estimate;
  state.request.truth = state.truth;
  state.request.plots = state.plots;
  check_options(state);
  with_threads(state.arguments.threads(), [&] {
    const exporters::Evaluation evaluation = exporters::evaluate_files(state.request);
    if (state.json == "-") {
      fmt::print("{}", evaluation.json());
      return;
    }
    if (!state.json.empty()) write_file(state.json, evaluation.json());
    fmt::print("{}", evaluation.text());
  });
  return kGood;
}

}  // namespace

Command add_evaluate(CLI::App& program) {
  CLI::App* command = program.add_subcommand(
      "evaluate",
      "How near a result is to the truth. Of the output of a run: path, stated accuracy, disparities and map, as far "
      "as the truth knows them; of files: trajectories (TUM, KITTI), disparity images, maps of ROS, pictures.");
  auto state = std::make_shared<Evaluate>(*command);
  exporters::EvaluationRequest& request = state->request;
  state->command = command;
  command->add_option("RESULT", state->estimate, "Output folder of a run, or a file")
      ->type_name("OUT|FILE")
      ->required();
  command->add_option("--truth", state->truth, "Session that holds truth/, its truth folder, or a file")
      ->type_name("SESSION|FILE")
      ->required();
  CLI::Option* plots =
      command->add_option("-o,--output", state->plots, "Folder for plots, each as PNG and SVG")->type_name("DIR");
  command->add_option("--json", state->json, "All figures as JSON (lengths in m, angles in deg); - = to the terminal")
      ->type_name("FILE");
  command->add_option("--kind", request.kind, "What a file is; auto = by its name and content")
      ->check(CLI::IsMember({"auto", "trajectory", "disparity", "map", "image"}))
      ->type_name("auto|trajectory|disparity|map|image")
      ->default_str("auto");
  command
      ->add_flag("--with-scale", request.trajectory.with_scale,
                 "Trajectories: align with turn, shift and scale (Sim3) instead of turn and shift (SE3)")
      ->group("Trajectories");
  command
      ->add_option("--truth-scale", request.truth_scale,
                   "Grey levels of the true disparity image a pixel (Tsukuba 16, Cones 4); 0 = 256, for 16-bit images")
      ->check(CLI::Range(0.0, 65536.0))
      ->type_name("X")
      ->default_str("0")
      ->group("Disparities");
  command
      ->add_flag("--round", request.disparity.round,
                 "Round the disparities to whole pixels first, for truth of whole pixels (Tsukuba)")
      ->group("Disparities");
  command
      ->add_option("--border-distance", request.disparity.border_distance,
                   "What lies nearer to a jump of the true disparity counts as at an object's border")
      ->check(CLI::Range(1, 100))
      ->type_name("px")
      ->default_str("9")
      ->group("Disparities");
  command->add_option("--border-jump", request.disparity.border_jump, "True disparities that differ by more are a jump")
      ->check(CLI::Range(0.0, 1000.0))
      ->type_name("px")
      ->default_str("1")
      ->group("Disparities");
  command
      ->add_option("--view", request.views,
                   "Frames whose error pictures are drawn; otherwise first, middle and last view")
      ->type_name("N")
      ->needs(plots)
      ->group("Disparities");
  command->add_option("--tolerance", request.map.tolerance, "Cells match within so many cells of the true plan")
      ->check(CLI::Range(0, 100))
      ->type_name("cells")
      ->default_str("1")
      ->group("Maps");
  command
      ->add_option("--mask", request.mask,
                   "Pictures: image that is 255 where to compare; 'black' = black pixels of the result are holes")
      ->type_name("FILE|black")
      ->group("Pictures");
  return [state] { return run(*state); };
}

}  // namespace iris::app
