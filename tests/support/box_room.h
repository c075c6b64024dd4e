// Stereo views of the inside of a box, with exact or noisy disparities: the truth is four walls, a floor and a ceiling.
#pragma once

#include <cmath>
#include <cstdint>
#include <random>

#include "iris/types/stereo_view.h"

namespace iris::testing {

struct BoxRoom {
  Eigen::Vector3d low{-2.03, -1.52, -1.2}, high{2.27, 1.61, 1.4};  // [m] world, z up
};

// A camera at `position` that looks along (cos yaw, sin yaw) and is tilted up by `pitch` [rad].
inline Pose level_camera(const Eigen::Vector3d& position, double yaw, double pitch = 0) {
  Pose pose = Pose::Identity();
  const Eigen::Vector3d forward(std::cos(yaw) * std::cos(pitch), std::sin(yaw) * std::cos(pitch), std::sin(pitch));
  const Eigen::Vector3d right(std::sin(yaw), -std::cos(yaw), 0);
  pose.linear().col(0) = right;
  pose.linear().col(1) = forward.cross(right);
  pose.linear().col(2) = forward;
  pose.translation() = position;
  return pose;
}

// The view of a camera in the room; noise: standard deviation of the disparity [px]. Walls have different colours.
inline StereoView view_of(const BoxRoom& room, const RectifiedCamera& camera, const Pose& world_from_cam,
                          double noise = 0, uint32_t seed = 1) {
  StereoView view;
  view.camera = camera;
  view.world_from_cam = world_from_cam;
  view.disparity.disparity = cv::Mat1f(camera.height, camera.width);
  view.disparity.origin = cv::Mat1b(camera.height, camera.width, static_cast<uint8_t>(DisparityOrigin::measured));
  cv::Mat3b image(camera.height, camera.width);
  std::mt19937 random(seed);
  std::normal_distribution<double> normal(0, 1);
  for (int y = 0; y < camera.height; ++y) {
    for (int x = 0; x < camera.width; ++x) {
      const Eigen::Vector3d sight =
          world_from_cam.linear() * Eigen::Vector3d((x - camera.cx) / camera.f, (y - camera.cy) / camera.f, 1);
      double depth = 1e9;
      int wall = 0;
      for (int a = 0; a < 3; ++a) {
        if (sight[a] == 0) continue;
        const double plane = sight[a] > 0 ? room.high[a] : room.low[a];
        const double s = (plane - world_from_cam.translation()[a]) / sight[a];
        if (s < depth) depth = s, wall = 2 * a + (sight[a] > 0);
      }
      view.disparity.disparity(y, x) =
          static_cast<float>(camera.f * camera.baseline / depth - camera.disparity_offset + noise * normal(random));
      image(y, x) = cv::Vec3b(static_cast<uint8_t>(40 * wall), static_cast<uint8_t>(250 - 40 * wall), 100);
    }
  }
  view.image = image;
  return view;
}

}  // namespace iris::testing
