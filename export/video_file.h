// Tours as video files.
#pragma once

#include <filesystem>
#include <memory>
#include <opencv2/core.hpp>

namespace iris::exporters {

// H.264 in MP4, yuv420p: what every browser plays. The frames are written to a temporary neighbour; close() renames it,
// so that the file at `path` is whole or not there. Without close() nothing is left behind.
class VideoWriter {
 public:
  // width, height [px] even, fps > 0. Throws InputError if the file cannot be written or OpenCV has no H.264 encoder.
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

}  // namespace iris::exporters
