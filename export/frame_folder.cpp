#include "export/frame_folder.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

#include "export/depth_file.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/workspace/view_files.h"

namespace iris::exporters {
namespace fs = std::filesystem;
namespace {

constexpr const char* kRecord = "tour.json";
constexpr int kJpegQuality = 92;

bool is_frame(const fs::path& file) {
  const std::string stem = file.stem().string(), extension = file.extension().string();
  return stem.size() >= 6 && std::all_of(stem.begin(), stem.end(), [](unsigned char c) { return std::isdigit(c); }) &&
         (extension == ".png" || extension == ".jpg" || extension == ".exr");
}

// Frames, and what a killed program left behind.
void remove_frames(const fs::path& folder, bool frames) {
  if (!fs::is_directory(folder)) return;
  std::vector<fs::path> files;
  for (const auto& entry : fs::directory_iterator(folder)) {
    if (entry.path().filename().string().starts_with(".tmp.") || (frames && is_frame(entry.path()))) {
      files.push_back(entry.path());
    }
  }
  for (const fs::path& file : files) fs::remove(file);
}

}  // namespace

FrameFolder::FrameFolder(const fs::path& folder, const nlohmann::json& description, const FrameFormat& format)
    : folder_(folder), format_(format) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error || !fs::is_directory(folder)) {
    throw InputError(folder, "is no folder and cannot become one", "give another name");
  }
  bool same = false;
  if (fs::exists(folder / kRecord)) {
    const auto before = nlohmann::json::parse(read_file(folder / kRecord), nullptr, false);
    same = before.is_object() && before.value("fingerprint", "") == description.at("fingerprint").get<std::string>();
  } else {
    // A tour killed before its first frame leaves at most a temporary file.
    for (const auto& entry : fs::directory_iterator(folder)) {
      if (entry.path().filename().string().starts_with(".tmp.")) continue;
      throw InputError(folder, "holds files but no tour", "give a new folder, or empty this one");
    }
  }
  remove_frames(folder, !same);
  remove_frames(folder / "depth", !same);
  if (!same) write_file(folder / kRecord, description.dump(1) + "\n");
}

fs::path FrameFolder::frame(int frame_idx) const {
  return folder_ / fmt::format("{:06}.{}", frame_idx, format_.jpeg ? "jpg" : "png");
}

bool FrameFolder::has(int frame_idx) const { return fs::exists(frame(frame_idx)); }

void FrameFolder::write(int frame_idx, const cv::Mat3b& image, const cv::Mat1f& depth) const {
  const std::string name = fmt::format("{:06}", frame_idx);
  if (format_.depth_png) write_file(folder_ / "depth" / (name + ".png"), encode_depth_png(depth));
  if (format_.depth_exr) write_file(folder_ / "depth" / (name + ".exr"), encode_depth_exr(depth));
  if (format_.jpeg) {
    std::vector<unsigned char> bytes;
    IRIS_CHECK(cv::imencode(".jpg", image, bytes, {cv::IMWRITE_JPEG_QUALITY, kJpegQuality}));
    write_file(frame(frame_idx), bytes);
  } else {
    write_file(frame(frame_idx), workspace::encode_png(image));
  }
}

cv::Mat3b FrameFolder::read(int frame_idx) const {
  const cv::Mat3b image = cv::imread(frame(frame_idx).string(), cv::IMREAD_COLOR);
  if (image.empty()) throw InputError(frame(frame_idx), "cannot be read", "remove it and give the same command again");
  return image;
}

void FrameFolder::remove(const fs::path& folder) {
  if (!fs::exists(folder / kRecord)) return;
  remove_frames(folder, true);
  remove_frames(folder / "depth", true);
  std::error_code ignored;
  fs::remove(folder / "depth", ignored);
  fs::remove(folder / kRecord);
  fs::remove(folder, ignored);
}

}  // namespace iris::exporters
