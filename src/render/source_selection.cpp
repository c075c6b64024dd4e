#include "iris/render/source_selection.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

namespace iris::render {
namespace {

using Eigen::Vector3d;

// Depths [m] between which a view has surfaces.
struct Range {
  double nearest, farthest;
};

Range range_of(const views::ViewSummary& view) {
  const double ft = view.camera.f * view.camera.baseline, offset = view.camera.disparity_offset;
  return {ft / std::max(view.max_disparity + offset, 0.01), ft / std::max(view.min_disparity + offset, 0.01)};
}

bool cuts(const Vector3d& from, const Vector3d& to, const Vector3d& a, const Vector3d& b, const Vector3d& c) {
  // Möller and Trumbore: barycentric coordinates of the intersection with the triangle's plane.
  const Vector3d direction = to - from, ab = b - a, ac = c - a;
  const Vector3d p = direction.cross(ac);
  const double determinant = ab.dot(p);
  if (std::abs(determinant) < 1e-12 * ab.norm() * ac.norm() * direction.norm()) return false;  // parallel
  const Vector3d r = from - a;
  const double u = r.dot(p) / determinant;
  if (u < 0 || u > 1) return false;
  const Vector3d q = r.cross(ab);
  const double v = direction.dot(q) / determinant;
  if (v < 0 || u + v > 1) return false;
  const double s = ac.dot(q) / determinant;
  return s >= 0 && s <= 1;
}

bool edges_cut(const Frustum& a, const Frustum& b) {
  for (const auto& edge : a.edges) {
    for (const auto& triangle : b.triangles) {
      if (cuts(a.corners[static_cast<size_t>(edge[0])], a.corners[static_cast<size_t>(edge[1])],
               b.corners[static_cast<size_t>(triangle[0])], b.corners[static_cast<size_t>(triangle[1])],
               b.corners[static_cast<size_t>(triangle[2])])) {
        return true;
      }
    }
  }
  return false;
}

Vector3d centre(const Frustum& body) {
  Vector3d sum = Vector3d::Zero();
  for (const Vector3d& corner : body.corners) sum += corner;
  return sum / static_cast<double>(body.corners.size());
}

// A point lies in a convex body if it is on the same side of every face as the body's centre.
bool contains(const Frustum& body, const Vector3d& point) {
  const Vector3d middle = centre(body);
  for (const auto& triangle : body.triangles) {
    const Vector3d& a = body.corners[static_cast<size_t>(triangle[0])];
    const Vector3d normal =
        (body.corners[static_cast<size_t>(triangle[1])] - a).cross(body.corners[static_cast<size_t>(triangle[2])] - a);
    if (normal.dot(point - a) * normal.dot(middle - a) < 0) return false;
  }
  return true;
}

// The points by which the usefulness of views is judged: rays over the novel picture, each at some depths.
struct Probes {
  static constexpr int kColumns = 12, kRows = 9, kDepths = 4;
  static constexpr size_t kCount = kColumns * kRows * kDepths;
  std::array<float, kCount> x, y, z;                    // [m] relative to the novel camera
  std::array<float, kCount> sight_x, sight_y, sight_z;  // unit direction of sight from the novel camera
  std::array<float, kCount> range;                      // [m] from the novel camera
};

Probes probes(const NovelCamera& camera, double nearest, double farthest) {
  Probes all;
  size_t i = 0;
  for (int row = 0; row < Probes::kRows; ++row) {
    for (int column = 0; column < Probes::kColumns; ++column) {
      const Vector3d sight =
          camera.world_from_cam.linear() * pixel_ray(camera, (column + 0.5) / Probes::kColumns * camera.width - 0.5,
                                                     (row + 0.5) / Probes::kRows * camera.height - 0.5)
                                               .normalized();
      for (int k = 0; k < Probes::kDepths; ++k, ++i) {
        const double range = nearest * std::pow(farthest / nearest, (k + 0.5) / Probes::kDepths);
        const Eigen::Vector3f s = sight.cast<float>(), p = (range * sight).cast<float>();
        all.x[i] = p.x(), all.y[i] = p.y(), all.z[i] = p.z();
        all.sight_x[i] = s.x(), all.sight_y[i] = s.y(), all.sight_z[i] = s.z();
        all.range[i] = static_cast<float>(range);
      }
    }
  }
  return all;
}

using Visibilities = std::array<float, Probes::kCount>;

// Probes at what is missing of a picture: one ray for each part of it, through the middle of its holes. `weights`: part
// of the picture that is missing there.
Probes hole_probes(const NovelCamera& camera, const NovelView& picture, int step, Visibilities& weights) {
  constexpr float kNearer = 0.7f, kFarther = 1.5f;  // of the depths beside the hole
  const cv::Mat1s& source = picture.source;
  Probes all{};
  weights.fill(0);
  for (int part = 0; part < Probes::kColumns * Probes::kRows; ++part) {
    const int row = part / Probes::kColumns, column = part % Probes::kColumns;
    const int x0 = column * source.cols / Probes::kColumns, x1 = (column + 1) * source.cols / Probes::kColumns;
    const int y0 = row * source.rows / Probes::kRows, y1 = (row + 1) * source.rows / Probes::kRows;
    cv::Point2d sum(0, 0);
    int holes = 0;
    for (int y = y0; y < y1; ++y) {
      for (int x = x0; x < x1; ++x) {
        if (source(y, x) < 0) sum += cv::Point2d(x, y), ++holes;
      }
    }
    if (holes == 0) continue;
    const cv::Point2d middle = sum / holes;
    cv::Point at(x0, y0);
    double least = 1e30;
    for (int y = y0; y < y1; ++y) {
      for (int x = x0; x < x1; ++x) {
        const cv::Point2d off = cv::Point2d(x, y) - middle;
        if (source(y, x) < 0 && off.dot(off) < least) least = off.dot(off), at = {x, y};
      }
    }
    float near = 1e30f, far = 0;
    for (const auto& [dx, dy] : {std::pair{-1, 0}, {1, 0}, {0, -1}, {0, 1}}) {
      for (cv::Point p = at; p.x >= 0 && p.y >= 0 && p.x < source.cols && p.y < source.rows; p += cv::Point(dx, dy)) {
        if (source(p) < 0) continue;
        near = std::min(near, picture.depth(p)), far = std::max(far, picture.depth(p));
        break;
      }
    }
    if (far <= 0) continue;
    const Vector3d ray = camera.world_from_cam.linear() * pixel_ray(camera, at.x * step, at.y * step);
    const Eigen::Vector3f sight = ray.normalized().cast<float>();
    const auto length = static_cast<float>(ray.norm());
    for (int k = 0; k < Probes::kDepths; ++k) {
      const auto i = static_cast<size_t>(part * Probes::kDepths + k);
      const float spread = kFarther * far / (kNearer * near);
      const float range = length * kNearer * near * std::pow(spread, (static_cast<float>(k) + 0.5f) / Probes::kDepths);
      all.x[i] = range * sight.x(), all.y[i] = range * sight.y(), all.z[i] = range * sight.z();
      all.sight_x[i] = sight.x(), all.sight_y[i] = sight.y(), all.sight_z[i] = sight.z();
      all.range[i] = range;
      weights[i] = static_cast<float>(holes) / static_cast<float>(source.total()) / Probes::kDepths;
    }
  }
  return all;
}

// How well a view shows each point, in [0, 1]: 0 = not in its image or outside its depth range; less when seen from
// another direction (what an error of the disparity shifts in the novel picture is proportional to the sine of the
// angle between both lines of sight; half the worth at kSine), and less when seen from farther away than the novel
// camera does (coarser pixels, less precise disparity). No branches: thousands of views are judged for a picture.
void judge(const NovelCamera& camera, const views::ViewSummary& view, const Range& range, const Probes& probes,
           Visibilities& values) {
  // 2 degrees: the best of 0.015 to 0.3 for the recordings of docs/views.md together.
  constexpr float kSine = 0.03f;
  const Pose cam_from_world = view.world_from_cam.inverse();
  const Eigen::Matrix3f r = cam_from_world.linear().cast<float>();
  const Eigen::Vector3f t = (cam_from_world * camera.world_from_cam.translation()).cast<float>();
  const Eigen::Vector3f to_view =
      (view.world_from_cam.translation() - camera.world_from_cam.translation()).cast<float>();
  const auto nearest = static_cast<float>(0.7 * range.nearest), farthest = static_cast<float>(1.5 * range.farthest);
  const auto f = static_cast<float>(view.camera.f), cx = static_cast<float>(view.camera.cx),
             cy = static_cast<float>(view.camera.cy);
  const auto right = static_cast<float>(view.camera.width - 1) - cx,
             bottom = static_cast<float>(view.camera.height - 1) - cy;
  for (size_t i = 0; i < Probes::kCount; ++i) {
    const float px = probes.x[i], py = probes.y[i], pz = probes.z[i];
    const float x = f * (r(0, 0) * px + r(0, 1) * py + r(0, 2) * pz + t.x());
    const float y = f * (r(1, 0) * px + r(1, 1) * py + r(1, 2) * pz + t.y());
    const float z = r(2, 0) * px + r(2, 1) * py + r(2, 2) * pz + t.z();
    const float dx = px - to_view.x(), dy = py - to_view.y(), dz = pz - to_view.z();
    const float square = dx * dx + dy * dy + dz * dz;
    const float along = dx * probes.sight_x[i] + dy * probes.sight_y[i] + dz * probes.sight_z[i];
    const bool seen = (z >= nearest) & (z <= farthest) & (x >= -cx * z) & (y >= -cy * z) & (x <= right * z) &
                      (y <= bottom * z) & (along > 0);
    const float cosine2 = along * along / square;
    const float sine = std::sqrt(std::max(0.0f, 1 - cosine2));
    const float sharpness = std::sqrt(std::min(1.0f, probes.range[i] * probes.range[i] / square));
    values[i] = seen ? kSine / (kSine + sine) * sharpness : 0.0f;
  }
}

// Axis-parallel bounds of a body.
struct Box {
  explicit Box(const Frustum& body) {
    for (const Vector3d& corner : body.corners) low = low.cwiseMin(corner), high = high.cwiseMax(corner);
  }
  bool meets(const Box& other) const {
    return (low.array() <= other.high.array()).all() && (other.low.array() <= high.array()).all();
  }
  Vector3d low = Vector3d::Constant(1e30), high = Vector3d::Constant(-1e30);
};

}  // namespace

int select_for_holes(const NovelCamera& camera, const NovelView& picture, int step,
                     const std::vector<views::ViewSummary>& views, const std::vector<int>& used) {
  constexpr float kSine = 0.1f;        // a view that looks along the line of one that shows nothing: half its worth
  constexpr float kLeastGain = 1e-2f;  // of the picture
  Visibilities weights;
  const Probes all = hole_probes(camera, picture, step, weights);
  std::vector<uint8_t> is_used(views.size(), 0);
  std::vector<Visibilities> blind(used.size());
  for (size_t k = 0; k < used.size(); ++k) {
    const views::ViewSummary& view = views[static_cast<size_t>(used[k])];
    is_used[static_cast<size_t>(used[k])] = 1;
    judge(camera, view, range_of(view), all, blind[k]);
  }
  std::vector<float> gains(views.size(), 0.0f), seen_parts(views.size(), 0.0f);
  constexpr int kGrain = 64;
  parallel_chunks(0, static_cast<int>(views.size()), kGrain, [&](int begin, int end) {
    Visibilities seen;
    for (int c = begin; c < end; ++c) {
      const auto i = static_cast<size_t>(c);
      const views::ViewSummary& view = views[i];
      if (is_used[i] || view.max_disparity <= 0) continue;
      judge(camera, view, range_of(view), all, seen);
      const Eigen::Vector3f place =
          (view.world_from_cam.translation() - camera.world_from_cam.translation()).cast<float>();
      for (size_t p = 0; p < Probes::kCount; ++p) {
        if (weights[p] * seen[p] <= 0) continue;
        const Eigen::Vector3f point(all.x[p], all.y[p], all.z[p]);
        const Eigen::Vector3f line = (point - place).normalized();
        float worth = 1;
        for (size_t k = 0; k < used.size(); ++k) {
          if (blind[k][p] <= 0) continue;
          const Eigen::Vector3f other = point - (views[static_cast<size_t>(used[k])].world_from_cam.translation() -
                                                 camera.world_from_cam.translation())
                                                    .cast<float>();
          const float sine = line.cross(other).norm() / other.norm();
          worth = std::min(worth, sine / (kSine + sine));
        }
        gains[i] += weights[p] * seen[p] * worth;
        seen_parts[i] += weights[p] * worth;
      }
    }
  });
  const auto best = std::max_element(gains.begin(), gains.end()) - gains.begin();
  return gains.empty() || seen_parts[static_cast<size_t>(best)] < kLeastGain ? -1 : static_cast<int>(best);
}

NovelView render_from_views(const NovelCamera& camera, const std::vector<views::ViewSummary>& views,
                            const std::function<std::shared_ptr<const PreparedSource>(int view)>& prepare,
                            const DsnvOptions& options) {
  std::vector<int> used = select_sources(camera, views, options);
  std::vector<std::shared_ptr<const PreparedSource>> sources;
  for (const int view : used) sources.push_back(prepare(view));
  return render_novel_view(camera, sources, options,
                           [&](const NovelView& so_far) -> std::shared_ptr<const PreparedSource> {
                             const int next = select_for_holes(camera, so_far, options.step, views, used);
                             if (next < 0) return nullptr;
                             used.push_back(next);
                             return prepare(next);
                           });
}

Frustum source_frustum(const views::ViewSummary& view) {
  IRIS_CHECK(view.max_disparity > 0);
  const Range range = range_of(view);
  Frustum body;
  for (const double depth : {range.nearest, std::max(range.farthest, 1.001 * range.nearest)}) {
    for (const auto& [x, y] : {std::pair{-0.5, -0.5},
                               {view.camera.width - 0.5, -0.5},
                               {view.camera.width - 0.5, view.camera.height - 0.5},
                               {-0.5, view.camera.height - 0.5}}) {
      body.corners.push_back(view.world_from_cam * (depth * Vector3d((x - view.camera.cx) / view.camera.f,
                                                                     (y - view.camera.cy) / view.camera.f, 1)));
    }
  }
  for (int i = 0; i < 4; ++i) {
    const int j = (i + 1) % 4;
    body.edges.insert(body.edges.end(), {{i, j}, {i + 4, j + 4}, {i, i + 4}});
    body.triangles.insert(body.triangles.end(), {{i, j, j + 4}, {i, j + 4, i + 4}});
  }
  body.triangles.insert(body.triangles.end(), {{0, 1, 2}, {0, 2, 3}, {4, 5, 6}, {4, 6, 7}});
  return body;
}

Frustum novel_frustum(const NovelCamera& camera, double farthest) {
  IRIS_CHECK(camera.projection == Projection::pinhole && farthest > 0);
  Frustum body;
  body.corners.push_back(camera.world_from_cam.translation());
  for (const auto& [x, y] : {std::pair{-0.5, -0.5},
                             {camera.width - 0.5, -0.5},
                             {camera.width - 0.5, camera.height - 0.5},
                             {-0.5, camera.height - 0.5}}) {
    body.corners.push_back(camera.world_from_cam * (farthest * pixel_ray(camera, x, y)));
  }
  for (int i = 1; i <= 4; ++i) {
    const int j = i % 4 + 1;
    body.edges.insert(body.edges.end(), {{0, i}, {i, j}});
    body.triangles.push_back({0, i, j});
  }
  body.triangles.insert(body.triangles.end(), {{1, 2, 3}, {1, 3, 4}});
  return body;
}

bool overlap(const Frustum& a, const Frustum& b) {
  return contains(a, centre(b)) || contains(b, centre(a)) || edges_cut(a, b) || edges_cut(b, a) ||
         contains(a, b.corners[0]) || contains(b, a.corners[0]);
}

std::vector<int> select_sources(const NovelCamera& camera, const std::vector<views::ViewSummary>& views,
                                const DsnvOptions& options) {
  std::vector<int> candidates;
  double log_nearest = 0, log_farthest = 0;
  std::vector<uint8_t> qualifies(views.size(), 0);
  constexpr int kGrain = 64;
  parallel_chunks(0, static_cast<int>(views.size()), kGrain, [&](int begin, int end) {
    double reach = 0;  // of the novel camera [m]
    Frustum novel;
    for (int i = begin; i < end; ++i) {
      const views::ViewSummary& view = views[static_cast<size_t>(i)];
      if (view.max_disparity <= 0) continue;
      if (camera.projection == Projection::pinhole) {
        const double disparity_one = view.camera.f * view.camera.baseline;  // [m] the distance of disparity 1
        if (disparity_one != reach) reach = disparity_one, novel = novel_frustum(camera, reach);
        const Frustum source = source_frustum(view);
        if (!Box(source).meets(Box(novel)) || !overlap(source, novel)) continue;
      }
      qualifies[static_cast<size_t>(i)] = 1;
    }
  });
  for (size_t i = 0; i < views.size(); ++i) {
    if (!qualifies[i]) continue;
    candidates.push_back(static_cast<int>(i));
    const Range range = range_of(views[i]);
    log_nearest += std::log(range.nearest);
    log_farthest += std::log(range.farthest);
  }
  if (candidates.empty()) return {};
  const double count = static_cast<double>(candidates.size());
  const double nearest = std::exp(log_nearest / count), farthest = std::exp(log_farthest / count);
  const Probes all = probes(camera, nearest, std::max(farthest, 1.001 * nearest));

  std::vector<Visibilities> seen(candidates.size());
  parallel_chunks(0, static_cast<int>(candidates.size()), kGrain, [&](int begin, int end) {
    for (int c = begin; c < end; ++c) {
      const auto k = static_cast<size_t>(c);
      const views::ViewSummary& view = views[static_cast<size_t>(candidates[k])];
      judge(camera, view, range_of(view), all, seen[k]);
    }
  });
  // The gain of a further view at a point shrinks with how well the point is shown already. So coverage comes first
  // (a bad view of a point does not stand in for a good one), then agreement of several views.
  Visibilities share;  // 1 / (1 + sum of the visibilities of the chosen views)
  share.fill(1);
  Visibilities covered{};
  std::vector<float> gains(candidates.size());
  std::vector<int> chosen;
  while (static_cast<int>(chosen.size()) < options.max_sources) {
    parallel_chunks(0, static_cast<int>(candidates.size()), kGrain, [&](int begin, int end) {
      for (int c = begin; c < end; ++c) {
        const Visibilities& values = seen[static_cast<size_t>(c)];
        constexpr size_t kLanes = 8;  // partial sums, which do not wait for each other
        static_assert(Probes::kCount % kLanes == 0);
        std::array<float, kLanes> sums{};
        for (size_t p = 0; p < Probes::kCount; p += kLanes) {
          for (size_t k = 0; k < kLanes; ++k) sums[k] += values[p + k] * share[p + k];
        }
        gains[static_cast<size_t>(c)] = std::accumulate(sums.begin(), sums.end(), 0.0f);
      }
    });
    const auto best = std::max_element(gains.begin(), gains.end()) - gains.begin();
    const auto winner = static_cast<size_t>(best);
    if (gains[winner] <= 1e-6f) break;
    chosen.push_back(candidates[winner]);
    for (size_t p = 0; p < Probes::kCount; ++p) {
      covered[p] += seen[winner][p];
      share[p] = 1 / (1 + covered[p]);
    }
    seen[winner].fill(0);  // taken
  }
  return chosen;
}

}  // namespace iris::render
