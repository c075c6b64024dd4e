// Poses and brightness of stored views from what neighbouring pictures show of the same surface points.
#include <ceres/ceres.h>

#include <Eigen/SparseCholesky>
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

using Eigen::Vector2d;
using Eigen::Vector3d;
using Vector12d = Eigen::Matrix<double, 12, 1>;
using Matrix12d = Eigen::Matrix<double, 12, 12>;

constexpr int kDarkest = 8, kBrightest = 247;  // [grey levels] beyond, the image may be cut off
constexpr int kDisparityScale = 64;            // of the disparities kept

// A surface point as one view sees it.
struct Point {
  float x = 0, y = 0, disparity = 0;  // [px] in the full image
  float grey = 0;                     // in the reduced one
};

// What is kept of a view: its image and disparities at half size, points of high contrast (whose grey value tells where
// they are), and smooth ones (whose grey value does not depend on that).
struct Reduced {
  cv::Mat1b image;
  cv::Mat1w disparity;  // [px / kDisparityScale] 0 = none
  std::vector<Point> edges, plains;
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
  constexpr int kEdgeCell = 10, kPlainCell = 24;  // [reduced px] one point each
  constexpr float kEdge = 8;                      // [grey levels per reduced px] least slope of an edge
  constexpr int kMargin = 3;                      // [reduced px]
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
  const auto collect = [&](int cell, bool steepest, std::vector<Point>& points) {
    for (int y0 = 0; y0 < small.rows; y0 += cell) {
      for (int x0 = 0; x0 < small.cols; x0 += cell) {
        cv::Point best(-1, -1);
        for (int y = y0; y < std::min(y0 + cell, small.rows); ++y) {
          for (int x = x0; x < std::min(x0 + cell, small.cols); ++x) {
            if (slope(y, x) < (steepest ? kEdge : 0.0f)) continue;
            const bool better = best.x < 0 || (steepest ? slope(y, x) > slope(best) : slope(y, x) < slope(best));
            if (better) best = {x, y};
          }
        }
        if (best.x < 0) continue;
        const auto x = static_cast<float>(2 * best.x), y = static_cast<float>(2 * best.y);
        points.push_back({x, y, disparity(2 * best.y, 2 * best.x), sample(result.image, half(x), half(y))});
      }
    }
  };
  collect(kEdgeCell, true, result.edges);
  collect(kPlainCell, false, result.plains);
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

// The line grey_j = slope * grey_i + offset through pairs of grey values.
struct GreyLine {
  double slope = 1, offset = 0;
};
GreyLine line_through(const std::vector<Vector2d>& greys) {
  Vector2d mean = Vector2d::Zero(), square = Vector2d::Zero();
  for (const Vector2d& g : greys) mean += g;
  mean /= static_cast<double>(greys.size());
  for (const Vector2d& g : greys) square += (g - mean).cwiseAbs2();
  GreyLine line;
  line.slope = std::clamp(std::sqrt(square.y() / std::max(square.x(), 1e-9)), 0.5, 2.0);
  line.offset = mean.y() - line.slope * mean.x();
  return line;
}

// Normal equations of a pair: e = grey_j - line(grey_i) over small turns and shifts of both views, each in its own
// camera frame (rotation first).
struct PairEquations {
  Matrix12d h = Matrix12d::Zero();
  Vector12d b = Vector12d::Zero();
};

PairEquations pair_equations(const Reduced& vi, const Reduced& vj, const RectifiedCamera& ci, const RectifiedCamera& cj,
                             const Pose& j_from_i) {
  constexpr size_t kFewest = 60;         // points
  constexpr double kGreyError = 8;       // [grey levels] noise, texture at half size, shine
  constexpr double kIndependent = 0.05;  // share of the points that are: neighbours err alike, depths are not exact
  constexpr double kMostOff = 25;        // [grey levels] mean error of pictures that do not belong together
  PairEquations equations;
  const DisparityMap map(cj, ci, j_from_i);
  struct Match {
    const Point* point;
    DisparityMap::Image at;
  };
  std::vector<Match> matches;
  std::vector<Vector2d> greys;
  for (const Point& point : vi.edges) {
    Match match{.point = &point, .at = {}};
    if (!shows(vj, map, point, match.at)) continue;
    matches.push_back(match);
    greys.emplace_back(point.grey, sample(vj.image, half(match.at.x), half(match.at.y)));
  }
  if (matches.size() < kFewest) return equations;
  const GreyLine line = line_through(greys);
  double off = 0;
  for (const Vector2d& g : greys) off += std::abs(g.y() - line.slope * g.x() - line.offset);
  if (off > kMostOff * static_cast<double>(greys.size())) return equations;
  for (size_t k = 0; k < matches.size(); ++k) {
    const Match& match = matches[k];
    const float x = half(match.at.x), y = half(match.at.y);
    const Vector2d slope(0.25 * (sample(vj.image, x + 1, y) - sample(vj.image, x - 1, y)),
                         0.25 * (sample(vj.image, x, y + 1) - sample(vj.image, x, y - 1)));  // per full pixel
    const Vector3d in_i = ci.point(match.point->x, match.point->y, match.point->disparity), in_j = j_from_i * in_i;
    const double per_z = 1 / in_j.z();
    const Vector3d g(slope.x() * cj.f * per_z, slope.y() * cj.f * per_z,
                     -cj.f * per_z * per_z * (slope.x() * in_j.x() + slope.y() * in_j.y()));
    const Vector3d in_frame_i = j_from_i.linear().transpose() * g;
    Vector12d jacobian;
    jacobian << in_i.cross(in_frame_i), in_frame_i, -in_j.cross(g), -g;
    const double error = greys[k].y() - line.slope * greys[k].x() - line.offset;
    const double weight =
        kIndependent / (kGreyError * kGreyError) * std::min(1.0, kGreyError / std::max(std::abs(error), 1e-9));
    equations.h.noalias() += weight * jacobian * jacobian.transpose();
    equations.b.noalias() += weight * error * jacobian;
  }
  return equations;
}

void align(const std::vector<views::ViewSummary>& views, const std::vector<Pair>& pairs, ReducedViews& reduced,
           std::vector<ViewCorrection>& corrections) {
  constexpr int kRounds = 4;
  constexpr double kTurn = 0.002;  // [rad] a pose is usually right to that,
  constexpr double kShift = 0.03;  // [baselines] and to this
  const int count = static_cast<int>(views.size());
  for (int round = 0; round < kRounds; ++round) {
    std::vector<PairEquations> equations(pairs.size());
    parallel_chunks(0, static_cast<int>(pairs.size()), 8, [&](int begin, int end) {
      for (int k = begin; k < end; ++k) {
        const auto [i, j] = pairs[static_cast<size_t>(k)];
        const auto si = static_cast<size_t>(i), sj = static_cast<size_t>(j);
        const Pose j_from_i = corrections[sj].world_from_cam.inverse() * corrections[si].world_from_cam;
        equations[static_cast<size_t>(k)] =
            pair_equations(*reduced.get(i), *reduced.get(j), views[si].camera, views[sj].camera, j_from_i);
      }
    });
    std::vector<Eigen::Triplet<double>> entries;
    Eigen::VectorXd right = Eigen::VectorXd::Zero(6 * count);
    for (int i = 0; i < count; ++i) {
      const auto si = static_cast<size_t>(i);
      const Pose moved = views[si].world_from_cam.inverse() * corrections[si].world_from_cam;
      const Eigen::AngleAxisd turn(Eigen::Matrix3d(moved.linear()));
      const double shift = kShift * views[si].camera.baseline;
      Vector6d held;
      held << turn.angle() * turn.axis() / (kTurn * kTurn), moved.translation() / (shift * shift);
      right.segment<6>(6 * i) -= held;
      for (int a = 0; a < 6; ++a)
        entries.emplace_back(6 * i + a, 6 * i + a, a < 3 ? 1 / (kTurn * kTurn) : 1 / (shift * shift));
    }
    for (size_t k = 0; k < pairs.size(); ++k) {
      const int at[2] = {6 * pairs[k].i, 6 * pairs[k].j};
      for (int a = 0; a < 12; ++a) {
        const int row = at[a / 6] + a % 6;
        right[row] -= equations[k].b[a];
        for (int c = 0; c < 12; ++c) {
          const int column = at[c / 6] + c % 6;
          if (column <= row) entries.emplace_back(row, column, equations[k].h(a, c));
        }
      }
    }
    Eigen::SparseMatrix<double> matrix(6 * count, 6 * count);
    matrix.setFromTriplets(entries.begin(), entries.end());
    const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> solver(matrix);
    IRIS_CHECK(solver.info() == Eigen::Success);
    const Eigen::VectorXd step = solver.solve(right);
    for (int i = 0; i < count; ++i) {
      const Vector3d turn = step.segment<3>(6 * i);
      Pose change = Pose::Identity();
      change.translation() = step.segment<3>(6 * i + 3);
      if (turn.norm() > 0) change.linear() = Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix();
      Pose& pose = corrections[static_cast<size_t>(i)].world_from_cam;
      pose = pose * change;
      pose.linear() = nearest_rotation(pose.linear());
    }
  }
}

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

void even_out(const std::vector<views::ViewSummary>& views, const std::vector<Pair>& pairs, ReducedViews& reduced,
              std::vector<ViewCorrection>& corrections) {
  constexpr size_t kFewest = 12;                               // points of a pair
  constexpr double kGreyError = 4;                             // [grey levels]
  constexpr double kGain = 0.2, kBias = 3, kVignetting = 0.3;  // usual sizes: ratio, [grey levels], ratio
  constexpr double kIndependent = 6;                           // points of a pair that err independently
  std::vector<std::vector<GreyError>> matches(pairs.size());
  parallel_chunks(0, static_cast<int>(pairs.size()), 8, [&](int begin, int end) {
    for (int k = begin; k < end; ++k) {
      const auto [i, j] = pairs[static_cast<size_t>(k)];
      const auto si = static_cast<size_t>(i), sj = static_cast<size_t>(j);
      const auto vi = reduced.get(i), vj = reduced.get(j);
      const DisparityMap map(views[sj].camera, views[si].camera,
                             corrections[sj].world_from_cam.inverse() * corrections[si].world_from_cam);
      std::vector<GreyError>& list = matches[static_cast<size_t>(k)];
      for (const Point& point : vi->plains) {
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
  if (problem.NumResidualBlocks() == 0) return;
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
  if (!summary.IsSolutionUsable()) return;
  double mean = 0;
  for (const auto& values : of_view) mean += values[0];
  mean /= static_cast<double>(of_view.size());
  for (size_t i = 0; i < views.size(); ++i) {
    corrections[i].brightness = {
        .gain = std::exp(of_view[i][0] - mean), .bias = of_view[i][1], .vignetting = vignetting};
  }
}

}  // namespace

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

std::vector<ViewCorrection> find_corrections(const views::ViewStore& store,
                                             const std::vector<std::vector<int>>& neighbours,
                                             const DsnvOptions& options) {
  const std::vector<views::ViewSummary>& views = store.summaries();
  IRIS_CHECK(neighbours.size() == views.size());
  std::vector<ViewCorrection> corrections(views.size());
  std::vector<Pair> pairs;
  for (size_t i = 0; i < views.size(); ++i) {
    corrections[i].world_from_cam = views[i].world_from_cam;
    for (const int j : neighbours[i]) pairs.push_back({static_cast<int>(i), j});
  }
  ReducedViews reduced(store);
  if (options.align_views) align(views, pairs, reduced, corrections);
  if (options.even_brightness) even_out(views, pairs, reduced, corrections);
  return corrections;
}

}  // namespace iris::render
