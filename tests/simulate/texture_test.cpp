#include "src/simulate/texture.h"

#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/imgproc.hpp>

#include "iris/core/parallel.h"
#include "iris/simulate/scene.h"

namespace iris::simulate {
namespace {

struct Sample {
  const char* name;
  Texture texture;
  double contrast;  // grey levels
};

std::vector<Sample> surfaces() {
  return {{"plaster", plaster(1, {186, 212, 222}, 0.075), 9},
          {"wallpaper", wallpaper(2, {196, 214, 218}, {128, 158, 142}), 9},
          {"tiles", tiles(3, {205, 212, 208}, {196, 176, 150}, 0.15, 96), 9},
          {"brick", brick(4, {82, 108, 168}), 15},
          {"parquet", parquet(5, {98, 142, 182}), 10},
          {"wood", wood(6, {95, 145, 190}), 7},
          {"fabric", fabric(7, {85, 125, 82}, {150, 190, 170}), 8},
          {"carpet", carpet(8, {140, 120, 104}, {172, 158, 138}), 8},
          {"granite", granite(9, {105, 110, 112}), 8},
          {"grass", grass(10), 8},
          {"paving", paving(11), 12},
          {"bark", bark(12), 8}};
}

cv::Mat1b grey_of(const cv::Mat3b& image) {
  cv::Mat1b grey;
  cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);
  return grey;
}

double deviation(const cv::Mat& image) {
  cv::Scalar mean, deviation;
  cv::meanStdDev(image, mean, deviation);
  return deviation[0];
}

// What a camera sees of it from about 2 m: the mean over about 4 mm.
cv::Mat seen(const cv::Mat3b& image) {
  cv::Mat blurred;
  cv::GaussianBlur(grey_of(image), blurred, {}, 1.2, 1.2);
  return blurred;
}

TEST(Texture, HasContrastAfterTheBlurOfALens) {
  for (const Sample& sample : surfaces()) {
    EXPECT_GT(deviation(seen(sample.texture.image)), sample.contrast) << sample.name;
    // Everywhere: in nine of ten windows of about 0.1 x 0.1 m it is above twice the noise of a camera with 45 dB
    // (1.43).
    const cv::Mat image = seen(sample.texture.image);
    const int edge = std::min({40, image.rows, image.cols});
    int windows = 0, weak = 0;
    for (int y = 0; y + edge <= image.rows; y += edge) {
      for (int x = 0; x + edge <= image.cols; x += edge, ++windows) weak += deviation(image({x, y, edge, edge})) < 2.9;
    }
    EXPECT_LE(weak, windows / 10) << sample.name << ": " << weak << " of " << windows;
  }
}

// Mean absolute difference of neighbours over a seam and between lines elsewhere.
TEST(Texture, TilesWithoutASeam) {
  for (const Sample& sample : surfaces()) {
    const cv::Mat1b grey = grey_of(sample.texture.image);
    // A border of bricks or tiles lies at the seam; such borders lie elsewhere as well: compare with the worst line.
    const auto columns = [&](int a, int b) { return cv::norm(grey.col(a), grey.col(b), cv::NORM_L1) / grey.rows; };
    const auto rows = [&](int a, int b) { return cv::norm(grey.row(a), grey.row(b), cv::NORM_L1) / grey.cols; };
    double worst_column = 0, worst_row = 0;
    for (int x = 0; x + 1 < grey.cols; ++x) worst_column = std::max(worst_column, columns(x, x + 1));
    for (int y = 0; y + 1 < grey.rows; ++y) worst_row = std::max(worst_row, rows(y, y + 1));
    EXPECT_LE(columns(grey.cols - 1, 0), 1.3 * worst_column) << sample.name;
    EXPECT_LE(rows(grey.rows - 1, 0), 1.3 * worst_row) << sample.name;
  }
}

TEST(Texture, NoiseHasTheStatedMomentsAndIsTheSameForAnyNumberOfThreads) {
  const auto make = [] { return fractal_noise(200, 120, octaves(200, 120, 64, 4), 5); };
  const cv::Mat1f noise = make();
  cv::Scalar mean, deviation;
  cv::meanStdDev(noise, mean, deviation);
  EXPECT_NEAR(mean[0], 0, 1e-4);
  EXPECT_NEAR(deviation[0], 1, 1e-4);
  cv::Mat1f one, three;
  with_threads(1, [&] { one = make(); });
  with_threads(3, [&] { three = make(); });
  EXPECT_EQ(cv::norm(one, three, cv::NORM_INF), 0);
  EXPECT_GT(cv::norm(one, fractal_noise(200, 120, octaves(200, 120, 64, 4), 6), cv::NORM_INF), 0.5);
}

TEST(Texture, TheRepetitiveOneRepeatsExactlyAndIsNotPlain) {
  const Texture texture = stripes({205, 214, 222}, {150, 120, 95}, 0.09);
  EXPECT_DOUBLE_EQ(texture.width, 0.09);
  EXPECT_GT(deviation(grey_of(texture.image)), 20);
}

TEST(Texture, RandomNumbersAreUniform) {
  Random random(3);
  double sum = 0, square = 0;
  constexpr int kCount = 100000;
  for (int i = 0; i < kCount; ++i) {
    const double x = random.uniform();
    ASSERT_GE(x, 0);
    ASSERT_LT(x, 1);
    sum += x;
    square += x * x;
  }
  // Four standard errors of mean and mean square.
  EXPECT_NEAR(sum / kCount, 0.5, 4 * std::sqrt(1.0 / 12 / kCount));
  EXPECT_NEAR(square / kCount, 1.0 / 3, 4 * std::sqrt(4.0 / 45 / kCount));
}

// Written down once: other machines, compilers and versions must give the same.
TEST(Texture, TheBytesAreThoseOfOtherMachines) {
  EXPECT_EQ(hash(1, 2, 3, 4), 0x2AB683F3u);
  EXPECT_EQ(hash(0, 0), 0x4788BB9Eu);
  const auto sum = [](const cv::Mat3b& image) {
    uint64_t h = 1469598103934665603ull;
    for (const cv::Vec3b& pixel : image) {
      for (int i = 0; i < 3; ++i) h = (h ^ pixel[i]) * 1099511628211ull;
    }
    return h;
  };
  EXPECT_EQ(sum(plaster(1, {186, 212, 222}, 0.075, {0.64, 0.64}).image), 0x6AD611D07AD756B7u);
  EXPECT_EQ(sum(landscape(2, 0.5, 0.4).image), 0x89FED2713E53B34Fu);
}

TEST(Texture, BooksLieSideBySide) {
  const BookBacks backs = book_backs(4);
  ASSERT_GT(backs.starts.size(), 30u);
  EXPECT_EQ(backs.starts.front(), 0);
  EXPECT_DOUBLE_EQ(backs.starts.back(), backs.texture.width);
  for (size_t i = 0; i + 1 < backs.starts.size(); ++i) EXPECT_GT(backs.starts[i + 1] - backs.starts[i], 0.015);
}

}  // namespace
}  // namespace iris::simulate
