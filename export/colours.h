// Linear light and sRGB (IEC 61966-2-1): colours are averaged in linear light.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <opencv2/core.hpp>

namespace iris::exporters {

// Linear light of the 256 sRGB levels.
inline std::array<float, 256> linear_levels() {
  std::array<float, 256> levels;
  for (int i = 0; i < 256; ++i) {
    const double s = i / 255.0;
    levels[i] = static_cast<float>(s <= 0.04045 ? s / 12.92 : std::pow((s + 0.055) / 1.055, 2.4));
  }
  return levels;
}

// sRGB of linear light, both in [0, 1].
inline double srgb_of(double linear) {
  return linear <= 0.0031308 ? 12.92 * linear : 1.055 * std::pow(std::min(linear, 1.0), 1 / 2.4) - 0.055;
}

// Red, green, blue of a pixel as linear light.
inline Eigen::Vector3f linear_colour(const cv::Mat& image, int y, int x, const std::array<float, 256>& levels) {
  if (image.type() == CV_8UC1) return Eigen::Vector3f::Constant(levels[image.at<uchar>(y, x)]);
  const cv::Vec3b& bgr = image.at<cv::Vec3b>(y, x);
  return {levels[bgr[2]], levels[bgr[1]], levels[bgr[0]]};
}

// As glTF stores it: 8 bits of linear light would leave too few dark levels.
inline uint16_t linear_16(float linear) {
  return static_cast<uint16_t>(std::lround(std::clamp(linear, 0.0f, 1.0f) * 65535));
}

inline std::array<uint8_t, 3> srgb_colour(const Eigen::Vector3f& linear) {
  std::array<uint8_t, 3> rgb;
  for (int i = 0; i < 3; ++i) {
    rgb[i] = static_cast<uint8_t>(std::lround(std::clamp(srgb_of(linear[i]), 0.0, 1.0) * 255));
  }
  return rgb;
}

}  // namespace iris::exporters
