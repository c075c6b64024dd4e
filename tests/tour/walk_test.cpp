#include "iris/tour/walk.h"

#include <gtest/gtest.h>

#include <functional>
#include <limits>
#include <numbers>
#include <queue>
#include <random>

#include "iris/tour/frames.h"

namespace iris::tour {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using mapping::MapRaster;
using mapping::MapState;

// From rows of text, the first one at the largest y: '#' occupied, '?' unknown, else free. Cells of 10 cm.
MapRaster map_of(const std::vector<std::string>& rows, double origin_x = -1, double origin_y = 2) {
  MapRaster raster{.cell = 0.1,
                   .origin_x = origin_x,
                   .origin_y = origin_y,
                   .width = static_cast<int>(rows[0].size()),
                   .height = static_cast<int>(rows.size())};
  raster.state = cv::Mat1b(raster.height, raster.width);
  for (int y = 0; y < raster.height; ++y) {
    for (int x = 0; x < raster.width; ++x) {
      const char c = rows[static_cast<size_t>(y)][static_cast<size_t>(x)];
      raster.state(y, x) = static_cast<uint8_t>(c == '#'   ? MapState::occupied
                                                : c == '?' ? MapState::unknown
                                                           : MapState::free);
    }
  }
  return raster;
}

// Three rooms side by side, 3 m wide and 4 m deep, with a door of 0.9 m in each wall, one low, one high; 10 cm walls,
// everything within a frame of unknown cells.
MapRaster three_rooms() {
  std::vector<std::string> rows(44, std::string(96, '?'));
  for (size_t y = 1; y < 43; ++y) {
    for (size_t x = 1; x < 95; ++x)
      rows[y][x] = y == 1 || y == 42 || x == 1 || x == 94 || x == 32 || x == 63 ? '#' : '.';
  }
  for (size_t y = 5; y < 14; ++y) rows[y][32] = '.';
  for (size_t y = 30; y < 39; ++y) rows[y][63] = '.';
  return map_of(rows, 0, 0);
}

TourOptions options_with(double clearance) {
  TourOptions options;
  options.clearance = clearance;
  return options;
}

TEST(FreeSpace, ClearanceIsTheDistanceToTheNearestCellThatIsNotFree) {
  std::mt19937 random(1);
  std::vector<std::string> rows(17, std::string(23, '.'));
  for (std::string& row : rows) {
    for (char& c : row) {
      const unsigned r = random() % 12;
      c = r == 0 ? '#' : r == 1 ? '?' : '.';
    }
  }
  const MapRaster raster = map_of(rows);
  const FreeSpace space(raster);
  for (int y = 0; y < raster.height; ++y) {
    for (int x = 0; x < raster.width; ++x) {
      double nearest = std::numeric_limits<double>::infinity();
      for (int v = -1; v <= raster.height; ++v) {
        for (int u = -1; u <= raster.width; ++u) {
          const bool inside = u >= 0 && v >= 0 && u < raster.width && v < raster.height;
          if (inside && raster.state(v, u) == static_cast<uint8_t>(MapState::free)) continue;
          nearest = std::min(nearest, std::hypot(u - x, v - y));
        }
      }
      const double expected = nearest == 0 ? 0 : (nearest - 0.5) * raster.cell;
      EXPECT_NEAR(space.clearance({raster.x_of(x), raster.y_of(y)}), expected, 1e-5) << x << " " << y;
      EXPECT_EQ(space.free({raster.x_of(x), raster.y_of(y)}), nearest > 0);
    }
  }
  EXPECT_EQ(space.clearance({-1.01, 2.5}), 0);
  EXPECT_EQ(space.state({100, 0}), MapState::unknown);
}

// Dijkstra without heuristic or straight pieces: the cost of the cheapest way over cells.
double cheapest(const FreeSpace& space, const MapRaster& raster, const Vector2d& from, const Vector2d& to,
                double clearance) {
  const auto cell = [&](const Vector2d& p) {
    return std::pair(static_cast<int>((p.x() - raster.origin_x) / raster.cell),
                     static_cast<int>((p.y() - raster.origin_y) / raster.cell));
  };
  const auto middle = [&](int x, int y) {
    return Vector2d(raster.origin_x + (x + 0.5) * raster.cell, raster.origin_y + (y + 0.5) * raster.cell);
  };
  const auto good = [&](int x, int y) {
    return x >= 0 && y >= 0 && x < raster.width && y < raster.height && space.clearance(middle(x, y)) >= clearance &&
           space.free(middle(x, y));
  };
  std::vector<double> costs(static_cast<size_t>(raster.width * raster.height), std::numeric_limits<double>::infinity());
  std::priority_queue<std::pair<double, int>, std::vector<std::pair<double, int>>, std::greater<>> open;
  const auto [sx, sy] = cell(from);
  costs[static_cast<size_t>(sy * raster.width + sx)] = 0;
  open.emplace(0, sy * raster.width + sx);
  while (!open.empty()) {
    const auto [cost, index] = open.top();
    open.pop();
    if (cost > costs[static_cast<size_t>(index)]) continue;
    const int x = index % raster.width, y = index / raster.width;
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dx = -1; dx <= 1; ++dx) {
        if (!good(x + dx, y + dy) || !good(x + dx, y) || !good(x, y + dy)) continue;
        const double next = cost + raster.cell * std::hypot(dx, dy);
        const size_t at = static_cast<size_t>((y + dy) * raster.width + x + dx);
        if (next < costs[at]) costs[at] = next, open.emplace(next, static_cast<int>(at));
      }
    }
  }
  const auto [tx, ty] = cell(to);
  return costs[static_cast<size_t>(ty * raster.width + tx)];
}

