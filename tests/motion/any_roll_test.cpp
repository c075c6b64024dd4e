// Views that are turned about the optical axis by any angle, nearer and farther; motions that the views contradict.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "iris/motion/agreement.h"
#include "iris/motion/rescue.h"
#include "iris/motion/scs.h"
#include "src/motion/rolled_matches.h"
#include "support/synthetic_views.h"

namespace iris::motion {
namespace {

const RectifiedCamera kCamera{.f = 270, .cx = 200, .cy = 150, .baseline = 0.12, .width = 400, .height = 300};
constexpr double kDegree = std::numbers::pi / 180;
using iris::testing::pose;

ViewFeatures features_at(const Pose& world_from_cam) {
  const testing::SyntheticView view = testing::render_room({}, kCamera, world_from_cam);
  return extract_features(view.image, view.disparity, kCamera, {});
}

const Pose kStart = pose({-0.2, 0, -1.5}, 5, -3, 2);
const ViewFeatures& start_view() {
  static const ViewFeatures view = features_at(kStart);
  return view;
}

TEST(RolledMatches, NameTheRollAndPairCornersOfOnePoint) {
  for (const double roll : {0.0, 28.0, 45.0, 100.0, -165.0}) {
    const Pose end = pose({-0.15, 0.03, -1.3}, 6, -2, 2 + roll);
    const ViewFeatures cur = features_at(end);
    const auto groups = rolled_matches(start_view(), cur, {}, 2);
    ASSERT_EQ(groups.size(), 2u);
    // The view of a camera that rolls clockwise is to be turned clockwise as well; in steps of 30 degrees.
    EXPECT_LE(std::abs(std::remainder(groups[0].roll - roll * kDegree, 2 * std::numbers::pi)), 16 * kDegree) << roll;
    const Pose cur_from_prev = end.inverse() * kStart;
    int right = 0;
    for (const RolledMatch& match : groups[0].matches) {
      const Eigen::Vector3d expected =
          kCamera.project(cur_from_prev * start_view().corners[match.prev_corner].point_in_cam);
      const Corner& corner = cur.corners[match.cur_corner];
      right += std::hypot(expected.x() - corner.x, expected.y() - corner.y) < 3;
      EXPECT_LE(std::abs(std::remainder(match.roll - groups[0].roll, 2 * std::numbers::pi)), 31 * kDegree);
    }
    EXPECT_GT(right, 0.4 * static_cast<double>(groups[0].matches.size())) << roll;
    EXPECT_GE(right, 40) << roll;
  }
}

TEST(RolledMatches, BearAChangeOfScale) {
  // From 4.5 m to 2.5 m before the wall, or back: the surroundings grow or shrink by 1.8.
  const ViewFeatures far = features_at(pose({0, 0, -2.5}, 0, 0, 0)), near = features_at(pose({0, 0, -0.5}, 0, 0, 30));
  for (const bool forward : {true, false}) {
    const ViewFeatures &prev = forward ? far : near, &cur = forward ? near : far;
    const auto groups = rolled_matches(prev, cur, {}, 1);
    int right = 0;
    for (const RolledMatch& match : groups[0].matches) {
      const Eigen::AngleAxisd turn((forward ? 1 : -1) * 30 * kDegree, Eigen::Vector3d::UnitZ());
      Eigen::Vector3d moved = turn * cur.corners[match.cur_corner].point_in_cam;
      moved.z() += forward ? 2 : -2;
      right += (moved - prev.corners[match.prev_corner].point_in_cam).head<2>().norm() < 0.05;
    }
    EXPECT_GE(right, 20) << forward;
  }
}

// No motion leads from a world into its mirror image, although both look alike: whatever is found is false.
TEST(EstimateMotion, FindsNothingBetweenAWorldAndItsMirrorImage) {
  std::vector<ViewFeatures> views, mirrored;
  for (int i = 0; i < 5; ++i) {
    const Pose world_from_cam = pose({-0.3 + 0.15 * i, 0.02 * i, -1.5 + 0.3 * i}, 10.0 * i - 20, -3, 36.0 * i);
    testing::SyntheticView view = testing::render_room({}, kCamera, world_from_cam);
    views.push_back(extract_features(view.image, view.disparity, kCamera, {}));
    cv::flip(view.image, view.image, 1);
    cv::flip(view.disparity.disparity, view.disparity.disparity, 1);
    cv::flip(view.disparity.origin, view.disparity.origin, 1);
    RectifiedCamera camera = kCamera;
    camera.cx = kCamera.width - 1 - kCamera.cx;
    mirrored.push_back(extract_features(view.image, view.disparity, camera, {}));
  }
  for (const ViewFeatures& view : views) {
    for (const ViewFeatures& mirror : mirrored) {
      ASSERT_GE(std::min(view.corners.size(), mirror.corners.size()), 100u);
      EXPECT_NE(estimate_motion(view, mirror, kCamera, {}).status, MotionStatus::ok);
    }
  }
}

class AnyRoll : public ::testing::TestWithParam<int> {};

TEST_P(AnyRoll, IsNoObstacle) {
  const Pose end = pose({-0.1, 0.05, -1.4}, 7, -2, 2 + GetParam());
  const MotionEstimate estimate = estimate_motion(start_view(), features_at(end), kCamera, {});
  ASSERT_EQ(estimate.status, MotionStatus::ok);
  const Pose error = (kStart.inverse() * end).inverse() * estimate.prev_from_cur;
  // As with quarter turns: see scs_test.cpp.
  EXPECT_LT(error.translation().norm(), 0.008);
  EXPECT_LT(rotation_angle(error), 0.08 * kDegree);
  ScsOptions options;
  options.any_roll = false;
  if (std::abs(GetParam()) >= 40) {
    EXPECT_NE(estimate_motion(start_view(), features_at(end), kCamera, options).status, MotionStatus::ok);
  }
}

INSTANTIATE_TEST_SUITE_P(Degrees, AnyRoll, ::testing::Values(-165, -135, -75, -45, -20, 25, 40, 60, 105, 150, 180),
                         [](const auto& info) {
                           return (info.param < 0 ? "minus" : "") + std::to_string(std::abs(info.param));
                         });

TEST(Agreement, OfTheTrueMotionIsFullAndWithoutContradiction) {
  const Pose end = pose({0.05, 0.05, -1.4}, 8, -2, 20);
  const ViewFeatures cur = features_at(end);
  const Pose truth = kStart.inverse() * end;
  const Agreement views = agreement(start_view(), cur, truth, kCamera);
  // Corners that leave the image and those behind others are not expected.
  EXPECT_GT(views.expected, 0.6 * static_cast<double>(start_view().corners.size()));
  EXPECT_GT(views.agreeing, 1000);
  EXPECT_LT(views.contradiction(), 0.005);
  // Off by 2.5 m: one view looks through all that the other one sees of the far wall, which hides it in turn.
  Pose wrong = truth;
  wrong.translation().z() += 2.5;
  EXPECT_GT(agreement(start_view(), cur, wrong, kCamera).contradiction(), 0.2);
}

TEST(Agreement, CountsWhatIsLookedThroughButNotWhatIsHidden) {
  // A plane at 40 px; one view has a nearer object before it. Whichever view it is, the other one looks through it.
  DisparityImage plane{cv::Mat1f(300, 400, 40.0f),
                       cv::Mat1b(300, 400, static_cast<uint8_t>(DisparityOrigin::measured))};
  DisparityImage object = {plane.disparity.clone(), plane.origin.clone()};
  object.disparity(cv::Rect(80, 80, 80, 80)).setTo(60);
  const ViewFeatures a{.image = cv::Mat1b(300, 400, uint8_t{0}), .disparity = plane, .corners = {}, .patches = {}};
  const ViewFeatures b{.image = a.image, .disparity = object, .corners = {}, .patches = {}};
  EXPECT_EQ(agreement(a, a, Pose::Identity(), kCamera).against, 0);
  for (const bool first : {true, false}) {
    const Agreement views = agreement(first ? a : b, first ? b : a, Pose::Identity(), kCamera);
    // 10 x 10 samples of the object, but for its rim of 2 px, where the plane is seen beside it.
    EXPECT_NEAR(views.against, 100, 20);
    EXPECT_GT(views.agreeing, 3000);
  }
}

TEST(Confirmed, OnlyIfTheViewsBearTheMotionOut) {
  const Pose end = pose({0.05, 0.05, -1.4}, 8, -2, 4);
  const ViewFeatures cur = features_at(end);
  const Pose truth = kStart.inverse() * end;
  TracedMotion motion = trace_motion(start_view(), cur, kCamera, {});
  ASSERT_EQ(motion.estimate.status, MotionStatus::ok);
  EXPECT_EQ(confirmed(motion, start_view(), cur, kCamera, {}).estimate.status, MotionStatus::ok);
  // As wrong as a repeated pattern makes it.
  for (const Eigen::Vector3d& shift : {Eigen::Vector3d(0.5, 0, 0), Eigen::Vector3d(0, 0, 0.4)}) {
    motion.estimate.prev_from_cur = truth;
    motion.estimate.prev_from_cur.translation() += shift;
    const TracedMotion judged = confirmed(motion, start_view(), cur, kCamera, {});
    EXPECT_EQ(judged.estimate.status, MotionStatus::too_few_consistent);
    EXPECT_TRUE(judged.used.empty());
    EXPECT_EQ(judged.estimate.prev_from_cur.matrix(), Pose::Identity().matrix());
  }
}

}  // namespace
}  // namespace iris::motion
