// Small scenes of which everything can be said in closed form.
#pragma once

#include <Eigen/Geometry>
#include <functional>
#include <utility>

#include "iris/simulate/scene.h"

namespace iris::simulate {

// A rectangle from `origin` along `a` and `b`; the texture covers it once.
inline SceneObject rectangle(const Eigen::Vector3d& origin, const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                             cv::Vec3b colour = {200, 200, 200}) {
  SceneObject object;
  object.mesh.vertices = {origin.cast<float>(), (origin + a).cast<float>(), (origin + a + b).cast<float>(),
                          (origin + b).cast<float>()};
  object.mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
  object.mesh.texture_coordinates = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
  object.mesh.colour = colour;
  return object;
}

inline SceneObject with_texture(SceneObject object, const cv::Mat3b& texture) {
  object.mesh.texture = texture;
  return object;
}

// Waves across a texture: `waves` of them over its width and its height.
inline cv::Mat3b wave_texture(int size, double waves) {
  cv::Mat3b texture(size, size);
  for (int y = 0; y < size; ++y) {
    for (int x = 0; x < size; ++x) {
      const double k = 2 * CV_PI * waves / size;
      const auto value =
          cv::saturate_cast<uchar>(128 + 40 * std::sin(k * (x + 0.5)) + 40 * std::cos(k * (y + 0.5) + 0.7));
      texture(y, x) = {value, value, value};
    }
  }
  return texture;
}

inline Scene scene_of(std::vector<SceneObject> objects, const char* name = "test") {
  Scene scene;
  scene.name = name;
  scene.objects = std::move(objects);
  return scene;
}

// World = the camera's frame at time 0 (x right, y down, z forward), unless a pose is given.
inline SimulatedPath still_path(const Pose& pose = Pose::Identity()) {
  return {.name = "static", .seconds = 1, .length = 0, .world_from_cam = [pose](double) { return pose; }};
}

inline SimulatedPath moving_path(double seconds, std::function<Pose(double)> pose) {
  return {.name = "moving", .seconds = seconds, .length = 0, .world_from_cam = std::move(pose)};
}

inline Pose shifted(double x, double y, double z) { return Pose(Eigen::Translation3d(x, y, z)); }

// Small, without noise or blur.
inline SimulateOptions plain_options(const char* lens) {
  SimulateOptions options;
  options.lens = lens;
  options.width = 320;
  options.height = 200;
  options.frames = 1;
  options.snr = 0;
  options.exposure = 0;
  return options;
}

}  // namespace iris::simulate
