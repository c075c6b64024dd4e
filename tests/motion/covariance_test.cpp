// Whether motions are as uncertain as they say: rendered sequences through stereo and motion, against the truth.
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <random>

#include "iris/core/parallel.h"
#include "iris/motion/scs.h"
#include "iris/stereo/mwmf.h"
#include "support/synthetic_views.h"

namespace iris::motion {
namespace {

const RectifiedCamera kCamera{.f = 260, .cx = 159.3, .cy = 118.8, .baseline = 0.11, .width = 320, .height = 240};
constexpr int kFrames = 25;

// Held in the hand: forth and back, turning about all axes.
Pose world_from_cam(int frame) {
  const double t = 0.1 * frame;
  Pose pose = Pose::Identity();
  pose.translation() =
      Eigen::Vector3d(0.4 * std::sin(0.9 * t), 0.2 * std::sin(1.3 * t + 1), -1.5 + 0.3 * std::sin(0.7 * t));
  pose.linear() = (Eigen::AngleAxisd(0.25 * std::sin(1.1 * t), Eigen::Vector3d::UnitY()) *
                   Eigen::AngleAxisd(0.12 * std::sin(1.7 * t), Eigen::Vector3d::UnitX()) *
                   Eigen::AngleAxisd(0.1 * std::sin(1.4 * t + 0.5), Eigen::Vector3d::UnitZ()))
                      .toRotationMatrix();
  return pose;
}

struct Images {
  cv::Mat1b left, right;
};

const std::vector<Images>& rendered() {
  static const std::vector<Images> result = [] {
    std::vector<Images> images(kFrames);
    parallel_chunks(0, kFrames, 1, [&](int begin, int end) {
      for (int i = begin; i < end; ++i) {
        const Pose left = world_from_cam(i);
        Pose right = left;
        right.translation() = left * Eigen::Vector3d(kCamera.baseline, 0, 0);
        images[i] = {testing::render_room({}, kCamera, left).image, testing::render_room({}, kCamera, right).image};
      }
    });
    return images;
  }();
  return result;
}

// Mean normalised squared error of the motions from frame to frame, with noise [grey levels] on all images.
double normalised_error(double noise) {
  ScsOptions options;
  stereo::MwmfOptions stereo_options;
  stereo_options.disparities = 48;
  std::vector<ViewFeatures> features(kFrames);
  parallel_chunks(0, kFrames, 1, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      std::mt19937_64 random(static_cast<uint64_t>(i + 1));
      std::normal_distribution<double> normal(0, noise);
      Images noisy{rendered()[i].left.clone(), rendered()[i].right.clone()};
      for (cv::Mat1b* image : {&noisy.left, &noisy.right})
        for (uint8_t& v : *image) v = cv::saturate_cast<uint8_t>(v + normal(random));
      features[i] = extract_features(noisy.left, stereo::mwmf(noisy.left, noisy.right, stereo_options), kCamera,
                                     options, noisy.right);
    }
  });
  double sum = 0;
  for (int i = 1; i < kFrames; ++i) {
    const MotionEstimate estimate = estimate_motion(features[i - 1], features[i], kCamera, options);
    EXPECT_EQ(estimate.status, MotionStatus::ok);
    const Pose truth = world_from_cam(i - 1).inverse() * world_from_cam(i);
    Vector6d error;
    error.head<3>() = estimate.prev_from_cur.translation() - truth.translation();
    const Eigen::AngleAxisd turn(Eigen::Matrix3d(estimate.prev_from_cur.linear() * truth.linear().transpose()));
    error.tail<3>() = turn.angle() * turn.axis();
    sum += error.dot(estimate.covariance.llt().solve(error)) / (kFrames - 1);
  }
  return sum;
}

// The squared error e^T C^-1 e has mean 6 and variance 12 if C is right; the mean of 24 lies in 6 +- 1.96 sqrt(12 / 24)
// = 4.6 ... 7.4 with 95 %.
TEST(Covariance, DescribesTheErrorsOfNoisyImages) {
  const double error = normalised_error(8);
  RecordProperty("normalised_error", std::to_string(error));
  EXPECT_GT(error, 4.6);
  EXPECT_LT(error, 7.4);
}

// With clean images the residuals are smaller than pixel_error promises, which the covariance does not believe.
TEST(Covariance, IsCautiousWithCleanImages) {
  const double error = normalised_error(2);
  RecordProperty("normalised_error", std::to_string(error));
  EXPECT_GT(error, 1.5);
  EXPECT_LT(error, 7.4);
}

}  // namespace
}  // namespace iris::motion
