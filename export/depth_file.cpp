#include "export/depth_file.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <opencv2/imgcodecs.hpp>
#include <string>

#include "iris/core/error.h"

namespace iris::exporters {
namespace {

// EXR is little endian.
class Bytes {
 public:
  template <typename Number>
  void number(Number value) {
    static_assert(std::endian::native == std::endian::little);
    const auto* from = reinterpret_cast<const unsigned char*>(&value);
    bytes.insert(bytes.end(), from, from + sizeof value);
  }
  void text(const std::string& value) {
    bytes.insert(bytes.end(), value.begin(), value.end());
    bytes.push_back(0);
  }
  void attribute(const std::string& name, const std::string& type, int32_t size) {
    text(name);
    text(type);
    number(size);
  }
  std::vector<unsigned char> bytes;
};

}  // namespace

std::vector<unsigned char> encode_depth_png(const cv::Mat1f& depth) {
  cv::Mat1w millimetres(depth.size());
  std::transform(depth.begin(), depth.end(), millimetres.begin(), [](float metres) {
    if (!(metres > 0)) return uint16_t{0};
    return static_cast<uint16_t>(std::clamp(std::round(1000.0 * metres), 1.0, 65535.0));
  });
  std::vector<unsigned char> png;
  IRIS_CHECK(cv::imencode(".png", millimetres, png));
  return png;
}

std::vector<unsigned char> encode_depth_exr(const cv::Mat1f& depth) {
  constexpr int32_t kFloat = 2;
  Bytes out;
  out.number(int32_t{20000630});  // magic number
  out.number(int32_t{2});         // version, scan lines
  out.attribute("channels", "chlist", 2 + 16 + 1);
  out.text("Y");
  out.number(kFloat);
  out.number(int32_t{0});  // not perceptually linear; reserved
  out.number(int32_t{1});  // every pixel
  out.number(int32_t{1});
  out.bytes.push_back(0);
  out.attribute("compression", "compression", 1);
  out.bytes.push_back(0);
  for (const char* window : {"dataWindow", "displayWindow"}) {
    out.attribute(window, "box2i", 16);
    out.number(int32_t{0});
    out.number(int32_t{0});
    out.number(int32_t{depth.cols - 1});
    out.number(int32_t{depth.rows - 1});
  }
  out.attribute("lineOrder", "lineOrder", 1);
  out.bytes.push_back(0);
  out.attribute("pixelAspectRatio", "float", 4);
  out.number(1.0f);
  out.attribute("screenWindowCenter", "v2f", 8);
  out.number(0.0f);
  out.number(0.0f);
  out.attribute("screenWindowWidth", "float", 4);
  out.number(1.0f);
  out.bytes.push_back(0);
  const uint64_t row_bytes = static_cast<uint64_t>(depth.cols) * sizeof(float);
  const uint64_t first = out.bytes.size() + static_cast<uint64_t>(depth.rows) * 8;
  for (int y = 0; y < depth.rows; ++y) out.number(first + static_cast<uint64_t>(y) * (8 + row_bytes));
  for (int y = 0; y < depth.rows; ++y) {
    out.number(int32_t{y});
    out.number(static_cast<int32_t>(row_bytes));
    const auto* row = reinterpret_cast<const unsigned char*>(depth[y]);
    out.bytes.insert(out.bytes.end(), row, row + row_bytes);
  }
  return std::move(out.bytes);
}

}  // namespace iris::exporters
