#include "export/scene_file.h"

#include <gtest/gtest.h>
#include <tiny_gltf.h>

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
  const tinygltf::Primitive* points = find_primitive(model, submap, "points");
  if (!points) return {};
  EXPECT_EQ(points->mode, TINYGLTF_MODE_POINTS);
  const auto positions = elements_of<Eigen::Vector3f>(model, points->attributes.at("POSITION"));
  const auto colours = elements_of<std::array<uint16_t, 4>>(model, points->attributes.at("COLOR_0"));
  EXPECT_EQ(positions.size(), colours.size());
  std::vector<ColouredPoint> result;
  for (size_t i = 0; i < positions.size(); ++i) result.push_back({positions[i], colours[i]});
  return result;
}

class SceneFile : public ::testing::Test {
 protected:
  tinygltf::Model write(const std::vector<StereoView>& views, const SceneOptions& options = {}) {
    write_scene(glb_, graph_of(views), views::MemoryViewStore(views), options, "rover");
    return read_glb(glb_);
  }

  const testing::TemporaryFolder temporary_;
  const fs::path folder_ = temporary_.path();
  const fs::path glb_ = folder_ / "scene.glb";
};

// What the points must be, written down without any of the exporter's shortcuts: a sorted map of cubes in double.
TEST_F(SceneFile, PointsAreTheWeightedMeansOfTheirCubes) {
  constexpr double kEdge = 0.0973;  // no point lies on the face of a cube, where a float may round across it
  const std::vector<StereoView> views = three_views();
  const SceneOptions options{.voxel = kEdge, .max_range = 4, .min_disparity = 3.7, .max_points = 100000};
  struct Sum {
    double w = 0;
    Eigen::Vector3d p = Eigen::Vector3d::Zero(), c = Eigen::Vector3d::Zero();
    int pixels = 0;
  };
  std::map<std::array<double, 3>, Sum> cubes;
  for (const StereoView& view : views) {
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        if (view.disparity.origin(y, x) == static_cast<uint8_t>(DisparityOrigin::between_segments)) continue;
        const double d = view.disparity.disparity(y, x) + 0.5;
        const Eigen::Vector3d p = Eigen::Vector3d(x - 31.5, y - 23.5, 60) * 0.2 / d;
        if (d < 3.7 || p.norm() > 4) continue;
        const double error = 0.1 * std::sqrt(2) * p.z() * p.norm() / (60 * 0.2);  // (4.24)
        const Eigen::Vector3d world = view.world_from_cam.linear() * p + view.world_from_cam.translation();
        Sum& sum = cubes[{std::floor(world.x() / kEdge), std::floor(world.y() / kEdge), std::floor(world.z() / kEdge)}];
        Eigen::Vector3d rgb;
        for (int i = 0; i < 3; ++i) {
          const double s =
              (view.image.channels() == 3 ? view.image.at<cv::Vec3b>(y, x)[2 - i] : view.image.at<uchar>(y, x)) / 255.0;
          rgb[i] = s <= 0.04045 ? s / 12.92 : std::pow((s + 0.055) / 1.055, 2.4);
        }
        sum.w += 1 / (error * error);
        sum.p += world / (error * error);
        sum.c += rgb / (error * error);
        ++sum.pixels;
      }
    }
  }
  const std::vector<ColouredPoint> points = points_of(write(views, options), 0);
  ASSERT_EQ(points.size(), cubes.size());
  ASSERT_GT(points.size(), 300u);
  int shared = 0;
  for (const ColouredPoint& point : points) {
    const Eigen::Vector3d p = point.position.cast<double>();
    const auto found = cubes.find({std::floor(p.x() / kEdge), std::floor(p.y() / kEdge), std::floor(p.z() / kEdge)});
    ASSERT_NE(found, cubes.end());
    const Sum& sum = found->second;
    shared += sum.pixels > 1;
    EXPECT_LT((p - sum.p / sum.w).norm(), 1e-6);  // floats of a few metres
    for (int i = 0; i < 3; ++i) EXPECT_NEAR(point.colour[i], 65535 * sum.c[i] / sum.w, 1);
    EXPECT_EQ(point.colour[3], 65535);
  }
  EXPECT_GT(shared, 100);
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

TEST_F(SceneFile, CoarserCubesKeepWithinTheBudget) {
  const std::vector<StereoView> views = three_views();
  SceneOptions options{.voxel = 0.01, .max_range = 40, .min_disparity = 1, .max_points = 1 << 20};
  const size_t all = points_of(write(views, options), 0).size();
  ASSERT_GT(all, 3000u);
  options.max_points = 1000;
  const tinygltf::Model model = write(views, options);
  const size_t few = points_of(model, 0).size();
  EXPECT_LE(few, 1000u);
  EXPECT_GT(few, 100u);
  // Thinning by the edge that was found gives the same cubes as thinning by it from the start.
  SceneOptions direct = options;
  direct.voxel = model.asset.extras.Get("voxel").GetNumberAsDouble();
  EXPECT_GT(direct.voxel, options.voxel);
  direct.max_points = 1 << 20;
  EXPECT_EQ(points_of(write(views, direct), 0).size(), few);
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
  changed = views;
  changed[19].image = changed[19].image.clone();
  changed[19].image.at<cv::Vec3b>(20, 60)[1] ^= 16;
  changed[19].disparity.origin = changed[19].disparity.origin.clone();
  changed[19].disparity.origin(20, 60) = static_cast<uint8_t>(DisparityOrigin::measured);
  write(changed);
  EXPECT_NE(read_file(glb_), one);
}

TEST_F(SceneFile, AnEmptySceneIsAValidFileAndAnUnwritablePlaceAnError) {
  const tinygltf::Model model = write({});
  EXPECT_EQ(model.nodes.size(), 1u);
  EXPECT_TRUE(model.meshes.empty());
  EXPECT_THROW(write_scene(glb_ / "below_a_file.glb", {}, views::MemoryViewStore({}), {}, ""), InputError);
}

TEST_F(SceneFile, StopsWhenItIsAskedTo) {
  const std::vector<StereoView> views = three_views();
  std::atomic<bool> stop = true;
  const pipeline::RunControl control{.progress = ProgressStyle::quiet, .stop = &stop};
  EXPECT_THROW(write_scene(glb_, graph_of(views), views::MemoryViewStore(views), {}, "rover", control), Interrupted);
  EXPECT_FALSE(fs::exists(glb_));
  stop = false;
  write_scene(glb_, graph_of(views), views::MemoryViewStore(views), {}, "rover", control);
  EXPECT_TRUE(fs::exists(glb_));
}

TEST_F(SceneFile, AFullDiskIsAnErrorAndLeavesWhatWasThere) {
  const std::vector<StereoView> views = three_views();
  write({});
  const std::string before = read_file(glb_);
  bool refused = false;
  {
    const testing::FullDisk full(16 * 1024);
    try {
      write_scene(glb_, graph_of(views), views::MemoryViewStore(views), {.voxel = 0.001}, "rover");
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
  EXPECT_EQ(set.options().size(), 4u);
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
