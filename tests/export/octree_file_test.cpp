#include "export/octree_file.h"

#include <gtest/gtest.h>
#include <octomap/ColorOcTree.h>
#include <octomap/OcTree.h>

#include <atomic>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <numbers>
#include <sstream>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "support/box_room.h"

namespace iris::exporters {
namespace {

using testing::BoxRoom;
using testing::level_camera;
using testing::view_of;
namespace fs = std::filesystem;

const RectifiedCamera kCamera{.f = 220, .cx = 159.5, .cy = 119.5, .baseline = 0.2, .width = 320, .height = 240};

class OctreeFileTest : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::temp_directory_path() /
              ("iris_octree_file_" + std::string(::testing::UnitTest::GetInstance()->current_test_info()->name()));
    fs::remove_all(folder_);
    std::vector<StereoView> views;
    for (int i = 0; i < 8; ++i) {
      const double yaw = i * std::numbers::pi / 4;
      views.push_back(
          view_of(room_, kCamera, level_camera({0.3 * std::cos(yaw), 0.3 * std::sin(yaw), 0}, yaw), 0.1, 7u + i));
    }
    store_ = std::make_unique<views::MemoryViewStore>(std::move(views));
  }
  void TearDown() override { fs::remove_all(folder_); }

  std::unique_ptr<octomap::ColorOcTree> read_ot() const {
    auto* tree = dynamic_cast<octomap::ColorOcTree*>(octomap::AbstractOcTree::read((folder_ / "map.ot").string()));
    return std::unique_ptr<octomap::ColorOcTree>(tree);
  }

  fs::path folder_;
  BoxRoom room_;
  std::unique_ptr<views::MemoryViewStore> store_;
};

// Cubes of the smallest size in all leaves of one kind.
template <typename Tree>
std::pair<int64_t, int64_t> count(const Tree& tree) {
  int64_t occupied = 0, free = 0;
  for (auto leaf = tree.begin_leafs(), end = tree.end_leafs(); leaf != end; ++leaf) {
    const int64_t span = int64_t{1} << (tree.getTreeDepth() - leaf.getDepth());
    (tree.isNodeOccupied(*leaf) ? occupied : free) += span * span * span;
  }
  return {occupied, free};
}

TEST_F(OctreeFileTest, BothFilesAreReadBackWithTheSameCounts) {
  const OctreeSummary summary = write_octree(folder_, *store_, {});
  EXPECT_GT(summary.occupied, 1000);
  EXPECT_GT(summary.free, 10000);
  const auto coloured = read_ot();
  ASSERT_TRUE(coloured);
  EXPECT_EQ(coloured->getResolution(), 0.1);
  EXPECT_EQ(count(*coloured), std::pair(summary.occupied, summary.free));
  // The room lies around the origin, where four regions meet; OctoMap writes the same bytes again.
  std::ostringstream again;
  coloured->write(again);
  EXPECT_TRUE(again.str() == read_file(folder_ / "map.ot"));
  octomap::OcTree binary(1.0);
  ASSERT_TRUE(binary.readBinary((folder_ / "map.bt").string()));
  EXPECT_EQ(binary.getResolution(), 0.1);
  EXPECT_EQ(count(binary), std::pair(summary.occupied, summary.free));
  std::ostringstream binary_again;
  binary.writeBinaryConst(binary_again);
  EXPECT_TRUE(binary_again.str() == read_file(folder_ / "map.bt"));
  const auto json = nlohmann::json::parse(read_file(folder_ / "octree.json"));
  EXPECT_EQ(json.at("frame"), "world");
  EXPECT_EQ(json.at("unit"), "m");
  EXPECT_EQ(json.at("occupied_cubes"), summary.occupied);
}

