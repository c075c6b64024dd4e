#include "plane_fill.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <map>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <vector>

#include "iris/core/error.h"

namespace iris::stereo {
namespace {

struct Sample {
  float x, y, d;  // [px] x and y relative to the gap's middle
};

// d = a x + b y + c, with the covariance of (a, b, c).
struct Plane {
  cv::Vec3d abc;
  cv::Matx33d covariance;
  double at(double x, double y) const { return abc[0] * x + abc[1] * y + abc[2]; }
  double deviation(double x, double y) const {
    const cv::Vec3d f(x, y, 1);
    return std::sqrt(std::max(0.0, f.dot(covariance * f)));
  }
};

// Neighbouring samples share most of their correlation windows, and with them their errors: so many count as one.
constexpr double kSharedErrors = 8;
constexpr double kLeastDeviation = 0.1;  // [px] of a measured disparity

// Least squares through the samples within `tolerance` of `start`. Nothing if they do not span a plane.
std::optional<Plane> fit(const std::vector<Sample>& samples, const cv::Vec3d& start, double tolerance, size_t& used) {
  cv::Matx33d normal = cv::Matx33d::zeros();
  cv::Vec3d right(0, 0, 0);
  used = 0;
  for (const Sample& s : samples) {
    const cv::Vec3d f(s.x, s.y, 1);
    if (std::abs(f.dot(start) - s.d) > tolerance) continue;
    normal += f * f.t();
    right += f * s.d;
    ++used;
  }
  if (used < 3 || cv::determinant(normal) < 1e-6 * static_cast<double>(used)) return std::nullopt;
  const cv::Matx33d inverse = normal.inv(cv::DECOMP_CHOLESKY);
  Plane plane{inverse * right, inverse};
  double squares = 0;
  for (const Sample& s : samples) {
    if (std::abs(s.x * start[0] + s.y * start[1] + start[2] - s.d) > tolerance) continue;
    squares += std::pow(plane.at(s.x, s.y) - s.d, 2);
  }
  const double variance = std::max(kLeastDeviation * kLeastDeviation, squares / static_cast<double>(used));
  plane.covariance *= kSharedErrors * variance;
  return plane;
}

// The plane that most samples agree with.
std::optional<Plane> consensus(const std::vector<Sample>& samples, const PlaneFillParameters& p) {
  constexpr int kTries = 40, kChecked = 200;
  uint32_t state = 12345;  // the same choice for the same samples
  const auto pick = [&]() -> const Sample& {
    state = state * 1664525u + 1013904223u;
    return samples[(uint64_t{state} * samples.size()) >> 32];
  };
  const size_t stride = std::max<size_t>(1, samples.size() / kChecked);
  cv::Vec3d best(0, 0, 0);
  size_t most = 0;
  for (int i = 0; i < kTries; ++i) {
    const std::array<const Sample*, 3> of{&pick(), &pick(), &pick()};
    cv::Matx33d rows;
    cv::Vec3d values, abc;
    for (int k = 0; k < 3; ++k) {
      rows(k, 0) = of[k]->x, rows(k, 1) = of[k]->y, rows(k, 2) = 1;
      values[k] = of[k]->d;
    }
    if (std::abs(cv::determinant(rows)) < 10) continue;  // nearly on a line
    cv::solve(rows, values, abc, cv::DECOMP_LU);
    if (std::abs(abc[0]) > p.max_slope || std::abs(abc[1]) > p.max_slope) continue;
    size_t agreeing = 0;
    for (size_t k = 0; k < samples.size(); k += stride) {
      const Sample& s = samples[k];
      agreeing += std::abs(s.x * abc[0] + s.y * abc[1] + abc[2] - s.d) <= p.tolerance;
    }
    if (agreeing <= most) continue;
    most = agreeing;
    best = abc;
  }
  if (most == 0) return std::nullopt;
  std::optional<Plane> plane;
  size_t used = 0;
  for (int i = 0; i < 3; ++i) {
    plane = fit(samples, best, p.tolerance, used);
    if (!plane) return std::nullopt;
    best = plane->abc;
  }
  const bool enough = used >= static_cast<size_t>(p.min_samples) &&
                      static_cast<double>(used) >= p.min_inliers * static_cast<double>(samples.size());
  const bool flat = std::abs(best[0]) <= p.max_slope && std::abs(best[1]) <= p.max_slope;
  return enough && flat ? plane : std::nullopt;
}

class Gap {
 public:
  Gap(const cv::Mat1f& measured, const Segments& segments, const cv::Mat1i& gaps, int name, const cv::Rect& box)
      : measured_(measured),
        label_(segments.label),
        gaps_(gaps),
        name_(name),
        box_(box),
        middle_x_(box.x + box.width / 2),
        middle_y_(box.y + box.height / 2) {}

