#include "export/tour_files.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>

#include "export/frame_folder.h"
#include "export/mesh_file.h"
#include "export/tour_moments.h"
#include "export/tour_picture.h"
#include "export/video_file.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/pipeline/frames.h"
#include "iris/render/refine.h"
#include "iris/tour/frames.h"
#include "iris/tour/path_file.h"
#include "iris/tour/scene.h"
#include "iris/tour/walk.h"

namespace iris::exporters {
namespace fs = std::filesystem;
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using pipeline::RunControl;
using workspace::Poses;
using workspace::Workspace;

constexpr size_t kCache = size_t{256} << 20;

// Where nothing was measured (a recording of bare walls): the distance at which a stereo camera sees well.
double depth_or_usual(const views::ViewStore& views) {
  constexpr double kUsualDepth = 20;  // [baselines]
  const views::ViewSummary& first = views.summaries().front();
  const double depth = tour::scene_depth(views, first.submap);
  return depth > 0 ? depth : kUsualDepth * first.camera.baseline;
}

// What a tour needs to know of the run.
struct Scene {
  std::unique_ptr<views::ViewStore> stored;
  std::unique_ptr<views::ViewStore> views;  // what pictures are made from; refers to those stored
  int submap = 0;
  PoseGraph graph;
  std::vector<PoseNode> nodes;  // of the sub-map
  std::optional<mapping::MapRaster> raster;
};

Scene open_scene(const Workspace& workspace, const render::DsnvOptions& options) {
  Scene scene;
  scene.submap = pipeline::summarise_frames(workspace, Poses::refined).largest_submap;
  scene.stored = workspace.views(Poses::refined, scene.submap, kCache);
  scene.views = std::make_unique<render::RefinedViewStore>(*scene.stored, options, kCache);
  IRIS_CHECK(!scene.views->summaries().empty());
  scene.graph = workspace.pose_graph(Poses::refined);
  for (const PoseNode& node : scene.graph.nodes) {
    if (node.submap == scene.submap) scene.nodes.push_back(node);
  }
  return scene;
}

std::string text_of(const Vector2d& point) { return fmt::format("{:.2f},{:.2f}", point.x(), point.y()); }

// The largest of three quarters, half and a quarter of the clearance with which the walk is possible, as an advice.
std::string smaller_clearance(const tour::FreeSpace& space, const std::vector<Vector2d>& stops,
                              tour::TourOptions options) {
  const double whole = options.clearance;
  for (const double part : {0.75, 0.5, 0.25}) {
    // As it is printed, so that the advice is what was tried.
    const std::string text = fmt::format("{:.3g}", part * whole);
    options.clearance = std::stod(text);
    if (tour::plan_walk(space, stops, options).status == tour::WalkStatus::ok) {
      return fmt::format("; with --tour.clearance {} there is a way", text);
    }
  }
  return "";
}

// Says why a walk is not possible, where one could go, and with which smaller clearance it would be.
[[noreturn]] void report(const tour::WalkPlan& plan, const tour::FreeSpace& space, const std::vector<Vector2d>& stops,
                         const tour::TourOptions& options) {
  const auto stop = static_cast<size_t>(plan.stop_idx);
  if (plan.status == tour::WalkStatus::not_free) {
    const char* where = plan.state == mapping::MapState::occupied  ? "lies in a wall or another obstacle"
                        : plan.state == mapping::MapState::unknown ? "lies where the map knows nothing"
                                                                   : "is too near to something";
    throw UsageError(fmt::format("{} {}; {}{}", text_of(stops[stop]), where,
                                 plan.nearest ? "the nearest place to stand is " + text_of(*plan.nearest)
                                              : "the map has no place with so much clearance",
                                 smaller_clearance(space, stops, options)));
  }
  throw UsageError(fmt::format(
      "there is no way from {} to {} that keeps {} m from walls and from what the map does not know "
      "(tour.clearance){}{}",
      text_of(stops[stop - 1]), text_of(stops[stop]), options.clearance,
      plan.nearest ? "; one gets as far as " + text_of(*plan.nearest) : "", smaller_clearance(space, stops, options)));
}

// Whether more than half of a picture has no source.
bool mostly_nothing(const NovelView& view) {
  return cv::countNonZero(view.source < 0) > static_cast<int>(view.source.total() / 2);
}

struct Planned {
  CameraPath path;
  std::vector<tour::Caption> captions;
};

Planned plan(const TourRequest& request, const Scene& scene, tour::TourOptions& options) {
  if (request.path == "along") {
    return {recorded_tour(scene.nodes, *scene.views, options), {}};
  }
  if (request.path == "follow" || request.path == "fixed") {
    const double distance = options.distance > 0 ? options.distance : depth_or_usual(*scene.views);
    return {tour::follow(scene.nodes, options, distance, request.path == "fixed"), {}};
  }
  if (request.path == "walk") {
    if (request.stops.size() < 2) throw UsageError("a walk wants --from X,Y and --to X,Y");
    const tour::FreeSpace space(*scene.raster);
    const tour::WalkPlan plan = tour::plan_walk(space, request.stops, options);
    if (plan.status != tour::WalkStatus::ok) report(plan, space, request.stops, options);
    double length = 0;
    for (size_t i = 1; i < plan.points.size(); ++i) length += (plan.points[i] - plan.points[i - 1]).norm();
    if (length < 1e-6) throw UsageError("the walk ends where it begins");
    spdlog::info("walk of {:.2f} m from {} to {}", length, text_of(plan.points.front()), text_of(plan.points.back()));
    return {tour::walk(plan.points, eye_height(scene.nodes, options), options), {}};
  }
  if (request.path == "orbit") {
    tour::LookedAt target;
    if (request.centre) {
      target.point = *request.centre;
      std::vector<double> distances;
      for (const PoseNode& node : scene.nodes) {
        distances.push_back((node.world_from_cam.translation() - target.point).norm());
      }
      std::nth_element(distances.begin(), distances.begin() + static_cast<ptrdiff_t>(distances.size() / 4),
                       distances.end());
      target.distance = distances[distances.size() / 4];
    } else {
      const auto found = tour::most_looked_at(*scene.views, scene.submap);
      if (!found) throw UsageError("no view has disparities in its middle: give --centre X,Y,Z");
      target = *found;
    }
    const tour::FreeSpace space(*scene.raster);
    const double height = eye_height(scene.nodes, options);
    const double level =
        std::sqrt(std::max(std::pow(target.distance, 2) - std::pow(height - target.point.z(), 2), 0.01));
    const double radius = options.radius > 0 ? options.radius : tour::free_radius(space, target.point.head<2>(), level);
    spdlog::info("orbit about {:.2f},{:.2f},{:.2f} with a radius of {:.2f} m", target.point.x(), target.point.y(),
                 target.point.z(), radius);
    const CameraPath path =
        tour::orbit(target.point, radius, height, scene.nodes.front().world_from_cam.translation(), options);
    if (const tour::Standing standing = tour::standing(space, path, options); standing.blocked > 0) {
      spdlog::warn("{} of {} frames stand where the map is not free, the first of them frame {}; see tour.radius",
                   standing.blocked, tour::frame_count(path, options), standing.first);
    }
    return {path, {}};
  }
  if (request.path == "panorama") {
    if (request.at.size() > 1) throw UsageError("a turning panorama stands at one place: give one --at X,Y");
    Vector3d position = scene.nodes[scene.nodes.size() / 2].world_from_cam.translation();
    if (!request.at.empty()) position.head<2>() = request.at.front();
    position.z() = eye_height(scene.nodes, options);
    const Vector3d forward = scene.nodes.front().world_from_cam.linear().col(2);
    return {tour::turn_around(position, std::atan2(forward.y(), forward.x()), options), {}};
  }
  const auto given = [&](const char* name) { return request.given.contains(name); };
  tour::TourOptions reading = options;
  // The length of the run's own tour says nothing about another path.
  if (!given("seconds")) reading.seconds = 0;
  tour::CameraPathFile file = tour::read_camera_path_file(request.path, reading);
  if (file.projection != Projection::pinhole) {
    throw InputError(request.path, "asks for equirectangular pictures, tours are made with perspective ones",
                     "set \"camera_type\" to perspective");
  }
  if (file.width > 0 && file.height > 0) {
    // H.264 in its common form has even sides.
    if (!given("width")) options.width = file.width & ~1;
    if (!given("height")) options.height = file.height & ~1;
  }
  if (file.fps > 0 && !given("fps")) options.fps = file.fps;
  if (given("ease")) file.path.ease = options.ease;
  if (given("fov")) {
    for (CameraKeyframe& key : file.path.keyframes) key.fov = options.fov * std::numbers::pi / 180;
  }
  return {file.path, file.captions};
}

// The numbers of a pose, to the last bit.
std::string exact(const Pose& pose) {
  std::string text;
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 4; ++column) text += fmt::format("{:a} ", pose(row, column));
  }
  return text;
}

