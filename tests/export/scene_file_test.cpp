#include "export/scene_file.h"

#include <gtest/gtest.h>
#include <tiny_gltf.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <map>
#include <random>
#include <set>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/core/options.h"
#include "iris/core/parallel.h"
#include "support/full_disk.h"
#include "support/temporary_folder.h"

namespace iris::exporters {
namespace {

namespace fs = std::filesystem;

constexpr int kWidth = 64, kHeight = 48;

const RectifiedCamera kCamera{
    .f = 60, .cx = 31.5, .cy = 23.5, .baseline = 0.2, .disparity_offset = 0.5, .width = kWidth, .height = kHeight};

// World z up: the camera looks along world y.
Pose looking_along_y(const Eigen::Vector3d& place) {
  Pose pose = Pose::Identity();
  pose.linear() << 1, 0, 0, 0, 0, 1, 0, -1, 0;
  pose.translation() = place;
  return pose;
}

// A slanted wall with coloured squares; all origins occur.
StereoView wall_view(int frame_idx, int submap, const Eigen::Vector3d& place, bool colour = true) {
  StereoView view;
  view.frame_idx = frame_idx;
  view.submap = submap;
  view.camera = kCamera;
  view.world_from_cam = looking_along_y(place);
  view.image.create(kHeight, kWidth, colour ? CV_8UC3 : CV_8UC1);
  view.disparity.disparity.create(kHeight, kWidth);
  view.disparity.origin.create(kHeight, kWidth);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const cv::Vec3b bgr((x / 8) * 30, (y / 8) * 40, 200);
      if (colour) {
        view.image.at<cv::Vec3b>(y, x) = bgr;
      } else {
        view.image.at<uchar>(y, x) = bgr[1];
      }
      view.disparity.disparity(y, x) = 2.5f + 0.1f * static_cast<float>(x);
      view.disparity.origin(y, x) = static_cast<uchar>(1 + (x + y) % 4);
    }
  }
  return view;
}

PoseGraph graph_of(const std::vector<StereoView>& views) {
  PoseGraph graph;
  for (const StereoView& view : views) {
    graph.nodes.push_back({.frame_idx = view.frame_idx,
                           .stamp_ns = view.stamp_ns,
                           .world_from_cam = view.world_from_cam,
                           .submap = view.submap});
  }
  return graph;
}

std::vector<StereoView> three_views() {
  return {wall_view(0, 0, {0, 0, 0}), wall_view(4, 0, {0.31, 0, 0.02}), wall_view(9, 0, {0.6, 0.1, 0}, false)};
}

tinygltf::Model read_glb(const fs::path& path) {
  tinygltf::Model model;
  std::string error, warning;
  EXPECT_TRUE(tinygltf::TinyGLTF().LoadBinaryFromFile(&model, &error, &warning, path.string())) << error;
  EXPECT_EQ(error + warning, "");
  return model;
}

// The bytes of an accessor as elements, which may be groups of the accessor's own.
template <class Element>
std::vector<Element> elements_of(const tinygltf::Model& model, int index) {
  const tinygltf::Accessor& accessor = model.accessors.at(static_cast<size_t>(index));
  const tinygltf::BufferView& view = model.bufferViews.at(static_cast<size_t>(accessor.bufferView));
  EXPECT_EQ(view.byteLength, accessor.count * static_cast<size_t>(accessor.ByteStride(view)));
  EXPECT_EQ(view.byteLength % sizeof(Element), 0u);
  EXPECT_EQ(view.byteOffset % 4, 0u);
  EXPECT_EQ(accessor.byteOffset, 0u);
  std::vector<Element> elements(view.byteLength / sizeof(Element));
  std::memcpy(static_cast<void*>(elements.data()), model.buffers.at(0).data.data() + view.byteOffset, view.byteLength);
  return elements;
}

// The node "submap_<k>" and its children by name.
const tinygltf::Node& submap_node(const tinygltf::Model& model, int submap) {
  for (const int child : model.nodes.at(0).children) {
    const tinygltf::Node& node = model.nodes.at(static_cast<size_t>(child));
    if (node.name == "submap_" + std::to_string(submap)) return node;
  }
  throw std::runtime_error("no such sub-map");
}

