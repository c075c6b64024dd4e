// The part of the FLOG method that any box-shaped grid shares: rays of sight of a stereo view, their way through the
// boxes, and the fuzzy update of the boxes (thesis 6.3). The layered map and the octree are both built with it.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "iris/types/flog_map.h"
#include "iris/types/stereo_view.h"

namespace iris::mapping {

// What a ray of sight says about the cells on its way. World frame [m].
struct SightRay {
  Eigen::Vector3f direction;  // unit, from the optical centre to the measured point
  float length;               // lc, distance of the point
  float error;                // e of (6.1): half the width of the triangle around the point
  float end;                  // nothing is said at or beyond this distance: lc + e, or where the ray is cut
  int pixel;                  // y * width + x of the pixel that measured it
};

struct SightRays {
  Eigen::Vector3d origin;  // optical centre
  std::vector<SightRay> rays;
};

struct RayOptions {
  double min_disparity = 4;  // [px] rays of smaller disparities are followed to the distance of this one only, and no
                             // farther than it is surely free
  double pixel_error = 0.1;  // [px] dp of (4.24)
  double min_error = 0;      // [m] lower bound of e
  double max_range = 20;     // [m] rays are cut here
  int step = 1;              // [px] every step-th row and column
};

// Rays of all disparities up to within_segment, row by row, in the world frame.
SightRays sight_rays(const StereoView& view, const RayOptions& options);

// A grid of boxes in tiles. Box (i, j, k) covers [i, i+1) x [j, j+1) x [k, k+1) times `box`, from `origin` on.
struct TiledGrid {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  // [m]
  Eigen::Vector3d box;                               // [m] size of a box
  Eigen::Vector3i tile_boxes;                        // boxes of a tile along x, y, z
  bool single_layer_of_tiles = false;                // only tiles with z index 0 exist
};

// The rays that cross each tile, in the order of the rays. Tiles in ascending order (z, y, x).
struct TileRays {
  struct Tile {
    Eigen::Vector3i index;
    std::vector<uint32_t> rays;
  };
  std::vector<Tile> tiles;
};
TileRays sort_by_tile(const SightRays& rays, const TiledGrid& grid);

// Updates the boxes of one tile ([z][y][x]) with the rays of `selection`, one after the other: (6.1) and (6.2).
// A ray updates each box that it crosses once. r is the distance of the point that is nearest to the box's middle among
// the points of the ray inside the box: a point outside would say where the surface is in a neighbour (layers are much
// higher than cells are wide, and a tilted ray passes the middle's height far from the box). In a rendered room that
// leaves 107 occupied cells beside the 298 of the walls, instead of 361. The tile's floats depend on the order of the
// rays in the last bits, and beyond Nt rays altogether: keep it.
void fuse_rays(const SightRays& rays, std::span<const uint32_t> selection, const TiledGrid& grid,
               const Eigen::Vector3i& tile_index, uint32_t max_rays, std::span<FlogCell> tile);

}  // namespace iris::mapping
