#include "iris/evaluate/cloud.h"

#include <gtest/gtest.h>

#include <random>

namespace iris::evaluate {
namespace {

// A square of 2 m on the ground, and a needle of a triangle beside it.
std::vector<TriangleMesh> made_truth() {
  TriangleMesh square;
  square.vertices = {{-1, -1, 0}, {1, -1, 0}, {1, 1, 0}, {-1, 1, 0}};
  square.triangles = {{0, 1, 2}, {0, 2, 3}};
  TriangleMesh needle;
  needle.vertices = {{5, 0, 0}, {5, 0, 3}, {5.001f, 0, 3}};
  needle.triangles = {{0, 1, 2}};
  return {square, needle};
}

CloudPoint point(double x, double y, double z, double sigma, double range = 1) {
  CloudPoint p;
  p.position = Eigen::Vector3d(x, y, z).cast<float>();
  p.sigma = static_cast<float>(sigma);
  p.range = static_cast<float>(range);
  return p;
}

TEST(EvaluateCloud, DistancesAreThoseToTheNearestTriangle) {
  // Above the square, beside its edge, beyond its corner, above the needle's tip, beside the needle.
  const std::vector<std::pair<Eigen::Vector3d, double>> cases = {{{0.2, 0.1, 0.25}, 0.25}, {{0.2, -0.1, -0.5}, 0.5},
                                                                 {{1.5, 0, 0}, 0.5},       {{2, 2, 0}, std::sqrt(2.0)},
                                                                 {{5, 0, 3.75}, 0.75},     {{5, 0.125, 1}, 0.125}};
  for (const auto& [place, distance] : cases) {
    PointCloud cloud;
    cloud.points = {point(place.x(), place.y(), place.z(), 1)};
    EXPECT_NEAR(evaluate_cloud(cloud, Pose::Identity(), made_truth(), {}, {}).distance.mean, distance, 1e-6);
  }
}

TEST(EvaluateCloud, SigmaAndRange) {
  PointCloud cloud;
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> place(-0.9, 0.9), size(0.001, 0.01);
  Pose truth_from_cloud = Pose::Identity();
  truth_from_cloud.translation() = Eigen::Vector3d(0.1, 0.2, -4);
  truth_from_cloud.linear() = Eigen::AngleAxisd(0.3, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  for (int i = 0; i < 20000; ++i) {
    const double sigma = size(random);
    // Far points (range 5) err by twice what they state.
    const bool far = i % 4 == 0;
    const Eigen::Vector3d p = truth_from_cloud.inverse() *
                              Eigen::Vector3d(place(random), place(random), (far ? 2 : 1) * sigma * normal(random));
    cloud.points.push_back(point(p.x(), p.y(), p.z(), sigma, far ? 5 : 2));
  }
  const CloudErrors errors = evaluate_cloud(cloud, truth_from_cloud, made_truth(), {}, {});
  EXPECT_EQ(errors.distance.count, 20000);
  EXPECT_EQ(errors.near_distance.count, 15000);
  EXPECT_NEAR(errors.near_within_sigma, 0.683, 0.015);
  EXPECT_NEAR(errors.near_within_two_sigma, 0.954, 0.01);
  EXPECT_NEAR(errors.within_sigma, 0.75 * 0.683 + 0.25 * 0.383, 0.015);
}

TEST(EvaluateCloud, CoverageIsThatOfTheTruePoints) {
  PointCloud cloud;
  for (int i = 0; i <= 50; ++i) {
    for (int k = 0; k <= 100; ++k) cloud.points.push_back(point(-1 + 0.02 * i, -1 + 0.02 * k, 0.01, 0.01));
  }
  // The cloud covers x <= 0; with its reach of 3 cm and 1 cm above the ground to x = 0.028.
  std::vector<Eigen::Vector3d> seen;
  int expected = 0;
  for (int i = 0; i < 200; ++i) {
    for (int k = 0; k < 20; ++k) {
      seen.emplace_back(-0.995 + 0.01 * i, -0.9 + 0.1 * k, 0);
      expected += seen.back().x() < 0.0283;
    }
  }
  const CloudErrors errors = evaluate_cloud(cloud, Pose::Identity(), made_truth(), seen, {});
  EXPECT_EQ(errors.seen, 4000);
  EXPECT_EQ(errors.covered, expected);
}

}  // namespace
}  // namespace iris::evaluate
