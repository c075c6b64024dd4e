// Where the surroundings of a point lie in another image, to a fraction of a pixel (Lucas and Kanade's method).
#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>

namespace iris::motion {

constexpr int kTrackWindow = 15;      // [px] side of the square that is compared
constexpr float kSameSurface = 0.8f;  // [px] disparities that differ by more belong to different surfaces

// The plane in space that the surroundings of a point belong to, by its disparities. What differs from it, because it
// lies before or behind, is not compared.
struct TrackedSurface {
  const cv::Mat1f* disparity = nullptr;             // [px] of `from`, 0 = none; null: everything is compared
  double at_point = 0;                              // [px] of the plane at the point
  Eigen::Vector2d slope = Eigen::Vector2d::Zero();  // [px/px] of the plane
};

struct PatchTrack {
  bool found = false;
  Eigen::Vector2d position = Eigen::Vector2d::Zero();  // [px] in `to`
  double similarity = 0;                               // correlation coefficient of the two squares, -1 to 1
  // [px^2] of the position, if what remains of the difference is independent noise of the pixels.
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();
};

// The position in `to`, near `start`, whose surroundings differ least from those of `at` in `from` but for brightness
// and contrast. to_from_from: the homography from small differences of position in `from` to those in `to`; it leaves
// (0, 0) where it is. Not found: the square leaves an image, is too flat, too little of it belongs to the surface, the
// position does not come to rest within 20 steps or moves away by more than half a square. Sums are of integers, so
// that the result is the same on every machine.
// blur: the direction in `to` along which one image may be blurred more than the other, by motion (its length does not
// matter); what that changes is estimated together with the position. Texture that is not symmetric, such as stripes of
// different widths, seems to move otherwise. Zero: both are equally sharp.
PatchTrack track_patch(const cv::Mat1b& from, const Eigen::Vector2d& at, const cv::Mat1b& to,
                       const Eigen::Vector2d& start, const Eigen::Matrix3d& to_from_from,
                       const TrackedSurface& surface = {}, const Eigen::Vector2d& blur = Eigen::Vector2d::Zero());
// Turned and scaled, but not in perspective.
PatchTrack track_patch(const cv::Mat1b& from, const Eigen::Vector2d& at, const cv::Mat1b& to,
                       const Eigen::Vector2d& start, const Eigen::Matrix2d& to_from_from);

// The same for a position that is known to lie in the row of `start`.
PatchTrack track_along_row(const cv::Mat1b& from, const Eigen::Vector2d& at, const cv::Mat1b& to,
                           const Eigen::Vector2d& start, const Eigen::Matrix3d& to_from_from,
                           const TrackedSurface& surface = {}, const Eigen::Vector2d& blur = Eigen::Vector2d::Zero());

}  // namespace iris::motion
