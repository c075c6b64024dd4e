#include "iris/tour/walk.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <queue>

#include "iris/core/error.h"

namespace iris::tour {
namespace {

using Eigen::Vector2d;
using mapping::MapState;

constexpr double kDegrees = std::numbers::pi / 180;
// Cells up to this many clearances from an obstacle are avoided, at up to 1 + kShyness times the cost of open ones.
constexpr double kComfort = 2, kShyness = 4;

// Points of a polyline, `step` apart.
std::vector<Vector2d> resampled(const std::vector<Vector2d>& points, double step) {
  std::vector<Vector2d> result = {points.front()};
  for (size_t i = 1; i < points.size(); ++i) {
    const double length = (points[i] - points[i - 1]).norm();
    const int pieces = static_cast<int>(std::ceil(length / step));
    for (int k = 1; k <= pieces; ++k) result.push_back(points[i - 1] + (points[i] - points[i - 1]) * k / pieces);
  }
  return result;
}

// Draws a way straight like a rubber band; the ends stay. Where it is nearer to something than is comfortable, it does
// not come nearer still.
void smooth(std::vector<Vector2d>& points, const FreeSpace& space, double clearance) {
  constexpr int kRounds = 200;
  for (int round = 0; round < kRounds; ++round) {
    for (size_t i = 1; i + 1 < points.size(); ++i) {
      const Vector2d moved = 0.5 * points[i] + 0.25 * (points[i - 1] + points[i + 1]);
      if (space.clearance(moved) >= std::min(kComfort * clearance, space.clearance(points[i]))) points[i] = moved;
    }
  }
}

}  // namespace

FreeSpace::FreeSpace(const mapping::MapRaster& raster)
    : cell_(raster.cell),
      origin_x_(raster.origin_x),
      origin_y_(raster.origin_y),
      width_(raster.width),
      height_(raster.height) {
  cv::flip(raster.state, state_, 0);
  // One row and column around it that is not free: beyond the map nothing is known.
  cv::Mat1b padded;
  cv::copyMakeBorder(state_ == static_cast<uint8_t>(MapState::free), padded, 1, 1, 1, 1, cv::BORDER_CONSTANT, 0);
  cv::Mat1f distance;
  cv::distanceTransform(padded, distance, cv::DIST_L2, cv::DIST_MASK_PRECISE, CV_32F);
  clearance_ = cv::Mat1f(height_, width_);
  for (int y = 0; y < height_; ++y) {
    for (int x = 0; x < width_; ++x) {
      const double cells = distance(y + 1, x + 1);
      clearance_(y, x) = cells > 0 ? static_cast<float>((cells - 0.5) * cell_) : 0.0f;
    }
  }
}

int FreeSpace::index_of(const Vector2d& point) const {
  const double x = std::floor((point.x() - origin_x_) / cell_), y = std::floor((point.y() - origin_y_) / cell_);
  if (!(x >= 0 && y >= 0 && x < width_ && y < height_)) return -1;
  return static_cast<int>(y) * width_ + static_cast<int>(x);
}

Vector2d FreeSpace::middle_of(int index) const {
  return {origin_x_ + (index % width_ + 0.5) * cell_, origin_y_ + (index / width_ + 0.5) * cell_};
}

MapState FreeSpace::state(const Vector2d& point) const {
  const int index = index_of(point);
  return index < 0 ? MapState::unknown : static_cast<MapState>(state_(index / width_, index % width_));
}

bool FreeSpace::free(const Vector2d& point) const { return state(point) == MapState::free; }

double FreeSpace::clearance(const Vector2d& point) const {
  const int index = index_of(point);
  return index < 0 ? 0 : clearance_(index / width_, index % width_);
}

std::optional<Vector2d> FreeSpace::nearest(const Vector2d& point, double least_clearance) const {
  std::optional<Vector2d> best;
  double best_distance = std::numeric_limits<double>::infinity();
  for (int index = 0; index < width_ * height_; ++index) {
    const float here = clearance_(index / width_, index % width_);
    if (here <= 0 || here < least_clearance) continue;
    const double distance = (middle_of(index) - point).squaredNorm();
    if (distance < best_distance) best_distance = distance, best = middle_of(index);
  }
  return best;
}

std::optional<Vector2d> FreeSpace::nearest_reachable(const Vector2d& point, const Vector2d& from,
                                                     double least_clearance) const {
  const int start = index_of(from);
  // Diagonal steps of way() need both cells beside them: what it reaches is connected along sides.
  const cv::Mat1b passable = (clearance_ > 0) & (clearance_ >= static_cast<float>(least_clearance));
  cv::Mat1i labels;
  cv::connectedComponents(passable, labels, 4, CV_32S);
  if (start < 0 || labels(start / width_, start % width_) == 0) return std::nullopt;
  const int label = labels(start / width_, start % width_);
  std::optional<Vector2d> best;
  double best_distance = std::numeric_limits<double>::infinity();
  for (int index = 0; index < width_ * height_; ++index) {
    if (labels(index / width_, index % width_) != label) continue;
    const double distance = (middle_of(index) - point).squaredNorm();
    if (distance < best_distance) best_distance = distance, best = middle_of(index);
  }
  return best;
}

bool FreeSpace::straight(const Vector2d& from, const Vector2d& to, double least_clearance) const {
  const int steps = std::max(1, static_cast<int>(std::ceil((to - from).norm() / (0.5 * cell_))));
  for (int i = 0; i <= steps; ++i) {
    const double here = clearance(from + (to - from) * i / steps);
    if (here <= 0 || here < least_clearance) return false;
  }
  return true;
}

double FreeSpace::cost(double clearance, double least_clearance) const {
  const double comfort = kComfort * least_clearance;
  if (clearance >= comfort) return 1;
  const double lacking = 1 - clearance / comfort;
  return 1 + kShyness * lacking * lacking / (0.25);  // at the least clearance lacking is 1/2
}

double FreeSpace::cost_of_line(const Vector2d& from, const Vector2d& to, double least_clearance) const {
  const int steps = std::max(1, static_cast<int>(std::ceil((to - from).norm() / (0.5 * cell_))));
  double sum = 0;
  for (int i = 0; i < steps; ++i) {
    const double here = clearance(from + (to - from) * (i + 0.5) / steps);
    if (here <= 0 || here < least_clearance) return std::numeric_limits<double>::infinity();
    sum += cost(here, least_clearance);
  }
  return sum / steps * (to - from).norm();
}

std::vector<Vector2d> FreeSpace::way(const Vector2d& from, const Vector2d& to, double least_clearance) const {
  const int start = index_of(from), goal = index_of(to);
  if (start < 0 || goal < 0) return {};
  const auto passable = [&](int index) {
    const float here = clearance_(index / width_, index % width_);
    return here > 0 && here >= least_clearance;
  };
  if (!passable(start) || !passable(goal)) return {};
  const size_t cells = static_cast<size_t>(width_) * height_;
  std::vector<float> costs(cells, std::numeric_limits<float>::infinity());
  std::vector<int> before(cells, -1);
  using Entry = std::pair<float, int>;  // estimated cost of the whole way, cell; equal costs in the order of the cells
  std::priority_queue<Entry, std::vector<Entry>, std::greater<>> open;
  const Vector2d end = middle_of(goal);
  costs[start] = 0;
  open.emplace(0.0f, start);
  std::vector<bool> closed(cells, false);
  while (!open.empty()) {
    const int index = open.top().second;
    open.pop();
    if (closed[index]) continue;
    closed[index] = true;
    if (index == goal) break;
    const int x = index % width_, y = index / width_;
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dx = -1; dx <= 1; ++dx) {
        if ((dx == 0 && dy == 0) || x + dx < 0 || y + dy < 0 || x + dx >= width_ || y + dy >= height_) continue;
        const int next = index + dy * width_ + dx;
        if (closed[next] || !passable(next)) continue;
        // A diagonal step does not squeeze between two corners.
        if (dx != 0 && dy != 0 && (!passable(index + dx) || !passable(index + dy * width_))) continue;
        const double length = cell_ * std::hypot(dx, dy);
        const float total =
            costs[index] + static_cast<float>(length * cost(clearance_(y + dy, x + dx), least_clearance));
        if (total >= costs[next]) continue;
        costs[next] = total;
        before[next] = index;
        open.emplace(total + static_cast<float>((middle_of(next) - end).norm()), next);
      }
    }
  }
  if (!closed[goal]) return {};
  std::vector<int> route;
  for (int index = goal; index >= 0; index = before[index]) route.push_back(index);
  std::reverse(route.begin(), route.end());

  // Straight pieces wherever they cost no more than the way over the cells.
  constexpr size_t kFarthest = 200;  // [cells]
  std::vector<Vector2d> points = {from};
  const auto point_of = [&](size_t i) { return i + 1 < route.size() ? middle_of(route[i]) : to; };
  for (size_t i = 0; i + 1 < route.size();) {
    size_t next = i + 1;
    for (size_t j = std::min(route.size() - 1, i + kFarthest); j > i + 1; --j) {
      if (straight(points.back(), point_of(j), least_clearance) &&
          cost_of_line(middle_of(route[i]), middle_of(route[j]), least_clearance) <=
              costs[route[j]] - costs[route[i]] + 1e-4) {
        next = j;
        break;
      }
    }
    i = next;
    points.push_back(point_of(i));
  }
  if (points.size() == 1) points.push_back(to);
  return points;
}

