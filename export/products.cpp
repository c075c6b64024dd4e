#include "export/products.h"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <cstring>
#include <ctime>
#include <filesystem>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <optional>
#include <sstream>

#include "export/cloud_file.h"
#include "export/map_drawing.h"
#include "export/mesh_file.h"
#include "export/report_file.h"
#include "export/tour_files.h"
#include "export/trajectory_file.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/mapping/flog.h"
#include "iris/pipeline/frames.h"

namespace iris::exporters {
namespace fs = std::filesystem;
namespace {

using pipeline::RunControl;
using pipeline::Stage;
using workspace::Poses;
using workspace::Workspace;
using Files = std::vector<std::string>;

// Views kept in memory while they are read one after the other.
constexpr size_t kStreamCache = 0;
// … and while each is compared with those that see the same.
constexpr size_t kFusionCache = size_t{256} << 20;

std::unique_ptr<views::ViewStore> main_views(const Workspace& workspace, size_t cache_bytes) {
  return workspace.views(Poses::refined, pipeline::summarise_frames(workspace, Poses::refined).largest_submap,
                         cache_bytes);
}

Files files_in(const fs::path& out, const char* folder) {
  Files files;
  for (const auto& entry : fs::recursive_directory_iterator(out / folder)) {
    if (entry.is_regular_file()) files.push_back(fs::relative(entry.path(), out).string());
  }
  std::sort(files.begin(), files.end());
  return files;
}

Files write_trajectory(const Workspace& workspace) {
  const fs::path folder = workspace.folder() / "trajectory";
  const PoseGraph graph = workspace.pose_graph(Poses::refined);
  write_tum(folder / "tum.txt", graph);
  write_kitti(folder / "kitti.txt", graph, workspace.frame_count());
  write_g2o(folder / "graph.g2o", graph, workspace.loops());
  write_path_picture(folder / "path.png", workspace.pose_graph(Poses::odometry), graph);
  return files_in(workspace.folder(), "trajectory");
}

// The title block of the sheet.
SheetFacts facts_of(const Workspace& workspace, const mapping::MapRaster& raster, const RectifiedCamera& camera,
                    const PoseGraph& graph, int submap) {
  SheetFacts facts{.title = fs::path(workspace.session_folder()).filename().string(), .date = {}, .lines = {}};
  double length = 0;
  int64_t begin_ns = 0;
  const PoseNode* last = nullptr;
  int poses = 0;
  for (const PoseNode& node : graph.nodes) {
    if (node.submap != submap) continue;
    if (last) {
      length += (node.world_from_cam.translation() - last->world_from_cam.translation()).norm();
    } else {
      begin_ns = node.stamp_ns;
    }
    last = &node;
    ++poses;
  }
  const double cell_area = raster.cell * raster.cell;
  const int occupied = cv::countNonZero(raster.state == static_cast<uint8_t>(mapping::MapState::occupied));
  // Recordings without a clock count from zero.
  constexpr int64_t kYear2000 = 946684800;
  const std::time_t seconds = begin_ns / 1'000'000'000;
  const bool dated = seconds > kYear2000;
  facts.date = fmt::format("{:%Y-%m-%dT%H:%M:%SZ}", fmt::gmtime(dated ? seconds : 0));
  std::string closing = "the path does not come back to itself";
  if (const auto error = closing_error(workspace.pose_graph(Poses::odometry), graph, submap)) {
    // Enough digits for both.
    const bool small = error->error + error->sigma < 0.1;
    const double scale = small ? 1000 : 1;
    closing = fmt::format("{:.{}f} \u00b1 {:.{}f} {}, {:.2g} % of {:.1f} m as chained, {} loop{}", scale * error->error,
                          small ? 1 : 3, scale * error->sigma, small ? 1 : 3, small ? "mm" : "m",
                          100 * error->error / std::max(error->way, 1e-9), error->way, error->loops,
                          error->loops == 1 ? "" : "s");
  }
  facts.lines = {
      {"Session", facts.title},
      {"Recorded", dated ? fmt::format("{:%Y-%m-%d %H:%M} UTC", fmt::gmtime(seconds)) : "date not recorded"},
      {"Camera", fmt::format("{} x {} px, f {:.0f} px, base {:.0f} mm", camera.width, camera.height, camera.f,
                             1000 * camera.baseline)},
      {"Path", fmt::format("{:.2f} m, {} poses", length, poses)},
      {"Closing error", closing},
      {"Explored", fmt::format("{:.1f} m\u00b2", cell_area * cv::countNonZero(raster.known))},
      {"Occupied", fmt::format("{:.1f} m\u00b2", cell_area * occupied)},
      {"Software", "IRIS " IRIS_VERSION},
  };
  if (const std::string text = submap_text(graph, submap); !text.empty()) {
    facts.lines.insert(facts.lines.end() - 1, {"Of the path", text});
  }
  return facts;
}

Files write_maps(const Workspace& workspace, const RunOptions& options, const RunControl& control) {
  const auto views = main_views(workspace, kStreamCache);
  const int count = static_cast<int>(views->summaries().size());
  IRIS_CHECK(count > 0);
  const views::ViewSummary& first = views->summaries().front();
  const mapping::FlogOptions mapping = map_options(workspace, options, first.submap);
  mapping::FlogBuilder builder(mapping, first.camera);
  Progress progress(control.progress, "map", count);
  for (int i = 0; i < count; ++i) {
    if (control.stopped()) throw Interrupted();
    builder.add(*views->load(i));
    progress.update(i + 1);
  }
  const fs::path folder = workspace.folder() / "map";
  const mapping::MapRaster raster = mapping::rasterise(builder.map(), mapping);
  const PoseGraph graph = workspace.pose_graph(Poses::refined);
  std::vector<mapping::MapRaster> layers;
  for (int k = 0; options.map.layers && k < builder.map().layers(); ++k) {
    layers.push_back(layer_raster(raster, k));
  }
  write_map(folder, raster, layers, graph, first.submap, options.map);
  write_sheet(folder, raster, graph, first.submap, facts_of(workspace, raster, first.camera, graph, first.submap),
              options.sheet);
  return files_in(workspace.folder(), "map");
}

// The largest sub-map first; its files have plain names, those of the others name their sub-map.
struct CloudFile {
  int submap;
  fs::path path;  // without extension
};
std::vector<CloudFile> cloud_files(const Workspace& workspace) {
  const int largest = pipeline::summarise_frames(workspace, Poses::refined).largest_submap;
  std::vector<CloudFile> files = {{largest, workspace.folder() / "model/cloud"}};
  for (const workspace::WorldRecord& world : workspace.worlds()) {
    if (world.submap == largest) continue;
    files.push_back({world.submap, workspace.folder() / fmt::format("model/cloud_submap{}", world.submap)});
  }
  return files;
}

Files write_clouds(const Workspace& workspace, const RunOptions& options, const RunControl& control) {
  Files written;
  for (const CloudFile& file : cloud_files(workspace)) {
    const auto views = workspace.views(Poses::refined, file.submap, kFusionCache);
    const PointCloud cloud = fuse_cloud(*views, options.cloud, control);
    fs::path ply = file.path, pcd = file.path;
    write_ply(ply += ".ply", cloud, options.cloud.ascii);
    write_pcd(pcd += ".pcd", cloud);
    written.push_back(fs::relative(ply, workspace.folder()).string());
    written.push_back(fs::relative(pcd, workspace.folder()).string());
  }
  return written;
}

Files write_meshes(const Workspace& workspace, const RunOptions& options, const RunControl& control) {
  Files written;
  const std::vector<std::string> formats = mesh_formats(options.mesh);
  for (const CloudFile& file : cloud_files(workspace)) {
    fs::path ply = file.path;
    const TriangleMesh mesh = surface_of(read_ply(ply += ".ply"), options.mesh, control);
    if (mesh.triangles.empty()) continue;  // nothing but what stands alone
    std::string name = file.path.filename().string();
    name.replace(0, std::strlen("cloud"), "mesh");
    for (const std::string& format : formats) {
      if (control.stopped()) throw Interrupted();
      const fs::path path = workspace.folder() / "model" / (name + "." + format);
      write_mesh(path, mesh);
      written.push_back(fs::relative(path, workspace.folder()).string());
    }
  }
  return written;
}

// map/map.png as its world file places it; nothing if there is none.
std::optional<GroundPicture> ground_picture(const fs::path& folder) {
  const fs::path png = folder / "map.png", world = folder / "map.pgw";
  if (!fs::exists(png) || !fs::exists(world)) return {};
  std::istringstream text(read_file(world));
  double cell = 0, zero = 0, down = 0, x = 0, y = 0;  // x, y: the middle of the upper left pixel
  text >> cell >> zero >> zero >> down >> x >> y;
  if (!text || cell <= 0) throw InputError(world, "is no world file", "write it again: iris export OUT --only map");
  GroundPicture ground{.image = cv::imread(png.string(), cv::IMREAD_COLOR)};
  if (ground.image.empty()) throw InputError(png, "cannot be read", "write it again: iris export OUT --only map");
  ground.width = cell * ground.image.cols;
  ground.height = cell * ground.image.rows;
  ground.x0 = x - cell / 2;
  ground.y0 = y + cell / 2 - ground.height;
  return ground;
}

Files write_scenes(const Workspace& workspace, const RunOptions& options, const RunControl& control) {
  const int largest = pipeline::summarise_frames(workspace, Poses::refined).largest_submap;
  const PoseGraph graph = workspace.pose_graph(Poses::refined);
  std::map<int, std::unique_ptr<views::ViewStore>> stores;
  std::map<int, PointCloud> clouds;
  std::vector<ScenePart> parts;
  for (const CloudFile& file : cloud_files(workspace)) {
    fs::path ply = file.path;
    stores[file.submap] = workspace.views(Poses::refined, file.submap, kFusionCache);
    clouds[file.submap] = read_ply(ply += ".ply");
    ScenePart part{.submap = file.submap, .views = stores[file.submap].get(), .cloud = &clouds[file.submap]};
    if (file.submap == largest && !part.views->summaries().empty()) {
      std::vector<PoseNode> nodes;
      for (const PoseNode& node : graph.nodes) {
        if (node.submap == largest) nodes.push_back(node);
      }
      part.ground = ground_picture(workspace.folder() / "map");
      part.tour = recorded_tour(nodes, *part.views, options.library.tour);
      part.tour_aspect = static_cast<double>(options.library.tour.width) / options.library.tour.height;
    }
    parts.push_back(std::move(part));
  }
  write_scene(workspace.folder() / "model/scene.glb", graph, parts, options.scene, options.cloud,
              fs::path(workspace.session_folder()).filename().string(), control);
  return {"model/scene.glb"};
}

}  // namespace

mapping::FlogOptions map_options(const Workspace& workspace, const RunOptions& options, int submap) {
  constexpr double kUsualCameraHeight = 1;
  mapping::FlogOptions mapping = options.library.mapping;
  for (const workspace::WorldRecord& world : workspace.worlds()) {
    if (world.submap != submap) continue;
    if (!world.floor_found) mapping.bottom -= kUsualCameraHeight;
    return mapping;
  }
  throw Bug(fmt::format("sub-map {} has no world", submap));
}

std::vector<Stage> product_stages(const RunOptions& options, const OptionSet& set) {
  return {
      Stage{.name = "trajectory",
            .sections = {},
            .after = {"loop"},
            .inputs = {},
            .run = [](Workspace& w, const RunControl&, const std::string&) { return write_trajectory(w); }},
      Stage{.name = "map",
            .sections = {"mapping", "map", "sheet"},
            .after = {"loop"},
            .inputs = {},
            .run = [&options](Workspace& w, const RunControl& control,
                              const std::string&) { return write_maps(w, options, control); }},
      Stage{.name = "octree",
            .sections = {"octree"},
            .after = {"loop"},
            .inputs = {},
            .run =
                [&options](Workspace& w, const RunControl& control, const std::string&) {
                  write_octree(w.folder() / "octree", *main_views(w, kStreamCache), options.octree, control);
                  return files_in(w.folder(), "octree");
                }},
      Stage{.name = "cloud",
            .sections = {"cloud"},
            .after = {"loop"},
            .inputs = {},
            .run = [&options](Workspace& w, const RunControl& control,
                              const std::string&) { return write_clouds(w, options, control); }},
      Stage{.name = "mesh",
            .sections = {"mesh"},
            .after = {"cloud"},
            .inputs = {},
            .run = [&options](Workspace& w, const RunControl& control,
                              const std::string&) { return write_meshes(w, options, control); }},
      Stage{.name = "scene",
            .sections = {"cloud", "scene", "tour"},
            .after = {"map", "cloud"},
            .inputs = {},
            .run = [&options](Workspace& w, const RunControl& control,
                              const std::string&) { return write_scenes(w, options, control); }},
      Stage{.name = "tour",
            .sections = {"render", "tour"},
            .after = {"loop"},
            .inputs = {},
            .run =
                [&options](Workspace& w, const RunControl& control, const std::string&) {
                  write_run_tour(w, options, control);
                  return files_in(w.folder(), "tour");
                }},
      Stage{.name = "report",
            .sections = {},
            .after = {"trajectory", "map", "octree", "cloud", "mesh", "scene", "tour"},
            .inputs = {},
            .run =
                [&set](Workspace& w, const RunControl&, const std::string&) {
                  write_report(w, set);
                  return files_in(w.folder(), "report");
                }},
  };
}

}  // namespace iris::exporters
