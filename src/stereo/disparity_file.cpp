#include "iris/stereo/disparity_file.h"

#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>

#include "iris/core/error.h"

namespace iris::stereo {
namespace {

void append(std::string& bytes, float value) {
  uint32_t bits = std::bit_cast<uint32_t>(value);
  for (int i = 0; i < 4; ++i, bits >>= 8) bytes.push_back(static_cast<char>(bits & 255));
}

}  // namespace

cv::Mat1w kitti_code(const cv::Mat1f& disparity) {
  cv::Mat1w code;
  disparity.convertTo(code, CV_16U, 256);
  return code;
}

std::string encode_pfm(const cv::Mat1f& image) {
  std::string bytes = "Pf\n" + std::to_string(image.cols) + " " + std::to_string(image.rows) + "\n-1.0\n";
  bytes.reserve(bytes.size() + 4 * image.total());
  for (int y = image.rows - 1; y >= 0; --y) {
    for (int x = 0; x < image.cols; ++x) {
      append(bytes, image(y, x) > 0 ? image(y, x) : std::numeric_limits<float>::infinity());
    }
  }
  return bytes;
}

cv::Mat1f depth_image(const cv::Mat1f& disparity, const RectifiedCamera& camera) {
  cv::Mat1f depth(disparity.size(), 0.0f);
  for (int y = 0; y < disparity.rows; ++y) {
    for (int x = 0; x < disparity.cols; ++x) {
      if (!(disparity(y, x) > 0)) continue;
      const double z = camera.point(x, y, disparity(y, x)).z();
      if (std::isfinite(z) && z > 0) depth(y, x) = static_cast<float>(z);
    }
  }
  return depth;
}

std::string encode_ply(const DisparityImage& image, const cv::Mat3b& colour, const RectifiedCamera& camera,
                       DisparityOrigin up_to) {
  IRIS_CHECK(colour.size() == image.disparity.size());
  std::string points;
  size_t count = 0;
  for (int y = 0; y < colour.rows; ++y) {
    for (int x = 0; x < colour.cols; ++x) {
      const float d = image.at(y, x, up_to);
      if (!(d > 0)) continue;
      const Eigen::Vector3d point = camera.point(x, y, d);
      if (!point.allFinite() || point.z() <= 0) continue;
      for (int i = 0; i < 3; ++i) append(points, static_cast<float>(point(i)));
      for (int c = 2; c >= 0; --c) points.push_back(static_cast<char>(colour(y, x)[c]));
      ++count;
    }
  }
  return "ply\nformat binary_little_endian 1.0\ncomment metres, left camera: x right, y down, z forward\nelement "
         "vertex " +
         std::to_string(count) +
         "\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\nproperty uchar green\n"
         "property uchar blue\nend_header\n" +
         points;
}

}  // namespace iris::stereo
