#include "iris/reconstruct/fusion.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "iris/core/error.h"

namespace iris::reconstruct {

void FusionOptions::declare(OptionSet& set) {
  set.section("cloud");
  set.add("pixel_error", pixel_error, "px", 0.001, 10,
          "error of image coordinates; how much larger the recording's errors are is measured by its views against "
          "each other");
  set.add("min_disparity", min_disparity, "px", 0.5, 1000,
          "leaves out points of smaller disparity: they are far away and uncertain");
  set.add("max_range", max_range, "m", 0.1, 10000,
          "leaves out points farther than this from their camera; their error grows with the square of the distance");
  set.add("step", step, "px", 1, 64, "every n-th row and column of a view gives points: faster, fewer points");
  set.add("neighbours", neighbours, "", 0, 100,
          "other views that each view is compared with; more are slower and tell more wrong points; 0 = none, every "
          "point of every view is kept");
  set.add("gate", gate, "", 0.5, 20,
          "standard deviations up to which two views are taken to measure the same surface; one that looks through by "
          "more says that nothing is there");
}

namespace {

constexpr float kJump = 2;  // [px] neighbouring disparities that differ by more belong to two surfaces (thesis 7.3)

// Slope of the disparity over a window, by least squares; 0 where too little is known.
class SlopeFinder {
 public:
  explicit SlopeFinder(const DisparityImage& image) : image_(image) {}

  Eigen::Vector2f at(int y, int x, float d) const {
    constexpr int kReach = 6, kStride = 3;  // [px]
    Eigen::Matrix3f a = Eigen::Matrix3f::Zero();
    Eigen::Vector3f b = Eigen::Vector3f::Zero();
    int count = 0;
    for (int dy = -kReach; dy <= kReach; dy += kStride) {
      const int yy = y + dy;
      if (yy < 0 || yy >= image_.disparity.rows) continue;
      for (int dx = -kReach; dx <= kReach; dx += kStride) {
        const int xx = x + dx;
        if (xx < 0 || xx >= image_.disparity.cols) continue;
        const float other = image_.at(yy, xx, DisparityOrigin::within_segment);
        if (other <= 0 || std::abs(other - d) > kJump) continue;
        const Eigen::Vector3f row(static_cast<float>(dx), static_cast<float>(dy), 1);
        a += row * row.transpose();
        b += row * (other - d);
        ++count;
      }
    }
    constexpr int kEnough = 8;
    if (count < kEnough) return Eigen::Vector2f::Zero();
    // A weak pull to no slope keeps windows regular in which all pixels lie on one line.
    a(0, 0) += 1;
    a(1, 1) += 1;
    return a.ldlt().solve(b).head<2>();
  }

 private:
  const DisparityImage& image_;
};

// Disparity between four pixels of one surface; 0 if one is missing or they are of two.
float disparity_between(const DisparityImage& image, double x, double y) {
  const int x0 = static_cast<int>(std::floor(x)), y0 = static_cast<int>(std::floor(y));
  if (x0 < 0 || y0 < 0 || x0 + 1 >= image.disparity.cols || y0 + 1 >= image.disparity.rows) return 0;
  const float d[4] = {
      image.at(y0, x0, DisparityOrigin::within_segment), image.at(y0, x0 + 1, DisparityOrigin::within_segment),
      image.at(y0 + 1, x0, DisparityOrigin::within_segment), image.at(y0 + 1, x0 + 1, DisparityOrigin::within_segment)};
  const auto [low, high] = std::minmax_element(d, d + 4);
  if (*low <= 0 || *high - *low > kJump) return 0;
  const float fx = static_cast<float>(x - x0), fy = static_cast<float>(y - y0);
  return (1 - fy) * ((1 - fx) * d[0] + fx * d[1]) + fy * ((1 - fx) * d[2] + fx * d[3]);
}

// What one other view says of pixels of the first.
class OtherView {
 public:
  OtherView(const StereoView& view, const StereoView& other)
      : camera_(view.camera),
        other_(other),
        other_from_view_(other.world_from_cam.inverse() * view.world_from_cam),
        view_from_other_(other_from_view_.inverse()) {}

