#include "iris/motion/scs.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cstring>
#include <numbers>
#include <random>

#include "iris/motion/chain.h"
#include "iris/motion/motion_picture.h"
#include "support/synthetic_views.h"

namespace iris::motion {
namespace {

const RectifiedCamera kCamera{.f = 270, .cx = 200, .cy = 150, .baseline = 0.12, .width = 400, .height = 300};
constexpr double kDegree = std::numbers::pi / 180;
using iris::testing::pose;

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
    EXPECT_GT(estimate.used, 0.95 * estimate.consistent);  // prediction finds most again, and others too
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
    options.any_roll = false;
    EXPECT_EQ(estimate_motion(prev, cur, kCamera, options).status, MotionStatus::too_few_consistent);
    options.any_roll = true;
  }
}

TEST(RejectSuspicious, SwitchedOffUsesAllConsistentPairs) {
  ScsOptions options;
  options.predict = false;
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

TEST(Predict, FindsCornersWhereTheMotionPutsThemAndMakesTheMotionMoreAccurate) {
  ScsOptions options;
  const Pose start = pose({-0.2, 0, -1.5}, 5, -3, 2);
  const ViewFeatures prev = features_at(start, options);
  double with = 0, without = 0;
  for (const Pose& end : {pose({0.05, 0.05, -1.4}, 8, -2, 4), pose({-0.15, -0.05, -1.1}, 4, -3, 2),
                          pose({-0.2, 0.02, -1.45}, 5, -3, 10), pose({-0.3, 0.0, -1.6}, 7, 1, -2)}) {
    const ViewFeatures cur = features_at(end, options);
    const Pose truth = start.inverse() * end;
    // Positions: the truth is the corner's exact place, whatever the corner detector makes of it.
    const auto found = predicted_matches(prev, cur, truth, kCamera, options);
    std::vector<double> errors;
    for (const Correspondence& c : found) {
      const Eigen::Vector3d expected = kCamera.project(truth.inverse() * c.prev_point);
      errors.push_back((kCamera.project(c.cur_point) - expected).head<2>().norm());
    }
    EXPECT_GT(found.size(), prev.corners.size() / 2);
    std::nth_element(errors.begin(), errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2), errors.end());
    EXPECT_LT(errors[errors.size() / 2], 0.1);  // measured: 0.03 to 0.063 px
    options.predict = true;
    with += (estimate_motion(prev, cur, kCamera, options).prev_from_cur.translation() - truth.translation()).norm();
    options.predict = false;
    without += (estimate_motion(prev, cur, kCamera, options).prev_from_cur.translation() - truth.translation()).norm();
  }
  EXPECT_LT(with, 0.9 * without);
}

// Correspondences with measurement noise in a volume before the camera.
std::vector<Correspondence> simulated(int count, const Pose& prev_from_cur, const Eigen::Vector3d& low,
                                      const Eigen::Vector3d& high, std::mt19937_64& random, double noise_px = 0.1) {
  std::uniform_real_distribution<double> unit(0, 1);
  std::normal_distribution<double> noise(0, noise_px);
  const auto measured = [&](const Eigen::Vector3d& p) {
    const Eigen::Vector3d pixel = kCamera.project(p);
    const double left = noise(random), right = noise(random), rows = (noise(random) + noise(random)) / 2;
    return kCamera.point(pixel.x() + left, pixel.y() + rows, pixel.z() + left - right);
  };
  std::vector<Correspondence> result;
  for (int i = 0; i < count; ++i) {
    const Eigen::Vector3d cur =
        low + (high - low).cwiseProduct(Eigen::Vector3d(unit(random), unit(random), unit(random)));
    result.push_back({i, i, measured(prev_from_cur * cur), measured(cur), 0});
  }
  return result;
}

const Eigen::Vector3d kLow(-1.2, -0.8, 1.8), kHigh(1.2, 0.8, 3.6);

