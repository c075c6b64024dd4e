#include "iris/tour/scene.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "iris/core/median.h"
#include "iris/tour/frames.h"

namespace iris::tour {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

// Views of a sub-map that have disparities: at most `most`, evenly chosen.
std::vector<int> some_views(const views::ViewStore& store, int submap, size_t most) {
  std::vector<int> views;
  for (size_t i = 0; i < store.summaries().size(); ++i) {
    const views::ViewSummary& view = store.summaries()[i];
    if (view.submap == submap && view.max_disparity > 0) views.push_back(static_cast<int>(i));
  }
  const size_t count = std::min(views.size(), most);
  std::vector<int> chosen;
  for (size_t k = 0; k < count; ++k) chosen.push_back(views[k * views.size() / count]);
  return chosen;
}

// A view with every 8th pixel of its disparities.
struct Look {
  RectifiedCamera camera;
  Pose world_from_cam = Pose::Identity();
  cv::Mat1f disparity;
};
constexpr int kStep = 8;  // [px]

// Disparity and depth agree up to this part, and so do neighbours of the point.
constexpr double kHidden = 0.85;

bool looks_at(const Look& look, const Vector3d& point) {
  const Vector3d in_cam = look.world_from_cam.inverse() * point;
  if (in_cam.z() <= 0) return false;
  const Vector3d pixel = look.camera.project(in_cam);
  const double x = pixel.x() / look.camera.width, y = pixel.y() / look.camera.height;
  if (x < 0.25 || x > 0.75 || y < 0.25 || y > 0.75) return false;
  const int column = std::min(static_cast<int>(pixel.x()) / kStep, look.disparity.cols - 1);
  const int row = std::min(static_cast<int>(pixel.y()) / kStep, look.disparity.rows - 1);
  const double there = look.disparity(row, column);
  return there > 0 && pixel.z() >= kHidden * there;
}

}  // namespace

double scene_depth(const views::ViewStore& store, int submap) {
  constexpr size_t kViews = 16;
  std::vector<double> depths;
  for (const int index : some_views(store, submap, kViews)) {
    const auto view = store.load(index);
    const cv::Mat1f& disparity = view->disparity.disparity;
    for (int y = kStep / 2; y < disparity.rows; y += kStep) {
      for (int x = kStep / 2; x < disparity.cols; x += kStep) {
        const double d = disparity(y, x) + view->camera.disparity_offset;
        if (disparity(y, x) > 0 && d > 0) depths.push_back(view->camera.f * view->camera.baseline / d);
      }
    }
  }
  return depths.empty() ? 0 : median(depths);
}

std::optional<LookedAt> most_looked_at(const views::ViewStore& store, int submap) {
  constexpr size_t kViews = 64;
  std::vector<Look> looks;
  std::vector<Vector3d> candidates;
  for (const int index : some_views(store, submap, kViews)) {
    const auto view = store.load(index);
    const cv::Mat1f& all = view->disparity.disparity;
    Look look{view->camera, view->world_from_cam, cv::Mat1f(all.rows / kStep, all.cols / kStep)};
    std::vector<double> middle;
    for (int y = 0; y < look.disparity.rows; ++y) {
      for (int x = 0; x < look.disparity.cols; ++x) {
        look.disparity(y, x) = all(y * kStep + kStep / 2, x * kStep + kStep / 2);
        const bool inside = std::abs(x - look.disparity.cols / 2) <= look.disparity.cols / 8 &&
                            std::abs(y - look.disparity.rows / 2) <= look.disparity.rows / 8;
        if (inside && look.disparity(y, x) > 0) middle.push_back(look.disparity(y, x));
      }
    }
    if (!middle.empty()) {
      const Vector3d point = look.camera.point(look.camera.cx, look.camera.cy, median(middle));
      if (point.allFinite()) candidates.push_back(look.world_from_cam * point);
    }
    looks.push_back(std::move(look));
  }
  std::optional<LookedAt> best;
  for (const Vector3d& candidate : candidates) {
    std::vector<double> distances;
    for (const Look& look : looks) {
      if (looks_at(look, candidate)) distances.push_back((look.world_from_cam.translation() - candidate).norm());
    }
    const int count = static_cast<int>(distances.size());
    if (count > 0 && (!best || count > best->views)) best = {candidate, median(distances), count};
  }
  return best;
}

double free_radius(const FreeSpace& space, const Vector2d& centre, double radius) {
  double best = radius;
  int least = -1;
  for (double r = radius; r >= radius / 3; r -= space.cell()) {
    constexpr int kDirections = 72;
    int blocked = 0;
    for (int i = 0; i < kDirections; ++i) {
      const double angle = 2 * std::numbers::pi * i / kDirections;
      if (!space.free(centre + r * Vector2d(std::cos(angle), std::sin(angle)))) ++blocked;
    }
    if (least < 0 || blocked < least) least = blocked, best = r;
  }
  return best;
}

Standing standing(const FreeSpace& space, const CameraPath& path, const TourOptions& options) {
  Standing result;
  for (int i = 0; i < frame_count(path, options); ++i) {
    const Pose pose = sample(path, eased_time(path, i / options.fps)).world_from_cam;
    if (space.free(pose.translation().head<2>())) continue;
    if (result.blocked++ == 0) result.first = i;
  }
  return result;
}

}  // namespace iris::tour
