// Errors of reconstructed points, propagated from the image (thesis 4.2 to 4.5).
//
// Noise model: independent Gaussian errors of standard deviation `pixel_error` [px] on the four image coordinates
// x_left, y_left, x_right, y_right of a point. Points are in the left rectified camera frame [m], z > 0.
#pragma once

#include <Eigen/Core>

#include "iris/geometry/rectified_camera.h"

namespace iris::reconstruct {

// Derivatives of (Px, Py, Pz) [m] by (x_left, y_left, x_right, y_right) [px] (table 4.1).
Eigen::Matrix<double, 3, 4> point_jacobian(const RectifiedCamera& camera, const Eigen::Vector3d& point);

// Covariance of a reconstructed point [m^2], pixel_error^2 J J^T: the ellipsoid of (4.14).
Eigen::Matrix3d point_covariance(const RectifiedCamera& camera, const Eigen::Vector3d& point, double pixel_error);

// Standard deviations of the three coordinates [m] (4.21).
Eigen::Vector3d coordinate_errors(const RectifiedCamera& camera, const Eigen::Vector3d& point, double pixel_error);

// Standard deviation of the distance from the left optical centre [m] (4.23).
double range_error(const RectifiedCamera& camera, const Eigen::Vector3d& point, double pixel_error);

// The same, simplified (4.24): within 1.6 % of (4.23) for the thesis's camera; what mapping uses for each ray.
double approximate_range_error(const RectifiedCamera& camera, const Eigen::Vector3d& point, double pixel_error);

// Standard deviation of the distance between two points of one view [m] (4.26). 0 if they coincide.
double length_error(const RectifiedCamera& camera, const Eigen::Vector3d& p, const Eigen::Vector3d& q,
                    double pixel_error);

}  // namespace iris::reconstruct
