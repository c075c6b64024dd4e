// What IRIS is compared with, from OpenCV's parts.
#pragma once

#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>

#include "iris/geometry/rectified_camera.h"

namespace iris::bench {

// Block matching in windows of 11x11 pixels, with left/right check and speckle filter as IRIS has them.
cv::Ptr<cv::StereoMatcher> block_matcher(int disparities);

// Semi-global matching, `mode` of cv::StereoSGBM; blocks of 5x5 pixels and the penalties that OpenCV recommends.
cv::Ptr<cv::StereoMatcher> semi_global_matcher(int disparities, int mode);

// The usual way to the motion between two stereo views: corners are tracked (Lucas-Kanade), their points in space come
// from the disparities of the first view, and the motion from perspective n points with RANSAC. Returns the number of
// points that agree with the motion.
int plain_motion(const cv::Mat1b& prev, const cv::Mat1f& prev_disparity, const cv::Mat1b& cur,
                 const RectifiedCamera& camera);

}  // namespace iris::bench
