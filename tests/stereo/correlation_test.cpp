#include "src/stereo/correlation.h"

#include <gmock/gmock.h>

#include <algorithm>
#include <array>

#include "iris/core/parallel.h"
#include "support/simd_targets.h"

namespace iris::stereo {
namespace {

constexpr int kNone = Correlation::kNone;

// Everything by its definition, window by window.
class Reference {
 public:
  Reference(const cv::Mat1b& left, const cv::Mat1b& right, const CorrelationParameters& p)
      : left_(left), right_(right), p_(p) {}

  // Sum over the window centred at (x, y); cut at the sides of either image and scaled, kNone if its centre is outside.
  int window(int y, int x, int d) const {
    if (!exists(x, d)) return kNone;
    int sum = 0, columns = 0;
    for (int u = x - p_.window_width / 2; u <= x + p_.window_width / 2; ++u) {
      if (!exists(u, d)) continue;
      ++columns;
      for (int v = y - p_.window_height / 2; v <= y + p_.window_height / 2; ++v) {
        const int row = std::clamp(v, 0, left_.rows - 1);
        sum += std::min(p_.cap, std::abs(left_(row, u) - right_(row, u - p_.min_disparity - d)));
      }
    }
    return sum * p_.window_width / columns;
  }

  // SAD5 (3.1): the supporting windows stand on the corners of the middle one; above and below they stay in the image.
  int cost(int y, int x, int d) const {
    const int rx = p_.window_width / 2, ry = p_.window_height / 2;
    const int up = std::max(0, y - ry), down = std::min(left_.rows - 1, y + ry);
    std::array<int, 4> corners = {window(up, x - rx, d), window(up, x + rx, d), window(down, x - rx, d),
                                  window(down, x + rx, d)};
    std::sort(corners.begin(), corners.end());
    return std::min(kNone, window(y, x, d) + corners[0] + corners[1]);
  }

  void expect_equal(const Correlation& c) const {
    for (int y = 0; y < left_.rows; ++y) {
      for (int x = 0; x < left_.cols; ++x) {
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
          if (u < 0 || u >= left_.cols) continue;
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
    return x >= 0 && x < left_.cols && partner >= 0 && partner < left_.cols;
  }
  const cv::Mat1b &left_, &right_;
  const CorrelationParameters p_;
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
  const Reference reference(left, right, c.parameters);
  testing::for_each_simd_target([&] { reference.expect_equal(correlate(left, right, c.parameters)); });
}

INSTANTIATE_TEST_SUITE_P(Sizes, CorrelationCases,
                         ::testing::Values(Case{{1, 1}, {4, 0, 9, 7, 24}}, Case{{5, 3}, {8, 0, 9, 7, 24}},
                                           Case{{31, 9}, {16, 0, 9, 7, 255}}, Case{{64, 20}, {16, 0, 9, 7, 24}},
                                           Case{{77, 70}, {13, 0, 5, 3, 255}}, Case{{50, 12}, {80, 0, 7, 5, 60}},
                                           Case{{45, 10}, {12, -6, 3, 5, 100}}, Case{{45, 10}, {12, -40, 5, 5, 100}},
                                           Case{{45, 10}, {12, 9, 11, 1, 100}}, Case{{40, 8}, {7, 0, 1, 1, 255}},
                                           Case{{40, 33}, {9, 0, 13, 15, 100}}));

TEST(Correlation, WideImagesInSeveralTilesAgreeWithTheDefinition) {
  cv::RNG random(4);
  cv::Mat1b left(6, 400), right(6, 400);
  random.fill(left, cv::RNG::UNIFORM, 0, 256);
  random.fill(right, cv::RNG::UNIFORM, 0, 256);
  const CorrelationParameters parameters{300, 0, 9, 7, 24};
  Reference(left, right, parameters).expect_equal(correlate(left, right, parameters));
}

TEST(Correlation, DoesNotDependOnThreads) {
  cv::RNG random(5);
  cv::Mat1b left(300, 150), right(300, 150);
  random.fill(left, cv::RNG::UNIFORM, 0, 256);
  random.fill(right, cv::RNG::UNIFORM, 0, 256);
  const CorrelationParameters parameters{40, 0, 9, 7, 24};
  Correlation one, many;
  with_threads(1, [&] { one = correlate(left, right, parameters); });
  with_threads(4, [&] { many = correlate(left, right, parameters); });
  for (const auto member : {&Correlation::winner, &Correlation::cost, &Correlation::second, &Correlation::before,
                            &Correlation::after, &Correlation::right_winner}) {
    EXPECT_EQ(cv::countNonZero(one.*member != many.*member), 0);
  }
}

}  // namespace
}  // namespace iris::stereo
