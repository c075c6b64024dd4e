#include "src/motion/corner_kernels.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstring>
#include <random>

#include "iris/core/parallel.h"
#include "support/simd_targets.h"

namespace iris::motion {
namespace {

cv::Mat1b noise_image(int width, int height, unsigned seed) {
  std::mt19937_64 random(seed);
  cv::Mat1b image(height, width);
  for (uint8_t& v : image) v = static_cast<uint8_t>(random() & 255);
  return image;
}

bool equal_bits(const cv::Mat1f& a, const cv::Mat1f& b) {
  if (a.size() != b.size()) return false;
  for (int y = 0; y < a.rows; ++y)
    if (std::memcmp(a[y], b[y], sizeof(float) * static_cast<size_t>(a.cols)) != 0) return false;
  return true;
}

// One number after the other, in single precision as the vectors have it.
cv::Mat1f plain_harris(const cv::Mat1b& image) {
  std::array<float, 6> gaussian;
  double sum = 0;
  for (int k = -5; k <= 5; ++k) sum += std::exp(-k * k / 8.0);
  for (int k = 0; k <= 5; ++k) gaussian[k] = static_cast<float>(std::exp(-k * k / 8.0) / sum);
  const auto smoothed = [&](const auto& at) {
    float total = gaussian[0] * at(0);
    for (int k = 1; k <= 5; ++k) total += gaussian[k] * (at(-k) + at(k));
    return total;
  };
  const auto product = [&](int x, int y, int which) {
    const auto g = [&](int u, int v) { return static_cast<int>(image(y + v, x + u)); };
    const float dx = static_cast<float>(g(1, -1) + 2 * g(1, 0) + g(1, 1) - g(-1, -1) - 2 * g(-1, 0) - g(-1, 1));
    const float dy = static_cast<float>(g(-1, 1) + 2 * g(0, 1) + g(1, 1) - g(-1, -1) - 2 * g(0, -1) - g(1, -1));
    return which == 0 ? dx * dx : which == 1 ? dx * dy : dy * dy;
  };
  cv::Mat1f across[3], response(image.size(), 0.0f);
  for (int which = 0; which < 3; ++which) {
    across[which] = cv::Mat1f(image.size(), 0.0f);
    for (int y = 1; y < image.rows - 1; ++y) {
      for (int x = 6; x < image.cols - 6; ++x) {
        across[which](y, x) = smoothed([&](int k) { return product(x + k, y, which); });
      }
    }
  }
  for (int y = 6; y < image.rows - 6; ++y) {
    for (int x = 6; x < image.cols - 6; ++x) {
      float m[3];
      for (int which = 0; which < 3; ++which) m[which] = smoothed([&](int k) { return across[which](y + k, x); });
      const float trace = m[0] + m[2];
      response(y, x) = (m[0] * m[2] - m[1] * m[1] - 0.04f * (trace * trace)) * (1.0f / 4096);
    }
  }
  return response;
}

TEST(HarrisResponse, HasTheSameBitsWithEveryInstructionSetAndNumberOfThreads) {
  // Narrower than a vector, a part of a tile, several tiles; several chunks of rows.
  for (const auto& [width, height] : {std::pair{14, 13}, {12, 40}, {40, 12}, {151, 300}, {333, 50}}) {
    const cv::Mat1b whole = noise_image(width + 5, height, 1);
    const cv::Mat1b image = whole.colRange(2, width + 2);  // rows that do not follow each other in memory
    const cv::Mat1f expected = plain_harris(image);
    testing::for_each_simd_target([&](const char* target) {
      for (const int threads : {1, 2}) {
        with_threads(threads, [&] {
          EXPECT_TRUE(equal_bits(harris_response(image), expected)) << target << " " << width << "x" << height;
        });
      }
    });
  }
}

TEST(LocalMaxima, AreThoseOfTheDefinition) {
  for (const auto& [width, height, border] :
       {std::tuple{50, 30, 1}, {19, 9, 1}, {70, 40, 13}, {3, 3, 1}, {20, 40, 10}}) {
    cv::Mat1f values(height, width);
    std::mt19937_64 random(7);
    for (float& v : values) v = static_cast<float>(random() % 6);  // many are equal
    std::vector<Maximum> expected;
    for (int y = border; y < height - border; ++y) {
      for (int x = border; x < width - border; ++x) {
        bool is_maximum = values(y, x) >= 3;
        for (int v = -1; v <= 1; ++v) {
          for (int u = -1; u <= 1; ++u) {
            const bool earlier = v < 0 || (v == 0 && u < 0);
            is_maximum &= (u == 0 && v == 0) ||
                          (earlier ? values(y, x) > values(y + v, x + u) : values(y, x) >= values(y + v, x + u));
          }
        }
        if (is_maximum) expected.push_back({x, y, values(y, x)});
      }
    }
    testing::for_each_simd_target([&](const char* target) {
      const std::vector<Maximum> found = local_maxima(values, 3, border);
      ASSERT_EQ(found.size(), expected.size()) << target;
      for (size_t i = 0; i < found.size(); ++i) {
        EXPECT_EQ(found[i].x, expected[i].x) << target;
        EXPECT_EQ(found[i].y, expected[i].y) << target;
        EXPECT_EQ(found[i].value, expected[i].value) << target;
      }
    });
  }
}

TEST(RankOfSquare, EqualsTheDefinitionWithEveryInstructionSet) {
  for (const int levels : {2, 10, 256}) {  // with many equal values too
    cv::Mat1b image = noise_image(31, 29, 3);
    for (uint8_t& v : image) v = static_cast<uint8_t>(v % levels);
    testing::for_each_simd_target([&](const char* target) {
      const RankPatch patch = rank_of_square(image[1] + 2, static_cast<ptrdiff_t>(image.step[0]));
      for (int row = 0; row < kPatchSize; ++row) {
        for (int column = 0; column < kPatchSize; ++column) {
          const int x = 2 + column + 5, y = 1 + row + 5;
          int darker = 0;
          for (int v = -5; v <= 5; ++v)
            for (int u = -5; u <= 5; ++u) darker += image(y + v, x + u) < image(y, x);
          ASSERT_EQ(patch[row * kPatchSize + column], darker) << target;
        }
      }
      for (size_t i = kPatchSize * kPatchSize; i < patch.size(); ++i) EXPECT_EQ(patch[i], 0);
    });
  }
}

TEST(NearestPatches, AreThoseOfPlainComparison) {
  std::mt19937_64 random(5);
  const auto patches = [&](int count, int levels) {
    std::vector<RankPatch> result(count, RankPatch{});
    for (RankPatch& patch : result)
      for (int i = 0; i < kPatchSize * kPatchSize; ++i) patch[i] = static_cast<uint8_t>(random() % levels);
    return result;
  };
  // Fewer than lanes, no multiples of them, several chunks; 256 levels: the largest differences.
  for (const auto& [n_a, n_b] : {std::pair{1, 1}, {3, 9}, {13, 2}, {40, 67}, {300, 31}}) {
    std::vector<RankPatch> a = patches(n_a, 256), b = patches(n_b, 256);
    b.back() = a.front();
    a.back() = a[a.size() / 2];  // equals: the lower index counts
    NearestPatches expected{.of_a = std::vector<NearestPatch>(a.size(), {1 << 30, -1}),
                            .of_b = std::vector<NearestPatch>(b.size(), {1 << 30, -1})};
    for (int i = 0; i < n_a; ++i) {
      for (int j = 0; j < n_b; ++j) {
        int sum = 0;
        for (size_t k = 0; k < a[i].size(); ++k) sum += std::abs(a[i][k] - b[j][k]);
        if (sum < expected.of_a[i].difference) expected.of_a[i] = {sum, j};
        if (sum < expected.of_b[j].difference) expected.of_b[j] = {sum, i};
      }
    }
    testing::for_each_simd_target([&](const char* target) {
      const NearestPatches nearest = nearest_patches(a, b);
      for (int i = 0; i < n_a; ++i) {
        ASSERT_EQ(nearest.of_a[i].index, expected.of_a[i].index) << target;
        ASSERT_EQ(nearest.of_a[i].difference, expected.of_a[i].difference) << target;
      }
      for (int j = 0; j < n_b; ++j) {
        ASSERT_EQ(nearest.of_b[j].index, expected.of_b[j].index) << target;
        ASSERT_EQ(nearest.of_b[j].difference, expected.of_b[j].difference) << target;
      }
    });
  }
  const NearestPatches none = nearest_patches(patches(4, 9), {});
  ASSERT_EQ(none.of_a.size(), 4u);
  EXPECT_EQ(none.of_a[0].index, -1);
}

}  // namespace
}  // namespace iris::motion