  struct Statement {
    bool sees = false;         // a surface where the point appears
    double difference = 0;     // [px] measured minus expected disparity in this view: > 0 = something stands before it
    double expected_gain = 0;  // change of the expected disparity by that of the first view
    bool carries = false;      // the following are known
    double disparity = 0;      // [px] of the first view's pixel, by this view
    double gain = 0;           // change of it by this view's measured disparity
  };

  // `sigma` [px] of a disparity; what differs by far more than `gate` of them is not carried to the first view.
  Statement of(const FusedPixel& pixel, double sigma, double gate) const {
    constexpr double kFar = 4;  // [gates]
    const Eigen::Vector3d in_view = camera_.point(pixel.x, pixel.y, pixel.disparity);
    const Eigen::Vector3d turned = other_from_view_.linear() * in_view;
    const Eigen::Vector3d expected_point = turned + other_from_view_.translation();
    if (expected_point.z() < 0.1 * other_.camera.baseline) return {};
    const Eigen::Vector3d expected = other_.camera.project(expected_point);
    const float measured = disparity_between(other_.disparity, expected.x(), expected.y());
    if (measured <= 0) return {};
    Statement statement{.sees = true};
    statement.difference = measured - expected.z();
    // in_view, and with it `turned`, changes by -1 / disparity of itself with the disparity.
    const double total = pixel.disparity + camera_.disparity_offset;
    const double f_b = other_.camera.f * other_.camera.baseline;
    statement.expected_gain = f_b / (expected_point.z() * expected_point.z()) * turned.z() / total;
    const double reach = gate * sigma * std::sqrt(1 + statement.expected_gain * statement.expected_gain);
    if (std::abs(statement.difference) > kFar * reach) return statement;

    const Eigen::Vector3d back = view_from_other_.linear() * other_.camera.point(expected.x(), expected.y(), measured);
    const auto carried = [&](const Eigen::Vector3d& q, double& result) {
      if (q.z() <= 0) return false;
      const Eigen::Vector3d seen = camera_.project(q);
      result = seen.z() + pixel.slope_x * (pixel.x - seen.x()) + pixel.slope_y * (pixel.y - seen.y());
      return true;
    };
    constexpr double kStep = 0.01;  // [px] of the numeric derivative; the function is smooth
    const double measured_total = measured + other_.camera.disparity_offset;
    double moved = 0;
    statement.carries =
        carried(back + view_from_other_.translation(), statement.disparity) &&
        carried(back * (measured_total / (measured_total + kStep)) + view_from_other_.translation(), moved);
    statement.gain = (moved - statement.disparity) / kStep;
    return statement;
  }

