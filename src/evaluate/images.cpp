#include "iris/evaluate/images.h"

#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>

#include "iris/core/error.h"

namespace iris::evaluate {
namespace {

constexpr int kWindow = 11;

cv::Mat1d grey_of(const cv::Mat& image) {
  cv::Mat grey = image;
  if (image.channels() == 3) cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);
  cv::Mat1d values;
  grey.convertTo(values, CV_64F);
  return values;
}

cv::Mat1d smooth(const cv::Mat1d& values) {
  cv::Mat1d result;
  cv::GaussianBlur(values, result, {kWindow, kWindow}, 1.5, 1.5, cv::BORDER_REFLECT);
  return result;
}

// Structural similarity at each pixel.
cv::Mat1d similarity(const cv::Mat1d& a, const cv::Mat1d& b) {
  constexpr double kC1 = 0.01 * 255 * 0.01 * 255, kC2 = 0.03 * 255 * 0.03 * 255;
  const cv::Mat1d mean_a = smooth(a), mean_b = smooth(b);
  const cv::Mat1d aa = smooth(a.mul(a)), bb = smooth(b.mul(b)), ab = smooth(a.mul(b));
  cv::Mat1d result(a.size());
  for (int y = 0; y < a.rows; ++y) {
    for (int x = 0; x < a.cols; ++x) {
      const double ma = mean_a(y, x), mb = mean_b(y, x);
      result(y, x) = (2 * ma * mb + kC1) * (2 * (ab(y, x) - ma * mb) + kC2) /
                     ((ma * ma + mb * mb + kC1) * (aa(y, x) - ma * ma + bb(y, x) - mb * mb + kC2));
    }
  }
  return result;
}

}  // namespace

ImageErrors compare_images(const cv::Mat& estimate, const cv::Mat& truth, const cv::Mat1b& mask) {
  IRIS_CHECK(estimate.size() == truth.size() && estimate.type() == truth.type() && estimate.depth() == CV_8U);
  IRIS_CHECK(estimate.channels() == 1 || estimate.channels() == 3);
  IRIS_CHECK(mask.empty() || mask.size() == truth.size());
  const cv::Mat1b used = mask.empty() ? cv::Mat1b(truth.size(), uint8_t{255}) : cv::Mat1b(mask != 0);
  ImageErrors errors;
  errors.pixels = cv::countNonZero(used);
  errors.coverage = 100.0 * static_cast<double>(errors.pixels) / static_cast<double>(used.total());
  if (errors.pixels == 0) return errors;
  errors.mse = cv::norm(estimate, truth, cv::NORM_L2SQR, used) / static_cast<double>(errors.pixels * truth.channels());
  errors.psnr = errors.mse > 0 ? 10 * std::log10(255.0 * 255.0 / errors.mse) : std::numeric_limits<double>::infinity();

  cv::Mat1b inside;
  cv::erode(used, inside, cv::Mat::ones(kWindow, kWindow, CV_8U), cv::Point(-1, -1), 1, cv::BORDER_CONSTANT,
            cv::Scalar::all(0));
  const cv::Mat1d map = similarity(grey_of(estimate), grey_of(truth));
  double sum = 0;
  int64_t count = 0;
  for (int y = 0; y < inside.rows; ++y) {
    for (int x = 0; x < inside.cols; ++x) {
      if (!inside(y, x)) continue;
      sum += map(y, x);
      ++count;
    }
  }
  errors.ssim = count > 0 ? sum / static_cast<double>(count) : 0;
  return errors;
}

}  // namespace iris::evaluate
