#include "iris/mapping/ray_fusion.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <tuple>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

namespace iris::mapping {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
// A plane crossed within this distance [m] before a tile's end is the end itself: sums of rounded steps are not exact.
constexpr double kSlack = 1e-9;

// Distances along a ray in fixed point, 2^-40 m; what is farther than 1000 km is never reached.
constexpr double kOneMetre = 1099511627776.0;
int64_t fixed(double metres) { return static_cast<int64_t>(std::clamp(metres, -1e6, 1e6) * kOneMetre); }

// All bits or none.
int64_t mask(bool condition) { return -static_cast<int64_t>(condition); }

// (6.2), written so that it is exact for equal values.
inline void update(FlogCell& cell, float empty, float occupied, uint32_t max_rays) {
  const uint32_t count = cell.rays + 1;
  const float weight = 1 / static_cast<float>(static_cast<int32_t>(count));
  cell.empty += (empty - cell.empty) * weight;
  cell.occupied += (occupied - cell.occupied) * weight;
  cell.rays = std::min(count, max_rays);
}

// One ray in the coordinates of a box grid: distance along the ray to the next plane of each axis (Amanatides and Woo).
struct Walk {
  Eigen::Vector3i box;    // where the walk is
  Eigen::Vector3i sign;   // +1 or -1
  Eigen::Vector3d next;   // [m] distance to the next plane of each axis
  Eigen::Vector3d delta;  // [m] distance between two planes
};

// `start` and `velocity` in boxes and boxes per metre; `from` [m]. lowest/highest: boxes that the walk may start in.
Walk start_walk(const Eigen::Vector3d& start, const Eigen::Vector3d& velocity, double from,
                const Eigen::Vector3i& lowest, const Eigen::Vector3i& highest) {
  Walk walk;
  for (int a = 0; a < 3; ++a) {
    const double position = std::floor(start[a] + velocity[a] * from);
    walk.box[a] = static_cast<int>(std::clamp<double>(position, lowest[a], highest[a]));
    walk.sign[a] = velocity[a] < 0 ? -1 : 1;
    const double inverse = velocity[a] == 0 ? kInfinity : 1 / velocity[a];
    walk.delta[a] = std::abs(inverse);
    walk.next[a] = velocity[a] == 0 ? kInfinity : (walk.box[a] + (velocity[a] > 0 ? 1 : 0) - start[a]) * inverse;
  }
  return walk;
}

}  // namespace

SightRays sight_rays(const StereoView& view, const RayOptions& options) {
  const RectifiedCamera& camera = view.camera;
  const double f_t = camera.f * camera.baseline;
  const cv::Mat1f& disparity = view.disparity.disparity;
  IRIS_CHECK(options.step >= 1 && options.min_disparity > 0);
  SightRays result{view.world_from_cam.translation(), {}};
  result.rays.reserve(static_cast<size_t>(disparity.rows / options.step + 1) *
                      static_cast<size_t>(disparity.cols / options.step + 1));
  const Eigen::Matrix3d rotation = view.world_from_cam.linear();
  const Eigen::Vector3d columns = rotation.col(0) / camera.f;
  for (int y = 0; y < disparity.rows; y += options.step) {
    const Eigen::Vector3d row = rotation * Eigen::Vector3d(-camera.cx / camera.f, (y - camera.cy) / camera.f, 1);
    for (int x = 0; x < disparity.cols; x += options.step) {
      const float measured = view.disparity.at(y, x, DisparityOrigin::within_segment);
      const double d = measured + camera.disparity_offset;
      if (measured <= 0 || d <= 0) continue;
      const Eigen::Vector3d sight = row + columns * x;  // to the point at depth 1
      const double stretch = sight.norm();
      const double z = f_t / d, length = stretch * z;
      const double propagated = options.pixel_error * std::sqrt(2.0) * z * length / f_t;  // (4.24)
      const double error = std::max(3 * propagated, options.min_error);
      double end = length + error;
      if (d < options.min_disparity) {
        // Far points only tell where it is free. Below half a pixel their error exceeds their distance: they tell
        // nothing.
        end = std::min(stretch * f_t / options.min_disparity, length - error);
        if (end <= 0) continue;
      }
      end = std::min(end, options.max_range);
      result.rays.push_back({(sight / stretch).cast<float>(), static_cast<float>(length), static_cast<float>(error),
                             static_cast<float>(end), y * disparity.cols + x});
    }
  }
  return result;
}