  // Measured pixels next to the gap, by their segments; every kBandStep-th, since neighbours share their errors anyway.
  std::map<int, std::vector<Sample>> samples(int band) const {
    constexpr int kBandStep = 3;
    std::map<int, std::vector<Sample>> found;
    int last_segment = -1;
    std::vector<Sample>* of_segment = nullptr;
    const auto walk = [&](int y, int x, int dy, int dx) {  // away from the gap
      if (!inside(y, x) || label_(y, x) < 0) return;
      if (const int segment = label_(y, x); segment != last_segment) {
        last_segment = segment;
        of_segment = &found[segment];
      }
      for (int k = 0; k < band; k += kBandStep, y += kBandStep * dy, x += kBandStep * dx) {
        if (!inside(y, x) || label_(y, x) != last_segment) return;
        of_segment->push_back({static_cast<float>(x - middle_x_), static_cast<float>(y - middle_y_), measured_(y, x)});
      }
    };
    for (int y = box_.y; y < box_.br().y; ++y) {
      for (int x = box_.x; x < box_.br().x; ++x) {
        if (gaps_(y, x) != name_) continue;
        walk(y, x - 1, 0, -1);
        walk(y, x + 1, 0, 1);
        walk(y - 1, x, -1, 0);
        walk(y + 1, x, 1, 0);
      }
    }
    return found;
  }

  void fill(const std::map<int, Plane>& planes, const cv::Mat1i& source, float smallest, const PlaneFillParameters& p,
            DisparityImage& filled) const {
    // Rows of the nearest valid pixels below and above, -1 = none.
    cv::Mat1i below(box_.size(), -1);
    for (int y = box_.br().y - 1; y >= box_.y; --y) {
      for (int x = box_.x; x < box_.br().x; ++x) {
        const bool last = y + 1 >= label_.rows;
        const bool ends = !last && label_(y + 1, x) >= 0;
        below(y - box_.y, x - box_.x) = ends                           ? y + 1
                                        : last || y + 1 == box_.br().y ? -1
                                                                       : below(y + 1 - box_.y, x - box_.x);
      }
    }
    std::vector<int> above(box_.width, -1);
    for (int y = box_.y; y < box_.br().y; ++y) {
      int left = -1, right = -1;  // columns of the nearest valid pixels in the row; right: of the run that ends there
      for (int x = box_.x; x < box_.br().x; ++x) {
        int& up = above[x - box_.x];
        if (y > 0 && label_(y - 1, x) >= 0) up = y - 1;
        if (gaps_(y, x) != name_) continue;
        if (x > 0 && label_(y, x - 1) >= 0) left = x - 1;
        if (right < x) {
          right = x + 1;
          while (right < label_.cols && label_(y, right) < 0) ++right;
        }
        if (filled.origin(y, x) != static_cast<uint8_t>(DisparityOrigin::between_segments)) continue;
        const auto plane = planes.find(source(y, x));
        if (plane == planes.end() || deviation(plane->second, y, x) > p.max_error) continue;
        const int down = below(y - box_.y, x - box_.x);
        const std::array<cv::Point, 4> around{cv::Point(left, y), cv::Point(right, y), cv::Point(x, up),
                                              cv::Point(x, down)};
        // The filled value lies no nearer than what surrounds the gap. Where one of these pixels is of the plane's
        // segment but clearly not on the plane, another part of the segment begins.
        float largest = smallest;
        bool agree = true;
        for (const cv::Point& point : around) {
          if (!inside(point.y, point.x)) continue;
          const float d = measured_(point);
          largest = std::max(largest, d);
          agree &=
              label_(point) != plane->first || std::abs(at(plane->second, point.y, point.x) - d) <= 2 * p.tolerance;
        }
        if (agree) filled.disparity(y, x) = std::clamp(at(plane->second, y, x), smallest, largest);
      }
    }
  }

 private:
  bool inside(int y, int x) const { return y >= 0 && x >= 0 && y < label_.rows && x < label_.cols; }
  float at(const Plane& plane, int y, int x) const {
    return static_cast<float>(plane.at(x - middle_x_, y - middle_y_));
  }
  double deviation(const Plane& plane, int y, int x) const { return plane.deviation(x - middle_x_, y - middle_y_); }

  const cv::Mat1f& measured_;
  const cv::Mat1i& label_;
  const cv::Mat1i& gaps_;
  int name_;
  cv::Rect box_;
  int middle_x_, middle_y_;
};

}  // namespace

void fill_planes(const cv::Mat1f& measured, const Segments& segments, const cv::Mat1i& source, float smallest,
                 const PlaneFillParameters& p, DisparityImage& filled) {
  IRIS_CHECK(measured.size() == segments.label.size() && measured.size() == source.size() &&
             measured.size() == filled.disparity.size());
  cv::Mat1i gaps;
  cv::Mat stats, centroids;
  const cv::Mat1b invalid = segments.label < 0;
  const int names = cv::connectedComponentsWithStats(invalid, gaps, stats, centroids, 4, CV_32S, cv::CCL_SAUF);
  for (int name = 1; name < names; ++name) {
    const int* const s = stats.ptr<int>(name);
    if (s[cv::CC_STAT_AREA] < p.min_area) continue;
    const Gap gap(measured, segments, gaps, name,
                  {s[cv::CC_STAT_LEFT], s[cv::CC_STAT_TOP], s[cv::CC_STAT_WIDTH], s[cv::CC_STAT_HEIGHT]});
    std::map<int, Plane> planes;
    for (const auto& [segment, samples] : gap.samples(p.band)) {
      if (samples.size() < static_cast<size_t>(p.min_samples)) continue;
      if (const std::optional<Plane> plane = consensus(samples, p)) planes.emplace(segment, *plane);
    }
    if (!planes.empty()) gap.fill(planes, source, smallest, p, filled);
  }
}

}  // namespace iris::stereo
