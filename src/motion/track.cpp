#include "iris/motion/track.h"

#include <Eigen/LU>
#include <array>
#include <cmath>
#include <cstdint>

namespace iris::motion {
namespace {

constexpr int kHalf = kTrackWindow / 2;
constexpr int kRow = 16;      // values a row: a whole number of vectors; the last is 0
constexpr float kScale = 16;  // steps a grey level: sums of products of two such values over the square fit 32 bits

using Square = std::array<int16_t, kTrackWindow * kRow>;

int32_t product_sum(const Square& a, const Square& b) {
  int32_t sum = 0;
  for (size_t i = 0; i < a.size(); ++i) sum += int32_t{a[i]} * int32_t{b[i]};
  return sum;
}

int32_t value_sum(const Square& a) {
  int32_t sum = 0;
  for (const int16_t v : a) sum += v;
  return sum;
}

// The surroundings of `from` at `at` as they appear in `to`, and their gradients.
struct Template {
  Square values{}, dx{}, dy{};
};

bool sample_template(const cv::Mat1b& image, const Eigen::Vector2d& at, const Eigen::Matrix2d& from_from_to,
                     Template& result) {
  constexpr int kSide = kTrackWindow + 2;  // one more on each side for the gradients
  constexpr int kReach = kHalf + 1;
  const Eigen::Vector2d reach = from_from_to.cwiseAbs() * Eigen::Vector2d::Constant(kReach);
  if (!(at.x() - reach.x() >= 0 && at.y() - reach.y() >= 0 && at.x() + reach.x() < image.cols - 1 &&
        at.y() + reach.y() < image.rows - 1)) {
    return false;
  }
  std::array<std::array<int16_t, kSide>, kSide> v;
  for (int j = 0; j < kSide; ++j) {
    for (int i = 0; i < kSide; ++i) {
      const Eigen::Vector2d p = at + from_from_to * Eigen::Vector2d(i - kReach, j - kReach);
      const int x = static_cast<int>(p.x()), y = static_cast<int>(p.y());
      const float fx = static_cast<float>(p.x() - x), fy = static_cast<float>(p.y() - y);
      const uint8_t *above = image[y] + x, *below = image[y + 1] + x;
      const float top = above[0] + fx * static_cast<float>(above[1] - above[0]);
      const float bottom = below[0] + fx * static_cast<float>(below[1] - below[0]);
      v[j][i] = static_cast<int16_t>(kScale * (top + fy * (bottom - top)) + 0.5f);
    }
  }
  for (int j = 0; j < kTrackWindow; ++j) {
    for (int i = 0; i < kTrackWindow; ++i) {
      result.values[j * kRow + i] = v[j + 1][i + 1];
      result.dx[j * kRow + i] = static_cast<int16_t>((v[j + 1][i + 2] - v[j + 1][i]) / 2);
      result.dy[j * kRow + i] = static_cast<int16_t>((v[j + 2][i + 1] - v[j][i + 1]) / 2);
    }
  }
  return true;
}

// The square around p, bilinear.
bool sample_square(const cv::Mat1b& image, const Eigen::Vector2d& p, Square& result) {
  if (!(p.x() >= kHalf && p.y() >= kHalf && p.x() < image.cols - 1 - kHalf && p.y() < image.rows - 1 - kHalf)) {
    return false;
  }
  const int x = static_cast<int>(p.x()), y = static_cast<int>(p.y());
  const float fx = static_cast<float>(p.x() - x), fy = static_cast<float>(p.y() - y);
  const float w00 = kScale * (1 - fx) * (1 - fy), w01 = kScale * fx * (1 - fy), w10 = kScale * (1 - fx) * fy,
              w11 = kScale * fx * fy;
  for (int j = 0; j < kTrackWindow; ++j) {
    const uint8_t *above = image[y - kHalf + j] + x - kHalf, *below = image[y - kHalf + j + 1] + x - kHalf;
    int16_t* out = result.data() + j * kRow;
    for (int i = 0; i < kTrackWindow; ++i) {
      const float v = w00 * above[i] + w01 * above[i + 1] + w10 * below[i] + w11 * below[i + 1];
      out[i] = static_cast<int16_t>(v + 0.5f);
    }
  }
  return true;
}

}  // namespace

PatchTrack track_patch(const cv::Mat1b& from, const Eigen::Vector2d& at, const cv::Mat1b& to,
                       const Eigen::Vector2d& start, const Eigen::Matrix2d& to_from_from) {
  constexpr int kSteps = 20;
  constexpr double kRest = 0.005;  // [px] a step below this changes nothing
  constexpr double kFlat = 1.0;    // [(grey levels/px)^2] least mean squared gradient any way
  constexpr double kCount = kTrackWindow * kTrackWindow;
  PatchTrack result;
  Template t;
  if (!(std::abs(to_from_from.determinant()) > 0.1) || !sample_template(from, at, to_from_from.inverse(), t)) {
    return result;
  }
  // Normal equations of the offset (dx, dy) and of the brightness, which is eliminated by its mean.
  const double sx = value_sum(t.dx), sy = value_sum(t.dy), st = value_sum(t.values);
  const double xx = product_sum(t.dx, t.dx) - sx * sx / kCount, xy = product_sum(t.dx, t.dy) - sx * sy / kCount,
               yy = product_sum(t.dy, t.dy) - sy * sy / kCount;
  const double det = xx * yy - xy * xy;
  const double smallest = (xx + yy) / 2 - std::hypot((xx - yy) / 2, xy);
  if (!(smallest > kFlat * kScale * kScale * kCount)) return result;

  Eigen::Vector2d p = start;
  Square square{}, difference{};
  for (int step = 0; step < kSteps; ++step) {
    if (!sample_square(to, p, square)) return result;
    for (size_t i = 0; i < square.size(); ++i) difference[i] = static_cast<int16_t>(square[i] - t.values[i]);
    const double mean = value_sum(difference) / kCount;
    const double gx = product_sum(t.dx, difference) - mean * sx, gy = product_sum(t.dy, difference) - mean * sy;
    const Eigen::Vector2d move(-(yy * gx - xy * gy) / det, -(xx * gy - xy * gx) / det);
    p += move;
    if (!((p - start).norm() <= kHalf)) return result;
    if (move.norm() < kRest) {
      const double ss = value_sum(square);
      // Squares of values do not fit 32 bits, those of differences from a value within the range do.
      double both = 0, of_template = 0, of_square = 0;
      for (size_t i = 0; i < square.size(); ++i) {
        if (i % kRow == kTrackWindow) continue;
        const double a = t.values[i] - st / kCount, b = square[i] - ss / kCount;
        both += a * b;
        of_template += a * a;
        of_square += b * b;
      }
      result = {.found = true, .position = p, .similarity = both / std::sqrt(std::max(of_template * of_square, 1.0))};
      return result;
    }
  }
  return result;
}

}  // namespace iris::motion
