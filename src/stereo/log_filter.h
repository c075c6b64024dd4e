// Laplacian of Gaussian, quantised to eight bits for integer correlation.
#pragma once

#include <cstdint>
#include <opencv2/core.hpp>
#include <vector>

namespace iris::stereo {

inline constexpr int kLogUnits = 8;   // units of the filtered image per grey level of the response
inline constexpr int kLogZero = 128;  // value of response 0

// Convolution with the Laplacian of a Gaussian of `sigma` > 0 [px] (thesis 3.4.1): 128 + 8 * response, rounded and
// limited to [0, 255]. The image continues with its border pixels. The response is that of the kernel (x^2 + y^2 - 2
// sigma^2) / sigma^4 * Gaussian: a grating of frequency w [rad/px] and amplitude A gives -w^2 exp(-sigma^2 w^2 / 2) A.
cv::Mat1b log_filter(const cv::Mat1b& image, double sigma);

// One half (index = distance from the centre) of the sampled Gaussian and of its second derivative; the whole kernels
// sum to 1 and to 0.
struct LogKernel {
  std::vector<float> gauss;
  std::vector<float> second;
};
LogKernel log_kernel(double sigma);

}  // namespace iris::stereo
