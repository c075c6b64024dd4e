#include "export/scene_file.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <memory>
#include <set>
#include <vector>

#include "export/gltf_builder.h"
#include "iris/core/error.h"
#include "iris/core/options.h"
#include "iris/core/parallel.h"

namespace iris::exporters {

void SceneOptions::declare(OptionSet& set) {
  set.section("scene");
  set.add("voxel", voxel, "m", 0.001, 10,
          "edge of the cubes that thin the points, one point a cube; smaller shows more detail and makes larger files");
  set.add("max_range", max_range, "m", 0.1, 10000,
          "leaves out points farther than this from their camera; their error grows with the square of the distance");
  set.add("min_disparity", min_disparity, "px", 0.5, 1000,
          "leaves out points of smaller disparity: they are far away and uncertain");
  set.add("max_points", max_points, "", 1000, 50'000'000,
          "at most so many points; with more, the edge of the cubes is doubled until they fit");
}

namespace {

// Weighted sums of the points in each cube. Cubes are kept in the order of their first point; a table with open
// addressing finds them.
class VoxelGrid {
 public:
  struct Cube {
    std::array<int32_t, 3> key;
    double weight = 0;
    Eigen::Vector3d point = Eigen::Vector3d::Zero();   // sum of weight * point
    Eigen::Vector3f colour = Eigen::Vector3f::Zero();  // sum of weight * linear colour
  };

  explicit VoxelGrid(double edge) : edge_(edge), slots_(1 << 10, -1) {}

  void add(const Eigen::Vector3d& point, double weight, const Eigen::Vector3f& colour) {
    std::array<int32_t, 3> key;
    for (int i = 0; i < 3; ++i) key[i] = static_cast<int32_t>(std::floor(point[i] / edge_));
    Cube& cube = at(key);
    cube.weight += weight;
    cube.point += weight * point;
    cube.colour += static_cast<float>(weight) * colour;
  }

  // Cubes of twice the edge: each takes over the sums of the up to eight that it covers.
  void coarsen() {
    edge_ *= 2;
    std::vector<Cube> fine;
    fine.swap(cubes_);
    std::fill(slots_.begin(), slots_.end(), -1);
    for (const Cube& cube : fine) {
      Cube& coarse = at({cube.key[0] >> 1, cube.key[1] >> 1, cube.key[2] >> 1});
      coarse.weight += cube.weight;
      coarse.point += cube.point;
      coarse.colour += cube.colour;
    }
  }

  const std::vector<Cube>& cubes() const { return cubes_; }

 private:
  static size_t hash(const std::array<int32_t, 3>& key) {
    uint64_t h = static_cast<uint32_t>(key[0]) * 0x9E3779B97F4A7C15ull;
    h = (h ^ static_cast<uint32_t>(key[1])) * 0xC2B2AE3D27D4EB4Full;
    h = (h ^ (h >> 29) ^ static_cast<uint32_t>(key[2])) * 0x165667B19E3779F9ull;
    return static_cast<size_t>(h ^ (h >> 32));
  }

  size_t slot_of(const std::array<int32_t, 3>& key) const {
    size_t slot = hash(key) & (slots_.size() - 1);
    while (slots_[slot] >= 0 && cubes_[static_cast<size_t>(slots_[slot])].key != key) {
      slot = (slot + 1) & (slots_.size() - 1);
    }
    return slot;
  }

  Cube& at(const std::array<int32_t, 3>& key) {
    const size_t slot = slot_of(key);
    if (slots_[slot] >= 0) return cubes_[static_cast<size_t>(slots_[slot])];
    slots_[slot] = static_cast<int32_t>(cubes_.size());
    cubes_.push_back({.key = key});
    if (2 * cubes_.size() > slots_.size()) {
      slots_.assign(2 * slots_.size(), -1);
      for (size_t i = 0; i < cubes_.size(); ++i) slots_[slot_of(cubes_[i].key)] = static_cast<int32_t>(i);
    }
    return cubes_.back();
  }

