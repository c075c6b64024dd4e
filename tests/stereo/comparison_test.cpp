#include "src/stereo/comparison.h"

#include <gmock/gmock.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <vector>

#include "iris/core/parallel.h"

namespace iris::stereo {
namespace {

constexpr int kNone = Correlation::kNone;

struct Case {
  Measure measure;
  bool census;
  int windows;
  bool cut;
  CorrelationParameters correlation;
};

// Everything by its definition, in floating point where the measure wants it.
class Reference {
 public:
  Reference(const MatchImage& left, const MatchImage& right, const ComparisonParameters& p)
      : left_(left), right_(right), p_(p), c_(p.correlation), rows_(left.grey.rows), cols_(left.grey.cols) {}

  // -1 = there is none.
  double window(int y, int x, int d) const {
    if (!exists(x, d)) return -1;
    const int rx = c_.window_width / 2, ry = c_.window_height / 2;
    if (!p_.cut && (y < ry || y >= rows_ - ry || !exists(x - rx, d) || !exists(x + rx, d))) return -1;
    std::vector<std::pair<int, int>> pixels;
    int64_t sum = 0;
    int columns = 0;
    for (int u = x - rx; u <= x + rx; ++u) {
      if (!exists(u, d)) continue;
      ++columns;
      for (int w = y - ry; w <= y + ry; ++w) {
        const int v = std::clamp(w, 0, rows_ - 1), partner = u - c_.min_disparity - d;
        const int a = left_.grey(v, u), b = right_.grey(v, partner);
        const int difference = std::min(c_.cap, std::abs(a - b));
        int bits = 0;
        for (int i = 0; i < 3 && !left_.census[0].empty(); ++i) {
          bits += std::popcount<unsigned>(left_.census[i](v, u) ^ right_.census[i](v, partner));
        }
        pixels.emplace_back(a, b);
        sum += p_.measure == Measure::ssd ? difference * difference
               : left_.census[0].empty()  ? difference
                                          : 5 * bits + 2 * difference;
      }
    }
    if (p_.measure != Measure::ncc) return static_cast<double>(sum * c_.window_width / columns);
    double mean_a = 0, mean_b = 0, aa = 0, bb = 0, ab = 0;
    for (const auto& [a, b] : pixels) mean_a += a, mean_b += b;
    mean_a /= static_cast<double>(pixels.size()), mean_b /= static_cast<double>(pixels.size());
    for (const auto& [a, b] : pixels) {
      aa += (a - mean_a) * (a - mean_a);
      bb += (b - mean_b) * (b - mean_b);
      ab += (a - mean_a) * (b - mean_b);
    }
    const double power = aa * bb;
    return kNccUnits * (1 - (power > 1e-6 ? ab / std::sqrt(power) : 0));
  }

  double cost(int y, int x, int d) const {
    const int reach = p_.windows == 1 ? 1 : p_.windows == 25 ? 3 : 2;
    const int rx = c_.window_width / 2, ry = c_.window_height / 2;
    if (!p_.cut &&
        (y - reach * ry < 0 || y + reach * ry >= rows_ || !exists(x - reach * rx, d) || !exists(x + reach * rx, d))) {
      return -1;
    }
    double sum = window(y, x, d);
    if (sum < 0) return -1;
    const auto add_best = [&](std::vector<double> values, size_t best) {
      std::erase_if(values, [](double v) { return v < 0; });
      std::sort(values.begin(), values.end());
      if (values.size() < best || sum < 0) {
        sum = -1;
        return;
      }
      for (size_t i = 0; i < best; ++i) sum += values[i];
    };
    const auto at = [&](int i, int j) { return window(std::clamp(y + j * ry, 0, rows_ - 1), x + i * rx, d); };
    if (p_.windows == 5) add_best({at(-1, -1), at(1, -1), at(-1, 1), at(1, 1)}, 2);
    if (p_.windows >= 9) {
      add_best({at(-1, -1), at(0, -1), at(1, -1), at(-1, 0), at(1, 0), at(-1, 1), at(0, 1), at(1, 1)}, 4);
    }
    if (p_.windows == 25) {
      std::vector<double> outer;
      for (int j = -2; j <= 2; ++j) {
        for (int i = -2; i <= 2; ++i) {
          if (std::abs(i) == 2 || std::abs(j) == 2) outer.push_back(at(i, j));
        }
      }
      add_best(outer, 8);
    }
    return sum;
  }

