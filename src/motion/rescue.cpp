#include "iris/motion/rescue.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <opencv2/features2d.hpp>

#include "iris/motion/track.h"

namespace iris::motion {
namespace {

// Pairs of keypoints that are each other's nearest in the space of descriptors, placed by their surroundings.
std::vector<Correspondence> keypoint_matches(const RescueFeatures& prev, const RescueFeatures& cur,
                                             const RectifiedCamera& camera, const ScsOptions& options) {
  std::vector<Correspondence> result;
  if (prev.keypoints.empty() || cur.keypoints.empty()) return result;
  std::vector<cv::DMatch> matches;
  cv::BFMatcher(cv::NORM_L2, /*crossCheck=*/true).match(prev.descriptors, cur.descriptors, matches);
  for (const cv::DMatch& match : matches) {
    const int i = match.queryIdx, j = match.trainIdx;
    const Corner &from = prev.keypoints[i], &start = cur.keypoints[j];
    const double scale = std::clamp(cur.sizes[j] / prev.sizes[i], 0.5, 2.0);
    const Eigen::Matrix2d warp = scale * Eigen::Rotation2Dd(cur.angles[j] - prev.angles[i]).toRotationMatrix();
    const Eigen::Vector2d at(start.x, start.y);
    const PatchTrack track = track_patch(prev.dense.image, {from.x, from.y}, cur.dense.image, at, warp);
    if (!track.found) continue;
    const Eigen::Vector2d& p = track.position;
    const double disparity = usable_disparity(cur.dense.disparity, p.x(), p.y(), camera, options);
    if (disparity == 0) continue;
    result.push_back({-1, -1, from.point_in_cam, camera.point(p.x(), p.y(), disparity), (p - at).norm()});
  }
  return result;
}

}  // namespace

RescueFeatures rescue_features(const ViewFeatures& view, const RectifiedCamera& camera, const ScsOptions& options) {
  constexpr int kMaxKeypoints = 3000;    // the strongest, before those without a disparity are dropped
  constexpr double kMinContrast = 0.01;  // a quarter of what SIFT asks for: weak texture must do
  ScsOptions more = options;
  more.max_corners = 4 * options.max_corners;
  more.min_strength = options.min_strength / 10;
  RescueFeatures result{.dense = extract_features(view.image, view.disparity, camera, more)};
  std::vector<cv::KeyPoint> found, usable;
  const auto sift = cv::SIFT::create(kMaxKeypoints, 3, kMinContrast);
  sift->detect(view.image, found);
  for (const cv::KeyPoint& keypoint : found) {
    Corner corner{.x = keypoint.pt.x, .y = keypoint.pt.y, .strength = keypoint.response};
    corner.disparity = usable_disparity(view.disparity, corner.x, corner.y, camera, options);
    if (corner.disparity == 0) continue;
    corner.point_in_cam = camera.point(corner.x, corner.y, corner.disparity);
    result.keypoints.push_back(corner);
    result.angles.push_back(keypoint.angle * std::numbers::pi / 180);
    result.sizes.push_back(keypoint.size);
    usable.push_back(keypoint);
  }
  cv::Mat descriptors;
  if (!usable.empty()) sift->compute(view.image, usable, descriptors);
  result.descriptors = descriptors;
  return result;
}

TracedMotion rescue_motion(const RescueFeatures& prev, const RescueFeatures& cur, const RectifiedCamera& camera,
                           const ScsOptions& options) {
  TracedMotion result;
  if (std::min(prev.count(), cur.count()) >= options.min_used) {
    const std::vector<Correspondence> keypoints = keypoint_matches(prev, cur, camera, options);
    for (const int turns : {0, 1, 3, 2}) {
      if (turns > 0 && !options.quarter_turns) break;
      std::vector<Correspondence> all = keypoints;
      if (turns == 0) {
        for (Correspondence& c :
             refine_matches(match_corners(prev.dense, cur.dense), prev.dense, cur.dense, 0, camera, options)) {
          c.prev_corner = c.cur_corner = -1;
          all.push_back(c);
        }
      }
      TracedMotion motion = motion_from(all, turns, camera, options);
      const MotionStatus status = motion.estimate.status;
      if (turns == 0 || status == MotionStatus::ok) result = std::move(motion);
      if (status == MotionStatus::ok || status == MotionStatus::ambiguous) break;
    }
    if (result.estimate.status == MotionStatus::ok && options.predict) {
      result = with_predicted(result, prev.dense, cur.dense, camera, options);
    }
  }
  result.estimate.corners = cur.count();
  return result;
}

}  // namespace iris::motion
