#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <mutex>
#include <opencv2/videoio.hpp>

#include "common.h"
#include "iris/core/error.h"

namespace iris::session {
namespace {

namespace fs = std::filesystem;

// One video file, decoded in ascending order. Seeking in compressed video is not exact in every container: going back
// means to decode again from the beginning.
class VideoStream {
 public:
  explicit VideoStream(const fs::path& file) : file_(file) {
    open();
    fps_ = capture_.get(cv::CAP_PROP_FPS);
    announced_ = static_cast<int>(std::max(0.0, capture_.get(cv::CAP_PROP_FRAME_COUNT)));
    count_ = announced_;
    // The header's count is a promise: only if the last frame can be had is it believed.
    if (count_ == 0 || !capture_.set(cv::CAP_PROP_POS_FRAMES, count_ - 1) || !capture_.grab()) {
      open();
      for (count_ = 0; capture_.grab(); ++count_) {
      }
    }
    open();
  }

  const fs::path& file() const { return file_; }
  double fps() const { return fps_; }
  int count() const { return count_; }
  int announced() const { return announced_; }

  cv::Mat frame(int index) {
    if (index < next_) open();
    for (; next_ < index; ++next_) grab();
    grab();
    ++next_;
    cv::Mat image;
    if (!capture_.retrieve(image) || image.empty()) fail();
    if (image.depth() != CV_8U || (image.channels() != 1 && image.channels() != 3)) fail();
    return image.clone();  // the decoder uses its own memory again
  }

 private:
  void open() {
    next_ = 0;
    if (!capture_.open(file_.string(), cv::CAP_FFMPEG) && !capture_.open(file_.string())) {
      throw InputError(file_, "cannot be opened as a video",
                       "check that the recording was finished; convert it to MP4 (H.264)");
    }
  }
  void grab() {
    if (!capture_.grab()) fail();
  }
  [[noreturn]] void fail() {
    throw InputError(file_, fmt::format("frame {} cannot be decoded", next_), "the video is damaged; convert it again");
  }

  fs::path file_;
  cv::VideoCapture capture_;
  int next_ = 0;
  int count_ = 0, announced_ = 0;
  double fps_ = 0;
};

enum class Layout { two_files, side_by_side, top_bottom };

// How one video holds two images: told by the calibration's size, otherwise by the shape. Both images of a pair are at
// least as wide as high and at most twice, so twice the width or twice the height is unmistakable only beyond that.
Layout layout_of(const cv::Size& video, const CameraModel& camera, const fs::path& file) {
  if (camera.width > 0) {
    if (video == cv::Size(2 * camera.width, camera.height)) return Layout::side_by_side;
    if (video == cv::Size(camera.width, 2 * camera.height)) return Layout::top_bottom;
    throw InputError(
        file,
        fmt::format("the video is {}x{} px; for a calibration of {}x{} px it must be {}x{} (side by side) or "
                    "{}x{} (top and bottom)",
                    video.width, video.height, camera.width, camera.height, 2 * camera.width, camera.height,
                    camera.width, 2 * camera.height),
        "calibrate at the resolution of the recording, or name the calibration with --session.calibration");
  }
  const double aspect = static_cast<double>(video.width) / video.height;
  if (aspect >= 2) return Layout::side_by_side;
  if (aspect < 1) return Layout::top_bottom;
  throw InputError(file,
                   fmt::format("{}x{} px: it cannot be told whether two images lie beside or above each other",
                               video.width, video.height),
                   "add image_width and image_height (of one image) to the calibration");
}

class VideoSession : public Session {
 public:
  VideoSession(const fs::path& folder, const fs::path& left, const fs::path& right,
               const StereoCalibration& calibration, const SessionOptions& options)
      : left_(std::make_unique<VideoStream>(left)) {
    folder_ = folder;
    identity_ = "video " + file_text(left);
    calibration_ = calibration;
    note_unit(calibration_, notes_);
    int count = left_->count();
    if (!right.empty()) {
      right_ = std::make_unique<VideoStream>(right);
      count = std::min(count, right_->count());
      if (left_->count() != right_->count()) {
        notes_.push_back(fmt::format("{} has {} frames, {} has {}: the last {} of the longer one are not used",
                                     left.filename().string(), left_->count(), right.filename().string(),
                                     right_->count(), std::abs(left_->count() - right_->count())));
      }
      if (std::abs(left_->fps() - right_->fps()) > 0.01) {
        throw InputError(right, fmt::format("has {} frames a second, the left video {}", right_->fps(), left_->fps()),
                         "both cameras must record at the same rate");
      }
    }
    for (const VideoStream* stream : {left_.get(), right_.get()}) {
      if (stream && stream->announced() > stream->count()) {
        notes_.push_back(fmt::format("{} says it has {} frames but only {} can be decoded: the recording was cut off",
                                     stream->file().filename().string(), stream->announced(), stream->count()));
      }
    }
    selected_ = selected_frames(count, options, folder);
    rate_ = options.rate > 0 ? options.rate : left_->fps();
    if (!(rate_ > 0) || !std::isfinite(rate_)) {
      rate_ = 10;
      has_stamps_ = false;
      notes_.push_back("the video does not say its rate; 10 frames a second are assumed (session.rate)");
    }
    const cv::Mat image = left_->frame(selected_.front());
    if (right_) {
      fit_to_images(calibration_, image.size(), right_->frame(selected_.front()).size(), left);
      return;
    }
    layout_ = layout_of(image.size(), calibration_.left, left);
    const auto [first, second] = halves(image);
    fit_to_images(calibration_, first.size(), second.size(), left);
  }

