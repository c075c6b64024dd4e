#include "export/panorama_tour.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>

#include "export/frame_folder.h"
#include "export/html.h"
#include "export/tour_files.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/pipeline/frames.h"
#include "iris/render/refine.h"
#include "iris/render/source_selection.h"

namespace iris::exporters {
namespace fs = std::filesystem;
namespace {

using Eigen::Vector2d;
using nlohmann::json;
using workspace::Poses;
using workspace::Workspace;

constexpr const char* kServer = "https://cdn.jsdelivr.net/npm/pannellum@2.5.6/build/";

constexpr const char* kStyle = R"(<style>
html, body { margin: 0; height: 100%; background: #202020; }
#panorama { width: 100%; height: 100%; }
#message { position: absolute; inset: 0; display: none; place-content: center; padding: 2em; text-align: center;
           font: 16px sans-serif; color: #fff; }
</style>)";

constexpr const char* kBody = R"(<div id="panorama"></div>
<div id="message"></div>
<script>
"use strict";
const config = @CONFIG@;
const images = @IMAGES@;
function tell(text) {
  const box = document.getElementById("message");
  box.textContent = text;
  box.style.display = "grid";
}
for (const [name, text] of Object.entries(images)) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  config.scenes[name].panorama = URL.createObjectURL(new Blob([bytes], {type: "image/jpeg"}));
}
if (typeof pannellum === "undefined") {
  tell("Pannellum could not be loaded. Without a network, give its folder to iris tour with --pannellum.");
} else if (location.protocol === "file:" && Object.keys(images).length === 0) {
  tell("Browsers load these pictures from a server only. Start one here (python3 -m http.server) and open " +
       "http://localhost:8000, or make one page that holds everything: iris tour ... -o tour.html");
} else {
  window.viewer = pannellum.viewer("panorama", config);
}
</script>
)";

void replace(std::string& text, const std::string& what, const std::string& by) {
  const size_t at = text.find(what);
  IRIS_CHECK(at != std::string::npos);
  text.replace(at, what.size(), by);
}

// Text inside <script>: nothing may look like its end.
std::string in_script(std::string text) {
  for (size_t at = 0; (at = text.find("</", at)) != std::string::npos; at += 3) text.replace(at, 2, "<\\/");
  return text;
}

struct Pannellum {
  std::string script, style;
};

Pannellum read_pannellum(const fs::path& folder) {
  for (const char* name : {"pannellum.js", "pannellum.css"}) {
    if (!fs::exists(folder / name)) {
      throw InputError(folder / name, "is not there",
                       "give --pannellum the folder 'build' of the npm package pannellum (npm install pannellum)");
    }
  }
  return {read_file(folder / "pannellum.js"), read_file(folder / "pannellum.css")};
}

std::string page(const std::string& title, const json& config, const json& images, const std::string& style,
                 const std::string& script) {
  std::string body = kBody;
  // What is put in first is not searched again for the later one: the large one comes last.
  replace(body, "@CONFIG@", in_script(config.dump(1)));
  replace(body, "@IMAGES@", images.dump());
  return html::document(title, style + "\n" + kStyle + "\n" + script, body);
}

std::vector<Vector2d> places_of(const PanoramaRequest& request, const tour::FreeSpace& space,
                                const std::vector<PoseNode>& nodes, const RunOptions& options) {
  if (request.at.empty()) {
    std::vector<Vector2d> places = tour::panorama_places(space, nodes, options.panorama);
    // A map without any free cell: the path is all that is known.
    if (places.empty()) places.push_back(nodes.front().world_from_cam.translation().head<2>());
    return places;
  }
  for (const Vector2d& place : request.at) {
    if (space.free(place)) continue;
    const auto near = space.nearest(place, options.library.tour.clearance);
    throw UsageError(
        fmt::format("--at {:.2f},{:.2f} lies {}{}", place.x(), place.y(),
                    space.state(place) == mapping::MapState::occupied ? "in a wall or another obstacle"
                                                                      : "where the map knows nothing",
                    near ? fmt::format("; the nearest place to stand is {:.2f},{:.2f}", near->x(), near->y()) : ""));
  }
  return request.at;
}

}  // namespace

json pannellum_config(const std::vector<tour::PanoramaNode>& nodes, const std::vector<std::string>& images,
                      const std::string& title) {
  constexpr double kDegrees = std::numbers::pi / 180;
  constexpr double kBelow = 0.4;  // [m] links lie a little below the eye, not before what one wants to see
  json scenes = json::object();
  for (size_t i = 0; i < nodes.size(); ++i) {
    json spots = json::array();
    for (const int k : nodes[i].links) {
      const Vector2d way = nodes[static_cast<size_t>(k)].position - nodes[i].position;
      // The middle of the panorama looks along x, to its right is -y.
      const double yaw = std::atan2(-way.y(), way.x()) / kDegrees;
      spots.push_back({{"type", "scene"},
                       {"yaw", yaw},
                       {"pitch", -std::atan2(kBelow, way.norm()) / kDegrees},
                       {"text", fmt::format("{} ({:.1f} m)", k + 1, way.norm())},
                       {"sceneId", fmt::format("node{}", k)},
                       {"targetYaw", yaw},
                       {"targetPitch", 0}});
    }
    json scene = {{"type", "equirectangular"},
                  {"title", fmt::format("{}, {} of {}", title, i + 1, nodes.size())},
                  {"panorama", images[i]},
                  {"hotSpots", spots}};
    if (!spots.empty()) scene["yaw"] = spots[0]["yaw"];
    scenes[fmt::format("node{}", i)] = scene;
  }
  return {{"default", {{"firstScene", "node0"}, {"autoLoad", true}, {"sceneFadeDuration", 500}, {"hfov", 100}}},
          {"scenes", scenes}};
}

