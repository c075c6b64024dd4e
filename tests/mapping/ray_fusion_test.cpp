// The ray walk and the fuzzy update against brute force in double precision.
#include "iris/mapping/ray_fusion.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <random>
#include <tuple>

namespace iris::mapping {
namespace {

using Index = std::tuple<int, int, int>;  // x, y, z of a box

struct BruteCell {
  double empty = 0, occupied = 0;
  int64_t rays = 0;
};

// [from, to] of the ray inside an axis-parallel box, by intersecting slabs; empty if from >= to.
std::pair<double, double> inside(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction, double end,
                                 const Eigen::Vector3d& low, const Eigen::Vector3d& high) {
  double from = 0, to = end;
  for (int a = 0; a < 3; ++a) {
    if (direction[a] == 0) {
      if (origin[a] < low[a] || origin[a] >= high[a]) return {1, 0};
      continue;
    }
    const double t0 = (low[a] - origin[a]) / direction[a], t1 = (high[a] - origin[a]) / direction[a];
    from = std::max(from, std::min(t0, t1));
    to = std::min(to, std::max(t0, t1));
  }
  return {from, to};
}

// Looks at every box of the range for every ray. Passages shorter than `shortest` are not counted: whether a ray that
// touches an edge passes is a question of rounding.
std::map<Index, BruteCell> brute_force(const SightRays& rays, const TiledGrid& grid, const Eigen::Vector3i& low,
                                       const Eigen::Vector3i& high, int64_t cap, double shortest, int* doubtful) {
  std::map<Index, BruteCell> cells;
  for (const SightRay& ray : rays.rays) {
    const Eigen::Vector3d direction = ray.direction.cast<double>();
    for (int z = low.z(); z < high.z(); ++z) {
      for (int y = low.y(); y < high.y(); ++y) {
        for (int x = low.x(); x < high.x(); ++x) {
          const Eigen::Vector3d corner = grid.origin + Eigen::Vector3d(x, y, z).cwiseProduct(grid.box);
          const auto [from, to] = inside(rays.origin, direction, 1e9, corner, corner + grid.box);
          if (from >= to || from >= ray.end) continue;
          if (to - from < shortest) {
            ++*doubtful;
            continue;
          }
          const double r = std::clamp((corner + 0.5 * grid.box - rays.origin).dot(direction), from, to);
          if (r >= ray.end) continue;
          const double lc = ray.length, e = ray.error;
          const double empty = r < lc - e ? 1 : r < lc ? (lc - r) / e : 0;
          const double occupied = std::max(0.0, 1 - std::abs(r - lc) / e);
          BruteCell& cell = cells[{x, y, z}];
          const auto n = static_cast<double>(cell.rays);
          cell.empty = (n * cell.empty + empty) / (n + 1);
          cell.occupied = (n * cell.occupied + occupied) / (n + 1);
          cell.rays = std::min(cell.rays + 1, cap);
        }
      }
    }
  }
  return cells;
}

SightRays random_rays(int count, std::mt19937& random, const Eigen::Vector3d& origin) {
  std::uniform_real_distribution<double> uniform(-1, 1);
  SightRays rays{origin, {}};
  while (static_cast<int>(rays.rays.size()) < count) {
    const Eigen::Vector3d v(uniform(random), uniform(random), uniform(random));
    if (v.norm() > 1 || v.norm() < 0.1) continue;
    const double length = 0.4 + 0.35 * uniform(random), error = 0.05 + 0.045 * uniform(random);
    // Every fifth ray is cut before its point.
    const double end = rays.rays.size() % 5 == 0 ? 0.7 * length : length + error;
    rays.rays.push_back({v.normalized().cast<float>(), static_cast<float>(length), static_cast<float>(error),
                         static_cast<float>(end), 0});
  }
  return rays;
}

std::map<Index, FlogCell> fuse_all(const SightRays& rays, const TiledGrid& grid, uint32_t cap) {
  std::map<Index, FlogCell> result;
  for (const TileRays::Tile& tile : sort_by_tile(rays, grid).tiles) {
    std::vector<FlogCell> cells(static_cast<size_t>(grid.tile_boxes.prod()));
    fuse_rays(rays, tile.rays, grid, tile.index, cap, cells);
    const Eigen::Vector3i n = grid.tile_boxes;
    for (int i = 0; i < n.prod(); ++i) {
      if (cells[static_cast<size_t>(i)].rays == 0) continue;
      const Eigen::Vector3i at(i % n.x(), i / n.x() % n.y(), i / (n.x() * n.y()));
      const Eigen::Vector3i box = at + tile.index.cwiseProduct(n);
      result[{box.x(), box.y(), box.z()}] = cells[static_cast<size_t>(i)];
    }
  }
  return result;
}

class RayFusionTest : public ::testing::TestWithParam<TiledGrid> {};

TEST_P(RayFusionTest, VisitsTheBoxesThatBruteForceFindsAndUpdatesThemAlike) {
  const TiledGrid grid = GetParam();
  std::mt19937 random(7);
  const SightRays rays = random_rays(400, random, {0.013, -0.021, 0.037});
  const Eigen::Vector3i high(12, 12, 12), low = -high;
  for (const uint32_t cap : {1u << 30, 20u}) {
    int doubtful = 0;
    const auto truth = brute_force(rays, grid, low, high, cap, 1e-7, &doubtful);
    EXPECT_LE(doubtful, 2) << "the comparison is only exact without them";
    const auto found = fuse_all(rays, grid, cap);
    int64_t visits = 0;
    for (const auto& [index, cell] : truth) {
      if (grid.single_layer_of_tiles && (std::get<2>(index) < 0 || std::get<2>(index) >= grid.tile_boxes.z())) continue;
      ASSERT_TRUE(found.contains(index));
      const FlogCell& other = found.at(index);
      EXPECT_EQ(other.rays, static_cast<uint32_t>(cell.rays));
      // Float distances are exact to 1e-7 m, memberships to that / e (5 mm) plus the rounding of the running mean.
      EXPECT_NEAR(other.empty, cell.empty, 1.0 / 65535);
      EXPECT_NEAR(other.occupied, cell.occupied, 1.0 / 65535);
      visits += cell.rays;
    }
    for (const auto& [index, cell] : found) EXPECT_TRUE(truth.contains(index));
    EXPECT_GT(visits, 1000);
  }
}

INSTANTIATE_TEST_SUITE_P(
    Grids, RayFusionTest,
    ::testing::Values(TiledGrid{.origin = {0, 0, 0}, .box = {0.1, 0.1, 0.1}, .tile_boxes = {4, 4, 4}},
                      TiledGrid{.origin = {0, 0, -0.35},
                                .box = {0.1, 0.1, 0.23},
                                .tile_boxes = {8, 8, 3},
                                .single_layer_of_tiles = true},
                      TiledGrid{.origin = {0.01, 0, 0}, .box = {0.1, 0.12, 0.15}, .tile_boxes = {2, 16, 5}}));

TEST(FuseRays, AxisParallelRaysOnTheGridsPlanesUpdateOneRowOfBoxes) {
  const TiledGrid grid{.origin = {0, 0, 0}, .box = {0.1, 0.1, 0.1}, .tile_boxes = {4, 4, 4}};
  for (int axis = 0; axis < 3; ++axis) {
    for (const float sign : {-1.0f, 1.0f}) {
      SightRays rays{Eigen::Vector3d::Zero(), {}};
      Eigen::Vector3f direction = Eigen::Vector3f::Zero();
      direction[axis] = sign;
      rays.rays.push_back({direction, 0.95f, 0.1f, 1.05f, 0});
      const auto found = fuse_all(rays, grid, 100);
      EXPECT_GE(found.size(), 10u);
      EXPECT_LE(found.size(), 11u);
      for (const auto& [index, cell] : found) {
        const std::array<int, 3> at = {std::get<0>(index), std::get<1>(index), std::get<2>(index)};
        for (int other = 0; other < 3; ++other) {
          if (other != axis) {
            EXPECT_EQ(at[static_cast<size_t>(other)], 0);
          }
        }
        EXPECT_EQ(cell.rays, 1u);
      }
    }
  }
}

// 16-bit memberships, as an integer implementation would store them, stop moving far from the mean that (6.2) asks for.
TEST(FlogCell, FloatsFollowTheMeanWhereSixteenBitsStagnate) {
  const int cap = 19983;
  double exact = 1;
  float single = 1;
  uint32_t fixed = 65535;
  for (int i = 0; i < 3 * cap; ++i) {  // a cell full of evidence, then measurements of 0.9
    exact += (0.9 - exact) / (cap + 1);
    single += (0.9f - single) * (1 / static_cast<float>(cap + 1));
    fixed = static_cast<uint32_t>((static_cast<uint64_t>(fixed) * cap + 58982 + (cap + 1) / 2) / (cap + 1));
  }
  EXPECT_NEAR(single, exact, 2e-4);
  EXPECT_GT(std::abs(fixed / 65535.0 - exact), 0.09);
}

TEST(SightRays, FollowTheErrorModelAndAreCutWhereItEnds) {
  StereoView view;
  view.camera = {.f = 400, .cx = 3, .cy = 2, .baseline = 0.1, .width = 8, .height = 6};
  view.disparity.disparity = cv::Mat1f::zeros(6, 8);
  view.disparity.origin = cv::Mat1b::zeros(6, 8);
  const auto set = [&](int y, int x, float d, DisparityOrigin origin) {
    view.disparity.disparity(y, x) = d;
    view.disparity.origin(y, x) = static_cast<uint8_t>(origin);
  };
  set(2, 3, 20, DisparityOrigin::measured);          // on the axis, 2 m
  set(4, 7, 8, DisparityOrigin::within_segment);     // 5 m
  set(0, 0, 2, DisparityOrigin::corrected);          // 20 m: cut at 4 px = 10 m depth
  set(1, 1, 30, DisparityOrigin::between_segments);  // never used for maps
  set(5, 1, 0.45f, DisparityOrigin::measured);       // 89 m with e = 84 m: surely free for 5 m only
  set(5, 5, 0.0625f, DisparityOrigin::measured);     // its error exceeds its distance: says nothing
  view.world_from_cam =
      Pose(Eigen::Translation3d(1, 2, 3) * Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, -1).normalized()));
  const SightRays rays = sight_rays(view, {.max_range = 100});
  ASSERT_EQ(rays.rays.size(), 4u);
  const auto check = [&](const SightRay& ray, double x, double y, double d) {
    const Eigen::Vector3d point = view.world_from_cam * view.camera.point(x, y, d);
    EXPECT_LT((rays.origin + ray.direction.cast<double>() * ray.length - point).norm(), 1e-5);
    const double z = 40 / d;
    EXPECT_NEAR(ray.error, 3 * 0.1 * std::sqrt(2.0) * z * ray.length / 40, 1e-5);  // 3 (4.24)
  };
  check(rays.rays[0], 0, 0, 2);
  check(rays.rays[1], 3, 2, 20);
  check(rays.rays[2], 7, 4, 8);
  EXPECT_NEAR(rays.rays[0].end, rays.rays[0].length / 2, 1e-5);
  EXPECT_NEAR(rays.rays[1].end, rays.rays[1].length + rays.rays[1].error, 1e-5);
  EXPECT_NEAR(rays.rays[3].end, rays.rays[3].length * (1 - 0.3 * std::sqrt(2.0) / 0.45), 1e-3);
  EXPECT_EQ(sight_rays(view, {.max_range = 3}).rays[2].end, 3.0f);
  EXPECT_EQ(sight_rays(view, {.min_error = 0.5}).rays[1].error, 0.5f);
  EXPECT_EQ(sight_rays(view, {.step = 2}).rays.size(), 1u);  // (0, 0) alone lies on even rows and columns
}

}  // namespace
}  // namespace iris::mapping
