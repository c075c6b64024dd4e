#include "iris/motion/track.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <random>

#include "support/synthetic_views.h"

namespace iris::motion {
namespace {

const Eigen::Matrix2d kNone = Eigen::Matrix2d::Identity();  // neither turned nor scaled

// A texture seen through a linear map: the grey value at x is that of the texture at `place` + m (x - centre).
cv::Mat1b textured(const Eigen::Vector2d& centre, const Eigen::Matrix2d& m, double gain, double offset, double noise,
                   unsigned seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal(0, noise);
  cv::Mat1b image(80, 90);
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      const Eigen::Vector2d p = m * (Eigen::Vector2d(x, y) - centre);
      image(y, x) = cv::saturate_cast<uint8_t>(offset + gain * 255 * testing::texture(p.x(), p.y(), 3, 32) +
                                               (noise > 0 ? normal(random) : 0));
    }
  }
  return image;
}

Eigen::Matrix2d similarity(double degrees, double scale) {
  return scale * Eigen::Rotation2Dd(degrees * std::numbers::pi / 180).toRotationMatrix();
}

TEST(TrackPatch, FindsAKnownPlaceToAFractionOfAPixel) {
  const Eigen::Vector2d at(40.3, 37.6);
  const cv::Mat1b from = textured(at, kNone, 1, 0, 0, 1);
  for (const Eigen::Vector2d& place : {Eigen::Vector2d(44.9, 40.1), Eigen::Vector2d(41.25, 36.75)}) {
    const cv::Mat1b to = textured(place, kNone, 1, 0, 0, 1);
    const PatchTrack track = track_patch(from, at, to, place + Eigen::Vector2d(1.3, -0.8), kNone);
    ASSERT_TRUE(track.found);
    EXPECT_LT((track.position - place).norm(), 0.03);  // rounding to grey levels and bilinear sampling
    EXPECT_GT(track.similarity, 0.99);
  }
}

TEST(TrackPatch, FollowsTurnedAndScaledSurroundings) {
  const Eigen::Vector2d at(40.3, 37.6), place(46.2, 39.7);
  const cv::Mat1b from = textured(at, kNone, 1, 0, 0, 1);
  for (const auto& [degrees, scale] : {std::pair{90.0, 1.0}, {-90.0, 1.0}, {180.0, 1.0}, {25.0, 1.2}, {-10.0, 0.8}}) {
    const Eigen::Matrix2d to_from_from = similarity(degrees, scale);
    const cv::Mat1b to = textured(place, to_from_from.inverse(), 1, 0, 0, 1);
    const PatchTrack track = track_patch(from, at, to, place + Eigen::Vector2d(-0.7, 0.9), to_from_from);
    ASSERT_TRUE(track.found) << degrees;
    EXPECT_LT((track.position - place).norm(), 0.05) << degrees;
    EXPECT_GT(track.similarity, 0.98);
  }
}

TEST(TrackPatch, IgnoresBrightnessAndIsUnbiasedUnderNoise) {
  const Eigen::Vector2d at(40.3, 37.6), place(43.5, 38.2);
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  constexpr int kTrials = 100;
  for (int i = 0; i < kTrials; ++i) {
    const cv::Mat1b from = textured(at, kNone, 0.6, 20, 3, 2 * i + 1);
    const cv::Mat1b to = textured(place, kNone, 0.6, 60, 3, 2 * i + 2);
    const PatchTrack track = track_patch(from, at, to, place, kNone);
    ASSERT_TRUE(track.found);
    EXPECT_LT((track.position - place).norm(), 0.3);
    mean += (track.position - place) / kTrials;
  }
  // Each is off by about 0.1 px. Sampling between pixels smooths noise, which favours positions half way between them:
  // 0.033 px here, with noise of 2 % of the contrast.
  EXPECT_LT(mean.norm(), 0.045);
}

// The texture while the camera moves: the mean over `way` [px], around `centre`.
cv::Mat1b blurred(const Eigen::Vector2d& centre, const Eigen::Vector2d& way) {
  constexpr int kMoments = 16;
  cv::Mat1f sum(80, 90, 0.0f);
  for (int k = 0; k < kMoments; ++k) {
    cv::accumulate(textured(centre + ((k + 0.5) / kMoments - 0.5) * way, kNone, 1, 0, 0, 1), sum);
  }
  return cv::Mat1b(sum / kMoments);
}

TEST(TrackPatch, FollowsWhatMotionBlursMoreOrLess) {
  // Pieces of texture are not symmetric, so that blur moves what fits best. Measured: 0.032 px (RMS) against 0.019 px,
  // along the row alone 0.024 against 0.015 px.
  const Eigen::Vector2d along(1, 0.3);
  double plain = 0, aware = 0, plain_in_row = 0, aware_in_row = 0;
  for (int i = 0; i < 24; ++i) {
    const Eigen::Vector2d at(36.3 + i % 6, 33.6 + 3 * (i / 6)), place = at + Eigen::Vector2d(2.55, 1.4);
    const cv::Mat1b from = blurred({40.3, 37.6}, 1 * along);
    for (const double length : {0.0, 3.0}) {
      const cv::Mat1b to = blurred({42.85, 39.0}, length * along);
      const auto error = [&](const PatchTrack& track) {
        EXPECT_TRUE(track.found);
        return (track.position - place).squaredNorm();
      };
      const Eigen::Matrix3d none = Eigen::Matrix3d::Identity();
      plain += error(track_patch(from, at, to, place, none));
      aware += error(track_patch(from, at, to, place, none, {}, along));
      plain_in_row += error(track_along_row(from, at, to, place, none));
      aware_in_row += error(track_along_row(from, at, to, place, none, {}, along));
    }
  }
  EXPECT_LT(aware, 0.5 * plain);
  EXPECT_LT(aware_in_row, 0.5 * plain_in_row);
}

