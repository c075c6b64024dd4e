#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "iris/geometry/pose.h"
#include "iris/geometry/rectified_camera.h"

namespace iris {

// State of one cell of the fuzzy layered occupancy grid (thesis 6.3), memberships in fixed point.
struct FlogCell {
  static constexpr uint16_t kOne = 65535;  // a membership of 1

  uint16_t empty = 0;      // muE * kOne
  uint16_t occupied = 0;   // muO * kOne
  uint32_t rays : 24 = 0;  // N, capped at 3 NK and at kMostRays
  uint32_t views : 8 = 0;  // that had a ray through it, 255 = or more
  static constexpr uint32_t kMostRays = (1u << 24) - 1;

  float mu_empty() const { return static_cast<float>(empty) / kOne; }
  float mu_occupied() const { return static_cast<float>(occupied) / kOne; }
};

// Layered grid in tiles. World frame: z up [m]. Cell (ix, iy) covers [ix, ix+1) x [iy, iy+1) times cell_size; layer k
// covers [layer_bounds[k], layer_bounds[k+1]) in z, and is cut into `slices` cells of equal height. Tiles are allocated
// on first touch (thesis A.5).
struct FlogMap {
  static constexpr int kTileBits = 6;
  static constexpr int kTileCells = 1 << kTileBits;  // cells along one side of a tile

  struct Tile {
    std::vector<FlogCell> cells;       // [slice][y in tile][x in tile]; slices of all layers, from below
    std::vector<uint32_t> viewpoints;  // of the views whose rays crossed the tile, ascending
  };

  double cell_size = 0.05;           // [m]
  std::vector<double> layer_bounds;  // [m] ascending, equidistant, layers + 1 of them
  int slices = 1;                    // cells of a layer above each other
  int full_rays = 1;                 // NK of (6.3)
  RectifiedCamera camera;            // of all views
  std::vector<Pose> viewpoints;      // world_from_cam of the added views, in their order
  // Table of tiles: covers tile columns [tile_x0, tile_x0 + tiles_x), rows likewise; null = never touched.
  int tile_x0 = 0, tile_y0 = 0, tiles_x = 0, tiles_y = 0;
  std::vector<std::unique_ptr<Tile>> tiles;  // row-major

  int layers() const { return static_cast<int>(layer_bounds.size()) - 1; }
  int all_slices() const { return layers() * slices; }
  double slice_height() const { return (layer_bounds.back() - layer_bounds.front()) / all_slices(); }  // [m]

  // The tile that holds a cell, or null if it was never touched.
  const Tile* tile_of(int ix, int iy) const {
    const int tx = (ix >> kTileBits) - tile_x0, ty = (iy >> kTileBits) - tile_y0;
    if (tx < 0 || ty < 0 || tx >= tiles_x || ty >= tiles_y) return nullptr;
    return tiles[static_cast<size_t>(ty) * tiles_x + tx].get();
  }
  // The cell, or null if its tile was never touched. Slice in [0, all_slices()).
  const FlogCell* find(int ix, int iy, int slice) const {
    const Tile* tile = tile_of(ix, iy);
    if (!tile) return nullptr;
    const int x = ix & (kTileCells - 1), y = iy & (kTileCells - 1);
    return &tile->cells[(static_cast<size_t>(slice) * kTileCells + y) * kTileCells + x];
  }
};

}  // namespace iris