TileRays sort_by_tile(const SightRays& rays, const TiledGrid& grid) {
  // Chunks of rays find their tiles independently; joined in the order of the chunks, the order of the rays stays.
  constexpr int kGrain = 1 << 14;
  using Index = std::tuple<int, int, int>;  // z, y, x
  const int count = static_cast<int>(rays.rays.size());
  std::vector<std::map<Index, std::vector<uint32_t>>> chunks(static_cast<size_t>((count + kGrain - 1) / kGrain));
  const Eigen::Vector3d tile = grid.box.cwiseProduct(grid.tile_boxes.cast<double>());
  const Eigen::Vector3d start = (rays.origin - grid.origin).cwiseQuotient(tile);
  constexpr int kFar = std::numeric_limits<int>::max() / 2;
  const Eigen::Vector3i lowest = Eigen::Vector3i::Constant(-kFar), highest = Eigen::Vector3i::Constant(kFar);
  parallel_chunks(0, count, kGrain, [&](int begin, int end) {
    auto& found = chunks[static_cast<size_t>(begin / kGrain)];
    // Neighbouring rays cross the same tiles: remember the last one of each position on the way.
    struct Recent {
      Eigen::Vector3i index;
      std::vector<uint32_t>* list = nullptr;
    };
    std::vector<Recent> recent;
    for (int i = begin; i < end; ++i) {
      const SightRay& ray = rays.rays[static_cast<size_t>(i)];
      const Eigen::Vector3d velocity = ray.direction.cast<double>().cwiseQuotient(tile);
      Walk walk = start_walk(start, velocity, 0, lowest, highest);
      for (size_t step = 0;; ++step) {
        if (!grid.single_layer_of_tiles || walk.box.z() == 0) {
          if (recent.size() <= step) recent.resize(step + 1);
          Recent& last = recent[step];
          if (!last.list || last.index != walk.box) {
            last = {walk.box, &found[{walk.box.z(), walk.box.y(), walk.box.x()}]};
          }
          last.list->push_back(static_cast<uint32_t>(i));
        }
        int axis = walk.next.x() < walk.next.y() ? 0 : 1;
        if (walk.next.z() < walk.next[axis]) axis = 2;
        if (walk.next[axis] >= ray.end) break;
        walk.box[axis] += walk.sign[axis];
        walk.next[axis] += walk.delta[axis];
      }
    }
  });
  std::map<Index, std::vector<uint32_t>> all;
  for (auto& chunk : chunks) {
    for (auto& [index, list] : chunk) {
      std::vector<uint32_t>& joined = all[index];
      joined.insert(joined.end(), list.begin(), list.end());
    }
  }
  TileRays result;
  for (auto& [index, list] : all) {
    const auto [z, y, x] = index;
    result.tiles.push_back({{x, y, z}, std::move(list)});
  }
  return result;
}

