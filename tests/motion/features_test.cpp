#include "iris/motion/features.h"

#include <gtest/gtest.h>

#include <map>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <random>

#include "iris/motion/correspondences.h"
#include "support/synthetic_views.h"

namespace iris::motion {
namespace {

const RectifiedCamera kCamera{.f = 300, .cx = 160, .cy = 120, .baseline = 0.1, .width = 320, .height = 240};

cv::Mat1b noise_image(int width, int height, unsigned seed) {
  std::mt19937_64 random(seed);
  cv::Mat1b image(height, width);
  for (uint8_t& v : image) v = static_cast<uint8_t>(random() & 255);
  return image;
}

DisparityImage constant_disparity(int width, int height, float value) {
  return {cv::Mat1f(height, width, value), cv::Mat1b(height, width, static_cast<uint8_t>(DisparityOrigin::measured))};
}

TEST(HarrisResponse, EqualsTheDefinition) {
  const cv::Mat1b image = noise_image(40, 40, 1);
  const cv::Mat1f response = harris_response(image);
  // Structure tensor by plain sums over the window of +-5 px, gradients by Sobel's masks.
  double weights = 0;
  Eigen::Matrix2d tensor = Eigen::Matrix2d::Zero();
  for (int v = -5; v <= 5; ++v) {
    for (int u = -5; u <= 5; ++u) {
      const int x = 20 + u, y = 17 + v;
      const auto g = [&](int dx, int dy) { return static_cast<double>(image(y + dy, x + dx)); };
      const Eigen::Vector2d gradient((g(1, -1) + 2 * g(1, 0) + g(1, 1) - g(-1, -1) - 2 * g(-1, 0) - g(-1, 1)) / 8,
                                     (g(-1, 1) + 2 * g(0, 1) + g(1, 1) - g(-1, -1) - 2 * g(0, -1) - g(1, -1)) / 8);
      const double weight = std::exp(-(u * u + v * v) / 8.0);
      tensor += weight * gradient * gradient.transpose();
      weights += weight;
    }
  }
  tensor /= weights;
  const double expected = tensor.determinant() - 0.04 * tensor.trace() * tensor.trace();
  EXPECT_NEAR(response(17, 20), expected, 1e-4 * std::abs(expected));
}

TEST(RankPatch, EqualsTheDefinition) {
  const cv::Mat1b image = noise_image(60, 50, 2);
  const RankPatch patch = rank_patch(image, 30, 20);
  for (int row = 0; row < kPatchSize; ++row) {
    for (int column = 0; column < kPatchSize; ++column) {
      const int x = 30 + column - 8, y = 20 + row - 8;
      int darker = 0;
      for (int v = -5; v <= 5; ++v)
        for (int u = -5; u <= 5; ++u) darker += image(y + v, x + u) < image(y, x);
      ASSERT_EQ(patch[row * kPatchSize + column], darker);
    }
  }
  for (size_t i = kPatchSize * kPatchSize; i < patch.size(); ++i) EXPECT_EQ(patch[i], 0);
}

TEST(GreyPatch, IsThePartOfTheImage) {
  const cv::Mat1b image = noise_image(60, 50, 2);
  const RankPatch patch = grey_patch(image, 30, 20);
  for (int row = 0; row < kPatchSize; ++row)
    for (int column = 0; column < kPatchSize; ++column)
      ASSERT_EQ(patch[row * kPatchSize + column], image(20 + row - 8, 30 + column - 8));
}

TEST(LaplacianOfGaussian, EqualsTheDefinition) {
  const cv::Mat1b image = noise_image(40, 40, 7);
  const cv::Mat1b filtered = laplacian_of_gaussian(image);
  const auto smooth = [&](int x, int y) {
    double sum = 0, weights = 0;
    for (int v = -4; v <= 4; ++v) {
      for (int u = -4; u <= 4; ++u) {
        const double weight = std::exp(-(u * u + v * v) / 2.0);
        sum += weight * image(y + v, x + u);
        weights += weight;
      }
    }
    return sum / weights;
  };
  for (int x = 15; x < 25; ++x) {
    const double laplacian = smooth(x - 1, 20) + smooth(x + 1, 20) + smooth(x, 19) + smooth(x, 21) - 4 * smooth(x, 20);
    // The Gaussian's mask may be cut at three pixels: 0.3 % of its weight.
    EXPECT_NEAR(filtered(20, x), std::clamp(128 + 8 * laplacian, 0.0, 255.0), 3);
  }
}

TEST(RankPatch, TurnsWithTheImage) {
  const cv::Mat1b image = noise_image(60, 50, 3);
  cv::Mat turned_image;
  cv::rotate(image, turned_image, cv::ROTATE_90_CLOCKWISE);
  EXPECT_EQ(turned(rank_patch(image, 30, 20)), rank_patch(turned_image, 49 - 20, 30));
}

TEST(ExtractFeatures, FindsTheCornersOfSquaresToATenthOfAPixel) {
  // Squares drawn by area coverage, so that their corners' true places are known to a fraction of a pixel.
  for (const double shift : {0.0, 0.2, 0.5, 0.7}) {
    cv::Mat1b image(240, 320, uint8_t{60});
    const double left = 100 + shift, right = 160 + shift, top = 80 + shift, bottom = 150 + shift;
    for (int y = 0; y < 240; ++y) {
      for (int x = 0; x < 320; ++x) {
        const double cover_x = std::clamp(std::min(x + 0.5, right) - std::max(x - 0.5, left), 0.0, 1.0);
        const double cover_y = std::clamp(std::min(y + 0.5, bottom) - std::max(y - 0.5, top), 0.0, 1.0);
        image(y, x) = static_cast<uint8_t>(std::lround(60 + 140 * cover_x * cover_y));
      }
    }
    const ViewFeatures features = extract_features(image, constant_disparity(320, 240, 10), kCamera, {});
    ASSERT_EQ(features.corners.size(), 4u);
    // Harris' maximum lies inside the square by an amount that is the same for all corners: their distances are exact.
    double min_x = 1e9, max_x = 0, min_y = 1e9, max_y = 0;
    for (const Corner& corner : features.corners) {
      min_x = std::min(min_x, corner.x);
      max_x = std::max(max_x, corner.x);
      min_y = std::min(min_y, corner.y);
      max_y = std::max(max_y, corner.y);
    }
    EXPECT_NEAR((min_x + max_x) / 2, (left + right) / 2, 0.05);
    EXPECT_NEAR((min_y + max_y) / 2, (top + bottom) / 2, 0.05);
    EXPECT_NEAR(min_x, left, 2);
    EXPECT_NEAR(min_y, top, 2);
  }
}

TEST(ExtractFeatures, KeepsOnlyCornersWithMeasuredDisparitiesAround) {
  const cv::Mat1b image = noise_image(320, 240, 4);
  DisparityImage disparity = constant_disparity(320, 240, 10);
  const size_t all = extract_features(image, disparity, kCamera, {}).corners.size();
  ASSERT_GT(all, 100u);
  disparity.origin.colRange(0, 160).setTo(static_cast<uint8_t>(DisparityOrigin::within_segment));  // interpolated
  disparity.origin.colRange(160, 200).setTo(static_cast<uint8_t>(DisparityOrigin::corrected));
  disparity.disparity.colRange(240, 280).setTo(3.9f);  // too far away
  disparity.disparity.colRange(290, 320).setTo(0);
  const ViewFeatures features = extract_features(image, disparity, kCamera, {});
  ASSERT_GT(features.corners.size(), 20u);
  bool corrected_used = false;
  for (const Corner& corner : features.corners) {
    EXPECT_GE(corner.x, 160.5);
    EXPECT_LT(corner.x, 289);
    EXPECT_TRUE(corner.x < 240 || corner.x > 279.4) << corner.x;
    corrected_used |= corner.x < 200;
    EXPECT_LT((corner.point_in_cam - kCamera.point(corner.x, corner.y, corner.disparity)).norm(), 1e-12);
  }
  EXPECT_TRUE(corrected_used);
}

TEST(ExtractFeatures, SpreadsTheCornersOverTheImage) {
  // Strong texture on the left, weak on the right: without the grid all corners would lie on the left.
  cv::Mat1b image = noise_image(320, 240, 5);
  cv::Mat1b right = image.colRange(160, 320);
  right.convertTo(right, CV_8U, 0.2, 100);
  ScsOptions options;
  options.max_corners = 160;  // two a cell
  const ViewFeatures features = extract_features(image, constant_disparity(320, 240, 10), kCamera, options);
  ASSERT_EQ(features.corners.size(), 160u);
  int on_right = 0;
  for (const Corner& corner : features.corners) on_right += corner.x > 160;
  EXPECT_NEAR(on_right, 80, 8);
}

TEST(UsableDisparity, InterpolatesSurfacesButNotAcrossSteps) {
  DisparityImage disparity = constant_disparity(20, 20, 10);
  for (int y = 0; y < 20; ++y)
    for (int x = 0; x < 20; ++x) disparity.disparity(y, x) = 10 + 0.1f * x + 0.2f * y;
  EXPECT_NEAR(usable_disparity(disparity, 7.3, 9.6, kCamera, {}), 10 + 0.73 + 1.92, 1e-5);
  disparity.disparity.colRange(8, 20) += 5;
  EXPECT_NEAR(usable_disparity(disparity, 7.3, 9.6, kCamera, {}), 10 + 0.7 + 2.0, 1e-5);  // pixel (7, 10)
  EXPECT_EQ(usable_disparity(disparity, 0.2, 9.6, kCamera, {}), 0);                       // no neighbours
  disparity.disparity(11, 8) = 0;
  EXPECT_EQ(usable_disparity(disparity, 7.3, 9.6, kCamera, {}), 0);
}

TEST(MatchCorners, FindsEveryCornerOfAShiftedImageAgain) {
  const cv::Mat1b image = noise_image(340, 240, 6);
  const cv::Mat1b a = image.colRange(0, 320).clone(), b = image.colRange(20, 340).clone();
  const DisparityImage disparity = constant_disparity(320, 240, 10);
  ScsOptions options;
  options.max_corners = 4000;
  for (const char* compare : {"rank", "sad"}) {
    options.compare = compare;
    const ViewFeatures prev = extract_features(a, disparity, kCamera, options);
    const ViewFeatures cur = extract_features(b, disparity, kCamera, options);
    const auto matches = match_corners(prev, cur);
    int right = 0;
    for (const auto& [i, j] : matches) {
      right +=
          std::abs(prev.corners[i].x - 20 - cur.corners[j].x) + std::abs(prev.corners[i].y - cur.corners[j].y) < 1e-6;
    }
    EXPECT_GT(right, 0.85 * static_cast<double>(std::min(prev.corners.size(), cur.corners.size()))) << compare;
    EXPECT_GT(right, 0.95 * static_cast<double>(matches.size())) << compare;
  }
}

}  // namespace
}  // namespace iris::motion
