#include "export/scene_file.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numbers>
#include <opencv2/imgcodecs.hpp>
#include <set>
#include <unordered_map>

#include "export/gltf_builder.h"
#include "export/scene_surfaces.h"
#include "iris/core/error.h"
#include "iris/core/options.h"

namespace iris::exporters {

void SceneOptions::declare(OptionSet& set) {
  set.section("scene");
  set.add("max_mb", max_mb, "MB", 1, 4000,
          "largest size of scene.glb: points are thinned, triangles made larger and textures smaller until it fits");
  set.add("max_points", max_points, "", 1000, 50'000'000,
          "at most so many points; with more, the edge of the cubes that thin them is doubled until they fit");
  set.add("surfaces", surfaces,
          "textured surfaces of the views; without them the scene shows points, path and cameras");
  set.add(
      "surface_error", surface_error, "", 0.01, 100,
      "standard deviations of the disparity by which triangles may differ from the measurements; larger makes fewer "
      "triangles");
  set.add("min_gain", min_gain, "%", 0, 100,
          "a view gets a surface if it shows so much more of all places; 0 = every view that shows anything new");
  set.add("jpeg_quality", jpeg_quality, "", 1, 100, "of the textures");
}

namespace {

// glTF's cameras look along -z with y up, ours along z with y down.
Pose gltf_camera(const Pose& world_from_cam) {
  Pose turned = world_from_cam;
  turned.linear().col(1) *= -1;
  turned.linear().col(2) *= -1;
  return turned;
}

// One point a cube: that of the least sigma, the first of several. In the order in which the cubes are first touched.
PointCloud thinned(const PointCloud& cloud, double edge) {
  PointCloud result{.edge = edge, .points = {}};
  std::unordered_map<uint64_t, size_t> cubes;
  for (const CloudPoint& point : cloud.points) {
    uint64_t key = 0;  // 21 bits an axis
    for (int i = 0; i < 3; ++i) {
      key = key << 21 | (static_cast<uint64_t>(static_cast<int64_t>(std::floor(point.position[i] / edge))) & 0x1fffff);
    }
    const auto [found, added] = cubes.try_emplace(key, result.points.size());
    if (added) {
      result.points.push_back(point);
    } else if (point.sigma < result.points[found->second].sigma) {
      result.points[found->second] = point;
    }
  }
  return result;
}

class SceneBuilder {
 public:
  SceneBuilder()
      : points_(builder_.add_unlit_material("points", {1, 1, 1})),
        path_(builder_.add_unlit_material("path", {1, 0.2, 0})),
        cameras_(builder_.add_unlit_material("cameras", {0, 0.35, 1})),
        levels_(linear_levels()),
        world_(builder_.add_world()) {}

  tinygltf::Model& model() { return builder_.model(); }

  int add_submap(int submap) { return builder_.add_node(world_, "submap_" + std::to_string(submap)); }

  void place(int node, const Pose& pose) {
    const Eigen::Quaterniond q(pose.linear());
    const Eigen::Vector3d t = pose.translation();
    model().nodes[static_cast<size_t>(node)].translation = {t.x(), t.y(), t.z()};
    model().nodes[static_cast<size_t>(node)].rotation = {q.x(), q.y(), q.z(), q.w()};
  }

  void add_surfaces(int parent, const views::ViewStore& views, const std::vector<SceneSurface>& surfaces) {
    if (surfaces.empty()) return;
    const int group = builder_.add_node(parent, "surfaces");
    for (const SceneSurface& surface : surfaces) {
      const views::ViewSummary& view = views.summaries()[static_cast<size_t>(surface.view)];
      const std::string name = frame_name("surface", view.frame_idx);
      const int material = builder_.add_unlit_material(name, {1, 1, 1});
      const int texture = builder_.add_texture(surface.jpeg, "image/jpeg");
      model().materials.back().pbrMetallicRoughness.baseColorTexture.index = texture;
      std::vector<uint32_t> indices;
      for (const Eigen::Vector3i& t : surface.mesh.triangles) {
        for (int i = 0; i < 3; ++i) indices.push_back(static_cast<uint32_t>(t[i]));
      }
      tinygltf::Primitive triangles =
          primitive(TINYGLTF_MODE_TRIANGLES, material, builder_.add_positions(surface.mesh.vertices));
      triangles.attributes["TEXCOORD_0"] = builder_.add_texture_coordinates(surface.mesh.texture_coordinates);
      triangles.indices = builder_.add_indices(indices);
      place(builder_.add_mesh_node(group, name, triangles), view.world_from_cam);
    }
  }

