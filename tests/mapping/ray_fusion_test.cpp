// The ray walk and the fuzzy update against brute force in double precision.
#include "iris/mapping/ray_fusion.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <map>
#include <optional>
#include <random>
#include <string>
#include <tuple>

#include "support/box_room.h"
#include "support/simd_targets.h"

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

// What (6.1) says of every box that a ray passes: looks at all boxes around it. Empty if that is a question of
// rounding: passages shorter than `shortest` [m], or a box's foot so near to the ray's end.
std::optional<std::vector<std::pair<Index, BruteCell>>> memberships(const SightRay& ray, const Eigen::Vector3d& origin,
                                                                    const TiledGrid& grid, double shortest) {
  std::vector<std::pair<Index, BruteCell>> result;
  const Eigen::Vector3d direction = ray.direction.cast<double>();
  const auto box_of = [&](const Eigen::Vector3d& p) -> Eigen::Vector3i {
    return (p - grid.origin).cwiseQuotient(grid.box).array().floor().cast<int>();
  };
  const double farthest = std::max<double>(ray.end, ray.length + ray.error);
  const Eigen::Vector3i a = box_of(origin), b = box_of(origin + direction * farthest);
  const Eigen::Vector3i low = a.cwiseMin(b).array() - 1, high = a.cwiseMax(b).array() + 1;
  for (int z = low.z(); z <= high.z(); ++z) {
    if (grid.single_layer_of_tiles && (z < 0 || z >= grid.tile_boxes.z())) continue;
    for (int y = low.y(); y <= high.y(); ++y) {
      for (int x = low.x(); x <= high.x(); ++x) {
        const Eigen::Vector3d corner = grid.origin + Eigen::Vector3d(x, y, z).cwiseProduct(grid.box);
        const auto [from, to] = inside(origin, direction, 1e9, corner, corner + grid.box);
        if (std::abs(to - from) < shortest && from < ray.end + shortest) return std::nullopt;
        if (from >= to || from >= ray.end) continue;
        const double r = std::clamp((corner + 0.5 * grid.box - origin).dot(direction), from, to);
        if (std::abs(r - ray.end) < shortest) return std::nullopt;
        if (r >= ray.end) continue;
        const double lc = ray.length, e = ray.error;
        const double empty = r < lc - e ? 1 : r < lc ? (lc - r) / e : 0;
        result.push_back({{x, y, z}, {empty, std::max(0.0, 1 - std::abs(r - lc) / e), 1}});
      }
    }
  }
  return result;
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

using Cells = std::map<Index, FlogCell>;

// Adds the rays of one view to the cells, tile by tile.
void fuse_all(const SightRays& rays, const TiledGrid& grid, uint32_t cap, Cells& result) {
  const Eigen::Vector3i n = grid.tile_boxes;
  std::map<Index, std::vector<FlogCell>> tiles;
  const auto index_of = [&](const Index& tile, int i) {
    const auto [x, y, z] = tile;
    const Eigen::Vector3i box =
        Eigen::Vector3i(i % n.x(), i / n.x() % n.y(), i / (n.x() * n.y())) + Eigen::Vector3i(x, y, z).cwiseProduct(n);
    return Index{box.x(), box.y(), box.z()};
  };
  fuse_rays(rays, grid, {.max_rays = cap}, [&](const Eigen::Vector3i& index) -> std::span<FlogCell> {
    const Index tile{index.x(), index.y(), index.z()};
    std::vector<FlogCell>& cells = tiles[tile];
    if (!cells.empty()) return cells;
    cells.resize(static_cast<size_t>(n.prod()));
    for (int i = 0; i < n.prod(); ++i) {
      if (const auto found = result.find(index_of(tile, i)); found != result.end())
        cells[static_cast<size_t>(i)] = found->second;
    }
    return cells;
  });
  for (const auto& [tile, cells] : tiles) {
    for (int i = 0; i < n.prod(); ++i) {
      if (cells[static_cast<size_t>(i)].rays > 0) result[index_of(tile, i)] = cells[static_cast<size_t>(i)];
    }
  }
}

class RayFusionTest : public ::testing::TestWithParam<TiledGrid> {};

// 100 000 rays, one after the other in double precision as (6.2) has it, on each instruction set that the machine has.
// Each view may add the rounding of a mean.
TEST_P(RayFusionTest, UpdatesTheBoxesThatBruteForceFindsToOneUnit) {
  const TiledGrid grid = GetParam();
  for (const int views : {1, 4}) {
    std::mt19937 random(7);
    std::map<Index, BruteCell> truth;
    std::vector<SightRays> of_view;
    for (int view = 0; view < views; ++view) {
      SightRays rays = random_rays(100000 / views, random, {0.013 + 0.31 * view, -0.021, 0.037});
      std::erase_if(rays.rays, [&](const SightRay& ray) {
        const auto passed = memberships(ray, rays.origin, grid, 1e-7);
        if (!passed) return true;
        for (const auto& [index, said] : *passed) {
          BruteCell& cell = truth[index];
          const auto n = static_cast<double>(cell.rays);
          cell.empty = (n * cell.empty + said.empty) / (n + 1);
          cell.occupied = (n * cell.occupied + said.occupied) / (n + 1);
          ++cell.rays;
        }
        return false;
      });
      EXPECT_GT(rays.rays.size(), 99600u / views);
      of_view.push_back(std::move(rays));
    }
    testing::for_each_simd_target([&](const char* target) {
      Cells found;
      for (const SightRays& rays : of_view) fuse_all(rays, grid, 1u << 30, found);
      ASSERT_EQ(found.size(), truth.size()) << target;
      double worst = 0;
      int64_t visits = 0;
      for (const auto& [index, cell] : truth) {
        ASSERT_TRUE(found.contains(index)) << target;
        const FlogCell& other = found.at(index);
        ASSERT_EQ(other.rays, static_cast<uint32_t>(cell.rays)) << target;
        worst = std::max({worst, std::abs(other.empty - FlogCell::kOne * cell.empty),
                          std::abs(other.occupied - FlogCell::kOne * cell.occupied)});
        visits += cell.rays;
      }
      RecordProperty(fmt::format("worst_of_{}_views_{}", views, target), std::to_string(worst));
      EXPECT_GT(visits, 200000);
      EXPECT_LE(worst, views == 1 ? 1 : 1.5) << target;
    });
  }
}

TEST_P(RayFusionTest, TheOrderOfTheRaysDoesNotMatter) {
  std::mt19937 random(8);
  SightRays rays = random_rays(2000, random, {0.013, -0.021, 0.037});
  Cells one, other;
  fuse_all(rays, GetParam(), 50, one);
  std::shuffle(rays.rays.begin(), rays.rays.end(), random);
  fuse_all(rays, GetParam(), 50, other);
  ASSERT_EQ(one.size(), other.size());
  for (const auto& [index, cell] : one) {
    EXPECT_EQ(std::memcmp(&cell, &other.at(index), sizeof(FlogCell)), 0);
    EXPECT_LE(cell.rays, 50u);
  }
}

INSTANTIATE_TEST_SUITE_P(
    Grids, RayFusionTest,
    ::testing::Values(TiledGrid{.origin = {0, 0, 0}, .box = {0.1, 0.1, 0.1}, .tile_boxes = {4, 4, 4}},
                      TiledGrid{.origin = {0, 0, -0.35},
                                .box = {0.1, 0.1, 0.23},
                                .tile_boxes = {8, 8, 3},
                                .single_layer_of_tiles = true},
                      TiledGrid{.origin = {0.01, 0, 0}, .box = {0.1, 0.12, 0.15}, .tile_boxes = {2, 16, 4}}));

TEST(FuseRays, AxisParallelRaysOnTheGridsPlanesUpdateOneRowOfBoxes) {
  const TiledGrid grid{.origin = {0, 0, 0}, .box = {0.1, 0.1, 0.1}, .tile_boxes = {4, 4, 4}};
  for (int axis = 0; axis < 3; ++axis) {
    for (const float sign : {-1.0f, 1.0f}) {
      SightRays rays{Eigen::Vector3d::Zero(), {}};
      Eigen::Vector3f direction = Eigen::Vector3f::Zero();
      direction[axis] = sign;
      rays.rays.push_back({direction, 0.95f, 0.1f, 1.05f, 0});
      Cells found;
      fuse_all(rays, grid, 100, found);
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

// N counts up to its cap only, so that a cell follows what is seen now; sixteen bits are enough for that, because they
// are rounded once a view, not once a ray.
TEST(FuseRays, AFullCellFollowsNewViews) {
  const TiledGrid grid{.box = {1, 1, 1}, .tile_boxes = {1, 1, 1}};
  const uint32_t cap = 19983, in_view = 50;
  SightRays rays{{-1, 0.5, 0.5}, {}};
  for (uint32_t i = 0; i < in_view; ++i) {
    rays.rays.push_back({{1, 0, 0}, 1.6f, 1, 2.6f, 0});  // the box's middle is at 1.5: muE = 0.1, muO = 0.9
  }
  std::vector<FlogCell> tile = {{FlogCell::kOne, 0, cap}};  // full of contrary evidence
  double exact = 0;
  for (uint32_t i = 0; i < 3 * cap; i += in_view) {
    exact = (cap * exact + 0.9 * in_view) / (cap + in_view);
    fuse_rays(rays, grid, {.max_rays = cap},
              [&](const Eigen::Vector3i& index) { return index.isZero() ? std::span(tile) : std::span<FlogCell>(); });
    ASSERT_EQ(tile[0].rays, cap);
  }
  EXPECT_GT(exact, 0.85);
  EXPECT_NEAR(tile[0].mu_occupied(), exact, 4e-3);
  EXPECT_NEAR(tile[0].mu_empty(), 1 - exact, 4e-3);
}

// Rays of neighbouring pixels that are followed together through empty space say of no box that something is there, or
// say less of it, than by themselves: only what they count as empty may go to the box beside.
TEST(FuseView, RaysThatAreFollowedTogetherSayTheSameOfSurfaces) {
  const RectifiedCamera camera{.f = 220, .cx = 162, .cy = 119.5, .baseline = 0.2, .width = 325, .height = 243};
  const testing::BoxRoom room;
  const StereoView view = testing::view_of(room, camera, testing::level_camera({0.2, -0.1, 0.1}, 0.4, 0.1), 0.1);
  const TiledGrid grid{.box = {0.05, 0.05, 0.1}, .tile_boxes = {16, 16, 16}};
  for (const int step : {1, 2}) {
    const auto fuse = [&](double bundle) {
      std::map<Index, std::vector<FlogCell>> tiles;
      fuse_view(view, {.min_error = 0.05, .step = step}, grid, {.max_rays = 1u << 30, .bundle = bundle},
                [&](const Eigen::Vector3i& index) -> std::span<FlogCell> {
                  std::vector<FlogCell>& cells = tiles[{index.x(), index.y(), index.z()}];
                  cells.resize(4096);
                  return cells;
                });
      return tiles;
    };
    const auto single = fuse(0), together = fuse(0.5);
    double rays = 0, rays_together = 0, units = 0;
    for (const auto& [index, cells] : single) {
      static const std::vector<FlogCell> kNone(4096);
      const auto other = together.find(index);
      for (size_t i = 0; i < cells.size(); ++i) {
        const FlogCell &a = cells[i], &b = (other == together.end() ? kNone : other->second)[i];
        rays += a.rays, rays_together += b.rays;
        // Sums of muO, from means that are rounded.
        const double in_a = static_cast<double>(a.rays) * a.occupied, in_b = static_cast<double>(b.rays) * b.occupied;
        units += in_a;
        ASSERT_NEAR(in_a, in_b, 0.5 * (a.rays + b.rays) + 1);
      }
    }
    EXPECT_GT(units, 1e8);
    EXPECT_NEAR(rays_together, rays, 0.01 * rays) << "step " << step;
  }
}

// The rays of a view are those of sight_rays().
TEST(FuseView, FollowsTheRaysOfTheView) {
  const RectifiedCamera camera{.f = 220, .cx = 162, .cy = 119.5, .baseline = 0.2, .width = 325, .height = 243};
  const StereoView view =
      testing::view_of(testing::BoxRoom(), camera, testing::level_camera({0.2, -0.1, 0.1}, 0.4, 0.1), 0.1);
  const TiledGrid grid{.box = {0.05, 0.05, 0.1}, .tile_boxes = {16, 16, 16}};
  Cells one, other;
  const auto into = [&](Cells& cells, std::map<Index, std::vector<FlogCell>>& tiles) {
    for (const auto& [tile, of_tile] : tiles) {
      for (int i = 0; i < 4096; ++i) {
        if (of_tile[static_cast<size_t>(i)].rays == 0) continue;
        const auto [x, y, z] = tile;
        cells[{16 * x + i % 16, 16 * y + i / 16 % 16, 16 * z + i / 256}] = of_tile[static_cast<size_t>(i)];
      }
    }
  };
  std::map<Index, std::vector<FlogCell>> tiles;
  fuse_view(view, {.min_error = 0.05}, grid, {.max_rays = 1u << 30}, [&](const Eigen::Vector3i& index) {
    std::vector<FlogCell>& cells = tiles[{index.x(), index.y(), index.z()}];
    cells.resize(4096);
    return std::span(cells);
  });
  into(one, tiles);
  fuse_all(sight_rays(view, {.min_error = 0.05}), grid, 1u << 30, other);
  ASSERT_EQ(one.size(), other.size());
  for (const auto& [index, cell] : one) EXPECT_EQ(std::memcmp(&cell, &other.at(index), sizeof(FlogCell)), 0);
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
