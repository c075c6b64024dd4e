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

  // Sum over the window centred at (x, y); cut at the sides of either image and scaled, kNone if its centre is outside.
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
    return sum * p_.window_width / columns;
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

  void expect_equal(const Correlation& c) const {
    for (int y = 0; y < rows_; ++y) {
      for (int x = 0; x < cols_; ++x) {
        std::vector<int> costs(p_.disparities);
        for (int d = 0; d < p_.disparities; ++d) costs[d] = cost(y, x, d);
        const int best = static_cast<int>(std::min_element(costs.begin(), costs.end()) - costs.begin());
        if (costs[best] == kNone) {
          ASSERT_EQ(c.winner(y, x), kNone) << y << " " << x;
        } else {
          int second = kNone;
          for (int d = 0; d < p_.disparities; ++d) {
            if (std::abs(d - best) > 1) second = std::min(second, costs[d]);
          }
          ASSERT_EQ(c.winner(y, x), best) << y << " " << x;
          ASSERT_EQ(c.cost(y, x), costs[best]) << y << " " << x;
          ASSERT_EQ(c.second(y, x), second) << y << " " << x;
          ASSERT_EQ(c.before(y, x), best > 0 ? costs[best - 1] : kNone) << y << " " << x;
          ASSERT_EQ(c.after(y, x), best + 1 < p_.disparities ? costs[best + 1] : kNone) << y << " " << x;
        }
        int right_best = kNone, right_cost = kNone;  // pixel x of the right image
        for (int d = 0; d < p_.disparities; ++d) {
          const int u = x + p_.min_disparity + d;
          if (u < 0 || u >= cols_) continue;
          const int value = cost(y, u, d);
          if (value < right_cost) {
            right_cost = value;
            right_best = d;
          }
        }
        ASSERT_EQ(c.right_winner(y, x), right_best) << y << " " << x;
      }
    }
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
    const Reference reference(l, r, parameters);
    testing::for_each_simd_target([&](const char* target) {
      SCOPED_TRACE(target);
      reference.expect_equal(correlate(l, r, parameters));
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
                                           // Sums over a column that just fit into 8 bits, or just do not.
                                           Case{{90, 12}, {32, 0, 7, 7, 36}}, Case{{110, 12}, {64, 0, 5, 5, 51}},
                                           Case{{110, 12}, {64, 0, 5, 5, 52}}));

TEST(Correlation, WideImagesInSeveralTilesAgreeWithTheDefinition) {
  cv::RNG random(4);
  cv::Mat1b left(6, 400), right(6, 400);
  random.fill(left, cv::RNG::UNIFORM, 0, 256);
  random.fill(right, cv::RNG::UNIFORM, 0, 256);
  const CorrelationParameters parameters{300, 0, 9, 7, 24};
  Reference({left, {}}, {right, {}}, parameters).expect_equal(correlate({left, {}}, {right, {}}, parameters));
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
  const CorrelationParameters parameters{40, 0, 9, 7, 24};
  Correlation one, many;
  with_threads(1, [&] { one = correlate({left, {}}, {right, {}}, parameters); });
  with_threads(4, [&] { many = correlate({left, {}}, {right, {}}, parameters); });
  for (const auto member : {&Correlation::winner, &Correlation::cost, &Correlation::second, &Correlation::before,
                            &Correlation::after, &Correlation::right_winner}) {
    EXPECT_EQ(cv::countNonZero(one.*member != many.*member), 0);
  }
}

}  // namespace
}  // namespace iris::stereo
