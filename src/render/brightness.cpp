// Brightness of stored views from what neighbouring pictures show of the same surface points.
#include <ceres/ceres.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <list>
#include <mutex>
#include <opencv2/imgproc.hpp>
#include <unordered_map>

#include "disparity_map.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/render/refine.h"

namespace iris::render {
namespace {

constexpr int kDarkest = 8, kBrightest = 247;  // [grey levels] beyond, the image may be cut off
constexpr int kDisparityScale = 64;            // of the disparities kept

// A surface point as one view sees it.
struct Point {
  float x = 0, y = 0, disparity = 0;  // [px] in the full image
  float grey = 0;                     // in the reduced one
};

// What is kept of a view: its image and disparities at half size, and points where the picture is smooth: their grey
// values do not depend on exact poses.
struct Reduced {
  cv::Mat1b image;
  cv::Mat1w disparity;  // [px / kDisparityScale] 0 = none
  std::vector<Point> points;
};

// Half-size pixel of a full-size coordinate: a pixel of the reduced image is the mean of 2x2.
float half(float full) { return (full - 0.5f) / 2; }

float sample(const cv::Mat1b& image, float x, float y) {
  const int x0 = std::clamp(static_cast<int>(x), 0, image.cols - 2),
            y0 = std::clamp(static_cast<int>(y), 0, image.rows - 2);
  const float fx = x - static_cast<float>(x0), fy = y - static_cast<float>(y0);
  const uint8_t *up = image[y0] + x0, *down = image[y0 + 1] + x0;
  const auto mix = [](float a, float b, float part) { return a + part * (b - a); };
  return mix(mix(up[0], up[1], fx), mix(down[0], down[1], fx), fy);
}

Reduced reduce(const StereoView& view) {
  constexpr int kCell = 24;   // [reduced px] one point each
  constexpr int kMargin = 3;  // [reduced px]
  Reduced result;
  cv::Mat grey = view.image;
  if (grey.channels() == 3) cv::cvtColor(view.image, grey, cv::COLOR_BGR2GRAY);
  cv::Mat1b small;
  cv::resize(grey, small, {grey.cols / 2, grey.rows / 2}, 0, 0, cv::INTER_AREA);
  cv::GaussianBlur(small, result.image, {5, 5}, 1.0);
  const cv::Mat1f& disparity = view.disparity.disparity;
  result.disparity = cv::Mat1w(result.image.size(), uint16_t{0});
  cv::Mat1f slope(result.image.size(), -1.0f);  // [grey levels per reduced px] -1 = no point
  for (int y = kMargin; y < small.rows - kMargin; ++y) {
    for (int x = kMargin; x < small.cols - kMargin; ++x) {
      const float d = disparity(2 * y, 2 * x);
      if (d <= 0) continue;
      result.disparity(y, x) = cv::saturate_cast<uint16_t>(d * kDisparityScale);
      if (!view.disparity.origin.empty() && view.disparity.at(2 * y, 2 * x, DisparityOrigin::corrected) <= 0) continue;
      // Not at the border of an object, and not beside what the camera did not see.
      bool inner = true;
      for (const int k : {-2 * kMargin, 2 * kMargin}) {
        inner = inner && std::abs(disparity(2 * y + k, 2 * x) - d) < 1 &&
                std::abs(disparity(2 * y, 2 * x + k) - d) < 1 && small(y + k / 2, x) > kDarkest &&
                small(y, x + k / 2) > kDarkest;
      }
      if (!inner || small(y, x) < kDarkest || small(y, x) > kBrightest) continue;
      const cv::Mat1b& i = result.image;
      slope(y, x) = 0.5f * std::hypot(static_cast<float>(i(y, x + 1) - i(y, x - 1)),
                                      static_cast<float>(i(y + 1, x) - i(y - 1, x)));
    }
  }
  for (int y0 = 0; y0 < small.rows; y0 += kCell) {
    for (int x0 = 0; x0 < small.cols; x0 += kCell) {
      cv::Point best(-1, -1);
      for (int y = y0; y < std::min(y0 + kCell, small.rows); ++y) {
        for (int x = x0; x < std::min(x0 + kCell, small.cols); ++x) {
          if (slope(y, x) >= 0 && (best.x < 0 || slope(y, x) < slope(best))) best = {x, y};
        }
      }
      if (best.x < 0) continue;
      const auto x = static_cast<float>(2 * best.x), y = static_cast<float>(2 * best.y);
      result.points.push_back({x, y, disparity(2 * best.y, 2 * best.x), sample(result.image, half(x), half(y))});
    }
  }
  return result;
}

// The reduced views used last.
class ReducedViews {
 public:
  explicit ReducedViews(const views::ViewStore& store) : store_(store) {}

