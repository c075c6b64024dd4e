#include "filters.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numeric>

#include "iris/core/parallel.h"

namespace iris::stereo {
namespace {

constexpr int kRowsPerChunk = 32;

// Compilers turn such loops into vectors: nothing that they read can change while they write, and no floating-point
// operation depends on a condition.

// valid: 1 where there is a disparity; joined: 1 where it belongs to the run of the one before it. Else 0.
void find_joints(const float* __restrict d, int width, float step, uint8_t* __restrict valid,
                 uint8_t* __restrict joined) {
  joined[0] = 0;
  for (int x = 0; x < width; ++x) valid[x] = static_cast<uint8_t>(d[x] > 0);
  for (int x = 1; x < width; ++x) joined[x] = static_cast<uint8_t>((d[x] > 0) & (std::abs(d[x] - d[x - 1]) <= step));
}

}  // namespace

Segments find_segments(const cv::Mat1f& disparity, double tolerance) {
  // Runs of connected pixels in each row are joined with those of the row above.
  struct Run {
    int begin, end;
  };
  const float step = static_cast<float>(tolerance);
  const int width = disparity.cols;
  std::vector<std::vector<Run>> runs_of_row(disparity.rows);
  parallel_chunks(0, disparity.rows, kRowsPerChunk, [&](int y0, int y1) {
    std::vector<uint8_t> valid(width), joined(width);
    const auto next = [&](const std::vector<uint8_t>& flags, int value, int x) {
      const void* const found = x < width ? std::memchr(&flags[x], value, width - x) : nullptr;
      return found == nullptr ? width : static_cast<int>(static_cast<const uint8_t*>(found) - flags.data());
    };
    for (int y = y0; y < y1; ++y) {
      find_joints(disparity[y], width, step, valid.data(), joined.data());
      for (int x = next(valid, 1, 0); x < width; x = next(valid, 1, x)) {
        const int end = next(joined, 0, x + 1);
        runs_of_row[y].push_back({x, end});
        x = end;
      }
    }
  });
  std::vector<Run> runs;
  std::vector<int> first_run(disparity.rows + 1);
  for (int y = 0; y < disparity.rows; ++y) {
    first_run[y] = static_cast<int>(runs.size());
    runs.insert(runs.end(), runs_of_row[y].begin(), runs_of_row[y].end());
  }
  first_run[disparity.rows] = static_cast<int>(runs.size());

  std::vector<int> parent(runs.size());  // the root of a set is its first run
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&](int i) {
    while (parent[i] != i) i = parent[i] = parent[parent[i]];
    return i;
  };
  for (int y = 1; y < disparity.rows; ++y) {
    const float* d = disparity[y];
    const float* above = disparity[y - 1];
    for (int i = first_run[y - 1], j = first_run[y]; i < first_run[y] && j < first_run[y + 1];) {
      const int end = std::min(runs[i].end, runs[j].end);
      for (int x = std::max(runs[i].begin, runs[j].begin); x < end; ++x) {
        if (std::abs(d[x] - above[x]) > step) continue;
        const int a = root(i), b = root(j);
        parent[std::max(a, b)] = std::min(a, b);
        break;
      }
      runs[i].end < runs[j].end ? ++i : ++j;
    }
  }

  Segments segments;
  segments.label.create(disparity.size());
  std::vector<int> label(runs.size());
  for (size_t i = 0; i < runs.size(); ++i) {
    const int r = root(static_cast<int>(i));
    if (r == static_cast<int>(i)) {
      label[i] = static_cast<int>(segments.sizes.size());
      segments.sizes.push_back(0);
    } else {
      label[i] = label[r];
    }
    segments.sizes[label[i]] += runs[i].end - runs[i].begin;
  }
  segments.runs.resize(runs.size());
  parallel_chunks(0, disparity.rows, kRowsPerChunk, [&](int y0, int y1) {
    for (int y = y0; y < y1; ++y) {
      int* out = segments.label[y];
      std::fill_n(out, disparity.cols, -1);
      for (int i = first_run[y]; i < first_run[y + 1]; ++i) {
        std::fill(out + runs[i].begin, out + runs[i].end, label[i]);
        segments.runs[i] = {y, runs[i].begin, runs[i].end, label[i]};
      }
    }
  });
  return segments;
}

void reject_small(int min_size, cv::Mat1f& disparity, Segments& segments) {
  for (const Segments::Run& run : segments.runs) {
    if (segments.sizes[run.label] >= min_size) continue;
    std::fill(segments.label[run.y] + run.begin, segments.label[run.y] + run.end, -1);
    std::fill(disparity[run.y] + run.begin, disparity[run.y] + run.end, 0.0f);
  }
}

}  // namespace iris::stereo
