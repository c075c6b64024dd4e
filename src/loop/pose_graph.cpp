#include "iris/loop/pose_graph.h"

#include <ceres/loss_function.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <optional>
#include <queue>
#include <unordered_map>

#include "block_cholesky.h"
#include "iris/core/error.h"
#include "iris/core/median.h"
#include "iris/core/parallel.h"
#include "iris/loop/twist.h"
#include "iris/motion/minimise.h"
#include "pose_problem.h"

namespace iris::loop {

Vector6d edge_residual(const Pose& world_from_i, const Pose& world_from_j, const Pose& i_from_j) {
  const Eigen::Matrix3d i_from_world = world_from_i.linear().transpose();
  Vector6d residual;
  residual << i_from_world * (world_from_j.translation() - world_from_i.translation()) - i_from_j.translation(),
      log_of(i_from_world * world_from_j.linear() * i_from_j.linear().transpose());
  return residual;
}

EdgeJacobians edge_jacobians(const Pose& world_from_i, const Pose& world_from_j, const Vector6d& residual) {
  const Eigen::Matrix3d i_from_world = world_from_i.linear().transpose();
  const Eigen::Matrix3d turn = inverse_left_jacobian(residual.tail<3>()) * i_from_world;
  EdgeJacobians result;
  result.by_i << -i_from_world,
      i_from_world * motion::cross_matrix(world_from_j.translation() - world_from_i.translation()),  //
      Eigen::Matrix3d::Zero(), -turn;
  result.by_j << i_from_world, Eigen::Matrix3d::Zero(),  //
      Eigen::Matrix3d::Zero(), turn;
  return result;
}

namespace {

// An edge between places in the list of nodes.
struct Link {
  int i = 0, j = 0;
  Pose i_from_j = Pose::Identity();
  Matrix6d information, covariance;
  bool loop = false, guessed = false;
  double votes = 1;  // about how sub-maps lie
};

// A guessed edge keeps at least what any motion between two frames obeys: 100 m and a turn are possible.
Matrix6d least_information() {
  Vector6d sigma;
  sigma << 100, 100, 100, 6, 6, 6;
  return sigma.cwiseInverse().cwiseAbs2().asDiagonal();
}

// By how many times standard deviations are larger than stated.
struct Sigmas {
  double odometry = 1, loop = 1;
};

std::vector<Link> links_of(const PoseGraph& graph, const Sigmas& sigmas, const LoopOptions& options) {
  const auto place_of = [&](int frame_idx) {
    const auto found = std::lower_bound(graph.nodes.begin(), graph.nodes.end(), frame_idx,
                                        [](const PoseNode& node, int idx) { return node.frame_idx < idx; });
    IRIS_CHECK(found != graph.nodes.end() && found->frame_idx == frame_idx);
    return static_cast<int>(found - graph.nodes.begin());
  };
  std::vector<Link> links;
  for (const PoseEdge& edge : graph.edges) {
    IRIS_CHECK(edge.i != edge.j);
    const bool loop = edge.kind == PoseEdgeKind::loop;
    const double sigma = loop ? sigmas.loop : sigmas.odometry;
    Link link{.i = place_of(edge.i),
              .j = place_of(edge.j),
              .i_from_j = edge.i_from_j,
              .loop = loop,
              .guessed = edge.kind == PoseEdgeKind::guessed,
              .votes = options.votes(edge.used)};
    link.information = edge.information / (sigma * sigma) + 1e-12 * least_information();
    if (edge.kind == PoseEdgeKind::guessed) link.information += least_information();
    link.covariance = link.information.inverse();
    links.push_back(link);
  }
  return links;
}

// Poses that a spanning forest of edges gives, with their uncertainty. Twists in a common frame simply add up along a
// path, so that the covariance between any two nodes is that of both to the root, less twice that of their last common
// node.
class Forest {
 public:
  Forest(const PoseGraph& graph, const std::vector<Link>& links) : graph_(graph), links_(links) {}