// Everything that the pictures depend on.
std::string fingerprint_of(const Workspace& workspace, RunOptions options, const tour::TourOptions& used,
                           const TourRequest& request, const Planned& planned) {
  options.library.tour = used;
  OptionSet set;
  options.declare(set);
  std::string text = std::string("iris " IRIS_VERSION "\n") + workspace.stage("loop")->fingerprint + "\n" +
                     set.text_of({"render", "tour", "mapping"});
  if (request.dynamic) text += "dynamic\n" + set.text_of({"session", "stereo"});
  if (!request.robot.empty()) text += "robot " + fingerprint(read_file(request.robot)) + "\n";
  text += fmt::format("{} {:a}\n", static_cast<int>(planned.path.interpolation), planned.path.ease);
  for (const CameraKeyframe& key : planned.path.keyframes) {
    text += fmt::format("{:a} {:a} {}\n", key.t, key.fov, exact(key.world_from_cam));
  }
  for (const tour::Caption& caption : planned.captions) text += fmt::format("{:a} {}\n", caption.t, caption.text);
  return fingerprint(text);
}

// tour.json: for resuming, and for who wants to know where each frame was taken.
nlohmann::json description_of(const std::string& fingerprint, const CameraPath& path,
                              const std::vector<PoseNode>& nodes, const tour::TourOptions& options,
                              const cv::Size& size) {
  nlohmann::json frames = nlohmann::json::array();
  for (int i = 0; i < tour::frame_count(path, options); ++i) {
    const tour::TourFrame frame = tour::tour_frame(path, nodes, options, i);
    std::vector<double> matrix;
    for (int row = 0; row < 4; ++row) {
      for (int column = 0; column < 4; ++column) {
        matrix.push_back(frame.camera.world_from_cam.matrix()(row, column));
      }
    }
    frames.push_back({{"t", frame.seconds}, {"f", frame.camera.f}, {"world_from_camera", matrix}});
  }
  return {{"fingerprint", fingerprint},
          {"about", "camera: x right, y down, z forward; world z up, m; f and sizes in pixels of the novel view"},
          {"fps", options.fps},
          {"width", options.width},
          {"height", options.height},
          {"picture_width", size.width},
          {"picture_height", size.height},
          {"frames", frames}};
}

