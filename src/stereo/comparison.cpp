#include "comparison.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdlib>
#include <utility>
#include <vector>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

namespace iris::stereo {
namespace {

constexpr int kRowsPerBlock = 16;
constexpr int kNoWindow = 1 << 26;  // more than any window, and 13 of them fit into 32 bits

int rings(int windows) { return windows == 1 ? 0 : windows == 25 ? 2 : 1; }

class Block {
 public:
  Block(const MatchImage& left, const MatchImage& right, const ComparisonParameters& p)
      : left_(left),
        right_(right),
        p_(p),
        c_(p.correlation),
        width_(left.grey.cols),
        height_(left.grey.rows),
        rx_(c_.window_width / 2),
        ry_(c_.window_height / 2),
        channels_(p.measure == Measure::ncc ? 5 : 1),
        column_size_(static_cast<size_t>(channels_) * c_.disparities),
        shift_(cost_shift(p, !left.census[0].empty())) {}

  void run(int y0, int y1, Correlation& out) {
    const int reach = rings(p_.windows) * ry_;
    first_row_ = std::max(0, y0 - reach);
    const int end_row = std::min(height_, y1 + reach);
    windows_.assign(static_cast<size_t>(end_row - first_row_) * width_ * c_.disparities, kNoWindow);
    columns_.assign(width_ * column_size_, 0);
    for (int v = first_row_ - ry_; v <= first_row_ + ry_; ++v) add_row(v, 1);
    for (int v = first_row_; v < end_row; ++v) {
      sum_windows(v);
      add_row(v - ry_, -1);
      add_row(v + ry_ + 1, 1);
    }
    for (int y = y0; y < y1; ++y) row(y, out);
  }

 private:
  bool exists(int x, int d) const {
    const int partner = x - c_.min_disparity - d;
    return x >= 0 && x < width_ && partner >= 0 && partner < width_;
  }
  // Candidates of column x: [first, end).
  std::pair<int, int> candidates(int x) const {
    const int first = std::clamp(x - c_.min_disparity - (width_ - 1), 0, c_.disparities);
    return {first, std::max(first, std::clamp(x - c_.min_disparity + 1, 0, c_.disparities))};
  }

  void add_row(int v, int sign) {
    const int y = std::clamp(v, 0, height_ - 1);
    const uint8_t* const right = right_.grey[y];
    for (int x = 0; x < width_; ++x) {
      const auto [first, end] = candidates(x);
      const int l = left_.grey(y, x);
      int* const sums = &columns_[x * column_size_];
      for (int d = first; d < end; ++d) {
        const int partner = x - c_.min_disparity - d;
        const int r = right[partner];
        const int difference = std::min(std::abs(l - r), c_.cap);
        switch (p_.measure) {
          case Measure::sad:
            sums[d] += sign * (left_.census[0].empty()
                                   ? difference
                                   : kCensusWeight * census_difference(y, x, partner) + kGreyWeight * difference);
            break;
          case Measure::ssd:
            sums[d] += sign * difference * difference;
            break;
          case Measure::ncc: {
            const int products[5] = {l, r, l * l, r * r, l * r};
            for (int i = 0; i < 5; ++i) sums[i * c_.disparities + d] += sign * products[i];
          }
        }
      }
    }
  }

  int census_difference(int y, int x, int partner) const {
    int bits = 0;
    for (int i = 0; i < 3; ++i) {
      bits += std::popcount(static_cast<unsigned>(left_.census[i](y, x) ^ right_.census[i](y, partner)));
    }
    return bits;
  }

