#include "iris/motion/closed_form.h"

#include <gtest/gtest.h>

#include <random>

namespace iris::motion {
namespace {

Pose some_motion() {
  Pose motion = Pose::Identity();
  motion.linear() = Eigen::AngleAxisd(0.6, Eigen::Vector3d(0.3, 1, -0.2).normalized()).toRotationMatrix();
  motion.translation() = Eigen::Vector3d(0.4, -0.1, 0.7);
  return motion;
}

struct Points {
  std::vector<Eigen::Vector3d> prev, cur;
  std::vector<double> weights;
};

Points points(int count, const Eigen::Vector3d& size, double noise_m, unsigned seed) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> unit(-1, 1);
  std::normal_distribution<double> noise(0, 1);
  Points result;
  for (int i = 0; i < count; ++i) {
    const Eigen::Vector3d c = size.cwiseProduct(Eigen::Vector3d(unit(random), unit(random), unit(random)));
    const Eigen::Vector3d n(noise(random), noise(random), noise(random));
    result.cur.push_back(c);
    result.prev.push_back(some_motion() * c + noise_m * n);
    result.weights.push_back(1 + std::abs(unit(random)));
  }
  return result;
}

TEST(SphericalMotion, RecoversAKnownTransform) {
  for (const Eigen::Vector3d& size : {Eigen::Vector3d(1, 2, 3), Eigen::Vector3d(2, 1, 0)}) {  // solid, planar
    for (const int count : {3, 4, 50}) {
      const Points p = points(count, size, 0, 7);
      const auto motion = spherical_motion(p.prev, p.cur, p.weights);
      ASSERT_TRUE(motion);
      EXPECT_LT((motion->matrix() - some_motion().matrix()).norm(), 1e-10);
    }
  }
}

TEST(SphericalMotion, GivesARotationForNoisyNearlyPlanarSetsWhoseBestFitIsAReflection) {
  int reflections = 0;
  for (unsigned seed = 0; seed < 200; ++seed) {
    const Points p = points(5, {2, 1, 0.001}, 0.02, seed);
    const auto motion = spherical_motion(p.prev, p.cur, p.weights);
    ASSERT_TRUE(motion);
    EXPECT_NEAR(motion->linear().determinant(), 1, 1e-12);
    EXPECT_LT(rotation_angle(motion->linear() * some_motion().linear().transpose()), 0.3);
    // Whether the unconstrained solution would have been a reflection: the sign of the scatter's determinant.
    Eigen::Vector3d pm = Eigen::Vector3d::Zero(), cm = Eigen::Vector3d::Zero();
    double sum = 0;
    for (size_t i = 0; i < p.cur.size(); ++i) {
      pm += p.weights[i] * p.prev[i];
      cm += p.weights[i] * p.cur[i];
      sum += p.weights[i];
    }
    Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
    for (size_t i = 0; i < p.cur.size(); ++i)
      scatter += p.weights[i] * (p.prev[i] - pm / sum) * (p.cur[i] - cm / sum).transpose();
    reflections += scatter.determinant() < 0;
  }
  EXPECT_GT(reflections, 20);  // the case does occur in this test
}

TEST(SphericalMotion, NoRigidMotionFitsBetter) {
  const Points p = points(20, {1, 2, 3}, 0.05, 3);
  const Pose best = *spherical_motion(p.prev, p.cur, p.weights);
  const auto sum = [&](const Pose& motion) {
    double s = 0;
    for (size_t i = 0; i < p.cur.size(); ++i) s += p.weights[i] * (p.prev[i] - motion * p.cur[i]).squaredNorm();
    return s;
  };
  for (int axis = 0; axis < 3; ++axis) {
    for (const double step : {-1e-3, 1e-3}) {
      Pose moved = best, turned = best;
      moved.translation()(axis) += step;
      turned.linear() = Eigen::AngleAxisd(step, Eigen::Vector3d::Unit(axis)).toRotationMatrix() * best.linear();
      EXPECT_GT(sum(moved), sum(best));
      EXPECT_GT(sum(turned), sum(best));
    }
  }
}

TEST(SphericalMotion, HasNoAnswerForTwoPointsOrALine) {
  const Points two = points(2, {1, 1, 1}, 0, 1);
  EXPECT_FALSE(spherical_motion(two.prev, two.cur, two.weights));
  const Points line = points(20, {0, 0, 1}, 0, 1);
  EXPECT_FALSE(spherical_motion(line.prev, line.cur, line.weights));
}

TEST(Chauvenet, EqualsAHandExample) {
  // Ten errors, S^2 = (9 * 1 + 16) / 9, S = 1.667. Error 4 is 2.4 S: 10 * 0.01640 = 0.164 < 0.5, rejected;
  // error 1 is 0.6 S: 10 * 0.549 = 5.5, kept.
  const std::vector<bool> keep = chauvenet({1, -1, 1, -1, 1, 4, -1, 1, -1, 1});
  for (size_t i = 0; i < keep.size(); ++i) EXPECT_EQ(keep[i], i != 5);
  // With error 3: S^2 = 18 / 9 = 2, 2.121 S: 10 * 0.0339 = 0.34, rejected; with 2.6: S^2 = 1.751, 1.965 S: 0.494,
  // rejected; with 2.5: S^2 = 1.694, 1.921 S: 0.548, kept.
  EXPECT_FALSE(chauvenet({1, 1, 1, 1, 1, 3, 1, 1, 1, 1})[5]);
  EXPECT_FALSE(chauvenet({1, 1, 1, 1, 1, 2.6, 1, 1, 1, 1})[5]);
  EXPECT_TRUE(chauvenet({1, 1, 1, 1, 1, 2.5, 1, 1, 1, 1})[5]);
}

TEST(Chauvenet, KeepsAllOfEqualOrNoErrors) {
  for (const bool keep : chauvenet({2, 2, 2, 2})) EXPECT_TRUE(keep);
  for (const bool keep : chauvenet({0, 0, 0})) EXPECT_TRUE(keep);
  EXPECT_TRUE(chauvenet({}).empty());
}

}  // namespace
}  // namespace iris::motion
