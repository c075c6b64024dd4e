#include "src/stereo/borders.h"

#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "iris/core/parallel.h"

namespace iris::stereo {
namespace {

// An object of disparity 12 in front of a background of disparity 5, both randomly textured: columns first … last of
// the left image.
struct Scene {
  cv::Mat1b left = cv::Mat1b(20, 80), right = cv::Mat1b(20, 80);
  cv::Mat1f truth = cv::Mat1f(20, 80);

  Scene(int first, int last, int seed) {
    cv::RNG random(seed);
    cv::Mat1b object(20, 100), background(20, 100);
    random.fill(object, cv::RNG::UNIFORM, 0, 256);
    random.fill(background, cv::RNG::UNIFORM, 0, 256);
    for (int y = 0; y < left.rows; ++y) {
      for (int x = 0; x < left.cols; ++x) {
        const bool seen = x >= first && x <= last;
        left(y, x) = seen ? object(y, x) : background(y, x);
        truth(y, x) = seen ? 12 : 5;
        const bool seen_right = x + 12 >= first && x + 12 <= last;
        right(y, x) = seen_right ? object(y, x + 12) : background(y, x + 5);
      }
    }
  }
};

cv::Mat1f corrected(const cv::Mat1b& left, const cv::Mat1b& right, const cv::Mat1f& disparity,
                    const BorderParameters& parameters) {
  cv::Mat1f out = disparity.clone();
  cv::Mat1b changed;
  correct_borders(left, right, parameters, out, changed);
  EXPECT_EQ(cv::countNonZero(changed != (out != disparity)), 0);
  return out;
}

// Correlation widens or narrows objects; whatever the shift of either border within reach, it is undone.
TEST(Borders, ReturnToWhereTheyAre) {
  const Scene scene(30, 55, 1);
  for (const BorderCriterion criterion : {BorderCriterion::support, BorderCriterion::halves}) {
    for (int at_left = -4; at_left <= 4; ++at_left) {
      for (int at_right = -4; at_right <= 4; ++at_right) {
        cv::Mat1f measured(scene.truth.size(), 5.0f);
        measured.colRange(30 + at_left, 56 + at_right) = 12.0f;
        const cv::Mat1f out = corrected(scene.left, scene.right, measured, {.criterion = criterion});
        int wrong = cv::countNonZero(out != scene.truth);
        // The thesis's criterion is met where both halves fit equally badly as well; where both fit is one such place.
        EXPECT_LE(wrong, criterion == BorderCriterion::support ? 0 : scene.left.rows) << at_left << " " << at_right;
      }
    }
  }
}

TEST(Borders, InvalidPixelsBesideABorderTakeItsSide) {
  const Scene scene(30, 55, 2);
  cv::Mat1f measured = scene.truth.clone();
  measured.colRange(25, 33) = 0.0f;  // hidden strip and the first columns of the object
  measured.colRange(53, 58) = 0.0f;
  const cv::Mat1f out = corrected(scene.left, scene.right, measured, {});
  for (int x = 0; x < scene.truth.cols; ++x) {
    if (out(10, x) > 0) {
      EXPECT_EQ(out(10, x), scene.truth(10, x)) << x;
    }
  }
  EXPECT_EQ(out(10, 31), 12);
  EXPECT_EQ(out(10, 54), 12);
  EXPECT_EQ(out(10, 27), 0);
  EXPECT_EQ(out(10, 57), 0);
}

TEST(Borders, SmallStepsAreNone) {
  const Scene scene(30, 55, 3);
  cv::Mat1f slope(scene.truth.size());
  for (int y = 0; y < slope.rows; ++y) {
    for (int x = 0; x < slope.cols; ++x) slope(y, x) = 5 + 1.9f * static_cast<float>(x / 8);
  }
  EXPECT_EQ(cv::countNonZero(corrected(scene.left, scene.right, slope, {}) != slope), 0);
}

// The definition of borders.h, step by step: every candidate of every border is written out and summed up anew.
cv::Mat1f reference(const cv::Mat1b& left, const cv::Mat1b& right, const cv::Mat1f& disparity,
                    const BorderParameters& p) {
  const int width = left.cols, height = left.rows;
  const auto grey = [&](const cv::Mat1b& image, int y, int x) {
    return static_cast<int>(image(std::clamp(y, 0, height - 1), std::clamp(x, 0, width - 1)));
  };
  cv::Mat1f out = disparity.clone();
  for (int y = 0; y < height; ++y) {
    // Invalid pixels take the lower valid neighbour, if there are two.
    std::vector<float> filled(width), from_left(width, 0.0f), from_right(width, 0.0f);
    for (int x = 0; x < width; ++x) {
      from_left[x] = disparity(y, x) > 0 ? disparity(y, x) : x > 0 ? from_left[x - 1] : 0;
    }
    for (int x = width - 1; x >= 0; --x) {
      from_right[x] = disparity(y, x) > 0 ? disparity(y, x) : x + 1 < width ? from_right[x + 1] : 0;
      filled[x] = std::min(from_left[x], from_right[x]);
    }
    std::vector<int> steps;
    for (int x = 1; x < width; ++x) {
      const bool known = filled[x - 1] > 0 && filled[x] > 0;
      if (known && std::abs(filled[x] - filled[x - 1]) >= static_cast<float>(p.min_step)) steps.push_back(x);
    }
    for (size_t i = 0; i < steps.size(); ++i) {
      const int at = steps[i];
      const float before = filled[at - 1], after = filled[at];
      const int d_before = static_cast<int>(std::lround(before)), d_after = static_cast<int>(std::lround(after));
      int best = at, best_value = -1;
      for (int k = 0; k <= 2 * p.reach; ++k) {
        const int x = at + (k % 2 == 0 ? k / 2 : -(k + 1) / 2);  // the nearest places first, left before right
        if (x < 1 || x > width - 1) continue;
        if (i > 0 && x < at && 2 * x < steps[i - 1] + at) continue;
        if (i + 1 < steps.size() && x > at && 2 * x > steps[i + 1] + at) continue;
        // c(n) is column n of the image in which both sides are adjacent, 0 = the border itself.
        const auto explained = [&](int n, int d) {
          int sum = 0;
          for (int v = y - p.rows / 2; v <= y + p.rows / 2; ++v) {
            const int difference = d_after > d_before
                                       ? grey(right, v, x - d_after + n) - grey(left, v, x - d_after + n + d)
                                       : grey(left, v, x + n) - grey(right, v, x + n - d);
            sum += std::min(p.cap, std::abs(difference));
          }
          return sum;
        };
        int value = 0;
        if (p.criterion == BorderCriterion::support) {
          for (int n = at - p.reach - x; n < at + p.reach - x; ++n) value += explained(n, n < 0 ? d_before : d_after);
        } else {
          for (int n = 0; n <= p.reach; ++n) value += explained(-1 - n, d_before) - explained(n, d_after);
          value = std::abs(value);
        }
        if (best_value < 0 || value < best_value) {
          best = x;
          best_value = value;
        }
      }
      for (int x = best; x < at; ++x) out(y, x) = after;
      for (int x = at; x < best; ++x) out(y, x) = before;
    }
  }
  return out;
}

TEST(Borders, EqualTheDefinitionOnRandomImagesWithAnyNumberOfThreads) {
  cv::RNG random(7);
  int moved = 0;
  for (int round = 0; round < 60; ++round) {
    const cv::Size size(random.uniform(1, 70), random.uniform(1, 30));
    cv::Mat1b left(size), right(size);
    random.fill(left, cv::RNG::UNIFORM, 100, 140);
    random.fill(right, cv::RNG::UNIFORM, 100, 140);
    cv::Mat1f disparity(size);
    float level = 3;
    for (float& d : disparity) {  // runs, steps and holes
      if (random.uniform(0, 6) == 0) level = random.uniform(1.0f, 12.0f);
      d = random.uniform(0, 4) == 0 ? 0.0f : level;
    }
    const BorderParameters parameters{.criterion = round % 2 == 0 ? BorderCriterion::support : BorderCriterion::halves,
                                      .min_step = 1 + round % 3,
                                      .reach = round % 6,
                                      .rows = 1 + 2 * (round % 4),
                                      .cap = 5 + round};
    const cv::Mat1f expected = reference(left, right, disparity, parameters);
    cv::Mat1f one, many;
    with_threads(1, [&] { one = corrected(left, right, disparity, parameters); });
    with_threads(4, [&] { many = corrected(left, right, disparity, parameters); });
    ASSERT_EQ(cv::countNonZero(one != expected), 0) << round;
    ASSERT_EQ(cv::countNonZero(one != many), 0) << round;
    moved += cv::countNonZero(one != disparity);
  }
  EXPECT_GT(moved, 1000);
}

}  // namespace
}  // namespace iris::stereo