  // Edges that `accept` takes, walked from the first node of each tree.
  template <class Accept>
  void grow(const Accept& accept) {
    const size_t count = graph_.nodes.size();
    tree_.assign(count, -1);
    parent_.assign(count, -1);
    depth_.assign(count, 0);
    pose_.assign(count, Pose::Identity());
    covariance_.assign(count, Matrix6d::Zero());
    std::vector<std::vector<int>> links_of_node(count);
    for (size_t k = 0; k < links_.size(); ++k) {
      if (!accept(static_cast<int>(k))) continue;
      links_of_node[links_[k].i].push_back(static_cast<int>(k));
      links_of_node[links_[k].j].push_back(static_cast<int>(k));
    }
    trees_ = 0;
    for (size_t root = 0; root < count; ++root) {
      if (tree_[root] >= 0) continue;
      tree_[root] = trees_;
      pose_[root] = graph_.nodes[root].world_from_cam;
      std::queue<int> open({static_cast<int>(root)});
      for (; !open.empty(); open.pop()) {
        const int node = open.front();
        for (const int k : links_of_node[node]) {
          const Link& link = links_[k];
          const int other = link.i == node ? link.j : link.i;
          if (tree_[other] >= 0) continue;
          tree_[other] = trees_;
          parent_[other] = node;
          depth_[other] = depth_[node] + 1;
          pose_[other] = link.i == node ? pose_[node] * link.i_from_j : pose_[node] * link.i_from_j.inverse();
          covariance_[other] = covariance_[node] + in_root(link, pose_[link.i]);
          open.push(other);
        }
      }
      ++trees_;
    }
  }

  int trees() const { return trees_; }
  int tree(int node) const { return tree_[node]; }
  const Pose& pose(int node) const { return pose_[node]; }

  // Covariance of the twist between two nodes of a tree, in its root's frame.
  Matrix6d covariance_between(int a, int b) const {
    int c = a, d = b;
    while (c != d) {
      int& deeper = depth_[c] > depth_[d] ? c : d;
      deeper = parent_[deeper];
    }
    return covariance_[a] + covariance_[b] - 2 * covariance_[c];
  }

  // Covariance of a link's own error as a twist in the frame that world_from_i leads to.
  static Matrix6d in_root(const Link& link, const Pose& world_from_i) {
    const Matrix6d to_root = adjoint(world_from_i);
    return to_root * twist_covariance(link.i_from_j, link.covariance) * to_root.transpose();
  }

  // Squared Mahalanobis distance between a link and what its tree says.
  double disagreement(const Link& link) const {
    const Matrix6d covariance = covariance_between(link.i, link.j) + in_root(link, pose_[link.i]);
    const Vector6d twist = twist_of(pose_[link.i] * link.i_from_j * pose_[link.j].inverse());
    return twist.dot(covariance.ldlt().solve(twist));
  }

  // The same between two links from tree a to tree b.
  double disagreement(const Link& first, const Link& second) const {
    const int a = tree_[first.i];
    const Pose first_place = placed(first, a), second_place = placed(second, a);  // a from b
    const auto end_in = [&](const Link& link, bool in_a) { return (tree_[link.i] == a) == in_a ? link.i : link.j; };
    const Matrix6d to_a = adjoint(first_place);
    const Matrix6d covariance =
        covariance_between(end_in(first, true), end_in(second, true)) +
        to_a * covariance_between(end_in(first, false), end_in(second, false)) * to_a.transpose() + own(first, a) +
        own(second, a);
    const Vector6d twist = twist_of(first_place * second_place.inverse());
    return twist.dot(covariance.ldlt().solve(twist));
  }

 private:
  // Where a link from tree a (or to it) places the other tree.
  Pose placed(const Link& link, int a) const {
    const Pose i_place = pose_[link.i] * link.i_from_j * pose_[link.j].inverse();
    return tree_[link.i] == a ? i_place : i_place.inverse();
  }
  Matrix6d own(const Link& link, int a) const {
    const Pose a_from_i = tree_[link.i] == a ? pose_[link.i] : placed(link, a) * pose_[link.i];
    return in_root(link, a_from_i);
  }

