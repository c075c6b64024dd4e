#include "export/measurement.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <map>
#include <unordered_map>

#include "iris/core/error.h"
#include "iris/reconstruct/error_propagation.h"

namespace iris::exporters {
namespace {

constexpr int kViewsOfAPoint = 8;     // that see it, nearest first
constexpr int kViewsLookedAt = 60;    // at most for each point
constexpr double kNearest = 0.05;     // [m] before the camera
constexpr double kHeightStep = 0.02;  // [m] along the vertical through a point without z

std::string text_of(const PickedPoint& p) {
  return p.z ? fmt::format("({:g}, {:g}, {:g})", p.xy.x(), p.xy.y(), *p.z)
             : fmt::format("({:g}, {:g})", p.xy.x(), p.xy.y());
}

// A point as one view measured it.
struct Sighting {
  int view_idx = 0;
  Eigen::Vector3d in_cam, in_world;
  bool sure = false;  // its error and its distance from the picked point are less than the radius
};

bool inside(const RectifiedCamera& camera, const Eigen::Vector3d& in_cam) {
  if (in_cam.z() < kNearest) return false;
  const Eigen::Vector3d image = camera.project(in_cam);
  return image.x() >= 1 && image.y() >= 1 && image.x() <= camera.width - 2 && image.y() <= camera.height - 2;
}

// The median of the measured disparities around a pixel; 0 if that is no surface: too few of them, or a jump.
double disparity_at(const DisparityImage& image, int y, int x) {
  constexpr int kLeast = 6;
  constexpr float kJump = 1;  // [px]
  if (x < 1 || y < 1 || x + 1 >= image.disparity.cols || y + 1 >= image.disparity.rows) return 0;
  if (image.at(y, x, DisparityOrigin::corrected) <= 0) return 0;
  std::vector<float> values;
  for (int v = y - 1; v <= y + 1; ++v) {
    for (int u = x - 1; u <= x + 1; ++u) {
      if (const float d = image.at(v, u, DisparityOrigin::corrected); d > 0) values.push_back(d);
    }
  }
  if (values.size() < kLeast) return 0;
  std::sort(values.begin(), values.end());
  return values.back() - values.front() > kJump ? 0 : static_cast<double>(values[values.size() / 2]);
}

// No border of an object is so near that the matching may have taken the wrong side: disparities on both sides of the
// pixel continue each other in every direction.
bool on_one_surface(const DisparityImage& image, int y, int x, double disparity) {
  constexpr int kReach = 6;       // [px] half of a matching window and a little more
  constexpr double kLargest = 1;  // [px] second difference
  const auto at = [&](int dy, int dx) {
    const bool in = x + dx >= 0 && y + dy >= 0 && x + dx < image.disparity.cols && y + dy < image.disparity.rows;
    return in ? static_cast<double>(image.at(y + dy, x + dx, DisparityOrigin::between_segments)) : 0;
  };
  for (const auto& [dy, dx] :
       {std::pair(0, kReach), std::pair(kReach, 0), std::pair(kReach, kReach), std::pair(kReach, -kReach)}) {
    const double before = at(-dy, -dx), behind = at(dy, dx);
    if (before <= 0 || behind <= 0 || std::abs(before + behind - 2 * disparity) > kLargest) return false;
  }
  return true;
}

class Finder {
 public:
  Finder(const views::ViewStore& views, const MeasureOptions& options) : views_(views), options_(options) {}

  // The views that see a point, nearest first.
  std::vector<Sighting> find(const PickedPoint& point, const std::string& name, const std::string& where) {
    nearest_distance_ = std::numeric_limits<double>::infinity();
    // What is uncertain, or farther off than the radius if only by its uncertainty, counts where nothing better is
    // seen.
    int looking = 0;
    for (const bool sure : {true, false}) {
      std::vector<Sighting> sightings;
      if (point.z) {
        sightings = search(point, *point.z, *point.z, sure, looking);
      } else {
        sightings = search(point, options_.bottom, options_.top, sure, looking);
        if (sightings.empty()) sightings = search(point, options_.low, options_.bottom, sure, looking);
      }
      if (!sightings.empty()) return agreeing(std::move(sightings));
    }
    const std::string what = fmt::format("{} = {}", name, text_of(point));
    Eigen::AlignedBox2d box;
    for (const auto& view : views_.summaries()) box.extend(view.world_from_cam.translation().head<2>());
    const std::string remedy = fmt::format(
        "pick a point that the map shows, in its world; the path goes from x {:.2f} to {:.2f} m, y {:.2f} to {:.2f} m",
        box.min().x(), box.max().x(), box.min().y(), box.max().y());
    if (looking == 0) throw InputError(where, fmt::format("no stored view looks at point {}", what), remedy);
    constexpr double kFar = 1;  // [m]
    if (nearest_distance_ > kFar)
      throw InputError(where, fmt::format("nothing was measured near point {}", what), remedy);
    throw InputError(
        where, fmt::format("no view measured a surface within {:g} m of point {}", options_.radius, what),
        fmt::format("the nearest that was measured is ({:.2f}, {:.2f}, {:.2f}), {:.2f} m away: pick that, or give "
                    "--measure.radius",
                    nearest_.x(), nearest_.y(), nearest_.z(), nearest_distance_));
  }

