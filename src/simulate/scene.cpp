#include "iris/simulate/scene.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "iris/core/error.h"
#include "scenes.h"

namespace iris::simulate {

namespace {

using Vector3 = Eigen::Vector3d;

struct Entry {
  std::string name;
  Scene (*make)(uint32_t seed);
};

const std::vector<Entry>& entries() {
  static const std::vector<Entry> all = {
      {"apartment", apartment},
      {"seminar-room", seminar_room},
      {"yard", yard},
      {"boxes", boxes},
      {"grasp", grasp},
      {"calibration", [](uint32_t seed) { return calibration_target(TargetKind::squares, seed); }},
      {"calibration:chessboard", [](uint32_t seed) { return calibration_target(TargetKind::chessboard, seed); }},
      {"calibration:charuco", [](uint32_t seed) { return calibration_target(TargetKind::charuco, seed); }},
  };
  return all;
}

}  // namespace

const std::vector<std::string>& scene_names() {
  static const std::vector<std::string> names = [] {
    std::vector<std::string> result;
    for (const Entry& entry : entries()) result.push_back(entry.name);
    return result;
  }();
  return names;
}

Scene make_scene(const std::string& name, int seed) {
  for (const Entry& entry : entries()) {
    if (entry.name != name) continue;
    Scene scene = entry.make(static_cast<uint32_t>(seed));
    scene.name = name;
    return scene;
  }
  throw UsageError(fmt::format("no scene '{}'; there are: {}", name, fmt::join(scene_names(), ", ")));
}

double squared_distance(const Vector3& point, const Vector3& a, const Vector3& b, const Vector3& c) {
  const auto to_edge = [&](const Vector3& from, const Vector3& to) {
    const Vector3 edge = to - from;
    const double length2 = edge.squaredNorm();
    const double s = length2 > 0 ? std::clamp((point - from).dot(edge) / length2, 0.0, 1.0) : 0;
    return (from + s * edge - point).squaredNorm();
  };
  const Vector3 normal = (b - a).cross(c - a);
  const double area2 = normal.squaredNorm();
  if (area2 > 0) {
    const bool inside = (b - a).cross(point - a).dot(normal) >= 0 && (c - b).cross(point - b).dot(normal) >= 0 &&
                        (a - c).cross(point - c).dot(normal) >= 0;
    if (inside) {
      const double height = (point - a).dot(normal);
      return height * height / area2;
    }
  }
  return std::min({to_edge(a, b), to_edge(b, c), to_edge(c, a)});
}

Scene scene_from_meshes(std::vector<TriangleMesh> meshes, const std::string& name) {
  Scene scene{.name = name};
  Eigen::AlignedBox3d box;
  for (TriangleMesh& mesh : meshes) {
    for (const Eigen::Vector3i& triangle : mesh.triangles) {
      for (int i = 0; i < 3; ++i) box.extend(mesh.vertices[static_cast<size_t>(triangle[i])].cast<double>());
    }
    if (mesh.triangles.empty()) continue;
    const bool textured = !mesh.texture.empty() && !mesh.texture_coordinates.empty();
    scene.objects.push_back({.mesh = std::move(mesh), .textured = textured});
  }
  if (box.isEmpty()) throw InputError(name, "has no triangle: there is nothing to see", "give a model with faces");
  // Ways and true maps are laid through the whole scene in steps of centimetres.
  constexpr double kSmallest = 0.001, kLargest = 1000;  // [m]
  const double size = box.diagonal().norm();
  if (!(size >= kSmallest && size <= kLargest)) {
    throw InputError(name, fmt::format("is {:g} m large; a scene has {:g} m to {:g} m", size, kSmallest, kLargest),
                     "scale the model to metres (from millimetres by 0.001)");
  }
  const Vector3 middle = box.center();
  double free = std::numeric_limits<double>::max();
  for (const SceneObject& object : scene.objects) {
    for (const Eigen::Vector3i& t : object.mesh.triangles) {
      const auto corner = [&](int i) { return object.mesh.vertices[static_cast<size_t>(t[i])].cast<double>().eval(); };
      free = std::min(free, squared_distance(middle, corner(0), corner(1), corner(2)));
    }
  }
  free = std::sqrt(free);
  const double reach = size / 2;
  ScenePlaces& places = scene.places;
  if (free > 0.1 * reach) {
    places.circle_centre = middle;
    places.circle_radius = std::min(1.0, 0.6 * free);
    places.stand = middle;
    places.stand_look_at = middle + Vector3::UnitX();
    places.paths = {"circle", "roam", "static"};
  } else {
    places.look_at = {middle};
    places.look_at_distance = 1.5 * reach;
    places.look_at_near = 1.4 * reach;
    places.look_at_far = 2.2 * reach;
    places.stand = middle + Vector3(1.5 * reach, 0, 0);
    places.stand_look_at = middle;
    places.paths = {"circle", "circle-far", "around", "static"};
  }
  return scene;
}

}  // namespace iris::simulate