void write_video(const fs::path& path, const FrameFolder& folder, int first, int end, const cv::Size& size, double fps,
                 const RunControl& control) {
  VideoWriter writer(path, size.width, size.height, fps);
  Progress progress(control.progress, "video", end - first);
  for (int i = first; i < end; ++i) {
    if (control.stopped()) throw Interrupted();
    const cv::Mat3b image = folder.read(i);
    if (image.size() != size) {
      throw InputError(folder.frame(i), "has another size than the tour", "remove it and give the same command again");
    }
    writer.add(image);
    progress.update(i - first + 1);
  }
  writer.close();
}

}  // namespace

double eye_height(const std::vector<PoseNode>& nodes, const tour::TourOptions& options) {
  if (options.eye >= 0) return options.eye;
  std::vector<double> heights;
  for (const PoseNode& node : nodes) heights.push_back(node.world_from_cam.translation().z());
  const auto middle = heights.begin() + static_cast<ptrdiff_t>(heights.size() / 2);
  std::nth_element(heights.begin(), middle, heights.end());
  return *middle;
}

mapping::MapRaster tour_map(const Workspace& workspace, const RunOptions& options, const views::ViewStore& views,
                            const RunControl& control) {
  const int count = static_cast<int>(views.summaries().size());
  const views::ViewSummary& first = views.summaries().front();
  const mapping::FlogOptions mapping = map_options(workspace, options, first.submap);
  mapping::FlogBuilder builder(mapping, first.camera);
  Progress progress(control.progress, "map", count);
  for (int i = 0; i < count; ++i) {
    if (control.stopped()) throw Interrupted();
    builder.add(*views.load(i));
    progress.update(i + 1);
  }
  return mapping::rasterise(builder.map(), mapping);
}

