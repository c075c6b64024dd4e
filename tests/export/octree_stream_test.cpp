#include "export/octree_stream.h"

#include <gtest/gtest.h>
#include <octomap/ColorOcTree.h>
#include <octomap/OcTree.h>

#include <map>
#include <random>
#include <sstream>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "support/full_disk.h"
#include "support/temporary_folder.h"

namespace iris::exporters {
namespace {

constexpr int kSide = OctreeStream::kTileSide, kCubes = kSide * kSide * kSide;
using Index = std::array<int, 3>;
using Tiles = std::map<Index, std::vector<OctreeCube>>;

std::vector<OctreeCube> filled(const OctreeCube& cube) { return std::vector<OctreeCube>(kCubes, cube); }

// Both files as OctoMap makes them of the whole tree in memory.
std::pair<std::string, std::string> octomaps_bytes(const Tiles& tiles, double resolution) {
  octomap::ColorOcTree coloured(resolution);
  octomap::OcTree plain(resolution);
  for (const auto& [index, cubes] : tiles) {
    for (int i = 0; i < kCubes; ++i) {
      const OctreeCube& cube = cubes[static_cast<size_t>(i)];
      if (cube.log_odds == 0) continue;
      const auto key = [&](size_t axis, int in_tile) {
        return static_cast<octomap::key_type>(index[axis] * kSide + in_tile + (1 << 15));
      };
      const octomap::OcTreeKey at(key(0, i % kSide), key(1, i / kSide % kSide), key(2, i / kSide / kSide));
      coloured.setNodeValue(at, cube.log_odds, true)->setColor(cube.rgb[0], cube.rgb[1], cube.rgb[2]);
      plain.setNodeValue(at, cube.log_odds, true);
    }
  }
  if (coloured.size() > 0) coloured.updateInnerOccupancy();
  coloured.prune();
  std::ostringstream ot, bt;
  EXPECT_TRUE(coloured.write(ot));
  EXPECT_TRUE(plain.writeBinary(bt));
  return {ot.str(), bt.str()};
}

class OctreeStreamTest : public ::testing::Test {
 protected:
  // The streamed files have the same bytes; returns their sizes.
  std::pair<size_t, size_t> expect_octomaps_bytes(const Tiles& tiles, double resolution = 0.05) const {
    OctreeStream stream(folder_.path());
    for (const auto& [index, cubes] : tiles) stream.add(OctreeStream::subtree(index, cubes));
    stream.write(resolution);
    const std::string ot = read_file(folder_.path() / "map.ot"), bt = read_file(folder_.path() / "map.bt");
    const auto [expected_ot, expected_bt] = octomaps_bytes(tiles, resolution);
    EXPECT_TRUE(ot == expected_ot) << ot.size() << " bytes, not " << expected_ot.size();
    EXPECT_TRUE(bt == expected_bt) << bt.size() << " bytes, not " << expected_bt.size();
    return {ot.size(), bt.size()};
  }

