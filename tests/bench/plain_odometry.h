// The usual way to the motion between two stereo views: corners are tracked (Lucas-Kanade), their points in space come
// from the disparities of the first view, and the motion from perspective n points with RANSAC.
#pragma once

#include <opencv2/core.hpp>

#include "iris/geometry/rectified_camera.h"

namespace iris::bench {

// Number of points that agree with the motion.
int plain_motion(const cv::Mat1b& prev, const cv::Mat1f& prev_disparity, const cv::Mat1b& cur,
                 const RectifiedCamera& camera);

}  // namespace iris::bench