// How many standard deviations a motion is off, as the root of the normalised squared error.
double deviations(const MotionEstimate& estimate, const Pose& truth) {
  Vector6d error;
  error.head<3>() = estimate.prev_from_cur.translation() - truth.translation();
  const Eigen::AngleAxisd turn(Eigen::Matrix3d(estimate.prev_from_cur.linear() * truth.linear().transpose()));
  error.tail<3>() = turn.angle() * turn.axis();
  return std::sqrt(error.dot(estimate.covariance.llt().solve(error)));
}

// Motions of 200 correspondences of which two out of five are random, and of the good ones alone.
struct Spoilt {
  TracedMotion with, without;
  std::vector<bool> in_with = std::vector<bool>(200), in_without = std::vector<bool>(200);  // used ones
};

Spoilt spoilt_by_forty_percent(const Pose& truth, unsigned seed, double noise_px) {
  std::mt19937_64 random(seed);
  std::vector<Correspondence> spoilt = simulated(200, truth, kLow, kHigh, random, noise_px);
  std::vector<Correspondence> clean;
  for (int i = 0; i < 200; ++i) {
    if (i % 5 < 2) {
      spoilt[i].cur_point = simulated(1, truth, kLow, kHigh, random, noise_px)[0].cur_point;
    } else {
      clean.push_back(spoilt[i]);
    }
  }
  Spoilt result{.with = motion_from(spoilt, 0, kCamera, {}), .without = motion_from(clean, 0, kCamera, {})};
  for (const Correspondence& c : result.with.used) result.in_with[c.prev_corner] = true;
  for (const Correspondence& c : result.without.used) result.in_without[c.prev_corner] = true;
  return result;
}

// Noise so small that all good pairs are consistent with each other, neighbours too, whose direction (5.3) noise turns
// most: the first point chosen, one with most consistencies, keeps them all, and no random one that contradicts any of
// them can enter. From there on both computations are the same ones: inliers and motion are equal bit by bit.
TEST(MotionFrom, IsExactlyTheSameWhenFortyPercentOfTheCorrespondencesAreRandom) {
  const Pose truth = pose({0.1, -0.05, 0.15}, 4, -2, 3);
  for (unsigned seed = 0; seed < 20; ++seed) {
    const Spoilt spoilt = spoilt_by_forty_percent(truth, seed, 0.003);
    ASSERT_EQ(spoilt.with.estimate.status, MotionStatus::ok);
    ASSERT_EQ(spoilt.with.estimate.consistent, 120) << seed;
    EXPECT_EQ(spoilt.in_with, spoilt.in_without) << seed;
    EXPECT_EQ(spoilt.with.estimate.prev_from_cur.matrix(), spoilt.without.estimate.prev_from_cur.matrix()) << seed;
    EXPECT_LT(deviations(spoilt.with.estimate, truth), std::sqrt(20.1)) << seed;
  }
}

// With the noise that the bound is made for, each pair of good ones fails it with a probability of 0.3 %, so that some
// of the 120 leave the set. Which ones, numbers of consistencies decide, and those with random ones count as well: the
// set cannot be exactly the same, only one as good.
TEST(MotionFrom, IsTheSameWhenFortyPercentOfTheCorrespondencesAreRandom) {
  const Pose truth = pose({0.1, -0.05, 0.15}, 4, -2, 3);
  int lost = 0, gained = 0, clean_total = 0;
  for (unsigned seed = 0; seed < 20; ++seed) {
    const Spoilt spoilt = spoilt_by_forty_percent(truth, seed, 0.1);
    ASSERT_EQ(spoilt.with.estimate.status, MotionStatus::ok);
    ASSERT_EQ(spoilt.without.estimate.status, MotionStatus::ok);
    for (int i = 0; i < 200; ++i) {
      lost += spoilt.in_without[i] && !spoilt.in_with[i];
      gained += spoilt.in_with[i] && !spoilt.in_without[i];
    }
    clean_total += static_cast<int>(spoilt.without.used.size());
    // Six degrees of freedom: chi-square's 99.73 % is 20.1, which corresponds to three standard deviations.
    EXPECT_LT(deviations(spoilt.with.estimate, truth), std::sqrt(20.1)) << seed;
  }
  EXPECT_LE(lost, clean_total / 1000) << clean_total;  // measured: 1 and 1
  EXPECT_LE(gained, clean_total / 1000) << clean_total;
}

