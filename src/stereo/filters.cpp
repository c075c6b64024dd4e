#include "filters.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <functional>
#include <numeric>
#include <utility>

#include "iris/core/parallel.h"

namespace iris::stereo {
namespace {

constexpr int kRowsPerChunk = 32;

}  // namespace

void reject_one_sided(const cv::Mat1w& right_winner, int min_disparity, double tolerance, cv::Mat1w& winner) {
  const int largest = static_cast<int>(std::floor(tolerance));
  for (int y = 0; y < winner.rows; ++y) {
    const uint16_t* from_right = right_winner[y];
    uint16_t* w = winner[y];
    for (int x = 0; x < winner.cols; ++x) {
      const int partner = w[x] == Correlation::kNone ? 0 : x - min_disparity - w[x];
      w[x] = std::abs(from_right[partner] - w[x]) > largest ? Correlation::kNone : w[x];
    }
  }
}

namespace {

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

namespace {

constexpr int kPhases = 64;  // per pixel of disparity, for the estimate of the pull

// Phases of disparities between whole pixels, -1/2 … 1/2, as indices 0 … steps; steps + 1 for pixels without disparity
// and for the smallest disparity, which stands for infinity. Turned into vectors, as above.
void phase_indices(const uint16_t* w, const float* d, int width, int min_disparity, int steps, int* __restrict index) {
  for (int x = 0; x < width; ++x) {
    const float phase = d[x] - static_cast<float>(w[x] + min_disparity) + 0.5f;
    const int nearest = static_cast<int>(phase * static_cast<float>(steps) + 0.5f);
    const int inside = static_cast<int>(phase >= 0) & static_cast<int>(phase <= 1);
    index[x] = (nearest & -inside) + (steps + 1) * (1 - inside);
  }
}

// A of equalise().
double estimate_pull(const cv::Mat1w& winner, int min_disparity, const cv::Mat1f& disparity) {
  constexpr double kLowest = -0.06, kHighest = 0.13;  // beyond these it is not texture that causes them
  // Of the phases of each whole disparity, one a chunk of rows. The last bin takes what does not count, as does the
  // first histogram: pixels without disparity; that of disparity w is the one after w.
  using Histogram = std::array<int, kPhases + 2>;
  constexpr int kRowsPerHistogram = 128;
  std::vector<std::vector<Histogram>> chunks((winner.rows + kRowsPerHistogram - 1) / kRowsPerHistogram);
  parallel_chunks(0, winner.rows, kRowsPerHistogram, [&](int y0, int y1) {
    std::vector<Histogram>& histograms = chunks[y0 / kRowsPerHistogram];
    std::vector<int> index(winner.cols);
    for (int y = y0; y < y1; ++y) {
      const uint16_t* w = winner[y];
      const int width = winner.cols;
      phase_indices(w, disparity[y], width, min_disparity, kPhases, index.data());
      uint16_t largest = 0;
      for (int x = 0; x < width; ++x) largest = std::max(largest, static_cast<uint16_t>(w[x] + 1));
      if (largest >= histograms.size()) histograms.resize(largest + 1, Histogram{});
      for (int x = 0; x < width; ++x) ++histograms[static_cast<uint16_t>(w[x] + 1)][index[x]];
    }
  });
  std::vector<Histogram> histograms;
  for (const std::vector<Histogram>& chunk : chunks) {
    if (chunk.size() > histograms.size()) histograms.resize(chunk.size(), Histogram{});
    for (size_t i = 0; i < chunk.size(); ++i) {
      std::transform(chunk[i].begin(), chunk[i].end(), histograms[i].begin(), histograms[i].begin(), std::plus());
    }
  }
  std::array<double, kPhases + 1> cosines;
  for (int i = 0; i <= kPhases; ++i) cosines[i] = std::cos(2 * CV_PI * (static_cast<double>(i) / kPhases - 0.5));
  struct Level {
    double pixels = 0, cosine = 0;
  };
  std::vector<Level> levels;
  double all = 0;
  for (size_t i = 1; i < histograms.size(); ++i) {
    const Histogram& histogram = histograms[i];
    Level level;
    for (int k = 0; k <= kPhases; ++k) {
      level.pixels += histogram[k];
      level.cosine += histogram[k] * cosines[k];
    }
    if (level.pixels == 0) continue;
    level.cosine /= level.pixels;
    all += level.pixels;
    levels.push_back(level);
  }
  if (levels.size() < 3) return 0;
  // A single large plane must not outvote all others.
  const double most = all / static_cast<double>(levels.size());
  double weights = 0, mean = 0, squares = 0;
  for (const Level& level : levels) {
    weights += std::min(level.pixels, most);
    mean += std::min(level.pixels, most) * level.cosine;
  }
  mean /= weights;
  for (const Level& level : levels) {
    const double term = std::min(level.pixels, most) / weights * (level.cosine - mean);
    squares += term * term;  // of the standard error of the mean
  }
  const double trust = mean == 0 ? 0 : std::max(0.0, 1 - squares / (mean * mean));
  return std::clamp(trust * mean / CV_PI, kLowest, kHighest);
}

}  // namespace

void equalise(const cv::Mat1w& winner, int min_disparity, cv::Mat1f& disparity) {
  const double pull = estimate_pull(winner, min_disparity, disparity);
  if (pull == 0) return;
  // Correction of a measured phase, tabulated: the p at which p - A sin(2 pi p) is the measured one.
  constexpr int kTable = 1024;
  std::array<float, kTable + 2> correction;  // the last one for pixels that stay
  correction.back() = 0;
  double phase = -0.5;  // of the measured phase before it, where Newton's method starts
  for (int i = 0; i <= kTable; ++i) {
    const double measured = static_cast<double>(i) / kTable - 0.5;
    for (int k = 0; k < 20; ++k) {  // a few suffice: 2 pi A < 1
      const double step = (phase - pull * std::sin(2 * CV_PI * phase) - measured) /
                          (1 - 2 * CV_PI * pull * std::cos(2 * CV_PI * phase));
      phase -= step;
      if (std::abs(step) < 1e-10) break;
    }
    correction[i] = static_cast<float>(phase - measured);
  }
  parallel_chunks(0, winner.rows, kRowsPerChunk, [&](int y0, int y1) {
    std::vector<int> index(winner.cols);
    for (int y = y0; y < y1; ++y) {
      float* d = disparity[y];
      phase_indices(winner[y], d, winner.cols, min_disparity, kTable, index.data());
      for (int x = 0; x < winner.cols; ++x) d[x] += correction[index[x]];
    }
  });
}

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