  void add_cloud(int parent, const PointCloud& cloud) {
    if (cloud.points.empty()) return;
    std::vector<Eigen::Vector3f> positions;
    std::vector<std::array<uint16_t, 4>> colours;
    for (const CloudPoint& point : cloud.points) {
      positions.push_back(point.position);
      std::array<uint16_t, 4> colour{0, 0, 0, 65535};
      for (size_t i = 0; i < 3; ++i) colour[i] = linear_16(levels_[point.rgb[i]]);
      colours.push_back(colour);
    }
    tinygltf::Primitive points = primitive(TINYGLTF_MODE_POINTS, points_, builder_.add_positions(positions));
    points.attributes["COLOR_0"] = builder_.add_colours(colours);
    builder_.add_mesh_node(parent, "cloud", points);
  }

  void add_path(int parent, const std::vector<Eigen::Vector3f>& path) {
    if (path.size() < 2) return;
    builder_.add_mesh_node(parent, "path", primitive(TINYGLTF_MODE_LINE_STRIP, path_, builder_.add_positions(path)));
  }

  // Pyramids over the image's corners, from the optical centre to the depth of one baseline; below them the cameras.
  void add_cameras(int parent, const std::vector<views::ViewSummary>& views) {
    if (views.empty()) return;
    std::vector<Eigen::Vector3f> positions;
    std::vector<uint32_t> indices;
    for (const views::ViewSummary& view : views) {
      const RectifiedCamera& camera = view.camera;
      const uint32_t apex = static_cast<uint32_t>(positions.size());
      positions.push_back(view.world_from_cam.translation().cast<float>());
      for (uint32_t corner = 0; corner < 4; ++corner) {
        const double x = (corner == 1 || corner == 2 ? camera.width : 0) - 0.5,
                     y = (corner >= 2 ? camera.height : 0) - 0.5;
        const double s = camera.baseline / camera.f;
        const Eigen::Vector3d in_cam(s * (x - camera.cx), s * (y - camera.cy), camera.baseline);
        positions.push_back((view.world_from_cam * in_cam).cast<float>());
        indices.insert(indices.end(), {apex, apex + 1 + corner, apex + 1 + corner, apex + 1 + (corner + 1) % 4});
      }
    }
    tinygltf::Primitive lines = primitive(TINYGLTF_MODE_LINE, cameras_, builder_.add_positions(positions));
    lines.indices = builder_.add_indices(indices);
    const int group = builder_.add_mesh_node(parent, "cameras", lines);
    const RectifiedCamera& first = views.front().camera;
    const int lens = add_camera("recording", 2 * std::atan(first.height / (2 * first.f)),
                                static_cast<double>(first.width) / first.height, first.baseline / 10);
    for (const views::ViewSummary& view : views) {
      const int node = builder_.add_node(group, frame_name("camera", view.frame_idx));
      place(node, gltf_camera(view.world_from_cam));
      model().nodes[static_cast<size_t>(node)].camera = lens;
    }
  }

