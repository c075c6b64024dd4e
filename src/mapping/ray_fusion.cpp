#include "iris/mapping/ray_fusion.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <memory>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

namespace iris::mapping {
namespace {

// Distances along a ray in fixed point, 2^-32 m.
constexpr double kOneMetre = 4294967296.0;
int64_t fixed(double metres) { return static_cast<int64_t>(metres * kOneMetre); }

// [boxes/m] slower than this no ray moves along an axis, so that all distances fit: a deviation of 2e-6 boxes in 20 m.
constexpr double kSlowest = 1e-7;

// All bits or none.
int64_t mask(bool condition) { return -static_cast<int64_t>(condition); }

// What the rays of a part of a view say about the boxes of a tile.
struct TileSums {
  struct Surface {
    uint32_t lack = 0;      // sum of 1 - muE
    uint32_t occupied = 0;  // sum of muO
  };
  Eigen::Vector3i index;
  std::vector<uint32_t> rays;
  std::vector<std::vector<Surface>> surface;  // of the boxes of one z, empty where no surface is near
};
constexpr size_t kMostRays = 65535;  // so many memberships of 1 fit into 32 bits

// (6.2) for all rays of the sums, which are of one tile.
void apply(const std::vector<const TileSums*>& parts, uint32_t max_rays, std::span<FlogCell> tile) {
  const size_t planes = parts.front()->surface.size(), plane = tile.size() / planes;
  for (size_t i = 0; i < tile.size(); ++i) {
    uint32_t rays = 0;
    for (const TileSums* part : parts) rays += part->rays[i];
    if (rays == 0) continue;
    uint64_t lack = 0, occupied = 0;
    for (const TileSums* part : parts) {
      const std::vector<TileSums::Surface>& surface = part->surface[i / plane];
      if (surface.empty()) continue;
      lack += surface[i % plane].lack;
      occupied += surface[i % plane].occupied;
    }
    FlogCell& cell = tile[i];
    const double before = cell.rays, added = rays, weight = 1 / (before + added);
    const double empty = before * cell.empty + (added * FlogCell::kOne - static_cast<double>(lack));
    cell.empty = static_cast<uint16_t>(empty * weight + 0.5);
    cell.occupied = static_cast<uint16_t>((before * cell.occupied + static_cast<double>(occupied)) * weight + 0.5);
    cell.rays = std::min(cell.rays + rays, max_rays);
  }
}

// A part of a ray, or of several that are followed together.
struct Way {
  Eigen::Vector3d direction;
  double from = 0, end = 0;      // [m]
  double length = 0, error = 1;  // [m]
  uint32_t rays = 1;
};

// Follows rays through the tiles of a grid and adds up what they say.
class Walker {
 public:
  // `low`, `high`: tiles that the rays can reach, inclusive.
  Walker(const TiledGrid& grid, const Eigen::Vector3d& origin, const Eigen::Vector3i& low, const Eigen::Vector3i& high)
      : n_(grid.tile_boxes),
        low_(low),
        tiles_(high - low + Eigen::Vector3i::Ones()),
        boxes_(tiles_.cwiseProduct(n_)),
        box_(grid.box),
        inverse_box_(grid.box.cwiseInverse()),
        shift_x_(std::countr_zero(static_cast<unsigned>(n_.x()))),
        shift_y_(std::countr_zero(static_cast<unsigned>(n_.y()))),
        shift_z_(grid.single_layer_of_tiles ? 31 : std::countr_zero(static_cast<unsigned>(n_.z()))),
        single_layer_(grid.single_layer_of_tiles),
        start_((origin - grid.origin).cwiseQuotient(grid.box) - low.cwiseProduct(n_).cast<double>()),
        sums_(static_cast<size_t>(tiles_.prod())) {
    for (int a = 0; a < (single_layer_ ? 2 : 3); ++a) IRIS_CHECK(std::has_single_bit(static_cast<unsigned>(n_[a])));
  }

  void walk(const Way& way);
  std::vector<std::unique_ptr<TileSums>> take() { return std::move(sums_); }

 private:
  TileSums& tile(const Eigen::Vector3i& index) {
    std::unique_ptr<TileSums>& sums =
        sums_[(static_cast<size_t>(index.z()) * tiles_.y() + index.y()) * static_cast<size_t>(tiles_.x()) + index.x()];
    if (!sums) {
      sums = std::make_unique<TileSums>();
      sums->index = index + low_;
      sums->rays.resize(static_cast<size_t>(n_.prod()));
      sums->surface.resize(static_cast<size_t>(n_.z()));
    }
    return *sums;
  }

