// Rectified pairs for tests of stereo: public ground truth, a recording, rendered patterns.
#pragma once

#include <cmath>
#include <fstream>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <utility>
#include <vector>

#include "iris/types/disparity_image.h"
#include "support/npz.h"
#include "support/test_data.h"

namespace iris::testing {

struct TruthPair {
  cv::Mat1b left, right;
  cv::Mat1f truth;  // [px], 0 = unknown
};

// Middlebury's Tsukuba (whole-pixel truth) or Cones.
inline TruthPair middlebury_pair(const std::string& name) {
  const auto folder = test_data("middlebury") / name;
  const bool tsukuba = name == "tsukuba";
  TruthPair pair;
  pair.left = cv::imread((folder / "img_left.png").string(), cv::IMREAD_GRAYSCALE);
  pair.right = cv::imread((folder / "img_right.png").string(), cv::IMREAD_GRAYSCALE);
  const cv::Mat1b coded =
      cv::imread((folder / (tsukuba ? "disp_gt.pgm" : "disp_gt.png")).string(), cv::IMREAD_GRAYSCALE);
  coded.convertTo(pair.truth, CV_32F, tsukuba ? 1.0 / 16 : 1.0 / 4);
  return pair;
}

// Middlebury's Motorcycle at a quarter of its size, as scikit-image brings it.
inline TruthPair motorcycle_pair() {
  const auto folder = test_data("middlebury") / "motorcycle";
  TruthPair pair;
  pair.left = cv::imread((folder / "motorcycle_left.png").string(), cv::IMREAD_GRAYSCALE);
  pair.right = cv::imread((folder / "motorcycle_right.png").string(), cv::IMREAD_GRAYSCALE);
  pair.truth = read_npz_float((folder / "motorcycle_disp.npz").string());
  for (float& d : pair.truth) d = std::isfinite(d) ? d : 0.0f;
  return pair;
}

// Middlebury's Aloe at a third of its size, as Debian's opencv-doc brings it.
inline std::filesystem::path aloe_folder() { return "/usr/share/doc/opencv-doc/examples/data"; }
inline TruthPair aloe_pair() {
  constexpr int kScale = 3;
  const auto read = [](const char* name) {
    cv::Mat1b image = cv::imread((aloe_folder() / name).string(), cv::IMREAD_GRAYSCALE);
    return cv::Mat1b(image(cv::Rect(0, 0, image.cols / kScale * kScale, image.rows / kScale * kScale)));
  };
  TruthPair pair;
  cv::resize(read("aloeL.jpg"), pair.left, cv::Size(), 1.0 / kScale, 1.0 / kScale, cv::INTER_AREA);
  cv::resize(read("aloeR.jpg"), pair.right, cv::Size(), 1.0 / kScale, 1.0 / kScale, cv::INTER_AREA);
  const cv::Mat1b coded = read("aloeGT.png");  // [px] of the full size
  pair.truth.create(pair.left.size());
  for (int y = 0; y < pair.truth.rows; ++y) {
    for (int x = 0; x < pair.truth.cols; ++x) {
      pair.truth(y, x) = static_cast<float>(coded(kScale * y + kScale / 2, kScale * x + kScale / 2)) / kScale;
    }
  }
  return pair;
}

// Pixels whose surface the right camera sees: 255; hidden ones, those outside of its image and those without truth: 0.
// The truth is warped into the right image, where of several surfaces the nearest is visible; a pixel is hidden if
// another one lies before it there by more than a pixel of disparity.
inline cv::Mat1b visible_in_both(const cv::Mat1f& truth) {
  cv::Mat1b visible(truth.size(), uchar{0});
  std::vector<float> nearest(truth.cols);
  for (int y = 0; y < truth.rows; ++y) {
    std::fill(nearest.begin(), nearest.end(), 0.0f);
    // A surface covers the right columns between the partners of neighbouring pixels that belong to it.
    for (int x = 0; x < truth.cols; ++x) {
      const float d = truth(y, x);
      if (!(d > 0)) continue;
      const bool joined = x > 0 && truth(y, x - 1) > 0 && std::abs(truth(y, x - 1) - d) <= 1;
      const int end = static_cast<int>(std::lround(static_cast<float>(x) - d));
      const int begin = joined ? static_cast<int>(std::lround(static_cast<float>(x - 1) - truth(y, x - 1))) : end;
      for (int u = std::max(0, std::min(begin, end)); u <= std::min(truth.cols - 1, std::max(begin, end)); ++u) {
        nearest[u] = std::max(nearest[u], d);
      }
    }
    for (int x = 0; x < truth.cols; ++x) {
      const float d = truth(y, x);
      const int u = static_cast<int>(std::lround(static_cast<float>(x) - d));
      if (d > 0 && u >= 0 && u < truth.cols && nearest[u] - d <= 1) visible(y, x) = 255;
    }
  }
  return visible;
}

// What was measured, without what interpolation filled in.
inline DisparityImage before_interpolation(const DisparityImage& image) {
  DisparityImage out{image.disparity.clone(), image.origin.clone()};
  const cv::Mat1b filled = image.origin > static_cast<uint8_t>(DisparityOrigin::corrected);
  out.disparity.setTo(0, filled);
  out.origin.setTo(0, filled);
  return out;
}

// Pair `index` of the EuRoC recording, rectified with OpenCV.
inline std::pair<cv::Mat1b, cv::Mat1b> rectified_euroc_pair(int index) {
  const auto folder = test_data("euroc_mh01") / "mav0";
  std::vector<cv::String> files[2];
  cv::glob((folder / "cam0" / "data" / "*.png").string(), files[0]);
  cv::glob((folder / "cam1" / "data" / "*.png").string(), files[1]);
  // sensor.yaml of both cameras: fx fy cx cy, k1 k2 p1 p2, body from camera.
  const cv::Matx33d k0(458.654, 0, 367.215, 0, 457.296, 248.375, 0, 0, 1);
  const cv::Matx33d k1(457.587, 0, 379.999, 0, 456.134, 255.238, 0, 0, 1);
  const cv::Vec4d d0(-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05);
  const cv::Vec4d d1(-0.28368365, 0.07451284, -0.00010473, -3.55590700e-05);
  const cv::Matx44d b0(0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975, 0.999557249008,
                       0.0149672133247, 0.025715529948, -0.064676986768, -0.0257744366974, 0.00375618835797,
                       0.999660727178, 0.00981073058949, 0, 0, 0, 1);
  const cv::Matx44d b1(0.0125552670891, -0.999755099723, 0.0182237714554, -0.0198435579556, 0.999598781151,
                       0.0130119051815, 0.0251588363115, 0.0453689425024, -0.0253898008918, 0.0179005838253,
                       0.999517347078, 0.00786212447038, 0, 0, 0, 1);
  const cv::Matx44d right_from_left = b1.inv() * b0;
  const cv::Size size(752, 480);
  cv::Mat r0, r1, p0, p1, q;
  cv::stereoRectify(k0, d0, k1, d1, size, right_from_left.get_minor<3, 3>(0, 0), right_from_left.get_minor<3, 1>(0, 3),
                    r0, r1, p0, p1, q, cv::CALIB_ZERO_DISPARITY, 0);
  std::pair<cv::Mat1b, cv::Mat1b> pair;
  for (int camera = 0; camera < 2; ++camera) {
    cv::Mat map_x, map_y;
    if (camera == 0) {
      cv::initUndistortRectifyMap(k0, d0, r0, p0, size, CV_32FC1, map_x, map_y);
    } else {
      cv::initUndistortRectifyMap(k1, d1, r1, p1, size, CV_32FC1, map_x, map_y);
    }
    cv::remap(cv::imread(files[camera].at(index), cv::IMREAD_GRAYSCALE), camera == 0 ? pair.first : pair.second, map_x,
              map_y, cv::INTER_LINEAR);
  }
  return pair;
}

// A smooth random texture that can be evaluated anywhere: a sum of gratings with periods from 4 to 40 px.
class Texture {
 public:
  explicit Texture(int seed) {
    cv::RNG random(seed);
    for (int i = 0; i < 60; ++i) {
      const double period = 4 * std::pow(10.0, random.uniform(0.0, 1.0)), angle = random.uniform(0.0, CV_PI);
      gratings_.push_back(
          {2 * CV_PI / period * std::cos(angle), 2 * CV_PI / period * std::sin(angle), random.uniform(0.0, 2 * CV_PI)});
    }
  }
  double operator()(double x, double y) const {
    double sum = 0;
    for (const cv::Vec3d& g : gratings_) sum += std::cos(g[0] * x + g[1] * y + g[2]);
    return 128 + 40 * sum / std::sqrt(gratings_.size() / 2.0);
  }

