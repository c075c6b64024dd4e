// iris measure OUT A B: how far two points of the map are apart, and how sure that is.
#include <fmt/format.h>

#include <cmath>
#include <memory>
#include <nlohmann/json.hpp>
#include <tuple>

#include "apps/iris/command.h"
#include "export/measurement.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/pipeline/frames.h"

namespace iris::app {
namespace {

constexpr const char* kDescription = "How far two points of the map are apart, plus or minus one standard deviation.";

// After the options.
constexpr const char* kExplanation =
    R"(Points are in the world of the map, in metres: x and y as the axes of OUT/map/map_picture.png and of the sheet
show them, z above the floor. 'x,y' means what stands there on the map (the floor if nothing does), and the
distance is horizontal; with 'x,y,z' for both points it is the one in space. Each point is measured anew in the
views that see it; the surface found within --measure.radius counts and is printed.

  iris measure OUT 1.2,0.5 -2,3.75          from wall to wall
  iris measure OUT 1.2,0.5,0.1 1.2,0.5,2.0  a height

The error has two parts: that of the points as their views measured them, which grows with the square of the
distance from the camera, and that of the path between the two views; if one view sees both points, the path does
not matter. 2 of 3 distances are right within it, 9 of 10 within twice of it; most others begin or end at the
border of an object. An error of the calibration itself is not contained: a baseline wrong by 1 % makes every
distance wrong by 1 %.)";

struct Measure {
  explicit Measure(CLI::App& command) : arguments(command, {"measure"}) {}
  std::string out, a, b, json;
  int submap = -1;
  Arguments arguments;
};

nlohmann::ordered_json json_of(const exporters::SeenPoint& p) {
  return {
      {"x", p.in_world.x()}, {"y", p.in_world.y()}, {"z", p.in_world.z()}, {"frame", p.frame_idx}, {"range", p.range}};
}

int run(Measure& state) {
  const exporters::PickedPoint a = exporters::parse_point(state.a), b = exporters::parse_point(state.b);
  const auto workspace = workspace::Workspace::open(state.out, workspace::Workspace::Access::read_only);
  state.arguments.resolve(workspace.folder() / "options.toml");
  if (!workspace.stage("loop")) {
    throw InputError(state.out, "its run is not finished", "finish it first with the same 'iris run' command");
  }
  const auto poses = workspace::Poses::refined;
  const int submap = state.submap >= 0 ? state.submap : pipeline::summarise_frames(workspace, poses).largest_submap;
  const auto worlds = workspace.worlds();
  if (std::none_of(worlds.begin(), worlds.end(), [&](const auto& world) { return world.submap == submap; })) {
    throw UsageError(fmt::format("--submap {}: there is none; 'iris info {}' lists them", submap, state.out));
  }
  // What the map shows: the layers, which begin a usual camera height lower where no floor was found.
  exporters::MeasureOptions options = state.arguments.measure;
  const mapping::FlogOptions mapping = exporters::map_options(workspace, state.arguments.options, submap);
  options.bottom = mapping.bottom, options.top = mapping.bottom + mapping.height, options.low = mapping.bottom - 0.3;
  const auto views = workspace.views(poses, submap, 0);
  const exporters::Measurement m =
      exporters::measure(workspace.pose_graph(poses), *views, a, b, options, workspace.folder().string());
  if (!state.json.empty()) {
    const nlohmann::ordered_json json = {{"a", json_of(m.a)},       {"b", json_of(m.b)},
                                         {"horizontal", m.in_plan}, {"distance", m.distance},
                                         {"sigma", m.sigma},        {"sigma_reconstruction", m.reconstruction},
                                         {"sigma_path", m.path}};
    const std::string text = json.dump(2) + "\n";
    if (state.json == "-") {
      fmt::print("{}", text);
      return kGood;
    }
    write_file(state.json, text);
  }
  for (const auto& [name, point, picked] : {std::tuple("A", m.a, a), std::tuple("B", m.b, b)}) {
    fmt::print("{}         {:.3f}, {:.3f}, {:.3f} m, seen from view {} in {:.2f} m distance\n", name,
               point.in_world.x(), point.in_world.y(), point.in_world.z(), point.frame_idx, point.range);
    const Eigen::Vector2d off = point.in_world.head<2>() - picked.xy;
    const double distance = std::hypot(off.norm(), picked.z ? point.in_world.z() - *picked.z : 0);
    if (distance > options.radius) {
      fmt::print("          {:.2f} m from where it was picked: nothing surer was measured within {:g} m of there\n",
                 distance, options.radius);
    }
  }
  const int digits = m.sigma < 0.002 ? 4 : 3;
  fmt::print("distance  {:.{}f} ± {:.{}f} m{}\n", m.distance, digits, m.sigma, digits, m.in_plan ? ", horizontal" : "");
  fmt::print(
      "          reconstruction ± {:.4f} m, {}\n", m.reconstruction,
      m.a.frame_idx == m.b.frame_idx ? "one view sees both" : fmt::format("path between the views ± {:.4f} m", m.path));
  return kGood;
}

}  // namespace

Command add_measure(CLI::App& program) {
  CLI::App* command = program.add_subcommand("measure", kDescription);
  command->footer(kExplanation);
  auto state = std::make_shared<Measure>(*command);
  command->add_option("OUT", state->out, "Output folder of a run")->required();
  command->add_option("A", state->a, "One point [m]")->type_name("X,Y[,Z]")->required();
  command->add_option("B", state->b, "The other one [m]")->type_name("X,Y[,Z]")->required();
  command
      ->add_option("--submap", state->submap, "The sub-map whose world is meant; default: the largest, that of the map")
      ->check(CLI::Range(0, 1000000))
      ->type_name("N");
  command
      ->add_option("--json", state->json, "The result as JSON (lengths in m); - = to the terminal, instead of the text")
      ->type_name("FILE");
  return [state] { return run(*state); };
}

}  // namespace iris::app