void fuse_rays(const SightRays& rays, std::span<const uint32_t> selection, const TiledGrid& grid,
               const Eigen::Vector3i& tile_index, uint32_t max_rays, std::span<FlogCell> tile) {
  const Eigen::Vector3i n = grid.tile_boxes;
  IRIS_CHECK(tile.size() == static_cast<size_t>(n.prod()));
  const Eigen::Vector3d corner = grid.origin + grid.box.cwiseProduct(n.cwiseProduct(tile_index).cast<double>());
  const Eigen::Vector3d start = (rays.origin - corner).cwiseQuotient(grid.box);
  const Eigen::Vector3i zero = Eigen::Vector3i::Zero(), last = n - Eigen::Vector3i::Ones();
  const Eigen::Vector3d inverse_box = grid.box.cwiseInverse();
  for (const uint32_t i : selection) {
    const SightRay& ray = rays.rays[i];
    const Eigen::Vector3d direction = ray.direction.cast<double>();
    const Eigen::Vector3d velocity = direction.cwiseProduct(inverse_box);
    // The part of the ray inside the tile.
    double from = 0, to = ray.end;
    for (int a = 0; a < 3; ++a) {
      if (velocity[a] == 0) {
        if (start[a] < 0 || start[a] >= n[a]) to = -1;
        continue;
      }
      const double inverse = 1 / velocity[a];
      const double t0 = -start[a] * inverse, t1 = (n[a] - start[a]) * inverse;
      from = std::max(from, std::min(t0, t1));
      to = std::min(to, std::max(t0, t1));
    }
    to -= kSlack;
    if (from >= to) continue;
    const Walk walk = start_walk(start, velocity, from, zero, last);
    // Distances in fixed point and masks instead of branches: which plane comes next cannot be predicted.
    int64_t tx = fixed(walk.next.x()), ty = fixed(walk.next.y()), tz = fixed(walk.next.z()), t = fixed(from);
    const int64_t dx = fixed(walk.delta.x()), dy = fixed(walk.delta.y()), dz = fixed(walk.delta.z());
    const int64_t leave = fixed(to), end = fixed(ray.end), length = fixed(ray.length);
    // Distance along the ray to the foot of the box's middle; a step forward moves it by a constant.
    int64_t middle =
        fixed((walk.box.cast<double>() + Eigen::Vector3d::Constant(0.5) - start).cwiseProduct(grid.box).dot(direction));
    const Eigen::Vector3d move = direction.cwiseProduct(grid.box).cwiseAbs();
    const int64_t move_x = fixed(move.x()), move_y = fixed(move.y()), move_z = fixed(move.z());
    const int64_t step_x = walk.sign.x(), step_y = static_cast<int64_t>(walk.sign.y()) * n.x(),
                  step_z = static_cast<int64_t>(walk.sign.z()) * n.x() * n.y();
    int64_t at = (static_cast<int64_t>(walk.box.z()) * n.y() + walk.box.y()) * n.x() + walk.box.x();
    const float scale = static_cast<float>(1 / kOneMetre) / ray.error;
    const int64_t free_to = fixed(static_cast<double>(ray.length) - static_cast<double>(ray.error));
    for (bool on = true; on;) {  // one turn for each layer of boxes: rays cross few layers and many columns
      const int64_t layer_end = std::min(tz, leave);
      // The empty part of the ray needs no memberships: muE = 1, muO = 0.
      const int64_t empty_end = std::min(layer_end, free_to);
      int64_t next = std::min(tx, ty);
      while (next < empty_end) {
        if (next > t) update(tile[static_cast<size_t>(at)], 1, 0, max_rays);
        t = next;
        const int64_t is_x = mask(tx < ty), is_y = ~is_x;
        at += (step_x & is_x) + (step_y & is_y);
        middle += (move_x & is_x) + (move_y & is_y);
        tx += dx & is_x;
        ty += dy & is_y;
        next = std::min(tx, ty);
      }
      for (;;) {
        const int64_t out = std::min(next, tz);  // of the box, also where the ray ends inside it
        if (out > t) {
          const int64_t r = std::min(std::max(middle, t), out);
          if (r >= end) {
            on = false;
            break;
          }
          // (6.1)
          const float s = static_cast<float>(length - r) * scale;
          update(tile[static_cast<size_t>(at)], std::min(std::max(s, 0.0f), 1.0f), std::max(0.0f, 1 - std::abs(s)),
                 max_rays);
        }
        t = out;
        if (next >= layer_end) break;
        const int64_t is_x = mask(tx < ty), is_y = ~is_x;
        at += (step_x & is_x) + (step_y & is_y);
        middle += (move_x & is_x) + (move_y & is_y);
        tx += dx & is_x;
        ty += dy & is_y;
        next = std::min(tx, ty);
      }
      if (tz >= leave) break;
      at += step_z;
      middle += move_z;
      tz += dz;
    }
  }
}

}  // namespace iris::mapping
