#include "iris/loop/verification.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <random>

#include "iris/motion/agreement.h"
#include "iris/motion/minimise.h"
#include "support/box_room.h"

namespace iris::loop {
namespace {

constexpr double kShift = 0.004, kTurn = 0.001;  // standard deviations [m], [rad] of a step and of a loop

Vector6d noise(std::mt19937& random, double shift = kShift, double turn = kTurn) {
  std::normal_distribution<double> normal(0, 1);
  Vector6d result;
  for (int k = 0; k < 6; ++k) result(k) = (k < 3 ? shift : turn) * normal(random);
  return result;
}

Matrix6d covariance_of(double shift = kShift, double turn = kTurn) {
  Matrix6d result = Matrix6d::Zero();
  result.diagonal() << shift * shift, shift * shift, shift * shift, turn * turn, turn * turn, turn * turn;
  return result;
}

LoopOptions plain() { return {.sigma = 1, .drift = 0, .turn_drift = 0}; }

// A walk `laps` times around a circle of 60 steps, with noisy odometry, broken into sub-maps at the given nodes.
struct Walk {
  std::vector<Pose> truth;
  PoseGraph graph;

  Walk(int laps, std::mt19937& random, const std::vector<int>& breaks = {}) {
    int submap = 0;
    for (int k = 0; k < 60 * laps; ++k) {
      const double a = 2 * M_PI * k / 60;
      truth.push_back(testing::level_camera({3 * std::cos(a), 3 * std::sin(a), 0}, a + 1.5));
      if (k == 0 || std::count(breaks.begin(), breaks.end(), k) > 0) {
        if (k > 0) ++submap;
        graph.nodes.push_back({.frame_idx = k, .submap = submap});
        continue;
      }
      const Pose step = motion::perturbed(truth[k - 1].inverse() * truth[k], noise(random));
      graph.nodes.push_back(
          {.frame_idx = k, .world_from_cam = graph.nodes.back().world_from_cam * step, .submap = submap});
      graph.edges.push_back({.i = k - 1, .j = k, .i_from_j = step, .information = covariance_of().inverse()});
    }
  }

