#include "visibility.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>

#include "iris/core/parallel.h"
#include "iris/mapping/flog.h"

namespace iris::mapping {
namespace {

constexpr auto kFree = static_cast<uint8_t>(MapState::free), kOccupied = static_cast<uint8_t>(MapState::occupied);
constexpr int kSide = FlogMap::kTileCells;
// Occupied cells next to the cell in question do not hide it: a surface looked at from the side would hide itself.
constexpr int kNeighbour = 1;
constexpr double kAtCamera = 2;  // [cells] what is so near to the camera does not hide anything either
constexpr int kClear = 2;  // [cells] that sight keeps away from obstacles: nothing was seen through a narrower gap

struct Viewpoint {
  Eigen::Matrix3d cam_from_world;
  Eigen::Vector3d position;  // [m] world
  Eigen::Vector3d in_cells;  // the same in cells of the grid
};

class Sight {
 public:
  // `wider`: the obstacles are by so many cells.
  Sight(const FlogMap& map, const TileStates& obstacles, int wider)
      : map_(map),
        obstacles_(obstacles),
        top_(map.all_slices()),
        neighbour_(kNeighbour + wider),
        at_camera_(kAtCamera + wider),
        hides_(obstacles.size() * kBlocks * kBlocks) {
    parallel_chunks(0, static_cast<int>(obstacles.size()), 1, [&](int begin, int end) {
      for (int t = begin; t < end; ++t) {
        const std::vector<uint8_t>& tile = obstacles[static_cast<size_t>(t)];
        for (size_t i = 0; i < tile.size(); ++i) {
          if (tile[i] != static_cast<uint8_t>(MapState::occupied)) continue;
          hides_[block(static_cast<size_t>(t), static_cast<int>(i % kSide), static_cast<int>(i / kSide % kSide))] = 1;
        }
      }
    });
  }

  // Whether nothing occupied lies between a cell and the camera.
  bool is_free(const Eigen::Vector3i& target, const Eigen::Vector3d& camera) const {
    // To the corner that is nearest to the camera: a surface that is looked at from the side would hide the middle.
    const Eigen::Vector3d low = target.cast<double>();
    const Eigen::Vector3d start = camera.cwiseMax(low).cwiseMin(low + Eigen::Vector3d::Ones());
    const Eigen::Vector3d way = camera - start;
    const double end = 1 - at_camera_ / std::max(at_camera_, way.norm());
    Eigen::Vector3i cell = target, step;
    Eigen::Vector3d next, delta;
    for (int a = 0; a < 3; ++a) {
      step[a] = way[a] < 0 ? -1 : 1;
      delta[a] = way[a] == 0 ? std::numeric_limits<double>::infinity() : 1 / std::abs(way[a]);
      next[a] = way[a] == 0 ? delta[a] : (way[a] > 0 ? low[a] + 1 - start[a] : start[a] - low[a]) * delta[a];
    }
    const auto boundary = [&](int a) {  // where the way leaves the cell along this axis, as part of the way
      return (way[a] > 0 ? cell[a] + 1 - start[a] : start[a] - cell[a]) * delta[a];
    };
    for (;;) {
      if (cell.z() < 0 || cell.z() >= top_) return true;  // has left the grid for good
      const int tx = (cell.x() >> FlogMap::kTileBits) - map_.tile_x0,
                ty = (cell.y() >> FlogMap::kTileBits) - map_.tile_y0;
      if (tx < 0 || ty < 0 || tx >= map_.tiles_x || ty >= map_.tiles_y) return true;
      const size_t tile = static_cast<size_t>(ty) * map_.tiles_x + tx;
      if (!hides_[block(tile, cell.x() & (kSide - 1), cell.y() & (kSide - 1))]) {
        // Crossed at once.
        const Eigen::Vector2i corner(cell.x() & ~(kBlock - 1), cell.y() & ~(kBlock - 1));
        for (int a = 0; a < 2; ++a) {
          if (way[a] == 0) continue;
          cell[a] = corner[a] + (step[a] > 0 ? kBlock - 1 : 0);
          next[a] = boundary(a);
        }
        const int out = next.x() < next.y() ? 0 : 1;
        if (next[out] >= end) return true;
        for (const int a : {1 - out, 2}) {
          if (way[a] == 0) continue;
          cell[a] = static_cast<int>(std::floor(start[a] + way[a] * next[out]));
          if (a != 2) cell[a] = std::clamp(cell[a], corner[a], corner[a] + kBlock - 1);
          next[a] = boundary(a);
        }
        cell[out] += step[out];
        next[out] += delta[out];
        continue;
      }
      const size_t at =
          (static_cast<size_t>(cell.z()) * kSide + (cell.y() & (kSide - 1))) * kSide + (cell.x() & (kSide - 1));
      if (obstacles_[tile][at] == static_cast<uint8_t>(MapState::occupied) &&
          (cell - target).cwiseAbs().maxCoeff() > neighbour_) {
        return false;
      }
      int axis = next.x() < next.y() ? 0 : 1;
      if (next.z() < next[axis]) axis = 2;
      if (next[axis] >= end) return true;
      cell[axis] += step[axis];
      next[axis] += delta[axis];
    }
  }