double length_of(const std::vector<Vector2d>& points) {
  double length = 0;
  for (size_t i = 1; i < points.size(); ++i) length += (points[i] - points[i - 1]).norm();
  return length;
}

TEST(Walk, FindsTheWayThatThereIsAndNoOther) {
  std::mt19937 random(3);
  int ways = 0, none = 0;
  for (int round = 0; round < 60; ++round) {
    std::vector<std::string> rows(20, std::string(30, '.'));
    for (std::string& row : rows) {
      for (char& c : row) c = random() % 100 < 33 ? (random() % 2 ? '#' : '?') : '.';
    }
    const MapRaster raster = map_of(rows);
    const FreeSpace space(raster);
    const auto from = space.nearest({-0.9, 2.1}, 0), to = space.nearest({1.9, 3.9}, 0);
    ASSERT_TRUE(from && to);
    // Without a clearance all free cells cost the same.
    const double truth = cheapest(space, raster, *from, *to, 0);
    const std::vector<Vector2d> way = space.way(*from, *to, 0);
    if (!std::isfinite(truth)) {
      EXPECT_TRUE(way.empty());
      const auto reachable = space.nearest_reachable(*to, *from, 0);
      ASSERT_TRUE(reachable);
      EXPECT_TRUE(std::isfinite(cheapest(space, raster, *from, *reachable, 0)));
      ++none;
      continue;
    }
    ++ways;
    ASSERT_GE(way.size(), 2u);
    EXPECT_EQ(way.front(), *from);
    EXPECT_EQ(way.back(), *to);
    EXPECT_LE(length_of(way), truth + 1e-3);  // straight pieces are shorter than those over cells
    for (size_t i = 1; i < way.size(); ++i) EXPECT_TRUE(space.straight(way[i - 1], way[i], 0));
  }
  EXPECT_GT(ways, 10);
  EXPECT_GT(none, 3);
}

