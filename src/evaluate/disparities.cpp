#include "iris/evaluate/disparities.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "iris/core/error.h"

namespace iris::evaluate {
namespace {

bool is_known(float truth) { return truth > 0 && std::isfinite(truth); }

constexpr double kNothing = std::numeric_limits<double>::quiet_NaN();

double percent(int64_t part, int64_t whole) {
  return whole > 0 ? 100.0 * static_cast<double>(part) / static_cast<double>(whole) : kNothing;
}

// What is next to a pixel along one line: the jump's kind and its distance (0 = the pixel touches it).
struct NearestJump {
  int distance = std::numeric_limits<int>::max();
  int kind = -1;
  void offer(int d, int k) {
    if (d < distance || (d == distance && k < kind)) distance = d, kind = k;
  }
};

// Looks for jumps along a line of `n` pixels; rising: kind of a jump to a larger disparity (its object begins there).
template <class Truth, class Nearest>
void scan_line(int n, const Truth& truth, const Nearest& nearest, int rising, int falling,
               const DisparityOptions& options) {
  for (int a = -1, b = 0; b < n; ++b) {
    if (!is_known(truth(b))) continue;
    const bool jump = a >= 0 && b - a <= options.border_distance && std::abs(truth(b) - truth(a)) > options.border_jump;
    if (jump) {
      const int kind = truth(b) > truth(a) ? rising : falling;
      for (int i = 0; i < options.border_distance; ++i) {
        if (a - i >= 0) nearest(a - i).offer(i, kind);
        if (b + i < n) nearest(b + i).offer(i, kind);
      }
    }
    a = b;
  }
}

}  // namespace

void RegionScore::add(const RegionScore& other) {
  known += other.known;
  valid += other.valid;
  for (size_t i = 0; i < bad.size(); ++i) bad[i] += other.bad[i];
  outliers_kitti += other.outliers_kitti;
}
double RegionScore::density() const { return percent(valid, known); }
double RegionScore::wrong(size_t threshold) const { return percent(bad.at(threshold), known); }
double RegionScore::wrong_or_missing(size_t threshold) const {
  return percent(bad.at(threshold) + known - valid, known);
}

void SubpixelScore::add(double error) {
  ++valid;
  if (std::abs(error) > 1) return;
  ++count;
  sum += error;
  absolute_sum += std::abs(error);
  square_sum += error * error;
}
void SubpixelScore::add(const SubpixelScore& other) {
  valid += other.valid;
  count += other.count;
  sum += other.sum;
  absolute_sum += other.absolute_sum;
  square_sum += other.square_sum;
}
double SubpixelScore::mean() const { return count > 0 ? sum / static_cast<double>(count) : kNothing; }
double SubpixelScore::absolute() const { return count > 0 ? absolute_sum / static_cast<double>(count) : kNothing; }
double SubpixelScore::rms() const { return count > 0 ? std::sqrt(square_sum / static_cast<double>(count)) : kNothing; }

void DisparityScore::add(const DisparityScore& other) {
  images += other.images;
  all.add(other.all);
  visible.add(other.visible);
  occluded.add(other.occluded);
  at_borders.add(other.at_borders);
  elsewhere.add(other.elsewhere);
  has_occlusion |= other.has_occlusion;
  has_discontinuity |= other.has_discontinuity;
  has_origin |= other.has_origin;
  subpixel.add(other.subpixel);
  for (size_t i = 0; i < by_origin.size(); ++i) by_origin[i].add(other.by_origin[i]);
  for (size_t i = 0; i < by_fraction.size(); ++i) by_fraction[i].add(other.by_fraction[i]);
  for (size_t i = 0; i < borders.size(); ++i) {
    borders[i].possible += other.borders[i].possible;
    borders[i].wrong_object += other.borders[i].wrong_object;
    borders[i].wrong_background += other.borders[i].wrong_background;
  }
  for (size_t i = 0; i < histogram.size(); ++i) histogram[i] += other.histogram[i];
}

cv::Mat1b border_kinds(const cv::Mat1f& truth, const DisparityOptions& options) {
  const int w = truth.cols, h = truth.rows;
  std::vector<NearestJump> nearest(truth.total());
  const auto at = [&](int y, int x) -> NearestJump& { return nearest[static_cast<size_t>(y) * w + x]; };
  for (int y = 0; y < h; ++y) {
    scan_line(
        w, [&](int x) { return truth(y, x); }, [&](int x) -> NearestJump& { return at(y, x); }, kBorderLeft,
        kBorderRight, options);
  }
  for (int x = 0; x < w; ++x) {
    scan_line(
        h, [&](int y) { return truth(y, x); }, [&](int y) -> NearestJump& { return at(y, x); }, kBorderTop,
        kBorderBottom, options);
  }
  cv::Mat1b kinds(truth.size());
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) kinds(y, x) = static_cast<uint8_t>(at(y, x).kind + 1);
  }
  return kinds;
}

