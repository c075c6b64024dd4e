#include "iris/loop/odometry.h"

#include <Eigen/LU>
#include <cmath>
#include <numbers>

#include "iris/core/error.h"

namespace iris::loop {

Odometry::Odometry(const PoseGraph& graph, const LoopOptions& options)
    : nodes_(graph.nodes),
      links_(graph.nodes.size()),
      sigma_(options.sigma),
      drift_(options.drift),
      turn_drift_(options.turn_drift * std::numbers::pi / 180) {
  const int n = static_cast<int>(nodes_.size());
  for (int k = 0; k < n; ++k) {
    IRIS_CHECK(k == 0 || nodes_[k - 1].frame_idx < nodes_[k].frame_idx);
    index_[nodes_[k].frame_idx] = k;
  }
  std::vector<const PoseEdge*> edge_of(nodes_.size(), nullptr);
  for (const PoseEdge& edge : graph.edges) {
    if (edge.kind == PoseEdgeKind::loop) continue;
    const int k = index_.at(edge.j);
    IRIS_CHECK(edge.i < edge.j && !edge_of[k]);
    edge_of[k] = &edge;
  }
  for (int k = 0; k < n; ++k) {
    Link& link = links_[k];
    link.jump = k;
    if (!edge_of[k]) continue;
    const PoseEdge& edge = *edge_of[k];
    link.parent = index_.at(edge.i);
    const Link& parent = links_[link.parent];
    const Link& jump = links_[parent.jump];
    // Jumps of skew-binary lengths: two of equal length are joined to one.
    const bool joined = parent.depth - jump.depth == jump.depth - links_[jump.jump].depth;
    link.jump = joined ? jump.jump : link.parent;
    link.depth = parent.depth + 1;
    const Matrix6d to_world = adjoint(nodes_[link.parent].world_from_cam);
    const Matrix6d step = twist_covariance(edge.i_from_j, edge.information.inverse());
    link.covariance = parent.covariance + to_world * step * to_world.transpose();
    link.path = parent.path + edge.i_from_j.translation().norm();
  }
}

int Odometry::common_ancestor(int a, int b) const {
  if (links_[a].depth < links_[b].depth) std::swap(a, b);
  while (links_[a].depth > links_[b].depth) {
    a = links_[links_[a].jump].depth >= links_[b].depth && links_[a].jump != a ? links_[a].jump : links_[a].parent;
  }
  while (a != b) {
    if (links_[a].parent < 0) return -1;
    const bool skip = links_[a].jump != links_[b].jump && links_[a].jump != a;
    a = skip ? links_[a].jump : links_[a].parent;
    b = skip ? links_[b].jump : links_[b].parent;
  }
  return a;
}

std::optional<RelativePose> Odometry::between(int i_frame, int j_frame) const {
  const int i = index_.at(i_frame), j = index_.at(j_frame);
  const int top = common_ancestor(i, j);
  if (top < 0) return std::nullopt;
  RelativePose result;
  const Pose i_from_world = nodes_[i].world_from_cam.inverse();
  result.i_from_j = i_from_world * nodes_[j].world_from_cam;
  result.path = links_[i].path + links_[j].path - 2 * links_[top].path;
  const Matrix6d in_world = links_[i].covariance + links_[j].covariance - 2 * links_[top].covariance;
  const Matrix6d to_i = adjoint(i_from_world);
  result.covariance = sigma_ * sigma_ * (to_i * in_world * to_i.transpose());
  const double shift = drift_ * result.path, turn = turn_drift_ * result.path;
  result.covariance.diagonal().head<3>().array() += shift * shift;
  result.covariance.diagonal().tail<3>().array() += turn * turn;
  return result;
}

double Odometry::position_error(int frame_idx) const {
  int root = index_.at(frame_idx);
  while (links_[root].parent >= 0) root = links_[root].jump;
  const auto relative = between(nodes_[root].frame_idx, frame_idx);
  const Matrix6d covariance = motion_covariance(relative->i_from_j, relative->covariance);
  return std::sqrt(covariance.topLeftCorner<3, 3>().trace());
}

}  // namespace iris::loop
