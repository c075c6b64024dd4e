#include "iris/evaluate/images.h"

#include <gtest/gtest.h>

#include <cmath>

#include "iris/core/error.h"

namespace iris::evaluate {
namespace {

cv::Mat1b noise(int rows, int cols, int seed) {
  cv::Mat1b image(rows, cols);
  cv::RNG(static_cast<uint64_t>(seed)).fill(image, cv::RNG::UNIFORM, 20, 220);
  return image;
}

TEST(Images, EqualImages) {
  const cv::Mat1b image = noise(40, 50, 1);
  const ImageErrors e = compare_images(image, image, {});
  EXPECT_TRUE(std::isinf(e.psnr));
  EXPECT_NEAR(e.ssim, 1, 1e-12);
  EXPECT_EQ(e.coverage, 100);
  EXPECT_EQ(e.pixels, 2000);
}

TEST(Images, AConstantOffsetHasAClosedForm) {
  const ImageErrors e = compare_images(cv::Mat1b(30, 30, uint8_t{110}), cv::Mat1b(30, 30, uint8_t{100}), {});
  EXPECT_NEAR(e.psnr, 20 * std::log10(25.5), 1e-9);
  // No variance: only the term of the means is left.
  const double c1 = 2.55 * 2.55;
  EXPECT_NEAR(e.ssim, (2 * 110 * 100 + c1) / (110 * 110 + 100 * 100 + c1), 1e-9);
  // In colour the mean is over the channels.
  cv::Mat3b a(20, 20, cv::Vec3b(50, 60, 70)), b(20, 20, cv::Vec3b(50, 60, 76));
  EXPECT_NEAR(compare_images(a, b, {}).mse, 12, 1e-12);
}

// SSIM straight from its definition, at one pixel.
double ssim_at(const cv::Mat1b& a, const cv::Mat1b& b, int y, int x) {
  double w[11], total = 0;
  for (int i = 0; i < 11; ++i) total += w[i] = std::exp(-(i - 5) * (i - 5) / (2 * 1.5 * 1.5));
  double ma = 0, mb = 0, aa = 0, bb = 0, ab = 0;
  for (int i = 0; i < 11; ++i) {
    for (int j = 0; j < 11; ++j) {
      const double weight = w[i] * w[j] / (total * total), p = a(y + i - 5, x + j - 5), q = b(y + i - 5, x + j - 5);
      ma += weight * p;
      mb += weight * q;
      aa += weight * p * p;
      bb += weight * q * q;
      ab += weight * p * q;
    }
  }
  const double c1 = 6.5025, c2 = 58.5225;
  return (2 * ma * mb + c1) * (2 * (ab - ma * mb) + c2) /
         ((ma * ma + mb * mb + c1) * (aa - ma * ma + bb - mb * mb + c2));
}

TEST(Images, SimilarityByDefinition) {
  const cv::Mat1b a = noise(19, 23, 1), b = 0.5 * a + 0.5 * noise(19, 23, 2);
  double sum = 0;
  for (int y = 5; y < 14; ++y) {
    for (int x = 5; x < 18; ++x) sum += ssim_at(a, b, y, x);
  }
  EXPECT_NEAR(compare_images(a, b, {}).ssim, sum / (9 * 13), 1e-9);
  EXPECT_LT(compare_images(a, noise(19, 23, 3), {}).ssim, 0.3);  // unrelated; 1 / sqrt(28 px of a window) is chance
}

TEST(Images, OnlyPixelsOfTheMaskCount) {
  const cv::Mat1b truth = noise(40, 60, 1);
  cv::Mat1b estimate = truth.clone();
  estimate(cv::Rect(0, 0, 30, 40)) = uint8_t{0};  // a hole
  cv::Mat1b mask(40, 60, uint8_t{255});
  mask(cv::Rect(0, 0, 30, 40)) = uint8_t{0};
  const ImageErrors e = compare_images(estimate, truth, mask);
  EXPECT_EQ(e.coverage, 50);
  EXPECT_TRUE(std::isinf(e.psnr));
  EXPECT_NEAR(e.ssim, 1, 1e-12);
  EXPECT_LT(compare_images(estimate, truth, {}).psnr, 15);
  EXPECT_EQ(compare_images(estimate, truth, cv::Mat1b(40, 60, uint8_t{0})).pixels, 0);
  EXPECT_THROW(compare_images(truth, cv::Mat1b(5, 5), {}), Bug);
}

}  // namespace
}  // namespace iris::evaluate
