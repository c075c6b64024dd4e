// Where the surroundings of a point lie in another image, to a fraction of a pixel (Lucas and Kanade's method).
#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>

namespace iris::motion {

constexpr int kTrackWindow = 15;  // [px] side of the square that is compared

struct PatchTrack {
  bool found = false;
  Eigen::Vector2d position = Eigen::Vector2d::Zero();  // [px] in `to`
  double similarity = 0;                               // correlation coefficient of the two squares, -1 to 1
};

// The position in `to`, near `start`, whose surroundings differ least from those of `at` in `from` but for an offset of
// the brightness. to_from_from: how small differences of position in `from` appear in `to` (identity: neither turned
// nor scaled). Not found: the square leaves an image, is too flat, the position does not come to rest within 20 steps
// or moves away by more than half a square. Sums are of integers, so that the result is the same on every machine.
PatchTrack track_patch(const cv::Mat1b& from, const Eigen::Vector2d& at, const cv::Mat1b& to,
                       const Eigen::Vector2d& start, const Eigen::Matrix2d& to_from_from);

}  // namespace iris::motion
