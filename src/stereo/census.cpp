#include "census.h"

#include <algorithm>
#include <bit>
#include <vector>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "../src/stereo/census.cpp"  // seen from include/
#include <hwy/foreach_target.h>                        // IWYU pragma: keep
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace iris::stereo::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// rows: five rows, starting two pixels to the left of the first one. Rows and planes have room for a vector behind.
void census_row(const uint8_t* const* rows, int width, uint8_t* const* planes) {
  const hn::ScalableTag<uint8_t> d8;
  for (int x = 0; x < width; x += static_cast<int>(hn::Lanes(d8))) {
    const auto centre = hn::LoadU(d8, rows[2] + x + 2);
    for (int plane = 0; plane < 3; ++plane) {
      auto bits = hn::Zero(d8);
      for (int bit = 0; bit < 8; ++bit) {
        const int k = 8 * plane + bit, at = k < 12 ? k : k + 1;
        const auto other = hn::LoadU(d8, rows[at / 5] + x + at % 5);
        bits = hn::Or(bits, hn::IfThenElseZero(hn::Lt(other, centre), hn::Set(d8, static_cast<uint8_t>(1 << bit))));
      }
      hn::StoreU(bits, d8, planes[plane] + x);
    }
  }
}

}  // namespace iris::stereo::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace iris::stereo {

HWY_EXPORT(census_row);

Census census_transform(const cv::Mat1b& image) {
  IRIS_CHECK(!image.empty());
  constexpr int kRowsPerChunk = 32;
  constexpr int kSlack = 256;  // a vector may reach beyond the end of a row
  Census census;
  for (cv::Mat1b& plane : census) plane.create(image.size());
  parallel_chunks(0, image.rows, kRowsPerChunk, [&](int y0, int y1) {
    const int stride = image.cols + 4 + kSlack;
    std::vector<uint8_t> padded(static_cast<size_t>(stride) * (y1 - y0 + 4));
    for (int i = 0; i < y1 - y0 + 4; ++i) {
      const uint8_t* row = image[std::clamp(y0 + i - 2, 0, image.rows - 1)];
      uint8_t* to = &padded[static_cast<size_t>(stride) * i];
      std::fill_n(to, 2, row[0]);
      std::copy_n(row, image.cols, to + 2);
      std::fill_n(to + image.cols + 2, 2, row[image.cols - 1]);
    }
    std::vector<uint8_t> bytes(3 * static_cast<size_t>(stride));
    uint8_t* const planes[3] = {&bytes[0], &bytes[stride], &bytes[2 * static_cast<size_t>(stride)]};
    for (int y = y0; y < y1; ++y) {
      const uint8_t* rows[5];
      for (int i = 0; i < 5; ++i) rows[i] = &padded[static_cast<size_t>(stride) * (y - y0 + i)];
      HWY_DYNAMIC_DISPATCH(census_row)(rows, image.cols, planes);
      for (int i = 0; i < 3; ++i) std::copy_n(planes[i], image.cols, census[i][y]);
    }
  });
  return census;
}

cv::Mat1b rank_transform(const Census& census) {
  cv::Mat1b rank(census[0].size());
  for (int y = 0; y < rank.rows; ++y) {
    for (int x = 0; x < rank.cols; ++x) {
      int darker = 0;
      for (const cv::Mat1b& plane : census) darker += std::popcount(static_cast<unsigned>(plane(y, x)));
      rank(y, x) = static_cast<uint8_t>(darker);
    }
  }
  return rank;
}

}  // namespace iris::stereo
#endif  // HWY_ONCE
