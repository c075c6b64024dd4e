#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

namespace iris {

// A surface of triangles: what the simulator renders, what is drawn into a tour, what mesh files hold.
struct TriangleMesh {
  std::string name;
  std::vector<Eigen::Vector3f> vertices;             // [m]
  std::vector<Eigen::Vector3i> triangles;            // indices of vertices, counter-clockwise seen from outside
  std::vector<Eigen::Vector2f> texture_coordinates;  // one a vertex, or none: (0, 0) is the upper-left corner of the
                                                     // texture, u to the right, v down, repeating beyond [0, 1]
  cv::Mat3b texture;                                 // BGR; empty = `colour` everywhere
  cv::Vec3b colour{200, 200, 200};                   // BGR
  std::vector<cv::Vec3b> vertex_colours;             // BGR, one a vertex, or none; before `colour`
};

}  // namespace iris