  double edge_;
  std::vector<int32_t> slots_;  // a power of two of them; index of the cube, -1 = free
  std::vector<Cube> cubes_;
};

// Red, green, blue.
Eigen::Vector3f linear_colour(const cv::Mat& image, int y, int x, const std::array<float, 256>& levels) {
  if (image.type() == CV_8UC1) return Eigen::Vector3f::Constant(levels[image.at<uchar>(y, x)]);
  const cv::Vec3b& bgr = image.at<cv::Vec3b>(y, x);
  return {levels[bgr[2]], levels[bgr[1]], levels[bgr[0]]};
}

void add_points(const StereoView& view, const SceneOptions& options, const std::array<float, 256>& levels,
                VoxelGrid& grid) {
  const RectifiedCamera& camera = view.camera;
  IRIS_CHECK(view.image.type() == CV_8UC1 || view.image.type() == CV_8UC3);
  IRIS_CHECK(view.image.size() == view.disparity.disparity.size());
  for (int y = 0; y < view.disparity.disparity.rows; ++y) {
    for (int x = 0; x < view.disparity.disparity.cols; ++x) {
      const float d = view.disparity.at(y, x, DisparityOrigin::within_segment);
      if (d <= 0 || d + camera.disparity_offset < options.min_disparity) continue;
      const Eigen::Vector3d point_in_cam = camera.point(x, y, d);
      const double range = point_in_cam.norm();
      if (range > options.max_range) continue;
      // (4.24) without its constant factor.
      const double error = point_in_cam.z() * range / (camera.f * camera.baseline);
      grid.add(view.world_from_cam * point_in_cam, 1 / (error * error), linear_colour(view.image, y, x, levels));
    }
  }
}

struct ThinnedPoints {
  std::map<int, VoxelGrid> submaps;
  double edge = 0;  // [m]
};

ThinnedPoints thin_points(const views::ViewStore& views, const SceneOptions& options,
                          const pipeline::RunControl& control) {
  ThinnedPoints points{.submaps = {}, .edge = options.voxel};
  const std::array<float, 256> levels = linear_levels();
  const int count = static_cast<int>(views.summaries().size());
  constexpr int kBatch = 8;  // views decoded at the same time; added one after the other, in order
  Progress progress(control.progress, "scene", count);
  for (int begin = 0; begin < count; begin += kBatch) {
    const int end = std::min(begin + kBatch, count);
    std::vector<std::shared_ptr<const StereoView>> batch(static_cast<size_t>(end - begin));
    parallel_chunks(begin, end, 1, [&](int i, int) { batch[static_cast<size_t>(i - begin)] = views.load(i); });
    for (const auto& view : batch) {
      if (control.stopped()) throw Interrupted();
      add_points(*view, options, levels, points.submaps.try_emplace(view->submap, points.edge).first->second);
      const auto total = [&] {
        size_t sum = 0;
        for (const auto& [submap, grid] : points.submaps) sum += grid.cubes().size();
        return sum;
      };
      while (total() > static_cast<size_t>(options.max_points) && points.edge < 1000) {
        for (auto& [submap, grid] : points.submaps) grid.coarsen();
        points.edge *= 2;
      }
    }
    progress.update(end);
  }
  if (points.edge > options.voxel) {
    spdlog::info("scene: cubes of {} m instead of {} m, to stay within scene.max_points = {}", points.edge,
                 options.voxel, options.max_points);
  }
  return points;
}

struct Materials {
  int points, path, cameras;
};

void add_point_node(ModelBuilder& builder, int parent, int material, const VoxelGrid& grid) {
  std::vector<Eigen::Vector3f> positions;
  std::vector<std::array<uint16_t, 4>> colours;
  positions.reserve(grid.cubes().size());
  colours.reserve(grid.cubes().size());
  for (const VoxelGrid::Cube& cube : grid.cubes()) {
    positions.push_back((cube.point / cube.weight).cast<float>());
    const Eigen::Vector3d colour = cube.colour.cast<double>() / cube.weight;
    std::array<uint16_t, 4> levels;
    for (int i = 0; i < 3; ++i) {
      levels[i] = static_cast<uint16_t>(std::lround(std::clamp(colour[i], 0.0, 1.0) * 65535));
    }
    levels[3] = 65535;
    colours.push_back(levels);
  }
  tinygltf::Primitive points = primitive(TINYGLTF_MODE_POINTS, material, builder.add_positions(positions));
  points.attributes["COLOR_0"] = builder.add_colours(colours);
  builder.add_mesh_node(parent, "points", points);
}

void add_path_node(ModelBuilder& builder, int parent, int material, const std::vector<Eigen::Vector3f>& path) {
  builder.add_mesh_node(parent, "path", primitive(TINYGLTF_MODE_LINE_STRIP, material, builder.add_positions(path)));
}

// Pyramids over the image's corners, from the optical centre to the depth of one baseline.
void add_camera_node(ModelBuilder& builder, int parent, int material,
                     const std::vector<const views::ViewSummary*>& views) {
  std::vector<Eigen::Vector3f> positions;
  std::vector<uint32_t> indices;
  for (const views::ViewSummary* view : views) {
    const RectifiedCamera& camera = view->camera;
    const uint32_t apex = static_cast<uint32_t>(positions.size());
    positions.push_back(view->world_from_cam.translation().cast<float>());
    for (uint32_t corner = 0; corner < 4; ++corner) {
      const double x = (corner == 1 || corner == 2 ? camera.width : 0) - 0.5,
                   y = (corner >= 2 ? camera.height : 0) - 0.5;
      const double s = camera.baseline / camera.f;
      const Eigen::Vector3d in_cam(s * (x - camera.cx), s * (y - camera.cy), camera.baseline);
      positions.push_back((view->world_from_cam * in_cam).cast<float>());
      indices.insert(indices.end(), {apex, apex + 1 + corner, apex + 1 + corner, apex + 1 + (corner + 1) % 4});
    }
  }
  tinygltf::Primitive cameras = primitive(TINYGLTF_MODE_LINE, material, builder.add_positions(positions));
  cameras.indices = builder.add_indices(indices);
  builder.add_mesh_node(parent, "cameras", cameras);
}

}  // namespace

void write_scene(const std::filesystem::path& glb, const PoseGraph& graph, const views::ViewStore& views,
                 const SceneOptions& options, const std::string& session_name, const pipeline::RunControl& control) {
  const ThinnedPoints points = thin_points(views, options, control);
  if (control.stopped()) throw Interrupted();
  std::map<int, std::vector<Eigen::Vector3f>> paths;
  std::map<int, std::vector<const views::ViewSummary*>> cameras;
  std::set<int> submaps;
  for (const PoseNode& node : graph.nodes) {
    paths[node.submap].push_back(node.world_from_cam.translation().cast<float>());
    submaps.insert(node.submap);
  }
  for (const views::ViewSummary& view : views.summaries()) {
    cameras[view.submap].push_back(&view);
    submaps.insert(view.submap);
  }

  ModelBuilder builder;
  const Materials materials{.points = builder.add_unlit_material("points", {1, 1, 1}),
                            .path = builder.add_unlit_material("path", {1, 0.2, 0}),
                            .cameras = builder.add_unlit_material("cameras", {0, 0.35, 1})};
  const int world = builder.add_world();

  double right = 0;  // [m] where the next sub-map begins in x
  for (const int submap : submaps) {
    const int node = builder.add_node(world, "submap_" + std::to_string(submap));
    Eigen::AlignedBox3d box;
    const auto grid = points.submaps.find(submap);
    if (grid != points.submaps.end() && !grid->second.cubes().empty()) {
      add_point_node(builder, node, materials.points, grid->second);
      for (const VoxelGrid::Cube& cube : grid->second.cubes()) box.extend(Eigen::Vector3d(cube.point / cube.weight));
    }
    for (const Eigen::Vector3f& p : paths[submap]) box.extend(p.cast<double>());
    for (const views::ViewSummary* view : cameras[submap]) box.extend(view->world_from_cam.translation());
    if (paths[submap].size() >= 2) add_path_node(builder, node, materials.path, paths[submap]);
    if (!cameras[submap].empty()) add_camera_node(builder, node, materials.cameras, cameras[submap]);
    // Side by side, with a gap of one metre.
    if (submap != *submaps.begin()) {
      const double shift = right + 1 - box.min().x();
      builder.model().nodes[static_cast<size_t>(node)].translation = {shift, 0, 0};
      right = box.max().x() + shift;
    } else {
      right = box.max().x();
    }
  }

  tinygltf::Model& model = builder.model();
  if (model.buffers[0].data.empty()) model.buffers.clear();
  model.asset.version = "2.0";
  model.asset.generator = "IRIS " IRIS_VERSION;
  model.asset.extras = tinygltf::Value(tinygltf::Value::Object{
      {"session", tinygltf::Value(session_name)},
      {"software", tinygltf::Value(std::string("IRIS"))},
      {"version", tinygltf::Value(std::string(IRIS_VERSION))},
      {"units", tinygltf::Value(std::string("m"))},
      {"up", tinygltf::Value(std::string("y at the top of the scene; z below the node 'world'"))},
      {"submaps", tinygltf::Value(std::string("no known relation to each other; shown side by side along x"))},
      {"voxel", tinygltf::Value(points.edge)}});
  write_glb(glb, model);
}

}  // namespace iris::exporters
