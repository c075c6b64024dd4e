#include "export/cloud_fusion.h"

#include <spdlog/spdlog.h>

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>

#include "export/cloud_filter.h"
#include "export/colours.h"
#include "iris/core/error.h"
#include "iris/core/options.h"
#include "iris/core/parallel.h"

namespace iris::exporters {

using reconstruct::FusedPixel;
using reconstruct::FusedView;

void CloudOptions::declare(OptionSet& set) {
  fusion.declare(set);
  set.section("cloud");
  set.add("voxel", voxel, "m", 0.001, 10,
          "edge of the cubes that thin the points, one point a cube; smaller shows more detail and makes larger files");
  set.add("max_points", max_points, "", 1000, 50'000'000,
          "at most so many points; with more, the edge of the cubes is doubled until they fit");
  set.add(
      "min_agree", min_agree, "", 0, 100,
      "other views that must measure a point; 0 keeps what a single view has seen: more complete, more wrong points");
  set.add("outlier_points", outlier_points, "", 0, 100,
          "neighbours whose mean distance tells whether a point stands alone and is dropped; 0 = keep all");
  set.add("outlier_sigma", outlier_sigma, "", 0.1, 20,
          "standard deviations above the mean from which on that distance is too large");
  set.add("normal_points", normal_points, "", 3, 100, "neighbours that a point's normal is fitted to");
  set.add("ascii", ascii, "writes cloud.ply as text: four times larger, readable by everything");
}

namespace {

// Sums over the points in each cube. Cubes are kept in the order of their first point; a table with open addressing
// finds them.
class FusionGrid {
 public:
  struct Sample {
    Eigen::Vector3d point;       // [m]
    Eigen::Matrix3d covariance;  // [m^2]
    Eigen::Vector3f colour;      // linear light
    Eigen::Vector3f to_camera;   // unit length
    float sigma = 0, range = 0;  // [m]
    int views = 0;
  };
  struct Cube {
    std::array<int32_t, 3> key;
    // Float sums, of positions relative to the cube's middle.
    Eigen::Matrix3f information = Eigen::Matrix3f::Zero();
    Eigen::Vector3f pull = Eigen::Vector3f::Zero();  // information * position
    Eigen::Vector3f colour = Eigen::Vector3f::Zero();
    Eigen::Vector3f to_camera = Eigen::Vector3f::Zero();
    float weight = 0, variance = 0;  // of colours, directions and variances: 1 / variance of the sample
    float range = 0;                 // least
    int views = 0;                   // most
    int samples = 0;
  };

  explicit FusionGrid(double edge) : edge_(edge), slots_(1 << 16, -1) {}

  double edge() const { return edge_; }
  const std::vector<Cube>& cubes() const { return cubes_; }

  Eigen::Vector3d middle(const Cube& cube) const {
    return Eigen::Vector3d(cube.key[0] + 0.5, cube.key[1] + 0.5, cube.key[2] + 0.5) * edge_;
  }
  Eigen::Vector3d mean(const Cube& cube) const {
    const Eigen::Matrix3d information = cube.information.cast<double>();
    return middle(cube) + information.inverse() * cube.pull.cast<double>();
  }

  void add(const Sample& sample) {
    std::array<int32_t, 3> key;
    for (int i = 0; i < 3; ++i) key[i] = static_cast<int32_t>(std::floor(sample.point[i] / edge_));
    Cube& cube = at(key);
    const Eigen::Matrix3d spread = sample.covariance + edge_ * edge_ / 12 * Eigen::Matrix3d::Identity();
    const Eigen::Matrix3f information = spread.inverse().cast<float>();
    cube.information += information;
    cube.pull += information * (sample.point - middle(cube)).cast<float>();
    const float weight = 1 / std::max(sample.sigma * sample.sigma, 1e-12f);
    cube.weight += weight;
    cube.variance += weight * sample.sigma * sample.sigma;
    cube.colour += weight * sample.colour;
    cube.to_camera += weight * sample.to_camera;
    cube.range = cube.samples == 0 ? sample.range : std::min(cube.range, sample.range);
    cube.views = std::max(cube.views, sample.views);
    ++cube.samples;
  }