  std::shared_ptr<const Reduced> get(int index) {
    {
      const std::lock_guard lock(mutex_);
      if (const auto found = cached_.find(index); found != cached_.end()) {
        recent_.splice(recent_.begin(), recent_, found->second);
        return found->second->second;
      }
    }
    const auto made = std::make_shared<const Reduced>(reduce(*store_.load(index)));
    const std::lock_guard lock(mutex_);
    if (!cached_.contains(index)) {
      recent_.emplace_front(index, made);
      cached_[index] = recent_.begin();
      if (recent_.size() > kMost) {
        cached_.erase(recent_.back().first);
        recent_.pop_back();
      }
    }
    return made;
  }

 private:
  static constexpr size_t kMost = 600;
  using Recent = std::list<std::pair<int, std::shared_ptr<const Reduced>>>;
  const views::ViewStore& store_;
  std::mutex mutex_;
  Recent recent_;
  std::unordered_map<int, Recent::iterator> cached_;
};

// Where view j shows a point of view i, in full pixels; false if it does not.
bool shows(const Reduced& view, const DisparityMap& map, const Point& point, DisparityMap::Image& at) {
  constexpr float kSameSurface = 1.5f;  // [px] poses may be wrong
  at = map.apply(point.x, point.y, point.disparity);
  const float x = half(at.x), y = half(at.y);
  if (!(x >= 2) || !(y >= 2) || x > static_cast<float>(view.image.cols - 3) ||
      y > static_cast<float>(view.image.rows - 3)) {
    return false;
  }
  const uint16_t d = view.disparity(static_cast<int>(y + 0.5f), static_cast<int>(x + 0.5f));
  return d > 0 &&
         std::abs(static_cast<float>(d) / kDisparityScale - at.disparity) < kSameSurface * (1 + at.per_disparity);
}

struct Pair {
  int i = 0, j = 0;
};

// Grey value of the other view predicted from this one's; [log gain, bias] of each, vignetting of both.
struct GreyError {
  double from, to;        // grey values
  double from_r2, to_r2;  // squared distances from the principal point, 1 in the corner
  double weight;
  template <class T>
  bool operator()(const T* a, const T* b, const T* vignetting, T* residual) const {
    const T light = (from / (1.0 - vignetting[0] * from_r2) - a[1]) * exp(-a[0]);
    residual[0] = weight * ((exp(b[0]) * light + b[1]) * (1.0 - vignetting[0] * to_r2) - to);
    return true;
  }
};

struct Held {
  double per_first, per_second;
  template <class T>
  bool operator()(const T* value, T* residual) const {
    residual[0] = value[0] * per_first;
    residual[1] = value[1] * per_second;
    return true;
  }
};

struct HeldOne {
  double per_unit;
  template <class T>
  bool operator()(const T* value, T* residual) const {
    residual[0] = value[0] * per_unit;
    return true;
  }
};

double corner_distance(const RectifiedCamera& camera) {
  const double x = std::max(camera.cx, camera.width - 1 - camera.cx),
               y = std::max(camera.cy, camera.height - 1 - camera.cy);
  return x * x + y * y;
}

double radius2(const RectifiedCamera& camera, double x, double y) {
  return ((x - camera.cx) * (x - camera.cx) + (y - camera.cy) * (y - camera.cy)) / corner_distance(camera);
}

}  // namespace

std::vector<Brightness> find_brightness(const views::ViewStore& store,
                                        const std::vector<std::vector<int>>& neighbours) {
  constexpr size_t kFewest = 12;                               // points of a pair
  constexpr double kGreyError = 4;                             // [grey levels]
  constexpr double kGain = 0.2, kBias = 3, kVignetting = 0.3;  // usual sizes: ratio, [grey levels], ratio
  constexpr double kIndependent = 6;                           // points of a pair that err independently
  const std::vector<views::ViewSummary>& views = store.summaries();
  IRIS_CHECK(neighbours.size() == views.size());
  std::vector<Brightness> brightness(views.size());
  std::vector<Pair> pairs;
  for (size_t i = 0; i < views.size(); ++i) {
    for (const int j : neighbours[i]) pairs.push_back({static_cast<int>(i), j});
  }
  ReducedViews reduced(store);
  std::vector<std::vector<GreyError>> matches(pairs.size());
  parallel_chunks(0, static_cast<int>(pairs.size()), 8, [&](int begin, int end) {
    for (int k = begin; k < end; ++k) {
      const auto [i, j] = pairs[static_cast<size_t>(k)];
      const auto si = static_cast<size_t>(i), sj = static_cast<size_t>(j);
      const auto vi = reduced.get(i), vj = reduced.get(j);
      const DisparityMap map(views[sj].camera, views[si].camera,
                             views[sj].world_from_cam.inverse() * views[si].world_from_cam);
      std::vector<GreyError>& list = matches[static_cast<size_t>(k)];
      for (const Point& point : vi->points) {
        DisparityMap::Image at;
        if (!shows(*vj, map, point, at)) continue;
        const double grey = sample(vj->image, half(at.x), half(at.y));
        if (grey < kDarkest || grey > kBrightest) continue;
        list.push_back({.from = point.grey,
                        .to = grey,
                        .from_r2 = radius2(views[si].camera, point.x, point.y),
                        .to_r2 = radius2(views[sj].camera, at.x, at.y),
                        .weight = 0});
      }
      if (list.size() < kFewest) list.clear();
      for (GreyError& error : list) {
        error.weight = std::min(1.0, std::sqrt(kIndependent / static_cast<double>(list.size()))) / kGreyError;
      }
    }
  });
  std::vector<std::array<double, 2>> of_view(views.size(), {0, 0});
  double vignetting = 0;
  ceres::Problem problem;
  for (size_t k = 0; k < pairs.size(); ++k) {
    for (const GreyError& error : matches[k]) {
      problem.AddResidualBlock(new ceres::AutoDiffCostFunction<GreyError, 1, 2, 2, 1>(new GreyError(error)),
                               new ceres::HuberLoss(1.5 * error.weight * kGreyError),
                               of_view[static_cast<size_t>(pairs[k].i)].data(),
                               of_view[static_cast<size_t>(pairs[k].j)].data(), &vignetting);
    }
  }
  if (problem.NumResidualBlocks() == 0) return brightness;
  for (auto& values : of_view) {
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<Held, 2, 2>(new Held{1 / kGain, 1 / kBias}), nullptr,
                             values.data());
  }
  problem.AddResidualBlock(new ceres::AutoDiffCostFunction<HeldOne, 1, 1>(new HeldOne{1 / kVignetting}), nullptr,
                           &vignetting);
  problem.SetParameterLowerBound(&vignetting, 0, -0.2);
  problem.SetParameterUpperBound(&vignetting, 0, 0.8);
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  options.num_threads = 1;  // the same sums for any number of threads
  options.max_num_iterations = 20;
  options.function_tolerance = 1e-5;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  if (!summary.IsSolutionUsable()) return brightness;
  double mean = 0;
  for (const auto& values : of_view) mean += values[0];
  mean /= static_cast<double>(of_view.size());
  for (size_t i = 0; i < views.size(); ++i) {
    brightness[i] = {.gain = std::exp(of_view[i][0] - mean), .bias = of_view[i][1], .vignetting = vignetting};
  }
  return brightness;
}

