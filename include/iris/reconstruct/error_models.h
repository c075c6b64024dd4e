// How far two reconstructions of one point are apart (thesis 4.4): point p of one view, q of another, and a supposed
// transform p_from_q between the views. Four models, from rough to exact. All give squared errors in units of the
// variance of `pixel_error`: with the true transform and the noise model of error_propagation.h the expectation is
// about 3.
#pragma once

#include <Eigen/Core>

#include "iris/geometry/pose.h"
#include "iris/geometry/rectified_camera.h"

namespace iris::reconstruct {

// |p - (R q + T)|^2 over the sum of the points' variances, each point's variance being the mean of its three (4.10).
double spherical_error(const RectifiedCamera& camera, const Eigen::Vector3d& p, const Eigen::Vector3d& q,
                       const Pose& p_from_q, double pixel_error);

// Mahalanobis distance with both points' covariances (4.15).
double ellipsoid_error(const RectifiedCamera& camera, const Eigen::Vector3d& p, const Eigen::Vector3d& q,
                       const Pose& p_from_q, double pixel_error);

// The centre of the error contour of `point` that belongs to an image error of `error_px` [px]; it lies beyond the
// point, seen from the middle between both cameras (4.16, 4.19). The denominator of (4.19) is kept positive: an error
// of more than a third of the disparity moves the centre no further.
Eigen::Vector3d drifted_centre(const RectifiedCamera& camera, const Eigen::Vector3d& point, double error_px);

// Ellipsoid error between the drifted centres, iterated until it is stable (4.4.4).
double drift_error(const RectifiedCamera& camera, const Eigen::Vector3d& p, const Eigen::Vector3d& q,
                   const Pose& p_from_q, double pixel_error);

// Image based error (4.7, 4.8): the least sum of the eight squared differences between the image coordinates of p and q
// and those of any point v (`best`, in q's frame).
struct ImageError {
  double square = 0;                               // in units of pixel_error^2
  Eigen::Vector3d best = Eigen::Vector3d::Zero();  // [m] in q's frame
};
ImageError image_error(const RectifiedCamera& camera, const Eigen::Vector3d& p, const Eigen::Vector3d& q,
                       const Pose& p_from_q, double pixel_error);

// Image coordinates (x_left, sqrt(2) y, x_right) [px] relative to the principal point. Rows are equal in both rectified
// images, so that y counts twice: the squared norm of a difference is the sum over all four coordinates.
Eigen::Vector3d image_coordinates(const RectifiedCamera& camera, const Eigen::Vector3d& point);
// Its derivative by the point [px/m].
Eigen::Matrix3d image_jacobian(const RectifiedCamera& camera, const Eigen::Vector3d& point);

}  // namespace iris::reconstruct