  std::string kind() const override {
    if (layout_ == Layout::two_files) return "two videos";
    return layout_ == Layout::side_by_side ? "side-by-side video" : "top-bottom video";
  }
  int size() const override { return static_cast<int>(selected_.size()); }
  int64_t stamp_ns(int frame_idx) const override {
    return std::llround(selected_.at(static_cast<size_t>(frame_idx)) * 1e9 / rate_);
  }
  bool random_access() const override { return false; }
  std::string frame_name(int frame_idx) const override {
    return fmt::format("{} frame {}", left_->file().filename().string(), selected_.at(static_cast<size_t>(frame_idx)));
  }

  StereoFrame read(int frame_idx) const override {
    const std::lock_guard lock(mutex_);
    const int index = selected_.at(static_cast<size_t>(frame_idx));
    StereoFrame frame;
    frame.frame_idx = frame_idx;
    frame.stamp_ns = stamp_ns(frame_idx);
    frame.left = left_->frame(index);
    if (right_) {
      frame.right = right_->frame(index);
    } else {
      std::tie(frame.left, frame.right) = halves(frame.left);
    }
    check_size(frame.left, calibration_.left, left_->file());
    check_size(frame.right, calibration_.right, (right_ ? right_ : left_)->file());
    return frame;
  }

  std::string fingerprint_text() const override {
    std::string text;
    for (const VideoStream* stream : {left_.get(), right_.get()}) {
      if (stream) text += file_text(stream->file()) + "\n";
    }
    for (int i = 0; i < size(); ++i) text += fmt::format("{} {}\n", selected_[static_cast<size_t>(i)], stamp_ns(i));
    return fingerprint_of(kind(), text, calibration_);
  }

 private:
  std::pair<cv::Mat, cv::Mat> halves(const cv::Mat& image) const {
    if (layout_ == Layout::side_by_side) {
      const int width = image.cols / 2;
      return {image.colRange(0, width).clone(), image.colRange(width, 2 * width).clone()};
    }
    const int height = image.rows / 2;
    return {image.rowRange(0, height).clone(), image.rowRange(height, 2 * height).clone()};
  }

  mutable std::mutex mutex_;  // decoding goes on from frame to frame
  std::unique_ptr<VideoStream> left_, right_;
  Layout layout_ = Layout::two_files;
  std::vector<int> selected_;
  double rate_ = 0;  // [Hz]
};

}  // namespace

bool is_video_file(const fs::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  static constexpr std::string_view kExtensions[] = {".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm", ".mpg", ".mpeg"};
  return !path.filename().string().starts_with('.') &&
         std::find(std::begin(kExtensions), std::end(kExtensions), extension) != std::end(kExtensions);
}

std::unique_ptr<Session> open_videos(const fs::path& folder, const fs::path& left, const fs::path& right,
                                     const StereoCalibration& calibration, const SessionOptions& options) {
  return std::make_unique<VideoSession>(folder, left, right, calibration, options);
}

}  // namespace iris::session
