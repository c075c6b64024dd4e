#include "src/stereo/correlation.h"

#include <gmock/gmock.h>

#include <algorithm>
#include <array>
#include <bit>

#include "iris/core/parallel.h"
#include "support/simd_targets.h"

namespace iris::stereo {
namespace {

constexpr int kNone = Correlation::kNone;

constexpr cv::Mat1w Correlation::*kMembers[] = {&Correlation::winner, &Correlation::cost,  &Correlation::second,
                                                &Correlation::before, &Correlation::after, &Correlation::right_winner};

void expect_equal(const Correlation& actual, const Correlation& expected) {
  for (size_t i = 0; i < std::size(kMembers); ++i) {
    ASSERT_EQ((actual.*kMembers[i]).size(), (expected.*kMembers[i]).size());
    EXPECT_EQ(cv::countNonZero(actual.*kMembers[i] != expected.*kMembers[i]), 0) << "member " << i;
  }
}

// Everything by its definition, window by window.
class Reference {
 public:
  Reference(const MatchImage& left, const MatchImage& right, const CorrelationParameters& p)
      : left_(left), right_(right), p_(p), rows_(left.grey.rows), cols_(left.grey.cols) {}

  int pixel(int y, int x, int x_right) const {
    const int difference = std::min(p_.cap, std::abs(left_.grey(y, x) - right_.grey(y, x_right)));
    if (left_.census[0].empty()) return difference;
    int bits = 0;
    for (int i = 0; i < 3; ++i) bits += std::popcount<unsigned>(left_.census[i](y, x) ^ right_.census[i](y, x_right));
    return 5 * bits + 2 * difference;
  }

  // Sum over the window centred at (x, y); cut at the sides of either image and scaled; divided; kNone if its centre is
  // outside.
  int window(int y, int x, int d) const {
    if (!exists(x, d)) return kNone;
    int sum = 0, columns = 0;
    for (int u = x - p_.window_width / 2; u <= x + p_.window_width / 2; ++u) {
      if (!exists(u, d)) continue;
      ++columns;
      for (int v = y - p_.window_height / 2; v <= y + p_.window_height / 2; ++v) {
        sum += pixel(std::clamp(v, 0, rows_ - 1), u, u - p_.min_disparity - d);
      }
    }
    return (sum * p_.window_width / columns) >> p_.shift;
  }

  // SAD5 (3.1): the supporting windows stand on the corners of the middle one; above and below they stay in the image.
  int cost(int y, int x, int d) const {
    const int rx = p_.window_width / 2, ry = p_.window_height / 2;
    const int up = std::max(0, y - ry), down = std::min(rows_ - 1, y + ry);
    std::array<int, 4> corners = {window(up, x - rx, d), window(up, x + rx, d), window(down, x - rx, d),
                                  window(down, x + rx, d)};
    std::sort(corners.begin(), corners.end());
    return std::min(kNone, window(y, x, d) + corners[0] + corners[1]);
  }

  Correlation correlate() const {
    Correlation c;
    for (const auto member : kMembers) (c.*member).create(rows_, cols_);
    for (int y = 0; y < rows_; ++y) {
      std::vector<std::vector<int>> costs(cols_, std::vector<int>(p_.disparities));
      for (int x = 0; x < cols_; ++x) {
        for (int d = 0; d < p_.disparities; ++d) costs[x][d] = cost(y, x, d);
        const int best = static_cast<int>(std::min_element(costs[x].begin(), costs[x].end()) - costs[x].begin());
        const bool found = costs[x][best] != kNone;
        int second = kNone;
        for (int d = 0; d < p_.disparities; ++d) {
          if (std::abs(d - best) > 1) second = std::min(second, costs[x][d]);
        }
        const auto value = [](bool exists, int number) { return static_cast<uint16_t>(exists ? number : kNone); };
        c.winner(y, x) = value(found, best);
        c.cost(y, x) = value(found, costs[x][best]);
        c.second(y, x) = value(found, second);
        c.before(y, x) = found && best > 0 ? value(true, costs[x][best - 1]) : Correlation::kNone;
        c.after(y, x) = found && best + 1 < p_.disparities ? value(true, costs[x][best + 1]) : Correlation::kNone;
      }
      for (int x = 0; x < cols_; ++x) {  // of the right image
        int right_best = kNone, right_cost = kNone;
        for (int d = 0; d < p_.disparities; ++d) {
          const int u = x + p_.min_disparity + d;
          if (u < 0 || u >= cols_ || costs[u][d] >= right_cost) continue;
          right_cost = costs[u][d];
          right_best = d;
        }
        c.right_winner(y, x) = static_cast<uint16_t>(right_best);
      }
    }
    return c;
  }

