#include "iris/workspace/view_files.h"

#include <fmt/format.h>

#include <cmath>
#include <opencv2/imgcodecs.hpp>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"

namespace iris::workspace {
namespace fs = std::filesystem;
namespace {

constexpr double kMaxCode = 65535;

fs::path file_of(const fs::path& folder, int frame_idx, const char* what) {
  return folder / fmt::format("{:06}.{}.png", frame_idx, what);
}

cv::Mat read_png(const fs::path& path) {
  cv::Mat image;
  if (fs::exists(path)) image = cv::imread(path.string(), cv::IMREAD_UNCHANGED);
  if (image.empty()) {
    throw InputError(path, fs::exists(path) ? "is no readable PNG" : "is missing",
                     "delete the output folder and run again");
  }
  return image;
}

}  // namespace

int disparity_scale(double max_disparity) { return max_disparity * 256 < kMaxCode ? 256 : 128; }

std::vector<unsigned char> encode_png(const cv::Mat& image) {
  std::vector<unsigned char> bytes;
  // Without parameters OpenCV chooses the fastest settings; naming a level would make libpng try all row filters.
  IRIS_CHECK(cv::imencode(".png", image, bytes));
  return bytes;
}

void write_view(const fs::path& folder, const StereoView& view, int scale) {
  cv::Mat1w code(view.disparity.disparity.size());
  for (int y = 0; y < code.rows; ++y) {
    const float* from = view.disparity.disparity[y];
    uint16_t* to = code[y];
    for (int x = 0; x < code.cols; ++x) {
      // A valid disparity stays valid: at least one unit.
      to[x] = from[x] > 0
                  ? static_cast<uint16_t>(std::min(kMaxCode, std::max(1.0, std::nearbyint(from[x] * double(scale)))))
                  : uint16_t{0};
    }
  }
  write_file(file_of(folder, view.frame_idx, "left"), encode_png(view.image));
  write_file(file_of(folder, view.frame_idx, "disparity"), encode_png(code));
  write_file(file_of(folder, view.frame_idx, "origin"), encode_png(view.disparity.origin));
}

void read_view(const fs::path& folder, int scale, StereoView& view) {
  view.image = read_png(file_of(folder, view.frame_idx, "left"));
  const fs::path disparity_path = file_of(folder, view.frame_idx, "disparity");
  const fs::path origin_path = file_of(folder, view.frame_idx, "origin");
  const cv::Mat code = read_png(disparity_path);
  const cv::Mat origin = read_png(origin_path);
  if (code.type() != CV_16UC1 || code.size() != view.image.size()) {
    throw InputError(disparity_path, "is not the 16-bit disparity image of its view",
                     "delete the output folder and run again");
  }
  if (origin.type() != CV_8UC1 || origin.size() != view.image.size()) {
    throw InputError(origin_path, "is not the origin image of its view", "delete the output folder and run again");
  }
  code.convertTo(view.disparity.disparity, CV_32F, 1.0 / scale);
  view.disparity.origin = origin;
}

}  // namespace iris::workspace