 private:
  const RectifiedCamera& camera_;
  const StereoView& other_;
  Pose other_from_view_, view_from_other_;
};

}  // namespace

FusedView fuse_view(const StereoView& view, const std::vector<std::shared_ptr<const StereoView>>& others,
                    const FusionOptions& options, double error_scale) {
  FusedView fused;
  const SlopeFinder slopes(view.disparity);
  for (int y = options.step / 2; y < view.disparity.disparity.rows; y += options.step) {
    for (int x = options.step / 2; x < view.disparity.disparity.cols; x += options.step) {
      const float d = view.disparity.at(y, x, DisparityOrigin::within_segment);
      if (d <= 0 || d + view.camera.disparity_offset < options.min_disparity) continue;
      if (view.camera.point(x, y, d).norm() > options.max_range) continue;
      const Eigen::Vector2f slope = slopes.at(y, x, d);
      fused.pixels.push_back({.x = x, .y = y, .disparity = d, .slope_x = slope.x(), .slope_y = slope.y()});
    }
  }
  std::vector<OtherView> other_views;
  for (const auto& other : others) other_views.emplace_back(view, *other);
  const double stated = std::numbers::sqrt2 * options.pixel_error;  // [px] of a disparity
  const double variance = std::pow(stated * error_scale, 2);
  for (FusedPixel& pixel : fused.pixels) {
    double weights = 1 / variance, sum = 0;  // of the differences to the pixel's own disparity
    for (const OtherView& other : other_views) {
      const OtherView::Statement s = other.of(pixel, std::sqrt(variance), options.gate);
      if (!s.sees) continue;
      const double spread = variance * s.gain * s.gain;
      const double difference = s.disparity - pixel.disparity;
      if (s.carries && std::abs(difference) <= options.gate * std::sqrt(variance + spread)) {
        // No view is worth much more than another: a gain near 0 comes from a surface along its line of sight.
        const double weight = 1 / std::max(spread, 0.01 * variance);
        ++pixel.agree;
        weights += weight;
        sum += weight * difference;
        fused.differences.push_back(static_cast<float>(difference / (stated * std::sqrt(1 + s.gain * s.gain))));
      } else if (s.difference < -options.gate * std::sqrt(variance * (1 + s.expected_gain * s.expected_gain))) {
        ++pixel.through;
      }
    }
    pixel.disparity += static_cast<float>(sum / weights);
    pixel.sigma = static_cast<float>(std::sqrt((1 + pixel.agree) / weights));
  }
  return fused;
}

double error_scale_of(std::vector<float> differences) {
  if (differences.empty()) return 1;
  for (float& difference : differences) difference = std::abs(difference);
  const auto middle = differences.begin() + static_cast<std::ptrdiff_t>(differences.size() / 2);
  std::nth_element(differences.begin(), middle, differences.end());
  constexpr double kNormalMedian = 0.67449;  // of the absolute value, in standard deviations
  return *middle / kNormalMedian;
}

std::vector<int> overlapping_views(const StereoView& view, const std::vector<PlacedCamera>& cameras, int view_idx,
                                   const FusionOptions& options) {
  constexpr int kSamples = 12;  // along each side of the image
  std::vector<Eigen::Vector3d> points;
  double far = 0;
  const cv::Mat1f& disparities = view.disparity.disparity;
  for (int j = 0; j < kSamples; ++j) {
    for (int i = 0; i < kSamples; ++i) {
      const int y = (2 * j + 1) * disparities.rows / (2 * kSamples),
                x = (2 * i + 1) * disparities.cols / (2 * kSamples);
      const float d = view.disparity.at(y, x, DisparityOrigin::within_segment);
      if (d <= 0 || d + view.camera.disparity_offset < options.min_disparity) continue;
      const Eigen::Vector3d point = view.camera.point(x, y, d);
      if (point.norm() > options.max_range) continue;
      points.push_back(point);
      far = std::max(far, point.norm());
    }
  }
  std::vector<std::pair<double, int>> scores;
  for (int i = 0; i < static_cast<int>(cameras.size()); ++i) {
    const PlacedCamera& other = cameras[static_cast<size_t>(i)];
    if (i == view_idx) continue;
    const Pose other_from_view = other.world_from_cam.inverse() * view.world_from_cam;
    if (other_from_view.translation().norm() > 2 * far) continue;
    double score = 0;
    for (const Eigen::Vector3d& point : points) {
      const Eigen::Vector3d p = other_from_view * point;
      if (p.z() <= other.camera.baseline) continue;
      const Eigen::Vector3d seen = other.camera.project(p);
      if (seen.x() < 0 || seen.y() < 0 || seen.x() > other.camera.width - 1 || seen.y() > other.camera.height - 1) {
        continue;
      }
      const double ratio = point.z() / p.z();
      score += std::min(ratio, 1 / ratio);
    }
    constexpr double kLeast = 0.02;  // of the points
    if (score > kLeast * kSamples * kSamples) scores.emplace_back(-score, i);
  }
  std::sort(scores.begin(), scores.end());
  std::vector<int> result;
  for (const auto& [score, i] : scores) {
    if (static_cast<int>(result.size()) == options.neighbours) break;
    result.push_back(i);
  }
  return result;
}

}  // namespace iris::reconstruct
