// iris tour OUT --path along|orbit|walk|panorama|follow|fixed|P.json -o FILE: another tour through a finished run.
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <string_view>

#include "apps/iris/command.h"
#include "export/panorama_tour.h"
#include "export/tour_files.h"
#include "export/video_file.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"

namespace iris::app {
namespace fs = std::filesystem;
namespace {

constexpr std::string_view kKinds[] = {"along", "orbit", "walk", "panorama", "follow", "fixed"};

struct Tour {
  explicit Tour(CLI::App& command) : arguments(command, {"render", "tour", "panorama"}) {}
  std::string out, output, frames, from, to, centre, robot, pannellum;
  std::vector<std::string> via, at;
  exporters::TourRequest request;
  Arguments arguments;
};

// "1.5,-2" or with as many numbers as wanted.
std::vector<double> numbers(const std::string& option, const std::string& text, size_t least, size_t most) {
  std::vector<double> values;
  size_t at = 0;
  bool good = true;
  while (good && at <= text.size()) {
    const size_t end = std::min(text.find(',', at), text.size());
    const std::string part = text.substr(at, end - at);
    char* rest = nullptr;
    values.push_back(std::strtod(part.c_str(), &rest));
    good = !part.empty() && rest == part.c_str() + part.size() && std::isfinite(values.back());
    at = end + 1;
  }
  if (!good || values.size() < least || values.size() > most) {
    throw UsageError(fmt::format("{} {}: {} numbers with commas between them are wanted [m]", option, text, most));
  }
  return values;
}

Eigen::Vector2d point(const std::string& option, const std::string& text) {
  const std::vector<double> values = numbers(option, text, 2, 2);
  return {values[0], values[1]};
}

// "10:20", "10:", ":20".
void set_frames(const std::string& text, exporters::TourRequest& request) {
  const size_t colon = text.find(':');
  const auto part = [&](const std::string& digits, int otherwise) {
    if (digits.empty()) return otherwise;
    if (digits.size() > 8 || digits.find_first_not_of("0123456789") != std::string::npos) {
      throw UsageError("--frames " + text + ": A:B is wanted, the frames from A to before B");
    }
    return std::stoi(digits);
  };
  if (colon == std::string::npos)
    throw UsageError("--frames " + text + ": A:B is wanted, the frames from A to before B");
  request.first_frame = part(text.substr(0, colon), 0);
  request.end_frame = part(text.substr(colon + 1), -1);
}

int run(Tour& state) {
  exporters::TourRequest& request = state.request;
  request.output = state.output;
  if (!request.output.has_filename()) request.output = request.output.parent_path();
  const std::string extension = request.output.extension().string();
  const bool video = exporters::is_video_name(request.output);
  const bool panorama = request.path == "panorama" && !video;
  if (!video && !extension.empty() && !state.output.ends_with('/') && !(panorama && extension == ".html")) {
    throw UsageError("-o " + state.output +
                     ": must end in .mp4 or .webm for a video, in .html for a page of panoramas, or be a folder for "
                     "pictures (no extension, or a slash behind it)");
  }
  if (std::find(std::begin(kKinds), std::end(kKinds), request.path) == std::end(kKinds) && !fs::exists(request.path)) {
    throw UsageError(
        fmt::format("--path {}: is neither a file that exists nor one of {}", request.path, fmt::join(kKinds, ", ")));
  }
  if (!state.frames.empty()) set_frames(state.frames, request);
  if (!state.from.empty()) request.stops.push_back(point("--from", state.from));
  for (const std::string& text : state.via) request.stops.push_back(point("--via", text));
  if (!state.to.empty()) request.stops.push_back(point("--to", state.to));
  if (!request.stops.empty() && request.path != "walk")
    throw UsageError("--from, --via and --to belong to --path walk");
  if (request.path == "walk" && (state.from.empty() || state.to.empty())) {
    throw UsageError("--path walk wants --from X,Y and --to X,Y");
  }
  if (!state.centre.empty()) {
    if (request.path != "orbit") throw UsageError("--centre belongs to --path orbit");
    const std::vector<double> values = numbers("--centre", state.centre, 3, 3);
    request.centre = Eigen::Vector3d(values[0], values[1], values[2]);
  }
  if (!state.at.empty() && request.path != "panorama") throw UsageError("--at belongs to --path panorama");
  for (const std::string& text : state.at) request.at.push_back(point("--at", text));
  if (!state.pannellum.empty() && !panorama) throw UsageError("--pannellum belongs to a tour of panoramas");
  request.robot = state.robot;
  request.given = state.arguments.given("tour");

  auto workspace = workspace::Workspace::open(state.out);
  state.arguments.resolve(workspace.folder() / "options.toml");
  if (!workspace.stage("loop")) {
    throw InputError(state.out, "its run is not finished", "finish it first with the same 'iris run' command");
  }
  with_threads(state.arguments.threads(), [&] {
    if (panorama) {
      const int nodes = exporters::write_panorama_tour(
          workspace, state.arguments.options,
          {.output = request.output, .at = request.at, .preview = request.preview, .pannellum = state.pannellum},
          state.arguments.control());
      spdlog::info("{}: {} panorama{}", state.output, nodes, nodes == 1 ? "" : "s");
      if (state.pannellum.empty()) {
        spdlog::info("the page loads its viewer from the network; with --pannellum DIR it brings it along");
      }
      return;
    }
    const exporters::TourResult result =
        exporters::write_tour(workspace, state.arguments.options, request, state.arguments.control());
    spdlog::info("{}: {} frames", state.output, result.frames);
  });
  return kGood;
}

constexpr const char* kDescription =
    "Renders a tour through a finished run: along the recorded path or along a path of your own. Interrupted, it goes "
    "on with the same command.\n\n"
    "  iris tour OUT --path orbit -o orbit.mp4\n"
    "  iris tour OUT --path walk --from 0,0 --to 4,3 -o walk.webm\n"
    "  iris tour OUT --path panorama -o panoramas/          a page with panoramas to click through (Pannellum)\n"
    "  iris tour OUT --path keys.json -o pictures/\n\n"
    "keys.json, in the world of the run (z up, m; angles in degrees, all but position optional):\n"
    "  {\"fps\": 25, \"fov\": 50, \"interpolation\": \"spline\", \"ease\": 1, \"keyframes\": [\n"
    "    {\"t\": 0, \"position\": [0, 0, 1.4], \"look_at\": [2, 0, 1.2], \"caption\": \"The hall\"},\n"
    "    {\"t\": 4, \"position\": [3, 0, 1.4], \"yaw\": 90, \"pitch\": -10, \"roll\": 0, \"fov\": 60},\n"
    "    {\"t\": 8, \"position\": [3, 2, 1.4], \"quaternion\": [-0.5, 0.5, -0.5, 0.5]}]}\n"
    "or nerfstudio's camera_path.json.";

}  // namespace

Command add_tour(CLI::App& program) {
  CLI::App* command = program.add_subcommand("tour", kDescription);
  auto state = std::make_shared<Tour>(*command);
  command->add_option("OUT", state->out, "Output folder of a run")->required();
  command
      ->add_option("--path", state->request.path,
                   "along: behind the recording camera; orbit: round a point; walk: through the map's free space; "
                   "panorama: turning on the spot (video), or a page of panoramas (folder, .html); follow, fixed: from "
                   "beside the recording camera (tour.swing, tour.rise), moving with it or not; else a file")
      ->type_name("along|orbit|walk|panorama|follow|fixed|P.json")
      ->capture_default_str();
  command
      ->add_option("-o,--output", state->output,
                   "Video (.mp4: H.264, .webm: VP9) or folder for pictures; for panoramas a folder or one .html file")
      ->type_name("FILE|DIR")
      ->check(kNotEmpty)
      ->required();
  command->add_option("--frames", state->frames, "Only the frames from A to before B; either may be left out")
      ->type_name("A:B");
  command->add_option("--from", state->from, "walk: beginning in the map [m]")->type_name("X,Y");
  command->add_option("--via", state->via, "walk: a place on the way; may be given several times")->type_name("X,Y");
  command->add_option("--to", state->to, "walk: end in the map [m]")->type_name("X,Y");
  command->add_option("--centre", state->centre, "orbit: what to look at [m]; default: what most views look at")
      ->type_name("X,Y,Z");
  command
      ->add_option("--at", state->at,
                   "panorama: where it stands [m]; of panoramas several; default: spread over the path")
      ->type_name("X,Y");
  command->add_flag("--preview", state->request.preview, "A quarter of the width and height");
  command->add_flag("--dynamic", state->request.dynamic,
                    "Each frame from the stereo pair of its moment alone, read from the session: for scenes that "
                    "change. With --path follow, fixed or a file");
  command
      ->add_option("--robot", state->robot, "Model to draw at the recording camera (glTF, OBJ, STL, PLY, COLLADA, …)")
      ->type_name("FILE")
      ->check(CLI::ExistingFile);
  command->add_flag("--keep-frames", state->request.keep_frames, "Keep a video's pictures in FILE.frames");
  command
      ->add_option("--pannellum", state->pannellum,
                   "Folder with pannellum.js and pannellum.css, copied into the tour, which then needs no network")
      ->type_name("DIR")
      ->check(CLI::ExistingDirectory);
  return [state] { return run(*state); };
}

}  // namespace iris::app
