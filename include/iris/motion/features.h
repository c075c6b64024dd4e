// What motion estimation keeps of a view: corners with their points in space and their surroundings (thesis 5.3.1).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <opencv2/core.hpp>
#include <vector>

#include "iris/geometry/rectified_camera.h"
#include "iris/motion/scs_options.h"
#include "iris/types/disparity_image.h"

namespace iris::motion {

// The surroundings of a corner, Rank transformed (or, with motion.compare = sad, after a Laplacian of Gaussian): 17x17
// values row by row, then zeros up to a multiple of 16 bytes.
constexpr int kPatchSize = 17;   // [px] window of the comparison
constexpr int kRankWindow = 11;  // [px] window of the Rank transform
using RankPatch = std::array<uint8_t, 304>;

struct Corner {
  double x = 0, y = 0;                                     // [px] sub-pixel position in the left image
  double disparity = 0;                                    // [px] as measured, at that position
  Eigen::Vector3d point_in_cam = Eigen::Vector3d::Zero();  // [m]
  float strength = 0;                                      // Harris response
  Eigen::Vector2d slope = Eigen::Vector2d::Zero();         // of the disparity around the corner [px/px]
  bool alone = false;                                      // what lies around belongs to that plane
  double disparity_error = 0;                              // [px] standard deviation; 0 = not known
};

struct ViewFeatures {
  cv::Mat1b image;  // left rectified image
  cv::Mat1b right;  // right rectified image; may be empty
  DisparityImage disparity;
  std::vector<Corner> corners;     // only those with a usable disparity
  std::vector<RankPatch> patches;  // one a corner
};

// Corners of a view that motion can use. With the right image their disparities are measured once more
// (measure_disparities). Two calls with equal input give equal output, bit by bit.
ViewFeatures extract_features(const cv::Mat1b& left_image, const DisparityImage& disparity,
                              const RectifiedCamera& camera, const ScsOptions& options,
                              const cv::Mat1b& right_image = {});

// Disparity at a sub-pixel position: 0 unless all pixels within 1 px of the nearest one carry a measured disparity and
// the result is at least options.min_disparity; interpolated where the surface is continuous, else the nearest pixel's.
double usable_disparity(const DisparityImage& disparity, double x, double y, const RectifiedCamera& camera,
                        const ScsOptions& options);

// Harris response det(M) - 0.04 trace(M)^2 [(grey levels/px)^4] of the structure tensor weighted with a Gaussian of 2
// px over 11x11 px; 0 within 6 px of the image's edge. The same bits on every machine.
cv::Mat1f harris_response(const cv::Mat1b& image);

// The Rank transform (number of pixels of the 11x11 window that are darker than its centre) in the 17x17 pixels around
// (x, y), which must be at least 13 px inside the image.
RankPatch rank_patch(const cv::Mat1b& image, int x, int y);

// The 17x17 grey values around (x, y).
RankPatch grey_patch(const cv::Mat1b& image, int x, int y);

// Laplacian of a Gaussian of 1 px, times 8, around the value 128: what grey patches are taken from.
cv::Mat1b laplacian_of_gaussian(const cv::Mat1b& image);

}  // namespace iris::motion
