#include "iris/loop/pose_graph.h"

#include <ceres/ceres.h>
#include <ceres/rotation.h>
#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <cmath>

#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "support/numeric.h"
#include "support/pose_graphs.h"

namespace iris::loop {
namespace {

using iris::testing::numeric_jacobian;
using iris::testing::PoseGraphExample;
using iris::testing::PoseGraphMaker;
using iris::testing::position_error;
using motion::perturbed;

// The noise of these graphs is drawn from their covariances.
LoopOptions exact_noise() { return {.sigma = 1, .estimate_sigma = false}; }

Pose some_pose(PoseGraphMaker& maker, double scale) { return perturbed(Pose::Identity(), scale * maker.normals()); }

// Error of a refined pose as a perturbation of the truth's kind.
Vector6d error_of(const Pose& estimate, const Pose& truth) {
  const Eigen::AngleAxisd turn(truth.linear() * estimate.linear().transpose());
  Vector6d error;
  error << truth.translation() - estimate.translation(), turn.angle() * turn.axis();
  return error;
}

// Root mean square position error that the covariances let expect [m]. Errors of one graph go together: a single graph
// may well be off by twice that.
double expected_error(const RefinedGraph& refined) {
  double sum = 0;
  for (const Matrix6d& covariance : refined.covariance) sum += covariance.topLeftCorner<3, 3>().trace();
  return std::sqrt(sum / static_cast<double>(refined.covariance.size()));
}

TEST(EdgeResidual, IsThePerturbationThatTakesTheMeasuredToThePredictedMotion) {
  PoseGraphMaker maker(1);
  for (int n = 0; n < 20; ++n) {
    const Pose i = some_pose(maker, 1), j = some_pose(maker, 1);
    const Vector6d error = 0.5 * maker.normals();
    const Pose predicted = i.inverse() * j;
    Pose measured;  // perturbed(measured, error) = predicted
    measured.translation() = predicted.translation() - error.head<3>();
    measured.linear() = perturbed(Pose::Identity(), error).linear().transpose() * predicted.linear();
    EXPECT_LT((edge_residual(i, j, measured) - error).norm(), 1e-12);
  }
}

TEST(EdgeResidual, JacobiansAreThoseOfCentralDifferences) {
  PoseGraphMaker maker(2);
  for (const double scale : {0.0, 1e-6, 0.3, 1.2}) {
    const Pose i = some_pose(maker, 1), j = some_pose(maker, 1);
    const Pose measured = perturbed(i.inverse() * j, scale * maker.normals());
    const EdgeJacobians jacobians = edge_jacobians(i, j, edge_residual(i, j, measured));
    const auto by_i = [&](const Eigen::VectorXd& x) { return edge_residual(perturbed(i, x), j, measured); };
    const auto by_j = [&](const Eigen::VectorXd& x) { return edge_residual(i, perturbed(j, x), measured); };
    EXPECT_LT((jacobians.by_i - numeric_jacobian(by_i, Vector6d::Zero(), 1e-5)).norm(), 1e-8) << scale;
    EXPECT_LT((jacobians.by_j - numeric_jacobian(by_j, Vector6d::Zero(), 1e-5)).norm(), 1e-8) << scale;
  }
}

// Nodes on a line without rotation: weighted means, known in closed form.
TEST(Refine, WeighsALoopAgainstOdometryByTheirVariances) {
  PoseGraph graph;
  for (int n = 0; n < 3; ++n) graph.nodes.push_back({.frame_idx = 10 * n});
  const auto edge = [](int i, int j, double x, double sigma, PoseEdgeKind kind) {
    Pose pose = Pose::Identity();
    pose.translation().x() = x;
    // Rotations are certain, so that the chain stays a line.
    Vector6d information;
    information << Eigen::Vector3d::Constant(1 / (sigma * sigma)), Eigen::Vector3d::Constant(1e12);
    return PoseEdge{i, j, pose, information.asDiagonal(), kind};
  };
  graph.edges = {edge(0, 10, 1, 0.1, PoseEdgeKind::odometry), edge(10, 20, 1, 0.1, PoseEdgeKind::odometry),
                 edge(0, 20, 2.1, 0.05, PoseEdgeKind::loop)};
  const RefinedGraph refined = refine(graph, exact_noise());
  EXPECT_TRUE(refined.converged);
  // Variance of the two steps together 0.02, of the loop 0.0025.
  const double last = (2 / 0.02 + 2.1 / 0.0025) / (1 / 0.02 + 1 / 0.0025);
  EXPECT_NEAR(refined.graph.nodes[2].world_from_cam.translation().x(), last, 1e-9);
  EXPECT_NEAR(refined.graph.nodes[1].world_from_cam.translation().x(), last / 2, 1e-9);
  EXPECT_NEAR(refined.covariance[2](0, 0), 1 / (1 / 0.02 + 1 / 0.0025), 1e-9);
  EXPECT_EQ(refined.covariance[0], Matrix6d::Zero());
  EXPECT_NEAR(refined.edge_error[2], (2.1 - last) / 0.05, 1e-6);
  EXPECT_EQ(refined.edge_weight, (std::vector<double>{1, 1, 1}));
  // All variances four times as large.
  LoopOptions options = exact_noise();
  options.sigma = 2;
  const RefinedGraph wider = refine(graph, options);
  EXPECT_NEAR(wider.graph.nodes[2].world_from_cam.translation().x(), last, 1e-9);
  EXPECT_NEAR(wider.covariance[2](0, 0), 4 * refined.covariance[2](0, 0), 1e-9);
  EXPECT_NEAR(wider.edge_error[2], 0.5 * refined.edge_error[2], 1e-6);
  // Without the loop: odometry as it is.
  graph.edges.pop_back();
  const RefinedGraph open = refine(graph, exact_noise());
  EXPECT_NEAR(open.graph.nodes[2].world_from_cam.translation().x(), 2, 1e-12);
  EXPECT_NEAR(open.covariance[2](0, 0), 0.02, 1e-9);
}

// A loop far beyond the limit: dynamic covariance scaling, solved here by hand for one unknown.
TEST(Refine, BoundsTheInfluenceOfAWrongLoop) {
  PoseGraph graph;
  graph.nodes = {{.frame_idx = 0}, {.frame_idx = 1}};
  graph.nodes[1].world_from_cam.translation().x() = 1;
  graph.edges = {{0, 1, graph.nodes[1].world_from_cam, 1e4 * Matrix6d::Identity(), PoseEdgeKind::odometry}};
  Pose wrong = Pose::Identity();
  wrong.translation().x() = 9;
  graph.edges.push_back({0, 1, wrong, 1e4 * Matrix6d::Identity(), PoseEdgeKind::loop});
  const RefinedGraph refined = refine(graph, exact_noise());
  const double x = refined.graph.nodes[1].world_from_cam.translation().x();
  EXPECT_NEAR(x, 1, 1e-6);
  EXPECT_NEAR(refined.edge_error[1], 100 * (9 - x), 1e-6);
  const double s = 2 * 22.5 / (22.5 + 1e4 * (9 - x) * (9 - x));
  EXPECT_NEAR(refined.edge_weight[1], s * s, 1e-9);
  EXPECT_LT(refined.edge_weight[1], kRejectedWeight);
}

// An independent solver on the same sum of squares.
struct CeresEdge {
  template <class T>
  bool operator()(const T* ti, const T* qi, const T* tj, const T* qj, T* residual) const {
    using Q = Eigen::Quaternion<T>;
    using V = Eigen::Matrix<T, 3, 1>;
    const Q a(Eigen::Map<const Q>{qi}), b(Eigen::Map<const Q>{qj});
    Eigen::Matrix<T, 6, 1> e;
    e.template head<3>() =
        a.conjugate() * (Eigen::Map<const V>(tj) - Eigen::Map<const V>(ti)) - edge.i_from_j.translation().cast<T>();
    const Q turn = a.conjugate() * b * Eigen::Quaterniond(edge.i_from_j.linear()).conjugate().cast<T>();
    const T q[4] = {turn.w(), turn.x(), turn.y(), turn.z()};
    ceres::QuaternionToAngleAxis(q, e.data() + 3);
    Eigen::Map<Eigen::Matrix<T, 6, 1>> result(residual);
    result = edge.information.llt().matrixU().toDenseMatrix().cast<T>() * e;
    return true;
  }
  PoseEdge edge;
};

TEST(Refine, FindsTheMinimumThatCeresFinds) {
  PoseGraphMaker maker(3);
  const PoseGraphExample example = maker.walk(150, 60, 6);
  const RefinedGraph refined = refine(example.graph, exact_noise());
  std::vector<Eigen::Quaterniond> q;
  std::vector<Eigen::Vector3d> t;
  for (const PoseNode& node : example.graph.nodes) {
    q.emplace_back(node.world_from_cam.linear());
    t.push_back(node.world_from_cam.translation());
  }
  ceres::Problem problem;
  for (const PoseEdge& edge : example.graph.edges) {
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<CeresEdge, 6, 3, 4, 3, 4>(new CeresEdge{edge}), nullptr,
                             t[edge.i / 3].data(), q[edge.i / 3].coeffs().data(), t[edge.j / 3].data(),
                             q[edge.j / 3].coeffs().data());
  }
  for (auto& rotation : q) problem.SetManifold(rotation.coeffs().data(), new ceres::EigenQuaternionManifold);
  problem.SetParameterBlockConstant(t[0].data());
  problem.SetParameterBlockConstant(q[0].coeffs().data());
  ceres::Solver::Options options;
  options.max_num_iterations = 200;
  options.function_tolerance = 1e-14;
  options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  double sum = 0;
  for (const double error : refined.edge_error) sum += error * error;
  EXPECT_NEAR(sum, 2 * summary.final_cost, 1e-5 * sum);
  for (size_t n = 0; n < t.size(); ++n) {
    const Pose& pose = refined.graph.nodes[n].world_from_cam;
    EXPECT_LT((pose.translation() - t[n]).norm(), 1e-5);  // a hundredth of the uncertainty
    EXPECT_LT(Eigen::Quaterniond(pose.linear()).angularDistance(q[n]), 1e-5);
  }
}

// Normalised squared errors follow a chi-square distribution: of n independent graphs, each node's sum has mean 6 n.
TEST(Refine, CovariancesAreThoseOfTheErrors) {
  constexpr int kGraphs = 40, kNodes = 300;
  double sum = 0, odometry = 0, end = 0;
  for (int k = 0; k < kGraphs; ++k) {
    PoseGraphMaker maker(100 + k);
    const PoseGraphExample example = maker.walk(kNodes, 60, 10);
    const RefinedGraph refined = refine(example.graph, exact_noise());
    EXPECT_TRUE(refined.converged);
    odometry += position_error(example.graph, example.truth);
    end += position_error(refined.graph, example.truth);
    // Nodes of one graph depend on each other: one node a graph.
    const int n = 50 + 5 * k;
    const Vector6d error = error_of(refined.graph.nodes[n].world_from_cam, example.truth[n]);
    sum += error.dot(refined.covariance[n].ldlt().solve(error));
  }
  // 95 % of the chi-square distribution with 240 degrees of freedom.
  EXPECT_GT(sum, 199.0);
  EXPECT_LT(sum, 284.8);
  EXPECT_LT(end, 0.5 * odometry);
}

TEST(Refine, CovariancesAreBlocksOfTheDenseInverse) {
  PoseGraphMaker maker(4);
  const PoseGraphExample example = maker.walk(60, 25, 4);
  const RefinedGraph refined = refine(example.graph, exact_noise());
  const int n = static_cast<int>(example.truth.size());
  Eigen::MatrixXd hessian = Eigen::MatrixXd::Zero(6 * n, 6 * n);
  for (const PoseEdge& edge : refined.graph.edges) {
    const int i = edge.i / 3, j = edge.j / 3;
    const Pose &pi = refined.graph.nodes[i].world_from_cam, &pj = refined.graph.nodes[j].world_from_cam;
    Eigen::MatrixXd row = Eigen::MatrixXd::Zero(6, 6 * n);
    const EdgeJacobians jacobians = edge_jacobians(pi, pj, edge_residual(pi, pj, edge.i_from_j));
    row.middleCols<6>(6 * i) = jacobians.by_i;
    row.middleCols<6>(6 * j) = jacobians.by_j;
    hessian += row.transpose() * edge.information * row;
  }
  const Eigen::MatrixXd inverse = hessian.bottomRightCorner(6 * n - 6, 6 * n - 6).inverse();
  for (int k = 1; k < n; ++k) {
    const Eigen::MatrixXd block = inverse.block<6, 6>(6 * k - 6, 6 * k - 6);
    EXPECT_LT((refined.covariance[k] - block).norm(), 1e-6 * block.norm()) << k;
  }
}

// One wrong loop for every five true ones changes next to nothing.
TEST(Refine, WrongLoopsChangeLittle) {
  double clean = 0, spoilt = 0;
  for (unsigned seed = 0; seed < 10; ++seed) {
    PoseGraphMaker maker(seed);
    PoseGraphExample example = maker.walk(600, 50, 14);
    const double without = position_error(refine(example.graph, exact_noise()).graph, example.truth);
    const size_t good = example.graph.edges.size();
    maker.add_wrong_loops(example, 10);
    const RefinedGraph refined = refine(example.graph, exact_noise());
    const double with = position_error(refined.graph, example.truth);
    EXPECT_LT(with, 1.1 * without) << seed;
    clean += without;
    spoilt += with;
    for (size_t k = good; k < example.graph.edges.size(); ++k) EXPECT_LT(refined.edge_weight[k], kRejectedWeight);
    for (size_t k = 0; k < good; ++k) EXPECT_GT(refined.edge_weight[k], kRejectedWeight);
  }
  EXPECT_LT(spoilt, 1.02 * clean);
}

// The frames of a graph in `parts` equal parts that odometry does not connect: sub-maps, each with its own world.
PoseGraph cut(const PoseGraphExample& example, int parts) {
  PoseGraph graph = example.graph;
  const int count = static_cast<int>(graph.nodes.size());
  const auto part_of = [&](int frame_idx) { return frame_idx / 3 * parts / count; };
  std::vector<Pose> first(static_cast<size_t>(parts));
  for (int n = count - 1; n >= 0; --n) first[part_of(3 * n)] = graph.nodes[n].world_from_cam;
  for (PoseNode& node : graph.nodes) {
    node.submap = part_of(node.frame_idx);
    node.world_from_cam = first[node.submap].inverse() * node.world_from_cam;
  }
  std::erase_if(graph.edges, [&](const PoseEdge& edge) {
    return edge.kind == PoseEdgeKind::odometry && part_of(edge.i) != part_of(edge.j);
  });
  return graph;
}

TEST(Refine, JoinsSubMapsThatLoopsConnect) {
  PoseGraphMaker maker(5);
  PoseGraphExample example = maker.walk(400, 80, 8);
  maker.add_wrong_loops(example, 16);
  example.graph = cut(example, 4);
  const RefinedGraph refined = refine(example.graph, exact_noise());
  for (const PoseNode& node : refined.graph.nodes) EXPECT_EQ(node.submap, 0);
  EXPECT_LT(position_error(refined.graph, example.truth), 2.5 * expected_error(refined));
}

TEST(Refine, DoesNotJoinByASingleOrContradictingLoops) {
  PoseGraphMaker maker(6);
  PoseGraphExample example = maker.walk(300, 0, 8);
  example.graph = cut(example, 3);
  const Pose far(Eigen::Translation3d(1, 0, 0));
  const Matrix6d covariance = maker.covariance(0.005, 0.002);
  // 0 and 1: three loops, each tells another relation. 1 and 2: a single one.
  for (const int k : {0, 1, 2}) {
    example.graph.edges.push_back(maker.measured(60 + 30 * k, 390 + 60 * k, Pose(Eigen::Translation3d(0, 4 * k, 0)),
                                                 PoseEdgeKind::loop, covariance));
  }
  example.graph.edges.push_back(maker.measured(450, 750, far, PoseEdgeKind::loop, covariance));
  const RefinedGraph refined = refine(example.graph, exact_noise());
  EXPECT_EQ(refined.graph.nodes.front().submap, 0);
  EXPECT_EQ(refined.graph.nodes[150].submap, 1);
  EXPECT_EQ(refined.graph.nodes.back().submap, 2);
  EXPECT_EQ(refined.edge_weight.back(), 0);
  EXPECT_TRUE(std::isinf(refined.edge_error.back()));
  // Trusting single ones joins the last two, to the largest sub-map.
  LoopOptions trusting = exact_noise();
  trusting.min_joining_loops = 1;
  example.graph.edges.erase(example.graph.edges.end() - 4, example.graph.edges.end() - 1);
  const RefinedGraph joined = refine(example.graph, trusting);
  EXPECT_EQ(joined.graph.nodes.front().submap, 1);
  EXPECT_EQ(joined.graph.nodes[150].submap, 0);
  EXPECT_EQ(joined.graph.nodes.back().submap, 0);
  // So does one of many correspondences.
  for (const int used : {74, 75}) {
    example.graph.edges.back().used = used;
    EXPECT_EQ(refine(example.graph, exact_noise()).edge_weight.back() > 0, used == 75);
  }
  // Each component's first node stays where it is.
  EXPECT_EQ(joined.graph.nodes[100].world_from_cam.matrix(), example.graph.nodes[100].world_from_cam.matrix());
}

// A guessed motion next to good ones gives way to a loop.
TEST(Refine, LoopsCorrectGuessedMotions) {
  PoseGraphMaker maker(7);
  PoseGraphExample example = maker.walk(200, 40, 6);
  PoseEdge& guessed = example.graph.edges[100];
  guessed.kind = PoseEdgeKind::guessed;
  guessed.information.setZero();
  guessed.i_from_j = Eigen::Translation3d(0.3, 0.2, -0.4) * guessed.i_from_j;
  const RefinedGraph refined = refine(example.graph, exact_noise());
  EXPECT_LT(position_error(refined.graph, example.truth), 2.5 * expected_error(refined));
}

TEST(Refine, DoesNotDependOnTheNumberOfThreads) {
  PoseGraphMaker maker(8);
  const PoseGraphExample example = maker.walk(800, 200, 12);
  RefinedGraph one, many;
  with_threads(1, [&] { one = refine(example.graph, {}); });
  with_threads(7, [&] { many = refine(example.graph, {}); });
  for (size_t n = 0; n < example.truth.size(); ++n) {
    ASSERT_EQ(one.graph.nodes[n].world_from_cam.matrix(), many.graph.nodes[n].world_from_cam.matrix());
    ASSERT_EQ(one.covariance[n], many.covariance[n]);
  }
}

TEST(Refine, TakesEmptyAndSingleGraphs) {
  EXPECT_TRUE(refine({}, {}).graph.nodes.empty());
  PoseGraph graph;
  graph.nodes.push_back({.frame_idx = 7, .submap = 3});
  const RefinedGraph refined = refine(graph, {});
  EXPECT_EQ(refined.graph.nodes[0].submap, 0);
  EXPECT_EQ(refined.covariance.size(), 1u);
  graph.edges.push_back({.i = 7, .j = 8});
  EXPECT_THROW(refine(graph, {}), Bug);
}

// The cost of 10,000 nodes is that of a sparse factorisation, not of an inverse of 60,000 rows.
TEST(Refine, ScalesToTenThousandNodes) {
  PoseGraphMaker maker(9);
  const PoseGraphExample example = maker.walk(10000, 300, 60);
  const RefinedGraph refined = refine(example.graph, exact_noise());
  EXPECT_TRUE(refined.converged);
  EXPECT_LT(position_error(refined.graph, example.truth), 2.5 * expected_error(refined));
  for (const Matrix6d& covariance : refined.covariance) ASSERT_TRUE((covariance.diagonal().array() >= 0).all());
}

// Graphs whose covariances are wrong by known factors, one for odometry, one for loops: these are found, though one
// loop in seven is wrong, and the covariances of the poses become those of the errors.
TEST(Refine, FindsByHowMuchCovariancesAreWrong) {
  struct Case {
    double odometry, loop;
  };
  for (const auto& [odometry, loop] : {Case{1, 1}, Case{3, 3}, Case{4, 1.5}, Case{1.5, 4}}) {
    constexpr int kGraphs = 10;
    double sum = 0, odometry_sigma = 0, loop_sigma = 0;
    for (int k = 0; k < kGraphs; ++k) {
      PoseGraphMaker maker(500 + k);
      PoseGraphExample example = maker.walk(400, 200, 12);
      maker.add_wrong_loops(example, 33);
      for (PoseEdge& edge : example.graph.edges) {
        const double factor = edge.kind == PoseEdgeKind::loop ? loop : odometry;
        edge.information *= factor * factor;
      }
      const RefinedGraph refined = refine(example.graph, {});
      odometry_sigma += refined.odometry_sigma / kGraphs;
      loop_sigma += refined.loop_sigma / kGraphs;
      const int n = 30 + 35 * k;
      const Vector6d error = error_of(refined.graph.nodes[n].world_from_cam, example.truth[n]);
      sum += error.dot(refined.covariance[n].ldlt().solve(error));
    }
    // Of 200 loops, 1200 degrees of freedom are shared by both. What is assumed pulls by a few hundredths.
    EXPECT_NEAR(odometry_sigma, odometry, 0.08 * odometry) << odometry << " " << loop;
    EXPECT_NEAR(loop_sigma, loop, 0.08 * loop) << odometry << " " << loop;
    // 99 % of the chi-square distribution with 60 degrees of freedom.
    EXPECT_GT(sum, 35.5) << odometry << " " << loop;
    EXPECT_LT(sum, 92.0) << odometry << " " << loop;
  }
}

// Without loops nothing tells; a few of them do not outweigh what is assumed.
TEST(Refine, AssumesWhatNoLoopTells) {
  PoseGraphMaker maker(600);
  PoseGraphExample example = maker.walk(100, 1, 6);
  const RefinedGraph few = refine(example.graph, {});
  EXPECT_GT(few.odometry_sigma, 1.5);
  EXPECT_GT(few.loop_sigma, 1.5);
  std::erase_if(example.graph.edges, [](const PoseEdge& edge) { return edge.kind == PoseEdgeKind::loop; });
  const RefinedGraph none = refine(example.graph, {});
  EXPECT_NEAR(none.odometry_sigma, LoopOptions().sigma, 1e-9);
  EXPECT_NEAR(none.loop_sigma, LoopOptions().sigma, 1e-9);
}

TEST(Refine, StopsWhenAsked) {
  PoseGraphMaker maker(10);
  const PoseGraphExample example = maker.walk(50, 10, 6);
  int asked = 0;
  EXPECT_THROW(refine(example.graph, {}, [&] { return ++asked > 2; }), Interrupted);
  EXPECT_EQ(asked, 3);
}

TEST(LoopOptions, AreDeclared) {
  LoopOptions options;
  OptionSet set;
  options.declare(set);
  set.set("loop.sigma", "1.25");
  set.set("loop.min_joining_loops", "5");
  set.set("loop.estimate_sigma", "false");
  EXPECT_EQ(options.sigma, 1.25);
  EXPECT_EQ(options.min_joining_loops, 5);
  EXPECT_FALSE(options.estimate_sigma);
  set.validate();
}

}  // namespace
}  // namespace iris::loop
