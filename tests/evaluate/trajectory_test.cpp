#include "iris/evaluate/trajectory.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/evaluate/formats.h"
#include "support/test_data.h"

namespace iris::evaluate {
namespace {

using Eigen::AngleAxisd;
using Eigen::Vector3d;

constexpr int64_t kPeriod = 100'000'000;

Pose turned_about(const Vector3d& axis, double angle, const Vector3d& shift) {
  Pose pose = Pose::Identity();
  pose.linear() = AngleAxisd(angle, axis.normalized()).toRotationMatrix();
  pose.translation() = shift;
  return pose;
}

// A camera that climbs along a spiral and looks along its path.
Trajectory spiral(int n, double step = 0.1) {
  Trajectory path;
  for (int i = 0; i < n; ++i) {
    const double a = step * i;
    path.push_back({1'000'000'000 + i * kPeriod,
                    turned_about(Vector3d(0.1, 0.2, 1), a, Vector3d(2 * std::cos(a), 2 * std::sin(a), 0.05 * i))});
  }
  return path;
}

Trajectory straight(int n, double step) {
  Trajectory path;
  for (int i = 0; i < n; ++i) {
    Pose pose = Pose::Identity();
    pose.translation().x() = step * i;
    path.push_back({i * kPeriod, pose});
  }
  return path;
}

template <class Change>
Trajectory changed(Trajectory path, const Change& change) {
  for (size_t i = 0; i < path.size(); ++i) path[i].world_from_cam = change(i, path[i].world_from_cam);
  return path;
}

TEST(Trajectory, AnotherWorldIsNoError) {
  const Trajectory truth = spiral(80);
  const Pose world = turned_about({1, -2, 0.5}, 2.3, {10, -4, 7});
  const TrajectoryErrors e =
      evaluate_trajectory(changed(truth, [&](size_t, const Pose& p) { return world * p; }), truth, {});
  EXPECT_EQ(e.pairs.size(), 80u);
  EXPECT_LT(e.absolute.translation.max, 1e-9);
  EXPECT_LT(e.absolute.rotation.max, 1e-7);
  EXPECT_LT(e.per_frame.translation.max, 1e-9);
  EXPECT_LT(e.closing_translation, 1e-9);
  EXPECT_NEAR(e.scale_error, 0, 1e-12);
  EXPECT_LT((e.alignment.truth_from_estimate.matrix() - world.inverse().matrix()).norm(), 1e-9);
  EXPECT_FALSE(e.rotation_from_orientations);
}

TEST(Trajectory, TurningBothChangesNothing) {
  const Trajectory truth = spiral(60);
  std::mt19937 random(3);
  std::normal_distribution<double> normal(0, 0.01);
  const Trajectory estimate = changed(truth, [&](size_t, const Pose& p) {
    return Pose(p * turned_about({normal(random), normal(random), 1}, normal(random),
                                 {normal(random), normal(random), normal(random)}));
  });
  const Pose world = turned_about({3, 1, 0.5}, -1.1, {1, 2, 3});
  const auto turn = [&](size_t, const Pose& p) { return Pose(world * p); };
  const TrajectoryErrors a = evaluate_trajectory(estimate, truth, {});
  const TrajectoryErrors b = evaluate_trajectory(changed(estimate, turn), changed(truth, turn), {});
  EXPECT_GT(a.absolute.translation.rmse, 0.01);
  EXPECT_NEAR(a.absolute.translation.rmse, b.absolute.translation.rmse, 1e-10);
  EXPECT_NEAR(a.absolute.rotation.rmse, b.absolute.rotation.rmse, 1e-10);
  EXPECT_NEAR(a.per_second.translation.rmse, b.per_second.translation.rmse, 1e-10);
  EXPECT_NEAR(a.per_metre.rotation.rmse, b.per_metre.rotation.rmse, 1e-10);
  EXPECT_NEAR(a.mean_drift.translation, b.mean_drift.translation, 1e-10);
  EXPECT_NEAR(a.closing_translation, b.closing_translation, 1e-10);
}

TEST(Trajectory, OneCentimetreToAndFroIsOneCentimetre) {
  // Sideways of a long path: no rigid motion can take it away.
  const Trajectory truth = straight(400, 0.1);
  const TrajectoryErrors e = evaluate_trajectory(changed(truth,
                                                         [](size_t i, Pose p) {
                                                           p.translation().z() += i % 2 == 0 ? 0.01 : -0.01;
                                                           return p;
                                                         }),
                                                 truth, {});
  EXPECT_NEAR(e.absolute.translation.rmse, 0.01, 1e-6);
  EXPECT_NEAR(e.absolute.translation.median, 0.01, 1e-4);
  EXPECT_NEAR(e.per_frame.translation.rmse, 0.02, 1e-6);  // from +1 cm to -1 cm and back
  EXPECT_NEAR(e.per_second.translation.max, 0, 1e-5);  // ten frames on it is the same again, up to the alignment's tilt
  EXPECT_TRUE(e.rotation_from_orientations);
}

TEST(Trajectory, AJumpShowsWhereItIs) {
  // The second half is 1 cm further in the direction of travel.
  const Trajectory truth = straight(101, 0.1);
  const TrajectoryErrors e = evaluate_trajectory(changed(truth,
                                                         [](size_t i, Pose p) {
                                                           if (i > 50) p.translation().x() += 0.01;
                                                           return p;
                                                         }),
                                                 truth, {});
  EXPECT_NEAR(e.per_frame.translation.max, 0.01, 1e-12);
  EXPECT_NEAR(e.per_frame.translation.mean, 0.01 / 100, 1e-12);
  EXPECT_NEAR(e.closing_translation, 0.01, 1e-12);
  EXPECT_NEAR(e.true_gap, 10, 1e-12);
  EXPECT_NEAR(e.true_path, 10, 1e-9);
  EXPECT_NEAR(e.estimated_path, 10.01, 1e-9);
  // 51 poses are moved by -a, 50 by 1 cm - a, with a the mean: deviation sqrt(p (1 - p)) of 1 cm.
  const double p = 50.0 / 101;
  EXPECT_NEAR(e.absolute.translation.rmse, 0.01 * std::sqrt(p * (1 - p)), 1e-9);
  // Segments of 1 m: 10 of the 91 contain the jump.
  ASSERT_EQ(e.drift.size(), 4u);  // 1, 2, 5, 10 m
  EXPECT_EQ(e.drift[0].length, 1);
  EXPECT_EQ(e.drift[0].segments, 91);
  EXPECT_NEAR(e.drift[0].translation, 0.01 * 10 / 91, 1e-9);
}

TEST(Trajectory, AScaledPathHasThatScaleErrorAndDrift) {
  const Trajectory truth = straight(1001, 1);  // 1 km
  const auto scaled = [&](const Trajectory& path) {
    return changed(path, [](size_t, Pose p) {
      p.translation() *= 1.01;
      return p;
    });
  };
  const TrajectoryErrors e = evaluate_trajectory(scaled(truth), truth, {});
  EXPECT_NEAR(e.scale_error, 0.01, 1e-9);
  ASSERT_EQ(e.drift.size(), 8u);
  EXPECT_EQ(e.drift[0].length, 100);
  EXPECT_EQ(e.drift[7].length, 800);
  EXPECT_EQ(e.drift[7].segments, 201);
  for (const SegmentDrift& drift : e.drift) EXPECT_NEAR(drift.translation, 0.01, 1e-9);
  EXPECT_NEAR(e.mean_drift.rotation, 0, 1e-12);

  const Trajectory curved = spiral(100);
  EXPECT_GT(evaluate_trajectory(scaled(curved), curved, {}).absolute.translation.rmse, 0.01);
  const TrajectoryErrors similar = evaluate_trajectory(scaled(curved), curved, {.with_scale = true});
  EXPECT_LT(similar.absolute.translation.max, 1e-9);
  EXPECT_NEAR(similar.alignment.scale, 1 / 1.01, 1e-12);
  EXPECT_NEAR(similar.scale_error, 0.01, 1e-9);
}

TEST(Trajectory, TurningTooFarIsDriftOfRotation) {
  // Each frame of 0.5 m turns by 0.001 rad more than in truth.
  const Trajectory truth = straight(41, 0.5);
  const TrajectoryErrors e = evaluate_trajectory(changed(truth,
                                                         [](size_t i, Pose p) {
                                                           p.linear() =
                                                               AngleAxisd(0.001 * i, Vector3d::UnitZ()) * p.linear();
                                                           return p;
                                                         }),
                                                 truth, {});
  EXPECT_NEAR(e.mean_drift.rotation, 0.002, 1e-6);
  EXPECT_NEAR(e.per_metre.rotation.mean, 0.002, 1e-6);
  EXPECT_NEAR(e.closing_rotation, 0.04, 1e-6);
}

TEST(Trajectory, AConstantTurnOfTheCameraIsFoundAndTakenOut) {
  const Trajectory truth = spiral(100);
  const Pose recorded_from_rectified = turned_about({0.2, 1, -0.3}, 0.06, Vector3d::Zero());
  const TrajectoryErrors e = evaluate_trajectory(
      changed(truth, [&](size_t, const Pose& p) { return p * recorded_from_rectified; }), truth, {});
  EXPECT_NEAR(rotation_angle(e.estimate_from_truth_cam), 0.06, 1e-9);
  EXPECT_LT((e.estimate_from_truth_cam - recorded_from_rectified.linear().transpose()).norm(), 1e-9);
  EXPECT_LT(e.absolute.rotation.max, 1e-7);
  EXPECT_LT(e.per_frame.translation.max, 1e-9);
  EXPECT_LT(e.per_frame.rotation.max, 1e-7);
}

TEST(Trajectory, TheTurnAboutAStraightPathComesFromTheOrientations) {
  const Trajectory truth = straight(50, 0.2);
  const Pose world = turned_about({1, 2, 3}, 1.9, {5, 5, 5});
  std::mt19937 random(1);
  std::normal_distribution<double> normal(0, 0.001);
  const TrajectoryErrors e = evaluate_trajectory(changed(truth,
                                                         [&](size_t, Pose p) {
                                                           p = world * p;
                                                           p.translation() +=
                                                               Vector3d(normal(random), normal(random), normal(random));
                                                           return p;
                                                         }),
                                                 truth, {});
  EXPECT_TRUE(e.rotation_from_orientations);
  // Noise of 1 mm over 50 poses along 10 m turns the path by less than 0.2 mrad.
  EXPECT_LT(rotation_angle(Eigen::Matrix3d(e.world_alignment.truth_from_estimate.linear() * world.linear())), 5e-4);
  EXPECT_LT(e.absolute.rotation.max, 5e-4);
  // A camera that does not move.
  const Trajectory still = straight(20, 0);
  const TrajectoryErrors s =
      evaluate_trajectory(changed(still, [&](size_t, const Pose& p) { return world * p; }), still, {});
  EXPECT_LT(s.absolute.translation.max, 1e-12);
  EXPECT_LT(s.absolute.rotation.max, 1e-7);
}

TEST(Trajectory, TruthIsInterpolatedIfDenseAndTheNearestOtherwise) {
  // Uniform motion: the interpolation is exact.
  const auto pose_at = [](double t) { return turned_about({1, 1, 0}, 0.3 * t, {t, -2 * t, 0.5 * t}); };
  Trajectory dense, estimate;
  for (int i = 0; i < 200; ++i) dense.push_back({i * 5'000'000, pose_at(0.005 * i)});
  for (int i = 0; i < 12; ++i) estimate.push_back({2'000'000 + i * kPeriod, pose_at(0.002 + 0.1 * i)});
  auto pairs = associate(estimate, dense);
  ASSERT_EQ(pairs.size(), 10u);  // the last two are behind the end of the truth at 0.995 s
  for (const PosePair& pair : pairs) {
    EXPECT_LT((pair.truth.matrix() - pair.estimate.matrix()).norm(), 1e-12);
  }
  // Truth once a second, estimate ten times: only those nearer than half a period of the estimate.
  const Trajectory sparse = {{0, pose_at(0)}, {1'000'000'000, pose_at(1)}};
  pairs = associate(estimate, sparse);
  ASSERT_EQ(pairs.size(), 2u);
  EXPECT_EQ(pairs[1].stamp_ns, 1'002'000'000);
  EXPECT_LT((pairs[1].truth.matrix() - pose_at(1).matrix()).norm(), 1e-12);
  EXPECT_TRUE(associate(estimate, {{90'000'000'000, pose_at(0)}}).empty());
}

TEST(Trajectory, SpreadByHand) {
  const Spread s = spread_of({4, 1, 2, 3});
  EXPECT_EQ(s.count, 4);
  EXPECT_DOUBLE_EQ(s.mean, 2.5);
  EXPECT_DOUBLE_EQ(s.median, 2.5);
  EXPECT_DOUBLE_EQ(s.max, 4);
  EXPECT_DOUBLE_EQ(s.rmse, std::sqrt(7.5));
  EXPECT_EQ(spread_of({}).count, 0);
}

TEST(Trajectory, DriftLengths) {
  EXPECT_THAT(drift_lengths(3700), ::testing::ElementsAre(100, 200, 300, 400, 500, 600, 700, 800));
  EXPECT_THAT(drift_lengths(350), ::testing::ElementsAre(100, 200, 300));
  EXPECT_THAT(drift_lengths(60), ::testing::ElementsAre(5, 10, 20, 50));
  EXPECT_THAT(drift_lengths(5.4), ::testing::ElementsAre(0.5, 1, 2, 5));
  EXPECT_TRUE(drift_lengths(0).empty());
}

TEST(Consistency, QuantilesOfChiSquared) {
  // Tables of the distribution.
  EXPECT_NEAR(chi_squared_quantile(0.95, 1), 3.8415, 1e-4);
  EXPECT_NEAR(chi_squared_quantile(0.975, 6), 14.4494, 1e-4);
  EXPECT_NEAR(chi_squared_quantile(0.025, 6), 1.2373, 1e-4);
  EXPECT_NEAR(chi_squared_quantile(0.975, 100), 129.561, 1e-3);
  EXPECT_NEAR(chi_squared_quantile(0.5, 2), 2 * std::log(2.0), 1e-9);
  // Many degrees: normal.
  EXPECT_NEAR(chi_squared_quantile(0.975, 60000), 60000 + 1.95996 * std::sqrt(120000.0), 2.5);
}

// Motions with errors drawn from `covariance` (g2o's coordinates), stated with `stated`.
Consistency drawn(const Matrix6d& covariance, const Matrix6d& stated) {
  std::mt19937 random(7);
  std::normal_distribution<double> normal;
  const Matrix6d root = covariance.llt().matrixL();
  std::vector<MotionEdge> edges;
  std::map<int64_t, Pose> truth;
  const Trajectory path = spiral(1001);
  for (const StampedPose& pose : path) truth[pose.stamp_ns] = pose.world_from_cam;
  for (size_t i = 1; i < path.size(); ++i) {
    Vector6d noise;
    for (int k = 0; k < 6; ++k) noise(k) = normal(random);
    noise = root * noise;
    // Z^-1 X has translation and quaternion vector `noise`.
    Pose error = Pose::Identity();
    const Vector3d v = noise.tail<3>();
    error.linear() = Eigen::Quaterniond(std::sqrt(1 - v.squaredNorm()), v.x(), v.y(), v.z()).toRotationMatrix();
    error.translation() = noise.head<3>();
    const Pose x = path[i - 1].world_from_cam.inverse() * path[i].world_from_cam;
    edges.push_back({path[i - 1].stamp_ns, path[i].stamp_ns, x * error.inverse(), stated.inverse()});
  }
  edges.push_back({0, 1, Pose::Identity(), stated.inverse()});                                // no truth
  edges.push_back({path[0].stamp_ns, path[1].stamp_ns, Pose::Identity(), Matrix6d::Zero()});  // states nothing
  return evaluate_consistency(edges, truth);
}

TEST(Consistency, ErrorsOfTheStatedCovarianceLieInTheBand) {
  Matrix6d mix = Matrix6d::Random();
  const Matrix6d covariance = 1e-6 * (mix * mix.transpose() + Matrix6d::Identity());
  const Consistency right = drawn(covariance, covariance);
  EXPECT_EQ(right.edges, 1000);
  EXPECT_EQ(right.skipped, 2);
  EXPECT_GT(right.mean, right.mean_low);
  EXPECT_LT(right.mean, right.mean_high);
  EXPECT_NEAR(right.mean_low, 6 - 1.96 * std::sqrt(12.0 / 1000), 0.01);
  EXPECT_NEAR(right.share_within, 0.95, 0.02);  // deviation 0.7 %
  EXPECT_NEAR(right.share_above, 0.025, 0.015);
  EXPECT_NEAR(right.translation_mean, 3, 0.25);  // deviation sqrt(6 / 1000) = 0.08
  EXPECT_NEAR(right.rotation_mean, 3, 0.25);
  EXPECT_NEAR(right.rotation_factor, 1, 0.04);

  const Consistency proud = drawn(covariance, covariance / 4);
  EXPECT_GT(proud.mean, proud.mean_high);
  EXPECT_NEAR(proud.mean, 24, 1.5);
  EXPECT_NEAR(proud.translation_factor, 2, 0.1);
  EXPECT_GT(proud.share_above, 0.7);
  const Consistency timid = drawn(covariance, covariance * 4);
  EXPECT_LT(timid.mean, timid.mean_low);
}

// --- formats
// ----------------------------------------------------------------------------------------------------------

std::string problem_of(const std::function<void()>& parse) {
  try {
    parse();
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

TEST(Formats, TumWithCommentsCommasAndNanoseconds) {
  const Trajectory path = parse_tum(
      "# t x y z q\n\n1403636579.763555527 1 2 3 0 0 0 1\r\n1403636580.0,4,5,6,0.6,0,0,0.8\n"
      "1403636581\t7 8 +9 0 0 0 -1\n",
      "p.tum");
  ASSERT_EQ(path.size(), 3u);
  EXPECT_EQ(path[0].stamp_ns, 1403636579763555527);  // a double would round it
  EXPECT_EQ(path[1].stamp_ns, 1403636580000000000);
  EXPECT_EQ(path[2].stamp_ns, 1403636581000000000);
  EXPECT_EQ(path[2].world_from_cam.translation(), Vector3d(7, 8, 9));
  EXPECT_NEAR(rotation_angle(path[1].world_from_cam), 2 * std::asin(0.6), 1e-12);
  EXPECT_EQ(parse_tum("1403636579763555527 0 0 0 0 0 0 1", "p")[0].stamp_ns, 1403636579763555527);
  EXPECT_EQ(parse_tum("-0.5 0 0 0 0 0 0 1", "p")[0].stamp_ns, -500000000);
  EXPECT_EQ(parse_tum("1.5e1 0 0 0 0 0 0 1", "p")[0].stamp_ns, 15000000000);
}

TEST(Formats, WhatIsWrongIsNamedWithItsLine) {
  using ::testing::AllOf;
  using ::testing::HasSubstr;
  const auto tum = [](const std::string& text) { return problem_of([&] { parse_tum(text, "p.tum"); }); };
  EXPECT_THAT(tum("0 0 0 0 0 0 0 1\n1 0 0 nan 0 0 0 1\n"),
              AllOf(HasSubstr("p.tum"), HasSubstr("line 2"), HasSubstr("nan")));
  EXPECT_THAT(tum("0 0 0 0 0 0 1\n"), HasSubstr("7 columns"));
  EXPECT_THAT(tum("0 0 0 x 0 0 0 1\n"), HasSubstr("'x' is no number"));
  EXPECT_THAT(tum("1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n"), HasSubstr("not later"));
  EXPECT_THAT(tum("1 0 0 0 0 0 0 0\n"), HasSubstr("quaternion"));
  EXPECT_THAT(tum("# nothing\n"), HasSubstr("no pose"));
  EXPECT_THAT(tum("1,2,3,4,5,6,7,8,9,10,11,12,13,14,15,16,17\n"), HasSubstr("T_BS"));
  EXPECT_THAT(problem_of([] { parse_kitti("1 0 0 0 0 2 0 0 0 0 1 0\n", "poses.txt"); }), HasSubstr("rotation"));
  EXPECT_THAT(problem_of([] { parse_ros_map("image: a.pgm\n", "map.yaml"); }), HasSubstr("no map of ROS"));
  EXPECT_THAT(problem_of([] { parse_ros_map("image: a\nresolution: 0\norigin: [0, 0, 0]\n", "m"); }),
              HasSubstr("above 0"));
}

TEST(Formats, KittiPosesCountByLine) {
  const std::string text =
      "1 0 0 0 0 1 0 0 0 0 1 0\nnan nan nan nan nan nan nan nan nan nan nan nan\n"
      "0 -1 0 1 1 0 0 2 0 0 1 3\n";
  EXPECT_TRUE(is_kitti(text));
  EXPECT_FALSE(is_kitti("# c\n1 2 3 4 5 6 7 8\n"));
  const auto poses = parse_kitti(text, "p");
  ASSERT_EQ(poses.size(), 3u);
  EXPECT_FALSE(poses[1]);
  EXPECT_NEAR(rotation_angle(*poses[2]), M_PI / 2, 1e-12);
  EXPECT_EQ(poses[2]->translation(), Vector3d(1, 2, 3));
}

TEST(Formats, TheTruthOfARecordingIsRead) {
  IRIS_NEEDS_TEST_DATA("euroc_mh01");
  const auto path = iris::testing::test_data("euroc_mh01") / "truth_left_camera.tum";
  const Trajectory truth = parse_tum(read_file(path), path);
  ASSERT_GT(truth.size(), 3000u);
  EXPECT_EQ(truth[0].stamp_ns, 1403636584563560009);
  EXPECT_EQ(truth[1].stamp_ns - truth[0].stamp_ns, 4999876);
  // Against itself, every 20th pose: no error.
  Trajectory some;
  for (size_t i = 0; i < truth.size(); i += 20) some.push_back(truth[i]);
  const TrajectoryErrors e = evaluate_trajectory(some, truth, {});
  EXPECT_LT(e.absolute.translation.max, 1e-9);
  EXPECT_NEAR(e.true_path, 5.5, 0.1);
}

}  // namespace
}  // namespace iris::evaluate
