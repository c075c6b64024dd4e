// Border correction (thesis 3.4.4): moves the left and right borders of objects to where the images say that they are.
#pragma once

#include <opencv2/core.hpp>

namespace iris::stereo {

// How the place of a border is judged. Both let the border wander and compare, over a few rows, how well the pixels on
// either side are explained by the disparity of the object and by that of the background.
enum class BorderCriterion {
  halves,   // as in the thesis: where the two halves of a window that moves along with the border fit equally well
  support,  // where the sum over a fixed support is lowest, each pixel explained by its side alone
};

struct BorderParameters {
  BorderCriterion criterion = BorderCriterion::support;
  int min_step = 2;  // [px] smaller steps of disparity are no borders; >= 1
  int reach = 4;     // [px] by how much a border may be moved; half of a correlation window
  int rows = 3;      // height of what is compared, odd, <= 127
  int cap = 10;      // [grey levels] most that one pixel's difference counts
};

// Corrects disparities [px], 0 = none: pixels that a border has passed get the disparity of their new side, those that
// were invalid as well; all others stay as they are. `left` and `right` are the images as they are compared.
// `corrected`: 255 where a disparity has changed, else 0.
//
// A border is a step between horizontal neighbours; for finding it, invalid pixels take the lower of the valid
// disparities to their left and right. At a right border of an object both sides are adjacent in the left image. At a
// left border a strip of the background is hidden from the right camera: both sides are adjacent in the right image,
// and that is where they are compared.
void correct_borders(const cv::Mat1b& left, const cv::Mat1b& right, const BorderParameters& parameters,
                     cv::Mat1f& disparity, cv::Mat1b& corrected);

}  // namespace iris::stereo
