#include "iris/mapping/flog.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <numbers>
#include <vector>

#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/mapping/ray_fusion.h"
#include "support/box_room.h"

namespace iris::mapping {
namespace {

using testing::BoxRoom;
using testing::level_camera;
using testing::view_of;

const RectifiedCamera kCamera{.f = 220, .cx = 159.5, .cy = 119.5, .baseline = 0.2, .width = 320, .height = 240};

std::vector<StereoView> walk_around(const BoxRoom& room, double noise) {
  std::vector<StereoView> views;
  for (int i = 0; i < 12; ++i) {
    const double yaw = i * std::numbers::pi / 6;
    const Eigen::Vector3d position(0.8 * std::cos(yaw + 2), 0.4 * std::sin(yaw + 2), 0.1);
    views.push_back(view_of(room, kCamera, level_camera(position, yaw, 0.1 * (i % 3 - 1)), noise, 100u + i));
  }
  return views;
}

// The same bits in the same tiles.
bool equal(const FlogMap& a, const FlogMap& b) {
  if (a.tile_x0 != b.tile_x0 || a.tile_y0 != b.tile_y0 || a.tiles_x != b.tiles_x || a.tiles_y != b.tiles_y)
    return false;
  for (size_t i = 0; i < a.tiles.size(); ++i) {
    if (!a.tiles[i] != !b.tiles[i]) return false;
    if (!a.tiles[i]) continue;
    const auto &p = a.tiles[i]->cells, &q = b.tiles[i]->cells;
    if (p.size() != q.size() || std::memcmp(p.data(), q.data(), p.size() * sizeof(FlogCell)) != 0) return false;
  }
  return true;
}

TEST(FlogBuilder, MapsTheWallsOfARoomWithinACellAndItsInsideAsFree) {
  const BoxRoom room;
  for (const double noise : {0.0, 0.1}) {
    FlogOptions options;  // between the floor and the ceiling
    options.bottom = -1.05;
    options.height = 2.1;
    FlogBuilder builder(options, kCamera);
    for (const StereoView& view : walk_around(room, noise)) EXPECT_TRUE(builder.add(view));
    const MapRaster raster = rasterise(builder.map(), options);
    // Walls are at most 3 m away: e = 3 * 0.1 px * sqrt(2) * 3 m * 3 m / (220 px * 0.2 m) = 9 cm.
    int wall_cells = 0, found = 0, wrong = 0, inside = 0, free = 0;
    for (int y = 0; y < raster.height; ++y) {
      for (int x = 0; x < raster.width; ++x) {
        const Eigen::Vector2d at(raster.x_of(x), raster.y_of(y));
        const double distance = std::min({at.x() - room.low.x(), room.high.x() - at.x(), at.y() - room.low.y(),
                                          room.high.y() - at.y()});  // > 0 inside
        const auto state = static_cast<MapState>(raster.state(y, x));
        if (state == MapState::occupied && std::abs(distance) > 1.5 * options.cell) ++wrong;
        if (distance > 2 * options.cell) ++inside, free += state == MapState::free;
        if (distance < -0.2) {
          EXPECT_EQ(state, MapState::unknown);
        }
        if (std::abs(distance) <= 0.5 * options.cell) {
          ++wall_cells;
          // The wall itself, or the neighbour when it lies on the edge between two cells.
          for (int dy = -1; dy <= 1; ++dy) {
            for (int dx = -1; dx <= 1; ++dx) {
              const int v = y + dy, u = x + dx;
              if (v < 0 || u < 0 || v >= raster.height || u >= raster.width) continue;
              if (raster.state(v, u) == static_cast<uint8_t>(MapState::occupied)) {
                ++found;
                dx = dy = 2;
              }
            }
          }
        }
      }
    }
    RecordProperty("wall_cells", wall_cells);
    EXPECT_GT(wall_cells, 250);
    EXPECT_GT(found, 0.98 * wall_cells) << "of " << wall_cells << ", noise " << noise;
    EXPECT_LT(wrong, 0.02 * wall_cells) << "noise " << noise;
    EXPECT_GT(free, 0.98 * inside) << "of " << inside << ", noise " << noise;
  }
}

// Here e of (6.1) is 0.4 cm, a fraction of a cell.
TEST(FlogBuilder, SurfacesMeasuredFinerThanACellStayInTheMap) {
  const RectifiedCamera fine{.f = 440, .cx = 319.5, .cy = 239.5, .baseline = 0.6, .width = 640, .height = 480};
  BoxRoom room;
  room.high.x() = 1.54;  // 1.5 cm behind the middle of its cells
  FlogOptions options;
  options.ray_step = 2;
  const auto occupied_on_wall = [&](double min_spread) {
    options.min_spread = min_spread;
    FlogBuilder builder(options, fine);
    builder.add(view_of(room, fine, level_camera({0, 0, 0}, 0)));
    const MapRaster raster = rasterise(builder.map(), options);
    int count = 0;
    for (int y = 0; y < raster.height; ++y) {
      for (int x = 0; x < raster.width; ++x) {
        if (std::abs(raster.x_of(x) - room.high.x()) > 0.5 * options.cell || std::abs(raster.y_of(y)) > 0.8) continue;
        count += raster.state(y, x) == static_cast<uint8_t>(MapState::occupied);
      }
    }
    return count;
  };
  EXPECT_EQ(occupied_on_wall(1), 32);  // 1.6 m of 5 cm cells
  EXPECT_LT(occupied_on_wall(0), 24);
}

// A surface that lies flat in a layer, as beds and tables do: most rays that cross its cells pass over it.
TEST(FlogBuilder, SlicesFindSurfacesThatLieFlatInALayer) {
  BoxRoom room;  // its floor is at z = -1.2
  FlogOptions options;
  options.bottom = -1.33;
  options.layers = 3;
  options.height = 1.8;
  const auto share_found = [&](int slices) {
    options.slices = slices;
    FlogBuilder builder(options, kCamera);
    for (int i = 0; i < 8; ++i) {
      builder.add(view_of(room, kCamera, level_camera({0, 0, 0}, i * std::numbers::pi / 4, -0.3), 0.1, 7u + i));
    }
    const MapRaster raster = rasterise(builder.map(), options);
    int cells = 0, found = 0;
    for (int y = 0; y < raster.height; ++y) {
      for (int x = 0; x < raster.width; ++x) {
        const double distance = std::hypot(raster.x_of(x), raster.y_of(y));
        if (distance < 1.2 || distance > 1.4) continue;  // seen at 45 degrees at most, and not a wall
        ++cells;
        found += raster.state(y, x) == static_cast<uint8_t>(MapState::occupied);
      }
    }
    return static_cast<double>(found) / cells;
  };
  EXPECT_GT(share_found(6), 0.9);
  EXPECT_LT(share_found(1), 0.5);
}

// A map of one tile without cells, looked into by a level camera at its edge.
FlogMap tile_seen_from(double height, int image_side, std::vector<double> layer_bounds, int slices) {
  FlogMap map;
  map.cell_size = 0.1;
  map.layer_bounds = std::move(layer_bounds);
  map.slices = slices;
  map.full_rays = 1;
  const double centre = (image_side - 1) / 2.0;
  map.camera = {.f = 100, .cx = centre, .cy = centre, .baseline = 0.1, .width = image_side, .height = image_side};
  map.viewpoints = {level_camera({0.05, 3.25, height}, 0)};
  map.tiles_x = map.tiles_y = 1;
  map.tiles.push_back(std::make_unique<FlogMap::Tile>());
  map.tiles[0]->viewpoints = {0};
  return map;
}

// By cells of the world; unknown outside of the raster.
MapState state_at(const MapRaster& raster, int x, int y) {
  const int column = x - static_cast<int>(std::lround(raster.origin_x / raster.cell));
  const int row = raster.height - 1 - y + static_cast<int>(std::lround(raster.origin_y / raster.cell));
  const bool inside = cv::Rect(0, 0, raster.width, raster.height).contains({column, row});
  return inside ? static_cast<MapState>(raster.state(row, column)) : MapState::unknown;
}

// A wall from side to side, 3 m ahead of the only camera; the cells all around are free if one believes the rays.
TEST(Rasterise, KnowsOnlyWhatAViewCanHaveSeen) {
  constexpr int kSide = FlogMap::kTileCells;
  FlogMap map = tile_seen_from(0.5, 200, {0, 1}, 1);
  for (int i = 0; i < kSide * kSide; ++i) {
    const bool wall = i % kSide == 30;
    map.tiles[0]->cells.push_back(wall ? FlogCell{0, FlogCell::kOne, 5, 1} : FlogCell{FlogCell::kOne, 0, 5, 1});
  }
  FlogOptions options;
  const auto state_at = [&](int x, int y) { return mapping::state_at(rasterise(map, options), x, y); };
  EXPECT_EQ(state_at(10, 32), MapState::free);
  EXPECT_EQ(state_at(30, 32), MapState::occupied);
  EXPECT_EQ(state_at(30, 50), MapState::occupied);  // seen aslant
  EXPECT_EQ(state_at(40, 32), MapState::unknown);   // behind the wall
  EXPECT_EQ(state_at(5, 60), MapState::unknown);    // outside of the image
  const auto open_from_to = [&](int from, int to) {
    for (int y = from; y < to; ++y)
      map.tiles[0]->cells[static_cast<size_t>(y * kSide + 30)] = {FlogCell::kOne, 0, 5, 1};
  };
  open_from_to(31, 34);
  EXPECT_EQ(state_at(40, 32), MapState::unknown);  // so narrow a gap is a wrong match
  open_from_to(29, 37);
  EXPECT_EQ(state_at(40, 32), MapState::free);
  EXPECT_EQ(state_at(40, 20), MapState::unknown);
  // An obstacle behind a narrow gap is believed if more than one view has measured it.
  map.viewpoints.push_back(map.viewpoints[0]);
  for (int y = 29; y < 37; ++y) map.tiles[0]->cells[static_cast<size_t>(y * kSide + 30)] = {0, FlogCell::kOne, 5, 1};
  open_from_to(32, 34);
  FlogCell& behind = map.tiles[0]->cells[32 * kSide + 40];
  behind = {0, FlogCell::kOne, 5, 1};
  EXPECT_EQ(state_at(40, 32), MapState::unknown);
  behind.views = 2;
  EXPECT_EQ(state_at(40, 32), MapState::occupied);
  behind = {FlogCell::kOne, 0, 5, 2};
  EXPECT_EQ(state_at(40, 32), MapState::unknown);
  options.seen_only = false;
  EXPECT_EQ(state_at(40, 20), MapState::free);
  EXPECT_EQ(state_at(5, 60), MapState::free);
}

// A flat surface seen from above, with a ridge on it that hides what follows: three cells on, sight passes over the
// ridge, but not down to the surface.
TEST(Rasterise, SightThatEndsAboveAnObstacleEndsOnIt) {
  constexpr int kSide = FlogMap::kTileCells, kSlice = kSide * kSide;
  FlogMap map = tile_seen_from(1.05, 400, {0, 0.3}, 3);
  const FlogCell occupied{0, FlogCell::kOne, 5, 2}, free{FlogCell::kOne, 0, 5, 2};
  for (int i = 0; i < 3 * kSlice; ++i) {
    const int x = i % kSide, z = i / kSlice;
    const bool ridge = z == 1 && x >= 30 && x < 34;
    map.tiles[0]->cells.push_back(z == 0 || ridge ? occupied : free);
  }
  EXPECT_EQ(state_at(rasterise(map), 20, 32), MapState::occupied);
  EXPECT_EQ(state_at(rasterise(map), 36, 32), MapState::occupied);
  // The surface is not seen itself: nothing is known where the cell above it is not known to be free.
  for (int z = 1; z < 3; ++z) map.tiles[0]->cells[static_cast<size_t>(z * kSlice + 32 * kSide + 36)] = {};
  EXPECT_EQ(state_at(rasterise(map), 36, 32), MapState::unknown);
}

TEST(FlogBuilder, GivesTheSameBitsForAnyNumberOfThreads) {
  const BoxRoom room;
  const auto views = walk_around(room, 0.1);
  const auto build = [&](int threads) {
    FlogBuilder builder({}, kCamera);
    with_threads(threads, [&] {
      for (const StereoView& view : views) builder.add(view);
    });
    return builder.take();
  };
  const FlogMap one = build(1);
  EXPECT_TRUE(equal(one, build(2)));
  EXPECT_TRUE(equal(one, build(3)));
}

TEST(FlogBuilder, TheTableOfTilesGrowsInAllDirections) {
  FlogOptions options;
  options.max_range = 4;
  const RectifiedCamera camera{.f = 40, .cx = 15.5, .cy = 11.5, .baseline = 0.5, .width = 32, .height = 24};
  BoxRoom room;
  room.low << -30, -30, -1;
  room.high << 30, 30, 1;
  const double half_pi = std::numbers::pi / 2;
  FlogBuilder grown(options, camera);
  std::vector<StereoView> views;
  for (int i = 0; i < 4; ++i) {
    const Eigen::Vector3d position(9 * std::cos(i * half_pi), 9 * std::sin(i * half_pi), 0);
    views.push_back(view_of(room, camera, level_camera(position, i * half_pi)));
    // What is there stays where it is when the table grows.
    FlogBuilder alone(options, camera);
    alone.add(views.back());
    grown.add(views.back());
    int cells = 0;
    for (int y = -300; y < 300; ++y) {
      for (int x = -300; x < 300; ++x) {
        const FlogCell* expected = alone.map().find(x, y, 1);
        if (!expected || expected->rays == 0) continue;
        ++cells;
        const FlogCell* cell = grown.map().find(x, y, 1);
        ASSERT_NE(cell, nullptr);
        EXPECT_EQ(std::memcmp(cell, expected, sizeof(FlogCell)), 0);
      }
    }
    EXPECT_GT(cells, 100);
  }
  const MapRaster raster = rasterise(grown.map(), options);
  EXPECT_LT(raster.origin_x, -11);
  EXPECT_LT(raster.origin_y, -11);
  EXPECT_GT(raster.origin_x + raster.width * raster.cell, 11);
  EXPECT_GT(raster.origin_y + raster.height * raster.cell, 11);
}

TEST(FlogBuilder, SkipsViewsThatAreTooSimilar) {
  const BoxRoom room;
  FlogBuilder builder({}, kCamera);
  const double half_view = std::atan(160 / 220.0);  // half the field of view
  const auto view = [&](double x, double yaw) { return view_of(room, kCamera, level_camera({x, 0, 0}, yaw)); };
  EXPECT_TRUE(builder.add(view(0, 0)));
  EXPECT_FALSE(builder.add(view(0.19, 0)));
  EXPECT_FALSE(builder.add(view(0, 0.99 * half_view)));
  EXPECT_TRUE(builder.add(view(0.201, 0)));
  EXPECT_TRUE(builder.add(view(0.201, 1.01 * half_view)));
}

TEST(FullRays, IsTheNumberOfRaysThatAWallAtOneMetreSendsThroughACell) {
  // A wall 1 m ahead; the layers are so deep that a cell's face on the wall collects every ray aimed at it.
  BoxRoom room;
  room.low << -3, -3, -3;
  room.high << 1, 3, 3;
  FlogOptions options;
  options.cell = 0.1;
  options.layers = 3;
  options.slices = 1;
  options.bottom = -0.3;
  options.height = 0.6;
  for (const int step : {1, 2}) {
    options.ray_step = step;
    const StereoView view = view_of(room, kCamera, level_camera({0, 0, 0}, 0));
    const SightRays rays = sight_rays(view, {.step = step});
    int through = 0;  // the middle layer's cell y in [0, 0.1), z in [-0.1, 0.1)
    for (const SightRay& ray : rays.rays) {
      const Eigen::Vector3d point = ray.direction.cast<double>() * ray.length;
      through += point.x() > 0.99 && point.y() >= 0 && point.y() < 0.1 && std::abs(point.z()) < 0.1;
    }
    // One row and one column more or less, by where the pixels fall.
    EXPECT_NEAR(full_rays(options, kCamera), through, 0.08 * through) << "step " << step;
  }
  // Not more than the image holds.
  options.ray_step = 1;
  options.height = 30;
  EXPECT_EQ(full_rays(options, kCamera), 22 * 240);
}

TEST(Rasterise, FollowsTheFuzzyRules) {
  FlogMap map;
  map.cell_size = 0.5;
  map.layer_bounds = {0, 1, 2};
  map.full_rays = 100;
  map.tile_x0 = -1, map.tile_y0 = 0, map.tiles_x = 1, map.tiles_y = 1;
  map.tiles.push_back(std::make_unique<FlogMap::Tile>());
  constexpr int kSide = FlogMap::kTileCells;
  map.tiles[0]->cells.resize(2 * kSide * kSide);
  const auto fixed = [](double membership) { return static_cast<uint16_t>(std::lround(membership * FlogCell::kOne)); };
  const auto cell = [&](int x, int y, int layer) -> FlogCell& {
    return map.tiles[0]->cells[static_cast<size_t>((layer * kSide + y) * kSide + x)];
  };
  // Column 62 of the tile is world cell -2: x from -1.0 to -0.5 m.
  cell(62, 3, 0) = {fixed(0.9), fixed(0.1), 100};  // free
  cell(63, 3, 0) = {fixed(0.2), fixed(0.7), 50};   // occupied, half the confidence
  cell(62, 4, 0) = {fixed(0.1), fixed(0.2), 100};  // indeterminate
  cell(63, 4, 0) = {fixed(1), fixed(0), 0};        // untouched
  cell(63, 4, 1) = {fixed(0.6), fixed(0.4), 200};  // partly filled, in the upper layer
  cell(60, 4, 1) = {fixed(0), fixed(1), 1};        // one ray: K = 0.01 is just enough
  cell(60, 3, 0) = {fixed(1), fixed(0), 100};      // free
  FlogOptions options;
  options.min_confidence = 0.02;
  options.occupied_level = 0.35;
  const MapRaster raster = rasterise(map, options);
  EXPECT_EQ(raster.width, 4);
  EXPECT_EQ(raster.height, 2);
  EXPECT_DOUBLE_EQ(raster.origin_x, -2);
  EXPECT_DOUBLE_EQ(raster.origin_y, 1.5);
  EXPECT_DOUBLE_EQ(raster.x_of(2), -0.75);
  EXPECT_DOUBLE_EQ(raster.y_of(1), 1.75);
  // Row 1 is y = 3. (6.4) by hand: M = not((E and not O) or I) and K, I = not E and not O.
  EXPECT_NEAR(raster.M(1, 2), 1 - 0.9, 2e-5);
  EXPECT_NEAR(raster.M(1, 3), 0.5, 2e-5);  // min(1 - max(0.2, 0.3), K)
  EXPECT_NEAR(raster.U(1, 3), 0.7, 2e-5);
  EXPECT_NEAR(raster.M(0, 2), 0.2, 2e-5);  // I = 0.8
  EXPECT_NEAR(raster.layer_M[1](0, 3), 0.4, 2e-5);
  EXPECT_NEAR(raster.M(0, 3), 0.4, 2e-5);
  EXPECT_NEAR(raster.M(0, 0), 0.01, 2e-5);
  const cv::Mat1b expected = (cv::Mat1b(2, 4) << 0, 0, 0, 2, 1, 0, 1, 2);
  EXPECT_EQ(cv::norm(raster.state, expected, cv::NORM_INF), 0);
  EXPECT_EQ(cv::norm(raster.known, expected > 0, cv::NORM_INF), 254);        // 0/1 against 0/255
  EXPECT_EQ(rasterise(FlogBuilder(options, kCamera).map()).state(0, 0), 0);  // nothing seen: one unknown cell
}

TEST(FlogOptions, AreDeclaredWithinTheirRanges) {
  OptionSet set;
  FlogOptions options;
  options.declare(set);
  set.validate();
  set.set("mapping.cell", "0.1");
  EXPECT_EQ(options.cell, 0.1);
  options.layers = 0;
  EXPECT_THROW(set.validate(), UsageError);
}

}  // namespace
}  // namespace iris::mapping