  const PoseGraph& graph_;
  const std::vector<Link>& links_;
  std::vector<int> tree_, parent_, depth_;
  std::vector<Pose> pose_;  // in the root node's world
  std::vector<Matrix6d> covariance_;
  int trees_ = 0;
};

// Groups of things that belong together; each is named by its first member.
class UnionFind {
 public:
  explicit UnionFind(int size) : parent_(static_cast<size_t>(size)) { std::iota(parent_.begin(), parent_.end(), 0); }
  int find(int a) {
    while (parent_[a] != a) a = parent_[a] = parent_[parent_[a]];
    return a;
  }
  bool join(int a, int b) {
    a = find(a);
    b = find(b);
    if (a == b) return false;
    parent_[std::max(a, b)] = std::min(a, b);
    return true;
  }

 private:
  std::vector<int> parent_;
};

// The loops that join trees: of each pair of trees the one that most others agree with; the pairs with most agreement
// first, as long as they join something.
std::vector<int> joining_links(const Forest& forest, const std::vector<Link>& links, double max_square,
                               double min_votes) {
  constexpr int kMaxHypotheses = 64;  // a pair with more loops: some of them, evenly chosen, are the hypotheses
  std::map<std::pair<int, int>, std::vector<int>> between;
  for (size_t k = 0; k < links.size(); ++k) {
    const int a = forest.tree(links[k].i), b = forest.tree(links[k].j);
    if (links[k].loop && a != b) between[std::minmax(a, b)].push_back(static_cast<int>(k));
  }
  struct Vote {
    double votes = 0;
    int link = 0;
  };
  std::vector<Vote> votes;
  for (const auto& [trees, candidates] : between) {
    const int count = static_cast<int>(candidates.size()), hypotheses = std::min(count, kMaxHypotheses);
    Vote best;
    for (int h = 0; h < hypotheses; ++h) {
      const int candidate = candidates[static_cast<int64_t>(h) * count / hypotheses];
      Vote vote{.link = candidate};
      for (const int other : candidates) {
        if (other == candidate || forest.disagreement(links[candidate], links[other]) < max_square) {
          vote.votes += links[other].votes;
        }
      }
      if (vote.votes > best.votes) best = vote;
    }
    if (best.votes >= min_votes) votes.push_back(best);
  }
  std::stable_sort(votes.begin(), votes.end(), [](const Vote& a, const Vote& b) { return a.votes > b.votes; });
  UnionFind groups(forest.trees());
  std::vector<int> joining;
  for (const Vote& vote : votes) {
    const Link& link = links[vote.link];
    if (groups.join(forest.tree(link.i), forest.tree(link.j))) joining.push_back(vote.link);
  }
  return joining;
}

// s^2 of dynamic covariance scaling, and its cost.
double weight_of(double square, double phi) {
  const double s = std::min(1.0, 2 * phi / (phi + square));
  return s * s;
}
double robust(double square, double phi) { return square <= phi ? square : phi * (3 * square - phi) / (phi + square); }

double square_of(const Link& link, const std::vector<Pose>& poses) {
  const Vector6d residual = edge_residual(poses[link.i], poses[link.j], link.i_from_j);
  return residual.dot(link.information * residual);
}

double cost_of(const std::vector<Link>& links, const std::vector<int>& active, const std::vector<Pose>& poses,
               double phi) {
  std::vector<double> costs(active.size());
  parallel_chunks(0, static_cast<int>(active.size()), 512, [&](int begin, int end) {
    for (int k = begin; k < end; ++k) {
      const double square = square_of(links[active[k]], poses);
      costs[k] = links[active[k]].loop ? robust(square, phi) : square;
    }
  });
  return std::accumulate(costs.begin(), costs.end(), 0.0);
}

// The unknowns: all nodes but the first of each component.
struct Unknowns {
  std::vector<int> of_node;  // -1: fixed
  int count = 0;
};

std::vector<std::pair<int, int>> pairs_of(const std::vector<Link>& links, const std::vector<int>& active,
                                          const Unknowns& unknowns) {
  std::vector<std::pair<int, int>> pairs;
  for (const int k : active) pairs.emplace_back(unknowns.of_node[links[k].i], unknowns.of_node[links[k].j]);
  return pairs;
}

std::vector<int> indices_of(const std::vector<char>& chosen) {
  std::vector<int> indices;
  for (size_t k = 0; k < chosen.size(); ++k) {
    if (chosen[k]) indices.push_back(static_cast<int>(k));
  }
  return indices;
}

// Chordal relaxation: rotations as unconstrained matrices with R_j = R_i R_ij, each then replaced by the nearest
// rotation; translations with t_j = t_i + R_i t_ij. Both are linear least squares. Nothing if one is singular.
bool relax(const std::vector<Link>& links, const std::vector<int>& active, const Unknowns& unknowns,
           std::vector<Pose>& poses) {
  using Block = Eigen::Matrix3d;
  BlockCholesky<3> system(unknowns.count, pairs_of(links, active, unknowns));
  // Of each row r of the matrices: |r_j - r_i R_ij|^2, the unknowns being the columns r^T.
  Eigen::MatrixXd right = Eigen::MatrixXd::Zero(3 * unknowns.count, 3);
  for (size_t k = 0; k < active.size(); ++k) {
    const Link& link = links[active[k]];
    const int i = unknowns.of_node[link.i], j = unknowns.of_node[link.j];
    const double weight = 3 / link.covariance.bottomRightCorner<3, 3>().trace();
    const Eigen::Matrix3d& turn = link.i_from_j.linear();
    if (i >= 0) system.add(i, weight * Block::Identity());
    if (j >= 0) system.add(j, weight * Block::Identity());
    system.add_pair(static_cast<int>(k), -weight * turn);
    if (i < 0 && j >= 0) right.middleRows<3>(3 * j) += weight * (poses[link.i].linear() * turn).transpose();
    if (j < 0 && i >= 0) right.middleRows<3>(3 * i) += weight * turn * poses[link.j].linear().transpose();
  }
  if (!system.factorise()) return false;
  const Eigen::MatrixXd rows = system.solve(right);
  std::vector<Pose> relaxed = poses;
  for (size_t node = 0; node < poses.size(); ++node) {
    const int at = unknowns.of_node[node];
    if (at >= 0) relaxed[node].linear() = nearest_rotation(rows.middleRows<3>(3 * at).transpose());
  }
  system.set_zero();
  Eigen::MatrixXd shift = Eigen::MatrixXd::Zero(3 * unknowns.count, 1);
  for (size_t k = 0; k < active.size(); ++k) {
    const Link& link = links[active[k]];
    const int i = unknowns.of_node[link.i], j = unknowns.of_node[link.j];
    const Eigen::Matrix3d& r = relaxed[link.i].linear();
    const Block weight = r * link.covariance.topLeftCorner<3, 3>().inverse() * r.transpose();
    // The step from the last node's to the first node's position, as far as it is known.
    Eigen::Vector3d known = r * link.i_from_j.translation();
    if (i < 0) known += relaxed[link.i].translation();
    if (j < 0) known -= relaxed[link.j].translation();
    if (i >= 0) {
      system.add(i, weight);
      shift.middleRows<3>(3 * i) -= weight * known;
    }
    if (j >= 0) {
      system.add(j, weight);
      shift.middleRows<3>(3 * j) += weight * known;
    }
    system.add_pair(static_cast<int>(k), -weight);
  }
  if (!system.factorise()) return false;
  const Eigen::MatrixXd positions = system.solve(shift);
  for (size_t node = 0; node < poses.size(); ++node) {
    const int at = unknowns.of_node[node];
    if (at >= 0) relaxed[node].translation() = positions.middleRows<3>(3 * at);
  }
  poses = std::move(relaxed);
  return true;
}

// Dynamic covariance scaling of loops.
class LoopLoss final : public ceres::LossFunction {
 public:
  void Evaluate(double square, double out[3]) const override {
    const double s = std::min(1.0, 2 * phi / (phi + square));
    out[0] = robust(square, phi);
    out[1] = s * s;
    out[2] = s < 1 ? -2 * s * s / (phi + square) : 0;
  }
  double phi = 1;
};

// The poses that agree best with the active links. The poses stay where they are in memory.
class GraphProblem {
 public:
  GraphProblem(const std::vector<Link>& links, const std::vector<int>& active, const Unknowns& unknowns,
               std::vector<Pose>& poses)
      : links_(links), active_(active), poses_(poses), problem_(lent()) {
    std::vector<char> present(poses.size(), 0);
    for (const int k : active) present[links[k].i] = present[links[k].j] = 1;
    for (size_t node = 0; node < poses.size(); ++node) {
      if (!present[node]) continue;
      problem_.AddParameterBlock(poses[node].data(), kPoseNumbers, &manifold_);
      if (unknowns.of_node[node] < 0) problem_.SetParameterBlockConstant(poses[node].data());
    }
    for (const int k : active) {
      const Link& link = links[k];
      problem_.AddResidualBlock(new EdgeCost(link.i_from_j, link.information), link.loop ? &loss_ : nullptr,
                                poses[link.i].data(), poses[link.j].data());
    }
  }

