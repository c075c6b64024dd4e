#include "export/octree_file.h"

#include <octomap/ColorOcTree.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>
#include <tuple>
#include <vector>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/mapping/ray_fusion.h"

namespace iris::exporters {
namespace {

using mapping::SightRay;
using mapping::SightRays;
using mapping::TileRays;

constexpr int kSide = 16;  // cubes along a side of a tile
constexpr int kCubes = kSide * kSide * kSide;
constexpr double kSurface = 0.35;  // membership of occupancy from here on is a surface

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

// Sums of integers: their order does not matter.
void add_colours(const SightRays& rays, const TileRays::Tile& task, const mapping::TiledGrid& grid,
                 const cv::Mat& image, Tile& tile) {
  const Eigen::Vector3i low = task.index * kSide;
  for (const uint32_t i : task.rays) {
    const SightRay& ray = rays.rays[i];
    if (ray.length >= ray.end) continue;  // cut before its point
    const Eigen::Vector3d point = rays.origin + ray.direction.cast<double>() * ray.length;
    const Eigen::Vector3i cube = point.cwiseQuotient(grid.box).array().floor().cast<int>().matrix() - low;
    if (cube.minCoeff() < 0 || cube.maxCoeff() >= kSide) continue;
    ColourSum& sum = tile.colours[(cube.z() * kSide + cube.y()) * kSide + cube.x()];
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

// Moves finished tiles into the octree, where empty space shrinks to a few nodes.
void store_tile(const TileIndex& index, const Tile& tile, const OctreeOptions& options, octomap::ColorOcTree& tree,
                OctreeSummary& summary) {
  const auto [tz, ty, tx] = index;
  constexpr int kCentre = 1 << 15;  // key of the cube whose lower corner is the origin
  for (int i = 0; i < kCubes; ++i) {
    const float value = log_odds(tile.cells[static_cast<size_t>(i)], options);
    if (value == 0) continue;
    const std::array<int, 3> cube = {tx * kSide + i % kSide, ty * kSide + i / kSide % kSide,
                                     tz * kSide + i / (kSide * kSide)};
    octomap::OcTreeKey key;
    bool inside = true;
    for (size_t a = 0; a < 3; ++a) {
      const int k = cube[a] + kCentre;
      inside = inside && k >= 0 && k < 2 * kCentre;
      key[static_cast<unsigned>(a)] = static_cast<octomap::key_type>(k);
    }
    if (!inside) continue;
    octomap::ColorOcTreeNode* node = tree.setNodeValue(key, value, true);
    ++(value > 0 ? summary.occupied : summary.free);
    const auto found = value > 0 ? tile.colours.find(i) : tile.colours.end();
    if (found == tile.colours.end()) continue;
    const ColourSum& sum = found->second;
    const auto mean = [&](size_t c) { return static_cast<uint8_t>((sum.bgr[c] + sum.count / 2) / sum.count); };
    node->setColor(mean(2), mean(1), mean(0));
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
                           const OctreeOptions& options) {
  const auto& summaries = views.summaries();
  const int count = static_cast<int>(summaries.size());
  for (const views::ViewSummary& view : summaries) IRIS_CHECK(view.submap == summaries.front().submap);
  const mapping::TiledGrid grid{.box = Eigen::Vector3d::Constant(options.resolution),
                                .tile_boxes = Eigen::Vector3i::Constant(kSide)};
  const double tile_size = kSide * options.resolution;
  octomap::ColorOcTree tree(options.resolution);
  OctreeSummary summary;
  std::map<TileIndex, Tile> tiles;
  for (int v = 0; v < count; ++v) {
    const auto view = views.load(v);
    const SightRays rays = mapping::sight_rays(*view, {.min_disparity = options.min_disparity,
                                                       .pixel_error = options.pixel_error,
                                                       .min_error = options.resolution,
                                                       .max_range = options.max_range,
                                                       .step = options.ray_step});
    const TileRays sorted = mapping::sort_by_tile(rays, grid);
    std::vector<Tile*> touched;
    for (const TileRays::Tile& task : sorted.tiles) {
      touched.push_back(&tiles[{task.index.z(), task.index.y(), task.index.x()}]);
    }
    // Nt = 3 NK as for the map.
    const double cube_px = view->camera.f * options.resolution / options.ray_step;
    const auto max_rays = static_cast<uint32_t>(std::max(3.0, std::round(3 * cube_px * cube_px)));
    parallel_chunks(0, static_cast<int>(touched.size()), 1, [&](int begin, int end) {
      for (int i = begin; i < end; ++i) {
        const auto at = static_cast<size_t>(i);
        mapping::fuse_rays(rays, sorted.tiles[at].rays, grid, sorted.tiles[at].index, max_rays, touched[at]->cells);
        add_colours(rays, sorted.tiles[at], grid, view->image, *touched[at]);
      }
    });
    // Tiles that no later view can reach are finished: memory does not grow with the session.
    std::erase_if(tiles, [&](const auto& entry) {
      const auto& [index, tile] = entry;
      const Eigen::Vector3d low =
          Eigen::Vector3d(std::get<2>(index), std::get<1>(index), std::get<0>(index)) * tile_size;
      const Eigen::Vector3d high = low + Eigen::Vector3d::Constant(tile_size);
      for (int later = v + 1; later < count; ++later) {
        const Eigen::Vector3d camera = summaries[static_cast<size_t>(later)].world_from_cam.translation();
        const Eigen::Vector3d nearest = camera.cwiseMax(low).cwiseMin(high);
        if ((nearest - camera).norm() <= options.max_range + 1e-6) return false;
      }
      store_tile(index, tile, options, tree, summary);
      return true;
    });
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
