// Tours as video files.
#pragma once

#include <filesystem>
#include <memory>
#include <opencv2/core.hpp>

namespace iris::exporters {

// The extension chooses: .mp4 is H.264, yuv420p, with its index in front so that it plays while it loads: what every
// browser shows; .webm is VP9. The frames are written to a temporary neighbour; close() renames it, so that the file at
// `path` is whole or not there. Without close() nothing is left behind.
class VideoWriter {
 public:
  // width, height [px] even, fps > 0. Throws InputError if the file cannot be written or OpenCV has no
  // encoder for it; UsageError for sizes that are not even and other extensions.
  VideoWriter(const std::filesystem::path& path, int width, int height, double fps);
  ~VideoWriter();
  VideoWriter(const VideoWriter&) = delete;
  VideoWriter& operator=(const VideoWriter&) = delete;

  // BGR, of the size given.
  void add(const cv::Mat3b& frame);

  // Ends the file and gives it its name. Throws InputError if it could not be written (a full disk, say).
  void close();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

// Whether a file's extension is that of a video that can be written.
bool is_video_name(const std::filesystem::path& path);

// Writes an MP4 file anew with its index (moov) before the pictures (mdat), offsets corrected. False: it already was,
// or is no such file; nothing is written then. Throws InputError.
bool write_fast_start(const std::filesystem::path& from, const std::filesystem::path& to);

}  // namespace iris::exporters