  void sum_windows(int v) {
    std::vector<int> running(column_size_, 0);
    for (int x_end = 0; x_end < width_ + rx_; ++x_end) {
      for (const auto& [x, sign] : {std::pair{x_end, 1}, std::pair{x_end - 2 * rx_ - 1, -1}}) {
        if (x < 0 || x >= width_) continue;
        const int* const column = &columns_[x * column_size_];
        for (size_t i = 0; i < column_size_; ++i) running[i] += sign * column[i];
      }
      const int x = x_end - rx_;
      if (x < 0) continue;
      int* const window = this->window(v, x);
      const auto [first, end] = candidates(x);
      for (int d = first; d < end; ++d) {
        const int low = std::max(0, c_.min_disparity + d), high = width_ - 1 + std::min(0, c_.min_disparity + d);
        const int visible = std::min(x + rx_, high) - std::max(x - rx_, low) + 1;
        const bool outside = visible < c_.window_width || v < ry_ || v >= height_ - ry_;
        if (!p_.cut && outside) continue;
        window[d] = p_.measure == Measure::ncc ? dissimilarity(&running[d], visible * c_.window_height)
                                               : static_cast<int>(int64_t{running[d]} * c_.window_width / visible);
      }
    }
  }

  // sums: of l, r, l^2, r^2, l r over n pixels, `disparities` apart.
  int dissimilarity(const int* sums, int n) const {
    const int64_t l = sums[0], r = sums[c_.disparities], ll = sums[2 * c_.disparities], rr = sums[3 * c_.disparities];
    const int64_t lr = sums[4 * c_.disparities];
    const double power = static_cast<double>(n * ll - l * l) * static_cast<double>(n * rr - r * r);
    const double ncc = power > 0 ? static_cast<double>(n * lr - l * r) / std::sqrt(power) : 0.0;
    return static_cast<int>(std::lround(kNccUnits * (1 - ncc)));
  }

  int* window(int v, int x) { return &windows_[(static_cast<size_t>(v - first_row_) * width_ + x) * c_.disparities]; }

  // Adds the lowest `best` of the windows of a ring to the costs; each of the 8 * ring windows stands on the border of
  // a rectangle.
  void add_ring(int y, int x, int ring, int best, int* cost) {
    const int d_end = c_.disparities;
    std::vector<int>& lowest = lowest_;
    lowest.assign(static_cast<size_t>(best) * d_end, kNoWindow);
    for (int j = -ring; j <= ring; ++j) {
      for (int i = -ring; i <= ring; ++i) {
        if (std::max(std::abs(i), std::abs(j)) != ring) continue;
        if (p_.windows == 5 && (i == 0 || j == 0)) continue;
        const int u = x + i * rx_, v = y + j * ry_;
        if (u < 0 || u >= width_) continue;
        if (!p_.cut && (v < 0 || v >= height_)) continue;
        entering_.assign(window(std::clamp(v, 0, height_ - 1), u), window(std::clamp(v, 0, height_ - 1), u) + d_end);
        for (int k = 0; k < best; ++k) {
          int* const rank = &lowest[static_cast<size_t>(k) * d_end];
          for (int d = 0; d < d_end; ++d) {
            const int low = std::min(rank[d], entering_[d]);
            entering_[d] = std::max(rank[d], entering_[d]);
            rank[d] = low;
          }
        }
      }
    }
    for (int k = 0; k < best; ++k) {
      for (int d = 0; d < d_end; ++d) cost[d] += lowest[static_cast<size_t>(k) * d_end + d];
    }
  }

  // All windows of pixel (x, y) lie in both images.
  bool inside(int y, int x, int d) const {
    const int reach_x = (1 + rings(p_.windows)) * rx_, reach_y = (1 + rings(p_.windows)) * ry_;
    return y >= reach_y && y < height_ - reach_y && exists(x - reach_x, d) && exists(x + reach_x, d);
  }