  LoopEdge loop(int i, int j, std::mt19937& random) const {
    return {.i = i,
            .j = j,
            .i_from_j = motion::perturbed(truth[i].inverse() * truth[j], noise(random)),
            .covariance = covariance_of(),
            .used = 100,
            .verdict = LoopVerdict::accepted};
  }
};

int count_of(const std::vector<LoopEdge>& edges, LoopVerdict verdict) {
  return static_cast<int>(
      std::count_if(edges.begin(), edges.end(), [&](const LoopEdge& e) { return e.verdict == verdict; }));
}

TEST(ChiSquare, OfTheWayAroundTwoTrueLoopsHasSixDegreesOfFreedom) {
  std::mt19937 random(1);
  double sum = 0;
  constexpr int kTrials = 300;
  for (int trial = 0; trial < kTrials; ++trial) {
    const Walk walk(2, random);
    const Odometry odometry(walk.graph, plain());
    sum += chi_square_of(walk.loop(10, 72, random), walk.loop(25, 84, random), odometry, plain());
  }
  // Four standard deviations of the mean; the ways 10-25 and 72-84 do not overlap.
  EXPECT_NEAR(sum / kTrials, 6, 4 * std::sqrt(12.0 / kTrials));
}

TEST(Consistency, KeepsTrueLoopsAndDropsScatteredFalseOnes) {
  std::mt19937 random(2);
  const Walk walk(3, random);
  const Odometry odometry(walk.graph, plain());
  std::vector<LoopEdge> edges;
  for (int k = 0; k < 60; ++k) edges.push_back(walk.loop(k, k + 60 + k % 50, random));
  const size_t good = edges.size();
  for (int k = 0; k < 60; ++k) {
    LoopEdge edge = walk.loop(k, k + 70, random);
    edge.i_from_j = motion::perturbed(edge.i_from_j, noise(random, 0.5, 0.2));
    edges.push_back(edge);
  }
  judge_consistency(edges, odometry, plain());
  int kept = 0, wrong = 0;
  for (size_t k = 0; k < edges.size(); ++k) {
    if (edges[k].verdict == LoopVerdict::accepted) ++(k < good ? kept : wrong);
    EXPECT_GE(edges[k].chi_square, 0);
  }
  // Each pair of true loops agrees with 99.9 %, and sixty must agree with each other at once.
  EXPECT_GE(kept, 57);
  EXPECT_EQ(wrong, 0);
}

// Odometry that is wrong by more than it says lets no loop pass; a stated drift does.
TEST(Consistency, TrustsOdometryAsFarAsItIsTold) {
  std::mt19937 random(3);
  Walk walk(2, random);
  Pose at = Pose::Identity();
  for (size_t e = 0; e < walk.graph.edges.size(); ++e) {  // 2 % too long, 0.2 deg/m
    PoseEdge& edge = walk.graph.edges[e];
    edge.i_from_j.linear() =
        edge.i_from_j.linear() *
        Eigen::AngleAxisd(0.2 * M_PI / 180 * edge.i_from_j.translation().norm(), Eigen::Vector3d::UnitY())
            .toRotationMatrix();
    edge.i_from_j.translation() *= 1.02;
    at = at * edge.i_from_j;
    walk.graph.nodes[e + 1].world_from_cam = at;
  }
  std::vector<LoopEdge> edges;
  for (int k = 0; k < 50; ++k) edges.push_back(walk.loop(k, k + 60, random));
  LoopOptions options = plain();
  std::vector<LoopEdge> judged = edges;
  judge_consistency(judged, Odometry(walk.graph, options), options);
  EXPECT_EQ(count_of(judged, LoopVerdict::inconsistent), 50);
  options.drift = 0.01;
  options.turn_drift = 0.2;
  judged = edges;
  judge_consistency(judged, Odometry(walk.graph, options), options);
  EXPECT_EQ(count_of(judged, LoopVerdict::accepted), 50);
}

TEST(Consistency, JoinsSubmapsByTheLargestAgreeingSet) {
  std::mt19937 random(4);
  const Walk walk(2, random, {60});
  const Odometry odometry(walk.graph, plain());
  std::vector<LoopEdge> edges;
  for (int k = 0; k < 20; ++k) edges.push_back(walk.loop(k, k + 60, random));
  for (int k = 20; k < 26; ++k) edges.push_back(walk.loop(k, k + 65, random));
  for (int k = 20; k < 26; ++k) edges.back().i_from_j = walk.truth[0].inverse() * walk.truth[7];
  for (int k = 30; k < 35; ++k) {  // agree with each other: places 6 steps apart that look alike
    LoopEdge edge = walk.loop(k, k + 60, random);
    edge.i_from_j = walk.truth[k].inverse() * walk.truth[k + 6];
    edges.push_back(edge);
  }
  judge_consistency(edges, odometry, plain());
  EXPECT_EQ(count_of(edges, LoopVerdict::accepted), 25);
  for (const LoopEdge& e : edges) EXPECT_EQ(e.chi_square, -1);  // nothing to compare with
  for (size_t k = edges.size() - 6; k < edges.size(); ++k) EXPECT_EQ(edges[k].verdict, LoopVerdict::inconsistent);
}

TEST(Consistency, DoesNotJoinSubmapsOnAWeakOrDividedVote) {
  std::mt19937 random(5);
  const Walk walk(2, random, {60});
  const Odometry odometry(walk.graph, plain());
  std::vector<LoopEdge> two{walk.loop(3, 63, random), walk.loop(9, 69, random)};
  std::vector<LoopEdge> strong = two;  // of 100 correspondences each
  for (LoopEdge& edge : two) edge.used = 30;
  judge_consistency(two, odometry, plain());
  EXPECT_EQ(count_of(two, LoopVerdict::unsupported), 2);
  judge_consistency(strong, odometry, plain());
  EXPECT_EQ(count_of(strong, LoopVerdict::accepted), 2);

  // Ten say that the second lap lies on the first, six that it is turned by six steps.
  std::vector<LoopEdge> divided;
  for (int k = 0; k < 16; ++k) {
    divided.push_back(walk.loop(k, k + 60, random));
    if (k >= 10) divided.back().i_from_j = walk.truth[k].inverse() * walk.truth[k + 6];
  }
  judge_consistency(divided, odometry, plain());
  EXPECT_EQ(count_of(divided, LoopVerdict::accepted), 0);
  EXPECT_EQ(count_of(divided, LoopVerdict::unsupported), 10);
  EXPECT_EQ(count_of(divided, LoopVerdict::inconsistent), 6);
}

// An edge from the later to the earlier sub-map counts like one the other way round.
TEST(Consistency, DoesNotDependOnWhichSubmapComesFirst) {
  std::mt19937 random(6);
  Walk walk(3, random, {60, 120});
  for (size_t k = 120; k < 180; ++k) walk.graph.nodes[k].submap = 0;  // the path went on in the first sub-map
  Pose step = walk.truth[59].inverse() * walk.truth[120];
  walk.graph.edges.push_back({.i = 59, .j = 120, .i_from_j = step, .information = covariance_of().inverse()});
  for (size_t k = 120; k < 180; ++k) {
    walk.graph.nodes[k].world_from_cam = walk.graph.nodes[59].world_from_cam * walk.truth[59].inverse() * walk.truth[k];
  }
  const Odometry odometry(walk.graph, plain());
  std::vector<LoopEdge> edges;
  for (int k = 0; k < 10; ++k) edges.push_back(walk.loop(k, k + 60, random));
  for (int k = 0; k < 10; ++k) edges.push_back(walk.loop(70 + k, 130 + k, random));
  judge_consistency(edges, odometry, plain());
  EXPECT_GE(count_of(edges, LoopVerdict::accepted), 19);
}

// More loops than are compared with each other: the rest is judged by its neighbours.
TEST(Consistency, JudgesThousandsOfLoops) {
  std::mt19937 random(7);
  const Walk walk(40, random);
  const Odometry odometry(walk.graph, plain());
  std::vector<LoopEdge> edges;
  for (int i = 0; i < 60 * 39; ++i) {
    edges.push_back(walk.loop(i, i + 60, random));
    if (i % 10 == 0) {
      edges.push_back(walk.loop(i, i + 61, random));
      edges.back().i_from_j.translation() += Eigen::Vector3d(0.1, 0, 0.1);
    }
  }
  judge_consistency(edges, odometry, plain());
  int kept = 0, wrong = 0;
  for (const LoopEdge& e : edges) {
    if (e.verdict == LoopVerdict::accepted) ++(e.j - e.i == 60 ? kept : wrong);
  }
  EXPECT_GT(kept, 0.95 * 60 * 39);
  EXPECT_EQ(wrong, 0);
}

TEST(Spread, IsThePartOfTheGridThatIsOccupied) {
  const RectifiedCamera camera{.width = 800, .height = 600};
  EXPECT_EQ(spread_of({}, camera), 0);
  EXPECT_NEAR(spread_of({{10, 10}, {20, 20}, {90, 90}}, camera), 1.0 / 48, 1e-12);
  std::vector<Eigen::Vector2d> all;
  for (int y = 50; y < 600; y += 100)
    for (int x = 50; x < 800; x += 100) all.emplace_back(x, y);
  EXPECT_NEAR(spread_of(all, camera), 1, 1e-12);
}

// What the agreement of loops rests on.
TEST(Agreement, TellsARightMotionFromAWrongOne) {
  const RectifiedCamera camera{.f = 200, .cx = 159.5, .cy = 119.5, .baseline = 0.1, .width = 320, .height = 240};
  const testing::BoxRoom room;
  const Pose pose_i = testing::level_camera({0, 0, 0}, 0.2), pose_j = testing::level_camera({0.3, 0.2, 0.1}, 0.5);
  const StereoView i = testing::view_of(room, camera, pose_i, 0.1, 1),
                   j = testing::view_of(room, camera, pose_j, 0.1, 2);
  const Pose truth = pose_i.inverse() * pose_j;
  motion::ViewFeatures of_i, of_j;
  of_i.disparity = i.disparity;
  of_j.disparity = j.disparity;
  EXPECT_LT(motion::agreement(of_i, of_j, truth, camera).contradiction(), 0.01);
  Pose wrong = truth;
  wrong.translation() += Eigen::Vector3d(0, 0, -0.8);
  EXPECT_GT(motion::agreement(of_i, of_j, wrong, camera).contradiction(), 0.4);
  const Pose back = truth * Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitY());
  EXPECT_EQ(motion::agreement(of_i, of_j, Eigen::Translation3d(0, 0, -50) * back, camera).agreeing, 0);
}

TEST(LoopVerdict, HasAName) {
  for (const LoopVerdict v :
       {LoopVerdict::accepted, LoopVerdict::no_motion, LoopVerdict::too_few_pairs, LoopVerdict::poorly_spread,
        LoopVerdict::not_symmetric, LoopVerdict::contradicted, LoopVerdict::inconsistent, LoopVerdict::unsupported}) {
    EXPECT_STRNE(name_of(v), "");
  }
}

}  // namespace
}  // namespace iris::loop
