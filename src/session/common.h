// What all kinds of sessions share.
#pragma once

#include <filesystem>
#include <memory>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "iris/session/session.h"

namespace iris::session {

// Indices of the frames that first, stride and max_frames leave of `count`. Throws InputError if none is left.
std::vector<int> selected_frames(int count, const SessionOptions& options, const std::filesystem::path& folder);

// Gives the calibration the recording's image size if it had none; throws InputError if it is for another size.
void fit_to_images(StereoCalibration& calibration, const cv::Size& left, const cv::Size& right,
                   const std::filesystem::path& first_image);

// Throws InputError if an image of a later frame has another size than the calibration.
void check_size(const cv::Mat& image, const CameraModel& camera, const std::filesystem::path& file);

// Notes a baseline that no rig of cameras has: lengths in millimetres or in squares of the target.
void note_unit(const StereoCalibration& calibration, std::vector<std::string>& notes);

// Notes a principal point far from the middle of the images: the calibration of other images, which files without an
// image size (KITTI) do not tell.
void note_principal_point(const StereoCalibration& calibration, std::vector<std::string>& notes);

// "<name> <size> <hash>" of a recorded file, wherever it lies. The hash covers three samples of the content:
// uncompressed images of one camera all have the same size, and reading everything twice would take as long as the
// reconstruction.
std::string file_text(const std::filesystem::path& file);

// Lines of the frames, then the calibration: what fingerprint_text returns.
std::string fingerprint_of(const std::string& kind, const std::string& frames, const StereoCalibration& calibration);

// True for the extensions of the usual video containers, if the file is not hidden.
bool is_video_file(const std::filesystem::path& path);

// One video with both images (right empty), or two. `folder` is what the session reports as its place.
std::unique_ptr<Session> open_videos(const std::filesystem::path& folder, const std::filesystem::path& left,
                                     const std::filesystem::path& right, const StereoCalibration& calibration,
                                     const SessionOptions& options);

}  // namespace iris::session
