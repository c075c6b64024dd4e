#include "iris/motion/minimise.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <random>

#include "support/numeric.h"

namespace iris::motion {
namespace {

const RectifiedCamera kCamera{.f = 436, .cx = 364, .cy = 257, .baseline = 0.11, .width = 752, .height = 480};

Pose some_motion() {
  Pose motion = Pose::Identity();
  motion.linear() = Eigen::AngleAxisd(0.2, Eigen::Vector3d(0.1, 1, -0.2).normalized()).toRotationMatrix();
  motion.translation() = Eigen::Vector3d(0.1, -0.05, 0.2);
  return motion;
}

Eigen::Vector3d measured(const Eigen::Vector3d& p, std::mt19937_64& random, double pixel_error) {
  std::normal_distribution<double> noise(0, 1);
  const Eigen::Vector3d pixel = kCamera.project(p);
  const double left = pixel_error * noise(random), right = pixel_error * noise(random);
  const double rows = pixel_error * (noise(random) + noise(random)) / 2;
  return kCamera.point(pixel.x() + left, pixel.y() + rows, pixel.z() + left - right);
}

std::vector<PointPair> simulated(int count, const Pose& prev_from_cur, double pixel_error, std::mt19937_64& random) {
  std::uniform_real_distribution<double> unit(0, 1);
  std::vector<PointPair> pairs;
  for (int i = 0; i < count; ++i) {
    const double depth = 1 + 3 * unit(random);
    const Eigen::Vector3d cur(depth * (1.6 * unit(random) - 0.8), depth * (unit(random) - 0.5), depth);
    pairs.emplace_back(measured(prev_from_cur * cur, random, pixel_error), measured(cur, random, pixel_error));
  }
  return pairs;
}

class Minimise : public ::testing::TestWithParam<ErrorModel> {};

TEST_P(Minimise, GradientEqualsTheNumericDerivative) {
  std::mt19937_64 random(4);
  auto pairs = simulated(30, some_motion(), 0.3, random);
  pairs[3].first.x() += 0.1;  // beyond Huber's bound
  const Pose at = perturbed(some_motion(), (Vector6d() << 0.01, -0.02, 0.005, 0.01, -0.01, 0.02).finished());
  for (const double huber : {0.0, 3.0}) {
    const MotionCost cost = motion_cost(kCamera, pairs, GetParam(), 0.1, huber, at);
    const Eigen::MatrixXd numeric = testing::numeric_jacobian(
        [&](const Eigen::VectorXd& step) -> Eigen::VectorXd {
          return Eigen::VectorXd::Constant(
              1, motion_cost(kCamera, pairs, GetParam(), 0.1, huber, perturbed(at, Vector6d(step))).value / 2);
        },
        Vector6d::Zero(), 1e-6);
    EXPECT_LT((cost.gradient - numeric.transpose()).norm(), 1e-6 * numeric.norm());
  }
}

TEST_P(Minimise, HessianEqualsTheNumericDerivativeOfTheGradientAtAPerfectFit) {
  std::mt19937_64 random(5);
  const auto pairs = simulated(30, some_motion(), 0, random);  // Gauss and Newton's Hessian is exact without residuals
  const MotionCost cost = motion_cost(kCamera, pairs, GetParam(), 0.1, 3, some_motion());
  EXPECT_LT(cost.value, 1e-15);
  const Eigen::MatrixXd numeric = testing::numeric_jacobian(
      [&](const Eigen::VectorXd& step) -> Eigen::VectorXd {
        return motion_cost(kCamera, pairs, GetParam(), 0.1, 3, perturbed(some_motion(), Vector6d(step))).gradient;
      },
      Vector6d::Zero(), 1e-6);
  EXPECT_LT((cost.hessian - numeric).norm(), 1e-5 * cost.hessian.norm());
}

TEST_P(Minimise, RecoversAMotionExactlyFromAPoorGuess) {
  std::mt19937_64 random(6);
  const auto pairs = simulated(30, some_motion(), 0, random);
  const MinimisedMotion result = minimise_motion(kCamera, pairs, GetParam(), 0.1, 3, Pose::Identity());
  EXPECT_TRUE(result.converged);
  EXPECT_LT((result.prev_from_cur.matrix() - some_motion().matrix()).norm(), 1e-7);
}

TEST_P(Minimise, CovarianceDescribesTheErrors) {
  // Normalised estimation error squared: e^T C^-1 e has mean 6 and variance 12, the mean of 300 trials lies within
  // 6 +- 1.96 sqrt(12 / 300) = 5.61 ... 6.39 with 95 %. Huber's bound and the estimated variance factor (freedom 12 +
  // 174) change it by about 2 %.
  std::mt19937_64 random(7);
  constexpr int kTrials = 300;
  double sum = 0;
  Vector6d mean = Vector6d::Zero();
  Matrix6d covariance = Matrix6d::Zero();
  for (int trial = 0; trial < kTrials; ++trial) {
    const auto pairs = simulated(60, some_motion(), 0.1, random);
    const MinimisedMotion result = minimise_motion(kCamera, pairs, GetParam(), 0.1, 3, some_motion());
    ASSERT_TRUE(result.converged);
    Vector6d error;
    error.head<3>() = result.prev_from_cur.translation() - some_motion().translation();
    const Eigen::AngleAxisd turn(Eigen::Matrix3d(result.prev_from_cur.linear() * some_motion().linear().transpose()));
    error.tail<3>() = turn.angle() * turn.axis();
    sum += error.dot(result.covariance.llt().solve(error)) / kTrials;
    mean += error / kTrials;
    covariance += result.covariance / kTrials;
  }
  EXPECT_GT(sum, 5.61);
  EXPECT_LT(sum, 6.39);
  // No bias: the mean error is within four of its standard deviations.
  for (int i = 0; i < 6; ++i) EXPECT_LT(std::abs(mean(i)), 4 * std::sqrt(covariance(i, i) / kTrials));
}

TEST_P(Minimise, CovarianceGrowsWithTheResiduals) {
  std::mt19937_64 random(8);
  const auto pairs = simulated(200, some_motion(), 0.2, random);  // twice the assumed noise
  const MinimisedMotion assumed = minimise_motion(kCamera, pairs, GetParam(), 0.2, 0, some_motion());
  const MinimisedMotion shown = minimise_motion(kCamera, pairs, GetParam(), 0.1, 0, some_motion());
  // The variance factor is known to sqrt(2 / 594) = 6 %; that it ends at 1 from below matters to `assumed` alone.
  EXPECT_NEAR(shown.covariance.trace() / assumed.covariance.trace(), 1, 0.12);
}

TEST_P(Minimise, FailsOnPointsThatLeaveTheMotionOpen) {
  std::mt19937_64 random(9);
  const auto two = simulated(1, some_motion(), 0, random);
  EXPECT_FALSE(minimise_motion(kCamera, two, GetParam(), 0.1, 3, some_motion()).converged);
}

INSTANTIATE_TEST_SUITE_P(Models, Minimise, ::testing::Values(ErrorModel::ellipsoid, ErrorModel::image),
                         [](const auto& info) { return info.param == ErrorModel::ellipsoid ? "ellipsoid" : "image"; });

}  // namespace
}  // namespace iris::motion
