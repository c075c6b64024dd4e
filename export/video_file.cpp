#include "export/video_file.h"

#include <unistd.h>

#include <opencv2/videoio.hpp>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"

namespace iris::exporters {
namespace fs = std::filesystem;

struct VideoWriter::State {
  fs::path path, temporary;
  int width = 0, height = 0;
  int frames = 0;
  cv::VideoWriter video;
};

VideoWriter::VideoWriter(const fs::path& path, int width, int height, double fps) : state_(std::make_unique<State>()) {
  IRIS_CHECK(width > 0 && height > 0 && fps > 0);
  if (width % 2 != 0 || height % 2 != 0) {
    throw UsageError("a video needs an even width and height, not " + std::to_string(width) + "x" +
                     std::to_string(height));
  }
  state_->path = path;
  state_->width = width;
  state_->height = height;
  if (path.has_parent_path()) {
    std::error_code error;
    fs::create_directories(path.parent_path(), error);
    if (error)
      throw InputError(path.parent_path(), "cannot be made (" + error.message() + ")", "choose another folder");
  }
  // The extension tells FFmpeg the container.
  state_->temporary = path.parent_path() / (".tmp." + std::to_string(getpid()) + "." + path.stem().string() + ".mp4");
  if (!state_->video.open(state_->temporary.string(), cv::CAP_FFMPEG, cv::VideoWriter::fourcc('a', 'v', 'c', '1'), fps,
                          cv::Size(width, height))) {
    std::error_code ignored;
    fs::remove(state_->temporary, ignored);
    throw InputError(path, "cannot be written as H.264 video",
                     "check the folder and its permissions, and that OpenCV has FFmpeg with libx264");
  }
}

VideoWriter::~VideoWriter() {
  if (!state_) return;
  state_->video.release();
  std::error_code ignored;
  fs::remove(state_->temporary, ignored);
}

void VideoWriter::add(const cv::Mat3b& frame) {
  IRIS_CHECK(state_ && frame.cols == state_->width && frame.rows == state_->height);
  state_->video.write(frame);
  ++state_->frames;
}

void VideoWriter::close() {
  IRIS_CHECK(state_ && state_->frames > 0);
  state_->video.release();
  // OpenCV reports no failed write: the finished file is opened again and must hold every frame.
  cv::VideoCapture check(state_->temporary.string(), cv::CAP_FFMPEG);
  if (!check.isOpened() || static_cast<int>(check.get(cv::CAP_PROP_FRAME_COUNT) + 0.5) != state_->frames) {
    throw InputError(state_->path, "could not be written completely", "check that the disk has space");
  }
  check.release();
  write_file_with(state_->path, [&](const fs::path& target) { fs::rename(state_->temporary, target); });
  state_.reset();
}

}  // namespace iris::exporters