TEST(MotionFrom, IsAmbiguousIfASecondSetOfSimilarSizeMovesOtherwise) {
  // A repetitive pattern: part of the matches are one period (0.3 m) off, which is a rigid motion as well (fig. 5.9).
  const Pose truth = pose({0.1, -0.05, 0.15}, 4, -2, 3);
  Pose shifted = truth;
  shifted.translation().x() += 0.3;
  for (const auto& [shifted_count, expected] :
       {std::pair{100, MotionStatus::ambiguous}, {80, MotionStatus::ambiguous}, {40, MotionStatus::ok}}) {
    std::mt19937_64 random(3);
    std::vector<Correspondence> all = simulated(100, truth, kLow, kHigh, random);
    for (const Correspondence& c : simulated(shifted_count, shifted, kLow, kHigh, random)) all.push_back(c);
    const TracedMotion motion = motion_from(all, 0, kCamera, {});
    EXPECT_EQ(motion.estimate.status, expected) << shifted_count;
    EXPECT_EQ(motion.used.empty(), expected == MotionStatus::ambiguous);
    if (motion.estimate.status != MotionStatus::ok) continue;
    EXPECT_LT(deviations(motion.estimate, truth), std::sqrt(20.1));
  }
}

TEST(MotionFrom, IsDegenerateWherePointsDoNotTellTheMotion) {
  const Pose truth = pose({0.1, -0.05, 0.15}, 1, -1, 1);
  std::mt19937_64 random(5);
  // On a line, and in a ball of 2 cm.
  for (const auto& [low, high] : {std::pair<Eigen::Vector3d, Eigen::Vector3d>{{-1, 0.2, 2.5}, {1, 0.2, 2.5}},
                                  {{0.3, 0.2, 2.5}, {0.32, 0.22, 2.52}}}) {
    const TracedMotion motion = motion_from(simulated(60, truth, low, high, random), 0, kCamera, {});
    EXPECT_EQ(motion.estimate.status, MotionStatus::degenerate);
    EXPECT_EQ(motion.estimate.prev_from_cur.matrix(), Pose::Identity().matrix());
  }
  // Far away: 80 m at 0.4 px of disparity.
  const TracedMotion far = motion_from(simulated(40, truth, {-30, -10, 80}, {30, 10, 81}, random), 0, kCamera, {});
  EXPECT_EQ(far.estimate.status, MotionStatus::degenerate);
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
    // Seven steps along the room; view 3 looks at an empty wall.
    static const std::vector<ViewFeatures> result = [] {
      std::vector<ViewFeatures> v;
      for (int i = 0; i < 8; ++i) v.push_back(features_at(world(i), {}));
      DisparityImage disparity{cv::Mat1f(300, 400, 10.0f), cv::Mat1b(300, 400, uint8_t{1})};
      v[3] = extract_features(cv::Mat1b(300, 400, uint8_t{90}), disparity, kCamera, {});
      return v;
    }();
    return result;
  }
  static ViewFeatures other_wall() { return features_at(pose({0, 0, 1.0}, 180, 0, 0), {}); }
  static Pose world(int i) { return pose({-0.2 + 0.05 * i, 0, -1.5 + 0.04 * i}, 5 - 1.0 * i, -3, 2 + 0.5 * i); }
};

bool equal_bits(const Pose& a, const Pose& b) { return std::memcmp(a.data(), b.data(), sizeof(double) * 16) == 0; }