  Eigen::Vector3i n_, low_, tiles_, boxes_;  // boxes of a tile; first tile; tiles; boxes of all tiles
  Eigen::Vector3d box_, inverse_box_;
  int shift_x_, shift_y_, shift_z_;  // boxes of a tile as powers of two
  bool single_layer_;
  Eigen::Vector3d start_;  // [boxes] optical centre, from the corner of the first tile
  std::vector<std::unique_ptr<TileSums>> sums_;
};

void Walker::walk(const Way& way) {
  std::array<double, 3> velocity, inverse;  // boxes per metre, 2^-32 m per box
  for (int a = 0; a < 3; ++a) {
    const auto k = static_cast<size_t>(a);
    const double v = way.direction[a] * inverse_box_[a];
    velocity[k] = std::abs(v) < kSlowest ? std::copysign(kSlowest, v) : v;
    inverse[k] = kOneMetre / velocity[k];
  }
  double from = way.from;
  if (single_layer_) {  // nothing else ends before the rays do
    constexpr double kMetre = 1 / kOneMetre;
    const double t0 = -start_.z() * inverse[2] * kMetre, t1 = (boxes_.z() - start_.z()) * inverse[2] * kMetre;
    from = std::max(from, std::min(t0, t1));
    if (from >= std::min(way.end, std::max(t0, t1))) return;
  }
  // From here on integers: distance along the ray to the next plane of each axis and between two planes (Amanatides and
  // Woo). Masks instead of branches: which plane comes next cannot be predicted.
  std::array<int64_t, 3> next, delta;
  std::array<int, 3> box, sign;
  for (int a = 0; a < 3; ++a) {
    const auto k = static_cast<size_t>(a);
    const bool forward = velocity[k] > 0;
    box[k] = std::clamp(static_cast<int>(start_[a] + velocity[k] * from), 0, boxes_[a] - 1);
    next[k] = static_cast<int64_t>((static_cast<double>(box[k] + forward) - start_[a]) * inverse[k]);
    delta[k] = static_cast<int64_t>(std::abs(inverse[k]));
    sign[k] = forward ? 1 : -1;
  }
  auto [tx, ty, tz] = next;
  const auto [dx, dy, dz] = delta;
  const int64_t step_x = sign[0], step_y = static_cast<int64_t>(sign[1]) * n_.x(),
                step_z = static_cast<int64_t>(sign[2]) * n_.x() * n_.y();
  const Eigen::Vector3d along = way.direction.cwiseProduct(box_);  // [m] that the foot of the middle moves, box by box
  const double to_middle = 0.5 * along.sum() - start_.dot(along);
  const auto middle_of = [&](int x, int y, int z) {
    return fixed(to_middle + x * along.x() + y * along.y() + z * along.z());
  };
  const int64_t move_x = fixed(std::abs(along.x())), move_y = fixed(std::abs(along.y())),
                move_z = fixed(std::abs(along.z()));
  const int64_t end = fixed(way.end), length = fixed(way.length);
  // Where the ray is surely empty, muE = 1 and muO = 0 for any r.
  const int64_t empty_end = std::min(end, fixed(way.length - way.error));
  const float scale = static_cast<float>(1 / (kOneMetre * way.error));
  const int shift_plane = shift_x_ + shift_y_, plane = 1 << shift_plane;

  int64_t xy = std::min(tx, ty), out = std::min(xy, tz), t = fixed(from);
  // The part before has counted the box in which this one begins if its foot lies there.
  if (way.from > 0 && from == way.from && middle_of(box[0], box[1], box[2]) < t) t = out;
  for (;;) {  // tiles
    const Eigen::Vector3i index(box[0] >> shift_x_, box[1] >> shift_y_, box[2] >> shift_z_);
    TileSums& sums = tile(index);
    uint32_t* const rays = sums.rays.data();
    const Eigen::Vector3i corner = index.cwiseProduct(n_);
    const int x = box[0] - corner.x(), y = box[1] - corner.y(), z = box[2] - corner.z();
    const int64_t leave =
        std::min({tx + (sign[0] > 0 ? n_.x() - 1 - x : x) * dx, ty + (sign[1] > 0 ? n_.y() - 1 - y : y) * dy,
                  tz + (sign[2] > 0 ? n_.z() - 1 - z : z) * dz});
    int64_t at = (static_cast<int64_t>(z) * n_.y() + y) * n_.x() + x;
    const int64_t empty_here = std::min(leave, empty_end);
    while (out < empty_here) {
      rays[at] += way.rays & static_cast<uint32_t>(mask(out > t));
      t = out;
      const int64_t is_z = mask(tz <= xy), is_x = mask(tx < ty) & ~is_z, is_y = ~(is_x | is_z);
      at += (step_x & is_x) + (step_y & is_y) + (step_z & is_z);
      tx += dx & is_x;
      ty += dy & is_y;
      tz += dz & is_z;
      xy = std::min(tx, ty);
      out = std::min(xy, tz);
    }
    const auto update_box = [&] {
      const auto here = static_cast<int>(at);
      box = {corner.x() + (here & (n_.x() - 1)), corner.y() + ((here & (plane - 1)) >> shift_x_),
             corner.z() + (here >> shift_plane)};
    };
    update_box();
    if (out < leave || out >= empty_end) {
      // Distance along the ray to the foot of the box's middle; a step forward moves it by a constant.
      int64_t middle = middle_of(box[0], box[1], box[2]);
      for (;;) {
        if (out > t) {
          const int64_t r = std::min(std::max(middle, t), out);
          if (r >= end) return;
          rays[at] += way.rays;
          // (6.1)
          const float s = static_cast<float>(length - r) * scale;
          if (s < 1) {
            std::vector<TileSums::Surface>& surface = sums.surface[static_cast<size_t>(at >> shift_plane)];
            if (surface.empty()) surface.resize(static_cast<size_t>(plane));
            TileSums::Surface& sum = surface[static_cast<size_t>(at & (plane - 1))];
            sum.lack += static_cast<uint32_t>(static_cast<int>((1 - std::max(s, 0.0f)) * FlogCell::kOne + 0.5f));
            sum.occupied +=
                static_cast<uint32_t>(static_cast<int>(std::max(0.0f, 1 - std::abs(s)) * FlogCell::kOne + 0.5f));
          }
        }
        if (out >= leave) break;
        t = out;
        const int64_t is_z = mask(tz <= xy), is_x = mask(tx < ty) & ~is_z, is_y = ~(is_x | is_z);
        at += (step_x & is_x) + (step_y & is_y) + (step_z & is_z);
        middle += (move_x & is_x) + (move_y & is_y) + (move_z & is_z);
        tx += dx & is_x;
        ty += dy & is_y;
        tz += dz & is_z;
        xy = std::min(tx, ty);
        out = std::min(xy, tz);
      }
      update_box();
    } else if (out > t) {
      rays[at] += way.rays;  // the last box of the tile, surely empty
    }
    // Into the next tile.
    t = out;
    if (tz <= xy) {
      box[2] += sign[2];
      tz += dz;
    } else if (tx < ty) {
      box[0] += sign[0];
      tx += dx;
    } else {
      box[1] += sign[1];
      ty += dy;
    }
    for (size_t k = 0; k < 3; ++k) {
      if (box[k] < 0 || box[k] >= boxes_[static_cast<Eigen::Index>(k)]) return;
    }
    xy = std::min(tx, ty);
    out = std::min(xy, tz);
  }
}

// Walks the rays of a square of pixels, together as far as they go together.
class Bundles {
 public:
  static constexpr int kLevels = 3;  // squares of 8, 4, 2 pixels and single ones
  static constexpr int kSide = 1 << kLevels;

