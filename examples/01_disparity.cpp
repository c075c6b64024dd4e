// Disparities of one rectified pair of images: example_01_disparity LEFT RIGHT PICTURE.png
#include <cstdio>
#include <opencv2/imgcodecs.hpp>

#include "iris/stereo/disparity_picture.h"
#include "iris/stereo/mwmf.h"

int main(int argc, char** argv) {
  if (argc != 4) {
    std::fprintf(stderr, "usage: %s LEFT RIGHT PICTURE.png\n", argv[0]);
    return 2;
  }
  const cv::Mat1b left = cv::imread(argv[1], cv::IMREAD_GRAYSCALE), right = cv::imread(argv[2], cv::IMREAD_GRAYSCALE);
  if (left.empty() || left.size() != right.size()) {
    std::fprintf(stderr, "two readable images of the same size are needed\n");
    return 3;
  }
  iris::stereo::MwmfOptions options;
  options.disparities = 64;
  const iris::DisparityImage image = iris::stereo::mwmf(left, right, options);
  cv::imwrite(argv[3], iris::stereo::disparity_picture(image.disparity, options.disparities));
}