TEST_F(Chain, ChainsPosesAndLeavesOutAViewThatShowsNothing) {
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
  EXPECT_TRUE(steps[3].blind);
  EXPECT_FALSE(steps[3].new_submap);
  EXPECT_EQ(steps[3].estimate.status, MotionStatus::too_few_corners);
  // The path goes on behind the spoilt view, in the sub-map before it.
  EXPECT_EQ(steps[4].reference_frame, 2);
  EXPECT_EQ(steps[4].submap, 0);
  EXPECT_LT(((world(0).inverse() * world(7)).inverse() * steps[7].world_from_cam).translation().norm(), 0.04);
  // What shows something begins a sub-map of its own; behind it as well the path goes on.
  const ChainStep away = chain.push(other_wall(), 8), back = chain.push(views()[7], 9);
  EXPECT_TRUE(away.new_submap);
  EXPECT_EQ(away.submap, 1);
  EXPECT_EQ(away.estimate.status, MotionStatus::too_few_consistent);
  EXPECT_TRUE(equal_bits(away.world_from_cam, Pose::Identity()));
  EXPECT_EQ(back.reference_frame, 7);
  EXPECT_EQ(back.submap, 0);
}

TEST_F(Chain, BeginsWithTheFirstViewThatShowsSomething) {
  MotionChain chain(kCamera, {});
  const ChainStep dark = chain.push(views()[3], 0), first = chain.push(views()[0], 1);
  EXPECT_TRUE(dark.blind);
  EXPECT_FALSE(dark.new_submap);
  EXPECT_TRUE(first.new_submap);
  EXPECT_EQ(first.submap, 0);
  EXPECT_EQ(chain.push(views()[1], 2).reference_frame, 1);
}

