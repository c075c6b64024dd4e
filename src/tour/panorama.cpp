#include "iris/tour/panorama.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

namespace iris::tour {
namespace {

using Eigen::Vector2d;

std::vector<Vector2d> places_at(const FreeSpace& space, const std::vector<PoseNode>& nodes, double spacing) {
  std::vector<Vector2d> places;
  const auto seen = [&](const Vector2d& point) {
    return std::any_of(places.begin(), places.end(),
                       [&](const Vector2d& place) { return space.straight(place, point, 0); });
  };
  const auto far = [&](const Vector2d& point, double distance) {
    return std::all_of(places.begin(), places.end(),
                       [&](const Vector2d& place) { return (place - point).norm() >= distance; });
  };
  const Vector2d* last = nullptr;  // the last one in sight
  std::vector<Vector2d> path;
  for (const PoseNode& node : nodes) {
    const Vector2d point = node.world_from_cam.translation().head<2>();
    // The camera was there: where the map does not know the place, it is free.
    if (space.state(point) != mapping::MapState::occupied) path.push_back(point);
  }
  for (const Vector2d& point : path) {
    if (far(point, spacing)) {
      places.push_back(point);
    } else if (!seen(point)) {
      // From the last place in sight one sees both.
      const Vector2d& corner = last && far(*last, 0.5 * spacing) ? *last : point;
      if (far(corner, 0.5 * spacing)) places.push_back(corner);
    }
    last = &point;
  }
  return places;
}

}  // namespace

void PanoramaOptions::declare(OptionSet& set) {
  set.section("panorama");
  set.add("width", width, "px", 64, 16384, "Width of a panorama; its height is half of it.");
  set.add("spacing", spacing, "m", 0.01, 1000,
          "Distance of panoramas that are placed automatically: at least so much, or half of it where the path turns "
          "out of sight of the others.");
  set.add("nodes", nodes, "", 0, 10000, "At most so many panoramas; 0 = as many as the spacing gives.");
  set.add("reach", reach, "m", 0.01, 10000,
          "Longest link between panoramas that see each other; those that could not be reached so are linked to the "
          "nearest, however far.");
  set.add("sources", sources, "", 1, 32, "Stored views that a panorama is made from.");
}

std::vector<Vector2d> panorama_places(const FreeSpace& space, const std::vector<PoseNode>& nodes,
                                      const PanoramaOptions& options) {
  const std::vector<Vector2d> all = places_at(space, nodes, options.spacing);
  if (options.nodes == 0 || static_cast<int>(all.size()) <= options.nodes) return all;
  // Each time the one that is farthest from those chosen.
  std::vector<double> distance(all.size(), std::numeric_limits<double>::infinity());
  std::vector<bool> chosen(all.size(), false);
  for (int n = 0; n < options.nodes; ++n) {
    const auto next = static_cast<size_t>(std::max_element(distance.begin(), distance.end()) - distance.begin());
    chosen[next] = true;
    for (size_t i = 0; i < all.size(); ++i) distance[i] = std::min(distance[i], (all[i] - all[next]).norm());
  }
  std::vector<Vector2d> places;  // in the order of the path
  for (size_t i = 0; i < all.size(); ++i) {
    if (chosen[i]) places.push_back(all[i]);
  }
  return places;
}

std::vector<PanoramaNode> link_panoramas(const FreeSpace& space, const std::vector<Vector2d>& places,
                                         const PanoramaOptions& options) {
  constexpr double kSameDirection = 0.906;  // cosine of 25 degrees
  struct Pair {
    double distance;
    int i, j;
  };
  std::vector<Pair> pairs;
  const int count = static_cast<int>(places.size());
  for (int i = 0; i < count; ++i) {
    for (int j = i + 1; j < count; ++j) pairs.push_back({(places[i] - places[j]).norm(), i, j});
  }
  std::stable_sort(pairs.begin(), pairs.end(), [](const Pair& a, const Pair& b) { return a.distance < b.distance; });
  std::vector<PanoramaNode> nodes;
  for (const Vector2d& place : places) nodes.push_back({place, {}});
  std::vector<int> group(places.size());
  std::iota(group.begin(), group.end(), 0);
  const auto link = [&](int i, int j) {
    nodes[i].links.push_back(j);
    nodes[j].links.push_back(i);
    const int from = group[j], to = group[i];
    std::replace(group.begin(), group.end(), from, to);
  };
  const auto taken = [&](int i, int j) {
    const Vector2d direction = (places[j] - places[i]).normalized();
    return std::any_of(nodes[i].links.begin(), nodes[i].links.end(),
                       [&](int k) { return (places[k] - places[i]).normalized().dot(direction) > kSameDirection; });
  };
  for (const Pair& pair : pairs) {
    if (pair.distance > options.reach || pair.distance == 0) continue;
    if (taken(pair.i, pair.j) || taken(pair.j, pair.i) || !space.straight(places[pair.i], places[pair.j], 0)) continue;
    link(pair.i, pair.j);
  }
  for (const Pair& pair : pairs) {
    if (group[pair.i] != group[pair.j]) link(pair.i, pair.j);
  }
  for (PanoramaNode& node : nodes) std::sort(node.links.begin(), node.links.end());
  return nodes;
}

}  // namespace iris::tour