WalkPlan plan_walk(const FreeSpace& space, const std::vector<Vector2d>& stops, const TourOptions& options) {
  IRIS_CHECK(stops.size() >= 2);
  WalkPlan plan;
  std::vector<Vector2d> standing;
  for (size_t i = 0; i < stops.size(); ++i) {
    const std::optional<Vector2d> near = space.nearest(stops[i], options.clearance);
    if (!space.free(stops[i]) || !near) {
      return {.status = WalkStatus::not_free,
              .stop_idx = static_cast<int>(i),
              .state = space.state(stops[i]),
              .nearest = near,
              .points = {}};
    }
    standing.push_back(space.clearance(stops[i]) >= options.clearance ? stops[i] : *near);
  }
  std::vector<Vector2d> points = {standing.front()};
  for (size_t i = 1; i < standing.size(); ++i) {
    const std::vector<Vector2d> piece = space.way(standing[i - 1], standing[i], options.clearance);
    if (piece.empty()) {
      return {.status = WalkStatus::not_connected,
              .stop_idx = static_cast<int>(i),
              .nearest = space.nearest_reachable(standing[i], standing[i - 1], options.clearance),
              .points = {}};
    }
    std::vector<Vector2d> dense = resampled(piece, space.cell());
    smooth(dense, space, options.clearance);
    points.insert(points.end(), dense.begin() + 1, dense.end());
  }
  plan.points = resampled(points, space.cell());
  return plan;
}

