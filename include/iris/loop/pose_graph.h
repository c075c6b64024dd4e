// Pose graph optimisation: the poses that agree best with all measured motions, those of loops included; loops that
// contradict the rest lose their weight. Closes the loops that the thesis leaves open (5.5, ch. 10).
#pragma once

#include <functional>
#include <vector>

#include "iris/loop/options.h"
#include "iris/types/pose_graph.h"

namespace iris::loop {

// A loop of less weight than this counts as rejected: its chi-square is above three times max_chi_square.
constexpr double kRejectedWeight = 0.25;

struct RefinedGraph {
  // Nodes and edges of the input in their order. Poses are refined; the first node of each component keeps its pose.
  // A component is what odometry, and loops that agree, connect; it is one sub-map: number 0 is the one with most
  // nodes, then by falling number of nodes, of equal ones the earlier first.
  PoseGraph graph;
  std::vector<double> edge_error;   // Mahalanobis distance of each edge after refinement, with the covariance enlarged
                                    // as below; infinite for a loop between different components
  std::vector<double> edge_weight;  // 1 = full; loops only are weighted (0 between different components)
  // Of each node relative to the first node of its component (0 there), the same perturbation as everywhere:
  // t' = t + dt, R' = exp(dw) R of world_from_cam.
  std::vector<Matrix6d> covariance;
  // [times] by which the standard deviations of motions between neighbours and of loops are larger than they say. They
  // are variance components (Helmert; Foerstner 1979): the squares left of each kind, by their redundancy, which is the
  // part of each motion that the others check. Loops by the median, so that wrong ones do not count. options.sigma
  // stands for as much as two loops tell; neither is taken to be better than it says.
  double odometry_sigma = 1, loop_sigma = 1;
  int iterations = 0;
  bool converged = true;
};

// Minimises the sum of the edges' squared Mahalanobis distances, a loop's beyond phi = max_chi_square being bounded
// (dynamic covariance scaling, Agarwal et al. 2013: s = min(1, 2 phi / (phi + chi^2)), weight s^2, which is the
// M-estimator rho = phi (3 chi^2 - phi) / (phi + chi^2)).
// Steps: loops that no drift of the odometry explains are left out at first; sub-maps are joined by the largest set of
// mutually consistent loops between them; rotations, then translations are found in closed form (chordal relaxation:
// two linear systems); Ceres from there, with phi falling to its value (graduated non-convexity); loops left out that
// now fit are taken in again. All of it is deterministic. Edges must name nodes of the graph. `stopped` is asked now
// and then; true: Interrupted is thrown; may be empty.
RefinedGraph refine(const PoseGraph& graph, const LoopOptions& options, const std::function<bool()>& stopped = {});

// The joint covariance of some poses of a sub-map by the edges of its graph, as they stand, in world perturbations
// (dt, dw) one pose after the other; the sub-map's first node is held fixed, so that only what does not change with a
// common motion has a meaning. Infinite if the edges do not determine the poses.
Eigen::MatrixXd joint_covariance(const PoseGraph& graph, const std::vector<int>& frames);

// The error of an edge, (dt, dw) in the measured motion's own perturbation: the predicted motion is the measured one
// moved by it, t + dt, exp(dw) R.
Vector6d edge_residual(const Pose& world_from_i, const Pose& world_from_j, const Pose& i_from_j);
// Its derivatives by the perturbations of world_from_i and world_from_j.
struct EdgeJacobians {
  Matrix6d by_i, by_j;
};
EdgeJacobians edge_jacobians(const Pose& world_from_i, const Pose& world_from_j, const Vector6d& residual);

}  // namespace iris::loop