const tinygltf::Primitive* find_primitive(const tinygltf::Model& model, int submap, const std::string& name) {
  for (const int child : submap_node(model, submap).children) {
    const tinygltf::Node& node = model.nodes.at(static_cast<size_t>(child));
    if (node.name == name) return &model.meshes.at(static_cast<size_t>(node.mesh)).primitives.at(0);
  }
  return nullptr;
}

struct ColouredPoint {
  Eigen::Vector3f position;
  std::array<uint16_t, 4> colour;
};

std::vector<ColouredPoint> points_of(const tinygltf::Model& model, int submap) {
  const tinygltf::Primitive* points = find_primitive(model, submap, "cloud");
  if (!points) return {};
  EXPECT_EQ(points->mode, TINYGLTF_MODE_POINTS);
  const auto positions = elements_of<Eigen::Vector3f>(model, points->attributes.at("POSITION"));
  const auto colours = elements_of<std::array<uint16_t, 4>>(model, points->attributes.at("COLOR_0"));
  EXPECT_EQ(positions.size(), colours.size());
  std::vector<ColouredPoint> result;
  for (size_t i = 0; i < positions.size(); ++i) result.push_back({positions[i], colours[i]});
  return result;
}

const tinygltf::Node* find_node(const tinygltf::Model& model, const std::string& name) {
  const auto found =
      std::find_if(model.nodes.begin(), model.nodes.end(), [&](const auto& node) { return node.name == name; });
  return found == model.nodes.end() ? nullptr : &*found;
}

Pose pose_of(const tinygltf::Node& node) {
  Pose pose = Pose::Identity();
  const std::vector<double>&t = node.translation, &q = node.rotation;
  pose.translation() = Eigen::Vector3d(t.at(0), t.at(1), t.at(2));
  pose.linear() = Eigen::Quaterniond(q.at(3), q.at(0), q.at(1), q.at(2)).toRotationMatrix();
  return pose;
}

// A flat patch of points, half of them dark.
PointCloud patch_cloud(int side) {
  PointCloud cloud{.edge = 0.02, .points = {}};
  for (int y = 0; y < side; ++y) {
    for (int x = 0; x < side; ++x) {
      CloudPoint p;
      p.position = {0.02f * static_cast<float>(x) + 0.01f, 2, 0.02f * static_cast<float>(y) + 0.01f};
      p.rgb = x < side / 2 ? std::array<uint8_t, 3>{10, 20, 30} : std::array<uint8_t, 3>{200, 100, 50};
      p.sigma = 0.001f * static_cast<float>(1 + (x + 2 * y) % 4);
      cloud.points.push_back(p);
    }
  }
  return cloud;
}

class SceneFile : public ::testing::Test {
 protected:
  // The views' sub-maps, each with the cloud of a patch; the first one with a map and a tour.
  void write_file_of(const std::vector<StereoView>& views, const SceneOptions& options,
                     const pipeline::RunControl& control = {}) {
    std::map<int, std::vector<StereoView>> by_submap;
    for (const StereoView& view : views) by_submap[view.submap].push_back(view);
    std::map<int, views::MemoryViewStore> stores;
    std::vector<ScenePart> parts;
    for (const auto& [submap, some] : by_submap) {
      const auto& store = stores.emplace(submap, views::MemoryViewStore(some)).first->second;
      parts.push_back({.submap = submap, .views = &store, .cloud = &cloud_});
    }
    if (!parts.empty()) {
      parts[0].ground =
          GroundPicture{.image = cv::Mat3b(20, 30, cv::Vec3b(1, 2, 3)), .x0 = -1, .y0 = 2, .width = 3, .height = 2};
      for (int i = 0; i < 5; ++i) {
        parts[0].tour.keyframes.push_back({.t = 2 + 0.5 * i,
                                           .world_from_cam = looking_along_y({0.1 * i, 0, 0.3}) *
                                                             Eigen::AngleAxisd(1.2 * i, Eigen::Vector3d::UnitY()),
                                           .fov = 0.9});
      }
      parts[0].tour_aspect = 1.5;
    }
    write_scene(glb_, graph_of(views), parts, options, cloud_options_, "rover", control);
  }
  tinygltf::Model write(const std::vector<StereoView>& views, const SceneOptions& options = {}) {
    write_file_of(views, options);
    return read_glb(glb_);
  }

  const testing::TemporaryFolder temporary_;
  const fs::path folder_ = temporary_.path();
  const fs::path glb_ = folder_ / "scene.glb";
  PointCloud cloud_ = patch_cloud(40);
  CloudOptions cloud_options_{.fusion = {.min_disparity = 1, .step = 1}};
};