CameraPath walk(const std::vector<Vector2d>& points, double eye, const TourOptions& options) {
  IRIS_CHECK(points.size() >= 2);
  constexpr double kAhead = 0.8;  // [m] the point that is looked at
  constexpr double kCalm = 0.3;   // [m] standard deviation of the Gaussian over the directions of sight
  const size_t count = points.size();
  std::vector<double> at(count, 0);  // [m] along the way
  for (size_t i = 1; i < count; ++i) at[i] = at[i - 1] + (points[i] - points[i - 1]).norm();
  // Directions [rad], without jumps of a full turn.
  std::vector<double> yaw(count, 0);
  for (size_t i = 0, ahead = 0; i < count; ++i) {
    while (ahead + 1 < count && at[ahead] - at[i] < kAhead) ++ahead;
    const Vector2d sight = points[ahead] - points[i];
    // The last steps keep the direction.
    if (i > 0 && (sight.norm() < 0.5 * kAhead || at[count - 1] - at[i] < 0.5 * kAhead)) {
      yaw[i] = yaw[i - 1];
      continue;
    }
    yaw[i] = std::atan2(sight.y(), sight.x());
    if (i > 0) yaw[i] = yaw[i - 1] + std::remainder(yaw[i] - yaw[i - 1], 2 * std::numbers::pi);
  }
  std::vector<double> calm(count, 0);
  for (size_t i = 0; i < count; ++i) {
    double sum = 0, total = 0;
    for (size_t k = i + 1; k-- > 0 && at[i] - at[k] < 3 * kCalm;) {
      const double weight = std::exp(-0.5 * std::pow((at[i] - at[k]) / kCalm, 2));
      sum += weight * yaw[k], total += weight;
    }
    for (size_t k = i + 1; k < count && at[k] - at[i] < 3 * kCalm; ++k) {
      const double weight = std::exp(-0.5 * std::pow((at[k] - at[i]) / kCalm, 2));
      sum += weight * yaw[k], total += weight;
    }
    calm[i] = sum / total;
  }
  CameraPath path;
  path.ease = options.ease;
  double t = 0;
  for (size_t i = 0; i < count; ++i) {
    if (i > 0) {
      t += std::max({(at[i] - at[i - 1]) / options.walk_speed,
                     std::abs(calm[i] - calm[i - 1]) / (options.turn_rate * kDegrees), 1e-6});
    }
    path.keyframes.push_back(
        {.t = t,
         .world_from_cam = looking({points[i].x(), points[i].y(), eye}, {std::cos(calm[i]), std::sin(calm[i]), 0}),
         .fov = options.fov * kDegrees});
  }
  if (options.seconds > 0) {
    for (CameraKeyframe& key : path.keyframes) key.t *= options.seconds / t;
  }
  return path;
}

}  // namespace iris::tour
