#include "iris/mapping/ray_fusion.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <mutex>

#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "ray_kernels.h"

namespace iris::mapping {
namespace {

// Adds up what rays say about the boxes of a region of tiles.
class Walker {
 public:
  // `low`, `high`: tiles that the rays can reach, inclusive.
  Walker(const TiledGrid& grid, const Eigen::Vector3d& origin, const Eigen::Vector3i& low, const Eigen::Vector3i& high)
      : sums_(layout_of(grid, high - low + Eigen::Vector3i::Ones())) {
    const Eigen::Vector3d start =
        (origin - grid.origin).cwiseQuotient(grid.box) - low.cwiseProduct(grid.tile_boxes).cast<double>();
    for (int a = 0; a < 3; ++a) {
      grid_.box[a] = grid.box[a];
      grid_.inverse_box[a] = 1 / grid.box[a];
      grid_.start[a] = start[a];
    }
    grid_.clip_z = grid.single_layer_of_tiles;
  }

  void add_ray(const Eigen::Vector3f& direction, float from, float length, float error, float end) {
    const size_t i = append(rays_, direction, from, end, 1);
    rays_.length[i] = length;
    rays_.error[i] = error;
    if (rays_.count == Ways::kMost) walk_rays(grid_, rays_, sums_);
  }
  // So many rays along one direction, between two distances where it is empty.
  void add_empty(const Eigen::Vector3f& direction, float from, float to, uint32_t rays) {
    append(empty_, direction, from, to, rays);
    if (empty_.count == Ways::kMost) walk_empty(grid_, empty_, sums_);
  }
  void finish() {
    walk_rays(grid_, rays_, sums_);
    walk_empty(grid_, empty_, sums_);
  }
  const BlockSums& sums() const { return sums_; }

 private:
  static BoxLayout layout_of(const TiledGrid& grid, const Eigen::Vector3i& tiles) {
    constexpr int kBlock[3] = {4, 4, 2};  // [powers of two] a few kB, so that little is held that no ray crosses
    BoxLayout layout;
    for (int a = 0; a < 3; ++a) {
      const auto n = static_cast<unsigned>(grid.tile_boxes[a]);
      layout.boxes[a] = tiles[a] * grid.tile_boxes[a];
      if (a == 2 && grid.single_layer_of_tiles) continue;
      IRIS_CHECK(std::has_single_bit(n));
      layout.block_shift[a] = std::min(kBlock[a], std::countr_zero(n));
      if (a < 2) {
        const auto blocks = static_cast<unsigned>(layout.boxes[a] >> layout.block_shift[a]);
        layout.blocks_shift[a] = std::countr_zero(std::bit_ceil(blocks));
      }
    }
    return layout;
  }

  static size_t append(Ways& ways, const Eigen::Vector3f& direction, float from, float end, uint32_t rays) {
    const size_t i = ways.count++;
    for (int a = 0; a < 3; ++a) ways.direction[a][i] = direction[a];
    ways.from[i] = from;
    ways.end[i] = end;
    ways.rays[i] = rays;
    return i;
  }

  WalkGrid grid_;
  Ways rays_, empty_;
  BlockSums sums_;
};

// Makes the rays of a view, band by band.
class BandMaker {
 public:
  BandMaker(const StereoView& view, const RayOptions& options)
      : disparity_(view.disparity), step_(options.step), rotation_(view.world_from_cam.linear()), camera_(view.camera) {
    IRIS_CHECK(options.step >= 1 && options.min_disparity > 0);
    const double f_t = camera_.f * camera_.baseline;
    row_.f_t = f_t;
    row_.disparity_offset = camera_.disparity_offset;
    row_.min_disparity = options.min_disparity;
    row_.farthest_z = f_t / options.min_disparity;
    row_.error_scale = 3 * options.pixel_error * std::sqrt(2.0) / f_t;  // (4.24)
    row_.min_error = options.min_error;
    row_.max_range = options.max_range;
  }

  size_t columns() const { return static_cast<size_t>((disparity_.disparity.cols + step_ - 1) / step_); }
  int rows() const { return (disparity_.disparity.rows + step_ - 1) / step_; }
  int bands() const { return (rows() + RayBand::kRows - 1) / RayBand::kRows; }