TEST_F(SceneFile, CloudIsThatWhichWasGiven) {
  const std::vector<ColouredPoint> points = points_of(write(three_views()), 0);
  ASSERT_EQ(points.size(), cloud_.points.size());
  for (size_t i = 0; i < points.size(); ++i) {
    EXPECT_EQ(points[i].position, cloud_.points[i].position);
    for (size_t k = 0; k < 3; ++k) {
      const double s = cloud_.points[i].rgb[k] / 255.0;  // sRGB -> linear light, IEC 61966-2-1
      EXPECT_NEAR(points[i].colour[k], 65535 * (s <= 0.04045 ? s / 12.92 : std::pow((s + 0.055) / 1.055, 2.4)), 1);
    }
    EXPECT_EQ(points[i].colour[3], 65535);
  }
}

TEST_F(SceneFile, SurfacesShowWhatTheViewsSaw) {
  const std::vector<StereoView> views = three_views();
  cloud_options_.fusion.neighbours = 0;  // each sees a wall of its own
  const tinygltf::Model model = write(views, {.surface_error = 0.2});
  const tinygltf::Node* group = find_node(model, "surfaces");
  ASSERT_NE(group, nullptr);
  ASSERT_FALSE(group->children.empty());
  for (const int child : group->children) {
    const tinygltf::Node& node = model.nodes.at(static_cast<size_t>(child));
    const auto view = std::find_if(views.begin(), views.end(), [&](const StereoView& v) {
      return node.name == "surface_00000" + std::to_string(v.frame_idx);
    });
    ASSERT_NE(view, views.end());
    EXPECT_TRUE(pose_of(node).isApprox(view->world_from_cam, 1e-9));
    const tinygltf::Primitive& surface = model.meshes.at(static_cast<size_t>(node.mesh)).primitives.at(0);
    const auto positions = elements_of<Eigen::Vector3f>(model, surface.attributes.at("POSITION"));
    const auto coordinates = elements_of<Eigen::Vector2f>(model, surface.attributes.at("TEXCOORD_0"));
    for (size_t i = 0; i < positions.size(); ++i) {
      const Eigen::Vector3d seen = kCamera.project(positions[i].cast<double>());
      EXPECT_NEAR((seen.x() + 0.5) / kWidth, coordinates[i].x(), 1e-5);
      EXPECT_NEAR((seen.y() + 0.5) / kHeight, coordinates[i].y(), 1e-5);
      EXPECT_NEAR(seen.z(), 2.5 + 0.1 * seen.x(), 0.1);  // the wall
    }
    const tinygltf::Material& material = model.materials.at(static_cast<size_t>(surface.material));
    EXPECT_TRUE(material.extensions.contains("KHR_materials_unlit"));
    const int texture = material.pbrMetallicRoughness.baseColorTexture.index;
    const tinygltf::Image& image =
        model.images.at(static_cast<size_t>(model.textures.at(static_cast<size_t>(texture)).source));
    EXPECT_EQ(image.width, kWidth);
    EXPECT_EQ(image.height, kHeight);
  }
  EXPECT_EQ(model.asset.extras.Get("surface_views").GetNumberAsInt(), static_cast<int>(group->children.size()));
  EXPECT_EQ(find_node(write(views, {.surfaces = false}), "surfaces"), nullptr);
}

