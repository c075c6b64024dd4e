#include "iris/mapping/flog.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/mapping/ray_fusion.h"
#include "visibility.h"

namespace iris::mapping {
namespace {

// Makes the table cover the tile columns and rows, whichever way it must grow (A.5).
void grow_table(FlogMap& map, int x0, int y0, int x1, int y1) {
  if (map.tiles_x > 0) {
    x0 = std::min(x0, map.tile_x0), x1 = std::max(x1, map.tile_x0 + map.tiles_x - 1);
    y0 = std::min(y0, map.tile_y0), y1 = std::max(y1, map.tile_y0 + map.tiles_y - 1);
  }
  const int nx = x1 - x0 + 1, ny = y1 - y0 + 1;
  if (nx == map.tiles_x && ny == map.tiles_y) return;
  std::vector<std::unique_ptr<FlogMap::Tile>> tiles(static_cast<size_t>(nx) * ny);
  for (int y = 0; y < map.tiles_y; ++y) {
    for (int x = 0; x < map.tiles_x; ++x) {
      tiles[static_cast<size_t>(y + map.tile_y0 - y0) * nx + (x + map.tile_x0 - x0)] =
          std::move(map.tiles[static_cast<size_t>(y) * map.tiles_x + x]);
    }
  }
  map.tiles = std::move(tiles);
  map.tile_x0 = x0, map.tile_y0 = y0, map.tiles_x = nx, map.tiles_y = ny;
}

}  // namespace

void FlogOptions::declare(OptionSet& set) {
  set.section("mapping");
  set.add("cell", cell, "m", 0.001, 10, "side of a map cell; smaller cells need more memory and nearer views");
  set.add("layers", layers, "", 1, 64, "layers of cells, told apart by height; a cell should be seen whole from 1 m");
  set.add("slices", slices, "", 1, 64,
          "cells of a layer above each other; 1 = the thesis, where a cell is as high as its layer and rays that pass "
          "over a table outvote those that end on it");
  set.add("bottom", bottom, "m", -1000, 1000,
          "lower bound of the lowest layer above the floor (where no floor was found, it is taken to lie 1 m below the "
          "first "
          "camera); at 0 the floor becomes an obstacle");
  set.add("height", height, "m", 0.001, 1000,
          "height of all layers together; lintels of doors that are reached close them");
  set.add("min_disparity", min_disparity, "px", 0.1, 1000,
          "rays of smaller disparities are followed only to the distance of this one, their error is too large beyond");
  set.add("pixel_error", pixel_error, "px", 0.001, 10,
          "error of image coordinates: makes obstacles thicker with distance");
  set.add("min_spread", min_spread, "cells", 0, 10,
          "least half width of a measured surface; 0 loses surfaces that are measured more finely than a cell");
  set.add("max_range", max_range, "m", 0.1, 10000, "rays are cut at this distance; what lies beyond stays unknown");
  set.add("ray_step", ray_step, "px", 1, 64, "every n-th row and column gives rays: faster, less evidence");
  set.add("bundle", bundle, "cells", 0, 10,
          "rays of neighbouring pixels are followed together through empty space while they are within this of each "
          "other: faster; 0 = every ray by itself, as in the thesis");
  set.add("min_move", min_move, "cells", 0, 10000, "a view is added if it moved this far since the last added one …");
  set.add("min_turn", min_turn, "fields of view", 0, 10, "… or turned by more than this part of the field of view");
  set.add("min_confidence", min_confidence, "", 0, 1,
          "confidence K below which a cell is unknown in map.pgm; 1 = as many rays as a whole cell gets from 1 m");
  set.add("occupied_level", occupied_level, "", 0.01, 1,
          "membership of occupancy that makes a cell an obstacle in map.pgm; lower finds thin things and more noise");
  set.add("seen_only", seen_only,
          "cells that no view can have seen past the obstacles of the finished map are unknown in map.pgm: free space "
          "and obstacles behind walls");
  set.add("min_views", min_views, "views", 1, 255,
          "what rays of fewer views say is believed only where they pass no obstacle closely, as wrong matches do that "
          "look through a wall; with seen_only");
}

int full_rays(const FlogOptions& options, const RectifiedCamera& camera) {
  const double columns = std::min<double>(camera.f * options.cell, camera.width);
  const double rows = std::min<double>(camera.f * options.height / (options.layers * options.slices), camera.height);
  return std::max(1, static_cast<int>(std::lround(columns * rows / (options.ray_step * options.ray_step))));
}

FlogBuilder::FlogBuilder(const FlogOptions& options, const RectifiedCamera& camera)
    : options_(options), half_view_(std::atan(0.5 * camera.width / camera.f)) {
  IRIS_CHECK(options.layers >= 1 && options.slices >= 1 && options.cell > 0 && options.height > 0);
  map_.cell_size = options.cell;
  map_.slices = options.slices;
  map_.camera = camera;
  for (int k = 0; k <= options.layers; ++k) {
    map_.layer_bounds.push_back(options.bottom + options.height * k / options.layers);
  }
  map_.full_rays = full_rays(options, camera);
}

bool FlogBuilder::add(const StereoView& view) {
  if (last_added_) {
    const Pose last_from_view = last_added_->inverse() * view.world_from_cam;
    if (last_from_view.translation().norm() < options_.min_move * options_.cell &&
        rotation_angle(last_from_view) <= options_.min_turn * 2 * half_view_) {
      return false;
    }
  }
  last_added_ = view.world_from_cam;
  const auto viewpoint = static_cast<uint32_t>(map_.viewpoints.size());
  map_.viewpoints.push_back(view.world_from_cam);

  const RayOptions rays{.min_disparity = options_.min_disparity,
                        .pixel_error = options_.pixel_error,
                        .min_error = options_.min_spread * options_.cell,
                        .max_range = options_.max_range,
                        .step = options_.ray_step};
  const TiledGrid grid{.origin = {0, 0, options_.bottom},
                       .box = {options_.cell, options_.cell, map_.slice_height()},
                       .tile_boxes = {FlogMap::kTileCells, FlogMap::kTileCells, map_.all_slices()},
                       .single_layer_of_tiles = true};
  // Nt = 3 NK: what was seen long ago gives way to what is seen now.
  const FusionOptions fusion{.max_rays = 3 * static_cast<uint32_t>(map_.full_rays), .bundle = options_.bundle};
  fuse_view(view, rays, grid, fusion, [&](const Eigen::Vector3i& index) -> std::span<FlogCell> {
    grow_table(map_, index.x(), index.y(), index.x(), index.y());
    std::unique_ptr<FlogMap::Tile>& tile =
        map_.tiles[static_cast<size_t>(index.y() - map_.tile_y0) * map_.tiles_x + (index.x() - map_.tile_x0)];
    if (!tile) {
      tile = std::make_unique<FlogMap::Tile>();
      tile->cells.resize(static_cast<size_t>(grid.tile_boxes.prod()));
    }
    if (tile->viewpoints.empty() || tile->viewpoints.back() != viewpoint) tile->viewpoints.push_back(viewpoint);
    return tile->cells;
  });
  return true;
}

namespace {

constexpr int kSide = FlogMap::kTileCells;

// One value of a cell: how far it says that something is there, and how far that can be relied on.
struct CellValue {
  float unsafe;  // not((E and not O) or I)
  float K;
};
CellValue value_of(const FlogCell& cell, int full_rays) {
  const float E = cell.mu_empty(), O = cell.mu_occupied();
  const float I = std::min(1 - E, 1 - O);
  return {1 - std::max(std::min(E, 1 - O), I),
          std::min(1.0f, static_cast<float>(cell.rays) / static_cast<float>(full_rays))};  // (6.3)
}

TileStates states_of(const FlogMap& map, const FlogOptions& options) {
  TileStates states(map.tiles.size());
  parallel_chunks(0, static_cast<int>(map.tiles.size()), 1, [&](int begin, int end) {
    for (int t = begin; t < end; ++t) {
      const FlogMap::Tile* tile = map.tiles[static_cast<size_t>(t)].get();
      if (!tile) continue;
      std::vector<uint8_t>& of_tile = states[static_cast<size_t>(t)];
      of_tile.resize(tile->cells.size());
      for (size_t i = 0; i < of_tile.size(); ++i) {
        const FlogCell& cell = tile->cells[i];
        MapState state = MapState::unknown;
        if (cell.rays > 0 && static_cast<double>(value_of(cell, map.full_rays).K) >= options.min_confidence) {
          if (static_cast<double>(cell.mu_occupied()) >= options.occupied_level) {
            state = MapState::occupied;
          } else if (cell.mu_empty() > 0.5f) {
            state = MapState::free;
          }
        }
        of_tile[i] = static_cast<uint8_t>(state);
      }
    }
  });
  return states;
}

}  // namespace

MapRaster rasterise(const FlogMap& map, const FlogOptions& options) {
  MapRaster raster;
  raster.cell = map.cell_size;
  raster.layer_bounds = map.layer_bounds;
  TileStates states = states_of(map, options);
  if (options.seen_only) forget_unseen(map, options.min_views, states);
  // Visits the cells that any ray crossed: cell, its state, column, row (of growing y), layer.
  const auto for_each_cell = [&](const auto& visit) {
    for (size_t t = 0; t < map.tiles.size(); ++t) {
      if (!map.tiles[t]) continue;
      const int tile_x = (static_cast<int>(t) % map.tiles_x + map.tile_x0) * kSide;
      const int tile_y = (static_cast<int>(t) / map.tiles_x + map.tile_y0) * kSide;
      const std::vector<FlogCell>& cells = map.tiles[t]->cells;
      for (size_t i = 0; i < cells.size(); ++i) {
        if (cells[i].rays == 0) continue;
        visit(cells[i], states[t][i], tile_x + static_cast<int>(i % kSide),
              tile_y + static_cast<int>(i / kSide % kSide), i / (kSide * kSide) / static_cast<size_t>(map.slices));
      }
    }
  };
  // What is known, or else whatever a ray crossed.
  int x0 = 0, y0 = 0, x1 = -1, y1 = -1;
  for (const bool known_only : {true, false}) {
    if (x1 >= x0) break;
    x0 = y0 = std::numeric_limits<int>::max(), x1 = y1 = std::numeric_limits<int>::min();
    for_each_cell([&](const FlogCell&, uint8_t state, int x, int y, size_t) {
      if (known_only && state == static_cast<uint8_t>(MapState::unknown)) return;
      x0 = std::min(x0, x), x1 = std::max(x1, x), y0 = std::min(y0, y), y1 = std::max(y1, y);
    });
  }
  if (x1 < x0) x0 = y0 = x1 = y1 = 0;
  raster.width = x1 - x0 + 1, raster.height = y1 - y0 + 1;
  // To a nanometre: 204 cells of 0.05 m are 10.2 m, not 10.200000000000001 m, in the files as well.
  const auto corner = [&](int cells) { return std::round(cells * map.cell_size * 1e9) / 1e9; };
  raster.origin_x = corner(x0), raster.origin_y = corner(y0);
  raster.M = cv::Mat1f::zeros(raster.height, raster.width);
  raster.state = cv::Mat1b::zeros(raster.height, raster.width);
  raster.U = cv::Mat1f::zeros(raster.height, raster.width);
  for (int k = 0; k < map.layers(); ++k) {
    raster.layer_M.push_back(cv::Mat1f::zeros(raster.height, raster.width));
    raster.layer_U.push_back(cv::Mat1f::zeros(raster.height, raster.width));
    raster.layer_state.push_back(cv::Mat1b::zeros(raster.height, raster.width));
  }
  const auto raise = [](float& highest, float value) { highest = std::max(highest, value); };
  for_each_cell([&](const FlogCell& cell, uint8_t state, int x, int y, size_t layer) {
    const int column = x - x0, row = y1 - y;
    if (column < 0 || row < 0 || column >= raster.width || row >= raster.height) return;
    const CellValue value = value_of(cell, map.full_rays);
    const float Mk = std::min(value.unsafe, value.K);  // (6.4)
    raise(raster.layer_M[layer](row, column), Mk);
    raise(raster.M(row, column), Mk);  // (6.5)
    if (state == static_cast<uint8_t>(MapState::unknown)) return;
    raise(raster.layer_U[layer](row, column), value.unsafe);
    raise(raster.U(row, column), value.unsafe);
    raster.layer_state[layer](row, column) = std::max(raster.layer_state[layer](row, column), state);
    raster.state(row, column) = std::max(raster.state(row, column), state);
  });
  raster.known = cv::Mat1b(raster.height, raster.width);
  for (int y = 0; y < raster.height; ++y) {
    for (int x = 0; x < raster.width; ++x) raster.known(y, x) = raster.state(y, x) != 0;
  }
  return raster;
}

}  // namespace iris::mapping
