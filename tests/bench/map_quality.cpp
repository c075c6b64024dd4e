// How good and how fast maps are, beside OctoMap's own fusion of the same rays: a table of docs/benchmarks.md.
#include <fmt/format.h>
#include <octomap/OcTree.h>

#include <cmath>
#include <ctime>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "bench/bench.h"
#include "bench/inputs.h"
#include "export/evaluation_files.h"
#include "iris/evaluate/map.h"
#include "iris/mapping/flog.h"
#include "iris/mapping/ray_fusion.h"
#include "iris/stereo/mwmf.h"

namespace iris::bench {
namespace fs = std::filesystem;
namespace {

using mapping::FlogOptions;

struct Apartment {
  std::vector<StereoView> views;  // with true poses
  evaluate::GridMap plan;
};

// Every few views: OctoMap takes 0.4 s for each of them.
Apartment read_apartment(const fs::path& folder) {
  constexpr size_t kEvery = 4;
  const Recording recording = read_recording(folder, folder / "truth/trajectory.tum");
  stereo::MwmfOptions stereo;
  stereo.disparities = 128;
  stereo.interpolation = "within";
  Apartment apartment{.views = std::vector<StereoView>((recording.pairs.size() + kEvery - 1) / kEvery),
                      .plan = exporters::read_map(folder / "truth/plan.yaml", true)};
  parallel_chunks(0, static_cast<int>(apartment.views.size()), 1, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      const size_t frame = kEvery * static_cast<size_t>(i);
      const StereoPair& pair = recording.pairs[frame];
      apartment.views[static_cast<size_t>(i)] = {.frame_idx = static_cast<int>(frame),
                                                 .camera = recording.camera,
                                                 .image = pair.left,
                                                 .disparity = stereo::mwmf(pair.left, pair.right, stereo),
                                                 .world_from_cam = recording.world_from_cam[frame]};
    }
  });
  return apartment;
}

mapping::SightRays rays_of(const StereoView& view, const FlogOptions& options) {
  return mapping::sight_rays(view, {.min_disparity = options.min_disparity,
                                    .pixel_error = options.pixel_error,
                                    .min_error = options.min_spread * options.cell,
                                    .max_range = options.max_range,
                                    .step = options.ray_step});
}

// What lies above each other, as the layered map has it: occupied before free before unknown.
evaluate::GridMap flattened(const octomap::OcTree& tree, const FlogOptions& options, const evaluate::GridMap& plan) {
  constexpr int kMargin = 400;  // [cells] beyond the plan: false cells there count as well
  evaluate::GridMap map{
      .cells = cv::Mat1b::zeros(plan.cells.rows + 2 * kMargin, plan.cells.cols + 2 * kMargin),
      .resolution = options.cell,
      .origin_x = plan.origin_x - kMargin * options.cell,
      .origin_y = plan.origin_y - kMargin * options.cell,
  };
  for (auto leaf = tree.begin_leafs(); leaf != tree.end_leafs(); ++leaf) {
    const double half = leaf.getSize() / 2, side = options.cell;
    if (leaf.getZ() + half <= options.bottom + 1e-6 || leaf.getZ() - half >= options.bottom + options.height - 1e-6)
      continue;
    const evaluate::Cell state = tree.isNodeOccupied(*leaf) ? evaluate::Cell::occupied : evaluate::Cell::free;
    for (double y = leaf.getY() - half + side / 2; y < leaf.getY() + half; y += side) {
      for (double x = leaf.getX() - half + side / 2; x < leaf.getX() + half; x += side) {
        const cv::Point cell = map.cell_of(x, y);
        if (!cv::Rect(0, 0, map.cells.cols, map.cells.rows).contains(cell)) continue;
        map.cells(cell) = std::max(map.cells(cell), static_cast<uint8_t>(state));
      }
    }
  }
  return map;
}

void print_row(const std::string& name, const evaluate::GridMap& map, const Apartment& apartment, double seconds,
               double rays, double megabytes) {
  const evaluate::MapErrors e = evaluate::evaluate_map(map, apartment.plan, Pose::Identity(), {});
  fmt::print("| {} | {:.1f} | {:.1f} | {:.1f} | {:.1f} | {:.1f} | {:.2f} | {:.1f} |\n", name, e.occupied_precision(),
             e.occupied_recall(), e.free_precision(), e.free_recall(),
             1e3 * seconds / static_cast<double>(apartment.views.size()), 1e-6 * rays / seconds, megabytes);
}

// Processor time of one thread.
double seconds_of(const std::function<void()>& work) {
  const std::clock_t begin = std::clock();
  with_threads(1, work);
  return static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC;
}

void print_flog(const std::string& name, const FlogOptions& options, const Apartment& apartment, double rays) {
  mapping::FlogBuilder builder(options, apartment.views.front().camera);
  const double seconds = seconds_of([&] {
    for (const StereoView& view : apartment.views) builder.add(view);
  });
  double bytes = 0;
  for (const auto& tile : builder.map().tiles) {
    if (tile) bytes += static_cast<double>(tile->cells.size() * sizeof(FlogCell));
  }
  const mapping::MapRaster raster = mapping::rasterise(builder.map(), options);
  const evaluate::GridMap map{
      .cells = raster.state, .resolution = raster.cell, .origin_x = raster.origin_x, .origin_y = raster.origin_y};
  print_row(name, map, apartment, seconds, rays, 1e-6 * bytes);
}

}  // namespace

void print_map_quality(const fs::path& folder) {
  const FlogOptions options;
  const Apartment apartment = read_apartment(folder);
  double rays = 0;
  for (const StereoView& view : apartment.views) rays += static_cast<double>(rays_of(view, options).rays.size());
  fmt::print(
      "\nApartment, {} views with true poses, cells of {:g} m between {:g} and {:g} m of height, "
      "one thread; percent.\n\n"
      "| | occupied: precision | recall | free: precision | recall | ms a view | Mrays/s | MB "
      "|\n|-|-:|-:|-:|-:|-:|-:|-:|\n",
      apartment.views.size(), options.cell, options.bottom, options.bottom + options.height);
  octomap::OcTree tree(options.cell);
  const double seconds = seconds_of([&] {
    for (const StereoView& view : apartment.views) {
      const mapping::SightRays of_view = rays_of(view, options);
      octomap::Pointcloud points;
      for (const mapping::SightRay& ray : of_view.rays) {
        const Eigen::Vector3d p = of_view.origin + (ray.direction * std::min(ray.length, ray.end)).cast<double>();
        points.push_back(static_cast<float>(p.x()), static_cast<float>(p.y()), static_cast<float>(p.z()));
      }
      const Eigen::Vector3f o = of_view.origin.cast<float>();
      tree.insertPointCloud(points, {o.x(), o.y(), o.z()}, options.max_range, true);
    }
  });
  tree.updateInnerOccupancy();
  print_row("OctoMap, insertPointCloud", flattened(tree, options, apartment.plan), apartment, seconds, rays,
            1e-6 * static_cast<double>(tree.memoryUsage()));
  FlogOptions thesis = options;  // cells as high as layers, all that any ray says
  thesis.slices = 1;
  thesis.bundle = 0;
  thesis.min_confidence = 0.01;
  thesis.occupied_level = 0.35;
  thesis.seen_only = false;
  thesis.min_views = 1;
  print_flog("FLOG, thesis", thesis, apartment, rays);
  print_flog("FLOG, default", options, apartment, rays);
  FlogOptions cubes = options;
  cubes.slices = static_cast<int>(std::lround(options.height / options.layers / options.cell));
  print_flog("FLOG, cubes", cubes, apartment, rays);
}

}  // namespace iris::bench