TEST_F(SceneFile, CamerasMapAndTour) {
  const std::vector<StereoView> views = three_views();
  const tinygltf::Model model = write(views);
  Pose turned = Pose::Identity();
  turned.linear() = Eigen::Vector3d(1, -1, -1).asDiagonal();  // looks along -z, y up
  const tinygltf::Node* camera = find_node(model, "camera_000004");
  ASSERT_NE(camera, nullptr);
  EXPECT_TRUE(pose_of(*camera).isApprox(views[1].world_from_cam * turned, 1e-9));
  const tinygltf::PerspectiveCamera& lens = model.cameras.at(static_cast<size_t>(camera->camera)).perspective;
  EXPECT_NEAR(lens.yfov, 2 * std::atan(24.0 / 60), 1e-6);
  EXPECT_NEAR(lens.aspectRatio, 64.0 / 48, 1e-6);

  const tinygltf::Primitive* map = find_primitive(model, 0, "map");
  ASSERT_NE(map, nullptr);
  const auto corners = elements_of<Eigen::Vector3f>(model, map->attributes.at("POSITION"));
  const auto coordinates = elements_of<Eigen::Vector2f>(model, map->attributes.at("TEXCOORD_0"));
  ASSERT_EQ(corners.size(), 4u);
  for (size_t i = 0; i < 4; ++i) {
    // Row 0 of the picture is the largest y; below the floor, which it would show through.
    EXPECT_EQ(corners[i], Eigen::Vector3f(-1 + 3 * coordinates[i].x(), 4 - 2 * coordinates[i].y(), -0.1f));
  }

  const tinygltf::Node* tour = find_node(model, "tour");
  ASSERT_NE(tour, nullptr);
  EXPECT_NEAR(model.cameras.at(static_cast<size_t>(tour->camera)).perspective.yfov, 0.9, 1e-6);
  ASSERT_EQ(model.animations.size(), 1u);
  const tinygltf::Animation& animation = model.animations[0];
  EXPECT_EQ(animation.name, "tour");
  ASSERT_EQ(animation.channels.size(), 2u);
  for (const tinygltf::AnimationChannel& channel : animation.channels) {
    EXPECT_EQ(&model.nodes.at(static_cast<size_t>(channel.target_node)), tour);
    const tinygltf::AnimationSampler& sampler = animation.samplers.at(static_cast<size_t>(channel.sampler));
    const auto times = elements_of<float>(model, sampler.input);
    EXPECT_EQ(times, (std::vector<float>{0, 0.5f, 1, 1.5f, 2}));
    for (size_t i = 0; i < times.size(); ++i) {
      const double at = static_cast<double>(i);
      const Pose expected =
          looking_along_y({0.1 * at, 0, 0.3}) * Eigen::AngleAxisd(1.2 * at, Eigen::Vector3d::UnitY()) * turned;
      if (channel.target_path == "translation") {
        EXPECT_LT(
            (elements_of<Eigen::Vector3f>(model, sampler.output)[i].cast<double>() - expected.translation()).norm(),
            1e-6);
        continue;
      }
      const auto turns = elements_of<Eigen::Vector4f>(model, sampler.output);
      const Eigen::Quaterniond q(turns[i].cast<double>());
      EXPECT_LT((q.toRotationMatrix() - expected.linear()).norm(), 1e-6);
      if (i > 0) {
        EXPECT_GT(turns[i].dot(turns[i - 1]), 0);  // the shorter way
      }
    }
  }
}

