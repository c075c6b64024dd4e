#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

namespace iris {

// A point of a surface, measured by one or more stereo views.
struct CloudPoint {
  Eigen::Vector3f position = Eigen::Vector3f::Zero();  // [m] world
  Eigen::Vector3f normal = Eigen::Vector3f::Zero();    // unit length, towards the cameras that saw it; 0 = not known
  std::array<uint8_t, 3> rgb{};                        // sRGB
  float sigma = 0;                                     // [m] standard deviation across the surface
  float range = 0;                                     // [m] from the nearest camera that measured it
  uint16_t views = 0;                                  // that agree on it, its own among them
};

struct PointCloud {
  double edge = 0;  // [m] of the cubes that thinned it: one point a cube
  std::vector<CloudPoint> points;
};

}  // namespace iris
