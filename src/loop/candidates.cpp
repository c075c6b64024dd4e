#include "iris/loop/candidates.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <map>
#include <unordered_map>

#include "iris/core/parallel.h"
#include "iris/motion/minimise.h"

namespace iris::loop {
namespace {

constexpr int kPoints = 30;  // of a sketch

// Probability that a normal variable lies below 0.
double below_zero(double mean, double sigma) { return 0.5 * std::erfc(mean / (sigma * std::sqrt(2.0))); }

// How probably view a sees a point of view b, weighted with how alike it looks from there; or, at best, whether it can
// see it if the error of the pose is as lucky as three standard deviations allow.
double seen(const ViewSketch& a, const Eigen::Vector3d& in_b, const Pose& a_from_b, const Matrix6d& covariance,
            const RectifiedCamera& camera, bool at_best) {
  constexpr double kNear = 0.1;                         // [m]
  constexpr double kLeastScale = 0.4;                   // corners are not recognised at other sizes
  constexpr double kFullView = 0.87, kLeastView = 0.5;  // cosines of the angle between the two sights: 30, 60 deg
  constexpr double kHidden = 1.25;                      // times as far as what is seen
  const Eigen::Vector3d p = a_from_b * in_b;
  const double z = p.z();
  if (z < kNear) return 0;
  Eigen::Matrix<double, 3, 6> jacobian;
  jacobian << Eigen::Matrix3d::Identity(), -motion::cross_matrix(p);
  const Eigen::Matrix3d spread = jacobian * covariance * jacobian.transpose();
  const double sigma_z = std::sqrt(spread(2, 2));
  const double scale = in_b.norm() / p.norm(), error = 1 + sigma_z / z;
  if (scale * error < kLeastScale || scale / error > 1 / kLeastScale) return 0;
  const Eigen::Vector3d from_b = p - a_from_b.translation();
  double sight = p.dot(from_b) / (p.norm() * from_b.norm());
  if (at_best) sight += 3 * std::sqrt(spread.trace()) / p.norm();
  if (sight < kLeastView) return 0;
  // How probably it falls into an image's rows, or columns.
  const auto inside = [&](double at, const Eigen::RowVector3d& by_point, int size) {
    const double sigma = std::sqrt((by_point * spread * by_point.transpose()).value() + 1);
    if (at_best) return at > -3 * sigma && at < size + 3 * sigma ? 1.0 : 0.0;
    return below_zero(at - size, sigma) - below_zero(at, sigma);
  };
  const double x = camera.f * p.x() / z + camera.cx, y = camera.f * p.y() / z + camera.cy;
  const double s = camera.f / z;
  const double probability =
      inside(x, {s, 0, -s * p.x() / z}, camera.width) * inside(y, {0, s, -s * p.y() / z}, camera.height);
  const int column = static_cast<int>(std::clamp(x / camera.width, 0.0, 0.999) * ViewSketch::kColumns);
  const int row = static_cast<int>(std::clamp(y / camera.height, 0.0, 0.999) * ViewSketch::kRows);
  const double farthest = a.depth[static_cast<size_t>(row * ViewSketch::kColumns + column)];
  if (farthest > 0 && z - 3 * sigma_z > kHidden * farthest) return 0;
  return probability * std::min(1.0, (sight - kLeastView) / (kFullView - kLeastView));
}

// Mean of seen() over the points of b.
double seen_part(const ViewSketch& a, const ViewSketch& b, const Pose& a_from_b, const Matrix6d& covariance,
                 const RectifiedCamera& camera, bool at_best) {
  const auto& points = b.points_in_cam;
  const auto sum_of = [&](size_t stride) {
    double sum = 0;
    for (size_t k = 0; k < points.size(); k += stride) {
      sum += seen(a, points[k].cast<double>(), a_from_b, covariance, camera, at_best);
    }
    return sum;
  };
  // Most pairs see nothing of each other, as a few of the points tell.
  return sum_of(5) == 0 ? 0 : sum_of(1) / static_cast<double>(points.size());
}

// The best few of one view's partners, none within `gap` views of a better one.
struct Partner {
  int view = 0;
  double score = 0;
};
std::vector<Partner> best_apart(std::vector<Partner> all, int count, int gap) {
  std::sort(all.begin(), all.end(), [](const Partner& a, const Partner& b) {
    return a.score != b.score ? a.score > b.score : a.view < b.view;
  });
  std::vector<Partner> kept;
  for (const Partner& p : all) {
    if (static_cast<int>(kept.size()) == count) break;
    const auto close = [&](const Partner& k) { return std::abs(k.view - p.view) <= gap; };
    if (std::none_of(kept.begin(), kept.end(), close)) kept.push_back(p);
  }
  return kept;
}

// Candidates from each view's partners, each pair once, ordered.
std::vector<Candidate> pairs_of(const std::vector<std::vector<Partner>>& partners, const std::vector<ViewSketch>& views,
                                Candidate::Source source) {
  std::map<std::pair<int, int>, double> pairs;
  for (size_t v = 0; v < partners.size(); ++v) {
    for (const Partner& p : partners[v]) {
      const auto [i, j] = std::minmax(views[v].frame_idx, views[p.view].frame_idx);
      double& score = pairs[{i, j}];
      score = std::max(score, p.score);
    }
  }
  std::vector<Candidate> candidates;
  for (const auto& [pair, score] : pairs) candidates.push_back({pair.first, pair.second, score, source});
  return candidates;
}

// Centres of what views see, in cubes.
class PlaceHash {
 public:
  PlaceHash(const std::vector<Eigen::Vector3d>& centres, double cell) : centres_(centres), cell_(cell) {
    for (int v = 0; v < static_cast<int>(centres.size()); ++v) cells_[key_of(cell_of(centres[v]))].push_back(v);
  }