  Bundles(const SightRays& rays, double apart, Walker& walker) : rays_(rays), walker_(walker) {
    for (int level = 0; level <= kLevels; ++level) {
      reach_[static_cast<size_t>(level)] = apart / (rays.spacing * (1 << level));
    }
  }

  // ids: kSide x kSide rays by row and column, -1 = none.
  void walk(const std::array<int, kSide * kSide>& ids) {
    ids_ = &ids;
    for (int y = 0; y < kSide; ++y) {
      for (int x = 0; x < kSide; ++x) {
        Node& node = nodes_[0][static_cast<size_t>(y * kSide + x)];
        const int id = ids[static_cast<size_t>(y * kSide + x)];
        if (id < 0) {
          node = {};
          continue;
        }
        const SightRay& ray = rays_.rays[static_cast<size_t>(id)];
        node = {ray.direction, std::min(ray.end, ray.length - ray.error), 1};
      }
    }
    for (int level = 1; level <= kLevels; ++level) {
      const std::vector<Node>& parts = nodes_[static_cast<size_t>(level) - 1];
      for (int y = 0; y < kSide >> level; ++y) {
        for (int x = 0; x < kSide >> level; ++x) {
          Node sum;
          for (const int v : {2 * y, 2 * y + 1}) {
            for (const int u : {2 * x, 2 * x + 1}) {
              const Node& part = parts[static_cast<size_t>(v * kSide + u)];
              sum.direction += part.direction;
              sum.empty_to = std::min(sum.empty_to, part.empty_to);
              sum.rays += part.rays;
            }
          }
          nodes_[static_cast<size_t>(level)][static_cast<size_t>(y * kSide + x)] = sum;
        }
      }
    }
    follow(kLevels, 0, 0, 0);
  }

