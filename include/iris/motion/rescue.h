// The second attempt at a motion that corners and Rank patches did not find: many more corners, weaker ones too, and
// SIFT keypoints, whose descriptors bear more turn, scale and perspective. All are candidates of the same consistency
// test. Costs some tenths of a second a view, hence for failures only.
#pragma once

#include <opencv2/core.hpp>
#include <vector>

#include "iris/motion/scs.h"

namespace iris::motion {

struct RescueFeatures {
  ViewFeatures dense;  // four times as many corners, down to a tenth of the strength
  std::vector<Corner> keypoints;
  std::vector<double> angles, sizes;  // [rad] clockwise, [px] of the keypoints
  cv::Mat1f descriptors;              // one row a keypoint

  int count() const { return static_cast<int>(dense.corners.size() + keypoints.size()); }
};

RescueFeatures rescue_features(const ViewFeatures& view, const RectifiedCamera& camera, const ScsOptions& options);

// As trace_motion; estimate.corners counts corners and keypoints of the current view.
TracedMotion rescue_motion(const RescueFeatures& prev, const RescueFeatures& cur, const RectifiedCamera& camera,
                           const ScsOptions& options);

}  // namespace iris::motion
