#include "iris/motion/track.h"

#include <Eigen/LU>
#include <algorithm>
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

uint32_t square_sum(const Square& a, const Square& inside) {
  uint32_t sum = 0;
  for (size_t i = 0; i < a.size(); ++i)
    sum += static_cast<uint32_t>(int32_t{a[i]} * int32_t{a[i]} * int32_t{inside[i]});
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
  Square blur{};    // a quarter of the second derivative along the direction of the blur
  Square inside{};  // 1 where the pixel belongs to the surface
};

bool sample_template(const cv::Mat1b& image, const Eigen::Vector2d& at, const Eigen::Matrix3d& from_from_to,
                     const TrackedSurface& surface, const Eigen::Vector2d& blur, Template& result) {
  constexpr int kSide = kTrackWindow + 2;  // one more on each side for the gradients
  constexpr int kReach = kHalf + 1;
  constexpr int kFar = 256;
  const Eigen::Matrix3d h = from_from_to / from_from_to(2, 2);
  // Within the square the denominator is linear, and so positive where its corners' are; images of lines are lines, so
  // that all samples lie between those of the corners.
  for (const int j : {-kReach, kReach}) {
    for (const int i : {-kReach, kReach}) {
      const Eigen::Vector3d p = h * Eigen::Vector3d(i, j, 1);
      if (!(p.z() > 0.5)) return false;
      const Eigen::Vector2d q = at + p.head<2>() / p.z();
      if (!(q.x() >= 0 && q.y() >= 0 && q.x() < image.cols - 1 && q.y() < image.rows - 1)) return false;
      if ((q - at).cwiseAbs().maxCoeff() >= kFar) return false;
    }
  }
  const Eigen::Matrix3f f = h.cast<float>();
  // Pixels are counted from one far to the upper left: then truncation is rounding down.
  const int left = static_cast<int>(at.x()) - kFar, top = static_cast<int>(at.y()) - kFar;
  const Eigen::Vector2f rest = (at - Eigen::Vector2d(left + kFar, top + kFar)).cast<float>();
  const auto slope_x = static_cast<float>(surface.slope.x()), slope_y = static_cast<float>(surface.slope.y());
  const auto plane = static_cast<float>(surface.at_point - surface.slope.dot(at - Eigen::Vector2d(left, top)));
  std::array<std::array<int16_t, kSide>, kSide> v, inside;
  for (auto& row : inside) row.fill(1);
  for (int j = 0; j < kSide; ++j) {
    constexpr int kWidth = 20;  // a whole number of vectors; what lies beyond the square is not used
    std::array<float, kWidth> fx, fy, upper_left{}, upper_right{}, lower_left{}, lower_right{};
    std::array<int32_t, kWidth> x, y, value;
    for (int i = 0; i < kWidth; ++i) {
      const float a = static_cast<float>(i - kReach), b = static_cast<float>(j - kReach);
      const float scale = 1 / (f(2, 0) * a + f(2, 1) * b + 1);
      const float px = rest.x() + (f(0, 0) * a + f(0, 1) * b + f(0, 2)) * scale;
      const float py = rest.y() + (f(1, 0) * a + f(1, 1) * b + f(1, 2)) * scale;
      x[i] = static_cast<int32_t>(px + kFar);
      y[i] = static_cast<int32_t>(py + kFar);
      fx[i] = px - static_cast<float>(x[i] - kFar);
      fy[i] = py - static_cast<float>(y[i] - kFar);
    }
    for (int i = 0; i < kSide; ++i) {
      const uint8_t* above = image[top + y[i]] + left + x[i];
      const uint8_t* below = above + image.step[0];
      upper_left[i] = above[0];
      upper_right[i] = above[1];
      lower_left[i] = below[0];
      lower_right[i] = below[1];
    }
    for (int i = 0; i < kWidth; ++i) {
      const float upper = upper_left[i] + fx[i] * (upper_right[i] - upper_left[i]);
      const float lower = lower_left[i] + fx[i] * (lower_right[i] - lower_left[i]);
      value[i] = static_cast<int32_t>(kScale * (upper + fy[i] * (lower - upper)) + 0.5f);
    }
    for (int i = 0; i < kSide; ++i) v[j][i] = static_cast<int16_t>(value[i]);
    if (surface.disparity == nullptr) continue;
    for (int i = 0; i < kSide; ++i) {
      const int nearest_x = x[i] + (fx[i] >= 0.5f ? 1 : 0), nearest_y = y[i] + (fy[i] >= 0.5f ? 1 : 0);
      const float d = (*surface.disparity)(top + nearest_y, left + nearest_x);
      const float expected = plane + slope_x * static_cast<float>(nearest_x) + slope_y * static_cast<float>(nearest_y);
      inside[j][i] = !(d > 0) || std::abs(d - expected) <= kSameSurface ? 1 : 0;
    }
  }
  for (int j = 0; j < kTrackWindow; ++j) {
    for (int i = 0; i < kTrackWindow; ++i) {
      const int16_t in = inside[j + 1][i + 1];
      result.inside[j * kRow + i] = in;
      result.values[j * kRow + i] = static_cast<int16_t>(in * v[j + 1][i + 1]);
      result.dx[j * kRow + i] = static_cast<int16_t>(in * ((v[j + 1][i + 2] - v[j + 1][i]) / 2));
      result.dy[j * kRow + i] = static_cast<int16_t>(in * ((v[j + 2][i + 1] - v[j][i + 1]) / 2));
    }
  }
  if (blur.isZero()) return true;
  // A little more blur along a line adds to an image its second derivative along that line.
  const Eigen::Vector2f along = blur.normalized().cast<float>();
  const float xx = along.x() * along.x() / 4, yy = along.y() * along.y() / 4, xy = along.x() * along.y() / 8;
  constexpr float kMost = 127 * kScale;  // as large as a difference of first order, so that sums fit
  for (int j = 0; j < kTrackWindow; ++j) {
    for (int i = 0; i < kTrackWindow; ++i) {
      const int middle = 2 * v[j + 1][i + 1];
      const float second = xx * static_cast<float>(v[j + 1][i] + v[j + 1][i + 2] - middle) +
                           yy * static_cast<float>(v[j][i + 1] + v[j + 2][i + 1] - middle) +
                           xy * static_cast<float>(v[j][i] + v[j + 2][i + 2] - v[j][i + 2] - v[j + 2][i]);
      const float rounded = std::min(std::max(second, -kMost), kMost) + (second < 0 ? -0.5f : 0.5f);
      result.blur[j * kRow + i] = static_cast<int16_t>(static_cast<int16_t>(rounded) * inside[j + 1][i + 1]);
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

// Sums over the square in `to`, as far as it shows the surface, and over its products with the template; that with the
// blur is left to the caller.
struct Sums {
  int32_t values = 0, dx = 0, dy = 0, both = 0, blur = 0;
};

Sums sums_of(const Square& square, const Template& t) {
  Sums sums;
  for (size_t i = 0; i < square.size(); ++i) {
    const int32_t v = square[i];
    sums.values += v * int32_t{t.inside[i]};
    sums.dx += v * int32_t{t.dx[i]};
    sums.dy += v * int32_t{t.dy[i]};
    sums.both += v * int32_t{t.values[i]};
  }
  return sums;
}

PatchTrack track(const cv::Mat1b& from, const Eigen::Vector2d& at, const cv::Mat1b& to, const Eigen::Vector2d& start,
                 const Eigen::Matrix3d& to_from_from, const TrackedSurface& surface, const Eigen::Vector2d& blur,
                 bool along_row) {
  constexpr int kSteps = 20;
  constexpr double kRest = 0.005;  // [px] a step below this changes nothing
  constexpr double kFlat = 1.0;    // [(grey levels/px)^2] least mean squared gradient any way
  constexpr double kFaint = 0.25;  // what shows the square with less contrast than this part does not show it
  constexpr int kLeast = kTrackWindow * kTrackWindow / 3;
  PatchTrack result;
  Template t;
  if (!(std::abs(to_from_from.topLeftCorner<2, 2>().determinant()) > 0.1) ||
      !sample_template(from, at, to_from_from.inverse(), surface, blur, t)) {
    return result;
  }
  const double count = value_sum(t.inside);
  if (count < kLeast) return result;
  // Around their mean, the template's values have no more than half of their range, and all sums below fit 32 bits.
  const auto middle = static_cast<int16_t>(std::lround(value_sum(t.values) / count));
  for (int j = 0; j < kTrackWindow; ++j) {
    for (int i = 0; i < kTrackWindow; ++i) {
      const int k = j * kRow + i;
      t.values[k] = static_cast<int16_t>(t.values[k] - middle * t.inside[k]);
    }
  }
  // Normal equations of the offset (dx, dy), the contrast and the blur; the brightness is eliminated by the means.
  const std::array<const Square*, 4> columns = {&t.dx, &t.dy, &t.values, &t.blur};
  const int unknowns = blur.isZero() ? 3 : 4;
  Eigen::Vector4d sum = Eigen::Vector4d::Zero();
  Eigen::Matrix4d products = Eigen::Matrix4d::Zero();
  for (int i = 0; i < unknowns; ++i) {
    sum(i) = value_sum(*columns[i]);
    for (int k = 0; k <= i; ++k) products(i, k) = products(k, i) = product_sum(*columns[i], *columns[k]);
  }
  const Eigen::Matrix4d centred = products - sum * sum.transpose() / count;
  Eigen::Matrix4d normal = centred;
  const double xx = normal(0, 0), xy = normal(0, 1), yy = normal(1, 1);
  const double smallest = along_row ? xx : (xx + yy) / 2 - std::hypot((xx - yy) / 2, xy);
  if (!(smallest > kFlat * kScale * kScale * count)) return result;
  if (along_row) {
    normal.row(1).setZero();
    normal.col(1).setZero();
    normal(1, 1) = 1;
  }
  // Blur looks like less contrast where the texture is a wave: then it is not looked for. By noise of 2 grey levels and
  // a difference of the blurs of a pixel.
  constexpr double kLittleBlur = 2 * kScale;
  normal(3, 3) += kLittleBlur * kLittleBlur;
  const Eigen::Matrix4d inverse = normal.inverse();

  Eigen::Vector2d p = start;
  Square square{};
  for (int step = 0; step < kSteps; ++step) {
    if (!sample_square(to, p, square)) return result;
    Sums sums = sums_of(square, t);
    if (unknowns == 4) sums.blur = product_sum(square, t.blur);
    // Of the products with the square and, for the offset, with the difference between square and template.
    const Eigen::Vector4d with_square =
        Eigen::Vector4d(sums.dx, sums.dy, sums.both, sums.blur) - sums.values / count * sum;
    Eigen::Vector4d gradient = with_square - centred.col(2);
    if (along_row) gradient(1) = 0;
    const Eigen::Vector4d move = -inverse * gradient;
    p += move.head<2>();
    if (!((p - start).norm() <= kHalf)) return result;
    if (move.head<2>().norm() >= kRest) continue;
    const double values = sums.values, of_square = square_sum(square, t.inside) - values * values / count;
    const Eigen::Vector2d weights(1 - move(2), -move(3));  // of the template and its blur in the square
    const double contrast = weights(0);
    if (!(contrast > kFaint)) return result;
    const double residual =
        of_square - 2 * weights.dot(with_square.tail<2>()) + weights.dot(centred.bottomRightCorner<2, 2>() * weights);
    return {.found = true,
            .position = p,
            .similarity = with_square(2) / std::sqrt(std::max(centred(2, 2) * of_square, 1.0)),
            .covariance = std::max(residual, 0.0) / (count * contrast * contrast) * inverse.topLeftCorner<2, 2>()};
  }
  return result;
}

}  // namespace

PatchTrack track_patch(const cv::Mat1b& from, const Eigen::Vector2d& at, const cv::Mat1b& to,
                       const Eigen::Vector2d& start, const Eigen::Matrix3d& to_from_from, const TrackedSurface& surface,
                       const Eigen::Vector2d& blur) {
  return track(from, at, to, start, to_from_from, surface, blur, false);
}

PatchTrack track_patch(const cv::Mat1b& from, const Eigen::Vector2d& at, const cv::Mat1b& to,
                       const Eigen::Vector2d& start, const Eigen::Matrix2d& to_from_from) {
  Eigen::Matrix3d warp = Eigen::Matrix3d::Identity();
  warp.topLeftCorner<2, 2>() = to_from_from;
  return track(from, at, to, start, warp, {}, Eigen::Vector2d::Zero(), false);
}

PatchTrack track_along_row(const cv::Mat1b& from, const Eigen::Vector2d& at, const cv::Mat1b& to,
                           const Eigen::Vector2d& start, const Eigen::Matrix3d& to_from_from,
                           const TrackedSurface& surface, const Eigen::Vector2d& blur) {
  return track(from, at, to, start, to_from_from, surface, blur, true);
}

}  // namespace iris::motion
