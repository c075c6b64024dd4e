#include "export/octree_file.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <tuple>
#include <vector>

#include "export/octree_stream.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/mapping/ray_fusion.h"

namespace iris::exporters {
namespace {

using mapping::SightRay;
using mapping::SightRays;

constexpr int kSide = OctreeStream::kTileSide;  // cubes along a side of a tile
constexpr int kCubes = kSide * kSide * kSide;
constexpr double kSurface = 0.35;  // membership of occupancy from here on is a surface
constexpr int kRegionTiles = 48;   // tiles along a side of a region, of any height
constexpr double kBundle = 0.5;    // as FlogOptions::bundle

struct ColourSum {
  std::array<uint32_t, 3> bgr = {};
  uint32_t count = 0;
  static constexpr uint32_t kMost = 1u << 24;  // points that fit; those of later views are left out
};

struct Tile {
  std::vector<FlogCell> cells = std::vector<FlogCell>(kCubes);
  // Of the cubes that hold measured points: which of the sums is theirs, counted from 1.
  std::vector<uint16_t> colour_of;
  std::vector<ColourSum> colours;
};

using TileIndex = std::tuple<int, int, int>;  // z, y, x

cv::Vec3b colour_at(const cv::Mat& image, int pixel) {
  const int y = pixel / image.cols, x = pixel % image.cols;
  return image.channels() == 3 ? image.at<cv::Vec3b>(y, x) : cv::Vec3b::all(image.at<uint8_t>(y, x));
}

using Tiles = std::map<TileIndex, Tile>;

// Sums of integers: their order does not matter.
void add_colours(const SightRays& rays, double resolution, const cv::Mat& image, Tiles& tiles) {
  static_assert((kSide & (kSide - 1)) == 0);
  constexpr int kShift = std::countr_zero(static_cast<unsigned>(kSide));
  TileIndex last_index;
  Tile* last = nullptr;
  for (const SightRay& ray : rays.rays) {
    if (ray.length >= ray.end) continue;  // cut before its point
    const Eigen::Vector3d point = rays.origin + ray.direction.cast<double>() * ray.length;
    const Eigen::Vector3i cube = (point / resolution).array().floor().cast<int>();
    const TileIndex index = {cube.z() >> kShift, cube.y() >> kShift, cube.x() >> kShift};
    if (!last || index != last_index) {
      const auto found = tiles.find(index);
      if (found == tiles.end()) continue;
      last = &found->second;
      last_index = index;
    }
    const auto in_tile = [](int i) { return i & (kSide - 1); };
    if (last->colour_of.empty()) last->colour_of.resize(kCubes);
    uint16_t& place = last->colour_of[static_cast<size_t>((in_tile(cube.z()) * kSide + in_tile(cube.y())) * kSide +
                                                          in_tile(cube.x()))];
    if (place == 0) {
      last->colours.emplace_back();
      place = static_cast<uint16_t>(last->colours.size());
    }
    ColourSum& sum = last->colours[place - 1u];
    if (sum.count == ColourSum::kMost) continue;
    const cv::Vec3b colour = colour_at(image, ray.pixel);
    for (int c = 0; c < 3; ++c) sum.bgr[static_cast<size_t>(c)] += colour[c];
    ++sum.count;
  }
}

// Log-odds of a cube; 0 = unknown.
float log_odds(const FlogCell& cell, const OctreeOptions& options) {
  if (static_cast<int64_t>(cell.rays) < options.min_rays) return 0;
  const double E = cell.mu_empty(), O = cell.mu_occupied();
  const bool surface = O >= kSurface;
  if (!surface && std::min(1 - E, 1 - O) > 0.5) return 0;
  const double share = O / (E + O);
  const double s = share < kSurface ? 0.5 * share / kSurface : 0.5 + 0.5 * (share - kSurface) / (1 - kSurface);
  const double n = cell.rays;
  const double p = std::clamp(0.5 + (s - 0.5) * n / (n + 4), 0.1192, 0.971);
  const double steps = std::round(8 * std::log(p / (1 - p)));
  // A known cube is never exactly undecided.
  return static_cast<float>((surface ? std::max(steps, 1.0) : std::min(steps, -1.0)) / 8);
}

// Moves a finished region to the files, tile by tile.
void store_tiles(const Tiles& tiles, const OctreeOptions& options, const pipeline::RunControl& control,
                 OctreeStream& stream, OctreeSummary& summary) {
  constexpr int kAtOnce = 64;  // tiles; bounds the memory of what waits to be written
  struct Stored {
    OctreeTile tile;
    OctreeSummary counts;
  };
  std::vector<const Tiles::value_type*> waiting;
  for (const auto& entry : tiles) {
    const auto [z, y, x] = entry.first;
    if (OctreeStream::is_inside({x, y, z})) waiting.push_back(&entry);
  }
  for (size_t first = 0; first < waiting.size(); first += kAtOnce) {
    if (control.stopped()) throw Interrupted();
    const size_t count = std::min<size_t>(kAtOnce, waiting.size() - first);
    std::vector<Stored> stored(count);
    parallel_chunks(0, static_cast<int>(count), 1, [&](int begin, int end) {
      std::vector<OctreeCube> cubes(kCubes);
      for (int t = begin; t < end; ++t) {
        const auto& [index, tile] = *waiting[first + static_cast<size_t>(t)];
        Stored& result = stored[static_cast<size_t>(t)];
        for (size_t i = 0; i < kCubes; ++i) {
          cubes[i] = {.log_odds = log_odds(tile.cells[i], options)};
          result.counts.occupied += cubes[i].log_odds > 0;
          result.counts.free += cubes[i].log_odds < 0;
        }
        if (result.counts.occupied + result.counts.free == 0) continue;
        for (size_t i = 0; i < tile.colour_of.size(); ++i) {
          if (tile.colour_of[i] == 0 || cubes[i].log_odds <= 0) continue;
          const ColourSum& sum = tile.colours[tile.colour_of[i] - 1u];
          const auto mean = [&](size_t c) { return static_cast<uint8_t>((sum.bgr[c] + sum.count / 2) / sum.count); };
          cubes[i].rgb = {mean(2), mean(1), mean(0)};
        }
        const auto [z, y, x] = index;
        result.tile = OctreeStream::subtree({x, y, z}, cubes);
      }
    });
    for (const Stored& result : stored) {
      summary.occupied += result.counts.occupied;
      summary.free += result.counts.free;
      if (result.tile.node.exists) stream.add(result.tile);
    }
  }
}

// Where the rays of a view can end that are cut at a distance: what holds the pyramid of its sight to that depth.
Eigen::AlignedBox3d sight_box(const views::ViewSummary& view, double range) {
  Eigen::AlignedBox3d box(view.world_from_cam.translation());
  const RectifiedCamera& camera = view.camera;
  for (const double x : {0, camera.width}) {
    for (const double y : {0, camera.height}) {
      const Eigen::Vector3d corner((x - camera.cx) / camera.f, (y - camera.cy) / camera.f, 1);
      box.extend(view.world_from_cam * (range * corner));
    }
  }
  return box;
}

}  // namespace

void OctreeOptions::declare(OptionSet& set) {
  set.section("octree");
  set.add("resolution", resolution, "m", 0.005, 10,
          "side of the smallest cube; half of it takes about eight times the memory");
  set.add("max_range", max_range, "m", 0.1, 1000, "rays are cut at this distance; what lies beyond stays unknown");
  set.add("min_disparity", min_disparity, "px", 0.1, 1000,
          "rays of smaller disparities are followed only to the distance of this one");
  set.add("pixel_error", pixel_error, "px", 0.001, 10,
          "error of image coordinates: makes surfaces thicker with distance");
  set.add("ray_step", ray_step, "px", 1, 64, "every n-th row and column gives rays");
  set.add("min_rays", min_rays, "", 1, 100000, "cubes that fewer rays crossed stay unknown");
}

OctreeSummary write_octree(const std::filesystem::path& folder, const views::ViewStore& views,
                           const OctreeOptions& options, const pipeline::RunControl& control) {
  const auto& summaries = views.summaries();
  const int count = static_cast<int>(summaries.size());
  for (const views::ViewSummary& view : summaries) IRIS_CHECK(view.submap == summaries.front().submap);
  const mapping::TiledGrid grid{.box = Eigen::Vector3d::Constant(options.resolution),
                                .tile_boxes = Eigen::Vector3i::Constant(kSide)};
  OctreeStream stream(folder);
  OctreeSummary summary;

  // Region after region, each with the views that reach it: memory grows neither with the session nor with loops.
  const double tile_size = kSide * options.resolution;
  const auto tile_of = [&](double metres) { return static_cast<int>(std::floor(metres / tile_size)); };
  std::vector<Eigen::AlignedBox3d> boxes;
  Eigen::AlignedBox3d all;
  for (const views::ViewSummary& view : summaries) {
    boxes.push_back(sight_box(view, options.max_range));
    boxes.back().min().array() -= options.resolution;
    boxes.back().max().array() += options.resolution;
    all.extend(boxes.back());
  }
  // The first region begins where the first tile can be.
  const int first_x = count > 0 ? tile_of(all.min().x()) : 0, first_y = count > 0 ? tile_of(all.min().y()) : 0;
  std::map<std::pair<int, int>, std::vector<int>> regions;  // y, x
  for (int v = 0; v < count; ++v) {
    const Eigen::AlignedBox3d& box = boxes[static_cast<size_t>(v)];
    const auto region_of = [&](double metres, int first) { return (tile_of(metres) - first) / kRegionTiles; };
    for (int y = region_of(box.min().y(), first_y); y <= region_of(box.max().y(), first_y); ++y) {
      for (int x = region_of(box.min().x(), first_x); x <= region_of(box.max().x(), first_x); ++x) {
        regions[{y, x}].push_back(v);
      }
    }
  }
  int64_t loads = 0, loaded = 0;
  for (const auto& [region, of_region] : regions) loads += static_cast<int64_t>(of_region.size());
  Progress progress(control.progress, "octree", loads);
  for (const auto& [region, of_region] : regions) {
    const auto& [region_y, region_x] = region;
    Tiles tiles;
    for (const int v : of_region) {
      if (control.stopped()) throw Interrupted();
      const auto view = views.load(v);
      const mapping::RayOptions ray_options{.min_disparity = options.min_disparity,
                                            .pixel_error = options.pixel_error,
                                            .min_error = options.resolution,
                                            .max_range = options.max_range,
                                            .step = options.ray_step};
      // Nt = 3 NK as for the map.
      const double cube_px = view->camera.f * options.resolution / options.ray_step;
      const auto max_rays = static_cast<uint32_t>(std::max(3.0, std::round(3 * cube_px * cube_px)));
      mapping::fuse_view(
          *view, ray_options, grid, {.max_rays = max_rays, .bundle = kBundle},
          [&](const Eigen::Vector3i& index) -> std::span<FlogCell> {
            if ((index.x() - first_x) / kRegionTiles != region_x || (index.y() - first_y) / kRegionTiles != region_y) {
              return {};
            }
            return tiles[{index.z(), index.y(), index.x()}].cells;
          });
      add_colours(mapping::sight_rays(*view, ray_options), options.resolution, view->image, tiles);
      progress.update(++loaded);
    }
    store_tiles(tiles, options, control, stream, summary);
  }
  stream.write(options.resolution);

  nlohmann::ordered_json json = {
      {"frame", "world"},
      {"axes", "z up, right-handed; the same frame as the map and the trajectory"},
      {"unit", "m"},
      {"resolution", options.resolution},
      {"max_range", options.max_range},
      {"views", count},
      {"submap", count > 0 ? summaries.front().submap : 0},
      {"occupied_cubes", summary.occupied},
      {"free_cubes", summary.free},
      {"files",
       {{"map.ot", "ColorOcTree: log-odds and colours"}, {"map.bt", "OcTree: occupied or free, most likely state"}}}};
  write_file(folder / "octree.json", json.dump(2) + "\n");
  return summary;
}

}  // namespace iris::exporters
