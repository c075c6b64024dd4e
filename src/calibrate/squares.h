// The thesis's grid of dark squares in an image.
#pragma once

#include "iris/calibrate/detect.h"

namespace iris::calibrate {

Detection find_squares(const cv::Mat1b& image, const Target& target);

// Bilinear grey value; the position must lie inside the image by one pixel.
double grey_at(const cv::Mat1b& image, const Eigen::Vector2d& p);
bool inside(const cv::Mat1b& image, const Eigen::Vector2d& p, double border);

}  // namespace iris::calibrate
