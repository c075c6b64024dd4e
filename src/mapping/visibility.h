// Which cells of a map any of its views can have seen.
#pragma once

#include <cstdint>
#include <vector>

#include "iris/types/flog_map.h"

namespace iris::mapping {

// MapState of all cells, tile by tile as in FlogMap::tiles; empty where no tile is.
using TileStates = std::vector<std::vector<uint8_t>>;

// Sets the cells to unknown that no view can have seen: no view has the cell's middle in its image with free sight,
// that is with no occupied cell on the straight line to it but those next to the cell itself. What a map says about
// such cells comes from wrong matches or from the spread of far measurements behind a surface. Of what is free, and of
// cells that rays of fewer than `min_views` views crossed, sight is free only if it keeps two cells away from what is
// occupied: a window of matching does not see through a gap that is narrower than itself, but where texture repeats
// itself, wrong matches make such gaps in a wall and free space behind them. What is occupied right below a cell that
// is seen to be free stays: a flat surface that is looked at from the side hides its own cells where it lies between
// two slices. `states` of a map without viewpoints stay as they are.
void forget_unseen(const FlogMap& map, int min_views, TileStates& states);

}  // namespace iris::mapping
