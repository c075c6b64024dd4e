#include "export/octree_stream.h"

#include <algorithm>
#include <bit>
#include <cstring>
#include <limits>
#include <sstream>

#include "iris/core/error.h"

namespace iris::exporters {
namespace {

using Kind = OctreeNode::Kind;
using Rgb = std::array<uint8_t, 3>;
using Children = std::array<OctreeNode, 8>;

static_assert(std::endian::native == std::endian::little, "OctoMap writes values as they lie in memory");

constexpr int kTileLevels = 4, kLevelsAbove = 16 - kTileLevels;
static_assert(OctreeStream::kTileSide == 1 << kTileLevels);
constexpr Rgb kWhite = {255, 255, 255};
constexpr size_t kOtNode = 4 + 3 + 1, kBtNode = 2;  // [bytes] value, colour, children; children

// The mean of those that have a colour.
Rgb mean_colour(const Children& children, Rgb OctreeNode::*colour) {
  std::array<int, 3> sum = {};
  int count = 0;
  for (const OctreeNode& child : children) {
    if (!child.exists || child.*colour == kWhite) continue;
    for (size_t c = 0; c < 3; ++c) sum[c] += (child.*colour)[c];
    ++count;
  }
  if (count == 0) return kWhite;
  Rgb mean;
  for (size_t c = 0; c < 3; ++c) mean[c] = static_cast<uint8_t>(sum[c] / count);
  return mean;
}

void put_ot(const OctreeNode& node, uint8_t children, char* at) {
  std::memcpy(at, &node.log_odds, 4);
  std::memcpy(at + 4, node.rgb.data(), 3);
  std::memcpy(at + 7, &children, 1);
}

// Joins eight children to their parent, whose bytes begin at `ot` and `bt` and are followed by those of the children:
// fills the parent in, and drops the children where they are pruned.
OctreeNode join(const Children& children, bool may_prune, std::string& ot, size_t at_ot, std::string& bt,
                size_t at_bt) {
  OctreeNode node{.likely = Kind::inner,
                  .exists = true,
                  .log_odds = -std::numeric_limits<float>::max(),
                  .nodes = 1,
                  .likely_nodes = 1};
  bool same = may_prune, same_likely = may_prune;
  uint8_t exist = 0;
  uint16_t kinds = 0;
  for (size_t i = 0; i < 8; ++i) {
    const OctreeNode& child = children[i];
    same = same && child.exists && child.leaf && child.log_odds == children[0].log_odds;
    same_likely = same_likely && child.likely == children[0].likely;
    exist = static_cast<uint8_t>(exist | child.exists << i);
    kinds = static_cast<uint16_t>(kinds | static_cast<int>(child.likely) << 2 * i);
    if (child.exists) node.log_odds = std::max(node.log_odds, child.log_odds);
    node.nodes += child.nodes;
    node.likely_nodes += child.likely_nodes;
  }
  node.mean_rgb = mean_colour(children, &OctreeNode::mean_rgb);
  node.rgb = node.mean_rgb;
  if (same) {
    node.leaf = true;
    node.nodes = 1;
    exist = 0;
    // OctoMap gives the mean to a pruned node only if its first child has a colour.
    node.rgb = children[0].rgb == kWhite ? kWhite : mean_colour(children, &OctreeNode::rgb);
    ot.resize(at_ot + kOtNode);
  }
  put_ot(node, exist, ot.data() + at_ot);
  if (same_likely && children[0].likely != Kind::inner) {
    node.likely = children[0].likely;
    node.likely_nodes = 1;
    bt.resize(at_bt);
  } else {
    std::memcpy(bt.data() + at_bt, &kinds, kBtNode);
  }
  return node;
}

// The subtree of the cubes of a tile from a corner on.
OctreeNode build_cubes(std::span<const OctreeCube> cubes, int level, std::array<int, 3> corner, std::string& ot,
                       std::string& bt) {
  if (level == 0) {
    const OctreeCube& cube = cubes[static_cast<size_t>(
        (corner[2] * OctreeStream::kTileSide + corner[1]) * OctreeStream::kTileSide + corner[0])];
    if (cube.log_odds == 0) return {};
    const OctreeNode node{.likely = cube.log_odds > 0 ? Kind::occupied : Kind::free,
                          .exists = true,
                          .leaf = true,
                          .log_odds = cube.log_odds,
                          .rgb = cube.rgb,
                          .mean_rgb = cube.rgb,
                          .nodes = 1,
                          .likely_nodes = 1};
    ot.resize(ot.size() + kOtNode);
    put_ot(node, 0, ot.data() + ot.size() - kOtNode);
    return node;
  }
  const size_t at_ot = ot.size(), at_bt = bt.size();
  ot.resize(at_ot + kOtNode);
  bt.resize(at_bt + kBtNode);
  Children children;
  bool any = false;
  for (size_t i = 0; i < 8; ++i) {
    std::array<int, 3> of_child = corner;
    for (size_t a = 0; a < 3; ++a) of_child[a] += static_cast<int>(i >> a & 1) << (level - 1);
    children[i] = build_cubes(cubes, level - 1, of_child, ot, bt);
    any = any || children[i].exists;
  }
  if (any) return join(children, true, ot, at_ot, bt, at_bt);
  ot.resize(at_ot);
  bt.resize(at_bt);
  return {};
}

// Tiles in the order of the files: the bits of their keys, axis by axis, from the highest.
uint64_t order_of(const std::array<int, 3>& tile) {
  uint64_t order = 0;
  for (int bit = kLevelsAbove - 1; bit >= 0; --bit) {
    for (int a = 2; a >= 0; --a) {
      const auto key = static_cast<uint64_t>(tile[static_cast<size_t>(a)] + OctreeStream::kTiles);
      order = order << 1 | (key >> bit & 1);
    }
  }
  return order;
}

}  // namespace

// What a file consists of: the nodes above the tiles, and the tiles between them.
struct OctreeStream::Files {
  struct Part {
    size_t at;  // in the nodes above
    const Placed* tile;
  };
  std::string ot, bt;  // nodes above the tiles
  std::vector<Part> ot_parts, bt_parts;
};

bool OctreeStream::is_inside(const std::array<int, 3>& tile) {
  return std::all_of(tile.begin(), tile.end(), [](int i) { return i >= -kTiles && i < kTiles; });
}

OctreeTile OctreeStream::subtree(const std::array<int, 3>& index, std::span<const OctreeCube> cubes) {
  IRIS_CHECK(is_inside(index) && cubes.size() == static_cast<size_t>(kTileSide) * kTileSide * kTileSide);
  OctreeTile tile{.index = index, .node = {}, .ot = {}, .bt = {}};
  tile.node = build_cubes(cubes, kTileLevels, {0, 0, 0}, tile.ot, tile.bt);
  IRIS_CHECK(tile.node.exists);
  return tile;
}

void OctreeStream::add(const OctreeTile& tile) {
  tiles_.push_back({.order = order_of(tile.index),
                    .node = tile.node,
                    .at_ot = spool_.append(tile.ot),
                    .at_bt = spool_.append(tile.bt),
                    .size_ot = static_cast<uint32_t>(tile.ot.size()),
                    .size_bt = static_cast<uint32_t>(tile.bt.size())});
}

// The nodes from a level above the tiles on.
OctreeNode OctreeStream::build(std::span<const Placed> tiles, int level, Files& files) {
  if (level == 0) {
    files.ot_parts.push_back({files.ot.size(), &tiles.front()});
    files.bt_parts.push_back({files.bt.size(), &tiles.front()});
    return tiles.front().node;
  }
  const size_t at_ot = files.ot.size(), at_bt = files.bt.size();
  const size_t ot_parts = files.ot_parts.size(), bt_parts = files.bt_parts.size();
  files.ot.resize(at_ot + kOtNode);
  files.bt.resize(at_bt + kBtNode);
  Children children;
  for (size_t first = 0; first < tiles.size();) {
    const auto child_of = [&](size_t t) { return tiles[t].order >> 3 * (level - 1) & 7; };
    size_t last = first + 1;
    while (last < tiles.size() && child_of(last) == child_of(first)) ++last;
    children[child_of(first)] = build(tiles.subspan(first, last - first), level - 1, files);
    first = last;
  }
  // OctoMap never prunes its root.
  const OctreeNode node = join(children, level < kLevelsAbove, files.ot, at_ot, files.bt, at_bt);
  if (node.leaf) files.ot_parts.resize(ot_parts);
  if (node.likely != Kind::inner) files.bt_parts.resize(bt_parts);
  return node;
}

void OctreeStream::write(double resolution) const {
  std::vector<Placed> tiles = tiles_;
  std::sort(tiles.begin(), tiles.end(), [](const Placed& a, const Placed& b) { return a.order < b.order; });
  for (size_t t = 1; t < tiles.size(); ++t) IRIS_CHECK(tiles[t - 1].order < tiles[t].order);
  Files files;
  OctreeNode root;
  if (!tiles.empty()) root = build(tiles, kLevelsAbove, files);
  const auto header = [&](const char* title, const char* type, int64_t nodes) {
    std::ostringstream text;  // numbers as OctoMap writes them
    text << "# Octomap OcTree " << title
         << "\n# (feel free to add / change comments, but leave the first line as it is!)"
         << "\n#\nid " << type << "\nsize " << nodes << "\nres " << resolution << "\ndata\n";
    return text.str();
  };
  const auto write_nodes = [&](const char* name, const std::string& head, const std::string& above,
                               const std::vector<Files::Part>& parts, uint64_t Placed::*at, uint32_t Placed::*size) {
    write_file_in_parts(folder_ / name, [&](const auto& put) {
      constexpr size_t kBlock = 1 << 20;  // [bytes]
      std::string block = head;
      size_t done = 0;
      for (const Files::Part& part : parts) {
        block.append(above, done, part.at - done);
        done = part.at;
        const size_t begin = block.size();
        block.resize(begin + part.tile->*size);
        spool_.read(part.tile->*at, block.data() + begin, part.tile->*size);
        if (block.size() < kBlock) continue;
        put(block);
        block.clear();
      }
      block.append(above, done);
      put(block);
    });
  };
  write_nodes("map.ot", header("file", "ColorOcTree", root.nodes), files.ot, files.ot_parts, &Placed::at_ot,
              &Placed::size_ot);
  write_nodes("map.bt", header("binary file", "OcTree", root.likely_nodes), files.bt, files.bt_parts, &Placed::at_bt,
              &Placed::size_bt);
}

}  // namespace iris::exporters