DisparityScore score_disparities(const DisparityImage& estimate, const cv::Mat1f& truth, const cv::Mat1b& occluded,
                                 const cv::Mat1b& discontinuity, const DisparityOptions& options) {
  const cv::Size size = truth.size();
  IRIS_CHECK(estimate.disparity.size() == size);
  IRIS_CHECK(estimate.origin.empty() || estimate.origin.size() == size);
  IRIS_CHECK(occluded.empty() || occluded.size() == size);
  IRIS_CHECK(discontinuity.empty() || discontinuity.size() == size);
  const cv::Mat1b kinds = border_kinds(truth, options);

  DisparityScore score;
  score.images = 1;
  score.has_occlusion = !occluded.empty();
  score.has_discontinuity = !discontinuity.empty();
  score.has_origin = !estimate.origin.empty();
  for (int y = 0; y < size.height; ++y) {
    for (int x = 0; x < size.width; ++x) {
      if (!is_known(truth(y, x))) continue;
      const double t = truth(y, x);
      double d = estimate.disparity(y, x);
      const bool valid = d > 0 && std::isfinite(d);
      if (options.round) d = std::round(d);
      const double error = d - t;

      RegionScore pixel{.known = 1, .valid = valid};
      for (size_t i = 0; i < kBadThresholds.size(); ++i) pixel.bad[i] = valid && std::abs(error) > kBadThresholds[i];
      pixel.outliers_kitti = valid && std::abs(error) > 3 && std::abs(error) > 0.05 * t;
      score.all.add(pixel);
      if (score.has_occlusion) (occluded(y, x) ? score.occluded : score.visible).add(pixel);
      const bool at_border = score.has_discontinuity ? discontinuity(y, x) != 0 : kinds(y, x) != 0;
      (at_border ? score.at_borders : score.elsewhere).add(pixel);

      const bool wrong = valid && std::abs(error) > 1;
      if (kinds(y, x) != 0) {
        BorderScore& border = score.borders.at(kinds(y, x) - 1u);
        ++border.possible;
        border.wrong_object += wrong && error > 0;
        border.wrong_background += wrong && error < 0;
      }
      if (!valid) continue;
      score.subpixel.add(error);
      auto origin = DisparityOrigin::measured;
      if (score.has_origin) {
        origin = static_cast<DisparityOrigin>(std::min<uint8_t>(4, estimate.origin(y, x)));
        score.by_origin.at(static_cast<size_t>(origin)).add(error);
      }
      if (origin == DisparityOrigin::measured) {
        const auto bin = static_cast<size_t>((t - std::floor(t)) * kFractionBins);
        score.by_fraction.at(std::min<size_t>(bin, kFractionBins - 1)).add(error);
      }
      const long bin = std::lround(std::clamp(error, -1e3, 1e3) * 10) + kHistogramBins / 2;
      ++score.histogram.at(static_cast<size_t>(std::clamp(bin, 0L, kHistogramBins - 1L)));
    }
  }
  return score;
}

cv::Mat3b error_picture(const cv::Mat1f& estimate, const cv::Mat1f& truth, const DisparityOptions& options) {
  IRIS_CHECK(estimate.size() == truth.size());
  const cv::Vec3d white(255, 255, 255), near_low(80, 170, 250), near_high(20, 20, 120);  // BGR
  const cv::Vec3d far_low(240, 190, 120), far_high(120, 30, 20);
  cv::Mat3b picture(truth.size());
  for (int y = 0; y < truth.rows; ++y) {
    for (int x = 0; x < truth.cols; ++x) {
      const double d = options.round ? std::round(estimate(y, x)) : estimate(y, x);
      cv::Vec3d colour = white;
      if (!is_known(truth(y, x))) {
        colour = cv::Vec3d::all(150);
      } else if (!(estimate(y, x) > 0)) {
        colour = cv::Vec3d::all(0);
      } else {
        const double error = d - truth(y, x), size = std::min(1.0, std::abs(error) / 4);
        const cv::Vec3d &low = error > 0 ? near_low : far_low, &high = error > 0 ? near_high : far_high;
        // A quarter of the scale (1 px) leads from white to the first colour.
        colour = size < 0.25 ? white + (low - white) * (4 * size) : low + (high - low) * ((size - 0.25) / 0.75);
      }
      picture(y, x) = cv::Vec3b(colour);
    }
  }
  return picture;
}

}  // namespace iris::evaluate
