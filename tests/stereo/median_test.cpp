#include "src/stereo/median.h"

#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "iris/core/parallel.h"
#include "support/simd_targets.h"

namespace iris::stereo {
namespace {

constexpr uchar kNone = 0, kMeasured = 1, kCorrected = 2, kWithin = 3, kBetween = 4;

TEST(PlainMedian, OfThoseWhoseNeighboursAreAllValid) {
  cv::RNG random(3);
  cv::Mat1f disparity(30, 40);
  for (float& d : disparity) d = random.uniform(0, 20) == 0 ? 0.0f : random.uniform(1.0f, 9.0f);
  const cv::Mat1f out = plain_median(disparity);
  for (int y = 0; y < disparity.rows; ++y) {
    for (int x = 0; x < disparity.cols; ++x) {
      std::vector<float> values;
      for (int v = y - 2; v <= y + 2; ++v) {
        for (int u = x - 2; u <= x + 2; ++u) {
          const bool inside = v >= 0 && u >= 0 && v < disparity.rows && u < disparity.cols;
          if (inside && disparity(v, u) > 0) values.push_back(disparity(v, u));
        }
      }
      std::sort(values.begin(), values.end());
      ASSERT_EQ(out(y, x), values.size() == 25 ? values[12] : disparity(y, x));
    }
  }
}

TEST(GuidedMedian, WeightsFallWithTheDifferenceOfGreyValues) {
  EXPECT_EQ(guide_weight(0, false), 160);
  EXPECT_EQ(guide_weight(0, true), 96);
  EXPECT_EQ(guide_weight(12, false), 100);
  EXPECT_EQ(guide_weight(32, false), 0);
  EXPECT_EQ(guide_weight(255, true), 0);
}

DisparityImage filtered(const cv::Mat1b& left, const DisparityImage& image) {
  DisparityImage out{image.disparity.clone(), image.origin.clone()};
  guided_median(left, out);
  return out;
}

// A dark object before a bright wall, its measured border 2 px too far out.
TEST(GuidedMedian, BordersFollowTheImage) {
  cv::Mat1b left(40, 60, uchar{200});
  left(cv::Rect(20, 10, 20, 20)) = 60;
  DisparityImage image{cv::Mat1f(left.size(), 4.25f), cv::Mat1b(left.size(), kMeasured)};
  cv::Mat1f truth = image.disparity.clone();
  truth(cv::Rect(20, 10, 20, 20)) = 12.5f;
  image.disparity(cv::Rect(18, 8, 24, 24)) = 12.5f;
  const DisparityImage out = filtered(left, image);
  EXPECT_EQ(cv::countNonZero(out.disparity != truth), 0);
  for (int y = 0; y < left.rows; ++y) {
    for (int x = 0; x < left.cols; ++x) {
      EXPECT_EQ(out.origin(y, x), truth(y, x) == image.disparity(y, x) ? kMeasured : kCorrected);
    }
  }
}

TEST(GuidedMedian, EqualsTheDefinitionWithAnyNumberOfThreads) {
  cv::RNG random(9);
  int changed = 0;
  for (int round = 0; round < 20; ++round) {
    const cv::Size size(random.uniform(1, 60), random.uniform(1, 40));
    cv::Mat1b left(size), origin(size);
    random.fill(left, cv::RNG::UNIFORM, 80, 120);
    DisparityImage image{cv::Mat1f(size), origin};
    for (int y = 0; y < size.height; ++y) {
      for (int x = 0; x < size.width; ++x) {
        const float base = (x / 17 + y / 13) % 2 == 0 ? 5.0f : 9.0f;
        const bool hole = random.uniform(0, 10) == 0;
        image.disparity(y, x) = hole ? 0.0f : base + random.uniform(-0.6f, 0.6f) + (random.uniform(0, 9) == 0 ? 3 : 0);
        origin(y, x) = hole ? kNone : static_cast<uchar>(random.uniform(kMeasured, kBetween + 1));
      }
    }
    DisparityImage one, many;
    with_threads(1, [&] { one = filtered(left, image); });
    testing::for_each_simd_target([&](const char* target) {
      const DisparityImage with = filtered(left, image);
      EXPECT_EQ(cv::countNonZero(with.disparity != one.disparity), 0) << target;
    });
    with_threads(4, [&] { many = filtered(left, image); });
    const auto inside = [&](int y, int x) { return y >= 0 && x >= 0 && y < size.height && x < size.width; };
    for (int y = 0; y < size.height; ++y) {
      for (int x = 0; x < size.width; ++x) {
        const float d = image.disparity(y, x);
        bool step = false;
        struct Entry {
          int bin, weight, distance;
          float disparity;
        };
        std::vector<Entry> entries;
        int total = 0;
        for (int v = y - 5; v <= y + 5; ++v) {
          for (int u = x - 5; u <= x + 5; ++u) {
            if (!inside(v, u) || !(image.disparity(v, u) > 0)) continue;
            const float other = image.disparity(v, u);
            for (const auto& [j, i] : {std::pair{0, 1}, std::pair{1, 0}, std::pair{0, -1}, std::pair{-1, 0}}) {
              if (!inside(v + j, u + i) || !(image.disparity(v + j, u + i) > 0)) continue;
              step |= std::abs(image.disparity(v + j, u + i) - other) > 1;
            }
            if ((u + v + x + y) % 2 != 0) continue;
            const int weight = guide_weight(std::abs(left(v, u) - left(y, x)), origin(v, u) >= kWithin);
            entries.push_back({static_cast<int>(std::lround(other)), weight, std::abs(u - x) + std::abs(v - y), other});
            total += weight;
          }
        }
        float expected = d;
        uchar expected_origin = origin(y, x);
        if (d > 0 && step) {
          std::stable_sort(entries.begin(), entries.end(),
                           [](const Entry& a, const Entry& b) { return a.bin < b.bin; });
          int median = 0, sum = 0;
          for (const Entry& entry : entries) {
            sum += entry.weight;
            median = entry.bin;
            if (2 * sum >= total) break;
          }
          if (std::abs(median - static_cast<int>(std::lround(d))) > 1) {
            int nearest = 1000;
            for (const Entry& entry : entries) {
              if (entry.bin != median || entry.distance >= nearest) continue;
              nearest = entry.distance;
              expected = entry.disparity;
            }
            if (expected_origin == kMeasured) expected_origin = kCorrected;
            ++changed;
          }
        }
        ASSERT_EQ(one.disparity(y, x), expected) << y << " " << x;
        ASSERT_EQ(one.origin(y, x), expected_origin);
        ASSERT_EQ(many.disparity(y, x), expected);
        ASSERT_EQ(many.origin(y, x), expected_origin);
      }
    }
  }
  EXPECT_GT(changed, 300);
}

}  // namespace
}  // namespace iris::stereo
