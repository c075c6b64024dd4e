#include <octomap/ColorOcTree.h>
#include <octomap/OcTree.h>

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
void flog(State& state, int threads) {
  const FlogOptions options;
  const std::vector<StereoView> views = turned_views();
  mapping::FlogBuilder builder(options, views[0].camera);
  for (const StereoView& view : views) builder.add(view);
  size_t next = 0;
  measure(state, threads, [&] { benchmark::DoNotOptimize(builder.add(views[next++ % 4])); });
  set_rate(state, "Mrays/s", 1e-6 * static_cast<double>(rays_of(views[0], options).rays.size()));
}

void octomap_tree(State& state, bool discretise) {
  const FlogOptions options;
  octomap::OcTree tree(options.cell);
  std::vector<octomap::Pointcloud> clouds;
  for (const StereoView& view : turned_views()) clouds.push_back(points_of(rays_of(view, options)));
  const octomap::point3d origin = point_of(turned_views()[0].world_from_cam.translation());
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

}  // namespace

void register_mapping() {
  const std::string input = hand_held().name;
  compare("mapping", "add a view, 5 cm", input,
          {{"IRIS", [](State& state) { flog(state, 1); }},
           {"OctoMap insertPointCloud", [](State& state) { octomap_tree(state, false); }},
           {"OctoMap, one ray a cube", [](State& state) { octomap_tree(state, true); }}});
  compare("mapping", "add a view, two threads", input,
          {{"IRIS", [](State& state) { flog(state, 2); }}, {"IRIS, one thread", [](State& state) { flog(state, 1); }}},
          Uses::several);
  compare("octree", "five views to files, 10 cm", input, {{"IRIS", our_octree}, {"OctoMap", octomap_octree}});
}

}  // namespace iris::bench