  const testing::TemporaryFolder folder_;
};

TEST_F(OctreeStreamTest, BytesAreOctomapsForTilesOnAllSidesOfTheOriginAndAtTheEndsOfTheWorld) {
  std::mt19937 random(1);
  Tiles tiles;
  constexpr int kEnd = OctreeStream::kTiles;
  for (const Index& index :
       {Index{0, 0, 0}, Index{-1, 0, 0}, Index{0, -1, -1}, Index{5, -40, 2}, Index{-33, 31, -1},
        Index{-kEnd, -kEnd, -kEnd}, Index{kEnd - 1, kEnd - 1, kEnd - 1}, Index{4, 4, 4}, Index{5, 4, 4}}) {
    std::vector<OctreeCube> cubes = filled({});
    // Patches of 4 cubes a side, so that some are pruned, with single cubes within; few log-odds, few colours.
    std::map<int, OctreeCube> patches;
    const auto any = [&] {
      OctreeCube cube{.log_odds = static_cast<float>(static_cast<int>(random() % 7) - 3) / 8};
      const auto grey = static_cast<uint8_t>(random() % 2 == 0 ? 255 : random() % 256);
      if (cube.log_odds > 0) cube.rgb = {grey, grey, static_cast<uint8_t>(random() % 2 == 0 ? grey : 17)};
      return cube;
    };
    for (int i = 0; i < kCubes; ++i) {
      const int patch = i % kSide / 4 + i / kSide % kSide / 4 * 4 + i / kSide / kSide / 4 * 16;
      if (!patches.contains(patch)) patches[patch] = any();
      OctreeCube& cube = cubes[static_cast<size_t>(i)];
      cube = random() % 50 == 0 ? any() : patches[patch];
      if (cube.log_odds > 0 && random() % 2 == 0) cube.rgb = any().rgb;
    }
    tiles[index] = cubes;
  }
  expect_octomaps_bytes(tiles, 0.05);
  expect_octomaps_bytes(tiles, 1.0 / 3);
}

TEST_F(OctreeStreamTest, WhatIsEqualIsPrunedAcrossTiles) {
  const OctreeCube empty{.log_odds = -1.5f};
  Tiles tiles;
  for (int i = 0; i < 64; ++i) tiles[{i % 4 - 4, i / 4 % 4, i / 16 - 4}] = filled(empty);  // a node three levels up
  const auto [ot, bt] = expect_octomaps_bytes(tiles);
  EXPECT_LT(ot, 16 * 8 + 200u);  // the way from the root to it
  EXPECT_LT(bt, 16 * 2 + 200u);
  // Occupied with different colours: pruned to their mean, in the first case only.
  tiles.clear();
  for (int i = 0; i < 8; ++i) {
    tiles[{i % 2, i / 2 % 2, i / 4}] = filled({.log_odds = 2, .rgb = {0, 0, static_cast<uint8_t>(10 * i)}});
  }
  const auto [ot_same, bt_same] = expect_octomaps_bytes(tiles);
  tiles[{0, 0, 0}] = filled({.log_odds = 2});
  expect_octomaps_bytes(tiles);
  // As likely, but not equal: only the binary file is pruned.
  tiles[{1, 1, 1}] = filled({.log_odds = 1});
  const auto [ot_more, bt_more] = expect_octomaps_bytes(tiles);
  EXPECT_EQ(bt_more, bt_same);
  EXPECT_EQ(ot_more, ot_same + 8 * 8);
  // One cube that is missing, and one of the other kind, keep all nodes above them.
  tiles[{0, 1, 0}][7] = {};
  tiles[{1, 0, 0}][4095] = empty;
  expect_octomaps_bytes(tiles);
}

TEST_F(OctreeStreamTest, TheOrderOfTheTilesDoesNotMatterAndNoTilesAreAnEmptyTree) {
  OctreeStream one(folder_.path() / "one"), two(folder_.path() / "two");
  const OctreeTile a = OctreeStream::subtree({-3, 2, 1}, filled({.log_odds = 1})),
                   b = OctreeStream::subtree({3, 2, -1}, filled({.log_odds = -1}));
  one.add(a), one.add(b);
  two.add(b), two.add(a);
  one.write(0.1), two.write(0.1);
  for (const char* name : {"map.ot", "map.bt"}) {
    EXPECT_EQ(read_file(folder_.path() / "one" / name), read_file(folder_.path() / "two" / name));
  }
  expect_octomaps_bytes({});
}

TEST_F(OctreeStreamTest, AFullDiskIsAnErrorAndLeavesNothing) {
  std::vector<OctreeCube> cubes = filled({});
  for (size_t i = 0; i < kCubes; ++i) cubes[i].log_odds = i % 3 == 0 ? 1.f : -1.f;
  OctreeStream stream(folder_.path());
  stream.add(OctreeStream::subtree({0, 0, 0}, cubes));
  {
    const testing::FullDisk full(16 * 1024);
    EXPECT_THROW(stream.write(0.1), InputError);
    EXPECT_THROW(stream.add(OctreeStream::subtree({1, 0, 0}, cubes)), InputError);
  }
  EXPECT_TRUE(std::filesystem::is_empty(folder_.path()));
}

TEST_F(OctreeStreamTest, ATileTwiceOutsideOrWithoutAnyCubeIsABug) {
  EXPECT_THROW(OctreeStream::subtree({OctreeStream::kTiles, 0, 0}, filled({.log_odds = 1})), Bug);
  EXPECT_THROW(OctreeStream::subtree({0, 0, 0}, filled({})), Bug);
  OctreeStream stream(folder_.path());
  const OctreeTile tile = OctreeStream::subtree({0, 0, 0}, filled({.log_odds = 1}));
  stream.add(tile), stream.add(tile);
  EXPECT_THROW(stream.write(0.1), Bug);
}

}  // namespace
}  // namespace iris::exporters
