// Disparities, depths and points as bytes of files for other programs.
#pragma once

#include <opencv2/core.hpp>
#include <string>

#include "iris/geometry/rectified_camera.h"
#include "iris/types/disparity_image.h"

namespace iris::stereo {

// PNG code of disparities as KITTI has it: 16 bit, disparity x 256 rounded, 0 = none. Requires disparities below
// 255.99 px (65535 / 256).
cv::Mat1w kitti_code(const cv::Mat1f& disparity);

// Portable float map: "Pf", little endian, lowest row first. Values <= 0 (none) become infinite, as in the Middlebury
// data sets.
std::string encode_pfm(const cv::Mat1f& image);

// Depth z [m] of each pixel; 0 = no disparity, or not in front of the camera.
cv::Mat1f depth_image(const cv::Mat1f& disparity, const RectifiedCamera& camera);

// Binary PLY of the points whose origin is not beyond `up_to`: float x y z [m] in the left camera's frame (x right,
// y down, z forward), uchar red green blue. `colour` is BGR.
std::string encode_ply(const DisparityImage& image, const cv::Mat3b& colour, const RectifiedCamera& camera,
                       DisparityOrigin up_to);

}  // namespace iris::stereo
