// The pictures of a tour as files, each whole or not there, so that an interrupted tour goes on behind them.
#pragma once

#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <opencv2/core.hpp>
#include <string>

namespace iris::exporters {

struct FrameFormat {
  bool jpeg = false;  // else PNG
  bool depth_png = false, depth_exr = false;
};

//   000000.png …          (or .jpg)
//   depth/000000.png …    16-bit [mm] (and .exr [m]), if asked for
//   tour.json             what the frames show; its "fingerprint" tells whether they belong to this tour
class FrameFolder {
 public:
  // Makes the folder. Frames of another tour are removed, those of this one are kept. Throws InputError if the folder
  // holds files but no tour. `description`: the content of tour.json, with a fingerprint.
  FrameFolder(const std::filesystem::path& folder, const nlohmann::json& description, const FrameFormat& format);

  const std::filesystem::path& path() const { return folder_; }
  std::filesystem::path frame(int frame_idx) const;
  bool has(int frame_idx) const;
  // Depth first: where the picture is, its depth is too.
  void write(int frame_idx, const cv::Mat3b& image, const cv::Mat1f& depth) const;
  // Throws InputError if the frame is damaged.
  cv::Mat3b read(int frame_idx) const;

  // Removes frames, depth and tour.json of a folder, and the folder if nothing else is in it. Does nothing if it holds
  // no tour.
  static void remove(const std::filesystem::path& folder);

 private:
  std::filesystem::path folder_;
  FrameFormat format_;
};

}  // namespace iris::exporters
