#include "iris/motion/rescue.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numbers>
#include <opencv2/features2d.hpp>
#include <utility>

#include "iris/core/error.h"
#include "iris/motion/track.h"

namespace iris::motion {
namespace {

constexpr int kDescriptorSize = 128;  // of SIFT, whole numbers from 0 to 255

// Rows of two sets of descriptors that are each other's nearest, ordered by the first; the lowest index among equals.
// In whole numbers, each distance once: the same result as OpenCV's matcher.
std::vector<std::pair<int, int>> mutually_nearest(const cv::Mat1f& a, const cv::Mat1f& b) {
  IRIS_CHECK(a.cols == kDescriptorSize && b.cols == kDescriptorSize);
  cv::Mat1s whole_a, whole_b;
  a.convertTo(whole_a, CV_16S);
  b.convertTo(whole_b, CV_16S);
  constexpr int kFar = std::numeric_limits<int>::max();
  std::vector<int> nearest_a(static_cast<size_t>(a.rows), -1);
  std::vector<int> nearest_b(static_cast<size_t>(b.rows), -1), least_b(static_cast<size_t>(b.rows), kFar);
  for (int i = 0; i < a.rows; ++i) {
    const int16_t* x = whole_a[i];
    int least = kFar;
    for (int j = 0; j < b.rows; ++j) {
      const int16_t* y = whole_b[j];
      int distance = 0;
      for (int k = 0; k < kDescriptorSize; ++k) {
        const auto difference = static_cast<int16_t>(x[k] - y[k]);
        distance += difference * difference;
      }
      if (distance < least) least = distance, nearest_a[i] = j;
      if (distance < least_b[j]) least_b[j] = distance, nearest_b[j] = i;
    }
  }
  std::vector<std::pair<int, int>> pairs;
  for (int i = 0; i < a.rows; ++i)
    if (nearest_b[nearest_a[i]] == i) pairs.emplace_back(i, nearest_a[i]);
  return pairs;
}

// Pairs of keypoints that are each other's nearest in the space of descriptors, placed by their surroundings.
std::vector<Correspondence> keypoint_matches(const RescueFeatures& prev, const RescueFeatures& cur,
                                             const RectifiedCamera& camera, const ScsOptions& options) {
  std::vector<Correspondence> result;
  if (prev.keypoints.empty() || cur.keypoints.empty()) return result;
  for (const auto& [i, j] : mutually_nearest(prev.descriptors, cur.descriptors)) {
    const Corner &from = prev.keypoints[i], &start = cur.keypoints[j];
    const double scale = std::clamp(cur.sizes[j] / prev.sizes[i], 0.5, 2.0);
    const Eigen::Matrix2d warp = scale * Eigen::Rotation2Dd(cur.angles[j] - prev.angles[i]).toRotationMatrix();
    const Eigen::Vector2d at(start.x, start.y);
    const PatchTrack track = track_patch(prev.dense.image, {from.x, from.y}, cur.dense.image, at, warp);
    if (!track.found) continue;
    const Eigen::Vector2d& p = track.position;
    const double disparity = usable_disparity(cur.dense.disparity, p.x(), p.y(), camera, options);
    if (disparity == 0) continue;
    result.push_back({.prev_corner = -1,
                      .cur_corner = -1,
                      .prev_point = from.point_in_cam,
                      .cur_point = camera.point(p.x(), p.y(), disparity),
                      .moved = (p - at).norm()});
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
  RescueFeatures result{.dense = extract_features(view.image, view.disparity, camera, more, view.right)};
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
      if (turns > 0 && !options.any_roll) break;
      std::vector<Correspondence> all = keypoints;
      if (turns == 0) {
        for (Correspondence& c :
             refine_matches(match_corners(prev.dense, cur.dense), prev.dense, cur.dense, camera, options)) {
          c.prev_corner = c.cur_corner = -1;
          all.push_back(c);
        }
      }
      TracedMotion motion = motion_from(all, turns * std::numbers::pi / 2, camera, options);
      if (motion.estimate.status == MotionStatus::ok && options.predict) {
        motion = confirmed(motion, prev.dense, cur.dense, camera, options);
      }
      const MotionStatus status = motion.estimate.status;
      if (turns == 0 || status == MotionStatus::ok) result = std::move(motion);
      if (status == MotionStatus::ok || status == MotionStatus::ambiguous) break;
    }
  }
  result.estimate.corners = cur.count();
  return result;
}

}  // namespace iris::motion
