#include "src/stereo/log_filter.h"

#include <gmock/gmock.h>

#include <cmath>

#include "iris/core/parallel.h"
#include "support/simd_targets.h"
#include "support/stereo_pairs.h"

namespace iris::stereo {
namespace {

TEST(LogFilter, KernelIsExactlyBlindToConstants) {
  for (const double sigma : {0.6, 1.0, 2.5}) {
    const LogKernel kernel = log_kernel(sigma);
    double gauss = kernel.gauss[0], second = kernel.second[0], moment = 0;
    for (size_t k = 1; k < kernel.gauss.size(); ++k) {
      gauss += 2 * kernel.gauss[k];
      second += 2 * kernel.second[k];
      moment += 2.0 * k * k * kernel.second[k];
    }
    EXPECT_NEAR(gauss, 1, 1e-6);
    EXPECT_NEAR(second, 0, 1e-6);
    // The second derivative of x^2 / 2 is 1 (sampling the kernel coarsely costs some of it at small sigma).
    EXPECT_NEAR(moment / 2, 1, sigma < 1 ? 0.15 : 0.01);
  }
  const cv::Mat1b flat(20, 33, uchar{201});
  EXPECT_EQ(cv::countNonZero(log_filter(flat, 1.0) != kLogZero), 0);
}

// A grating A cos(w x) comes out as -w^2 exp(-sigma^2 w^2 / 2) A cos(w x). Quantisation of the input to whole grey
// levels (error up to 0.5, noise gain of the kernel 0.56 at sigma 1) and of the output: 3 units of 1/8 grey level.
TEST(LogFilter, MatchesClosedFormForGratings) {
  const double amplitude = 60, sigma = 1.0;
  for (const cv::Vec2d& w : {cv::Vec2d(0.5, 0), cv::Vec2d(0, 0.6), cv::Vec2d(0.4, 0.3), cv::Vec2d(-0.2, 0.55)}) {
    cv::Mat1b image(64, 90);
    for (int y = 0; y < image.rows; ++y) {
      for (int x = 0; x < image.cols; ++x) {
        image(y, x) = cv::saturate_cast<uchar>(128 + amplitude * std::cos(w[0] * x + w[1] * y));
      }
    }
    const cv::Mat1b filtered = log_filter(image, sigma);
    const double w2 = w.dot(w);
    const double gain = -w2 * std::exp(-0.5 * sigma * sigma * w2) * amplitude * kLogUnits;
    double worst = 0;
    for (int y = 8; y < image.rows - 8; ++y) {
      for (int x = 8; x < image.cols - 8; ++x) {
        const double expected = kLogZero + gain * std::cos(w[0] * x + w[1] * y);
        worst = std::max(worst, std::abs(filtered(y, x) - std::clamp(expected, 0.0, 255.0)));
      }
    }
    EXPECT_LT(worst, 3) << w;
  }
}

// The same operations, in the same order, in plain code.
cv::Mat1b log_reference(const cv::Mat1b& image, double sigma) {
  const LogKernel kernel = log_kernel(sigma);
  const int radius = static_cast<int>(kernel.gauss.size()) - 1;
  cv::Mat1f smooth(image.size()), second(image.size());
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      float a = kernel.gauss[0] * image(y, x), b = kernel.second[0] * image(y, x);
      for (int k = 1; k <= radius; ++k) {
        const float sum = static_cast<float>(image(std::max(0, y - k), x)) + image(std::min(image.rows - 1, y + k), x);
        a += kernel.gauss[k] * sum;
        b += kernel.second[k] * sum;
      }
      smooth(y, x) = a;
      second(y, x) = b;
    }
  }
  cv::Mat1b out(image.size());
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      float sum = kernel.second[0] * smooth(y, x) + kernel.gauss[0] * second(y, x);
      for (int k = 1; k <= radius; ++k) {
        const int l = std::max(0, x - k), r = std::min(image.cols - 1, x + k);
        const float p = kernel.second[k] * (smooth(y, l) + smooth(y, r));
        const float q = kernel.gauss[k] * (second(y, l) + second(y, r));
        sum += p + q;
      }
      const float value = sum * kLogUnits + (kLogZero + 0.5f);
      out(y, x) = static_cast<uchar>(std::min(255.0f, std::max(0.0f, value)));
    }
  }
  return out;
}

TEST(LogFilter, EveryInstructionSetGivesTheBitsOfPlainCode) {
  cv::RNG random(3);
  for (const cv::Size size : {cv::Size(1, 1), cv::Size(5, 3), cv::Size(17, 40), cv::Size(67, 35), cv::Size(130, 70)}) {
    cv::Mat1b image(size);
    random.fill(image, cv::RNG::UNIFORM, 0, 256);
    for (const double sigma : {0.7, 1.0, 1.8}) {
      const cv::Mat1b expected = log_reference(image, sigma);
      testing::for_each_simd_target([&](const char* target) {
        EXPECT_EQ(cv::countNonZero(log_filter(image, sigma) != expected), 0)
            << target << " " << size << " sigma " << sigma;
      });
    }
  }
}

}  // namespace
}  // namespace iris::stereo
