// Disparities of corners, measured at the corners themselves and more precisely than dense stereo does.
#pragma once

#include "iris/geometry/pose.h"
#include "iris/motion/features.h"
#include "iris/motion/track.h"

namespace iris::motion {

constexpr double kMaxCorrection = 1;  // [px] what differs more from dense stereo is a wrong match

// Measures the disparity of each corner again, in view.right if there is one: the surroundings are moved along the row,
// as a piece of the plane that fits the measured disparities around, until they differ least. Sets slope, and where the
// match succeeds disparity, point_in_cam and disparity_error.
void measure_disparities(ViewFeatures& view, const RectifiedCamera& camera);

// The homography that takes small differences of position from the corner to those from its image in another camera
// (same intrinsics): the surroundings are the piece of a plane that corner.slope tells.
Eigen::Matrix3d plane_warp(const RectifiedCamera& camera, const Corner& corner, const Pose& other_from_cam);

// What of the corner's surroundings is tracked.
TrackedSurface corner_surface(const DisparityImage& disparity, const Corner& corner);

// Covariance of the position of a corner in an image [px^2], by the comparison with another image of the same quality.
Eigen::Matrix2d position_covariance(const PatchTrack& track);

}  // namespace iris::motion
