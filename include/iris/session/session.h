// Recorded stereo input behind one interface. What a folder holds is found by looking at it.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "iris/core/options.h"
#include "iris/geometry/stereo_calibration.h"
#include "iris/types/stereo_frame.h"

namespace iris::session {

struct SessionOptions {
  std::string calibration;    // path of the calibration (file or folder); empty = found with the recording
  std::string pair = "auto";  // KITTI recordings with two pairs: grey (image_0, image_1) or colour (image_2, image_3)
  double max_stamp_difference = 0;  // [s] of left and right image of one frame; 0 = half a frame period
  double rate = 0;                  // [Hz] of recordings without time stamps; 0 = 10 Hz, videos: what they say
  int first = 0;                    // frames skipped at the beginning
  int stride = 1;                   // every n-th frame is used
  int max_frames = 0;               // at most so many frames; 0 = all
  bool needs_calibration = true;    // not an option of users: false for calibrating itself; only sizes are then known

  void declare(OptionSet& set);
};

// A recording: frames 0 .. size() - 1 in the order of time.
class Session {
 public:
  virtual ~Session() = default;

  // "EuRoC/ASL", "KITTI odometry", "image folders", "image files", "two videos", "side-by-side video", "top-bottom
  // video".
  virtual std::string kind() const = 0;

  // Number of paired frames, after first, stride and max_frames.
  virtual int size() const = 0;

  // Time of the left image [ns], strictly ascending.
  virtual int64_t stamp_ns(int frame_idx) const = 0;

  // False: nothing says when the frames were recorded, and those times follow from an assumed rate.
  bool has_stamps() const { return has_stamps_; }

  // For people: the left image's file name; of videos the file's name and the frame's number in it.
  virtual std::string frame_name(int frame_idx) const = 0;

  // The frame as 8-bit grey or BGR images of the calibration's size. May be called from many threads. Throws InputError
  // that names the file if an image is missing, damaged or cut off, or has another size.
  virtual StereoFrame read(int frame_idx) const = 0;

  // False for videos: frames are then read fast only in ascending order (any other order gives the same images,
  // slowly).
  virtual bool random_access() const = 0;

  // Identifies the input wherever it lies: names, sizes and stamps of the files, and the calibration's values.
  virtual std::string fingerprint_text() const = 0;

  // Tells recordings apart whatever the options and the calibration: kind, name and size of the first recorded file.
  const std::string& identity() const { return identity_; }

  const StereoCalibration& calibration() const { return calibration_; }
  const std::filesystem::path& folder() const { return folder_; }  // or the video file

  // For people: what was assumed, what was dropped and why.
  const std::vector<std::string>& notes() const { return notes_; }

 protected:
  StereoCalibration calibration_;
  std::filesystem::path folder_;
  std::vector<std::string> notes_;
  std::string identity_;
  bool has_stamps_ = true;
};

// Opens a recording; the first frame that can be read is compared with the calibration (of images; of videos the first
// one). Understood are
//   * EuRoC/ASL: mav0/cam0/data, mav0/cam1/data (or without mav0);
//   * KITTI odometry: image_0 and image_1 (grey) or image_2 and image_3 (colour), calib.txt, times.txt if there;
//   * a pair of image folders: left/right, cam0/cam1, image_left/image_right, image_l/image_r … (or their data
//   folders),
//     with a calibration beside them;
//   * image files with left and right in their names, with a calibration beside them;
//   * two videos (left.mp4, right.mp4, cam0/cam1 …) or one side-by-side or top-bottom video (left or upper half = left
//   camera).
// Throws InputError with what was looked for. Also sets OpenCV's own messages to silent unless OPENCV_LOG_LEVEL is set:
// what they say comes as an error of this library.
std::unique_ptr<Session> open_session(const std::filesystem::path& folder_or_video, const SessionOptions& options);

}  // namespace iris::session
