#include "filters.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "iris/core/parallel.h"

namespace iris::stereo {
namespace {

constexpr int kRowsPerChunk = 32;

}  // namespace

void reject_ambiguous(const Correlation& correlation, int min_margin, cv::Mat1w& winner) {
  parallel_chunks(0, winner.rows, kRowsPerChunk, [&](int y0, int y1) {
    for (int y = y0; y < y1; ++y) {
      const uint16_t* cost = correlation.cost[y];
      const uint16_t* second = correlation.second[y];
      uint16_t* w = winner[y];
      for (int x = 0; x < winner.cols; ++x) {
        const bool ambiguous = second[x] == Correlation::kNone || second[x] - cost[x] < min_margin;
        w[x] = ambiguous ? Correlation::kNone : w[x];
      }
    }
  });
}

void reject_outermost(int min_disparity, cv::Mat1w& winner) {
  const int last = winner.cols - 1;
  for (int y = 0; y < winner.rows; ++y) {
    uint16_t* w = winner[y];
    for (int x = 0; x < winner.cols; ++x) {
      const int partner = x - min_disparity - w[x];
      const bool outermost = (partner == 0 && x > 0) || (partner == last && x < last);
      w[x] = outermost ? Correlation::kNone : w[x];
    }
  }
}

void reject_one_sided(const cv::Mat1w& right_winner, int min_disparity, double tolerance, cv::Mat1w& winner) {
  const int largest = static_cast<int>(std::floor(tolerance));
  parallel_chunks(0, winner.rows, kRowsPerChunk, [&](int y0, int y1) {
    for (int y = y0; y < y1; ++y) {
      const uint16_t* from_right = right_winner[y];
      uint16_t* w = winner[y];
      for (int x = 0; x < winner.cols; ++x) {
        if (w[x] == Correlation::kNone) continue;
        const int other = from_right[x - min_disparity - w[x]];
        if (std::abs(other - w[x]) > largest) w[x] = Correlation::kNone;
      }
    }
  });
}

cv::Mat1f refine(const Correlation& correlation, const cv::Mat1w& winner, int min_disparity, SubPixel fit,
                 float smallest) {
  cv::Mat1f disparity(winner.size());
  parallel_chunks(0, winner.rows, kRowsPerChunk, [&](int y0, int y1) {
    for (int y = y0; y < y1; ++y) {
      const uint16_t* w = winner[y];
      const uint16_t* cost = correlation.cost[y];
      const uint16_t* before = correlation.before[y];
      const uint16_t* after = correlation.after[y];
      float* out = disparity[y];
      for (int x = 0; x < winner.cols; ++x) {
        // V: the steeper side has the slope of both. Parabola: the mean of both sides' slopes is its curvature.
        const int highest = std::max(before[x], after[x]);
        const int spread = fit == SubPixel::parabola ? before[x] + after[x] - 2 * cost[x] : 2 * (highest - cost[x]);
        const bool inside = fit != SubPixel::off && highest != Correlation::kNone && spread > 0;
        const float offset = inside ? static_cast<float>(before[x] - after[x]) /
                                          static_cast<float>((fit == SubPixel::parabola ? 2 : 1) * std::max(1, spread))
                                    : 0.0f;
        const float value = std::max(static_cast<float>(w[x] + min_disparity) + offset, smallest);
        out[x] = w[x] == Correlation::kNone ? 0.0f : value;
      }
    }
  });
  return disparity;
}

namespace {

constexpr int kPhases = 64;  // per pixel of disparity, for the estimate of the pull

// A of equalise().
double estimate_pull(const cv::Mat1w& winner, int min_disparity, const cv::Mat1f& disparity) {
  constexpr double kLowest = -0.06, kHighest = 0.13;  // beyond these it is not texture that causes them
  std::vector<std::array<int, kPhases + 1>> histograms;
  for (int y = 0; y < winner.rows; ++y) {
    const uint16_t* w = winner[y];
    const float* d = disparity[y];
    for (int x = 0; x < winner.cols; ++x) {
      if (w[x] == Correlation::kNone) continue;
      const float phase = d[x] - static_cast<float>(w[x] + min_disparity) + 0.5f;
      if (phase < 0 || phase > 1) continue;
      if (w[x] >= histograms.size()) histograms.resize(w[x] + 1);
      ++histograms[w[x]][static_cast<size_t>(phase * kPhases + 0.5f)];
    }
  }
  struct Level {
    double pixels = 0, cosine = 0;
  };
  std::vector<Level> levels;
  double all = 0;
  for (const auto& histogram : histograms) {
    Level level;
    for (int i = 0; i <= kPhases; ++i) {
      level.pixels += histogram[i];
      level.cosine += histogram[i] * std::cos(2 * CV_PI * (static_cast<double>(i) / kPhases - 0.5));
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
  std::array<float, kTable + 1> correction;
  for (int i = 0; i <= kTable; ++i) {
    const double measured = static_cast<double>(i) / kTable - 0.5;
    double phase = measured;
    for (int k = 0; k < 60; ++k) phase = measured + pull * std::sin(2 * CV_PI * phase);  // converges: 2 pi A < 1
    correction[i] = static_cast<float>(phase - measured);
  }
  parallel_chunks(0, winner.rows, kRowsPerChunk, [&](int y0, int y1) {
    for (int y = y0; y < y1; ++y) {
      const uint16_t* w = winner[y];
      float* d = disparity[y];
      for (int x = 0; x < winner.cols; ++x) {
        if (w[x] == Correlation::kNone) continue;
        const float phase = d[x] - static_cast<float>(w[x] + min_disparity) + 0.5f;
        if (phase < 0 || phase > 1) continue;  // the smallest disparity that stands for infinity
        d[x] += correction[static_cast<size_t>(phase * kTable + 0.5f)];
      }
    }
  });
}

Segments find_segments(const cv::Mat1f& disparity, double tolerance) {
  // Runs of connected pixels in each row are joined with those of the row above.
  struct Run {
    int begin, end;
  };
  const float step = static_cast<float>(tolerance);
  std::vector<Run> runs;
  std::vector<int> first_run(disparity.rows + 1);
  runs.reserve(disparity.rows * 32);
  for (int y = 0; y < disparity.rows; ++y) {
    first_run[y] = static_cast<int>(runs.size());
    const float* d = disparity[y];
    for (int x = 0; x < disparity.cols;) {
      if (d[x] <= 0) {
        ++x;
        continue;
      }
      const int begin = x++;
      while (x < disparity.cols && d[x] > 0 && std::abs(d[x] - d[x - 1]) <= step) ++x;
      runs.push_back({begin, x});
    }
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
  parallel_chunks(0, disparity.rows, kRowsPerChunk, [&](int y0, int y1) {
    for (int y = y0; y < y1; ++y) {
      int* out = segments.label[y];
      std::fill_n(out, disparity.cols, -1);
      for (int i = first_run[y]; i < first_run[y + 1]; ++i) std::fill(out + runs[i].begin, out + runs[i].end, label[i]);
    }
  });
  return segments;
}

void reject_small(int min_size, cv::Mat1f& disparity, Segments& segments) {
  parallel_chunks(0, disparity.rows, kRowsPerChunk, [&](int y0, int y1) {
    for (int y = y0; y < y1; ++y) {
      int* label = segments.label[y];
      float* d = disparity[y];
      for (int x = 0; x < disparity.cols; ++x) {
        if (label[x] >= 0 && segments.sizes[label[x]] < min_size) {
          label[x] = -1;
          d[x] = 0;
        }
      }
    }
  });
}

}  // namespace iris::stereo
