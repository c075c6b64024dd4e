#include "interpolation.h"

#include <algorithm>
#include <array>
#include <limits>
#include <vector>

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
float smallest(const std::array<Neighbour, 4>& neighbours, bool second) {
  float first = std::numeric_limits<float>::infinity(), next = first;
  for (const Neighbour& neighbour : neighbours) {
    if (neighbour.distance == 0) continue;
    next = std::min(next, std::max(first, neighbour.disparity));
    first = std::min(first, neighbour.disparity);
  }
  return second && next < std::numeric_limits<float>::infinity() ? next : first;
}

// Whether the gap between two neighbours in a row is the strip of background that an object at the right hides from the
// right camera: as wide as the step of disparity, with some tolerance for the pixels that windows lose on either side.
bool hidden(const Neighbour& left, const Neighbour& right) {
  constexpr float kTolerance = 2;  // [px]
  if (left.distance == 0 || right.distance == 0 || left.segment == right.segment) return false;
  const float step = right.disparity - left.disparity;
  return step > 0 && static_cast<float>(left.distance + right.distance - 1) <= step + kTolerance;
}

}  // namespace

DisparityImage interpolate(const cv::Mat1f& disparity, const cv::Mat1b& corrected, const Segments& segments,
                           const InterpolationParameters& parameters) {
  const Interpolation mode = parameters.mode;
  const cv::Mat1i& label = segments.label;
  DisparityImage out;
  out.disparity = disparity.clone();
  out.origin.create(disparity.size());
  // Rows of the nearest valid pixels above and below, -1 = none.
  cv::Mat1i above(disparity.size()), below(disparity.size());
  if (mode != Interpolation::off) {
    parallel_chunks(0, disparity.cols, kColumnsPerChunk, [&](int x0, int x1) {
      std::vector<int> last(x1 - x0, -1);
      for (int y = 0; y < disparity.rows; ++y) {
        for (int x = x0; x < x1; ++x) {
          last[x - x0] = label(y, x) >= 0 ? y : last[x - x0];
          above(y, x) = last[x - x0];
        }
      }
      std::fill(last.begin(), last.end(), -1);
      for (int y = disparity.rows - 1; y >= 0; --y) {
        for (int x = x0; x < x1; ++x) {
          last[x - x0] = label(y, x) >= 0 ? y : last[x - x0];
          below(y, x) = last[x - x0];
        }
      }
    });
  }
  const auto neighbour = [&](int y, int x, int distance) { return Neighbour{disparity(y, x), label(y, x), distance}; };
  const auto fill = [&](int y, int x, const Neighbour& left, const Neighbour& right) {
    const int up = above(y, x), down = below(y, x);
    const Neighbour top = up < 0 ? Neighbour{} : neighbour(up, x, y - up);
    const Neighbour bottom = down < 0 ? Neighbour{} : neighbour(down, x, down - y);
    const bool in_row = left.distance > 0 || right.distance > 0;
    const bool in_column = up >= 0 || down >= 0;
    if (!in_row && !in_column) return;
    const bool within = left.segment >= 0 && left.segment == right.segment && left.segment == top.segment &&
                        left.segment == bottom.segment;
    if (!within && mode != Interpolation::everywhere) return;
    float value;
    if (!in_row) {
      value = along_line(top, bottom).disparity;
    } else if (!in_column || (parameters.left_from_right && left.distance == 0)) {
      value = along_line(left, right).disparity;
    } else if (parameters.hidden_strips && hidden(left, right)) {
      value = left.disparity;
    } else {
      const Estimate row = along_line(left, right), column = along_line(top, bottom);
      value = row.segment == column.segment ? 0.5f * (row.disparity + column.disparity)
                                            : smallest({left, right, top, bottom}, parameters.second_smallest);
    }
    out.disparity(y, x) = value;
    out.origin(y, x) =
        static_cast<uint8_t>(within ? DisparityOrigin::within_segment : DisparityOrigin::between_segments);
  };
  parallel_chunks(0, disparity.rows, kRowsPerChunk, [&](int y0, int y1) {
    for (int y = y0; y < y1; ++y) {
      for (int x = 0; x < disparity.cols; ++x) {
        const bool moved = !corrected.empty() && corrected(y, x) != 0;
        out.origin(y, x) = static_cast<uint8_t>(label(y, x) < 0 ? DisparityOrigin::none
                                                : moved         ? DisparityOrigin::corrected
                                                                : DisparityOrigin::measured);
      }
      if (mode == Interpolation::off) continue;
      for (int x = 0; x < disparity.cols;) {
        if (label(y, x) >= 0) {
          ++x;
          continue;
        }
        const int begin = x;
        while (x < disparity.cols && label(y, x) < 0) ++x;
        for (int i = begin; i < x; ++i) {
          const Neighbour left = begin == 0 ? Neighbour{} : neighbour(y, begin - 1, i - begin + 1);
          const Neighbour right = x == disparity.cols ? Neighbour{} : neighbour(y, x, x - i);
          fill(y, i, left, right);
        }
      }
    }
  });
  return out;
}

}  // namespace iris::stereo
