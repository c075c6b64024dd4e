#include "iris/motion/minimise.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
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
  pairs[3].prev.x() += 0.1;  // beyond Huber's bound
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

// The least squared image error of a pair over the position of its point (4.8), by Nelder and Mead's simplex on nothing
// but projections, started again until it rests: the inner loop of the thesis.
double nested_image_error(const PointPair& pair, const Pose& prev_from_cur, double pixel_error) {
  const auto pixels = [](const Eigen::Vector3d& p) {
    const double s = kCamera.f / p.z();
    return Eigen::Vector4d(s * p.x(), s * p.y(), s * (p.x() - kCamera.baseline), s * p.y());
  };
  const Eigen::Vector4d seen_prev = pixels(pair.prev), seen_cur = pixels(pair.cur);
  const auto error = [&](const Eigen::Vector3d& v) {
    return ((pixels(prev_from_cur * v) - seen_prev).squaredNorm() + (pixels(v) - seen_cur).squaredNorm()) /
           (pixel_error * pixel_error);
  };
  Eigen::Vector3d best = pair.cur;
  double step = 0.01;
  for (int restart = 0; restart < 6; ++restart, step /= 20) {
    std::vector<std::pair<double, Eigen::Vector3d>> simplex{{error(best), best}};
    for (int axis = 0; axis < 3; ++axis) {
      const Eigen::Vector3d corner = best + step * (axis == 2 ? 3 : 1) * Eigen::Vector3d::Unit(axis);
      simplex.emplace_back(error(corner), corner);
    }
    const auto order = [&] {
      std::sort(simplex.begin(), simplex.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
    };
    for (int iteration = 0; iteration < 120; ++iteration) {
      order();
      const Eigen::Vector3d centre = (simplex[0].second + simplex[1].second + simplex[2].second) / 3;
      const auto along = [&](double s) {
        const Eigen::Vector3d at = centre + s * (simplex[3].second - centre);
        return std::pair(error(at), at);
      };
      auto next = along(-1);
      if (next.first < simplex[0].first)
        next = std::min(next, along(-2), [](auto& a, auto& b) { return a.first < b.first; });
      if (next.first >= simplex[2].first) next = along(0.5);
      if (next.first < simplex[3].first) {
        simplex[3] = next;
      } else {
        for (int i = 1; i < 4; ++i) {
          simplex[i].second = (simplex[i].second + simplex[0].second) / 2;
          simplex[i].first = error(simplex[i].second);
        }
      }
    }
    order();
    best = simplex[0].second;
  }
  return error(best);
}

TEST(MinimiseImage, EqualsTheNestedMinimisationOfTheThesis) {
  // The outer loop: Newton's method on nothing but values of the nested sum, with differences of 1e-4 of a parabola
  // that is exact to 1e-4 of the step.
  std::mt19937_64 random(12);
  const auto pairs = simulated(12, some_motion(), 0.1, random);
  const MinimisedMotion joint = minimise_motion(kCamera, pairs, ErrorModel::image, 0.1, 0, Pose::Identity());
  ASSERT_TRUE(joint.converged);
  const auto nested = [&](const Pose& motion) {
    double sum = 0;
    for (const PointPair& pair : pairs) sum += nested_image_error(pair, motion, 0.1);
    return sum;
  };
  const auto joint_value = motion_cost(kCamera, pairs, ErrorModel::image, 0.1, 0, joint.prev_from_cur).value;
  EXPECT_NEAR(nested(joint.prev_from_cur), joint_value, 1e-9 * joint_value);
  Pose at = joint.prev_from_cur;
  // A start elsewhere, in units of the expected errors.
  const Eigen::LLT<Matrix6d> sigma(joint.covariance);
  const auto moved = [&](const Pose& pose, const Vector6d& u) { return perturbed(pose, sigma.matrixL() * u); };
  at = moved(at, (Vector6d() << 0.5, -0.4, 0.3, 0.2, -0.5, 0.4).finished());
  const double h = 0.05;
  for (int iteration = 0; iteration < 5; ++iteration) {
    const double centre = nested(at);
    Vector6d gradient;
    Matrix6d hessian;
    std::array<double, 6> up, down;
    for (int i = 0; i < 6; ++i) {
      up[i] = nested(moved(at, h * Vector6d::Unit(i)));
      down[i] = nested(moved(at, -h * Vector6d::Unit(i)));
      gradient(i) = (up[i] - down[i]) / (2 * h);
      hessian(i, i) = (up[i] + down[i] - 2 * centre) / (h * h);
    }
    for (int i = 0; i < 6; ++i) {
      for (int k = 0; k < i; ++k) {
        const double both = nested(moved(at, h * (Vector6d::Unit(i) + Vector6d::Unit(k))));
        hessian(i, k) = hessian(k, i) = (both - up[i] - up[k] + centre) / (h * h);
      }
    }
    at = moved(at, -hessian.llt().solve(gradient));
  }
  EXPECT_NEAR(nested(at), joint_value, 1e-9 * joint_value);
  EXPECT_GE(nested(at), joint_value * (1 - 1e-9));
}

TEST(MinimiseImage, NoMotionNearbyIsBetterAlsoWithHubersBound) {
  std::mt19937_64 random(13);
  auto pairs = simulated(40, some_motion(), 0.1, random);
  for (int i = 0; i < 6; ++i) pairs[i].prev.x() += 0.02 * (i + 1);  // beyond the bound
  const MinimisedMotion joint = minimise_motion(kCamera, pairs, ErrorModel::image, 0.1, 3, some_motion());
  ASSERT_TRUE(joint.converged);
  const MotionCost cost = motion_cost(kCamera, pairs, ErrorModel::image, 0.1, 3, joint.prev_from_cur);
  // The expected decrease by a full step in units of the statistical error.
  EXPECT_LT(cost.gradient.dot(cost.hessian.llt().solve(cost.gradient)), 1e-9);
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

// Every pair three times: the errors are those of single pairs, and so is the covariance.
TEST_P(Minimise, CovarianceKnowsThatNeighboursShareTheirErrors) {
  std::mt19937_64 random(15);
  double ratio = 0;
  constexpr int kTrials = 20;
  for (int trial = 0; trial < kTrials; ++trial) {
    const auto pairs = simulated(60, some_motion(), 0.2, random);
    auto thrice = pairs;
    for (int i = 0; i < 2; ++i) thrice.insert(thrice.end(), pairs.begin(), pairs.end());
    const MinimisedMotion one = minimise_motion(kCamera, pairs, GetParam(), 0.1, 0, some_motion());
    const MinimisedMotion three = minimise_motion(kCamera, thrice, GetParam(), 0.1, 0, some_motion());
    ratio += three.covariance.trace() / one.covariance.trace() / kTrials;
  }
  // The degrees of freedom are counted as if all pairs were independent: 174 / 180 against 534 / 540.
  EXPECT_NEAR(ratio, (174.0 / 180) / (534.0 / 540), 1e-3);
}

// Pairs of known, different accuracy, some of them seen by other cameras.
std::vector<PointPair> weighted(int count, const Pose& prev_from_cur, double scale, std::mt19937_64& random) {
  std::normal_distribution<double> noise(0, 1);
  std::uniform_real_distribution<double> unit(0, 1);
  std::vector<PointPair> pairs = simulated(count, prev_from_cur, 0, random);
  for (int i = 0; i < count; ++i) {
    PointPair& pair = pairs[i];
    if (i % 2 == 0) {
      pair.prev_from_seeing.linear() = Eigen::AngleAxisd(0.1 + 0.01 * i, Eigen::Vector3d::UnitY()).toRotationMatrix();
      pair.prev_from_seeing.translation() = Eigen::Vector3d(0.05, -0.1, -0.2);
      pair.prev = pair.prev_from_seeing.inverse() * pair.prev;
    }
    Eigen::Matrix3d root = Eigen::Matrix3d::Zero();  // of the covariance of (x_left, sqrt(2) y, x_right)
    root.diagonal() =
        scale * Eigen::Vector3d(0.05 + 0.3 * unit(random), 0.05 + 0.3 * unit(random), 0.05 + 0.3 * unit(random));
    root(1, 0) = scale * 0.1 * (unit(random) - 0.5);
    for (Eigen::Vector3d* point : {&pair.prev, &pair.cur}) {
      const Eigen::Vector3d error = root * Eigen::Vector3d(noise(random), noise(random), noise(random));
      const Eigen::Vector3d seen = kCamera.project(*point);
      *point =
          kCamera.point(seen.x() + error.x(), seen.y() + error.y() / std::sqrt(2.0), seen.z() + error.x() - error.z());
    }
    pair.whitening = 0.1 * root.inverse() * (scale > 0 ? 1 : 0);
    if (scale == 0) pair.whitening = Eigen::Matrix3d::Identity();
  }
  return pairs;
}

TEST(MinimiseWeighted, GradientEqualsTheNumericDerivative) {
  std::mt19937_64 random(16);
  const auto pairs = weighted(30, some_motion(), 1, random);
  const Pose at = perturbed(some_motion(), (Vector6d() << 0.01, -0.02, 0.005, 0.01, -0.01, 0.02).finished());
  const MotionCost cost = motion_cost(kCamera, pairs, ErrorModel::image, 0.1, 3, at);
  const Eigen::MatrixXd numeric = testing::numeric_jacobian(
      [&](const Eigen::VectorXd& step) -> Eigen::VectorXd {
        return Eigen::VectorXd::Constant(
            1, motion_cost(kCamera, pairs, ErrorModel::image, 0.1, 3, perturbed(at, Vector6d(step))).value / 2);
      },
      Vector6d::Zero(), 1e-6);
  EXPECT_LT((cost.gradient - numeric.transpose()).norm(), 1e-6 * numeric.norm());
}

TEST(MinimiseWeighted, RecoversAMotionFromSeveralCamerasExactly) {
  std::mt19937_64 random(17);
  const MinimisedMotion result =
      minimise_motion(kCamera, weighted(30, some_motion(), 0, random), ErrorModel::image, 0.1, 3, Pose::Identity());
  EXPECT_TRUE(result.converged);
  EXPECT_LT((result.prev_from_cur.matrix() - some_motion().matrix()).norm(), 1e-7);
}

// As for equal pairs: 6 +- 0.39 with 95 % if every pair counts by its accuracy. Counted alike, errors are larger.
TEST(MinimiseWeighted, CovarianceDescribesTheErrorsWhichAreSmaller) {
  std::mt19937_64 random(18);
  constexpr int kTrials = 300;
  double sum = 0, weighted_square = 0, plain_square = 0;
  for (int trial = 0; trial < kTrials; ++trial) {
    auto pairs = weighted(60, some_motion(), 1, random);
    const MinimisedMotion result = minimise_motion(kCamera, pairs, ErrorModel::image, 0.1, 0, some_motion());
    ASSERT_TRUE(result.converged);
    const Pose difference = result.prev_from_cur * some_motion().inverse();
    Vector6d error;
    error.head<3>() = result.prev_from_cur.translation() - some_motion().translation();
    const Eigen::AngleAxisd turn(Eigen::Matrix3d(difference.linear()));
    error.tail<3>() = turn.angle() * turn.axis();
    sum += error.dot(result.covariance.llt().solve(error)) / kTrials;
    weighted_square += error.tail<3>().squaredNorm();
    for (PointPair& pair : pairs) pair.whitening.setIdentity();
    const MinimisedMotion plain = minimise_motion(kCamera, pairs, ErrorModel::image, 0.1, 0, some_motion());
    plain_square += std::pow(rotation_angle(some_motion().inverse() * plain.prev_from_cur), 2);
  }
  EXPECT_GT(sum, 5.4);
  EXPECT_LT(sum, 6.39);
  EXPECT_LT(weighted_square, 0.8 * plain_square);
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
