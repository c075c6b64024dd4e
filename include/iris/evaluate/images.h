// How alike two pictures are: novel views against what a camera saw from the same place (thesis 7.4).
#pragma once

#include <cstdint>
#include <opencv2/core.hpp>

namespace iris::evaluate {

struct ImageErrors {
  int64_t pixels = 0;   // that were compared
  double coverage = 0;  // [%] of the pixels that are within the mask
  double mse = 0;       // mean squared difference over all channels
  double psnr = 0;      // [dB] 10 log10(255^2 / mse); infinite for equal images
  double ssim = 0;      // mean structural similarity of the grey images, in [-1, 1]
};

// 8-bit images of one size, both with 1 or both with 3 (BGR) channels. `mask`: 255 = compare this pixel; empty = all.
// SSIM (Wang et al. 2004): Gaussian window of 11 x 11 px with a deviation of 1.5 px, K1 = 0.01, K2 = 0.03, L = 255, at
// pixels whose window lies inside the image and, with a mask, inside the mask (0 if there are none).
ImageErrors compare_images(const cv::Mat& estimate, const cv::Mat& truth, const cv::Mat1b& mask);

}  // namespace iris::evaluate