  // Cubes of twice the edge: each takes over the sums of the up to eight that it covers.
  void coarsen() {
    std::vector<Cube> fine;
    fine.swap(cubes_);
    std::fill(slots_.begin(), slots_.end(), -1);
    const double fine_edge = edge_;
    edge_ *= 2;
    for (const Cube& cube : fine) {
      const Eigen::Vector3d fine_middle =
          Eigen::Vector3d(cube.key[0] + 0.5, cube.key[1] + 0.5, cube.key[2] + 0.5) * fine_edge;
      Cube& coarse = at({cube.key[0] >> 1, cube.key[1] >> 1, cube.key[2] >> 1});
      coarse.information += cube.information;
      coarse.pull += cube.pull + cube.information * (fine_middle - middle(coarse)).cast<float>();
      coarse.weight += cube.weight;
      coarse.variance += cube.variance;
      coarse.colour += cube.colour;
      coarse.to_camera += cube.to_camera;
      coarse.range = coarse.samples == 0 ? cube.range : std::min(coarse.range, cube.range);
      coarse.views = std::max(coarse.views, cube.views);
      coarse.samples += cube.samples;
    }
  }

 private:
  static size_t hash(const std::array<int32_t, 3>& key) {
    uint64_t h = static_cast<uint32_t>(key[0]) * 0x9E3779B97F4A7C15ull;
    h = (h ^ static_cast<uint32_t>(key[1])) * 0xC2B2AE3D27D4EB4Full;
    h = (h ^ (h >> 29) ^ static_cast<uint32_t>(key[2])) * 0x165667B19E3779F9ull;
    return static_cast<size_t>(h ^ (h >> 32));
  }

  static bool same(const std::array<int32_t, 3>& a, const std::array<int32_t, 3>& b) {
    return a[0] == b[0] && a[1] == b[1] && a[2] == b[2];
  }

  size_t slot_of(const std::array<int32_t, 3>& key) const {
    size_t slot = hash(key) & (slots_.size() - 1);
    while (slots_[slot] >= 0 && !same(cubes_[static_cast<size_t>(slots_[slot])].key, key)) {
      slot = (slot + 1) & (slots_.size() - 1);
    }
    return slot;
  }

  Cube& at(const std::array<int32_t, 3>& key) {
    const size_t slot = slot_of(key);
    if (slots_[slot] >= 0) return cubes_[static_cast<size_t>(slots_[slot])];
    slots_[slot] = static_cast<int32_t>(cubes_.size());
    cubes_.push_back({.key = key});
    if (2 * cubes_.size() > slots_.size()) {
      slots_.assign(2 * slots_.size(), -1);
      for (size_t i = 0; i < cubes_.size(); ++i) slots_[slot_of(cubes_[i].key)] = static_cast<int32_t>(i);
    }
    return cubes_.back();
  }

