#include "iris/loop/odometry.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <random>

#include "iris/motion/minimise.h"
#include "support/numeric.h"

namespace iris::loop {
namespace {

Pose random_pose(std::mt19937& random, double shift, double turn) {
  std::normal_distribution<double> normal(0, 1);
  Vector6d step;
  for (int k = 0; k < 6; ++k) step(k) = (k < 3 ? shift : turn) * normal(random);
  return motion::perturbed(Pose::Identity(), step);
}

Matrix6d random_covariance(std::mt19937& random, double shift, double turn) {
  std::normal_distribution<double> normal(0, 1);
  Matrix6d m;
  for (double& v : m.reshaped()) v = normal(random);
  Matrix6d scale = Matrix6d::Zero();
  scale.diagonal() << shift, shift, shift, turn, turn, turn;
  return scale * (m * m.transpose() + Matrix6d::Identity()) * scale;
}

// Node k hangs on parents[k] (-1: none).
PoseGraph tree(const std::vector<int>& parents, std::mt19937& random) {
  PoseGraph graph;
  for (int k = 0; k < static_cast<int>(parents.size()); ++k) {
    PoseNode node{.frame_idx = 3 * k, .world_from_cam = random_pose(random, 2, 1), .submap = parents[k] < 0 ? k : 0};
    if (parents[k] >= 0) {
      const Pose step = random_pose(random, 0.5, 0.3);
      node.world_from_cam = graph.nodes[static_cast<size_t>(parents[k])].world_from_cam * step;
      graph.edges.push_back({.i = 3 * parents[k],
                             .j = 3 * k,
                             .i_from_j = step,
                             .information = random_covariance(random, 1e-3, 1e-3).inverse()});
    }
    graph.nodes.push_back(node);
  }
  return graph;
}

LoopOptions plain() { return {.sigma = 1, .drift = 0, .turn_drift = 0}; }

TEST(Twists, TakeAMotionsCovarianceToTheOneOfItsTwistAndBack) {
  std::mt19937 random(1);
  const Pose pose = random_pose(random, 3, 1);
  const Matrix6d covariance = random_covariance(random, 0.1, 0.02);
  // The perturbation (dt, dw) moves the pose by the twist of perturbed(pose) * pose^-1.
  const Eigen::MatrixXd jacobian = testing::numeric_jacobian(
      [&](const Eigen::VectorXd& x) -> Eigen::VectorXd {
        return twist_of(motion::perturbed(pose, x) * pose.inverse());
      },
      Eigen::VectorXd::Zero(6), 1e-6);
  EXPECT_TRUE(twist_covariance(pose, covariance).isApprox(jacobian * covariance * jacobian.transpose(), 1e-6));
  EXPECT_TRUE(motion_covariance(pose, twist_covariance(pose, covariance)).isApprox(covariance, 1e-12));
}

TEST(Twists, AreTakenToAnotherFrameByTheAdjoint) {
  std::mt19937 random(2);
  const Pose b_from_a = random_pose(random, 3, 1);
  const Eigen::MatrixXd jacobian = testing::numeric_jacobian(
      [&](const Eigen::VectorXd& x) -> Eigen::VectorXd {
        return twist_of(b_from_a * motion::perturbed(Pose::Identity(), x) * b_from_a.inverse());
      },
      Eigen::VectorXd::Zero(6), 1e-6);
  EXPECT_TRUE(adjoint(b_from_a).isApprox(jacobian, 1e-6));
}

// The covariance of the way between all pairs of nodes of a tree against a chain of edges put together one by one.
TEST(Odometry, AgreesWithTheChainOfEdges) {
  std::mt19937 random(3);
  std::vector<int> parents{-1};
  for (int k = 1; k < 40; ++k) parents.push_back(k % 7 == 0 ? k - 4 : k - 1);
  parents[30] = -1;  // a second tree: 30 and what hangs on it
  const PoseGraph graph = tree(parents, random);
  const Odometry odometry(graph, plain());
  std::vector<const PoseEdge*> edge_of(parents.size(), nullptr);
  for (const PoseEdge& e : graph.edges) edge_of[static_cast<size_t>(e.j / 3)] = &e;
  const auto way_up = [&](int k) {
    std::vector<int> way{k};
    while (parents[way.back()] >= 0) way.push_back(parents[way.back()]);
    return way;
  };
  int joined = 0;
  for (int i = 0; i < 40; ++i) {
    for (int j = 0; j < 40; ++j) {
      const auto found = odometry.between(3 * i, 3 * j);
      const std::vector<int> up_i = way_up(i), up_j = way_up(j);
      ASSERT_EQ(found.has_value(), up_i.back() == up_j.back()) << i << " " << j;
      if (!found) continue;
      ++joined;
      // Down to i's frame: every edge that lies on one of the two ways to the root, but not on both.
      Matrix6d covariance = Matrix6d::Zero();
      double path = 0;
      const Pose i_from_world = graph.nodes[static_cast<size_t>(i)].world_from_cam.inverse();
      for (int k = 0; k < 40; ++k) {
        const bool on_i = std::count(up_i.begin(), up_i.end(), k) > 0,
                   on_j = std::count(up_j.begin(), up_j.end(), k) > 0;
        if (on_i == on_j) continue;
        const PoseEdge& e = *edge_of[k];
        const Matrix6d to_i = adjoint(i_from_world * graph.nodes[static_cast<size_t>(parents[k])].world_from_cam);
        covariance += to_i * twist_covariance(e.i_from_j, e.information.inverse()) * to_i.transpose();
        path += e.i_from_j.translation().norm();
      }
      EXPECT_NEAR((found->covariance - covariance).norm(), 0, 1e-9 * covariance.norm() + 1e-13) << i << " " << j;
      EXPECT_NEAR(found->path, path, 1e-9);
      const Pose direct = i_from_world * graph.nodes[static_cast<size_t>(j)].world_from_cam;
      EXPECT_TRUE(found->i_from_j.isApprox(direct, 1e-12));
    }
  }
  EXPECT_GT(joined, 800);
}

// Errors drawn for every edge scatter the end of a chain as the covariance says.
TEST(Odometry, PredictsTheScatterOfAChainsEnd) {
  std::mt19937 random(4);
  std::vector<int> parents{-1};
  for (int k = 1; k < 30; ++k) parents.push_back(k - 1);
  const PoseGraph graph = tree(parents, random);
  const auto predicted = Odometry(graph, plain()).between(0, 87);
  const Eigen::LDLT<Matrix6d> solver(predicted->covariance);
  std::normal_distribution<double> normal(0, 1);
  constexpr int kTrials = 1000;
  double sum = 0;
  for (int trial = 0; trial < kTrials; ++trial) {
    Pose end = Pose::Identity();
    for (const PoseEdge& e : graph.edges) {
      Vector6d noise;
      for (double& v : noise) v = normal(random);
      const Matrix6d covariance = e.information.inverse();
      end = end * motion::perturbed(e.i_from_j, Eigen::LLT<Matrix6d>(covariance).matrixL() * noise);
    }
    const Vector6d error = twist_of(end * predicted->i_from_j.inverse());
    sum += error.dot(solver.solve(error));
  }
  // The mean of a chi-square of six degrees of freedom: four standard deviations of the mean are 4 sqrt(12 / 1000).
  EXPECT_NEAR(sum / kTrials, 6, 0.44);
}

TEST(Odometry, IsInflatedAndDriftsWithTheWay) {
  std::mt19937 random(5);
  const PoseGraph graph = tree({-1, 0, 1, 2}, random);
  const auto without = Odometry(graph, plain()).between(0, 9);
  LoopOptions options = plain();
  options.sigma = 3;
  options.drift = 0.1;
  options.turn_drift = 180 / M_PI;
  const auto with = Odometry(graph, options).between(0, 9);
  Matrix6d expected = 9 * without->covariance;
  expected.diagonal().head<3>().array() += 0.01 * without->path * without->path;
  expected.diagonal().tail<3>().array() += without->path * without->path;
  EXPECT_TRUE(with->covariance.isApprox(expected, 1e-9));
  EXPECT_GT(Odometry(graph, options).position_error(9), Odometry(graph, plain()).position_error(9));
  EXPECT_EQ(Odometry(graph, options).position_error(0), 0);
}

TEST(Odometry, IgnoresLoops) {
  std::mt19937 random(6);
  PoseGraph graph = tree({-1, 0, 1, -1}, random);
  const auto without = Odometry(graph, plain()).between(0, 6);
  graph.edges.push_back({.i = 0, .j = 6, .kind = PoseEdgeKind::loop});
  graph.edges.push_back({.i = 0, .j = 9, .kind = PoseEdgeKind::loop});
  const Odometry odometry(graph, plain());
  EXPECT_EQ(odometry.between(0, 6)->covariance, without->covariance);
  EXPECT_FALSE(odometry.between(0, 9).has_value());
}

}  // namespace
}  // namespace iris::loop