  void make(int index, RayBand& band) const {
    const int first = index * RayBand::kRows, count = std::min(RayBand::kRows, rows() - first);
    band.clear();
    SightRow row = row_;
    for (int y = 0; y < count; ++y) {
      const int image_y = (first + y) * step_;
      const Eigen::Vector3d left =
          rotation_ * Eigen::Vector3d(-camera_.cx / camera_.f, (image_y - camera_.cy) / camera_.f, 1);
      const Eigen::Vector3d column_step = rotation_.col(0) * (step_ / camera_.f);
      for (int a = 0; a < 3; ++a) row.first[a] = left[a], row.column_step[a] = column_step[a];
      float* const measured = band.disparity.data() + static_cast<size_t>(y) * band.stride();
      const float* const disparities = disparity_.disparity.ptr<float>(image_y);
      const uint8_t* const origins = disparity_.origin.ptr<uint8_t>(image_y);
      for (size_t i = 0; i < columns(); ++i) {
        const size_t x = i * static_cast<size_t>(step_);
        measured[i] = origins[x] <= static_cast<uint8_t>(DisparityOrigin::within_segment) ? disparities[x] : 0;
      }
      sight_row(row, y, band);
    }
  }

 private:
  const DisparityImage& disparity_;
  int step_;
  Eigen::Matrix3d rotation_;
  RectifiedCamera camera_;
  SightRow row_;
};

// Walks the rays of squares of pixels, together as far as they go together.
class Bundles {
 public:
  // `apart` [m], `spacing` [rad] of neighbouring pixels.
  Bundles(double apart, double spacing, Walker& walker) : walker_(walker) {
    for (int level = 0; level <= RayBand::kLevels; ++level) {
      reach_[static_cast<size_t>(level)] = static_cast<float>(apart / (spacing * (1 << level)));
    }
  }

  void walk(const RayBand& band) {
    for (size_t x = 0; x < band.levels[RayBand::kLevels].stride; ++x) follow<RayBand::kLevels>(band, x, 0, 0);
  }

 private:
  // The square of 2^kLevel pixels with the index (x, y) among its like, from a distance on.
  template <int kLevel>
  void follow(const RayBand& band, size_t x, size_t y, float from) {
    const RayBand::Level& level = band.levels[kLevel];
    const size_t at = y * level.stride + x;
    const float rays = level.rays[at];
    if (rays == 0) return;
    const Eigen::Vector3f direction(level.direction[0][at], level.direction[1][at], level.direction[2][at]);
    if constexpr (kLevel == 0) {
      if (from < band.end[at]) walker_.add_ray(direction, from, band.length[at], band.error[at], band.end[at]);
    } else {
      const float to = std::min(reach_[kLevel], level.empty_to[at]);
      if (rays > 1 && to > from) {
        walker_.add_empty(direction.normalized(), from, to, static_cast<uint32_t>(rays));
        from = to;
      }
      for (const size_t v : {2 * y, 2 * y + 1}) {
        for (const size_t u : {2 * x, 2 * x + 1}) follow<kLevel - 1>(band, u, v, from);
      }
    }
  }

  Walker& walker_;
  std::array<float, RayBand::kLevels + 1> reach_;  // [m] to where the rays of a square lie together
};

// The tiles that rays can reach whose ends lie in a box around their origin, inclusive; false: none.
bool reachable(const Eigen::Vector3d& origin, const Eigen::AlignedBox3f& ends, const TiledGrid& grid,
               Eigen::Vector3i& low, Eigen::Vector3i& high) {
  constexpr double kRounding = 1e-3;  // [boxes]
  const Eigen::Vector3d least = origin + ends.min().cast<double>(), most = origin + ends.max().cast<double>();
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
  const BandMaker maker(view, options);
  SightRays result{view.world_from_cam.translation(), {}};
  result.rays.reserve(maker.columns() * static_cast<size_t>(maker.rows()));
  RayBand band(maker.columns());
  const RayBand::Level& pixels = band.levels[0];
  for (int b = 0; b < maker.bands(); ++b) {
    maker.make(b, band);
    for (int y = 0; y < RayBand::kRows; ++y) {
      for (size_t x = 0; x < maker.columns(); ++x) {
        const size_t at = static_cast<size_t>(y) * band.stride() + x;
        if (band.end[at] <= 0) continue;
        result.rays.push_back({{pixels.direction[0][at], pixels.direction[1][at], pixels.direction[2][at]},
                               band.length[at],
                               band.error[at],
                               band.end[at],
                               (b * RayBand::kRows + y) * options.step * view.disparity.disparity.cols +
                                   static_cast<int>(x) * options.step});
      }
    }
  }
  return result;
}

namespace {

// (6.2) for a block of boxes of a tile, which lies `corner` boxes from the corner of the tile.
void apply(const std::vector<const BoxSum*>& parts, const BoxLayout& layout, const Eigen::Vector3i& corner,
           const Eigen::Vector3i& tile_boxes, uint32_t max_rays, std::span<FlogCell> tile) {
  const int nx = 1 << layout.block_shift[0], ny = 1 << layout.block_shift[1], nz = 1 << layout.block_shift[2];
  size_t i = 0;
  for (int z = 0; z < nz; ++z) {
    for (int y = 0; y < ny; ++y) {
      FlogCell* const row = &tile[(static_cast<size_t>(corner.z() + z) * static_cast<size_t>(tile_boxes.y()) +
                                   static_cast<size_t>(corner.y() + y)) *
                                      static_cast<size_t>(tile_boxes.x()) +
                                  static_cast<size_t>(corner.x())];
      for (int x = 0; x < nx; ++x, ++i) {
        uint64_t rays_and_lack = 0, occupied = 0;
        for (const BoxSum* part : parts) {
          rays_and_lack += part[i].rays_and_lack;
          occupied += part[i].occupied;
        }
        const auto rays = static_cast<uint32_t>(rays_and_lack >> kRayShift);
        if (rays == 0) continue;
        const uint64_t lack = rays_and_lack & (kOneRay - 1);
        FlogCell& cell = row[x];
        const double before = cell.rays, added = rays, weight = 1 / (before + added);
        const double empty = before * cell.empty + (added * FlogCell::kOne - static_cast<double>(lack));
        cell.empty = static_cast<uint16_t>(empty * weight + 0.5);
        cell.occupied = static_cast<uint16_t>((before * cell.occupied + static_cast<double>(occupied)) * weight + 0.5);
        cell.rays = std::min({cell.rays + rays, max_rays, FlogCell::kMostRays});
        cell.views = std::min(cell.views + 1u, 255u);
      }
    }
  }
}

// A walker for each thread that asks for one at a time. Which rays it gets does not matter, since sums of integers do
// not depend on their order.
class Walkers {
 public:
  explicit Walkers(std::function<std::unique_ptr<Walker>()> make) : make_(std::move(make)) {}

