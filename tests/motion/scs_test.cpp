#include "iris/motion/scs.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cstring>
#include <numbers>
#include <random>

#include "iris/motion/chain.h"
#include "support/synthetic_views.h"

namespace iris::motion {
namespace {

const RectifiedCamera kCamera{.f = 270, .cx = 200, .cy = 150, .baseline = 0.12, .width = 400, .height = 300};
constexpr double kDegree = std::numbers::pi / 180;

Pose pose(const Eigen::Vector3d& position, double yaw, double pitch, double roll) {
  Pose world_from_cam = Pose::Identity();
  world_from_cam.linear() = (Eigen::AngleAxisd(yaw * kDegree, Eigen::Vector3d::UnitY()) *
                             Eigen::AngleAxisd(pitch * kDegree, Eigen::Vector3d::UnitX()) *
                             Eigen::AngleAxisd(roll * kDegree, Eigen::Vector3d::UnitZ()))
                                .toRotationMatrix();
  world_from_cam.translation() = position;
  return world_from_cam;
}

ViewFeatures features_at(const Pose& world_from_cam, const ScsOptions& options) {
  const testing::SyntheticView view = testing::render_room({}, kCamera, world_from_cam);
  return extract_features(view.image, view.disparity, kCamera, options);
}

struct Case {
  const char* name;
  Pose prev, cur;
};

class EstimateMotion : public ::testing::TestWithParam<std::string> {};

TEST_P(EstimateMotion, RecoversKnownMotionsOfARenderedRoom) {
  ScsOptions options;
  options.model = GetParam();
  const Pose start = pose({-0.2, 0, -1.5}, 5, -3, 2);
  const ViewFeatures prev = features_at(start, options);
  for (const Case& c : {Case{"none", start, start}, Case{"aside", start, pose({0.05, 0.05, -1.4}, 8, -2, 4)},
                        Case{"forward", start, pose({-0.15, -0.05, -1.1}, 4, -3, 2)},
                        Case{"rolled", start, pose({-0.2, 0.02, -1.45}, 5, -3, 10)}}) {
    const MotionEstimate estimate = estimate_motion(prev, features_at(c.cur, options), kCamera, options);
    ASSERT_EQ(estimate.status, MotionStatus::ok) << c.name;
    const Pose error = (c.prev.inverse() * c.cur).inverse() * estimate.prev_from_cur;
    // About 100 pairs with 0.1 px at depths around 4 m: 0.1 px / 270 px / sqrt(100) is 0.002 degrees of rotation and
    // 0.15 mm across; along, 0.1 sqrt(2) 16 / (270 * 0.12) / sqrt(100) = 7 mm. The matches of the turned and scaled
    // texture are a few times worse than 0.1 px.
    const double scale = GetParam() == "spherical" ? 4 : 1;
    EXPECT_LT(error.translation().norm(), scale * 0.006) << c.name;
    EXPECT_LT(rotation_angle(error), scale * 0.06 * kDegree) << c.name;
    EXPECT_LT(estimate.rms_px, 0.3) << c.name;
    EXPECT_GE(estimate.used, 60) << c.name;
    EXPECT_LE(estimate.used, estimate.consistent);
    EXPECT_LE(estimate.consistent, estimate.initial);
    EXPECT_LE(estimate.initial, estimate.corners);
    EXPECT_EQ(Eigen::LLT<Matrix6d>(estimate.covariance).info(), Eigen::Success);
  }
}

TEST_P(EstimateMotion, RecoversAQuarterTurnAboutTheOpticalAxis) {
  ScsOptions options;
  options.model = GetParam();
  const Pose start = pose({-0.2, 0, -1.5}, 5, -3, 2);
  const ViewFeatures prev = features_at(start, options);
  for (const double roll : {90.0, -90.0, 180.0}) {
    const Pose end = pose({-0.1, 0.05, -1.4}, 7, -2, 2 + roll);
    const ViewFeatures cur = features_at(end, options);
    const MotionEstimate estimate = estimate_motion(prev, cur, kCamera, options);
    ASSERT_EQ(estimate.status, MotionStatus::ok) << roll;
    const Pose error = (start.inverse() * end).inverse() * estimate.prev_from_cur;
    const double scale = GetParam() == "spherical" ? 4 : 1;
    EXPECT_LT(error.translation().norm(), scale * 0.008) << roll;
    EXPECT_LT(rotation_angle(error), scale * 0.08 * kDegree) << roll;
    options.quarter_turns = false;
    EXPECT_EQ(estimate_motion(prev, cur, kCamera, options).status, MotionStatus::too_few_consistent);
    options.quarter_turns = true;
  }
}

TEST(RejectSuspicious, SwitchedOffUsesAllConsistentPairs) {
  ScsOptions options;
  const ViewFeatures prev = features_at(pose({-0.2, 0, -1.5}, 5, -3, 2), options);
  const ViewFeatures cur = features_at(pose({0.05, 0.05, -1.4}, 8, -2, 4), options);
  const MotionEstimate with = estimate_motion(prev, cur, kCamera, options);
  options.reject_suspicious = false;
  const MotionEstimate without = estimate_motion(prev, cur, kCamera, options);
  ASSERT_EQ(with.status, MotionStatus::ok);
  ASSERT_EQ(without.status, MotionStatus::ok);
  EXPECT_EQ(without.consistent, with.consistent);
  EXPECT_EQ(without.used, without.consistent);
  EXPECT_LT(with.used, with.consistent);
}

INSTANTIATE_TEST_SUITE_P(Models, EstimateMotion, ::testing::Values("spherical", "ellipsoid", "drift", "image"),
                         [](const auto& info) { return info.param; });

TEST(EstimateMotionFails, WithTooFewCornersOnAnEmptyWall) {
  DisparityImage disparity{cv::Mat1f(300, 400, 10.0f), cv::Mat1b(300, 400, uint8_t{1})};
  const ViewFeatures empty = extract_features(cv::Mat1b(300, 400, uint8_t{90}), disparity, kCamera, {});
  EXPECT_EQ(empty.corners.size(), 0u);
  const ViewFeatures good = features_at(pose({0, 0, -1.5}, 0, 0, 0), {});
  EXPECT_EQ(estimate_motion(good, empty, kCamera, {}).status, MotionStatus::too_few_corners);
  EXPECT_EQ(estimate_motion(empty, good, kCamera, {}).status, MotionStatus::too_few_corners);
}

TEST(EstimateMotionFails, WithTooFewConsistentBetweenDifferentWalls) {
  const ViewFeatures front = features_at(pose({0, 0, -1.5}, 0, 0, 0), {});
  const ViewFeatures back = features_at(pose({0, 0, 1.0}, 180, 0, 0), {});
  const cv::Mat1b front_image = front.image.clone(), back_image = back.image.clone();
  const MotionEstimate estimate = estimate_motion(front, back, kCamera, {});
  EXPECT_EQ(estimate.status, MotionStatus::too_few_consistent);
  EXPECT_EQ(cv::norm(front.image, front_image, cv::NORM_INF), 0);  // the attempts with turned images left them alone
  EXPECT_EQ(cv::norm(back.image, back_image, cv::NORM_INF), 0);
  EXPECT_GT(estimate.corners, 100);
  EXPECT_EQ(estimate.prev_from_cur.matrix(), Pose::Identity().matrix());
}

TEST(EstimateMotionFails, AsDegenerateWithPointsNearlyOnALine) {
  // Only corners in a strip of 5 rows: 0.1 px of noise leave the turn about the strip open by several degrees.
  ScsOptions options;
  options.max_corners = 4000;
  options.min_strength = 0.01;
  const ViewFeatures all = features_at(pose({0, 0, 0}, 0, 0, 0), options);  // a wall at 4 m fills the image
  ViewFeatures strip = all;
  strip.corners.clear();
  strip.patches.clear();
  for (size_t i = 0; i < all.corners.size(); ++i) {
    if (std::abs(all.corners[i].y - 110) > 2.5) continue;
    strip.corners.push_back(all.corners[i]);
    strip.patches.push_back(all.patches[i]);
  }
  ASSERT_GE(strip.corners.size(), 8u);
  options.min_used = 4;
  const MotionEstimate estimate = estimate_motion(strip, strip, kCamera, options);
  EXPECT_EQ(estimate.status, MotionStatus::degenerate);
  EXPECT_GE(estimate.used, 4);
}

class Chain : public ::testing::Test {
 protected:
  static const std::vector<ViewFeatures>& views() {
    // Seven steps along the room; view 3 looks at an empty wall, view 5 the other way.
    static const std::vector<ViewFeatures> result = [] {
      std::vector<ViewFeatures> v;
      for (int i = 0; i < 8; ++i) v.push_back(features_at(world(i), {}));
      DisparityImage disparity{cv::Mat1f(300, 400, 10.0f), cv::Mat1b(300, 400, uint8_t{1})};
      v[3] = extract_features(cv::Mat1b(300, 400, uint8_t{90}), disparity, kCamera, {});
      return v;
    }();
    return result;
  }
  static Pose world(int i) { return pose({-0.2 + 0.05 * i, 0, -1.5 + 0.04 * i}, 5 - 1.0 * i, -3, 2 + 0.5 * i); }
};

bool equal_bits(const Pose& a, const Pose& b) { return std::memcmp(a.data(), b.data(), sizeof(double) * 16) == 0; }

TEST_F(Chain, ChainsPosesAndStartsASubMapWhereNoMotionIsFound) {
  MotionChain chain(kCamera, {});
  std::vector<ChainStep> steps;
  for (int i = 0; i < 8; ++i) steps.push_back(chain.push(views()[i], i));
  EXPECT_TRUE(steps[0].new_submap);
  EXPECT_EQ(steps[0].reference_frame, -1);
  for (const int i : {1, 2}) {
    EXPECT_EQ(steps[i].submap, 0);
    EXPECT_EQ(steps[i].reference_frame, i - 1);
    const Pose error = (world(0).inverse() * world(i)).inverse() * steps[i].world_from_cam;
    EXPECT_LT(error.translation().norm(), 0.02);
    EXPECT_LT(rotation_angle(error), 0.2 * kDegree);
  }
  EXPECT_TRUE(steps[3].new_submap);
  EXPECT_EQ(steps[3].submap, 1);
  EXPECT_EQ(steps[3].estimate.status, MotionStatus::too_few_corners);
  EXPECT_TRUE(equal_bits(steps[3].world_from_cam, Pose::Identity()));
  // The path goes on behind the spoilt view, in the sub-map before it.
  EXPECT_EQ(steps[4].reference_frame, 2);
  EXPECT_EQ(steps[4].submap, 0);
  EXPECT_LT(((world(0).inverse() * world(7)).inverse() * steps[7].world_from_cam).translation().norm(), 0.04);
}

TEST_F(Chain, NumbersOfSubMapsAreNeverUsedTwice) {
  MotionChain chain(kCamera, {});
  chain.restore({{10, views()[0], Pose::Identity(), 0}}, 3);
  EXPECT_EQ(chain.push(views()[3], 11).submap, 3);
  EXPECT_EQ(chain.push(views()[1], 12).submap, 0);
}

TEST_F(Chain, RetriesEarlierViews) {
  ScsOptions options;
  MotionChain chain(kCamera, options);
  chain.push(views()[0], 10);
  chain.push(views()[1], 11);
  // A view that only the one before the previous one overlaps: the previous one is an empty wall.
  MotionChain restored(kCamera, options);
  restored.restore({{10, views()[0], Pose::Identity(), 4}, {11, views()[3], Pose::Identity(), 4}}, 5);
  const ChainStep step = restored.push(views()[1], 12);
  EXPECT_EQ(step.reference_frame, 10);
  EXPECT_EQ(step.submap, 4);
  EXPECT_FALSE(step.new_submap);
  options.retry_views = 0;
  MotionChain impatient(kCamera, options);
  impatient.restore({{10, views()[0], Pose::Identity(), 4}, {11, views()[3], Pose::Identity(), 4}}, 5);
  EXPECT_TRUE(impatient.push(views()[1], 12).new_submap);
}

TEST_F(Chain, GoesOnBitByBitAfterARestart) {
  ScsOptions options;
  options.retry_views = 2;
  MotionChain whole(kCamera, options);
  std::vector<ChainStep> steps;
  for (int i = 0; i < 8; ++i) steps.push_back(whole.push(views()[i], i));
  for (int cut = 1; cut < 8; ++cut) {
    MotionChain chain(kCamera, options);
    std::vector<MotionChain::Restored> last;
    for (int i = std::max(0, cut - 3); i < cut; ++i) {
      last.push_back({i, views()[i], steps[i].world_from_cam, steps[i].submap});
    }
    int submaps = 0;
    for (int i = 0; i < cut; ++i) submaps += steps[i].new_submap;
    chain.restore(last, submaps);
    for (int i = cut; i < 8; ++i) {
      const ChainStep step = chain.push(views()[i], i);
      EXPECT_TRUE(equal_bits(step.world_from_cam, steps[i].world_from_cam)) << cut << " " << i;
      EXPECT_EQ(step.submap, steps[i].submap);
      EXPECT_EQ(step.new_submap, steps[i].new_submap);
      EXPECT_EQ(step.reference_frame, steps[i].reference_frame);
      EXPECT_EQ(step.estimate.used, steps[i].estimate.used);
      EXPECT_EQ(step.estimate.rms_px, steps[i].estimate.rms_px);
    }
  }
}

TEST(ScsOptionsDeclaration, HasValidDefaultsAndNoDoubleNames) {
  ScsOptions options;
  OptionSet set;
  options.declare(set);
  EXPECT_NO_THROW(set.validate());
  set.set("motion.model", "image");
  EXPECT_EQ(options.model, "image");
}

}  // namespace
}  // namespace iris::motion
