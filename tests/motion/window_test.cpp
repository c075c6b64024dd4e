// Motions measured against several earlier views, and cameras that rest.
#include <gtest/gtest.h>

#include <cstring>
#include <random>

#include "iris/core/parallel.h"
#include "iris/motion/chain.h"
#include "support/synthetic_views.h"

namespace iris::motion {
namespace {

const RectifiedCamera kCamera{.f = 210, .cx = 159.3, .cy = 118.8, .baseline = 0.12, .width = 320, .height = 240};

Pose moving(int frame) {
  const double t = 0.1 * frame;
  Pose pose = Pose::Identity();
  pose.translation() = Eigen::Vector3d(0.4 * t, 0.1 * std::sin(3 * t), -1.5 + 0.3 * t);
  pose.linear() = (Eigen::AngleAxisd(0.3 * t, Eigen::Vector3d::UnitY()) *
                   Eigen::AngleAxisd(0.05 * std::sin(4 * t), Eigen::Vector3d::UnitX()))
                      .toRotationMatrix();
  return pose;
}

// Noisy views; the disparities are those of the left images' pixels, with noise of their own.
std::vector<ViewFeatures> views_at(const std::vector<Pose>& poses, const ScsOptions& options) {
  std::vector<ViewFeatures> views(poses.size());
  parallel_chunks(0, static_cast<int>(poses.size()), 1, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      std::mt19937_64 random(static_cast<uint64_t>(i + 1));
      std::normal_distribution<double> grey(0, 3), px(0, 0.1);
      Pose right_pose = poses[i];
      right_pose.translation() = poses[i] * Eigen::Vector3d(kCamera.baseline, 0, 0);
      testing::SyntheticView left = testing::render_room({}, kCamera, poses[i]);
      cv::Mat1b right = testing::render_room({}, kCamera, right_pose).image;
      for (cv::Mat1b* image : {&left.image, &right})
        for (uint8_t& v : *image) v = cv::saturate_cast<uint8_t>(v + grey(random));
      for (float& d : left.disparity.disparity) d += static_cast<float>(px(random));
      views[i] = extract_features(left.image, left.disparity, kCamera, options, right);
    }
  });
  return views;
}

std::vector<ChainStep> chained(const std::vector<ViewFeatures>& views, const ScsOptions& options) {
  MotionChain chain(kCamera, options);
  std::vector<ChainStep> steps;
  for (size_t i = 0; i < views.size(); ++i) steps.push_back(chain.push(views[i], static_cast<int>(i)));
  return steps;
}

std::vector<Pose> moving_poses(int count) {
  std::vector<Pose> poses;
  for (int i = 0; i < count; ++i) poses.push_back(moving(i));
  return poses;
}

TEST(Window, LessensTheDrift) {
  const std::vector<Pose> poses = moving_poses(14);
  const std::vector<ViewFeatures> views = views_at(poses, {});
  std::array<double, 2> error{}, stated{};
  for (const int window : {1, 4}) {
    ScsOptions options;
    options.window = window;
    const std::vector<ChainStep> steps = chained(views, options);
    for (size_t i = 1; i < poses.size(); ++i) {
      ASSERT_EQ(steps[i].estimate.status, MotionStatus::ok);
      EXPECT_EQ(steps[i].reference_frame, static_cast<int>(i) - 1);
      const Pose truth = poses[0].inverse() * poses[i];
      error[window > 1] += (steps[i].world_from_cam.translation() - truth.translation()).squaredNorm();
      stated[window > 1] += steps[i].estimate.covariance.topLeftCorner<3, 3>().trace();
    }
  }
  EXPECT_LT(error[1], error[0]);
  EXPECT_LT(stated[1], stated[0]);
}

TEST(Window, OfOneViewIsTheMotionBetweenTwo) {
  const std::vector<ViewFeatures> views = views_at(moving_poses(3), {});
  ScsOptions options;
  options.window = 1;
  const std::vector<ChainStep> steps = chained(views, options);
  for (size_t i = 1; i < views.size(); ++i) {
    EXPECT_EQ(steps[i].estimate.prev_from_cur.matrix(),
              estimate_motion(views[i - 1], views[i], kCamera, options).prev_from_cur.matrix());
  }
}

TEST(Rest, ErrorsOfARestingCameraDoNotAddUp) {
  // Moves, rests for longer than the chain remembers, and moves on.
  std::vector<Pose> poses = moving_poses(3);
  for (int i = 0; i < 12; ++i) poses.push_back(poses.back());
  poses.push_back(moving(3));
  const std::vector<ViewFeatures> views = views_at(poses, {});
  ScsOptions options;
  options.window = 1;  // this is about the reference view alone
  const std::vector<ChainStep> steps = chained(views, options);
  for (size_t i = 3; i < steps.size(); ++i) EXPECT_EQ(steps[i].reference_frame, 2);
  double resting = 0, before = 0;
  options.rest = 0;
  const std::vector<ChainStep> adding = chained(views, options);
  for (size_t i = 3; i < 15; ++i) {
    const auto moved = [&](const std::vector<ChainStep>& s) {
      return (s[2].world_from_cam.inverse() * s[i].world_from_cam).translation().squaredNorm();
    };
    EXPECT_EQ(adding[i].reference_frame, static_cast<int>(i) - 1);
    resting += moved(steps);
    before += moved(adding);
  }
  EXPECT_LT(resting, before);
}

TEST(Rest, ARestoredChainGoesOnExactly) {
  std::vector<Pose> poses = moving_poses(4);
  for (int i = 0; i < 8; ++i) poses.push_back(poses.back());
  for (int i = 4; i < 7; ++i) poses.push_back(moving(i));
  const std::vector<ViewFeatures> views = views_at(poses, {});
  const ScsOptions options;
  const std::vector<ChainStep> whole = chained(views, options);
  for (const int interrupted : {2, 4, 7, 11, 12, 13}) {
    MotionChain chain(kCamera, options);
    std::vector<MotionChain::Restored> last;
    const int begin = std::max(0, interrupted - chain.kept_views());
    std::vector<bool> needed(views.size(), false);
    for (int i = begin; i < interrupted; ++i) {
      needed[i] = true;
      if (whole[i].reference_frame >= 0) needed[whole[i].reference_frame] = true;
    }
    for (int i = 0; i < interrupted; ++i) {
      if (!needed[i]) continue;
      last.push_back({.frame_idx = i,
                      .features = views[i],
                      .world_from_cam = whole[i].world_from_cam,
                      .submap = 0,
                      .reference_frame = whole[i].reference_frame,
                      .reference_from_cam = whole[i].estimate.prev_from_cur});
    }
    chain.restore(last, 1);
    for (size_t i = interrupted; i < views.size(); ++i) {
      const ChainStep step = chain.push(views[i], static_cast<int>(i));
      EXPECT_EQ(step.reference_frame, whole[i].reference_frame) << interrupted << " " << i;
      EXPECT_EQ(std::memcmp(step.world_from_cam.matrix().data(), whole[i].world_from_cam.matrix().data(),
                            16 * sizeof(double)),
                0)
          << interrupted << " " << i;
      EXPECT_EQ(step.estimate.covariance, whole[i].estimate.covariance);
    }
  }
}

}  // namespace
}  // namespace iris::motion