TourResult write_tour(const Workspace& workspace, const RunOptions& options, const TourRequest& request,
                      const RunControl& control) {
  const bool video = is_video_name(request.output);
  Scene scene = open_scene(workspace, options.library.render);
  tour::TourOptions tour_options = options.library.tour;
  if (request.path == "walk" || request.path == "orbit" || tour_options.layout != "plain") {
    scene.raster = tour_map(workspace, options, *workspace.views(Poses::refined, scene.submap, 0), control);
  }
  const Planned planned = plan(request, scene, tour_options);
  if (request.preview) {
    tour_options.width = std::max(16, tour_options.width / 8 * 2);
    tour_options.height = std::max(16, tour_options.height / 8 * 2);
  }
  const CameraPath& path = planned.path;
  const int frames = tour::frame_count(path, tour_options);
  const int end = request.end_frame < 0 ? frames : request.end_frame;
  if (request.first_frame < 0 || request.first_frame >= end || end > frames) {
    throw UsageError(
        fmt::format("--frames {}:{}: the tour has the frames 0 to {}", request.first_frame, end, frames - 1));
  }

  tour::TourExtras extras;
  if (!request.robot.empty()) {
    extras.robot = read_meshes(request.robot);
    for (TriangleMesh& mesh : extras.robot) {
      for (Eigen::Vector3f& vertex : mesh.vertices) vertex *= static_cast<float>(tour_options.robot_scale);
    }
  }
  const TourPicture picture(tour_options, scene.raster ? &*scene.raster : nullptr, scene.graph, scene.submap,
                            scene.views->summaries().front().camera, planned.captions, path);

  const std::string fingerprint = fingerprint_of(workspace, options, tour_options, request, planned);
  fs::path work = request.output;
  if (video) {
    work = request.frames;
    if (work.empty()) work = fs::path(request.output) += ".frames";
  }
  const FrameFormat format{.jpeg = !video && tour_options.frame_format == "jpeg",
                           .depth_png = tour_options.depth == "png" || tour_options.depth == "both",
                           .depth_exr = tour_options.depth == "exr" || tour_options.depth == "both"};
  const fs::path depth_folder =
      video ? request.output.parent_path() / (request.output.stem().string() + "_depth") : fs::path();
  const bool depth = format.depth_png || format.depth_exr;
  if (video && depth && fs::exists(depth_folder) && !fs::exists(depth_folder / "tour.json")) {
    throw InputError(depth_folder, "is in the way of the depth images", "remove it, or choose another output");
  }
  const nlohmann::json description = description_of(fingerprint, path, scene.nodes, tour_options, picture.size());
  const FrameFolder folder(work, description, format);

  for (int i = request.first_frame; i < end; ++i) {
    if (!folder.has(i)) extras.frames.push_back(i);
  }
  TourResult result{.frames = end - request.first_frame, .rendered = static_cast<int>(extras.frames.size())};
  int done = result.frames - result.rendered;
  if (done > 0) spdlog::info("{}: {} of {} frames are there already", work.string(), done, result.frames);
  if (result.rendered > 0) {
    const std::unique_ptr<Moments> moments = request.dynamic
                                                 ? open_moments(workspace, options, scene.nodes, *scene.views)
                                                 : stored_moments(scene.nodes, *scene.views);
    if (request.dynamic) extras.moment = [&](int64_t stamp_ns) { return moments->view(stamp_ns); };
    int empty = 0;
    Progress progress(control.progress, "tour", result.frames);
    progress.update(done);
    tour::render_tour(
        path, scene.nodes, *scene.views, tour_options, options.library.render,
        [&](int frame_idx, int, const NovelView& view) {
          if (control.stopped()) throw Interrupted();
          empty += mostly_nothing(view);
          const tour::TourFrame frame = tour::tour_frame(path, scene.nodes, tour_options, frame_idx);
          const cv::Mat image = tour_options.layout == "plain" ? cv::Mat() : moments->view(frame.stamp_ns)->image;
          folder.write(frame_idx, picture.compose(frame, tour::eased_time(path, frame.seconds), view, image),
                       view.depth);
          progress.update(++done);
        },
        extras);
    // A few are usual, at the ends of a path.
    constexpr int kMany = 10;  // one in so many
    if (empty * kMany > result.rendered) {
      spdlog::warn("{} of {} pictures show mostly nothing: {}", empty, result.rendered,
                   request.dynamic ? "the recording camera did not look there at these moments"
                                   : "the recording never looked there");
    }
  }
  if (video) {
    write_video(request.output, folder, request.first_frame, end, picture.size(), tour_options.fps, control);
    if (depth && !request.keep_frames) {
      // Killed meanwhile, the next call moves the rest.
      const FrameFolder depths(depth_folder, description, {});
      for (const auto& entry : fs::directory_iterator(work / "depth")) {
        fs::rename(entry.path(), depths.path() / entry.path().filename());
      }
    }
    if (!request.keep_frames) FrameFolder::remove(work);
  }
  return result;
}

CameraPath recorded_tour(const std::vector<PoseNode>& nodes, const views::ViewStore& views,
                         const tour::TourOptions& options) {
  return tour::along(nodes, options, depth_or_usual(views));
}

void write_run_tour(const Workspace& workspace, const RunOptions& options, const RunControl& control) {
  const fs::path folder = workspace.folder() / "tour";
  TourRequest request{.output = folder / "tour.mp4", .frames = folder / "frames", .keep_frames = true};
  // All but what an interrupted run can go on with.
  std::error_code ignored;
  if (!fs::exists(request.frames / "tour.json")) fs::remove_all(folder, ignored);
  write_tour(workspace, options, request, control);
}

}  // namespace iris::exporters
