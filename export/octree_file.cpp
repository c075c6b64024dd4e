#include "export/octree_file.h"

#include <octomap/ColorOcTree.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>
#include <tuple>
#include <vector>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/mapping/ray_fusion.h"

namespace iris::exporters {
namespace {

using mapping::SightRay;
using mapping::SightRays;

constexpr int kSide = 16;  // cubes along a side of a tile
constexpr int kCubes = kSide * kSide * kSide;
constexpr double kSurface = 0.35;  // membership of occupancy from here on is a surface
constexpr int kRegionTiles = 48;   // tiles along a side of a region, of any height
constexpr double kBundle = 0.5;    // as FlogOptions::bundle

struct ColourSum {
  std::array<uint64_t, 3> bgr = {};
  uint64_t count = 0;
};

struct Tile {
  std::vector<FlogCell> cells = std::vector<FlogCell>(kCubes);
  std::map<int, ColourSum> colours;  // of the cubes that hold measured points
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
    ColourSum& sum = last->colours[(in_tile(cube.z()) * kSide + in_tile(cube.y())) * kSide + in_tile(cube.x())];
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

std::string bytes_of(const octomap::AbstractOcTree& tree) {
  std::ostringstream stream;
  IRIS_CHECK(tree.write(stream));
  return std::move(stream).str();
}

constexpr int kCentre = 1 << 15;  // key of the cube whose lower corner is the origin

bool is_inside(const std::array<int, 3>& cube) {
  return std::all_of(cube.begin(), cube.end(), [](int k) { return k >= -kCentre && k < kCentre; });
}

octomap::OcTreeKey key_of(const std::array<int, 3>& cube) {
  const auto key = [](int k) { return static_cast<octomap::key_type>(k + kCentre); };
  return {key(cube[0]), key(cube[1]), key(cube[2])};
}

// Moves a finished tile into the octree, where empty space shrinks to a few nodes.
void store_tile(const TileIndex& index, const Tile& tile, const OctreeOptions& options, octomap::ColorOcTree& tree,
                OctreeSummary& summary) {
  const auto [tz, ty, tx] = index;
  for (int i = 0; i < kCubes; ++i) {
    const float value = log_odds(tile.cells[static_cast<size_t>(i)], options);
    if (value == 0) continue;
    const std::array<int, 3> cube = {tx * kSide + i % kSide, ty * kSide + i / kSide % kSide,
                                     tz * kSide + i / (kSide * kSide)};
    if (!is_inside(cube)) continue;
    octomap::ColorOcTreeNode* node = tree.setNodeValue(key_of(cube), value, true);
    ++(value > 0 ? summary.occupied : summary.free);
    const auto found = value > 0 ? tile.colours.find(i) : tile.colours.end();
    if (found == tile.colours.end()) continue;
    const ColourSum& sum = found->second;
    const auto mean = [&](size_t c) { return static_cast<uint8_t>((sum.bgr[c] + sum.count / 2) / sum.count); };
    node->setColor(mean(2), mean(1), mean(0));
  }
  // At once, or the leaves of all empty space would be held until the end.
  const unsigned depth = tree.getTreeDepth();
  for (unsigned level = 1; (1 << level) <= kSide; ++level) {
    const int side = 1 << level;
    for (int i = 0; i < kCubes / (side * side * side); ++i) {
      const int n = kSide / side;
      const std::array<int, 3> cube = {tx * kSide + i % n * side, ty * kSide + i / n % n * side,
                                       tz * kSide + i / (n * n) * side};
      const octomap::OcTreeKey key = key_of(cube);
      octomap::ColorOcTreeNode* node = is_inside(cube) ? tree.search(key, depth - level) : nullptr;
      if (node && tree.nodeHasChildren(node)) tree.pruneNode(node);
    }
  }
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
  octomap::ColorOcTree tree(options.resolution);
  OctreeSummary summary;

  // Region after region, each with the views that reach it: memory grows neither with the session nor with loops.
  const double tile_size = kSide * options.resolution, reach = options.max_range + options.resolution;
  const auto tile_of = [&](double metres) { return static_cast<int>(std::floor(metres / tile_size)); };
  Eigen::Vector3d corner = Eigen::Vector3d::Zero();  // the first region begins where the first tile can be
  for (int v = 0; v < count; ++v) {
    const Eigen::Vector3d low = summaries[static_cast<size_t>(v)].world_from_cam.translation().array() - reach;
    corner = v == 0 ? low : Eigen::Vector3d(corner.cwiseMin(low));
  }
  const int first_x = tile_of(corner.x()), first_y = tile_of(corner.y());
  std::map<std::pair<int, int>, std::vector<int>> regions;  // y, x
  for (int v = 0; v < count; ++v) {
    const Eigen::Vector3d camera = summaries[static_cast<size_t>(v)].world_from_cam.translation();
    const auto region_of = [&](double metres, int first) { return (tile_of(metres) - first) / kRegionTiles; };
    for (int y = region_of(camera.y() - reach, first_y); y <= region_of(camera.y() + reach, first_y); ++y) {
      for (int x = region_of(camera.x() - reach, first_x); x <= region_of(camera.x() + reach, first_x); ++x) {
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
      mapping::fuse_view(*view, ray_options, grid, {.max_rays = max_rays, .bundle = kBundle},
                         [&](const Eigen::Vector3i& index) -> std::span<FlogCell> {
                           const bool here = (index.x() - first_x) / kRegionTiles == region_x &&
                                             (index.y() - first_y) / kRegionTiles == region_y;
                           if (!here) return {};
                           return tiles[{index.z(), index.y(), index.x()}].cells;
                         });
      add_colours(mapping::sight_rays(*view, ray_options), options.resolution, view->image, tiles);
      progress.update(++loaded);
    }
    for (const auto& [index, tile] : tiles) {
      if (control.stopped()) throw Interrupted();
      store_tile(index, tile, options, tree, summary);
    }
  }
  if (tree.size() > 0) tree.updateInnerOccupancy();  // ColorOcTree follows its root unchecked
  tree.prune();
  write_file(folder / "map.ot", bytes_of(tree));

  // As a plain OcTree, which every reader of .bt knows: the data are the same, only the name in the header differs.
  tree.toMaxLikelihood();
  tree.prune();
  std::ostringstream stream;
  stream << "# Octomap OcTree binary file\nid OcTree\nsize " << tree.size() << "\nres " << options.resolution
         << "\ndata\n";
  tree.writeBinaryData(stream);
  write_file(folder / "map.bt", stream.str());

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
