// OctoMap's files without OctoMap's tree in memory: tile after tile is written away as it will stand in the files.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "iris/core/large_file.h"

namespace iris::exporters {

// A cube of the smallest size.
struct OctreeCube {
  float log_odds = 0;                            // of occupancy; > 0 occupied, < 0 free, 0 unknown (no node)
  std::array<uint8_t, 3> rgb = {255, 255, 255};  // white: has no colour, as OctoMap has it
};

// A node of the octree, as its parent sees it.
struct OctreeNode {
  enum class Kind : uint8_t { none, free, occupied, inner };  // in the order of the format's bits
  Kind likely = Kind::none;                                   // in map.bt
  bool exists = false, leaf = false;                          // in map.ot
  float log_odds = 0;
  std::array<uint8_t, 3> rgb = {}, mean_rgb = {};  // as it stands in the file; of all below, before any were pruned
  int64_t nodes = 0, likely_nodes = 0;             // in map.ot and map.bt, with itself
};

// The finished subtree of a tile.
struct OctreeTile {
  std::array<int, 3> index = {};  // x, y, z
  OctreeNode node;
  std::string ot, bt;  // its bytes
};

// Writes map.ot (a ColorOcTree) and map.bt (an OcTree), byte by byte what OctoMap writes of the same cubes:
//   map.ot  every cube by setNodeValue() and setColor(), then updateInnerOccupancy(), prune(), write()
//   map.bt  the same in an OcTree, then writeBinary(), which takes the more likely state and prunes
// In memory are the tiles' places and the nodes above them, which is a few hundred bytes a tile; the tiles' bytes are
// on the disk of the folder, a second time while the files are put together.
class OctreeStream {
 public:
  static constexpr int kTileSide = 16;                      // cubes along a side of a tile
  static constexpr int kTiles = (1 << 16) / kTileSide / 2;  // in each direction from the origin: 16 levels in all

  explicit OctreeStream(const std::filesystem::path& folder) : folder_(folder), spool_(folder) {}

  static bool is_inside(const std::array<int, 3>& tile);
  // The subtree of a tile, whose cubes are [z][y][x] and not all unknown. `index`: inside, its first cube has the index
  // kTileSide * index; the corner of cube (0, 0, 0) is the origin.
  static OctreeTile subtree(const std::array<int, 3>& index, std::span<const OctreeCube> cubes);

  // Each tile once, in any order. Throws InputError.
  void add(const OctreeTile& tile);
  // Writes the two files, each whole or not at all. Throws InputError.
  void write(double resolution) const;

 private:
  struct Placed {
    uint64_t order;  // along the files
    OctreeNode node;
    uint64_t at_ot, at_bt;  // in the spool
    uint32_t size_ot, size_bt;
  };
  struct Files;
  static OctreeNode build(std::span<const Placed> tiles, int level, Files& files);

  std::filesystem::path folder_;
  SpoolFile spool_;
  std::vector<Placed> tiles_;
};

}  // namespace iris::exporters