TEST_F(SceneFile, NodesPathCamerasAndExtras) {
  const std::vector<StereoView> views = three_views();
  const tinygltf::Model model = write(views);
  const tinygltf::Node& world = model.nodes.at(static_cast<size_t>(model.scenes.at(0).nodes.at(0)));
  EXPECT_EQ(world.name, "world");
  const std::vector<double>& q = world.rotation;
  const Eigen::Quaterniond y_up_from_z_up(q.at(3), q.at(0), q.at(1), q.at(2));
  EXPECT_LT((y_up_from_z_up * Eigen::Vector3d::UnitZ() - Eigen::Vector3d::UnitY()).norm(), 1e-15);
  EXPECT_LT((y_up_from_z_up * Eigen::Vector3d::UnitX() - Eigen::Vector3d::UnitX()).norm(), 1e-15);
  EXPECT_TRUE(submap_node(model, 0).translation.empty());

  const tinygltf::Primitive* path = find_primitive(model, 0, "path");
  ASSERT_NE(path, nullptr);
  EXPECT_EQ(path->mode, TINYGLTF_MODE_LINE_STRIP);
  const auto places = elements_of<Eigen::Vector3f>(model, path->attributes.at("POSITION"));
  ASSERT_EQ(places.size(), 3u);
  for (size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(places[i], views[i].world_from_cam.translation().cast<float>().eval());
  }

  const tinygltf::Primitive* cameras = find_primitive(model, 0, "cameras");
  ASSERT_NE(cameras, nullptr);
  EXPECT_EQ(cameras->mode, TINYGLTF_MODE_LINE);
  const auto corners = elements_of<Eigen::Vector3f>(model, cameras->attributes.at("POSITION"));
  const auto lines = elements_of<std::array<uint32_t, 2>>(model, cameras->indices);
  ASSERT_EQ(corners.size(), 15u);
  // Each pyramid: the apex, and four corners that project onto the image's corners from a depth of one baseline.
  for (size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(corners[5 * i], places[i]);
    std::set<std::pair<long, long>> projected;
    for (size_t k = 1; k < 5; ++k) {
      const Eigen::Vector3d p = views[i].world_from_cam.inverse() * corners[5 * i + k].cast<double>();
      EXPECT_NEAR(p.z(), kCamera.baseline, 1e-6);
      const Eigen::Vector3d xyd = kCamera.project(p);
      projected.emplace(std::lround(2 * xyd.x()), std::lround(2 * xyd.y()));
    }
    EXPECT_EQ(projected,
              (std::set<std::pair<long, long>>{
                  {-1, -1}, {2 * kWidth - 1, -1}, {-1, 2 * kHeight - 1}, {2 * kWidth - 1, 2 * kHeight - 1}}));
  }
  // Eight edges a pyramid, all different: four to the apex, four around the base.
  std::set<std::array<uint32_t, 2>> edges;
  int to_apex = 0;
  for (std::array<uint32_t, 2> line : lines) {
    std::sort(line.begin(), line.end());
    EXPECT_EQ(line[0] / 5, line[1] / 5);
    to_apex += line[0] % 5 == 0;
    edges.insert(line);
  }
  EXPECT_EQ(edges.size(), 24u);
  EXPECT_EQ(to_apex, 12);

  EXPECT_EQ(model.asset.extras.Get("session").Get<std::string>(), "rover");
  EXPECT_EQ(model.asset.extras.Get("units").Get<std::string>(), "m");
  EXPECT_EQ(model.asset.extras.Get("software").Get<std::string>(), "IRIS");
  EXPECT_FALSE(model.asset.extras.Get("version").Get<std::string>().empty());
  EXPECT_EQ(model.asset.extras.Get("voxel").GetNumberAsDouble(), 0.02);
}

TEST_F(SceneFile, CoarserCubesKeepWithinTheBudgetOfPoints) {
  const tinygltf::Model model = write(three_views(), {.max_points = 1000});
  const std::vector<ColouredPoint> points = points_of(model, 0);
  EXPECT_EQ(points.size(), 400u);  // of 1600: one of four
  EXPECT_EQ(model.asset.extras.Get("voxel").GetNumberAsDouble(), 0.04);
  // Of each cube the point of the least sigma.
  double sum = 0;
  for (const ColouredPoint& point : points) {
    const auto same = std::find_if(cloud_.points.begin(), cloud_.points.end(),
                                   [&](const CloudPoint& p) { return p.position == point.position; });
    ASSERT_NE(same, cloud_.points.end());
    sum += same->sigma;
  }
  EXPECT_LT(sum / 400, 0.0016);
}

TEST_F(SceneFile, KeepsWithinItsSize) {
  // Noisy pictures and disparities compress badly and need every triangle.
  std::vector<StereoView> views;
  cv::RNG random(1);
  for (int i = 0; i < 60; ++i) {
    StereoView view = wall_view(i, 0, {0.4 * i, 0, 0});
    random.fill(view.image, cv::RNG::UNIFORM, 0, 256);
    cv::Mat1f noise(kHeight, kWidth);
    random.fill(noise, cv::RNG::NORMAL, 0, 0.2);
    view.disparity.disparity = view.disparity.disparity + noise;
    views.push_back(view);
  }
  cloud_options_.min_agree = 0;
  write(views, {.max_mb = 1000, .min_gain = 0});
  const auto all = fs::file_size(glb_);
  ASSERT_GT(all, 1'200'000u);
  const tinygltf::Model model = write(views, {.max_mb = 1, .min_gain = 0});
  EXPECT_LE(fs::file_size(glb_), 1'000'000u);
  EXPECT_GT(find_node(model, "surfaces")->children.size(), 3u);
}