cv::Mat even_image(const cv::Mat& image, const RectifiedCamera& camera, const Brightness& brightness) {
  IRIS_CHECK(image.depth() == CV_8U && brightness.gain > 0);
  const auto gain = static_cast<float>(1 / brightness.gain);
  const auto bias = static_cast<float>(brightness.bias / brightness.gain);
  const auto vignetting = static_cast<float>(brightness.vignetting / corner_distance(camera));
  cv::Mat even(image.size(), image.type());
  parallel_chunks(0, image.rows, 32, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      const uint8_t* from = image.ptr<uint8_t>(y);
      uint8_t* to = even.ptr<uint8_t>(y);
      const float dy = static_cast<float>(y) - static_cast<float>(camera.cy);
      for (int x = 0; x < image.cols; ++x) {
        const float dx = static_cast<float>(x) - static_cast<float>(camera.cx);
        const float factor = gain / (1 - vignetting * (dx * dx + dy * dy));
        for (int c = 0; c < image.channels(); ++c) {
          const int k = x * image.channels() + c;
          // What is black because the camera did not see it stays so.
          const float value = static_cast<float>(from[k]) * factor - bias + 0.5f;
          to[k] = from[k] == 0 ? 0 : static_cast<uint8_t>(std::clamp(value, 0.0f, 255.0f));
        }
      }
    }
  });
  return even;
}

}  // namespace iris::render
