#include "log_filter.h"

#include <algorithm>
#include <cmath>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "../src/stereo/log_filter.cpp"  // seen from include/
#include <hwy/foreach_target.h>                            // IWYU pragma: keep
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace iris::stereo::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// The LoG is g''(x) g(y) + g(x) g''(y): columns are convolved with both kernels into `smooth` and `second`, then rows
// the other way round. rows[radius + k] is image row y + k; `smooth` and `second` have room for `radius` values on both
// sides and a vector behind. No fused multiply-add: every instruction set must give the same bits.
//
// kRadius = 0: any; compilers unroll the loops of a known one.
template <int kRadius>
HWY_INLINE void log_row_of(const uint8_t* const* rows, int width, const float* gauss, const float* laplace,
                           int any_radius, float* smooth, float* second, uint8_t* out) {
  const int radius = kRadius == 0 ? any_radius : kRadius;
  const hn::ScalableTag<float> df;
  const hn::Rebind<int32_t, decltype(df)> di;
  const hn::Rebind<uint8_t, decltype(df)> d8;
  const int lanes = static_cast<int>(hn::Lanes(df));
  const auto load = [&](const uint8_t* p) HWY_ATTR { return hn::PromoteTo(di, hn::LoadU(d8, p)); };
  for (int x = 0; x < width; x += lanes) {
    const auto centre = hn::ConvertTo(df, load(rows[radius] + x));
    auto a = hn::Mul(hn::Set(df, gauss[0]), centre);
    auto b = hn::Mul(hn::Set(df, laplace[0]), centre);
    for (int k = 1; k <= radius; ++k) {
      const auto sum = hn::ConvertTo(df, hn::Add(load(rows[radius - k] + x), load(rows[radius + k] + x)));
      a = hn::Add(a, hn::Mul(hn::Set(df, gauss[k]), sum));
      b = hn::Add(b, hn::Mul(hn::Set(df, laplace[k]), sum));
    }
    hn::StoreU(a, df, smooth + radius + x);
    hn::StoreU(b, df, second + radius + x);
  }
  for (int k = 0; k < radius; ++k) {
    smooth[k] = smooth[radius];
    second[k] = second[radius];
  }
  for (int k = 0; k < radius + lanes; ++k) {
    smooth[radius + width + k] = smooth[radius + width - 1];
    second[radius + width + k] = second[radius + width - 1];
  }
  const auto scale = hn::Set(df, static_cast<float>(kLogUnits));
  const auto offset = hn::Set(df, kLogZero + 0.5f);  // truncation then rounds
  const auto low = hn::Zero(df);
  const auto high = hn::Set(df, 255.0f);
  for (int x = 0; x < width; x += lanes) {
    const float* s = smooth + radius + x;
    const float* t = second + radius + x;
    auto sum =
        hn::Add(hn::Mul(hn::Set(df, laplace[0]), hn::LoadU(df, s)), hn::Mul(hn::Set(df, gauss[0]), hn::LoadU(df, t)));
    for (int k = 1; k <= radius; ++k) {
      const auto p = hn::Mul(hn::Set(df, laplace[k]), hn::Add(hn::LoadU(df, s - k), hn::LoadU(df, s + k)));
      const auto q = hn::Mul(hn::Set(df, gauss[k]), hn::Add(hn::LoadU(df, t - k), hn::LoadU(df, t + k)));
      sum = hn::Add(sum, hn::Add(p, q));
    }
    const auto value = hn::Min(hn::Max(hn::Add(hn::Mul(sum, scale), offset), low), high);
    hn::StoreU(hn::DemoteTo(d8, hn::ConvertTo(di, value)), d8, out + x);
  }
}

void log_row(const uint8_t* const* rows, int width, const float* gauss, const float* laplace, int radius, float* smooth,
             float* second, uint8_t* out) {
  if (radius == 4) {  // of sigma 1
    log_row_of<4>(rows, width, gauss, laplace, radius, smooth, second, out);
  } else {
    log_row_of<0>(rows, width, gauss, laplace, radius, smooth, second, out);
  }
}

}  // namespace iris::stereo::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace iris::stereo {

HWY_EXPORT(log_row);

LogKernel log_kernel(double sigma) {
  const int radius = std::max(1, static_cast<int>(std::ceil(4 * sigma)));
  std::vector<double> gauss(radius + 1), second(radius + 1);
  double gauss_sum = 0, second_sum = 0;
  for (int k = 0; k <= radius; ++k) {
    const double weight = k == 0 ? 1 : 2;
    gauss[k] = std::exp(-0.5 * k * k / (sigma * sigma));
    gauss_sum += weight * gauss[k];
  }
  for (int k = 0; k <= radius; ++k) {
    gauss[k] /= gauss_sum;
    second[k] = (k * k / (sigma * sigma) - 1) / (sigma * sigma) * gauss[k];
    second_sum += (k == 0 ? 1 : 2) * second[k];
  }
  LogKernel kernel;
  for (int k = 0; k <= radius; ++k) {
    kernel.gauss.push_back(static_cast<float>(gauss[k]));
    kernel.second.push_back(static_cast<float>(second[k] - second_sum * gauss[k]));  // a flat image gives exactly 0
  }
  return kernel;
}

cv::Mat1b log_filter(const cv::Mat1b& image, double sigma) {
  IRIS_CHECK(sigma > 0 && !image.empty());
  constexpr int kSlack = 64;  // a vector may reach beyond the end of a row
  constexpr int kRowsPerChunk = 32;
  const LogKernel kernel = log_kernel(sigma);
  const int radius = static_cast<int>(kernel.gauss.size()) - 1;
  const int width = image.cols;
  cv::Mat1b out(image.size());
  parallel_chunks(0, image.rows, kRowsPerChunk, [&](int y0, int y1) {
    const int stride = width + kSlack;
    const int rows_needed = y1 - y0 + 2 * radius;
    std::vector<uint8_t> padded(static_cast<size_t>(stride) * rows_needed);
    for (int i = 0; i < rows_needed; ++i) {
      const uint8_t* row = image[std::clamp(y0 - radius + i, 0, image.rows - 1)];
      std::copy(row, row + width, &padded[static_cast<size_t>(stride) * i]);
    }
    std::vector<float> smooth(width + 2 * radius + 2 * kSlack), second(smooth.size());
    std::vector<const uint8_t*> rows(2 * radius + 1);
    std::vector<uint8_t> result(stride);
    for (int y = y0; y < y1; ++y) {
      for (int k = 0; k <= 2 * radius; ++k) rows[k] = &padded[static_cast<size_t>(stride) * (y - y0 + k)];
      HWY_DYNAMIC_DISPATCH(log_row)
      (rows.data(), width, kernel.gauss.data(), kernel.second.data(), radius, smooth.data(), second.data(),
       result.data());
      std::copy(result.begin(), result.begin() + width, out[y]);
    }
  });
  return out;
}

}  // namespace iris::stereo
#endif  // HWY_ONCE
