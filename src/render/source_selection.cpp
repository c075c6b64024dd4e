#include "iris/render/source_selection.h"

#include <algorithm>
#include <cmath>

#include "iris/core/error.h"

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
struct Probe {
  Vector3d point;  // [m] world
  Vector3d sight;  // unit direction of sight from the novel camera
  double range;    // [m] from the novel camera
};

std::vector<Probe> probes(const NovelCamera& camera, double nearest, double farthest) {
  constexpr int kColumns = 12, kRows = 9, kDepths = 4;
  std::vector<Probe> all;
  for (int row = 0; row < kRows; ++row) {
    for (int column = 0; column < kColumns; ++column) {
      const Vector3d sight =
          camera.world_from_cam.linear() *
          pixel_ray(camera, (column + 0.5) / kColumns * camera.width - 0.5, (row + 0.5) / kRows * camera.height - 0.5)
              .normalized();
      for (int k = 0; k < kDepths; ++k) {
        const double range = nearest * std::pow(farthest / nearest, (k + 0.5) / kDepths);
        all.push_back({camera.world_from_cam.translation() + range * sight, sight, range});
      }
    }
  }
  return all;
}

// How well a view shows a point, in [0, 1]: 0 = not in its image or outside its depth range; less when seen from
// another direction, and less when seen from farther away than the novel camera does (coarser pixels, less precise
// disparity).
double visibility(const Pose& cam_from_world, const views::ViewSummary& view, const Range& range, const Probe& probe) {
  const Vector3d in_cam = cam_from_world * probe.point;
  if (in_cam.z() < 0.7 * range.nearest || in_cam.z() > 1.5 * range.farthest) return 0;
  const Vector3d pixel = view.camera.project(in_cam);
  if (pixel.x() < 0 || pixel.y() < 0 || pixel.x() > view.camera.width - 1 || pixel.y() > view.camera.height - 1)
    return 0;
  const double distance = in_cam.norm();
  const double cosine = (probe.point - view.world_from_cam.translation()).dot(probe.sight) / distance;
  if (cosine <= 0) return 0;
  const double sharpness = std::min(1.0, probe.range / distance);
  return cosine * cosine * sharpness;
}

}  // namespace

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
  for (size_t i = 0; i < views.size(); ++i) {
    const views::ViewSummary& view = views[i];
    if (view.max_disparity <= 0) continue;
    if (camera.projection == Projection::pinhole) {
      const double disparity_one = view.camera.f * view.camera.baseline;  // [m] the distance of disparity 1
      if (!overlap(source_frustum(view), novel_frustum(camera, disparity_one))) continue;
    }
    candidates.push_back(static_cast<int>(i));
    const Range range = range_of(view);
    log_nearest += std::log(range.nearest);
    log_farthest += std::log(range.farthest);
  }
  if (candidates.empty()) return {};
  const double count = static_cast<double>(candidates.size());
  const double nearest = std::exp(log_nearest / count), farthest = std::exp(log_farthest / count);
  const std::vector<Probe> all = probes(camera, nearest, std::max(farthest, 1.001 * nearest));

  std::vector<std::vector<float>> seen;  // [candidate][probe]
  for (const int index : candidates) {
    const views::ViewSummary& view = views[static_cast<size_t>(index)];
    const Pose cam_from_world = view.world_from_cam.inverse();
    const Range range = range_of(view);
    std::vector<float>& values = seen.emplace_back();
    for (const Probe& probe : all) values.push_back(static_cast<float>(visibility(cam_from_world, view, range, probe)));
  }
  // The gain of a further view at a point shrinks with what is chosen already: 1, 1/2, 1/3, … of its visibility. So
  // coverage comes first, then agreement of several views.
  std::vector<float> covered(all.size(), 0.0f);
  std::vector<bool> taken(candidates.size(), false);
  std::vector<int> chosen;
  while (static_cast<int>(chosen.size()) < options.max_sources) {
    int best = -1;
    double best_gain = 1e-6;
    for (size_t c = 0; c < candidates.size(); ++c) {
      if (taken[c]) continue;
      double gain = 0;
      for (size_t p = 0; p < all.size(); ++p) gain += seen[c][p] / (1 + covered[p]);
      if (gain > best_gain) best_gain = gain, best = static_cast<int>(c);
    }
    if (best < 0) break;
    const size_t winner = static_cast<size_t>(best);
    taken[winner] = true;
    chosen.push_back(candidates[winner]);
    for (size_t p = 0; p < all.size(); ++p) covered[p] += seen[winner][p] > 0 ? 1.0f : 0.0f;
  }
  return chosen;
}

}  // namespace iris::render