  double edge_;
  std::vector<int32_t> slots_;  // a power of two of them; index of the cube, -1 = free
  std::vector<Cube> cubes_;
};

// A fused pixel as a point of the world, with the covariance of (4.14): dp on x and y, sigma on the disparity.
FusionGrid::Sample sample_of(const StereoView& view, const FusedPixel& pixel, double image_error,
                             const std::array<float, 256>& levels) {
  const RectifiedCamera& camera = view.camera;
  const double d = pixel.disparity + camera.disparity_offset, scale = camera.baseline / d;
  const Eigen::Vector3d point = camera.point(pixel.x, pixel.y, pixel.disparity);
  Eigen::Matrix3d covariance = point * point.transpose() * std::pow(pixel.sigma / d, 2);
  covariance(0, 0) += std::pow(scale * image_error, 2);
  covariance(1, 1) += std::pow(scale * image_error, 2);
  // The plane of constant slope: slope_x f X + slope_y f Y + c Z = f b.
  const double ax = camera.f * pixel.slope_x, ay = camera.f * pixel.slope_y;
  const Eigen::Vector3d normal =
      Eigen::Vector3d(ax, ay, (camera.f * camera.baseline - ax * point.x() - ay * point.y()) / point.z()).normalized();
  const Eigen::Matrix3d& r = view.world_from_cam.linear();
  FusionGrid::Sample sample;
  sample.point = view.world_from_cam * point;
  sample.covariance = r * covariance * r.transpose();
  sample.colour = linear_colour(view.image, pixel.y, pixel.x, levels);
  sample.to_camera = -(r * point).normalized().cast<float>();
  sample.sigma = static_cast<float>(std::sqrt(normal.dot(covariance * normal)));
  sample.range = static_cast<float>(point.norm());
  sample.views = 1 + pixel.agree;
  return sample;
}

constexpr int kBatch = 8;  // views fused at the same time

}  // namespace

ViewFusion::ViewFusion(const views::ViewStore& views, const CloudOptions& options) : views_(views), options_(options) {
  for (const views::ViewSummary& view : views.summaries()) cameras_.push_back({view.camera, view.world_from_cam});
  // The scale of the errors, from a few views and few of their pixels.
  constexpr int kProbes = 24;
  constexpr double kWide = 10;  // [standard deviations] the gate, as long as the errors are not known
  reconstruct::FusionOptions probing = options.fusion;
  probing.step = std::max(8, options.fusion.step);
  probing.gate = kWide;
  const int count = static_cast<int>(cameras_.size()), probes = std::min(kProbes, count);
  std::vector<std::vector<float>> differences(static_cast<size_t>(probes));
  parallel_chunks(0, probes, 1, [&](int i, int) {
    const int index = static_cast<int>((2 * int64_t{i} + 1) * count / (2 * probes));
    const auto view = views_.load(index);
    std::vector<std::shared_ptr<const StereoView>> others;
    for (const int other : neighbours(*view, index)) others.push_back(views_.load(other));
    differences[static_cast<size_t>(i)] = fuse_view(*view, others, probing).differences;
  });
  std::vector<float> all;
  for (const std::vector<float>& some : differences) all.insert(all.end(), some.begin(), some.end());
  error_scale_ = std::max(1.0, reconstruct::error_scale_of(std::move(all)));
}

std::vector<int> ViewFusion::neighbours(const StereoView& view, int index) const {
  return reconstruct::overlapping_views(view, cameras_, index, options_.fusion);
}

ViewFusion::Fused ViewFusion::fuse(int index) const {
  Fused result{.view = views_.load(index), .fused = {}};
  std::vector<std::shared_ptr<const StereoView>> others;
  for (const int other : neighbours(*result.view, index)) others.push_back(views_.load(other));
  result.fused = fuse_view(*result.view, others, options_.fusion, error_scale_);
  if (others.empty()) return result;
  std::erase_if(result.fused.pixels, [&](const FusedPixel& pixel) {
    return pixel.agree < options_.min_agree || pixel.through > pixel.agree;
  });
  return result;
}

PointCloud fuse_cloud(const views::ViewStore& views, const CloudOptions& options, const pipeline::RunControl& control) {
  const int count = static_cast<int>(views.summaries().size());
  const ViewFusion fusion(views, options);
  const double image_error = options.fusion.pixel_error * fusion.error_scale();
  const std::array<float, 256> levels = linear_levels();
  FusionGrid grid(options.voxel);
  Progress progress(control.progress, "cloud", count);
  for (int begin = 0; begin < count; begin += kBatch) {
    if (control.stopped()) throw Interrupted();
    const int end = std::min(begin + kBatch, count);
    std::vector<ViewFusion::Fused> batch(static_cast<size_t>(end - begin));
    parallel_chunks(begin, end, 1, [&](int i, int) { batch[static_cast<size_t>(i - begin)] = fusion.fuse(i); });
    for (const ViewFusion::Fused& one : batch) {
      for (const FusedPixel& pixel : one.fused.pixels) grid.add(sample_of(*one.view, pixel, image_error, levels));
      while (grid.cubes().size() > static_cast<size_t>(options.max_points) && grid.edge() < 1000) grid.coarsen();
    }
    progress.update(end);
  }
  PointCloud cloud{.edge = grid.edge(), .points = {}};
  cloud.points.reserve(grid.cubes().size());
  for (const FusionGrid::Cube& cube : grid.cubes()) {
    CloudPoint point;
    point.position = grid.mean(cube).cast<float>();
    point.normal = cube.to_camera.normalized();  // which side was seen: what the fitted normal points to
    point.rgb = srgb_colour(cube.colour / cube.weight);
    point.sigma = std::sqrt(cube.variance / cube.weight);
    point.range = cube.range;
    point.views = static_cast<uint16_t>(std::min(cube.views, 65535));
    cloud.points.push_back(point);
  }
  if (control.stopped()) throw Interrupted();
  filter_cloud(cloud, options.outlier_points, options.outlier_sigma, options.normal_points);
  spdlog::info("cloud: {} points, one a cube of {} m; errors {:.1f} times what cloud.pixel_error says",
               cloud.points.size(), cloud.edge, fusion.error_scale());
  return cloud;
}

}  // namespace iris::exporters
