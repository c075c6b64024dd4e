#include <fmt/format.h>
#include <octomap/ColorOcTree.h>
#include <octomap/OcTree.h>
#include <sys/resource.h>

#include <chrono>
#include <filesystem>

#include "bench/bench.h"
#include "bench/inputs.h"
#include "export/octree_file.h"
#include "iris/mapping/flog.h"
#include "iris/mapping/ray_fusion.h"
#include "iris/views/view_store.h"
#include "support/box_room.h"
#include "support/temporary_folder.h"

namespace iris::bench {
namespace {

using benchmark::State;
using mapping::FlogOptions;
using mapping::SightRays;

// One view from the middle of the map's heights, looking level into four directions, so that none is too similar to the
// one before.
std::vector<StereoView> turned_views() {
  std::vector<StereoView> views;
  for (int i = 0; i < 4; ++i) {
    StereoView view = *hand_held_views()[0];
    view.world_from_cam = testing::level_camera({0, 0, 1}, i * M_PI / 2);
    views.push_back(std::move(view));
  }
  return views;
}

// A hall whose walls, floor and ceiling are 5.6 m away on the mean, seen from its middle.
std::vector<StereoView> hall_views() {
  testing::BoxRoom hall;
  hall.low << -4.9, -4.9, -3;
  hall.high << 4.9, 4.9, 5;
  const RectifiedCamera camera{.f = 436, .cx = 375.5, .cy = 239.5, .baseline = 0.11, .width = 752, .height = 480};
  std::vector<StereoView> views;
  for (int i = 0; i < 4; ++i) {
    views.push_back(testing::view_of(hall, camera, testing::level_camera({0, 0, 1}, i * M_PI / 2), 0.1, 3u + i));
  }
  return views;
}

SightRays rays_of(const StereoView& view, const FlogOptions& options) {
  return mapping::sight_rays(view, {.min_disparity = options.min_disparity,
                                    .pixel_error = options.pixel_error,
                                    .min_error = options.min_spread * options.cell,
                                    .max_range = options.max_range,
                                    .step = options.ray_step});
}

octomap::Pointcloud points_of(const SightRays& rays) {
  octomap::Pointcloud points;
  for (const mapping::SightRay& ray : rays.rays) {
    const Eigen::Vector3d point = rays.origin + (ray.direction * std::min(ray.length, ray.end)).cast<double>();
    points.push_back(static_cast<float>(point.x()), static_cast<float>(point.y()), static_cast<float>(point.z()));
  }
  return points;
}

octomap::point3d point_of(const Eigen::Vector3d& p) {
  return {static_cast<float>(p.x()), static_cast<float>(p.y()), static_cast<float>(p.z())};
}

// The map has its final extent after the first round, as for most views of a recording.
void flog(State& state, const std::vector<StereoView>& views, int threads) {
  const FlogOptions options;
  mapping::FlogBuilder builder(options, views[0].camera);
  for (const StereoView& view : views) builder.add(view);
  size_t next = 0;
  measure(state, threads, [&] { benchmark::DoNotOptimize(builder.add(views[next++ % 4])); });
  set_rate(state, "Mrays/s", 1e-6 * static_cast<double>(rays_of(views[0], options).rays.size()));
}

void octomap_tree(State& state, const std::vector<StereoView>& views, bool discretise) {
  const FlogOptions options;
  octomap::OcTree tree(options.cell);
  std::vector<octomap::Pointcloud> clouds;
  for (const StereoView& view : views) clouds.push_back(points_of(rays_of(view, options)));
  const octomap::point3d origin = point_of(views[0].world_from_cam.translation());
  const auto add = [&](size_t i) { tree.insertPointCloud(clouds[i % 4], origin, options.max_range, true, discretise); };
  for (size_t i = 0; i < 4; ++i) add(i);
  size_t next = 0;
  measure(state, 1, [&] { add(next++); });
}

void our_octree(State& state) {
  std::vector<StereoView> list;
  for (const auto& view : hand_held_views()) list.push_back(*view);
  const views::MemoryViewStore store(std::move(list));
  const testing::TemporaryFolder folder;
  measure(state, 1, [&] { exporters::write_octree(folder.path(), store, {}); });
}

void octomap_octree(State& state) {
  const exporters::OctreeOptions options;
  const auto& views = hand_held_views();
  const testing::TemporaryFolder folder;
  measure(state, 1, [&] {
    octomap::ColorOcTree tree(options.resolution);
    for (const auto& view : views) {
      const SightRays rays = mapping::sight_rays(*view, {.min_disparity = options.min_disparity,
                                                         .pixel_error = options.pixel_error,
                                                         .min_error = options.resolution,
                                                         .max_range = options.max_range,
                                                         .step = options.ray_step});
      const octomap::Pointcloud points = points_of(rays);
      tree.insertPointCloud(points, point_of(rays.origin), options.max_range, true);
      for (size_t i = 0; i < points.size(); ++i) {
        const int pixel = rays.rays[i].pixel;
        const uint8_t grey = view->image.at<uint8_t>(pixel / view->camera.width, pixel % view->camera.width);
        const octomap::point3d& p = points[i];
        tree.averageNodeColor(p.x(), p.y(), p.z(), grey, grey, grey);
      }
    }
    tree.updateInnerOccupancy();
    tree.prune();
    tree.write((folder.path() / "map.ot").string());
    tree.writeBinary((folder.path() / "map.bt").string());
  });
}

// A site of 100 m x 100 m x 5 m: halls of 10 m, each seen from four places in six directions, made when they are asked
// for.
class Site : public views::ViewStore {
 public:
  Site() {
    for (int i = 0; i < 100 * kViews; ++i) {
      summaries_.push_back({.frame_idx = i, .camera = camera_, .world_from_cam = pose(i), .max_disparity = 100});
    }
  }
  const std::vector<views::ViewSummary>& summaries() const override { return summaries_; }
  std::shared_ptr<const StereoView> load(int index) const override {
    testing::BoxRoom hall;
    hall.low = corner(index);
    hall.high = hall.low + Eigen::Vector3d(9.9, 9.9, 5);
    return std::make_shared<StereoView>(
        testing::view_of(hall, camera_, pose(index), 0.1, static_cast<uint32_t>(index)));
  }

