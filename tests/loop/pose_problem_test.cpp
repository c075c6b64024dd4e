#include "src/loop/pose_problem.h"

#include <ceres/gradient_checker.h>
#include <ceres/manifold_test_utils.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iris/core/error.h"
#include "iris/loop/pose_graph.h"
#include "iris/loop/twist.h"
#include "iris/motion/minimise.h"
#include "support/numeric.h"
#include "support/pose_graphs.h"

namespace iris::loop {
namespace {

using iris::testing::numeric_jacobian;
using iris::testing::PoseGraphMaker;
using motion::perturbed;

Pose some_pose(PoseGraphMaker& maker) { return perturbed(Pose::Identity(), maker.normals()); }

TEST(PoseManifold, PlusAndMinusAreInverse) {
  PoseGraphMaker maker(1);
  const PoseManifold manifold;
  for (const double scale : {0.0, 1e-7, 0.01, 0.8}) {
    const Pose x = some_pose(maker);
    const Vector6d step = scale * maker.normals();
    Pose moved;
    ASSERT_TRUE(manifold.Plus(x.data(), step.data(), moved.data()));
    EXPECT_EQ(moved.matrix(), screwed(x, step).matrix());
    Vector6d back;
    ASSERT_TRUE(manifold.Minus(moved.data(), x.data(), back.data()));
    EXPECT_LT((back - step).norm(), 1e-9);
    const Pose y = some_pose(maker);
    ASSERT_TRUE(manifold.Minus(y.data(), x.data(), back.data()));
    ASSERT_TRUE(manifold.Plus(x.data(), back.data(), moved.data()));
    EXPECT_LT((moved.matrix() - y.matrix()).norm(), 1e-9);
  }
}

TEST(PoseManifold, DerivativesAreThoseOfCentralDifferences) {
  PoseGraphMaker maker(2);
  const PoseManifold manifold;
  const Pose x = some_pose(maker);
  Eigen::Matrix<double, kPoseNumbers, 6, Eigen::RowMajor> plus;
  Eigen::Matrix<double, 6, kPoseNumbers, Eigen::RowMajor> minus;
  ASSERT_TRUE(manifold.PlusJacobian(x.data(), plus.data()));
  ASSERT_TRUE(manifold.MinusJacobian(x.data(), minus.data()));
  const auto moved = [&](const Eigen::VectorXd& step) -> Eigen::VectorXd {
    return screwed(x, step).matrix().reshaped();
  };
  EXPECT_LT((plus - numeric_jacobian(moved, Vector6d::Zero(), 1e-5)).norm(), 1e-9);
  EXPECT_LT((minus * plus - Matrix6d::Identity()).norm(), 1e-14);
  EXPECT_EQ(minus, step_from_numbers(x));
}

TEST(EdgeCost, IsTheResidualInStandardDeviations) {
  PoseGraphMaker maker(3);
  const Pose i = some_pose(maker), j = some_pose(maker);
  const Pose measured = perturbed(i.inverse() * j, 0.3 * maker.normals());
  const Matrix6d information = maker.covariance(0.1, 0.05).inverse();
  const EdgeCost cost(measured, information);
  const double* const parameters[] = {i.data(), j.data()};
  Vector6d residual;
  ASSERT_TRUE(cost.Evaluate(parameters, residual.data(), nullptr));
  const Vector6d plain = edge_residual(i, j, measured);
  EXPECT_NEAR(residual.squaredNorm(), plain.dot(information * plain), 1e-9 * residual.squaredNorm());

  const PoseManifold manifold;
  const std::vector<const ceres::Manifold*> manifolds = {&manifold, &manifold};
  ceres::GradientChecker checker(&cost, &manifolds, ceres::NumericDiffOptions());
  ceres::GradientChecker::ProbeResults probe;
  EXPECT_TRUE(checker.Probe(parameters, 1e-6, &probe)) << probe.error_log;
}

// Of one unknown position between two others it is the weighted mean; asked to stop, it throws.
TEST(Minimise, StopsWhenAsked) {
  Pose a = Pose::Identity(), b = Pose::Identity(), step = Pose::Identity();
  step.translation().x() = 1;
  PoseManifold manifold;
  for (const bool stop : {false, true}) {
    ceres::Problem problem(lent());
    problem.AddParameterBlock(a.data(), kPoseNumbers, &manifold);
    problem.AddParameterBlock(b.data(), kPoseNumbers, &manifold);
    problem.SetParameterBlockConstant(a.data());
    problem.AddResidualBlock(new EdgeCost(step, Matrix6d::Identity()), nullptr, a.data(), b.data());
    step.translation().x() = 3;
    problem.AddResidualBlock(new EdgeCost(step, 3 * Matrix6d::Identity()), nullptr, a.data(), b.data());
    const std::function<bool()> stopped = [&] { return stop; };
    Watch watch(stopped);
    watch.rest = 1e-12;
    int iterations = 0;
    const auto run = [&] {
      return minimise(problem, near_the_minimum(ceres::SPARSE_NORMAL_CHOLESKY), watch, 10, iterations);
    };
    if (stop) {
      EXPECT_THROW(run(), Interrupted);
    } else {
      EXPECT_TRUE(run());
      EXPECT_NEAR(b.translation().x(), 2.5, 1e-9);
      EXPECT_GE(iterations, 1);
      EXPECT_LE(iterations, 4);
    }
    step.translation().x() = 1;
  }
}

}  // namespace
}  // namespace iris::loop
