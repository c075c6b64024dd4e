#include "interpolation.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <vector>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

namespace iris::stereo {
namespace {

constexpr int kRowsPerChunk = 32;
constexpr int kColumnsPerChunk = 128;

// A valid pixel next to an invalid one; distance 0 = there is none.
struct Neighbour {
  float disparity = 0;
  int segment = -1;
  int distance = 0;
};

struct Estimate {
  float disparity;
  int segment;
};

// (3.5) and (3.6): along one line, between two neighbours, of which at least one exists.
Estimate along_line(const Neighbour& a, const Neighbour& b) {
  if (a.distance == 0) return {b.disparity, b.segment};
  if (b.distance == 0) return {a.disparity, a.segment};
  if (a.segment == b.segment) {
    const float t = static_cast<float>(a.distance) / static_cast<float>(a.distance + b.distance);
    return {a.disparity + t * (b.disparity - a.disparity), a.segment};
  }
  return a.disparity <= b.disparity ? Estimate{a.disparity, a.segment} : Estimate{b.disparity, b.segment};
}

// The smallest disparity or, if there are two, the second smallest.
Estimate smallest(const std::array<Neighbour, 4>& neighbours, bool second) {
  constexpr Estimate kNone = {std::numeric_limits<float>::infinity(), -1};
  Estimate first = kNone, next = kNone;
  for (const Neighbour& neighbour : neighbours) {
    if (neighbour.distance == 0) continue;
    const Estimate estimate = {neighbour.disparity, neighbour.segment};
    if (estimate.disparity < first.disparity) {
      next = first;
      first = estimate;
    } else if (estimate.disparity < next.disparity) {
      next = estimate;
    }
  }
  return second && next.segment >= 0 ? next : first;
}

// Whether the gap between two neighbours in a row is the strip of background that an object at the right hides from the
// right camera: as wide as the step of disparity, and wider by what windows lose on either side of it, half of their
// width each. Within a segment, whose disparities grow step by step around the strip, a slanting surface could look the
// same: there the step must be at least half as large as the gap.
bool hidden(const Neighbour& left, const Neighbour& right) {
  constexpr float kSlack = 6, kStepWithin = 2;  // [px]
  if (left.distance == 0 || right.distance == 0) return false;
  const float step = right.disparity - left.disparity, gap = static_cast<float>(left.distance + right.distance - 1);
  if (left.segment != right.segment) return step > 0 && gap <= step + kSlack;
  return step > kStepWithin && gap <= step + std::min(kSlack, step);
}

// Of valid pixels; none elsewhere. In a form that compilers turn into vectors.
void set_origins(const int* __restrict label, const uint8_t* __restrict corrected, int width,
                 uint8_t* __restrict origin) {
  constexpr auto kMeasured = static_cast<uint8_t>(DisparityOrigin::measured);
  constexpr auto kCorrected = static_cast<uint8_t>(DisparityOrigin::corrected);
  for (int x = 0; x < width; ++x) {
    const uint8_t valid = corrected[x] != 0 ? kCorrected : kMeasured;
    origin[x] = label[x] < 0 ? static_cast<uint8_t>(DisparityOrigin::none) : valid;
  }
}

}  // namespace

DisparityImage interpolate(const cv::Mat1f& disparity, const cv::Mat1b& corrected, const Segments& segments,
                           const InterpolationParameters& parameters, cv::Mat1i* source) {
  const Interpolation mode = parameters.mode;
  const int width = disparity.cols, height = disparity.rows;
  IRIS_CHECK(height <= std::numeric_limits<int16_t>::max());
  const cv::Mat1i& label = segments.label;
  DisparityImage out;
  out.disparity = disparity.clone();
  out.origin.create(disparity.size());
  if (source != nullptr) *source = cv::Mat1i(disparity.size(), -1);
  // Rows of the nearest valid pixels above and below, -1 = none.
  cv::Mat1s above, below;
  if (mode != Interpolation::off) {
    above.create(disparity.size());
    below.create(disparity.size());
    parallel_chunks(0, width, kColumnsPerChunk, [&](int x0, int x1) {
      std::array<int16_t, kColumnsPerChunk> last;
      const auto pass = [&](int y, int16_t* nearest) {
        const int* const of_row = label[y] + x0;
        for (int i = 0; i < x1 - x0; ++i) last[i] = of_row[i] >= 0 ? static_cast<int16_t>(y) : last[i];
        std::copy_n(last.begin(), x1 - x0, nearest + x0);
      };
      last.fill(-1);
      for (int y = 0; y < height; ++y) pass(y, above[y]);
      last.fill(-1);
      for (int y = height - 1; y >= 0; --y) pass(y, below[y]);
    });
  }
  const auto neighbour = [&](int y, int x, int distance) { return Neighbour{disparity[y][x], label[y][x], distance}; };
  // The pixels begin … end - 1 of a row, all invalid.
  const auto fill = [&](int y, int begin, int end) {
    const int16_t* const rows_above = above[y];
    const int16_t* const rows_below = below[y];
    float* const values = out.disparity[y];
    uint8_t* const origins = out.origin[y];
    Neighbour left = begin == 0 ? Neighbour{} : neighbour(y, begin - 1, 1);
    Neighbour right = end == width ? Neighbour{} : neighbour(y, end, end - begin);
    const bool in_row = begin > 0 || end < width;
    const bool row_alone = in_row && parameters.left_from_right && begin == 0;
    const bool strip = parameters.hidden_strips && hidden(left, right);  // depends on the sum of both distances
    for (int x = begin; x < end; ++x) {
      left.distance = begin == 0 ? 0 : x - begin + 1;
      right.distance = end == width ? 0 : end - x;
      const int up = rows_above[x], down = rows_below[x];
      const bool in_column = up >= 0 || down >= 0;
      if (!in_row && !in_column) continue;
      const Neighbour top = up < 0 ? Neighbour{} : neighbour(up, x, y - up);
      const Neighbour bottom = down < 0 ? Neighbour{} : neighbour(down, x, down - y);
      const bool within = left.segment >= 0 && left.segment == right.segment && left.segment == top.segment &&
                          left.segment == bottom.segment;
      if (!within && mode != Interpolation::everywhere) continue;
      Estimate estimate;
      if (!in_row) {
        estimate = along_line(top, bottom);
      } else if (!in_column || row_alone) {
        estimate = along_line(left, right);
      } else if (strip) {
        estimate = {left.disparity, left.segment};
      } else {
        const Estimate row = along_line(left, right), column = along_line(top, bottom);
        estimate = row.segment == column.segment ? Estimate{0.5f * (row.disparity + column.disparity), row.segment}
                                                 : smallest({left, right, top, bottom}, parameters.second_smallest);
      }
      values[x] = estimate.disparity;
      if (source != nullptr) (*source)(y, x) = estimate.segment;
      origins[x] = static_cast<uint8_t>(within ? DisparityOrigin::within_segment : DisparityOrigin::between_segments);
    }
  };
  parallel_chunks(0, height, kRowsPerChunk, [&](int y0, int y1) {
    const std::vector<uint8_t> moved(width, 0);  // if nothing was
    for (int y = y0; y < y1; ++y) {
      const int* const of_row = label[y];
      set_origins(of_row, corrected.empty() ? moved.data() : corrected[y], width, out.origin[y]);
      if (mode == Interpolation::off) continue;
      for (int x = 0; x < width;) {
        while (x < width && of_row[x] >= 0) ++x;
        const int begin = x;
        while (x < width && of_row[x] < 0) ++x;
        if (begin < x) fill(y, begin, x);
      }
    }
  });
  return out;
}

}  // namespace iris::stereo