  // Until the step is far below the uncertainty of the poses; phi falls from `phi` to `last_phi` on the way.
  bool run(double phi, double last_phi, int max_iterations, const std::function<bool()>& stopped, int& iterations) {
    constexpr double kRest = 0.5e-6;  // all poses together: a thousandth of a standard deviation
    Watch watch(stopped);
    watch.rest = kRest;
    const double fall = std::min(1.0 / 8, std::pow(last_phi / phi, 1.0 / 6));
    const int last = iterations + max_iterations;
    for (;;) {
      loss_.phi = phi;
      watch.single_step = phi > last_phi;
      const bool rests = minimise(problem_, near_the_minimum(ceres::SPARSE_NORMAL_CHOLESKY), watch,
                                  std::max(1, last - iterations), iterations);
      if (!watch.single_step) return rests;
      // Loops below phi have their full say, whatever it is.
      phi = std::max(last_phi, std::min(phi * fall, largest_loop()));
    }
  }

 private:
  double largest_loop() const {
    double largest = 0;
    for (const int k : active_) {
      if (links_[k].loop) largest = std::max(largest, square_of(links_[k], poses_));
    }
    return largest;
  }

  const std::vector<Link>& links_;
  std::vector<int> active_;
  const std::vector<Pose>& poses_;
  PoseManifold manifold_;
  LoopLoss loss_;
  ceres::Problem problem_;
};

// An edge to first order, as it counts.
struct LinearEdge {
  EdgeJacobians by;
  Matrix6d information;
};

// The matrix of the normal equations. `pairs`: the unknowns of each edge's poses, -1 = fixed.
BlockCholesky<6> normal_matrix(int unknowns, const std::vector<std::pair<int, int>>& pairs,
                               const std::vector<LinearEdge>& edges) {
  BlockCholesky<6> matrix(unknowns, pairs);
  for (size_t k = 0; k < edges.size(); ++k) {
    const auto& [i, j] = pairs[k];
    const auto& [by, information] = edges[k];
    const Matrix6d weighted_j = information * by.by_j;
    if (i >= 0) matrix.add(i, by.by_i.transpose() * information * by.by_i);
    if (j >= 0) matrix.add(j, by.by_j.transpose() * weighted_j);
    matrix.add_pair(static_cast<int>(k), by.by_i.transpose() * weighted_j);
  }
  return matrix;
}

// The active links at some poses to first order: what their minimum is sure of.
class Linearised {
 public:
  Linearised(const std::vector<Link>& links, std::vector<int> active, const Unknowns& unknowns,
             const std::vector<Pose>& poses, double phi)
      : links_(links),
        active_(std::move(active)),
        unknowns_(unknowns),
        edges_(active_.size()),
        squares_(active_.size()) {
    parallel_chunks(0, static_cast<int>(active_.size()), 128, [&](int begin, int end) {
      for (int k = begin; k < end; ++k) {
        const Link& link = links[active_[k]];
        const Vector6d residual = edge_residual(poses[link.i], poses[link.j], link.i_from_j);
        squares_[k] = residual.dot(link.information * residual);
        edges_[k] = {.by = edge_jacobians(poses[link.i], poses[link.j], residual),
                     .information = (link.loop ? weight_of(squares_[k], phi) : 1) * link.information};
      }
    });
    BlockCholesky<6> system = normal_matrix(unknowns.count, pairs_of(links, active_, unknowns), edges_);
    system.factorise_nearly();
    inverse_ = system.inverse();
  }