  void add_ground(int parent, const GroundPicture& ground) {
    std::vector<unsigned char> bytes;
    IRIS_CHECK(cv::imencode(".png", ground.image, bytes));
    const int material = builder_.add_unlit_material("map", {1, 1, 1});
    const int texture = builder_.add_texture(bytes, "image/png");
    model().materials.back().pbrMetallicRoughness.baseColorTexture.index = texture;
    model().materials.back().doubleSided = true;
    const auto x0 = static_cast<float>(ground.x0), y0 = static_cast<float>(ground.y0),
               x1 = static_cast<float>(ground.x0 + ground.width), y1 = static_cast<float>(ground.y0 + ground.height);
    constexpr float z = -0.1f;  // [m] below the floor, which is uneven as it was measured: both would show in patches
    tinygltf::Primitive plane = primitive(TINYGLTF_MODE_TRIANGLES, material,
                                          builder_.add_positions({{x0, y0, z}, {x1, y0, z}, {x1, y1, z}, {x0, y1, z}}));
    plane.attributes["TEXCOORD_0"] = builder_.add_texture_coordinates({{0, 1}, {1, 1}, {1, 0}, {0, 0}});
    plane.indices = builder_.add_indices({0, 1, 2, 0, 2, 3});
    builder_.add_mesh_node(parent, "map", plane);
  }

  void add_tour(int parent, const CameraPath& tour, double aspect) {
    if (tour.keyframes.size() < 2) return;
    const int node = builder_.add_node(parent, "tour");
    place(node, gltf_camera(tour.keyframes.front().world_from_cam));
    model().nodes[static_cast<size_t>(node)].camera = add_camera("tour", tour.keyframes.front().fov, aspect, kTourNear);
    std::vector<float> times;
    std::vector<Eigen::Vector3f> places;
    std::vector<Eigen::Vector4f> turns;
    for (const CameraKeyframe& key : tour.keyframes) {
      times.push_back(static_cast<float>(key.t - tour.keyframes.front().t));
      places.push_back(key.world_from_cam.translation().cast<float>());
      Eigen::Vector4d turn = Eigen::Quaterniond(gltf_camera(key.world_from_cam).linear()).coeffs();
      // The shorter way round.
      if (!turns.empty() && turns.back().cast<double>().dot(turn) < 0) turn = -turn;
      turns.push_back(turn.normalized().cast<float>());
    }
    tinygltf::Animation animation;
    animation.name = "tour";
    const int input = builder_.add_times(times);
    for (const auto& [path, output] :
         {std::pair("translation", builder_.add_vectors(places)), std::pair("rotation", builder_.add_vectors(turns))}) {
      tinygltf::AnimationSampler sampler;
      sampler.input = input;
      sampler.output = output;
      sampler.interpolation = "LINEAR";
      tinygltf::AnimationChannel channel;
      channel.sampler = static_cast<int>(animation.samplers.size());
      channel.target_node = node;
      channel.target_path = path;
      animation.samplers.push_back(sampler);
      animation.channels.push_back(channel);
    }
    model().animations.push_back(animation);
  }

 private:
  static constexpr double kTourNear = 0.05, kFar = 1000;  // [m]

  static std::string frame_name(const std::string& what, int frame_idx) {
    std::string digits = std::to_string(frame_idx);
    if (digits.size() < 6) digits.insert(0, 6 - digits.size(), '0');
    return what + "_" + digits;
  }

  int add_camera(const std::string& name, double yfov, double aspect, double near) {
    tinygltf::Camera camera;
    camera.name = name;
    camera.type = "perspective";
    camera.perspective.yfov = yfov;
    camera.perspective.aspectRatio = aspect;
    camera.perspective.znear = near;
    camera.perspective.zfar = kFar;
    model().cameras.push_back(camera);
    return static_cast<int>(model().cameras.size()) - 1;
  }