 private:
  struct Node {
    Eigen::Vector3f direction = Eigen::Vector3f::Zero();  // sum
    float empty_to = std::numeric_limits<float>::max();   // [m] the first of the rays says more from here on
    uint32_t rays = 0;
  };

  // The square of 2^level pixels with the index (x, y) among its like, from a distance on.
  void follow(int level, int x, int y, double from) {
    const auto at = static_cast<size_t>(y * kSide + x);
    const Node& node = nodes_[static_cast<size_t>(level)][at];
    if (node.rays == 0) return;
    if (level == 0) {
      const SightRay& ray = rays_.rays[static_cast<size_t>((*ids_)[at])];
      if (from < static_cast<double>(ray.end)) {
        walker_.walk({ray.direction.cast<double>(), from, ray.end, ray.length, ray.error, 1});
      }
      return;
    }
    constexpr double kFar = 1e6;  // [m] what a bundle says holds for empty space only
    const double to = std::min<double>(reach_[static_cast<size_t>(level)], node.empty_to);
    if (node.rays > 1 && to > from) {
      walker_.walk({node.direction.cast<double>().normalized(), from, to, kFar, 1, node.rays});
      from = to;
    }
    for (const int v : {2 * y, 2 * y + 1}) {
      for (const int u : {2 * x, 2 * x + 1}) follow(level - 1, u, v, from);
    }
  }

  const SightRays& rays_;
  Walker& walker_;
  std::array<double, kLevels + 1> reach_;  // [m] to where the rays of a square lie together
  const std::array<int, kSide* kSide>* ids_ = nullptr;
  std::array<std::vector<Node>, kLevels + 1> nodes_ = {std::vector<Node>(kSide * kSide),
                                                       std::vector<Node>(kSide* kSide), std::vector<Node>(kSide* kSide),
                                                       std::vector<Node>(kSide* kSide)};
};

// The tiles that rays can reach, inclusive; false: none.
bool reachable(const SightRays& rays, const TiledGrid& grid, Eigen::Vector3i& low, Eigen::Vector3i& high) {
  if (rays.rays.empty()) return false;
  Eigen::Vector3d least = rays.origin, most = rays.origin;
  for (const SightRay& ray : rays.rays) {
    const Eigen::Vector3d point = rays.origin + ray.direction.cast<double>() * ray.end;
    least = least.cwiseMin(point), most = most.cwiseMax(point);
  }
  constexpr double kRounding = 1e-3;  // [boxes]
  const Eigen::Vector3d tile = grid.box.cwiseProduct(grid.tile_boxes.cast<double>());
  const Eigen::Vector3d margin = kRounding * grid.box;
  low = (least - margin - grid.origin).cwiseQuotient(tile).array().floor().cast<int>();
  high = (most + margin - grid.origin).cwiseQuotient(tile).array().floor().cast<int>();
  if (!grid.single_layer_of_tiles) return true;
  if (low.z() > 0 || high.z() < 0) return false;
  low.z() = high.z() = 0;
  return true;
}

}  // namespace

SightRays sight_rays(const StereoView& view, const RayOptions& options) {
  const RectifiedCamera& camera = view.camera;
  const double f_t = camera.f * camera.baseline;
  const cv::Mat1f& disparity = view.disparity.disparity;
  IRIS_CHECK(options.step >= 1 && options.min_disparity > 0);
  SightRays result{view.world_from_cam.translation(), {}};
  result.columns = (disparity.cols + options.step - 1) / options.step;
  result.spacing = options.step / camera.f;
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
                             static_cast<float>(end), y * disparity.cols + x, y / options.step, x / options.step});
    }
  }
  return result;
}

