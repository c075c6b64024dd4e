#pragma once

#include <cstdint>
#include <vector>

#include "iris/geometry/pose.h"

namespace iris {

struct PoseNode {
  int frame_idx = 0;
  int64_t stamp_ns = 0;
  Pose world_from_cam = Pose::Identity();  // left rectified camera
  int submap = 0;                          // poses of different sub-maps have no known relation
  // Against the first camera of the sub-map: translation [m], then rotation [rad], as a left perturbation in the world:
  // t' = t + dt, R' = exp(dw) R. Zero before the loop stage, and of the first camera.
  Matrix6d covariance = Matrix6d::Zero();
};

enum class PoseEdgeKind { odometry, loop, guessed };  // guessed: not measured, its information is next to nothing

// Nodes are named by their frame_idx.
struct PoseEdge {
  int i = 0, j = 0;
  Pose i_from_j = Pose::Identity();
  Matrix6d information = Matrix6d::Identity();  // inverse of MotionEstimate::covariance, same order and perturbation
  PoseEdgeKind kind = PoseEdgeKind::odometry;
  int used = 0;  // correspondences behind it, as in MotionEstimate; 0 = not known
};

// Nodes in the order of their frames; frames without a pose have no node.
struct PoseGraph {
  std::vector<PoseNode> nodes;
  std::vector<PoseEdge> edges;
};

}  // namespace iris
