#include "iris/motion/consistency.h"

#include <gtest/gtest.h>

#include <bit>
#include <numbers>
#include <random>

#include "iris/geometry/pose.h"
#include "iris/reconstruct/error_propagation.h"

namespace iris::motion {
namespace {

const RectifiedCamera kCamera{.f = 436, .cx = 364, .cy = 257, .baseline = 0.11, .width = 752, .height = 480};
constexpr double kMaxTurn = std::numbers::pi / 4;

Pose some_motion() {
  Pose motion = Pose::Identity();
  motion.linear() = Eigen::AngleAxisd(0.2, Eigen::Vector3d(0.1, 1, -0.2).normalized()).toRotationMatrix();
  motion.translation() = Eigen::Vector3d(0.1, -0.05, 0.2);
  return motion;
}

Eigen::Vector3d measured(const Eigen::Vector3d& p, std::mt19937_64& random, double pixel_error) {
  std::normal_distribution<double> noise(0, pixel_error);
  const Eigen::Vector3d pixel = kCamera.project(p);
  const double left = noise(random), right = noise(random), rows = (noise(random) + noise(random)) / 2;
  return kCamera.point(pixel.x() + left, pixel.y() + rows, pixel.z() + left - right);
}

Eigen::Vector3d random_point(std::mt19937_64& random) {
  std::uniform_real_distribution<double> unit(0, 1);
  const double depth = 1 + 4 * unit(random);
  return {depth * (1.6 * unit(random) - 0.8), depth * (unit(random) - 0.5), depth};
}

std::vector<Correspondence> correspondences(int good, int bad, const Pose& prev_from_cur, unsigned seed) {
  std::mt19937_64 random(seed);
  std::vector<Correspondence> result;
  for (int i = 0; i < good + bad; ++i) {
    const Eigen::Vector3d cur = random_point(random);
    const Eigen::Vector3d prev = i < good ? prev_from_cur * cur : random_point(random);
    result.push_back({i, i, measured(prev, random, 0.1), measured(cur, random, 0.1)});
  }
  return result;
}

TEST(Consistent, FollowsTheBoundsOfDistanceAndTurn) {  // (5.2), (5.3)
  Correspondence a, b;
  a.prev_point = a.cur_point = Eigen::Vector3d(0, 0, 2);
  b.prev_point = Eigen::Vector3d(1, 0.2, 2.5);
  b.cur_point = b.prev_point;
  EXPECT_TRUE(consistent(kCamera, a, b, 0.1, kMaxTurn));
  const Eigen::Vector3d line = b.prev_point - a.prev_point;
  // Stretched until just below and just above three standard deviations.
  const double error = std::numbers::sqrt2 * reconstruct::length_error(kCamera, a.prev_point, b.prev_point, 0.1);
  b.cur_point = a.cur_point + line * (1 + 2.9 * error / line.norm());
  EXPECT_TRUE(consistent(kCamera, a, b, 0.1, kMaxTurn));
  b.cur_point = a.cur_point + line * (1 + 3.2 * error / line.norm());
  EXPECT_FALSE(consistent(kCamera, a, b, 0.1, kMaxTurn));
  // Turned in the image plane.
  for (const auto& [degrees, turns, expected] : {std::tuple{44, 0, true},
                                                 {46, 0, false},
                                                 {-90, 1, true},
                                                 {-90, 0, false},
                                                 {180, 2, true},
                                                 {90, 3, true},
                                                 {-46, 1, true}}) {
    b.cur_point = a.cur_point + Eigen::AngleAxisd(degrees * std::numbers::pi / 180, Eigen::Vector3d::UnitZ()) * line;
    const Correspondence flat_a = a;
    Correspondence flat_b = b;
    flat_b.prev_point.z() = flat_b.cur_point.z() = 2;
    EXPECT_EQ(consistent(kCamera, flat_a, flat_b, 0.1, kMaxTurn, turns * std::numbers::pi / 2), expected)
        << degrees << " " << turns;
  }
}

TEST(ConsistencyMatrix, HoldsEveryPairBothWays) {
  const auto all = correspondences(50, 50, some_motion(), 5);
  const BitMatrix matrix = consistency_matrix(kCamera, all, 0.1, kMaxTurn);
  for (int i = 0; i < matrix.size(); ++i) {
    for (int k = 0; k < matrix.size(); ++k) {
      EXPECT_EQ(matrix.at(i, k), i != k && consistent(kCamera, all[i], all[k], 0.1, kMaxTurn));
    }
  }
}

// Size of the largest set in which all are consistent, by trying all subsets.
int largest_set(const BitMatrix& matrix) {
  int largest = 0;
  for (uint32_t subset = 1; subset < (1u << matrix.size()); ++subset) {
    bool all = true;
    for (int i = 0; i < matrix.size() && all; ++i) {
      const uint32_t others = subset & ~(1u << i);
      if (subset >> i & 1) all = (matrix.row(i)[0] & others) == others;
    }
    if (all) largest = std::max(largest, std::popcount(subset));
  }
  return largest;
}

TEST(ConsistentSet, IsMutuallyConsistentMaximalAndNearlyAsLargeAsTheLargest) {
  int total = 0, largest_total = 0;
  for (unsigned seed = 0; seed < 100; ++seed) {
    const auto all = correspondences(6, 6, some_motion(), seed);
    const BitMatrix matrix = consistency_matrix(kCamera, all, 0.1, kMaxTurn);
    const std::vector<int> chosen = consistent_set(matrix);
    for (const int i : chosen)
      for (const int k : chosen) EXPECT_TRUE(i == k || matrix.at(i, k));
    for (int extra = 0; extra < matrix.size(); ++extra) {
      bool fits = std::find(chosen.begin(), chosen.end(), extra) == chosen.end();
      for (const int i : chosen) fits = fits && matrix.at(i, extra);
      EXPECT_FALSE(fits);
    }
    total += static_cast<int>(chosen.size());
    largest_total += largest_set(matrix);
  }
  EXPECT_GE(total, 0.98 * largest_total);  // greedy loses little
}

TEST(ConsistentSet, FindsTheMotionAmongHalfOutliers) {
  for (unsigned seed = 0; seed < 10; ++seed) {
    const auto all = correspondences(100, 100, some_motion(), seed);
    const std::vector<int> chosen = consistent_set(consistency_matrix(kCamera, all, 0.1, kMaxTurn));
    int good = 0;
    for (const int i : chosen) good += i < 100;
    // A pair of good ones passes with 99.7 %, so that most but not all good ones remain.
    EXPECT_GE(good, 70);
    EXPECT_LE(static_cast<int>(chosen.size()) - good, 2);
  }
}

TEST(ConsistentSet, IsSmallWithoutACommonMotion) {
  for (unsigned seed = 0; seed < 10; ++seed) {
    const auto all = correspondences(0, 200, some_motion(), seed);
    EXPECT_LT(consistent_set(consistency_matrix(kCamera, all, 0.1, kMaxTurn)).size(), 8u);
  }
  EXPECT_TRUE(consistent_set(BitMatrix(0)).empty());
}

}  // namespace
}  // namespace iris::motion
