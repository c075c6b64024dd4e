#include "filters.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <vector>

#include "iris/core/parallel.h"

namespace iris::stereo {
namespace {

constexpr int kRowsPerChunk = 32;
constexpr int kRunsPerChunk = 4096;

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
  // Runs of connected pixels in each row are joined with those of the row above: first within chunks of rows, then
  // across their borders.
  struct Run {
    int begin, end;
  };
  struct Chunk {
    std::vector<Run> runs;
    std::vector<int> first_run;  // of each row and behind the last
    std::vector<int> parent;     // the root of a set is its first run
  };
  const float step = static_cast<float>(tolerance);
  const int width = disparity.cols, height = disparity.rows;
  const auto join = [](std::vector<int>& parent, int i, int j) {
    const auto root = [&](int k) {
      while (parent[k] != k) k = parent[k] = parent[parent[k]];
      return k;
    };
    const int a = root(i), b = root(j);
    parent[std::max(a, b)] = std::min(a, b);
  };
  // The runs [i, i_end) of row y - 1 and [j, j_end) of row y.
  const auto join_rows = [&](const std::vector<Run>& runs, std::vector<int>& parent, int y, int i, int i_end, int j,
                             int j_end) {
    const float* d = disparity[y];
    const float* above = disparity[y - 1];
    while (i < i_end && j < j_end) {
      const int end = std::min(runs[i].end, runs[j].end);
      for (int x = std::max(runs[i].begin, runs[j].begin); x < end; ++x) {
        if (std::abs(d[x] - above[x]) > step) continue;
        join(parent, i, j);
        break;
      }
      runs[i].end < runs[j].end ? ++i : ++j;
    }
  };
  std::vector<Chunk> chunks((height + kRowsPerChunk - 1) / kRowsPerChunk);
  parallel_chunks(0, height, kRowsPerChunk, [&](int y0, int y1) {
    auto& [runs, first_run, parent] = chunks[y0 / kRowsPerChunk];
    std::vector<uint8_t> valid(width), joined(width);
    const auto next = [&](const std::vector<uint8_t>& flags, int value, int x) {
      const void* const found = x < width ? std::memchr(&flags[x], value, width - x) : nullptr;
      return found == nullptr ? width : static_cast<int>(static_cast<const uint8_t*>(found) - flags.data());
    };
    for (int y = y0; y < y1; ++y) {
      const int first = static_cast<int>(runs.size());
      first_run.push_back(first);
      find_joints(disparity[y], width, step, valid.data(), joined.data());
      for (int x = next(valid, 1, 0); x < width; x = next(valid, 1, x)) {
        const int end = next(joined, 0, x + 1);
        parent.push_back(static_cast<int>(runs.size()));
        runs.push_back({x, end});
        x = end;
      }
      if (y > y0) join_rows(runs, parent, y, first_run[y - y0 - 1], first, first, static_cast<int>(runs.size()));
    }
    first_run.push_back(static_cast<int>(runs.size()));
  });

  std::vector<Run> runs;
  std::vector<int> parent, first_run;
  for (int y0 = 0; const Chunk& chunk : chunks) {
    const int offset = static_cast<int>(runs.size());
    runs.insert(runs.end(), chunk.runs.begin(), chunk.runs.end());
    for (const int of_chunk : chunk.parent) parent.push_back(offset + of_chunk);
    const int above = y0 == 0 ? 0 : first_run[y0 - 1];
    for (size_t row = 0; row + 1 < chunk.first_run.size(); ++row) first_run.push_back(offset + chunk.first_run[row]);
    if (y0 > 0) join_rows(runs, parent, y0, above, offset, offset, offset + chunk.first_run[1]);
    y0 += kRowsPerChunk;
  }
  first_run.push_back(static_cast<int>(runs.size()));

  Segments segments;
  segments.label.create(disparity.size());
  std::vector<int> label(runs.size());
  for (size_t i = 0; i < runs.size(); ++i) {
    if (parent[i] == static_cast<int>(i)) {
      label[i] = static_cast<int>(segments.sizes.size());
      segments.sizes.push_back(0);
    } else {
      label[i] = label[parent[i]];  // an earlier run of the same segment
    }
    segments.sizes[label[i]] += runs[i].end - runs[i].begin;
  }
  segments.runs.resize(runs.size());
  parallel_chunks(0, height, kRowsPerChunk, [&](int y0, int y1) {
    for (int y = y0; y < y1; ++y) {
      int* out = segments.label[y];
      std::fill_n(out, width, -1);
      for (int i = first_run[y]; i < first_run[y + 1]; ++i) {
        std::fill(out + runs[i].begin, out + runs[i].end, label[i]);
        segments.runs[i] = {y, runs[i].begin, runs[i].end, label[i]};
      }
    }
  });
  return segments;
}

void reject_small(int min_size, cv::Mat1f& disparity, Segments& segments) {
  parallel_chunks(0, static_cast<int>(segments.runs.size()), kRunsPerChunk, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      const Segments::Run& run = segments.runs[i];
      if (segments.sizes[run.label] >= min_size) continue;
      std::fill(segments.label[run.y] + run.begin, segments.label[run.y] + run.end, -1);
      std::fill(disparity[run.y] + run.begin, disparity[run.y] + run.end, 0.0f);
    }
  });
}

}  // namespace iris::stereo