TEST(Walk, KeepsItsClearanceThroughTwoDoors) {
  const FreeSpace space(three_rooms());
  const TourOptions options = options_with(0.25);
  const WalkPlan plan = plan_walk(space, {{0.8, 0.8}, {8.8, 3.6}}, options);
  ASSERT_EQ(plan.status, WalkStatus::ok);
  EXPECT_NEAR((plan.points.front() - Vector2d(0.8, 0.8)).norm(), 0, 1e-12);
  EXPECT_NEAR((plan.points.back() - Vector2d(8.8, 3.6)).norm(), 0, 1e-12);
  for (const Vector2d& point : plan.points) EXPECT_GE(space.clearance(point), 0.25) << point.transpose();
  // In the first door (y 3.0 to 3.9 m) the way is within a cell and a half of its middle.
  for (const Vector2d& point : plan.points) {
    if (std::abs(point.x() - 3.25) < 0.05) {
      EXPECT_NEAR(point.y(), 3.45, 0.15);
    }
    if (std::abs(point.x() - 6.35) < 0.05) {
      EXPECT_NEAR(point.y(), 0.95, 0.15);
    }
  }
  // The taut string through the doors' nearer posts is the lower bound.
  const double taut = length_of({{0.8, 0.8}, {3.25, 3.0}, {6.35, 1.4}, {8.8, 3.6}});
  EXPECT_GT(length_of(plan.points), taut);
  EXPECT_LT(length_of(plan.points), 1.15 * taut);

  // Every frame of the tour stands free, at the height of the eye, level, and the camera turns no faster than allowed.
  const CameraPath path = walk(plan.points, 1.5, options);
  const int frames = frame_count(path, options);
  for (int i = 0; i < frames; ++i) {
    const Pose pose = sample(path, eased_time(path, i / options.fps)).world_from_cam;
    EXPECT_GE(space.clearance(pose.translation().head<2>()), 0.2);
    EXPECT_NEAR(pose.translation().z(), 1.5, 1e-12);
    EXPECT_NEAR(pose.linear()(2, 0), 0, 1e-9);
    EXPECT_NEAR(pose.linear()(2, 2), 0, 1e-9);
  }
  for (size_t i = 1; i < path.keyframes.size(); ++i) {
    const CameraKeyframe &a = path.keyframes[i - 1], &b = path.keyframes[i];
    EXPECT_GT(b.t, a.t);
    const double turn =
        rotation_angle(Eigen::Matrix3d(a.world_from_cam.linear().transpose() * b.world_from_cam.linear()));
    EXPECT_LE(turn / (b.t - a.t), options.turn_rate * std::numbers::pi / 180 * 1.001);
    EXPECT_LE((b.world_from_cam.translation() - a.world_from_cam.translation()).norm() / (b.t - a.t),
              options.walk_speed * 1.001);
  }
}

TEST(Walk, VisitsItsStops) {
  const FreeSpace space(three_rooms());
  const Vector2d via(2.9, 0.5);  // too near to the wall: half a metre from it is a place
  const WalkPlan plan = plan_walk(space, {{0.8, 0.8}, via, {0.8, 3.6}}, options_with(0.4));
  ASSERT_EQ(plan.status, WalkStatus::ok);
  double nearest = 1e9;
  for (const Vector2d& point : plan.points) nearest = std::min(nearest, (point - via).norm());
  EXPECT_LT(nearest, 0.35);
  EXPECT_GT(nearest, 0.05);
}

TEST(Walk, SaysWhyNotAndWhereElse) {
  const FreeSpace space(three_rooms());
  const TourOptions options = options_with(0.25);
  const WalkPlan wall = plan_walk(space, {{0.8, 0.8}, {3.25, 1.0}}, options);
  EXPECT_EQ(wall.status, WalkStatus::not_free);
  EXPECT_EQ(wall.stop_idx, 1);
  EXPECT_EQ(wall.state, MapState::occupied);
  ASSERT_TRUE(wall.nearest);
  EXPECT_NEAR((*wall.nearest - Vector2d(3.25, 1.0)).norm(), 0.30, 0.06);  // 0.25 m from the wall's cells
  EXPECT_GE(space.clearance(*wall.nearest), 0.25);

  const WalkPlan unknown = plan_walk(space, {{-3, 0.8}, {3.0, 1.0}}, options);
  EXPECT_EQ(unknown.status, WalkStatus::not_free);
  EXPECT_EQ(unknown.stop_idx, 0);
  EXPECT_EQ(unknown.state, MapState::unknown);

  // Doors of 0.9 m are too narrow for 0.6 m on both sides.
  const WalkPlan narrow = plan_walk(space, {{0.8, 0.8}, {8.5, 3.0}}, options_with(0.6));
  EXPECT_EQ(narrow.status, WalkStatus::not_connected);
  ASSERT_TRUE(narrow.nearest);
  EXPECT_LT(narrow.nearest->x(), 3.2);
  EXPECT_GT(narrow.nearest->x(), 2.4);
}

}  // namespace
}  // namespace iris::tour