 private:
  static constexpr int kViews = 24;
  static Eigen::Vector3d corner(int index) {
    const int hall = index / kViews;
    return {10.0 * (hall % 10), 10.0 * (hall / 10), 0};
  }
  static Pose pose(int index) {
    const int view = index % kViews;
    const Eigen::Vector3d place(2.5 + 5 * (view % 2), 2.5 + 5 * (view / 2 % 2), 1.5);
    return testing::level_camera(corner(index) + place, view / 4 * M_PI / 3, 0.2 - 0.4 * (view % 2));
  }
  const RectifiedCamera camera_{.f = 250, .cx = 159.5, .cy = 119.5, .baseline = 0.2, .width = 320, .height = 240};
  std::vector<views::ViewSummary> summaries_;
};

}  // namespace

void print_large_octree() {
  const testing::TemporaryFolder folder;
  exporters::OctreeOptions options;
  options.resolution = 0.05;
  options.ray_step = 1;
  const Site site;
  const auto begin = std::chrono::steady_clock::now();
  const exporters::OctreeSummary summary = exporters::write_octree(folder.path(), site, options);
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  rusage usage;
  getrusage(RUSAGE_SELF, &usage);
  constexpr double kCube = 0.05 * 0.05 * 0.05;
  fmt::print(
      "octree of a site of 100 m x 100 m x 5 m, cubes of 0.05 m: {} views, {:.1f} million cubes occupied, {:.0f} free "
      "({:.0f} m3 known), {:.0f} s, {:.0f} MiB at most, map.ot {:.0f} MB, map.bt {:.1f} MB\n",
      site.summaries().size(), 1e-6 * static_cast<double>(summary.occupied), 1e-6 * static_cast<double>(summary.free),
      kCube * static_cast<double>(summary.occupied + summary.free), seconds,
      static_cast<double>(usage.ru_maxrss) / 1024, 1e-6 * static_cast<double>(file_size(folder.path() / "map.ot")),
      1e-6 * static_cast<double>(file_size(folder.path() / "map.bt")));
}

void register_mapping() {
  const std::string input = hand_held().name;
  compare("mapping", "add a view, 5 cm", input,
          {{"IRIS", [](State& state) { flog(state, turned_views(), 1); }},
           {"OctoMap insertPointCloud", [](State& state) { octomap_tree(state, turned_views(), false); }},
           {"OctoMap, one ray a cube", [](State& state) { octomap_tree(state, turned_views(), true); }}});
  compare("mapping", "add a view, 5 cm", "hall 752x480, rays of 5.6 m",
          {{"IRIS", [](State& state) { flog(state, hall_views(), 1); }},
           {"OctoMap insertPointCloud", [](State& state) { octomap_tree(state, hall_views(), false); }},
           {"OctoMap, one ray a cube", [](State& state) { octomap_tree(state, hall_views(), true); }}});
  compare("mapping", "add a view, two threads", input,
          {{"IRIS", [](State& state) { flog(state, turned_views(), 2); }},
           {"IRIS, one thread", [](State& state) { flog(state, turned_views(), 1); }}},
          Uses::several);
  compare("octree", "five views to files, 10 cm", input, {{"IRIS", our_octree}, {"OctoMap", octomap_octree}});
}

}  // namespace iris::bench