  void use(const std::function<void(Walker&)>& work) {
    Walker* walker = nullptr;
    {
      const std::lock_guard lock(mutex_);
      if (!idle_.empty()) {
        walker = idle_.back();
        idle_.pop_back();
      }
    }
    if (!walker) {
      std::unique_ptr<Walker> made = make_();
      walker = made.get();
      const std::lock_guard lock(mutex_);
      all_.push_back(std::move(made));
    }
    work(*walker);
    const std::lock_guard lock(mutex_);
    idle_.push_back(walker);
  }
  const std::vector<std::unique_ptr<Walker>>& all() const { return all_; }

 private:
  std::function<std::unique_ptr<Walker>()> make_;
  std::mutex mutex_;
  std::vector<std::unique_ptr<Walker>> all_;
  std::vector<Walker*> idle_;
};

// Boxes of a tile's sums.
struct TileBlocks {
  Eigen::Vector3i tile;                  // from the first one of the region
  std::vector<size_t> blocks;            // ascending
  std::vector<Eigen::Vector3i> corners;  // [boxes] of the blocks, from the tile's
};

// All blocks with sums, by tiles in ascending order (z, y, x).
std::vector<TileBlocks> touched_tiles(const std::vector<std::unique_ptr<Walker>>& walkers, const TiledGrid& grid) {
  std::vector<uint32_t> blocks;
  for (const auto& walker : walkers) {
    const std::vector<uint32_t>& of_walker = walker->sums().allocated();
    blocks.insert(blocks.end(), of_walker.begin(), of_walker.end());
  }
  std::sort(blocks.begin(), blocks.end());
  blocks.erase(std::unique(blocks.begin(), blocks.end()), blocks.end());
  const BoxLayout& layout = walkers.front()->sums().layout();
  std::map<std::array<int, 3>, TileBlocks> tiles;
  for (const uint32_t block : blocks) {
    const auto x = static_cast<int>(block & ((1u << layout.blocks_shift[0]) - 1));
    const auto y = static_cast<int>(block >> layout.blocks_shift[0] & ((1u << layout.blocks_shift[1]) - 1));
    const auto z = static_cast<int>(block >> (layout.blocks_shift[0] + layout.blocks_shift[1]));
    const Eigen::Vector3i at(x << layout.block_shift[0], y << layout.block_shift[1], z << layout.block_shift[2]);
    const Eigen::Vector3i tile = at.cwiseQuotient(grid.tile_boxes);
    TileBlocks& of_tile = tiles[{tile.z(), tile.y(), tile.x()}];
    of_tile.tile = tile;
    of_tile.blocks.push_back(block);
    of_tile.corners.push_back(at - tile.cwiseProduct(grid.tile_boxes));
  }
  std::vector<TileBlocks> result;
  for (auto& [index, tile] : tiles) result.push_back(std::move(tile));
  return result;
}

// Updates the cells with all that the walkers have summed up.
void apply(const std::vector<std::unique_ptr<Walker>>& walkers, const TiledGrid& grid, const Eigen::Vector3i& low,
           uint32_t max_rays, const TileOf& tile_of) {
  if (walkers.empty()) return;
  const std::vector<TileBlocks> touched = touched_tiles(walkers, grid);
  std::vector<std::span<FlogCell>> tiles;
  for (const TileBlocks& tile : touched) {
    tiles.push_back(tile_of(tile.tile + low));
    IRIS_CHECK(tiles.back().empty() || tiles.back().size() == static_cast<size_t>(grid.tile_boxes.prod()));
  }
  parallel_chunks(0, static_cast<int>(touched.size()), 1, [&](int begin, int end) {
    std::vector<const BoxSum*> parts;
    for (int t = begin; t < end; ++t) {
      const TileBlocks& tile = touched[static_cast<size_t>(t)];
      const std::span<FlogCell> cells = tiles[static_cast<size_t>(t)];
      for (size_t b = 0; !cells.empty() && b < tile.blocks.size(); ++b) {
        parts.clear();
        for (const auto& walker : walkers) {
          if (const BoxSum* part = walker->sums().table()[tile.blocks[b]]) parts.push_back(part);
        }
        apply(parts, walkers.front()->sums().layout(), tile.corners[b], grid.tile_boxes, max_rays, cells);
      }
    }
  });
}

}  // namespace

void fuse_view(const StereoView& view, const RayOptions& ray_options, const TiledGrid& grid,
               const FusionOptions& options, const TileOf& tile_of) {
  const BandMaker maker(view, ray_options);
  const Eigen::Vector3d origin = view.world_from_cam.translation();
  constexpr int kGrain = 6;  // bands; a part of the image
  // Where the rays end, before any is followed. They are made twice, which is cheaper than to hold them.
  std::vector<Eigen::AlignedBox3f> boxes(static_cast<size_t>(maker.bands()));
  parallel_chunks(0, maker.bands(), kGrain, [&](int begin, int end) {
    RayBand band(maker.columns());
    for (int b = begin; b < end; ++b) {
      maker.make(b, band);
      boxes[static_cast<size_t>(b)] = {Eigen::Vector3f(band.low), Eigen::Vector3f(band.high)};
    }
  });
  Eigen::AlignedBox3f ends;
  for (const Eigen::AlignedBox3f& box : boxes) ends.extend(box);
  Eigen::Vector3i low, high;
  if (ends.isEmpty() || !reachable(origin, ends, grid, low, high)) return;

  const double apart = options.bundle * std::min(grid.box.x(), grid.box.y());
  const int most = static_cast<int>(kMostRays / (maker.columns() * RayBand::kRows));  // bands at once
  IRIS_CHECK(most > 0);
  for (int first = 0; first < maker.bands(); first += most) {
    Walkers walkers([&] { return std::make_unique<Walker>(grid, origin, low, high); });
    parallel_chunks(first, std::min(first + most, maker.bands()), kGrain, [&](int begin, int end) {
      walkers.use([&](Walker& walker) {
        RayBand band(maker.columns());
        Bundles bundles(apart, ray_options.step / view.camera.f, walker);
        for (int b = begin; b < end; ++b) {
          maker.make(b, band);
          sum_squares(band);
          bundles.walk(band);
        }
        walker.finish();
      });
    });
    apply(walkers.all(), grid, low, options.max_rays, tile_of);
  }
}

void fuse_rays(const SightRays& rays, const TiledGrid& grid, const FusionOptions& options, const TileOf& tile_of) {
  if (rays.rays.empty()) return;
  Eigen::AlignedBox3f ends(Eigen::Vector3f::Zero().eval());
  for (const SightRay& ray : rays.rays) ends.extend(ray.direction * ray.end);
  Eigen::Vector3i low, high;
  if (!reachable(rays.origin, ends, grid, low, high)) return;
  for (size_t first = 0; first < rays.rays.size(); first += kMostRays) {
    const size_t last = std::min(first + kMostRays, rays.rays.size());
    std::vector<std::unique_ptr<Walker>> walkers;
    walkers.push_back(std::make_unique<Walker>(grid, rays.origin, low, high));
    for (size_t i = first; i < last; ++i) {
      const SightRay& ray = rays.rays[i];
      walkers[0]->add_ray(ray.direction, 0, ray.length, ray.error, ray.end);
    }
    walkers[0]->finish();
    apply(walkers, grid, low, options.max_rays, tile_of);
  }
}

}  // namespace iris::mapping