  // The marginal covariances of the unknowns.
  const std::vector<Matrix6d>& covariances() const { return inverse_.diagonal; }

  // What the links' squares say of these, see RefinedGraph. `prior` counts like two loops.
  Sigmas sigmas(const Sigmas& before, double prior, double phi) const {
    constexpr double kPrior = 12;         // degrees of freedom
    constexpr double kMedian = 5.35 / 6;  // of the chi-square distribution with six degrees of freedom, by its mean
    double odometry_square = 0, odometry_redundancy = 0, loop_redundancy = 0;
    std::vector<double> of_loops;
    for (size_t k = 0; k < active_.size(); ++k) {
      const Link& link = links_[active_[k]];
      const double square = squares_[k];
      const double redundancy = 6 - edges_[k].information.cwiseProduct(predicted(k)).sum();
      if (link.guessed) continue;
      if (!link.loop) {
        odometry_square += square;
        odometry_redundancy += redundancy;
      } else if (weight_of(square, phi) >= kRejectedWeight && redundancy > 0.1) {
        of_loops.push_back(square / redundancy);
        loop_redundancy += redundancy;
      }
    }
    const auto estimate = [&](double sigma, double square, double redundancy) {
      const double variance = (kPrior * prior * prior + sigma * sigma * square) / (kPrior + redundancy);
      return std::max(1.0, std::sqrt(variance));
    };
    const double of_loop = of_loops.empty() ? 0 : median(of_loops) / kMedian;
    return {.odometry = estimate(before.odometry, odometry_square, odometry_redundancy),
            .loop = estimate(before.loop, loop_redundancy * of_loop, loop_redundancy)};
  }