TEST_F(SceneFile, SubmapsStandSideBySide) {
  const std::vector<StereoView> views = {wall_view(0, 0, {0, 0, 0}), wall_view(1, 0, {0.1, 0, 0}),
                                         wall_view(5, 2, {0, 0, 0}), wall_view(7, 3, {0, 0, 0})};
  const tinygltf::Model model = write(views);
  double right = -1e9;
  for (const int submap : {0, 2, 3}) {
    const std::vector<double>& shift = submap_node(model, submap).translation;
    double low = 1e9, high = -1e9;
    for (const ColouredPoint& point : points_of(model, submap)) {
      const double x = point.position.x() + (shift.empty() ? 0 : shift[0]);
      low = std::min(low, x);
      high = std::max(high, x);
    }
    EXPECT_GT(low, right);
    right = high;
  }
  EXPECT_NE(find_primitive(model, 0, "path"), nullptr);
  EXPECT_EQ(find_primitive(model, 2, "path"), nullptr);  // one pose is no line
  EXPECT_NE(find_primitive(model, 2, "cameras"), nullptr);
}

TEST_F(SceneFile, SameBytesForAnyNumberOfThreadsAndEveryChangeShows) {
  std::vector<StereoView> views;
  for (int i = 0; i < 20; ++i) views.push_back(wall_view(i, 0, {0.05 * i, 0.01 * i, 0}));
  std::string one, three;
  with_threads(1, [&] { write(views); });
  one = read_file(glb_);
  with_threads(3, [&] { write(views); });
  three = read_file(glb_);
  EXPECT_EQ(one, three);

  std::vector<StereoView> changed = views;
  changed[7].world_from_cam.translation().z() += 1e-4;
  write(changed);
  EXPECT_NE(read_file(glb_), one);
  cloud_.points[3].rgb[1] ^= 16;
  write(views);
  EXPECT_NE(read_file(glb_), one);
}

TEST_F(SceneFile, AnEmptySceneIsAValidFileAndAnUnwritablePlaceAnError) {
  const tinygltf::Model model = write({});
  EXPECT_EQ(model.nodes.size(), 1u);
  EXPECT_TRUE(model.meshes.empty());
  EXPECT_THROW(write_scene(glb_ / "below_a_file.glb", {}, {}, {}, {}, ""), InputError);
}

TEST_F(SceneFile, StopsWhenItIsAskedTo) {
  std::atomic<bool> stop = true;
  const pipeline::RunControl control{.progress = ProgressStyle::quiet, .stop = &stop};
  EXPECT_THROW(write_file_of(three_views(), {}, control), Interrupted);
  EXPECT_FALSE(fs::exists(glb_));
  stop = false;
  write_file_of(three_views(), {}, control);
  EXPECT_TRUE(fs::exists(glb_));
}

TEST_F(SceneFile, AFullDiskIsAnErrorAndLeavesWhatWasThere) {
  write({});
  const std::string before = read_file(glb_);
  bool refused = false;
  {
    const testing::FullDisk full(16 * 1024);
    try {
      write_file_of(three_views(), {});
    } catch (const InputError&) {
      refused = true;
    }
  }
  EXPECT_TRUE(refused);
  EXPECT_EQ(read_file(glb_), before);
  EXPECT_EQ(std::distance(fs::directory_iterator(folder_), {}), 1);
}

TEST_F(SceneFile, OptionsAreDeclared) {
  SceneOptions options;
  OptionSet set;
  options.declare(set);
  EXPECT_EQ(set.options().size(), 6u);
  set.validate();
  set.set("scene.max_points", "10");
  EXPECT_THROW(set.validate(), UsageError);
}

// Khronos' own validator as the foreign reader.
TEST_F(SceneFile, PassesTheGltfValidator) {
  const fs::path tools = fs::path(IRIS_SOURCE_DIR) / "tests/tools";
  if (std::system("node --version >/dev/null 2>&1") != 0 || !fs::exists(tools / "node_modules/gltf-validator")) {
    GTEST_SKIP() << "skipped: no node or no gltf-validator (npm --prefix " << tools.string() << " install)";
  }
  const auto problems = [&](const std::vector<StereoView>& views) {
    write(views);
    const std::string log = (folder_ / "log.txt").string();
    const int status = std::system(
        ("node '" + (tools / "check_gltf.mjs").string() + "' '" + glb_.string() + "' >'" + log + "' 2>&1").c_str());
    return status == 0 ? "" : read_file(log);
  };
  EXPECT_EQ(problems(three_views()), "");
  EXPECT_EQ(problems({wall_view(0, 0, {0, 0, 0}), wall_view(1, 0, {0.1, 0, 0}), wall_view(5, 1, {0, 0, 0})}), "");
  EXPECT_EQ(problems({}), "");
}

}  // namespace
}  // namespace iris::exporters