TEST_F(OctreeFileTest, WallsAreOccupiedInTheirColourTheInsideIsFreeAndTheOutsideUnknown) {
  write_octree(folder_, *store_, {});
  const auto tree = read_ot();
  ASSERT_TRUE(tree);
  const auto state = [&](double x, double y, double z) {
    const auto* node = tree->search(x, y, z);
    return !node ? 0 : tree->isNodeOccupied(*node) ? 2 : 1;
  };
  int walls = 0, found = 0, inside = 0, free = 0;
  for (double z = -0.55; z < 0.6; z += 0.1) {
    for (double y = -1.15; y < 1.2; y += 0.1) {
      // The wall x = high.x, and the one x = low.x; within a cube of the truth.
      for (const double x : {room_.high.x(), room_.low.x()}) {
        ++walls;
        found += state(x, y, z) == 2 || state(x - 0.1, y, z) == 2 || state(x + 0.1, y, z) == 2;
        EXPECT_NE(state(1.2 * x + (x > 0 ? 0.3 : -0.3), y, z), 1) << "free space behind a wall";
      }
    }
    for (double y = -0.95; y < 1; y += 0.1) {
      for (double x = -1.5; x < 1.6; x += 0.1) {
        // What the views see: they look outwards from a circle of 0.3 m, +-28 degrees up and down.
        if (std::hypot(x, y) - 0.35 < 2.1 * std::abs(z)) continue;
        ++inside, free += state(x, y, z) == 1;
      }
    }
  }
  EXPECT_GT(found, 0.97 * walls);
  EXPECT_GT(free, 0.97 * inside);
  EXPECT_EQ(state(0, 0, 3), 0);
  // Wall 1 of the room (x high) is (40, 210, 100) in BGR.
  const auto* node = tree->search(room_.high.x(), 0.05, 0.05);
  ASSERT_TRUE(node);
  EXPECT_EQ(node->getColor(), octomap::ColorOcTreeNode::Color(100, 210, 40));
}

TEST_F(OctreeFileTest, BytesDoNotDependOnTheNumberOfThreads) {
  with_threads(1, [&] { write_octree(folder_ / "one", *store_, {}); });
  with_threads(2, [&] { write_octree(folder_ / "two", *store_, {}); });
  for (const char* name : {"map.ot", "map.bt", "octree.json"}) {
    EXPECT_TRUE(read_file(folder_ / "one" / name) == read_file(folder_ / "two" / name)) << name;
  }
}

TEST_F(OctreeFileTest, OctomapsOwnToolReadsTheFile) {
  if (std::system("command -v bt2vrml > /dev/null") != 0) GTEST_SKIP() << "skipped: no bt2vrml (octomap-tools)";
  write_octree(folder_, *store_, {});
  const std::string command = "cd '" + folder_.string() + "' && bt2vrml map.bt > log.txt 2>&1";
  EXPECT_EQ(std::system(command.c_str()), 0);
  EXPECT_GT(fs::file_size(folder_ / "map.bt.wrl"), 1000u);
}

TEST_F(OctreeFileTest, StopsWhenAskedAndLeavesNothing) {
  const std::atomic<bool> stop = true;
  EXPECT_THROW(write_octree(folder_ / "stopped", *store_, {}, {.stop = &stop}), Interrupted);
  EXPECT_FALSE(std::filesystem::exists(folder_ / "stopped" / "map.ot"));
}

TEST_F(OctreeFileTest, NoViewsGiveEmptyTrees) {
  const OctreeSummary summary = write_octree(folder_, views::MemoryViewStore({}), {});
  EXPECT_EQ(summary.occupied + summary.free, 0);
  octomap::OcTree binary(1.0);
  EXPECT_TRUE(binary.readBinary((folder_ / "map.bt").string()));
  EXPECT_EQ(binary.size(), 0u);
}

TEST(OctreeOptions, AreDeclaredWithinTheirRanges) {
  OptionSet set;
  OctreeOptions options;
  options.declare(set);
  set.validate();
  options.resolution = 0;
  EXPECT_THROW(set.validate(), UsageError);
}

}  // namespace
}  // namespace iris::exporters