 private:
  int unknown_i(size_t k) const { return unknowns_.of_node[links_[active_[k]].i]; }
  int unknown_j(size_t k) const { return unknowns_.of_node[links_[active_[k]].j]; }

  // Covariance of what the poses predict of a link.
  Matrix6d predicted(size_t k) const {
    const int i = unknown_i(k), j = unknown_j(k);
    const auto& [by_i, by_j] = edges_[k].by;
    Matrix6d result = Matrix6d::Zero();
    if (i >= 0) result += by_i * inverse_.diagonal[i] * by_i.transpose();
    if (j >= 0) result += by_j * inverse_.diagonal[j] * by_j.transpose();
    if (i < 0 || j < 0) return result;
    const Matrix6d cross = by_i * inverse_.pairs[k] * by_j.transpose();
    return result + cross + cross.transpose();
  }

  const std::vector<Link>& links_;
  std::vector<int> active_;
  const Unknowns& unknowns_;
  std::vector<LinearEdge> edges_;  // of the active links
  std::vector<double> squares_;    // their squared Mahalanobis distances
  BlockCholesky<6>::Inverse inverse_;
};

struct Solution {
  std::vector<Pose> poses;
  std::vector<char> fits;       // links that took part; the other loops contradict
  std::vector<double> squares;  // Mahalanobis distances; infinite between components
  double cost = 0;              // of all links within components
  int iterations = 0;
  bool converged = false;
};

// Minimises from given poses over the links that fit, leaves out loops that have no say (they cost time) and takes in
// those that fit after all, until nothing changes.
Solution settle(const std::vector<Link>& links, const std::vector<char>& inside, const Unknowns& unknowns,
                std::vector<char> fits, std::vector<Pose> poses, double first_phi, const LoopOptions& options,
                const std::function<bool()>& stopped) {
  const double phi = options.max_chi_square;
  Solution solution{.poses = std::move(poses), .fits = std::move(fits)};
  constexpr int kMaxRounds = 3;
  for (int round = 0; round < kMaxRounds; ++round) {
    GraphProblem problem(links, indices_of(solution.fits), unknowns, solution.poses);
    solution.converged =
        problem.run(round == 0 ? first_phi : phi, phi, options.max_iterations, stopped, solution.iterations);
    solution.squares.assign(links.size(), std::numeric_limits<double>::infinity());
    solution.cost = 0;
    bool changed = false;
    for (size_t k = 0; k < links.size(); ++k) {
      if (!inside[k]) continue;
      const double square = solution.squares[k] = square_of(links[k], solution.poses);
      solution.cost += links[k].loop ? robust(square, phi) : square;
      if (!links[k].loop || round + 1 == kMaxRounds) continue;
      const char fit = weight_of(square, phi) > (solution.fits[k] ? 1e-3 : kRejectedWeight);
      changed = changed || fit != solution.fits[k];
      solution.fits[k] = fit;
    }
    if (!changed) break;
  }
  return solution;
}

}  // namespace

RefinedGraph refine(const PoseGraph& graph, const LoopOptions& options, const std::function<bool()>& stopped) {
  const int count = static_cast<int>(graph.nodes.size());
  Sigmas sigmas{.odometry = options.sigma, .loop = options.sigma};
  std::vector<Link> links = links_of(graph, sigmas, options);
  const double phi = options.max_chi_square;
  const double max_gate = 4 * phi;  // covariances are first order and errors have tails: twice the distance

  // Odometry alone, then with the loops that join sub-maps.
  Forest forest(graph, links);
  forest.grow([&](int k) { return !links[k].loop; });
  const std::vector<int> joining = joining_links(forest, links, max_gate, options.min_joining_loops);
  if (!joining.empty()) {
    std::vector<bool> joins(links.size(), false);
    for (const int k : joining) joins[k] = true;
    forest.grow([&](int k) { return !links[k].loop || joins[k]; });
  }
  Unknowns unknowns{.of_node = std::vector<int>(static_cast<size_t>(count), -1)};
  std::vector<Pose> poses(static_cast<size_t>(count));
  std::vector<int> sizes(static_cast<size_t>(forest.trees()), 0);
  for (int node = 0; node < count; ++node) {
    poses[node] = forest.pose(node);
    if (sizes[forest.tree(node)]++ > 0) unknowns.of_node[node] = unknowns.count++;
  }

  // Loops that the drift of the odometry explains.
  std::vector<char> inside(links.size()), fits(links.size());
  parallel_chunks(0, static_cast<int>(links.size()), 16, [&](int begin, int end) {
    for (int k = begin; k < end; ++k) {
      inside[k] = forest.tree(links[k].i) == forest.tree(links[k].j);
      fits[k] = inside[k] && (!links[k].loop || forest.disagreement(links[k]) < max_gate);
    }
  });
  const std::vector<int> active = indices_of(fits);
  std::vector<Pose> relaxed = poses;
  if (relax(links, active, unknowns, relaxed) &&
      cost_of(links, active, relaxed, phi) < cost_of(links, active, poses, phi)) {
    poses = std::move(relaxed);
  }

  // All loops have their full say at first. If some lose it, they may have been wrong from the start and have led
  // astray: a second attempt in which half of the loops has it.
  std::vector<double> of_loops;
  for (const int k : active) {
    if (links[k].loop) of_loops.push_back(square_of(links[k], poses));
  }
  const double largest = of_loops.empty() ? 0 : *std::max_element(of_loops.begin(), of_loops.end());
  Solution solution = settle(links, inside, unknowns, fits, poses, std::max(phi, largest), options, stopped);
  int iterations = solution.iterations;
  if (solution.fits != fits) {
    const double typical = of_loops.empty() ? 0 : median(of_loops);
    Solution second = settle(links, inside, unknowns, fits, poses, std::max(phi, 4 * typical), options, stopped);
    iterations += second.iterations;
    if (second.cost < solution.cost) solution = std::move(second);
  }

  // What the loops say of the motions' errors changes weights, and these what they say.
  constexpr int kMaxRounds = 6;
  constexpr double kSame = 0.02;
  std::optional<Linearised> linearised;
  for (int round = 0;; ++round) {
    linearised.emplace(links, indices_of(solution.fits), unknowns, solution.poses, phi);
    if (!options.estimate_sigma || round == kMaxRounds) break;
    const Sigmas next = linearised->sigmas(sigmas, options.sigma, phi);
    if (std::abs(next.odometry / sigmas.odometry - 1) < kSame && std::abs(next.loop / sigmas.loop - 1) < kSame) break;
    sigmas = next;
    links = links_of(graph, sigmas, options);
    solution =
        settle(links, inside, unknowns, std::move(solution.fits), std::move(solution.poses), phi, options, stopped);
    iterations += solution.iterations;
  }

  RefinedGraph result{.graph = graph,
                      .odometry_sigma = sigmas.odometry,
                      .loop_sigma = sigmas.loop,
                      .iterations = iterations,
                      .converged = solution.converged};
  for (size_t k = 0; k < links.size(); ++k) {
    result.edge_error.push_back(std::sqrt(solution.squares[k]));
    result.edge_weight.push_back(links[k].loop ? weight_of(solution.squares[k], phi) : 1);
  }
  std::vector<int> order(sizes.size()), submap(sizes.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return sizes[a] > sizes[b]; });
  for (size_t k = 0; k < order.size(); ++k) submap[order[k]] = static_cast<int>(k);
  result.covariance.assign(static_cast<size_t>(count), Matrix6d::Zero());
  for (int node = 0; node < count; ++node) {
    PoseNode& refined = result.graph.nodes[node];
    refined.submap = submap[forest.tree(node)];
    const int at = unknowns.of_node[node];
    if (at < 0) continue;
    refined.world_from_cam = solution.poses[node];
    refined.world_from_cam.linear() = nearest_rotation(solution.poses[node].linear());
    result.covariance[node] = linearised->covariances()[at];
  }
  return result;
}