  // Views before `end` whose centre is within `radius`, ascending; at most `most`, evenly taken.
  std::vector<int> near(int view, double radius, int end, size_t most) const {
    std::vector<int> found;
    const auto take = [&](const std::vector<int>& cell) {
      for (const int v : cell)
        if (v < end && (centres_[v] - centres_[view]).squaredNorm() <= radius * radius) found.push_back(v);
    };
    const Eigen::Vector3d r = Eigen::Vector3d::Constant(radius);
    const Cell low = cell_of(centres_[view] - r), high = cell_of(centres_[view] + r);
    double volume = 1;
    for (int a = 0; a < 3; ++a) volume *= static_cast<double>(high[a] - low[a] + 1);
    if (volume < static_cast<double>(cells_.size())) {
      for (int64_t x = low[0]; x <= high[0]; ++x)
        for (int64_t y = low[1]; y <= high[1]; ++y)
          for (int64_t z = low[2]; z <= high[2]; ++z)
            if (const auto cell = cells_.find(key_of({x, y, z})); cell != cells_.end()) take(cell->second);
    } else {
      for (const auto& [key, cell] : cells_) take(cell);
    }
    std::sort(found.begin(), found.end());
    if (found.size() <= most) return found;
    std::vector<int> thinned;
    for (size_t k = 0; k < most; ++k) thinned.push_back(found[k * found.size() / most]);
    return thinned;
  }

