// Noise and brightness of the recorded images.
#include "src/simulate/sensor.h"

#include <gtest/gtest.h>

#include <cmath>

#include "iris/simulate/simulator.h"
#include "simulate/simple_scenes.h"
#include "src/simulate/renderer.h"

namespace iris::simulate {
namespace {

// A grey wall all over the image, facing the camera.
Scene grey_wall(int grey) {
  const auto value = static_cast<uchar>(grey);
  return scene_of({rectangle({-90, -90, 2}, {180, 0, 0}, {0, 180, 0}, {value, value, value})});
}
// Grey value of it in the image: closed form of the shading, the normal points to the camera.
double seen_grey(int grey) { return grey * static_cast<double>(shade(Eigen::Vector3f(0, 0, -1))); }

TEST(Shading, IsAmbientPlusLambert) {
  float least = 2, most = 0;
  for (int i = 0; i < 2000; ++i) {
    const Eigen::Vector3f normal =
        Eigen::Vector3f(std::sin(i * 1.1f), std::cos(i * 2.3f), std::sin(i * 0.37f + 1)).normalized();
    least = std::min(least, shade(normal));
    most = std::max(most, shade(normal));
    // Only one of the two sides is in the sun.
    EXPECT_FLOAT_EQ(std::min(shade(normal), shade(-normal)), 0.7f);
  }
  EXPECT_FLOAT_EQ(least, 0.7f);
  EXPECT_NEAR(most, 1.0f, 0.01f);
}

class Noise : public ::testing::TestWithParam<double> {};

TEST_P(Noise, HasTheAskedStrengthIsUnbiasedGaussianAndIndependent) {
  SimulateOptions options = plain_options("ideal");
  options.width = 752;
  options.height = 480;
  options.frames = 2;
  options.snr = GetParam();
  const Simulator simulator(grey_wall(150), still_path(), options);
  const StereoFrame first = simulator.frame(0), second = simulator.frame(1);
  const double sigma = 255 * std::pow(10, -options.snr / 20), n = static_cast<double>(first.left.total());
  const double mean = seen_grey(150);
  ASSERT_NEAR(mean, std::round(mean), 1e-4);
  const cv::Mat1b images[] = {first.left, first.right, second.left, second.right};
  for (const cv::Mat1b& image : images) {
    double sum = 0, squares = 0, beside = 0, below = 0;
    int far = 0;
    for (int y = 0; y < image.rows; ++y) {
      for (int x = 0; x < image.cols; ++x) {
        const double e = image(y, x) - mean;
        sum += e;
        squares += e * e;
        if (x > 0) beside += e * (image(y, x - 1) - mean);
        if (y > 0) below += e * (image(y - 1, x) - mean);
        far += std::abs(e) > 2 * sigma;
      }
    }
    // Rounding to whole grey levels adds 1/12 to the variance. Five standard deviations of the estimates.
    const double expected = std::sqrt(sigma * sigma + 1.0 / 12);
    EXPECT_NEAR(sum / n, 0, 5 * expected / std::sqrt(n));
    EXPECT_NEAR(std::sqrt(squares / n), expected, 5 * expected / std::sqrt(2 * n));
    EXPECT_NEAR(std::sqrt(squares / n) / sigma, 1, 0.03);
    EXPECT_NEAR(beside / squares, 0, 5 / std::sqrt(n));
    EXPECT_NEAR(below / squares, 0, 5 / std::sqrt(n));
    // Whole grey levels beyond two standard deviations; the mean is whole, too.
    const double beyond = (std::floor(2 * sigma) + 0.5) / sigma, share = std::erfc(beyond / std::sqrt(2.0));
    EXPECT_NEAR(far / n, share, 5 * std::sqrt(share / n));
  }
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < i; ++j) {
      double product = 0;
      for (int y = 0; y < images[i].rows; ++y) {
        for (int x = 0; x < images[i].cols; ++x) product += (images[i](y, x) - mean) * (images[j](y, x) - mean);
      }
      EXPECT_NEAR(product / (n * sigma * sigma), 0, 6 / std::sqrt(n));
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Decibels, Noise, ::testing::Values(45.0, 30.0));

TEST(Sensor, NoiseDependsOnTheSeedAndColoursAreIndependent) {
  SimulateOptions options = plain_options("ideal");
  options.snr = 40;
  options.colour = true;
  const cv::Mat3b one = Simulator(grey_wall(150), still_path(), options).frame(0).left;
  options.seed = 2;
  const cv::Mat3b two = Simulator(grey_wall(150), still_path(), options).frame(0).left;
  EXPECT_GT(cv::norm(one, two, cv::NORM_INF), 5);
  double product = 0, squares = 0;
  const double mean = seen_grey(150);
  for (const cv::Vec3b& p : one) {
    product += (p[0] - mean) * (p[2] - mean);
    squares += (p[0] - mean) * (p[0] - mean);
  }
  EXPECT_NEAR(product / squares, 0, 5 / std::sqrt(static_cast<double>(one.total())));
}

TEST(Sensor, VignettingTakesTheAskedLightFromTheCorners) {
  SimulateOptions options = plain_options("ideal");
  options.vignetting = 40;
  const cv::Mat1b image = Simulator(grey_wall(220), still_path(), options).frame(0).left;
  const double grey = seen_grey(220), cx = 159.5, cy = 99.5;
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      const double r2 = ((x - cx) * (x - cx) + (y - cy) * (y - cy)) / (cx * cx + cy * cy);
      ASSERT_NEAR(image(y, x), grey * (1 - 0.4 * r2), 0.501);
    }
  }
  EXPECT_NEAR(image(0, 0), grey * 0.6, 0.501);
}