 private:
  bool exists(int x, int d) const {
    const int partner = x - p_.min_disparity - d;
    return x >= 0 && x < cols_ && partner >= 0 && partner < cols_;
  }
  const MatchImage left_, right_;
  const CorrelationParameters p_;
  const int rows_, cols_;
};

struct Case {
  cv::Size size;
  CorrelationParameters parameters;
};

class CorrelationCases : public ::testing::TestWithParam<Case> {};

TEST_P(CorrelationCases, EveryInstructionSetGivesTheDefinitionBitForBit) {
  const Case& c = GetParam();
  cv::RNG random(17);
  cv::Mat1b left(c.size), right(c.size);
  random.fill(left, cv::RNG::UNIFORM, 0, 256);
  random.fill(right, cv::RNG::UNIFORM, 0, 256);
  // Half of the columns really correspond, so that winners are clear in places and ties occur (flat blocks) in others.
  for (int y = 0; y < c.size.height; ++y) {
    for (int x = 0; x + 3 < c.size.width; ++x) {
      if ((x / 16 + y / 8) % 3 == 0) right(y, x) = left(y, x + 3);
      if ((x / 16 + y / 8) % 3 == 1) right(y, x) = left(y, x) = 90;
    }
  }
  for (const bool census : {false, true}) {
    CorrelationParameters parameters = c.parameters;
    const int max_cap = largest_cap(parameters.window_width, parameters.window_height, census);
    if (max_cap < 0) continue;  // windows too large for 16 bits
    parameters.cap = std::min(parameters.cap, max_cap);
    const MatchImage l = {left, census ? census_transform(left) : Census()};
    const MatchImage r = {right, census ? census_transform(right) : Census()};
    const Correlation expected = Reference(l, r, parameters).correlate();
    testing::for_each_simd_target([&](const char* target) {
      SCOPED_TRACE(target);
      expect_equal(correlate(l, r, parameters), expected);
    });
  }
}

INSTANTIATE_TEST_SUITE_P(Sizes, CorrelationCases,
                         ::testing::Values(Case{{1, 1}, {4, 0, 9, 7, 24}}, Case{{5, 3}, {8, 0, 9, 7, 24}},
                                           Case{{31, 9}, {16, 0, 9, 7, 255}}, Case{{64, 20}, {16, 0, 9, 7, 24}},
                                           Case{{77, 70}, {13, 0, 5, 3, 255}}, Case{{50, 12}, {80, 0, 7, 5, 60}},
                                           Case{{45, 10}, {12, -6, 3, 5, 100}}, Case{{45, 10}, {12, -40, 5, 5, 100}},
                                           Case{{45, 10}, {12, 9, 11, 1, 100}}, Case{{40, 8}, {7, 0, 1, 1, 255}},
                                           Case{{40, 33}, {9, 0, 13, 15, 100}},
                                           // Costs of 8 bits, up to the largest that fit; candidates that do not.
                                           Case{{1, 1}, {4, 0, 7, 7, 24, 4}}, Case{{5, 3}, {8, 0, 7, 7, 24, 4}},
                                           Case{{79, 70}, {33, 0, 7, 7, 24, 4}}, Case{{67, 9}, {64, 0, 7, 7, 27, 4}},
                                           Case{{67, 9}, {13, -6, 7, 7, 36, 5}}, Case{{67, 9}, {64, 9, 3, 5, 5, 0}},
                                           Case{{45, 10}, {12, -40, 13, 3, 85, 6}}, Case{{40, 8}, {7, 0, 1, 1, 255, 2}},
                                           Case{{150, 5}, {256, -70, 5, 3, 28, 3}},
                                           Case{{150, 5}, {257, -70, 5, 3, 28, 3}},
                                           Case{{200, 4}, {512, -300, 3, 3, 24, 2}},
                                           Case{{90, 12}, {32, 0, 7, 7, 24, 3}}, Case{{90, 12}, {32, 0, 7, 7, 27, 0}},
                                           // Sums over a column that just fit into 8 bits, or just do not.
                                           Case{{90, 12}, {32, 0, 7, 7, 36}}, Case{{110, 12}, {64, 0, 5, 5, 51}},
                                           Case{{110, 12}, {64, 0, 5, 5, 52}}));

TEST(Correlation, WideImagesInSeveralTilesAgreeWithTheDefinition) {
  cv::RNG random(4);
  cv::Mat1b left(6, 400), right(6, 400);
  random.fill(left, cv::RNG::UNIFORM, 0, 256);
  random.fill(right, cv::RNG::UNIFORM, 0, 256);
  for (const CorrelationParameters& parameters :
       {CorrelationParameters{300, 0, 9, 7, 24}, CorrelationParameters{250, 0, 7, 7, 24, 4}}) {
    expect_equal(correlate({left, {}}, {right, {}}, parameters),
                 Reference({left, {}}, {right, {}}, parameters).correlate());
  }
}

TEST(Correlation, ShiftMakesCostsFitIntoBytesIfColumnsDo) {
  EXPECT_EQ(shift_for_bytes(7, 7, 24), 4);  // 1176 / 16 = 73
  EXPECT_EQ(shift_for_bytes(7, 7, 36), 5);  // 252 is the largest sum over a column
  EXPECT_EQ(shift_for_bytes(7, 7, 37), 0);
  EXPECT_EQ(shift_for_bytes(3, 3, 9), 0);
}

TEST(Census, EveryInstructionSetGivesTheDefinition) {
  cv::RNG random(6);
  for (const cv::Size size : {cv::Size(1, 1), cv::Size(7, 3), cv::Size(70, 40), cv::Size(131, 33)}) {
    cv::Mat1b image(size);
    random.fill(image, cv::RNG::UNIFORM, 100, 110);  // with ties
    testing::for_each_simd_target([&](const char* target) {
      SCOPED_TRACE(target);
      const Census census = census_transform(image);
      for (int y = 0; y < size.height; ++y) {
        for (int x = 0; x < size.width; ++x) {
          int k = 0;
          for (int dy = -2; dy <= 2; ++dy) {
            for (int dx = -2; dx <= 2; ++dx) {
              if (dx == 0 && dy == 0) continue;
              const int v = std::clamp(y + dy, 0, size.height - 1), u = std::clamp(x + dx, 0, size.width - 1);
              ASSERT_EQ((census[k / 8](y, x) >> (k % 8)) & 1, image(v, u) < image(y, x) ? 1 : 0);
              ++k;
            }
          }
        }
      }
    });
  }
}

TEST(Correlation, LargestCapKeepsCostsInSixteenBits) {
  EXPECT_EQ(largest_cap(9, 7, false), 255);
  EXPECT_EQ(largest_cap(31, 31, false), 22);  // 65534 / (3 * 961)
  EXPECT_EQ(largest_cap(7, 7, true), 67);     // (255 - 120) / 2
  EXPECT_LT(largest_cap(31, 31, true), 0);
}

TEST(Correlation, DoesNotDependOnThreads) {
  cv::RNG random(5);
  cv::Mat1b left(300, 150), right(300, 150);
  random.fill(left, cv::RNG::UNIFORM, 0, 256);
  random.fill(right, cv::RNG::UNIFORM, 0, 256);
  for (const int shift : {0, 4}) {
    const CorrelationParameters parameters{40, 0, 7, 7, 24, shift};
    Correlation one, many;
    with_threads(1, [&] { one = correlate({left, {}}, {right, {}}, parameters); });
    with_threads(4, [&] { many = correlate({left, {}}, {right, {}}, parameters); });
    expect_equal(many, one);
  }
}

}  // namespace
}  // namespace iris::stereo