 private:
  static constexpr int kBlock = 8;  // [cells] along the sides of a block of columns
  static constexpr int kBlocks = kSide / kBlock;
  static size_t block(size_t tile, int x, int y) { return (tile * kBlocks + y / kBlock) * kBlocks + x / kBlock; }

  const FlogMap& map_;
  const TileStates& obstacles_;
  int top_, neighbour_;
  double at_camera_;            // [cells]
  std::vector<uint8_t> hides_;  // whether a block of columns has obstacles
};

// What hides: the occupied cells, and what lies between two occupied ones above each other. Walls stand upright; where
// their texture repeats itself, they are found in patches, and wrong matches look through the holes.
TileStates obstacles_of(const FlogMap& map, const TileStates& states) {
  constexpr size_t kSlice = static_cast<size_t>(kSide) * kSide;
  TileStates obstacles = states;
  parallel_chunks(0, static_cast<int>(states.size()), 1, [&](int begin, int end) {
    for (int t = begin; t < end; ++t) {
      std::vector<uint8_t>& tile = obstacles[static_cast<size_t>(t)];
      for (size_t column = 0; column < std::min(kSlice, tile.size()); ++column) {
        int below = -1;  // slice of the last occupied cell
        for (int z = 0; z < map.all_slices(); ++z) {
          if (tile[static_cast<size_t>(z) * kSlice + column] != kOccupied) continue;
          if (below >= 0) {
            for (int between = below + 1; between < z; ++between) {
              tile[static_cast<size_t>(between) * kSlice + column] = kOccupied;
            }
          }
          below = z;
        }
      }
    }
  });
  return obstacles;
}

// All occupied cells wider by `cells` along x and y, where there are tiles.
TileStates widened(const FlogMap& map, const TileStates& obstacles, int cells) {
  TileStates result = obstacles;
  // One axis after the other. Each tile takes from itself and from its neighbours.
  for (const bool along_x : {true, false}) {
    const TileStates from = result;
    parallel_chunks(0, static_cast<int>(from.size()), 1, [&](int begin, int end) {
      for (int t = begin; t < end; ++t) {
        std::vector<uint8_t>& tile = result[static_cast<size_t>(t)];
        for (size_t i = 0; i < tile.size(); ++i) {
          const auto along = static_cast<int>(along_x ? i % kSide : i / kSide % kSide);
          const int stride = along_x ? 1 : kSide;
          for (int k = -cells; k <= cells && tile[i] != kOccupied; ++k) {
            int there = along + k, other = t;
            if (there < 0 || there >= kSide) {
              const int step = there < 0 ? -1 : 1;
              const int column = t % map.tiles_x + (along_x ? step : 0), row = t / map.tiles_x + (along_x ? 0 : step);
              if (column < 0 || row < 0 || column >= map.tiles_x || row >= map.tiles_y) continue;
              other = row * map.tiles_x + column;
              there -= step * kSide;
            }
            const std::vector<uint8_t>& source = from[static_cast<size_t>(other)];
            if (source.empty()) continue;
            const int64_t at = static_cast<int64_t>(i) + static_cast<int64_t>(there - along) * stride;
            if (source[static_cast<size_t>(at)] == kOccupied) tile[i] = kOccupied;
          }
        }
      }
    });
  }
  return result;
}

}  // namespace

void forget_unseen(const FlogMap& map, int min_views, TileStates& states) {
  if (map.viewpoints.empty()) return;
  const double bottom = map.layer_bounds.front();
  const Eigen::Vector3d cell(map.cell_size, map.cell_size, map.slice_height());
  std::vector<Viewpoint> viewpoints;
  for (const Pose& pose : map.viewpoints) {
    const Eigen::Vector3d position = pose.translation();
    viewpoints.push_back(
        {pose.linear().transpose(), position, (position - Eigen::Vector3d(0, 0, bottom)).cwiseQuotient(cell)});
  }
  TileStates seen = states;
  const TileStates obstacles = obstacles_of(map, states);
  const TileStates wide_obstacles = widened(map, obstacles, kClear);
  const Sight sight(map, obstacles, 0), clear_sight(map, wide_obstacles, kClear);
  const size_t enough = std::min(static_cast<size_t>(min_views), map.viewpoints.size());
  parallel_chunks(0, static_cast<int>(states.size()), 1, [&](int begin, int end) {
    for (int t = begin; t < end; ++t) {
      const auto index = static_cast<size_t>(t);
      if (states[index].empty()) continue;
      const int x0 = (t % map.tiles_x + map.tile_x0) * kSide, y0 = (t / map.tiles_x + map.tile_y0) * kSide;
      // The nearest first: fewer cells between, and the best measurements.
      std::vector<const Viewpoint*> order;
      for (const uint32_t v : map.tiles[index]->viewpoints) order.push_back(&viewpoints[v]);
      const Eigen::Vector3d middle =
          (Eigen::Vector3d(x0, y0, 0) + Eigen::Vector3d::Constant(0.5 * kSide)).cwiseProduct(cell);
      std::stable_sort(order.begin(), order.end(), [&](const Viewpoint* a, const Viewpoint* b) {
        return (a->position - middle).head<2>().squaredNorm() < (b->position - middle).head<2>().squaredNorm();
      });
      const auto sees = [&](const Sight& use, const Viewpoint& view, const Eigen::Vector3i& target,
                            const Eigen::Vector3d& point) {
        const Eigen::Vector3d in_cam = view.cam_from_world * (point - view.position);
        if (in_cam.z() <= 0) return false;
        const Eigen::Vector3d pixel = map.camera.project(in_cam);
        if (!(pixel.x() >= 0 && pixel.y() >= 0 && pixel.x() < map.camera.width && pixel.y() < map.camera.height))
          return false;
        return use.is_free(target, view.in_cells);
      };
      size_t last = 0;  // what saw the neighbour mostly sees the next one as well
      for (size_t i = 0; i < states[index].size(); ++i) {
        if (states[index][i] == static_cast<uint8_t>(MapState::unknown)) continue;
        const Eigen::Vector3i target(x0 + static_cast<int>(i % kSide), y0 + static_cast<int>(i / kSide % kSide),
                                     static_cast<int>(i / (kSide * kSide)));
        const Eigen::Vector3d point =
            (target.cast<double>() + Eigen::Vector3d::Constant(0.5)).cwiseProduct(cell) + Eigen::Vector3d(0, 0, bottom);
        const bool is_free = states[index][i] == static_cast<uint8_t>(MapState::free);
        const Sight& use = is_free || map.tiles[index]->cells[i].views < enough ? clear_sight : sight;
        bool found = last < order.size() && sees(use, *order[last], target, point);
        for (size_t v = 0; v < order.size() && !found; ++v) {
          if (v == last || !sees(use, *order[v], target, point)) continue;
          found = true;
          last = v;
        }
        if (!found) seen[index][i] = static_cast<uint8_t>(MapState::unknown);
      }
      // Sight that ends above an obstacle ends on it: of a table that is looked at from the side, the cells in one
      // slice hide those in the slice below, and nothing but the free space above would remain of these.
      constexpr size_t kSlice = static_cast<size_t>(kSide) * kSide;
      for (size_t i = 0; i + kSlice < states[index].size(); ++i) {
        if (states[index][i] == kOccupied && seen[index][i + kSlice] == kFree) seen[index][i] = kOccupied;
      }
    }
  });
  states = std::move(seen);
}

}  // namespace iris::mapping