  ModelBuilder builder_;
  int points_, path_, cameras_;  // materials
  std::array<float, 256> levels_;
  int world_;
};

}  // namespace

void write_scene(const std::filesystem::path& glb, const PoseGraph& graph, const std::vector<ScenePart>& parts,
                 const SceneOptions& options, const CloudOptions& cloud_options, const std::string& session_name,
                 const pipeline::RunControl& control) {
  constexpr size_t kPointBytes = 20;
  constexpr double kCloudShare = 1.0 / 3, kReserve = 0.05;  // of the file; the reserve is for all small things
  const double budget = options.max_mb * 1e6;
  const auto most_points =
      std::min(static_cast<size_t>(options.max_points), static_cast<size_t>(kCloudShare * budget / kPointBytes));
  double edge = 0;
  const auto total = [](const std::map<int, PointCloud>& clouds) {
    size_t sum = 0;
    for (const auto& [submap, cloud] : clouds) sum += cloud.points.size();
    return sum;
  };
  std::map<int, PointCloud> clouds;
  for (const ScenePart& part : parts) {
    if (!part.cloud) continue;
    clouds[part.submap] = *part.cloud;
    edge = std::max(edge, part.cloud->edge);
  }
  while (total(clouds) > most_points && edge < 1000) {
    edge *= 2;
    for (auto& [submap, cloud] : clouds) cloud = thinned(cloud, edge);
  }

  std::map<int, std::vector<Eigen::Vector3f>> paths;
  for (const PoseNode& node : graph.nodes) {
    paths[node.submap].push_back(node.world_from_cam.translation().cast<float>());
  }
  size_t all_views = 0;
  for (const ScenePart& part : parts) all_views += part.views ? part.views->summaries().size() : 0;
  constexpr double kViewBytes = 1500;  // of a view's nodes, camera pyramid, material and arrays in the file's JSON
  const double surface_budget =
      std::max(0.0, (1 - kReserve) * budget - static_cast<double>(kPointBytes * total(clouds)) -
                        kViewBytes * static_cast<double>(all_views) - 12.0 * static_cast<double>(graph.nodes.size()));

  SceneBuilder builder;
  double right = 0;  // [m] where the next sub-map begins in x
  int kept_views = 0;
  for (const ScenePart& part : parts) {
    const int node = builder.add_submap(part.submap);
    const std::vector<views::ViewSummary> views =
        part.views ? part.views->summaries() : std::vector<views::ViewSummary>{};
    if (options.surfaces && !views.empty()) {
      const auto share =
          static_cast<size_t>(surface_budget * static_cast<double>(views.size()) / static_cast<double>(all_views));
      const std::vector<SceneSurface> surfaces = scene_surfaces(*part.views, options, cloud_options, share, control);
      builder.add_surfaces(node, *part.views, surfaces);
      kept_views += static_cast<int>(surfaces.size());
    }
    const PointCloud& cloud = clouds[part.submap];
    builder.add_cloud(node, cloud);
    builder.add_path(node, paths[part.submap]);
    builder.add_cameras(node, views);
    if (part.ground) builder.add_ground(node, *part.ground);
    builder.add_tour(node, part.tour, part.tour_aspect);

    Eigen::AlignedBox3f box;
    for (const CloudPoint& point : cloud.points) box.extend(point.position);
    for (const Eigen::Vector3f& place : paths[part.submap]) box.extend(place);
    for (const views::ViewSummary& view : views) box.extend(view.world_from_cam.translation().cast<float>().eval());
    if (box.isEmpty()) continue;
    // Side by side, with a gap of one metre.
    if (part.submap != parts.front().submap) {
      const double shift = right + 1 - box.min().x();
      builder.model().nodes[static_cast<size_t>(node)].translation = {shift, 0, 0};
      right = box.max().x() + shift;
    } else {
      right = box.max().x();
    }
  }
  if (control.stopped()) throw Interrupted();

  tinygltf::Model& model = builder.model();
  if (model.buffers[0].data.empty()) model.buffers.clear();
  model.asset.version = "2.0";
  model.asset.generator = "IRIS " IRIS_VERSION;
  tinygltf::Value::Object extras = {
      {"session", tinygltf::Value(session_name)},
      {"software", tinygltf::Value(std::string("IRIS"))},
      {"version", tinygltf::Value(std::string(IRIS_VERSION))},
      {"units", tinygltf::Value(std::string("m"))},
      {"up", tinygltf::Value(std::string("y at the top of the scene; z below the node 'world'"))},
      {"surface_views", tinygltf::Value(kept_views)},
      {"voxel", tinygltf::Value(edge)}};
  if (parts.size() > 1) {
    extras["submaps"] = tinygltf::Value(std::string("no known relation to each other; shown side by side along x"));
  }
  model.asset.extras = tinygltf::Value(std::move(extras));
  write_glb(glb, model);
}

}  // namespace iris::exporters
