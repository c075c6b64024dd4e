// One real camera: pinhole with lens distortion (thesis 2.1, equations 2.3 and 2.4, and the models of today's tools).
#pragma once

#include <Eigen/Core>
#include <vector>

namespace iris {

enum class Distortion {
  radial_tangential,  // k1 k2 p1 p2 [k3 [k4 k5 k6]] on normalised coordinates, the order of OpenCV
  equidistant,        // Kannala-Brandt k1..k4: fisheye, polynomial in the angle to the optical axis
};

// Camera frame: x right, y down, z forward [m]. Pixel (0, 0) is the centre of the upper-left pixel.
struct CameraModel {
  int width = 0, height = 0;                        // [px]; 0 = not known (yet)
  Eigen::Matrix3d K = Eigen::Matrix3d::Identity();  // [fx skew cx; 0 fy cy; 0 0 1] px (2.4)
  Distortion distortion = Distortion::radial_tangential;
  std::vector<double>
      coefficients;  // radial_tangential: 0, 2, 4, 5 or 8 of them; equidistant: 0 or 4; none = no distortion

  // Image point [px] of a point in the camera frame. Radial-tangential cameras see only z > 0: NaN otherwise.
  Eigen::Vector2d project(const Eigen::Vector3d& point_in_cam) const;

  // Direction of unit length of the ray through an image point: the inverse of project. NaN where the lens model has
  // no inverse (outside of the part of the image plane that the model reaches).
  Eigen::Vector3d unproject(const Eigen::Vector2d& pixel) const;

  // Largest angle to the optical axis [rad] up to which the radial part of the model grows: beyond it the polynomial
  // folds back and would show the same image twice.
  double max_angle() const;

  // True if any coefficient is not 0. (An equidistant camera is distorted even when all are 0.)
  bool distorted() const;
};

}  // namespace iris