  // The same point in another view, if that sees it.
  std::optional<Sighting> again(int view_idx, const Eigen::Vector3d& seen) {
    return at(view_idx, {.xy = seen.head<2>(), .z = seen.z()}, seen.z(), seen.z(), false);
  }

  bool looks_at(int view_idx, const Eigen::Vector3d& point) const {
    const views::ViewSummary& view = views_.summaries()[static_cast<size_t>(view_idx)];
    return inside(view.camera, view.world_from_cam.inverse() * point);
  }

 private:
  std::vector<Sighting> search(const PickedPoint& point, double low, double high, bool sure, int& looking) {
    std::vector<std::pair<double, int>> order;
    for (int i = 0; i < static_cast<int>(views_.summaries().size()); ++i) {
      const Eigen::Vector3d& eye = views_.summaries()[static_cast<size_t>(i)].world_from_cam.translation();
      double nearest = std::numeric_limits<double>::infinity();
      for (const double z : heights(low, high)) {
        const Eigen::Vector3d p(point.xy.x(), point.xy.y(), z);
        if (looks_at(i, p)) nearest = std::min(nearest, (p - eye).norm());
      }
      if (std::isfinite(nearest)) order.emplace_back(nearest, i);
    }
    std::sort(order.begin(), order.end());
    looking = std::max(looking, static_cast<int>(order.size()));
    std::vector<Sighting> sightings;
    for (size_t i = 0; i < order.size() && i < kViewsLookedAt && sightings.size() < kViewsOfAPoint; ++i) {
      const auto found = at(order[i].second, point, low, high, !point.z);
      if (found && (!sure || found->sure)) sightings.push_back(*found);
    }
    return sightings;
  }

  // Without those that the other views contradict: wrong matches, and surfaces that reach too far at their borders.
  std::vector<Sighting> agreeing(std::vector<Sighting> sightings) {
    constexpr double kSigmas = 4;
    std::vector<int> support;
    for (const Sighting& s : sightings) {
      support.push_back(0);
      for (const Sighting& other : sightings) {
        const StereoView& seen = view(other.view_idx);
        const Eigen::Vector3d in_cam = seen.world_from_cam.inverse() * s.in_world;
        if (!inside(seen.camera, in_cam)) continue;
        const Eigen::Vector3d image = seen.camera.project(in_cam);
        const double d = disparity_at(seen.disparity, static_cast<int>(std::lround(image.y())),
                                      static_cast<int>(std::lround(image.x())));
        if (d <= 0) continue;
        const double error = std::hypot(reconstruct::range_error(seen.camera, in_cam, options_.pixel_error),
                                        reconstruct::range_error(seen.camera, s.in_cam, options_.pixel_error));
        const double depth = seen.camera.point(image.x(), image.y(), d).norm();
        support.back() += std::abs(depth - in_cam.norm()) <= kSigmas * error;
      }
    }
    const int most = *std::max_element(support.begin(), support.end());
    std::vector<Sighting> kept;
    for (size_t k = 0; k < sightings.size(); ++k) {
      if (2 * support[k] >= most) kept.push_back(sightings[k]);
    }
    return kept;
  }

  static std::vector<double> heights(double low, double high) {
    std::vector<double> result;
    for (int k = 0; low + k * kHeightStep <= high + 1e-9; ++k) result.push_back(low + k * kHeightStep);
    return result;
  }

  const StereoView& view(int idx) {
    auto& cached = cache_[idx];
    if (!cached) cached = views_.load(idx);
    return *cached;
  }