 private:
  std::vector<cv::Vec3d> gratings_;
};

// A slanted plane: disparity at left pixel (x, y) is d0 + slope * x.
inline std::pair<cv::Mat1b, cv::Mat1b> slanted_pair(cv::Size size, double d0, double slope, int seed = 1) {
  const Texture texture(seed);
  std::pair<cv::Mat1b, cv::Mat1b> pair{cv::Mat1b(size), cv::Mat1b(size)};
  for (int y = 0; y < size.height; ++y) {
    for (int x = 0; x < size.width; ++x) {
      pair.first(y, x) = cv::saturate_cast<uchar>(texture(x, y));
      // x_right = x - d0 - slope x
      pair.second(y, x) = cv::saturate_cast<uchar>(texture((x + d0) / (1 - slope), y));
    }
  }
  return pair;
}

// Four slanted planes for measuring the sub-pixel accuracy, their disparities covering all fractions of a pixel evenly,
// with noise of this standard deviation [grey levels] on both images. Truth is unknown (0) near the edges.
inline std::vector<TruthPair> slanted_planes(double noise) {
  std::vector<TruthPair> planes;
  for (int plane = 0; plane < 4; ++plane) {
    const double d0 = plane % 2 == 0 ? 6.3 : 20.2, slope = plane % 2 == 0 ? 0.03 : -0.02;
    const cv::Size size(320, 120);
    auto [left, right] = slanted_pair(size, d0, slope, 1 + plane);
    cv::RNG random(plane + 1);
    for (cv::Mat1b* image : {&left, &right}) {
      for (uchar& v : *image) v = cv::saturate_cast<uchar>(v + random.gaussian(noise));
    }
    cv::Mat1f truth(size, 0.0f);
    for (int y = 8; y < size.height - 8; ++y) {
      for (int x = 40; x < size.width - 8; ++x) truth(y, x) = static_cast<float>(d0 + slope * x);
    }
    planes.push_back({left, right, truth});
  }
  return planes;
}

}  // namespace iris::testing
