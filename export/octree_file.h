// The space around the path as an OctoMap octree, for planners and viewers in three dimensions.
#pragma once

#include <filesystem>

#include "iris/core/options.h"
#include "iris/pipeline/pipeline.h"
#include "iris/views/view_store.h"

namespace iris::exporters {

struct OctreeOptions {
  double resolution = 0.1;   // [m] side of the smallest cube; 16 levels reach ±32768 cubes from the origin
  double max_range = 10;     // [m] rays are cut here: bounds memory and the error of what is written
  double min_disparity = 4;  // [px] as for the map (thesis 6.3.3)
  double pixel_error = 0.1;  // [px] dp of (4.24)
  int ray_step = 2;          // [px] every n-th row and column gives rays
  int min_rays = 3;          // cubes that fewer rays crossed stay unknown

  void declare(OptionSet& set);  // section "octree"
};

// Counts of what was written.
struct OctreeSummary {
  int64_t occupied = 0, free = 0;  // cubes of `resolution`
};

// Fuses the views (all of one sub-map, in the order of the store) by the fuzzy update of the map, (6.1) and (6.2), on
// cubes, and writes into `folder`, each file whole or not at all (throws InputError):
//   map.ot       ColorOcTree with full log-odds; colour = mean colour of the points measured inside the cube
//   map.bt       the same as an OcTree, occupied or free only
//   octree.json  what the formats cannot say: frame, units, options, counts
// World frame [m], z up.
//
// Membership to log-odds: a cube is occupied if O >= 0.35. It is unknown (no node) if fewer than min_rays crossed it,
// or if it is not occupied and more indeterminate than anything else, I = min(1 - E, 1 - O) > 1/2 (6.4). All others are
// free. The probability of occupancy is p = 1/2 + (s - 1/2) c, with O / (E + O) stretched to s so that 0.35 becomes
// 1/2, and c = N / (N + 4) for the N rays of the cube: few rays say little. p is clamped to OctoMap's 0.1192 ... 0.971;
// log(p / (1-p)) is rounded to steps of 1/8, so that large empty space can be pruned, and is at least one step away
// from undecided. The files are the same, byte for byte, for any number of threads.
//
// Memory: the cubes of one region of 768 x 768 cubes at a time (10 bytes each, where a ray came), and a few hundred
// bytes a tile of 16 cubes a side; what is finished waits on the disk of `folder`. Views near the border of regions are
// read for each of them. Throws Interrupted if `control` asks to stop; nothing is written then.
OctreeSummary write_octree(const std::filesystem::path& folder, const views::ViewStore& views,
                           const OctreeOptions& options, const pipeline::RunControl& control = {});

}  // namespace iris::exporters