int write_panorama_tour(const Workspace& workspace, const RunOptions& options, const PanoramaRequest& request,
                        const pipeline::RunControl& control) {
  const bool one_file = request.output.extension() == ".html";
  Pannellum pannellum;
  if (!request.pannellum.empty()) pannellum = read_pannellum(request.pannellum);

  const int submap = pipeline::summarise_frames(workspace, Poses::refined).largest_submap;
  constexpr size_t kCache = size_t{256} << 20;
  const auto stored = workspace.views(Poses::refined, submap, kCache);
  const auto views = std::make_unique<render::RefinedViewStore>(*stored, options.library.render, kCache);
  std::vector<PoseNode> path;
  for (const PoseNode& node : workspace.pose_graph(Poses::refined).nodes) {
    if (node.submap == submap) path.push_back(node);
  }
  const tour::FreeSpace space(tour_map(workspace, options, *views, control));
  const std::vector<tour::PanoramaNode> nodes =
      tour::link_panoramas(space, places_of(request, space, path, options), options.panorama);
  const double eye = eye_height(path, options.library.tour);
  const int width = std::max(64, request.preview ? options.panorama.width / 4 : options.panorama.width) & ~1;

  const std::string title = fs::path(workspace.session_folder()).filename().string();
  json places = json::array();
  std::vector<std::string> images;
  std::string identity = std::string("iris " IRIS_VERSION "\n") + workspace.stage("loop")->fingerprint;
  {
    RunOptions copy = options;
    OptionSet set;
    copy.declare(set);
    identity += set.text_of({"render", "panorama"}) + fmt::format("{} {:a}", width, eye);
  }
  for (size_t i = 0; i < nodes.size(); ++i) {
    const Vector2d& at = nodes[i].position;
    places.push_back({{"position", {at.x(), at.y(), eye}}, {"links", nodes[i].links}});
    images.push_back(fmt::format("{:06}.jpg", i));
    identity += fmt::format(" {:a} {:a}", at.x(), at.y());
  }
  const json config = pannellum_config(nodes, images, title);
  const fs::path work = one_file ? fs::path(request.output) += ".frames" : request.output;
  const FrameFolder folder(work,
                           {{"fingerprint", fingerprint(identity)},
                            {"about", "world z up, m; the middle column of a panorama looks along x, up is z"},
                            {"nodes", places},
                            {"pannellum", config}},
                           {.jpeg = true});

  render::DsnvOptions dsnv = options.library.render;
  dsnv.max_sources = options.panorama.sources;
  Progress progress(control.progress, "panoramas", static_cast<int64_t>(nodes.size()));
  for (size_t i = 0; i < nodes.size(); ++i) {
    if (control.stopped()) throw Interrupted();
    const int index = static_cast<int>(i);
    if (!folder.has(index)) {
      const NovelCamera camera{
          .projection = Projection::equirectangular,
          .width = width,
          .height = width / 2,
          .world_from_cam = tour::looking({nodes[i].position.x(), nodes[i].position.y(), eye}, {1, 0, 0})};
      const auto prepare = [&](int view) { return std::make_shared<render::PreparedSource>(views->load(view), dsnv); };
      const NovelView view = render::render_from_views(camera, views->summaries(), prepare, dsnv);
      folder.write(index, view.image, view.depth);
    }
    progress.update(index + 1);
  }

  if (one_file) {
    json bytes = json::object();
    for (size_t i = 0; i < nodes.size(); ++i) {
      const std::string jpeg = read_file(folder.frame(static_cast<int>(i)));
      bytes[fmt::format("node{}", i)] =
          html::base64({reinterpret_cast<const unsigned char*>(jpeg.data()), jpeg.size()});
    }
    const std::string style = request.pannellum.empty()
                                  ? fmt::format("<link rel=\"stylesheet\" href=\"{}pannellum.css\">", kServer)
                                  : "<style>\n" + pannellum.style + "</style>";
    const std::string script = request.pannellum.empty()
                                   ? fmt::format("<script src=\"{}pannellum.js\"></script>", kServer)
                                   : "<script>\n" + in_script(pannellum.script) + "</script>";
    write_file(request.output, page(title, config, bytes, style, script));
    FrameFolder::remove(work);
  } else {
    const std::string from = request.pannellum.empty() ? kServer : "pannellum/";
    if (!request.pannellum.empty()) {
      write_file(request.output / "pannellum/pannellum.js", pannellum.script);
      write_file(request.output / "pannellum/pannellum.css", pannellum.style);
    }
    write_file(
        request.output / "index.html",
        page(title, config, json::object(), fmt::format("<link rel=\"stylesheet\" href=\"{}pannellum.css\">", from),
             fmt::format("<script src=\"{}pannellum.js\"></script>", from)));
  }
  return static_cast<int>(nodes.size());
}

}  // namespace iris::exporters
