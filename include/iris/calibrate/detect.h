// Finds the corners of a calibration target in an image, to parts of a pixel.
#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "iris/calibrate/target.h"

namespace iris::calibrate {

// Corners seen in one image: their numbers (target.h), ascending, and where they are [px].
struct Corners {
  std::vector<int> ids;
  std::vector<Eigen::Vector2d> points;
  bool empty() const { return ids.empty(); }
  size_t size() const { return ids.size(); }
};

struct Detection {
  Corners corners;  // empty if the target was not found
  double blur = 0;  // [px] over which the target's borders rise from black to white, in the worse of both directions
  std::string problem;  // why it was not found, where that can be said: "a grid of 8 x 5 squares"
};

// Grey image. Squares are localised as in the thesis (2.3, figure 2.3): straight lines are fitted to the edge points of
// half of each side, without the pixels next to the corner, because lens distortion bends whole sides; the corner is
// their intersection. Chessboards: cv::findChessboardCorners and cornerSubPix; markers: cv::aruco. The corners of
// squares and chessboards are numbered so that columns run to the right in the image, or as near to it as the sheet
// allows.
Detection find_target(const cv::Mat1b& image, const Target& target);

// Intersections of lines through the half sides of a dark square whose corners are known roughly (clockwise, to about
// 2 px); false if a side cannot be measured. For find_target.
bool refine_square(const cv::Mat1b& image, std::vector<Eigen::Vector2d>& corners);

// Throws UsageError that lists the dictionaries if the target's is unknown.
void require_dictionary(const Target& target);

// What could be wrong with an image in which find_target found nothing: another count of corners, a mirrored image.
// Takes long. Empty if nothing was found out.
std::string explain_missing(const cv::Mat1b& image, const Target& target);

// Renumbers the right image's corners so that the sheet is turned like in the left one, where the target looks the same
// in several ways. The cameras must not be rolled against each other by more than 45 degrees.
void match_orientation(const Target& target, const Corners& left, Corners& right);

}  // namespace iris::calibrate
