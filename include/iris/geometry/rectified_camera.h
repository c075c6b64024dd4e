// The rectified stereo camera: both optical axes parallel, rows aligned, left image is the reference.
#pragma once

#include <Eigen/Core>

namespace iris {

// Camera frame: x right, y down, z forward, origin in the left optical centre [m]. Pixel (0, 0) is the centre of the
// upper-left pixel. disparity = x_left - x_right [px].
struct RectifiedCamera {
  double f = 0;                 // [px] focal length
  double cx = 0;                // [px] principal point of the left camera
  double cy = 0;                // [px]
  double baseline = 0;          // [m] > 0
  double disparity_offset = 0;  // [px] x of the right principal point minus cx (Middlebury's doffs): added to a
                                // measured disparity before it is converted to depth
  int width = 0;                // [px]
  int height = 0;               // [px]

  // Point in the left camera frame [m] of image point (x, y) [px] with measured disparity (4.3).
  // Infinite if disparity + disparity_offset is 0.
  Eigen::Vector3d point(double x, double y, double disparity) const {
    const double s = baseline / (disparity + disparity_offset);
    return {s * (x - cx), s * (y - cy), s * f};
  }
  // (x, y, disparity) [px] of a point in the left camera frame with z > 0.
  Eigen::Vector3d project(const Eigen::Vector3d& point_in_cam) const {
    const double s = f / point_in_cam.z();
    return {s * point_in_cam.x() + cx, s * point_in_cam.y() + cy, s * baseline - disparity_offset};
  }
};

}  // namespace iris