void fuse_view(const SightRays& rays, const TiledGrid& grid, const FusionOptions& options, const TileOf& tile_of) {
  Eigen::Vector3i low, high;
  if (!reachable(rays, grid, low, high)) return;
  // Parts of the rays, each with sums of its own: [begin, end), at borders of squares of pixels if there is a picture.
  const bool bundle = options.bundle > 0 && rays.columns > 0;
  const auto row_of = [&](size_t i) { return rays.rays[i].row; };
  std::vector<size_t> parts = {0};
  while (parts.back() < rays.rays.size()) {
    size_t end = std::min(parts.back() + kMostRays, rays.rays.size());
    if (bundle && end < rays.rays.size()) {
      const int band = row_of(end) / Bundles::kSide;
      size_t border = end;
      while (border > parts.back() && row_of(border - 1) / Bundles::kSide == band) --border;
      if (border > parts.back()) end = border;
    }
    parts.push_back(end);
  }
  const double apart = options.bundle * std::min(grid.box.x(), grid.box.y());
  // So many at once: bounds the memory, whatever the number of threads.
  constexpr size_t kAtOnce = 4;
  for (size_t first = 0; first + 1 < parts.size(); first += kAtOnce) {
    const size_t count = std::min(kAtOnce, parts.size() - 1 - first);
    std::vector<std::vector<std::unique_ptr<TileSums>>> sums(count);
    parallel_chunks(0, static_cast<int>(count), 1, [&](int begin, int end) {
      for (int p = begin; p < end; ++p) {
        Walker walker(grid, rays.origin, low, high);
        size_t i = parts[first + static_cast<size_t>(p)];
        const size_t part_end = parts[first + static_cast<size_t>(p) + 1];
        if (!bundle) {
          for (; i < part_end; ++i) {
            const SightRay& ray = rays.rays[i];
            walker.walk({ray.direction.cast<double>(), 0, ray.end, ray.length, ray.error, 1});
          }
        }
        Bundles bundles(rays, std::max(apart, 1e-12), walker);
        std::vector<std::array<int, Bundles::kSide * Bundles::kSide>> squares(
            bundle ? static_cast<size_t>(rays.columns / Bundles::kSide + 1) : 0);
        while (i < part_end) {  // bands of squares
          for (auto& square : squares) square.fill(-1);
          const int band = row_of(i) / Bundles::kSide;
          for (; i < part_end && row_of(i) / Bundles::kSide == band; ++i) {
            const int column = rays.rays[i].column;
            squares[static_cast<size_t>(column / Bundles::kSide)]
                   [static_cast<size_t>(row_of(i) % Bundles::kSide * Bundles::kSide + column % Bundles::kSide)] =
                       static_cast<int>(i);
          }
          for (const auto& square : squares) bundles.walk(square);
        }
        sums[static_cast<size_t>(p)] = walker.take();
      }
    });
    struct Task {
      size_t tile;
      std::span<FlogCell> cells;
    };
    std::vector<Task> tasks;
    for (size_t t = 0; t < sums.front().size(); ++t) {
      const TileSums* touched = nullptr;
      for (const auto& of_part : sums) {
        if (of_part[t]) touched = of_part[t].get();
      }
      if (!touched) continue;
      const std::span<FlogCell> cells = tile_of(touched->index);
      if (cells.empty()) continue;
      IRIS_CHECK(cells.size() == static_cast<size_t>(grid.tile_boxes.prod()));
      tasks.push_back({t, cells});
    }
    parallel_chunks(0, static_cast<int>(tasks.size()), 1, [&](int begin, int end) {
      for (int i = begin; i < end; ++i) {
        const Task& task = tasks[static_cast<size_t>(i)];
        std::vector<const TileSums*> of_tile;
        for (const auto& of_part : sums) {
          if (of_part[task.tile]) of_tile.push_back(of_part[task.tile].get());
        }
        apply(of_tile, options.max_rays, task.cells);
      }
    });
  }
}

}  // namespace iris::mapping