 private:
  using Cell = std::array<int64_t, 3>;
  Cell cell_of(const Eigen::Vector3d& p) const {
    Cell cell;
    for (int a = 0; a < 3; ++a) cell[a] = static_cast<int64_t>(std::floor(std::clamp(p[a] / cell_, -1e6, 1e6)));
    return cell;
  }
  static uint64_t key_of(const Cell& c) {  // 21 bits each
    uint64_t key = 0;
    for (const int64_t v : c) key = key << 21 | static_cast<uint64_t>(v + (1 << 20));
    return key;
  }
  const std::vector<Eigen::Vector3d>& centres_;
  double cell_;
  std::unordered_map<uint64_t, std::vector<int>> cells_;
};

}  // namespace

ViewSketch sketch(int frame_idx, const motion::ViewFeatures& features, const RectifiedCamera& camera) {
  ViewSketch result{.frame_idx = frame_idx, .points_in_cam = {}, .depth = {}};
  const size_t corners = features.corners.size(), count = std::min<size_t>(kPoints, corners);
  // Corners are ordered by the cells of a grid over the image.
  for (size_t k = 0; k < count; ++k) {
    result.points_in_cam.push_back(features.corners[k * corners / count].point_in_cam.cast<float>());
  }
  constexpr int kStep = 4;  // [px]
  std::vector<float> least(static_cast<size_t>(ViewSketch::kColumns * ViewSketch::kRows), 0.0f);
  const int width = features.image.cols, height = features.image.rows;
  for (int y = kStep / 2; y < height; y += kStep) {
    for (int x = kStep / 2; x < width; x += kStep) {
      const float d = features.disparity.at(y, x, DisparityOrigin::corrected);
      if (!(d > 0)) continue;
      float& cell = least[static_cast<size_t>(y * ViewSketch::kRows / height * ViewSketch::kColumns +
                                              x * ViewSketch::kColumns / width)];
      if (cell == 0 || d < cell) cell = d;
    }
  }
  for (const float d : least) {
    const double true_disparity = d + camera.disparity_offset;
    result.depth.push_back(d > 0 && true_disparity > 0 ? static_cast<float>(camera.f * camera.baseline / true_disparity)
                                                       : 0.0f);
  }
  return result;
}

double expected_overlap(const ViewSketch& i, const ViewSketch& j, const RelativePose& relative,
                        const RectifiedCamera& camera, bool at_best) {
  if (i.points_in_cam.empty() || j.points_in_cam.empty()) return 0;
  const double first = seen_part(i, j, relative.i_from_j, relative.covariance, camera, at_best);
  if (first == 0) return 0;
  const Pose j_from_i = relative.i_from_j.inverse();
  const Matrix6d to_j = adjoint(j_from_i);
  return std::min(first, seen_part(j, i, j_from_i, to_j * relative.covariance * to_j.transpose(), camera, at_best));
}

std::vector<Candidate> overlap_candidates(const std::vector<ViewSketch>& views, const Odometry& odometry,
                                          const RectifiedCamera& camera, const LoopOptions& options) {
  constexpr size_t kMost = 120;  // places near a view that are looked at
  const int n = static_cast<int>(views.size());
  if (options.overlap_candidates == 0) return {};
  std::vector<Eigen::Vector3d> centres(views.size(), Eigen::Vector3d::Zero());
  std::vector<double> radii(views.size(), 0), errors(views.size(), 0);
  for (int v = 0; v < n; ++v) {
    if (views[v].points_in_cam.empty()) continue;
    const Pose& pose = odometry.node(views[v].frame_idx).world_from_cam;
    for (const Eigen::Vector3f& p : views[v].points_in_cam) centres[v] += p.cast<double>();
    centres[v] /= static_cast<double>(views[v].points_in_cam.size());
    for (const Eigen::Vector3f& p : views[v].points_in_cam) {
      radii[v] += (p.cast<double>() - centres[v]).squaredNorm() / static_cast<double>(views[v].points_in_cam.size());
    }
    radii[v] = std::sqrt(radii[v]);
    centres[v] = pose * centres[v];
    errors[v] = odometry.position_error(views[v].frame_idx);
  }
  std::vector<double> sorted = radii;
  std::sort(sorted.begin(), sorted.end());
  const double usual = n > 0 ? std::max(0.1, sorted[sorted.size() / 2]) : 1,
               large = n > 0 ? sorted[sorted.size() * 9 / 10] : 1;
  const PlaceHash places(centres, 2 * usual);
  std::vector<std::vector<Partner>> partners(views.size());
  parallel_chunks(0, n, 16, [&](int from, int to) {
    for (int v = from; v < to; ++v) {
      if (views[v].points_in_cam.empty()) continue;
      const double radius = radii[v] + large + 3 * errors[v];
      std::vector<Partner> all;
      for (const int other : places.near(v, radius, v - options.min_gap + 1, kMost)) {
        const auto relative = odometry.between(views[other].frame_idx, views[v].frame_idx);
        if (!relative) continue;
        const double overlap = expected_overlap(views[other], views[v], *relative, camera);
        if (overlap >= options.min_overlap) all.push_back({other, overlap});
      }
      partners[v] = best_apart(std::move(all), options.overlap_candidates, options.min_gap / 4);
    }
  });
  return pairs_of(partners, views, Candidate::Source::overlap);
}

std::vector<Candidate> appearance_candidates(const ViewIndex& index, const std::vector<ViewSketch>& views,
                                             const Odometry& odometry, const RectifiedCamera& camera,
                                             const LoopOptions& options) {
  constexpr int kLooked = 20;        // times as many answers are looked at as are taken
  constexpr double kExcluded = 0.5;  // times loop.min_overlap: what poses can at best make of it
  const int n = static_cast<int>(views.size());
  if (options.appearance_candidates == 0) return {};
  std::vector<std::vector<Partner>> partners(views.size());
  parallel_chunks(0, n, 8, [&](int from, int to) {
    for (int v = from; v < to; ++v) {
      const double usual = std::max(v > 0 ? index.score(v, v - 1) : 0.0, v + 1 < n ? index.score(v, v + 1) : 0.0);
      std::vector<Partner> all;
      for (const ScoredView& found : index.query(v, kLooked * options.appearance_candidates)) {
        if (!(found.score >= options.min_similarity * usual)) break;
        const auto relative =
            odometry.between(views[std::min(v, found.index)].frame_idx, views[std::max(v, found.index)].frame_idx);
        if (relative) {
          if (std::abs(v - found.index) < options.min_gap) continue;
          const double overlap = expected_overlap(views[std::min(v, found.index)], views[std::max(v, found.index)],
                                                  *relative, camera, /*at_best=*/true);
          if (overlap < kExcluded * options.min_overlap) continue;
        }
        all.push_back({found.index, std::min(1.0, found.score)});
      }
      partners[v] = best_apart(std::move(all), options.appearance_candidates, options.min_gap / 4);
    }
  });
  return pairs_of(partners, views, Candidate::Source::appearance);
}

}  // namespace iris::loop