  // The surface that a view measured at a point between two heights: the one that projects nearest to it.
  std::optional<Sighting> at(int view_idx, const PickedPoint& point, double low, double high, bool plan) {
    const StereoView& seen = view(view_idx);
    const Pose cam_from_world = seen.world_from_cam.inverse();
    std::optional<Sighting> best;
    double best_distance = std::numeric_limits<double>::infinity();
    const auto consider = [&](int x, int y, const Eigen::Vector3d& p) {
      const double d = disparity_at(seen.disparity, y, x);
      if (d <= 0 || d + seen.camera.disparity_offset <= 0) return;
      const Eigen::Vector3d in_cam = seen.camera.point(x, y, d), in_world = seen.world_from_cam * in_cam;
      const double distance = plan ? (in_world - p).head<2>().norm() : (in_world - p).norm();
      if (distance < nearest_distance_) nearest_distance_ = distance, nearest_ = in_world;
      const double error = reconstruct::range_error(seen.camera, in_cam, options_.pixel_error);
      if (distance > options_.radius + 3 * error || distance >= best_distance) return;
      if (plan && (in_world.z() < low - options_.radius || in_world.z() > high + options_.radius)) return;
      best_distance = distance;
      best = Sighting{.view_idx = view_idx,
                      .in_cam = in_cam,
                      .in_world = in_world,
                      .sure = std::max(error, distance) <= options_.radius && on_one_surface(seen.disparity, y, x, d)};
    };
    for (const double z : heights(low, high)) {
      const Eigen::Vector3d p(point.xy.x(), point.xy.y(), z);
      const Eigen::Vector3d in_cam = cam_from_world * p;
      if (!inside(seen.camera, in_cam)) continue;
      const Eigen::Vector3d image = seen.camera.project(in_cam);
      const int x = static_cast<int>(std::lround(image.x())), y = static_cast<int>(std::lround(image.y()));
      consider(x, y, p);
      if (best || low < high) continue;
      // Beside the pixel itself, as far as the radius reaches: the nearest with a measurement.
      const int reach = std::min(30, static_cast<int>(seen.camera.f * options_.radius / in_cam.z()));
      for (int ring = 1; ring <= reach && !best; ++ring) {
        for (int k = -ring; k < ring; ++k) {
          consider(x + k, y - ring, p), consider(x + ring, y + k, p);
          consider(x - k, y + ring, p), consider(x - ring, y - k, p);
        }
      }
    }
    return best;
  }