TEST(TrackPatch, IgnoresContrast) {
  const Eigen::Vector2d at(40.3, 37.6), place(44.1, 38.9);
  const cv::Mat1b from = textured(at, kNone, 1, 0, 0, 1);
  const cv::Mat1b to = textured(place, kNone, 0.7, 40, 0, 1);
  for (const bool along_row : {false, true}) {
    const Eigen::Vector2d start = place + Eigen::Vector2d(0.9, along_row ? 0 : -0.5);
    const PatchTrack track = along_row ? track_along_row(from, at, to, start, Eigen::Matrix3d::Identity())
                                       : track_patch(from, at, to, start, kNone);
    ASSERT_TRUE(track.found);
    EXPECT_LT((track.position - place).norm(), 0.03);
    EXPECT_GT(track.similarity, 0.99);
  }
}

TEST(TrackPatch, FollowsAHomography) {
  const Eigen::Vector2d at(40.3, 37.6), place(46.2, 39.7);
  const cv::Mat1b from = textured(at, kNone, 1, 0, 0, 1);
  Eigen::Matrix3d to_from_from;
  to_from_from << 1.1, 0.1, 0, -0.05, 0.95, 0, 0.01, -0.004, 1;
  const Eigen::Matrix3d from_from_to = to_from_from.inverse();
  cv::Mat1b to(80, 90);
  for (int y = 0; y < to.rows; ++y) {
    for (int x = 0; x < to.cols; ++x) {
      const Eigen::Vector2d p = (from_from_to * (Eigen::Vector2d(x, y) - place).homogeneous()).hnormalized();
      to(y, x) = cv::saturate_cast<uint8_t>(255 * testing::texture(p.x(), p.y(), 3, 32));
    }
  }
  const PatchTrack track = track_patch(from, at, to, place + Eigen::Vector2d(0.5, -0.6), to_from_from);
  ASSERT_TRUE(track.found);
  EXPECT_LT((track.position - place).norm(), 0.04);
}

// A texture before another that moves differently: only what belongs to the surface is compared.
TEST(TrackPatch, ComparesTheSurfaceOnly) {
  const Eigen::Vector2d at(40, 37), place(43.4, 37);
  const auto image = [&](const Eigen::Vector2d& front, double behind) {
    cv::Mat1b result(80, 90);
    for (int y = 0; y < result.rows; ++y) {
      for (int x = 0; x < result.cols; ++x) {
        const double u = x - front.x(), v = y - front.y();
        const double grey = u < 3 ? testing::texture(u, v, 3, 32) : testing::texture(x - behind, v, 7, 32);
        result(y, x) = static_cast<uint8_t>(255 * grey);
      }
    }
    return result;
  };
  const cv::Mat1b from = image(at, 0), to = image(place, 0.8);
  cv::Mat1f disparity(80, 90, 10.0f);
  for (int y = 0; y < 80; ++y)
    for (int x = 43; x < 90; ++x) disparity(y, x) = 6;
  const Eigen::Matrix3d none = Eigen::Matrix3d::Identity();
  const PatchTrack all = track_patch(from, at, to, place, none);
  const PatchTrack surface = track_patch(from, at, to, place, none, {&disparity, 10, Eigen::Vector2d::Zero()});
  ASSERT_TRUE(surface.found);
  EXPECT_LT((surface.position - place).norm(), 0.04);
  EXPECT_TRUE(!all.found || (all.position - place).norm() > 0.15);
  disparity.setTo(6);
  EXPECT_FALSE(track_patch(from, at, to, place, none, {&disparity, 10, Eigen::Vector2d::Zero()}).found);
}

TEST(TrackPatch, GivesUpWhereNothingCanBeFollowed) {
  const Eigen::Matrix2d& none = kNone;
  const Eigen::Vector2d at(40.3, 37.6);
  const cv::Mat1b image = textured(at, none, 1, 0, 0, 1);
  EXPECT_FALSE(track_patch(cv::Mat1b(80, 90, uint8_t{100}), at, image, at, none).found);  // flat
  cv::Mat1b edge(80, 90, uint8_t{50});
  edge.colRange(40, 90).setTo(150);
  EXPECT_FALSE(track_patch(edge, at, edge, at, none).found);  // a straight edge leaves the way along it open
  for (const Eigen::Vector2d& outside : {Eigen::Vector2d(3, 40), Eigen::Vector2d(86, 40), Eigen::Vector2d(40, 3),
                                         Eigen::Vector2d(40, 77), Eigen::Vector2d(NAN, 40)}) {
    EXPECT_FALSE(track_patch(image, outside, image, at, none).found);
    EXPECT_FALSE(track_patch(image, at, image, outside, none).found);
  }
  EXPECT_FALSE(track_patch(image, at, image, at, Eigen::Matrix2d(Eigen::Matrix2d::Zero())).found);
  // The largest sums that pixels can give: squares of black and white.
  cv::Mat1b black_and_white(80, 90);
  for (int y = 0; y < 80; ++y)
    for (int x = 0; x < 90; ++x) black_and_white(y, x) = (x / 4 + y / 4) % 2 ? 255 : 0;
  const PatchTrack track = track_patch(black_and_white, {40, 36}, black_and_white, {40.4, 36.3}, none);
  ASSERT_TRUE(track.found);
  EXPECT_LT((track.position - Eigen::Vector2d(40, 36)).norm(), 1e-3);
}

}  // namespace
}  // namespace iris::motion