TEST_F(Chain, NumbersOfSubMapsAreNeverUsedTwice) {
  MotionChain chain(kCamera, {});
  chain.restore({{10, views()[0], Pose::Identity(), 0}}, 3);
  EXPECT_EQ(chain.push(other_wall(), 11).submap, 3);
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

// Turned by 40 degrees about the optical axis: too much for Rank patches that are not turned.
TEST_F(Chain, RescuesByKeypointsWhatPatchesCannotMatch) {
  ScsOptions options;
  options.any_roll = false;
  options.max_turn = 60;
  const Pose start = world(0), end = pose({-0.15, 0.02, -1.42}, 6, -2, 42);
  const ViewFeatures prev = views()[0], cur = features_at(end, options);
  ASSERT_NE(estimate_motion(prev, cur, kCamera, options).status, MotionStatus::ok);
  MotionChain chain(kCamera, options);
  chain.push(prev, 0);
  const ChainStep step = chain.push(cur, 1);
  EXPECT_TRUE(step.rescued);
  EXPECT_EQ(step.estimate.status, MotionStatus::ok);
  EXPECT_EQ(step.reference_frame, 0);
  EXPECT_EQ(static_cast<int>(step.used.size()), step.estimate.used);
  const Pose error = (start.inverse() * end).inverse() * step.estimate.prev_from_cur;
  EXPECT_LT(error.translation().norm(), 0.01);
  EXPECT_LT(rotation_angle(error), 0.1 * kDegree);
  options.rescue = false;
  MotionChain without(kCamera, options);
  without.push(prev, 0);
  EXPECT_TRUE(without.push(cur, 1).new_submap);
}

TEST_F(Chain, GuessesOnlyIfAskedAndSaysSo) {
  ScsOptions options;
  options.guess = true;
  options.retry_views = 2;
  MotionChain chain(kCamera, options);
  std::vector<ChainStep> steps;
  for (const int view : {0, 1, 2, 3, 4}) steps.push_back(chain.push(views()[view], view));
  EXPECT_EQ(steps[2].estimate.status, MotionStatus::ok);
  EXPECT_EQ(steps[3].estimate.status, MotionStatus::guessed);  // the empty wall
  EXPECT_EQ(steps[3].reference_frame, 2);
  EXPECT_FALSE(steps[3].new_submap);
  // The motion before it, once more.
  const Pose motion = steps[1].world_from_cam.inverse() * steps[2].world_from_cam;
  EXPECT_LT((steps[3].estimate.prev_from_cur.matrix() - motion.matrix()).norm(), 1e-12);
  EXPECT_LT((steps[3].world_from_cam.matrix() - (steps[2].world_from_cam * motion).matrix()).norm(), 1e-12);
  // Its error is within what it claims.
  EXPECT_LT(deviations(steps[3].estimate, world(2).inverse() * world(3)), 3);
  // The view behind is measured against one in front of the guess.
  EXPECT_EQ(steps[4].estimate.status, MotionStatus::ok);
  EXPECT_EQ(steps[4].reference_frame, 2);
  // With a frame left out, twice the motion; and not for ever.
  MotionChain blind(kCamera, options);
  for (const int view : {0, 1}) blind.push(views()[view], view);
  const ChainStep first = blind.push(views()[3], 3);
  EXPECT_EQ(first.estimate.status, MotionStatus::guessed);
  const Pose once = steps[1].estimate.prev_from_cur;
  EXPECT_LT((first.estimate.prev_from_cur.translation() - 2 * once.translation()).norm(), 1e-12);
  EXPECT_NEAR(rotation_angle(first.estimate.prev_from_cur), 2 * rotation_angle(once), 1e-9);
  EXPECT_EQ(blind.push(views()[3], 4).estimate.status, MotionStatus::guessed);
  EXPECT_TRUE(blind.push(views()[3], 5).blind);
}

TEST_F(Chain, PicturesShowWhatAMotionWasMadeOf) {
  MotionChain chain(kCamera, {});
  chain.push(views()[0], 0);
  const ChainStep step = chain.push(views()[1], 1);
  ASSERT_NE(chain.view(1), nullptr);
  EXPECT_EQ(chain.view(7), nullptr);
  const cv::Mat3b picture = motion_picture(*chain.view(1), step, kCamera);
  ASSERT_EQ(picture.size(), cv::Size(800, 600));
  // Green circles only where pairs were used, around their points in the current view.
  const cv::Mat3b used = picture(cv::Rect(400, 300, 400, 300));
  int drawn = 0;
  for (const Correspondence& c : step.used) {
    const Eigen::Vector3d p = kCamera.project(c.cur_point);
    const cv::Rect around(static_cast<int>(p.x()) - 4, static_cast<int>(p.y()) - 4, 10, 10);
    if (around.y < 60) continue;  // the captions
    int green = 0;
    for (const cv::Vec3b& v : cv::Mat3b(used(around))) green += v[1] > v[0] + 60 && v[1] > v[2] + 60;
    drawn += green > 0;
  }
  EXPECT_GT(drawn, 0.5 * static_cast<double>(step.used.size()));
}

TEST_F(Chain, GoesOnBitByBitAfterARestart) {
  ScsOptions options;
  options.retry_views = 2;
  for (const bool guess : {false, true}) {
    options.guess = guess;
    MotionChain whole(kCamera, options);
    std::vector<ChainStep> steps;
    for (int i = 0; i < 8; ++i) steps.push_back(whole.push(views()[i], i));
    for (int cut = 1; cut < 8; ++cut) {
      MotionChain chain(kCamera, options);
      std::vector<MotionChain::Restored> last;
      std::vector<bool> needed(8, false);
      for (int i = cut - 1, kept = 0; i >= 0 && kept < chain.kept_views(); --i) {
        if (steps[i].blind) continue;
        needed[i] = true;
        ++kept;
        if (steps[i].reference_frame >= 0) needed[steps[i].reference_frame] = true;
      }
      for (int i = 0; i < cut; ++i) {
        if (!needed[i]) continue;
        last.push_back({i, views()[i], steps[i].world_from_cam, steps[i].submap,
                        steps[i].estimate.status == MotionStatus::guessed, steps[i].reference_frame,
                        steps[i].estimate.prev_from_cur});
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
}

TEST(ScsOptionsDeclaration, HasValidDefaultsAndNoDoubleNames) {
  ScsOptions options;
  OptionSet set;
  options.declare(set);
  EXPECT_NO_THROW(set.validate());
  EXPECT_EQ(options.model, "image");
  set.set("motion.model", "drift");
  EXPECT_EQ(options.model, "drift");
}

}  // namespace
}  // namespace iris::motion