  void row(int y, Correlation& out) {
    std::vector<uint16_t> costs(static_cast<size_t>(width_) * c_.disparities, Correlation::kNone);
    std::vector<int> cost(c_.disparities);
    for (int x = 0; x < width_; ++x) {
      std::copy_n(window(y, x), c_.disparities, cost.begin());
      if (p_.windows == 5) add_ring(y, x, 1, 2, cost.data());
      if (p_.windows >= 9) add_ring(y, x, 1, 4, cost.data());
      if (p_.windows == 25) add_ring(y, x, 2, 8, cost.data());
      uint16_t* const row_costs = &costs[static_cast<size_t>(x) * c_.disparities];
      for (int d = 0; d < c_.disparities; ++d) {
        if (cost[d] >= kNoWindow || (!p_.cut && !inside(y, x, d))) continue;
        row_costs[d] = static_cast<uint16_t>(std::min(cost[d] >> shift_, Correlation::kNone - 1));
      }
      select(y, x, row_costs, out);
    }
    for (int x = 0; x < width_; ++x) {
      uint16_t winner = Correlation::kNone, lowest = Correlation::kNone;
      for (int d = 0; d < c_.disparities; ++d) {
        const int u = x + c_.min_disparity + d;
        if (u < 0 || u >= width_) continue;
        const uint16_t value = costs[static_cast<size_t>(u) * c_.disparities + d];
        if (value >= lowest) continue;
        lowest = value;
        winner = static_cast<uint16_t>(d);
      }
      out.right_winner(y, x) = winner;
    }
  }

  void select(int y, int x, const uint16_t* cost, Correlation& out) const {
    const int end = c_.disparities;
    const int best = static_cast<int>(std::min_element(cost, cost + end) - cost);
    const bool found = cost[best] != Correlation::kNone;
    uint16_t second = Correlation::kNone;
    for (int d = 0; d < end && found; ++d) {
      if (std::abs(d - best) > 1) second = std::min(second, cost[d]);
    }
    out.winner(y, x) = found ? static_cast<uint16_t>(best) : Correlation::kNone;
    out.cost(y, x) = cost[best];
    out.second(y, x) = second;
    out.before(y, x) = found && best > 0 ? cost[best - 1] : Correlation::kNone;
    out.after(y, x) = found && best + 1 < end ? cost[best + 1] : Correlation::kNone;
  }

  const MatchImage& left_;
  const MatchImage& right_;
  const ComparisonParameters& p_;
  const CorrelationParameters& c_;
  const int width_, height_, rx_, ry_, channels_;
  const size_t column_size_;
  const int shift_;
  int first_row_ = 0;
  std::vector<int> windows_;  // [row][x][d]
  std::vector<int> columns_;  // [x][channel][d]: sums over the height of a window
  std::vector<int> lowest_, entering_;
};

}  // namespace

int windows_in_cost(int windows) { return windows == 1 ? 1 : windows == 5 ? 3 : windows == 9 ? 5 : 13; }

int cost_shift(const ComparisonParameters& p, bool census) {
  const int64_t area = int64_t{p.correlation.window_width} * p.correlation.window_height;
  int64_t of_window = area * (census ? 24 * kCensusWeight + kGreyWeight * p.correlation.cap : p.correlation.cap);
  if (p.measure == Measure::ssd) of_window = area * p.correlation.cap * p.correlation.cap;
  if (p.measure == Measure::ncc) of_window = 2 * kNccUnits;
  IRIS_CHECK(of_window < kNoWindow);
  int shift = 0;
  while ((of_window * windows_in_cost(p.windows)) >> shift >= Correlation::kNone) ++shift;
  return shift;
}

Correlation compare(const MatchImage& left, const MatchImage& right, const ComparisonParameters& p) {
  IRIS_CHECK(!left.grey.empty() && left.grey.size() == right.grey.size());
  IRIS_CHECK(p.windows == 1 || p.windows == 5 || p.windows == 9 || p.windows == 25);
  IRIS_CHECK(p.correlation.disparities > 0 && p.correlation.window_width % 2 == 1 &&
             p.correlation.window_height % 2 == 1);
  IRIS_CHECK(p.measure == Measure::sad || left.census[0].empty());
  Correlation out;
  for (cv::Mat1w* image : {&out.winner, &out.cost, &out.second, &out.before, &out.after, &out.right_winner}) {
    image->create(left.grey.size());
  }
  parallel_chunks(0, left.grey.rows, kRowsPerBlock, [&](int y0, int y1) { Block(left, right, p).run(y0, y1, out); });
  return out;
}

}  // namespace iris::stereo