  const views::ViewStore& views_;
  const MeasureOptions& options_;
  std::unordered_map<int, std::shared_ptr<const StereoView>> cache_;
  double nearest_distance_ = 0;  // [m] of what was measured near the point that is looked for
  Eigen::Vector3d nearest_ = Eigen::Vector3d::Zero();
};

}  // namespace

void MeasureOptions::declare(OptionSet& set) {
  set.section("measure");
  set.add("radius", radius, "m", 0.001, 10,
          "a surface within this distance of a picked point is what was meant; cells of the map are 0.05 m wide");
  set.add("pixel_error", pixel_error, "px", 0.001, 10,
          "standard deviation of image coordinates, from which the points' errors follow (thesis 4.26)");
}

PickedPoint parse_point(const std::string& text) {
  std::vector<double> values;
  const char* at = text.data();
  const char* const end = at + text.size();
  bool good = !text.empty();
  while (good) {
    double value = 0;
    const auto [next, error] = std::from_chars(at, end, value);
    good = error == std::errc() && std::isfinite(value);
    values.push_back(value);
    at = next;
    if (!good || at == end) break;
    good = *at == ',';
    ++at;
  }
  if (!good || values.size() < 2 || values.size() > 3) {
    throw UsageError(fmt::format("'{}' is no point; give x,y or x,y,z in metres without blanks, as 1.25,-0.4", text));
  }
  PickedPoint point{.xy = {values[0], values[1]}, .z = {}};
  if (values.size() == 3) point.z = values[2];
  return point;
}

Measurement measure(const PoseGraph& graph, const views::ViewStore& views, const PickedPoint& a, const PickedPoint& b,
                    const MeasureOptions& options, const std::string& where) {
  Finder finder(views, options);
  std::vector<Sighting> of_a = finder.find(a, "A", where), of_b = finder.find(b, "B", where);
  // Views that see both, nearest first: they know the distance without the path.
  const auto& summaries = views.summaries();
  std::vector<std::pair<double, int>> both;
  for (int i = 0; i < static_cast<int>(summaries.size()); ++i) {
    const Eigen::Vector3d p = of_a.front().in_world, q = of_b.front().in_world;
    if (!finder.looks_at(i, p) || !finder.looks_at(i, q)) continue;
    const Eigen::Vector3d& eye = summaries[static_cast<size_t>(i)].world_from_cam.translation();
    both.emplace_back(std::max((p - eye).norm(), (q - eye).norm()), i);
  }
  std::sort(both.begin(), both.end());
  for (size_t k = 0; k < both.size() && k < kViewsOfAPoint; ++k) {
    const auto p = finder.again(both[k].second, of_a.front().in_world);
    const auto q = finder.again(both[k].second, of_b.front().in_world);
    if (!p || !q) continue;
    const auto add = [](std::vector<Sighting>& to, const Sighting& sighting) {
      const bool there =
          std::any_of(to.begin(), to.end(), [&](const auto& s) { return s.view_idx == sighting.view_idx; });
      if (!there) to.push_back(sighting);
    };
    add(of_a, *p), add(of_b, *q);
  }

  std::map<int, size_t> place_of_view;  // in the joint covariance
  std::vector<int> frames;
  for (const auto* sightings : {&of_a, &of_b}) {
    for (const Sighting& s : *sightings) {
      if (place_of_view.try_emplace(s.view_idx, frames.size()).second) {
        frames.push_back(summaries[static_cast<size_t>(s.view_idx)].frame_idx);
      }
    }
  }
  const Eigen::MatrixXd joint = loop::joint_covariance(graph, frames);
  std::unordered_map<int, const PoseNode*> node_of_frame;
  for (const PoseNode& node : graph.nodes) node_of_frame[node.frame_idx] = &node;

  Measurement best;
  best.sigma = std::numeric_limits<double>::infinity();
  for (const Sighting& p : of_a) {
    for (const Sighting& q : of_b) {
      const views::ViewSummary& view_p = summaries[static_cast<size_t>(p.view_idx)];
      const views::ViewSummary& view_q = summaries[static_cast<size_t>(q.view_idx)];
      Measurement m{.in_plan = !a.z || !b.z};
      Eigen::Vector3d along = q.in_world - p.in_world;
      if (m.in_plan) along.z() = 0;
      m.distance = along.norm();
      // Points that coincide have no direction: the sum of all their errors is an upper bound.
      if (m.distance > 0) along /= m.distance;
      const auto own_variance = [&](const Sighting& s, const views::ViewSummary& view) {
        const Eigen::Matrix3d covariance = reconstruct::point_covariance(view.camera, s.in_cam, options.pixel_error);
        const Eigen::Vector3d in_cam = view.world_from_cam.linear().transpose() * along;
        return m.distance > 0 ? in_cam.dot(covariance * in_cam) : covariance.trace();
      };
      m.reconstruction = std::sqrt(own_variance(p, view_p) + own_variance(q, view_q));
      if (p.view_idx != q.view_idx) {
        // A pose that moves by (dt, dw) moves its point by dt + dw x (point - eye).
        const auto gradient = [&](const Sighting& s, const views::ViewSummary& view) {
          Vector6d result;
          result << along, (s.in_world - view.world_from_cam.translation()).cross(along);
          return result;
        };
        const Vector6d by_p = -gradient(p, view_p), by_q = gradient(q, view_q);
        const auto block = [&](const Sighting& s, const Sighting& t) {
          return joint.block<6, 6>(static_cast<Eigen::Index>(6 * place_of_view.at(s.view_idx)),
                                   static_cast<Eigen::Index>(6 * place_of_view.at(t.view_idx)));
        };
        const double by_graph =
            by_p.dot(block(p, p) * by_p) + by_q.dot(block(q, q) * by_q) + 2 * by_p.dot(block(p, q) * by_q);
        const double independent = by_p.dot(node_of_frame.at(view_p.frame_idx)->covariance * by_p) +
                                   by_q.dot(node_of_frame.at(view_q.frame_idx)->covariance * by_q);
        m.path = std::sqrt(std::max(0.0, by_graph < independent ? by_graph : independent));
      }
      m.sigma = std::hypot(m.reconstruction, m.path);
      if (m.sigma >= best.sigma) continue;
      const auto seen = [](const Sighting& s, const views::ViewSummary& view) {
        return SeenPoint{.in_world = s.in_world, .frame_idx = view.frame_idx, .range = s.in_cam.norm()};
      };
      m.a = seen(p, view_p), m.b = seen(q, view_q);
      best = m;
    }
  }
  if (!std::isfinite(best.sigma)) {
    throw InputError(where, "the covariances of its path are not finite", "make the output again with 'iris run'");
  }
  return best;
}

}  // namespace iris::exporters
