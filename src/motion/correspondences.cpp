#include "iris/motion/correspondences.h"

#include <algorithm>
#include <cmath>

#include "corner_kernels.h"
#include "iris/motion/corner_disparity.h"
#include "iris/motion/track.h"

namespace iris::motion {
namespace {

// [px] Where corners move by less, exposures that are shorter than the time between the views by far blur nothing that
// matters.
constexpr double kNoBlur = 10;

}  // namespace

RankPatch turned(const RankPatch& patch) {
  RankPatch result{};
  for (int row = 0; row < kPatchSize; ++row)
    for (int column = 0; column < kPatchSize; ++column)
      result[row * kPatchSize + column] = patch[(kPatchSize - 1 - column) * kPatchSize + row];
  return result;
}

std::vector<std::pair<int, int>> match_corners(const ViewFeatures& prev, const ViewFeatures& cur) {
  const NearestPatches nearest = nearest_patches(prev.patches, cur.patches);
  std::vector<std::pair<int, int>> matches;
  for (int i = 0; i < static_cast<int>(nearest.of_a.size()); ++i) {
    const int j = nearest.of_a[i].index;
    if (j >= 0 && nearest.of_b[j].index == i) matches.emplace_back(i, j);
  }
  return matches;
}

std::optional<Correspondence> refined_match(int prev_corner, int cur_corner, const Eigen::Matrix2d& cur_from_prev,
                                            const ViewFeatures& prev, const ViewFeatures& cur,
                                            const RectifiedCamera& camera, const ScsOptions& options) {
  const Corner &from = prev.corners[prev_corner], &start = cur.corners[cur_corner];
  const Eigen::Vector2d at(start.x, start.y);
  const PatchTrack track = track_patch(prev.image, {from.x, from.y}, cur.image, at, cur_from_prev);
  if (!track.found) return std::nullopt;
  const double disparity = usable_disparity(cur.disparity, track.position.x(), track.position.y(), camera, options);
  if (disparity == 0) return std::nullopt;
  return Correspondence{.prev_corner = prev_corner,
                        .cur_corner = cur_corner,
                        .prev_point = from.point_in_cam,
                        .cur_point = camera.point(track.position.x(), track.position.y(), disparity),
                        .moved = (track.position - at).norm()};
}

std::vector<Correspondence> refine_matches(const std::vector<std::pair<int, int>>& matches, const ViewFeatures& prev,
                                           const ViewFeatures& cur, const RectifiedCamera& camera,
                                           const ScsOptions& options) {
  std::vector<Correspondence> result;
  for (const auto& [i, j] : matches) {
    if (const auto match = refined_match(i, j, Eigen::Matrix2d::Identity(), prev, cur, camera, options)) {
      result.push_back(*match);
    }
  }
  return result;
}

std::vector<Correspondence> predicted_matches(const ViewFeatures& prev, const ViewFeatures& cur,
                                              const Pose& prev_from_cur, const RectifiedCamera& camera,
                                              const ScsOptions& options, int most_corners) {
  const Pose cur_from_prev = prev_from_cur.inverse();
  std::vector<Correspondence> result;
  const int all = static_cast<int>(prev.corners.size());
  const int count = most_corners > 0 ? std::min(most_corners, all) : all;
  for (int i = 0; i < count; ++i) {
    const Corner& corner = prev.corners[i];
    const Eigen::Vector3d q = cur_from_prev * corner.point_in_cam;
    if (!(q.z() > 0)) continue;
    const Eigen::Vector3d expected = camera.project(q);
    const Eigen::Vector2d predicted = expected.head<2>();
    const Eigen::Matrix3d warp = plane_warp(camera, corner, cur_from_prev);
    const TrackedSurface surface = corner_surface(prev.disparity, corner);
    // Both images are blurred about along the way that the corner took, but not alike.
    Eigen::Vector2d blur = predicted - Eigen::Vector2d(corner.x, corner.y);
    if (blur.norm() < kNoBlur) blur.setZero();
    const PatchTrack track = track_patch(prev.image, {corner.x, corner.y}, cur.image, predicted, warp, surface, blur);
    if (!track.found || track.similarity < options.min_similarity) continue;
    const double moved = (track.position - predicted).norm();
    if (moved > options.max_refinement) continue;
    double disparity = usable_disparity(cur.disparity, track.position.x(), track.position.y(), camera, options);
    if (disparity == 0 || std::abs(disparity - expected.z()) > options.max_refinement) continue;
    Correspondence found{.prev_corner = i, .cur_corner = -1, .prev_point = corner.point_in_cam, .moved = moved};
    if (corner.disparity_error > 0 && !cur.right.empty()) {
      // The same surroundings once more in the right image.
      Pose right_from_prev = cur_from_prev;
      right_from_prev.translation().x() -= camera.baseline;
      const Eigen::Vector2d start(track.position.x() - disparity, track.position.y());
      const PatchTrack right = track_along_row(prev.image, {corner.x, corner.y}, cur.right, start,
                                               plane_warp(camera, corner, right_from_prev), surface, blur);
      if (right.found && std::abs(right.position.x() - start.x()) <= kMaxCorrection) {
        disparity = track.position.x() - right.position.x();
        found.left_covariance = position_covariance(track);
        found.right_variance = (position_covariance(right)(0, 0) + corner.disparity_error * corner.disparity_error) / 2;
      }
    }
    found.cur_point = camera.point(track.position.x(), track.position.y(), disparity);
    result.push_back(found);
  }
  return result;
}

}  // namespace iris::motion
