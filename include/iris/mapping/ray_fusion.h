// The part of the FLOG method that any box-shaped grid shares: rays of sight of a stereo view, their way through the
// boxes, and the fuzzy update of the boxes (thesis 6.3). The layered map and the octree are both built with it.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
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

// A grid of boxes in tiles, whose numbers of boxes are powers of two. Box (i, j, k) covers [i, i+1) x [j, j+1) x [k,
// k+1) times `box`, from `origin` on.
struct TiledGrid {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  // [m]
  Eigen::Vector3d box;                               // [m] size of a box
  Eigen::Vector3i tile_boxes;                        // boxes of a tile along x, y, z
  bool single_layer_of_tiles = false;                // only tiles with z index 0 exist, of any number of boxes along z
};

struct FusionOptions {
  uint32_t max_rays = 1;  // Nt: N of a box is capped at it (6.3.2)
  // [boxes] Of views, not of single rays: rays of neighbouring pixels are followed together through empty space as long
  // as they are within this of each other (a block of 2, 4 or 8 pixels a side): along the middle of the block, counted
  // as so many rays. Where any of them says more than that it is empty (6.1), they go apart. Moves a part of their
  // count into a neighbouring box, but no membership. 0 = every ray by itself.
  double bundle = 0;
};

// The boxes [z][y][x] of a tile, or none if it is of no interest.
using TileOf = std::function<std::span<FlogCell>(const Eigen::Vector3i& index)>;

// Updates all boxes that the rays of a view cross: (6.1) and (6.2). The rays of a view come at the same time, so that
// all of them count alike: n rays move a membership mu to (N mu + sum of mu_i) / (N + n), which is what (6.2) gives one
// after the other as long as N is below its cap. Sums of integers (of 2^24 rays at most, then the cells are updated):
// the result does not depend on the number of threads. `tile_of` is called by one thread at a time, in ascending order
// (z, y, x). A ray updates each box that it crosses once. r is the distance of the point that is nearest to the box's
// middle among the points of the ray inside the box: a point outside would say where the surface is in a neighbour
// (layers are much higher than cells are wide, and a tilted ray passes the middle's height far from the box). In a
// rendered room that leaves 107 occupied cells beside the 298 of the walls, instead of 361.
void fuse_view(const StereoView& view, const RayOptions& rays, const TiledGrid& grid, const FusionOptions& options,
               const TileOf& tile_of);

// The same for any rays from one point, each followed by itself.
void fuse_rays(const SightRays& rays, const TiledGrid& grid, const FusionOptions& options, const TileOf& tile_of);

}  // namespace iris::mapping