TEST(Sensor, BrightnessDriftsAsAsked) {
  SimulateOptions options = plain_options("ideal");
  options.width = options.height = 32;
  options.exposure_drift = 20;
  options.rate = 2;
  options.frames = 200;
  const double grey = seen_grey(150);
  const auto brightness = [&](const cv::Mat& image) { return image.at<uchar>(16, 16) / grey; };
  const double half_level = 0.5 / grey;
  {
    const Simulator simulator(grey_wall(150), still_path(), options);
    double least = 9, most = 0, steepest = 0, before = 0;
    for (int i = 0; i < options.frames; ++i) {
      const StereoFrame frame = simulator.frame(i);
      EXPECT_EQ(cv::norm(frame.left, frame.right, cv::NORM_INF), 0);  // both cameras alike
      const double now = brightness(frame.left);
      least = std::min(least, now);
      most = std::max(most, now);
      if (i > 0) steepest = std::max(steepest, std::abs(now - before));
      before = now;
    }
    EXPECT_NEAR(least, 0.8, 0.01);
    EXPECT_NEAR(most, 1.2, 0.01);
    EXPECT_LT(steepest, 0.2 * 2 * CV_PI / 19 * 0.5 + 2 * half_level);  // slow
  }
  options.exposure_drift = 0;
  options.gain_difference = 10;
  const Simulator simulator(grey_wall(150), still_path(), options);
  const Sensor sensor(options);
  double sum = 0, least = 9, most = 0;
  for (int i = 0; i < options.frames; ++i) {
    const StereoFrame frame = simulator.frame(i);
    EXPECT_NEAR(brightness(frame.left), 1, half_level + 1e-6);
    const double right = brightness(frame.right);
    EXPECT_NEAR(right, sensor.gain(1, i / options.rate), half_level + 1e-6);
    sum += right;
    least = std::min(least, right);
    most = std::max(most, right);
  }
  EXPECT_NEAR(sum / options.frames, 1.1, 0.005);
  EXPECT_NEAR(least, 1.05, half_level + 0.002);
  EXPECT_NEAR(most, 1.15, half_level + 0.002);
}

}  // namespace
}  // namespace iris::simulate
