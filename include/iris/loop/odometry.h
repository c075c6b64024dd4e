// Relative poses of any two nodes of a graph by odometry alone, with their uncertainty, in constant time.
#pragma once

#include <optional>
#include <unordered_map>
#include <vector>

#include "iris/loop/options.h"
#include "iris/loop/twist.h"
#include "iris/types/pose_graph.h"

namespace iris::loop {

// What odometry says about two nodes.
struct RelativePose {
  Pose i_from_j = Pose::Identity();
  Matrix6d covariance = Matrix6d::Zero();  // of a twist on the left, hence in i
  double path = 0;                         // [m] length of the way between them
};

// Odometry's edges form trees: every node is measured against one earlier node at most. With all errors expressed as
// twists in the world, the covariance of the way between two nodes is the sum over its edges, a difference of sums from
// the root. Loop edges are ignored. Standard deviations are enlarged, and a systematic error grows with the way's
// length (LoopOptions).
class Odometry {
 public:
  Odometry(const PoseGraph& graph, const LoopOptions& options);

  bool has(int frame_idx) const { return index_.contains(frame_idx); }
  const PoseNode& node(int frame_idx) const { return nodes_[static_cast<size_t>(index_.at(frame_idx))]; }

  // Nothing if no way of odometry joins them.
  std::optional<RelativePose> between(int i_frame, int j_frame) const;

  // Standard deviation [m] of a node's position as seen from the first node of its tree (and back).
  double position_error(int frame_idx) const;

 private:
  struct Link {
    int parent = -1, jump = -1, depth = 0;   // jump: an ancestor for logarithmic search
    Matrix6d covariance = Matrix6d::Zero();  // from the root, of a twist in the world
    double path = 0;                         // [m] from the root
  };
  int common_ancestor(int a, int b) const;

  std::vector<PoseNode> nodes_;
  std::vector<Link> links_;
  std::unordered_map<int, int> index_;
  double sigma_, drift_, turn_drift_;
};

}  // namespace iris::loop