Eigen::MatrixXd joint_covariance(const PoseGraph& graph, const std::vector<int>& frames) {
  IRIS_CHECK(!frames.empty());
  std::unordered_map<int, const PoseNode*> node_of_frame;
  for (const PoseNode& node : graph.nodes) node_of_frame[node.frame_idx] = &node;
  const int submap = node_of_frame.at(frames.front())->submap;
  std::unordered_map<int, int> unknown_of_frame;
  for (const PoseNode& node : graph.nodes) {
    if (node.submap == submap) unknown_of_frame[node.frame_idx] = static_cast<int>(unknown_of_frame.size()) - 1;
  }
  std::vector<std::pair<int, int>> pairs;
  std::vector<LinearEdge> edges;
  for (const PoseEdge& edge : graph.edges) {
    const auto i = unknown_of_frame.find(edge.i), j = unknown_of_frame.find(edge.j);
    if (i == unknown_of_frame.end() || j == unknown_of_frame.end()) continue;
    pairs.emplace_back(i->second, j->second);
    const Pose& world_from_i = node_of_frame.at(edge.i)->world_from_cam;
    const Pose& world_from_j = node_of_frame.at(edge.j)->world_from_cam;
    edges.push_back(
        {.by = edge_jacobians(world_from_i, world_from_j, edge_residual(world_from_i, world_from_j, edge.i_from_j)),
         .information = edge.information});
  }
  const int unknowns = static_cast<int>(unknown_of_frame.size()) - 1;
  const auto wanted = static_cast<Eigen::Index>(6 * frames.size());
  if (unknowns == 0) return Eigen::MatrixXd::Zero(wanted, wanted);
  BlockCholesky<6> matrix = normal_matrix(unknowns, pairs, edges);
  if (!matrix.factorise()) return Eigen::MatrixXd::Constant(wanted, wanted, std::numeric_limits<double>::infinity());
  Eigen::MatrixXd right = Eigen::MatrixXd::Zero(6 * unknowns, wanted);
  for (size_t k = 0; k < frames.size(); ++k) {
    const int at = unknown_of_frame.at(frames[k]);
    if (at >= 0) right.block<6, 6>(6 * at, static_cast<Eigen::Index>(6 * k)).setIdentity();
  }
  return right.transpose() * matrix.solve(right);
}

}  // namespace iris::loop
