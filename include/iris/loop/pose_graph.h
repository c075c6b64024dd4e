// Pose graph optimisation: the poses that agree best with all measured motions, those of loops included; loops that
// contradict the rest lose their weight. Closes the loops that the thesis leaves open (5.5, ch. 10).
#pragma once

#include <functional>
#include <vector>

#include "iris/core/options.h"
#include "iris/types/pose_graph.h"

namespace iris::loop {

struct PoseGraphOptions {
  // [times] by which the standard deviations of motions are larger than they say: errors of neighbouring corners go
  // together, which the covariances do not know. In a simulated flat, Mahalanobis distances from the truth are 2.5
  // times too large (1.3 to 1.9 for each coordinate alone), of single motions as of chains and loops; with 2.5 those of
  // the refined poses are as they should be (1.00).
  double odometry_sigma = 2.5, loop_sigma = 2.5;
  double max_loop_error = 5.0;  // [standard deviations] Mahalanobis distance (6 degrees of freedom; 99.9 % of good
                                // loops stay below 4.7) from which on a loop loses weight
  int min_joining_loops = 2;    // so many loops must agree on the relation of two sub-maps to join them
  int max_iterations = 50;      // of the minimisation, in each of at most three rounds

  void declare(OptionSet& set);  // section "loop"
};

// A loop of less weight than this counts as rejected: it is off by more than sqrt(3) max_loop_error.
constexpr double kRejectedWeight = 0.25;

struct RefinedGraph {
  // Nodes and edges of the input in their order. Poses are refined; the first node of each component keeps its pose.
  // A component is what odometry, and loops that agree, connect; it is one sub-map: number 0 is the one with most
  // nodes, then by falling number of nodes, of equal ones the earlier first.
  PoseGraph graph;
  std::vector<double> edge_error;   // Mahalanobis distance of each edge after refinement, with the covariance of the
                                    // options; infinite for a loop between different components
  std::vector<double> edge_weight;  // 1 = full; loops only are weighted (0 between different components)
  // Of each node relative to the first node of its component (0 there), the same perturbation as everywhere:
  // t' = t + dt, R' = exp(dw) R of world_from_cam.
  std::vector<Matrix6d> covariance;
  int iterations = 0;
  bool converged = true;
};

// Minimises the sum of the edges' squared Mahalanobis distances, a loop's beyond phi = max_loop_error^2 being bounded
// (dynamic covariance scaling, Agarwal et al. 2013: s = min(1, 2 phi / (phi + chi^2)), weight s^2, which is the
// M-estimator rho = phi (3 chi^2 - phi) / (phi + chi^2)).
// Steps: loops that no drift of the odometry explains are left out at first; sub-maps are joined by the largest set of
// mutually consistent loops between them; rotations, then translations are found in closed form (chordal relaxation:
// two linear systems); Ceres from there, with phi falling to its value (graduated non-convexity); loops left out that
// now fit are taken in again. All of it is deterministic. Edges must name nodes of the graph. `stopped` is asked now
// and then; true: Interrupted is thrown; may be empty.
RefinedGraph refine(const PoseGraph& graph, const PoseGraphOptions& options, const std::function<bool()>& stopped = {});

// The error of an edge, (dt, dw) in the measured motion's own perturbation: the predicted motion is the measured one
// moved by it, t + dt, exp(dw) R.
Vector6d edge_residual(const Pose& world_from_i, const Pose& world_from_j, const Pose& i_from_j);
// Its derivatives by the perturbations of world_from_i and world_from_j.
struct EdgeJacobians {
  Matrix6d by_i, by_j;
};
EdgeJacobians edge_jacobians(const Pose& world_from_i, const Pose& world_from_j, const Vector6d& residual);

}  // namespace iris::loop