 private:
  bool exists(int x, int d) const {
    const int partner = x - c_.min_disparity - d;
    return x >= 0 && x < cols_ && partner >= 0 && partner < cols_;
  }
  const MatchImage left_, right_;
  const ComparisonParameters p_;
  const CorrelationParameters c_;
  const int rows_, cols_;
};

class ComparisonCases : public ::testing::TestWithParam<Case> {
 protected:
  ComparisonCases() {
    cv::RNG random(11);
    cv::Mat1b left(24, 50), right(24, 50);
    random.fill(left, cv::RNG::UNIFORM, 0, 256);
    random.fill(right, cv::RNG::UNIFORM, 0, 256);
    const bool census = GetParam().census;
    left_ = {left, census ? census_transform(left) : Census()};
    right_ = {right, census ? census_transform(right) : Census()};
    parameters_ = {GetParam().correlation, GetParam().measure, GetParam().windows, GetParam().cut};
  }
  MatchImage left_, right_;
  ComparisonParameters parameters_;
};

TEST_P(ComparisonCases, GivesTheDefinition) {
  const Correlation c = compare(left_, right_, parameters_);
  const Reference reference(left_, right_, parameters_);
  const int disparities = parameters_.correlation.disparities, min_disparity = parameters_.correlation.min_disparity;
  const double unit = 1 << cost_shift(parameters_, GetParam().census);
  // Each window of the NCC is rounded to whole units.
  const double tolerance = GetParam().measure == Measure::ncc ? 0.5 * windows_in_cost(GetParam().windows) + 1 : 1;
  std::vector<double> costs(static_cast<size_t>(left_.grey.cols) * disparities);
  for (int y = 0; y < left_.grey.rows; ++y) {
    for (int x = 0; x < left_.grey.cols; ++x) {
      double* const cost = &costs[static_cast<size_t>(x) * disparities];
      int best = -1;
      for (int d = 0; d < disparities; ++d) {
        const double value = reference.cost(y, x, d);
        cost[d] = value < 0 ? -1 : value / unit;
        if (cost[d] >= 0 && (best < 0 || cost[d] < cost[best])) best = d;
      }
      if (best < 0) {
        ASSERT_EQ(c.winner(y, x), kNone);
        continue;
      }
      const auto expect_cost = [&](int value, double expected) {
        if (expected < 0) {
          ASSERT_EQ(value, kNone) << y << " " << x;
        } else {
          ASSERT_NEAR(value, expected, tolerance) << y << " " << x;
        }
      };
      const int winner = c.winner(y, x);
      ASSERT_LT(winner, disparities);
      expect_cost(c.cost(y, x), cost[best]);
      expect_cost(c.cost(y, x), cost[winner]);
      expect_cost(c.before(y, x), winner > 0 ? cost[winner - 1] : -1);
      expect_cost(c.after(y, x), winner + 1 < disparities ? cost[winner + 1] : -1);
      double second = -1;
      for (int d = 0; d < disparities; ++d) {
        if (std::abs(d - winner) > 1 && cost[d] >= 0 && (second < 0 || cost[d] < second)) second = cost[d];
      }
      expect_cost(c.second(y, x), second);
    }
    for (int x = 0; x < left_.grey.cols; ++x) {
      double lowest = -1;
      const auto from_right = [&](int d) {
        const int u = x + min_disparity + d;
        return u < 0 || u >= left_.grey.cols ? -1 : costs[static_cast<size_t>(u) * disparities + d];
      };
      for (int d = 0; d < disparities; ++d) {
        if (from_right(d) >= 0 && (lowest < 0 || from_right(d) < lowest)) lowest = from_right(d);
      }
      if (lowest < 0) {
        ASSERT_EQ(c.right_winner(y, x), kNone);
      } else {
        ASSERT_LE(from_right(c.right_winner(y, x)), lowest + tolerance);
      }
    }
  }
}

TEST_P(ComparisonCases, DoesNotDependOnThreads) {
  Correlation one, many;
  with_threads(1, [&] { one = compare(left_, right_, parameters_); });
  with_threads(4, [&] { many = compare(left_, right_, parameters_); });
  for (const auto member : {&Correlation::winner, &Correlation::cost, &Correlation::second, &Correlation::before,
                            &Correlation::after, &Correlation::right_winner}) {
    EXPECT_EQ(cv::countNonZero(one.*member != many.*member), 0);
  }
}

INSTANTIATE_TEST_SUITE_P(Measures, ComparisonCases,
                         ::testing::Values(Case{Measure::sad, false, 1, false, {12, 0, 5, 3, 255}},
                                           Case{Measure::sad, false, 1, true, {12, -3, 5, 3, 30}},
                                           Case{Measure::sad, false, 5, false, {12, 0, 3, 5, 255}},
                                           Case{Measure::sad, true, 5, true, {12, 0, 5, 3, 20}},
                                           Case{Measure::sad, false, 9, false, {9, 2, 3, 3, 255}},
                                           Case{Measure::sad, false, 9, true, {9, 0, 5, 5, 60}},
                                           Case{Measure::sad, true, 25, true, {9, 0, 3, 5, 15}},
                                           Case{Measure::sad, false, 25, false, {9, 0, 3, 3, 255}},
                                           Case{Measure::ssd, false, 5, true, {12, 0, 5, 5, 255}},
                                           Case{Measure::ssd, false, 1, false, {12, 0, 7, 7, 255}},
                                           Case{Measure::ncc, false, 5, true, {12, 0, 5, 5, 255}},
                                           Case{Measure::ncc, false, 9, false, {8, 0, 5, 3, 255}}));

// The two implementations of SAD5 agree in every bit.
TEST(Comparison, EqualsTheFastCorrelation) {
  cv::RNG random(12);
  for (const bool census : {false, true}) {
    cv::Mat1b left(40, 90), right(40, 90);
    random.fill(left, cv::RNG::UNIFORM, 0, 256);
    random.fill(right, cv::RNG::UNIFORM, 0, 256);
    const MatchImage l{left, census ? census_transform(left) : Census()};
    const MatchImage r{right, census ? census_transform(right) : Census()};
    const CorrelationParameters p{20, 0, 7, 5, 40};
    const Correlation fast = correlate(l, r, p), plain = compare(l, r, {.correlation = p});
    for (const auto member : {&Correlation::winner, &Correlation::cost, &Correlation::second, &Correlation::before,
                              &Correlation::after, &Correlation::right_winner}) {
      EXPECT_EQ(cv::countNonZero(fast.*member != plain.*member), 0);
    }
  }
}

TEST(Comparison, RankCountsTheDarkerNeighbours) {
  cv::RNG random(6);
  cv::Mat1b image(20, 31);
  random.fill(image, cv::RNG::UNIFORM, 100, 110);
  const cv::Mat1b rank = rank_transform(census_transform(image));
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      int darker = 0;
      for (int v = y - 2; v <= y + 2; ++v) {
        for (int u = x - 2; u <= x + 2; ++u) {
          darker += image(std::clamp(v, 0, image.rows - 1), std::clamp(u, 0, image.cols - 1)) < image(y, x);
        }
      }
      ASSERT_EQ(rank(y, x), darker);
    }
  }
}

}  // namespace
}  // namespace iris::stereo
