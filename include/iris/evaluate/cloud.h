// Errors of a point cloud against the true surface.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "iris/evaluate/trajectory.h"
#include "iris/types/point_cloud.h"
#include "iris/types/triangle_mesh.h"

namespace iris::evaluate {

struct CloudOptions {
  double near_range = 3;  // [m] from the camera: points measured from nearer are judged by themselves too
  double reach = 0.03;    // [m] a true point is covered if a point of the cloud lies within this
};

struct CloudErrors {
  Spread distance;                                // [m] of all points from the nearest true surface
  Spread near_distance;                           // of those measured from within near_range
  double within_sigma = 0, within_two_sigma = 0;  // parts of all points whose distance is within their stated sigma
  double near_within_sigma = 0, near_within_two_sigma = 0;
  int seen = 0, covered = 0;  // true points
};

// `truth_from_cloud`: the cloud's world in that of the truth. `seen`: points of the true surface [m] that the cloud
// should hold.
CloudErrors evaluate_cloud(const PointCloud& cloud, const Pose& truth_from_cloud,
                           const std::vector<TriangleMesh>& truth, const std::vector<Eigen::Vector3d>& seen,
                           const CloudOptions& options);

}  // namespace iris::evaluate
