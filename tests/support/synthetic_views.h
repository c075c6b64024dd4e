// Stereo views of a made-up scene, ray-cast analytically: left image and exact disparities.
#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
#include <numbers>
#include <opencv2/core.hpp>

#include "iris/geometry/pose.h"
#include "iris/geometry/rectified_camera.h"
#include "iris/types/disparity_image.h"

namespace iris::testing {

// A number in [0, 1) from whole coordinates: the same on every machine.
inline double hashed(int64_t a, int64_t b, int64_t c) {
  uint64_t h = 0x9E3779B97F4A7C15ull * static_cast<uint64_t>(a + 0x10001) +
               0xC2B2AE3D27D4EB4Full * static_cast<uint64_t>(b + 0x20003) +
               0x165667B19E3779F9ull * static_cast<uint64_t>(c + 0x30005);
  for (int i = 0; i < 3; ++i) {
    h ^= h >> 29;
    h *= 0xBF58476D1CE4E5B9ull;
  }
  return static_cast<double>(h >> 11) * 0x1p-53;
}

// Smooth noise in [0, 1] over a surface whose points carry coordinates (u, v) [m]; `cell` [m] is its coarsest detail.
inline double texture(double u, double v, int surface, double cell = 0.4) {
  double sum = 0, weight = 0;
  for (int octave = 0; octave < 4; ++octave, cell /= 2) {
    const double x = u / cell, y = v / cell;
    const auto x0 = static_cast<int64_t>(std::floor(x)), y0 = static_cast<int64_t>(std::floor(y));
    double fx = x - static_cast<double>(x0), fy = y - static_cast<double>(y0);
    fx = fx * fx * (3 - 2 * fx);
    fy = fy * fy * (3 - 2 * fy);
    const int64_t layer = surface * 16 + octave;
    const double top = (1 - fx) * hashed(x0, y0, layer) + fx * hashed(x0 + 1, y0, layer);
    const double bottom = (1 - fx) * hashed(x0, y0 + 1, layer) + fx * hashed(x0 + 1, y0 + 1, layer);
    sum += (1 - fy) * top + fy * bottom;
    weight += 1;
  }
  return sum / weight;
}

// A room seen from inside: an axis-aligned box 6 m wide, 3 m high, 8 m long around the origin (x right, y down, z
// forward), with a smaller box standing in it.
struct Room {
  Eigen::Vector3d low{-3, -1.5, -4}, high{3, 1.5, 4};
  Eigen::Vector3d box_low{-0.9, 0.2, 2.0}, box_high{0.3, 1.5, 2.8};

  // Depth along the ray start + s direction and grey value [0, 1] at the nearest surface.
  std::pair<double, double> cast(const Eigen::Vector3d& start, const Eigen::Vector3d& direction) const {
    double nearest = std::numeric_limits<double>::infinity();
    int face = -1;
    for (int axis = 0; axis < 3; ++axis) {  // leaving the room
      if (direction(axis) == 0) continue;
      const double s = ((direction(axis) > 0 ? high : low)(axis)-start(axis)) / direction(axis);
      if (s < nearest) {
        nearest = s;
        face = axis * 2 + (direction(axis) > 0 ? 1 : 0);
      }
    }
    double enter = 0, leave = nearest;  // entering the box
    int box_face = -1;
    for (int axis = 0; axis < 3; ++axis) {
      if (direction(axis) == 0) continue;
      double s0 = (box_low(axis) - start(axis)) / direction(axis),
             s1 = (box_high(axis) - start(axis)) / direction(axis);
      if (s0 > s1) std::swap(s0, s1);
      if (s0 > enter) {
        enter = s0;
        box_face = 6 + axis;
      }
      leave = std::min(leave, s1);
    }
    if (box_face >= 0 && enter < leave) {
      nearest = enter;
      face = box_face;
    }
    const Eigen::Vector3d p = start + nearest * direction;
    const int axis = face < 6 ? face / 2 : face - 6;
    return {nearest, texture(p((axis + 1) % 3), p((axis + 2) % 3), face)};
  }
};

struct SyntheticView {
  cv::Mat1b image;
  DisparityImage disparity;
};

// Each grey value is the mean over 2x2 rays a pixel; disparities are those of the pixel centres.
inline SyntheticView render_room(const Room& room, const RectifiedCamera& camera, const Pose& world_from_cam) {
  SyntheticView view;
  view.image.create(camera.height, camera.width);
  view.disparity.disparity.create(camera.height, camera.width);
  view.disparity.origin = cv::Mat1b(camera.height, camera.width, static_cast<uint8_t>(DisparityOrigin::measured));
  const auto ray = [&](double x, double y) {
    return room.cast(
        world_from_cam.translation(),
        world_from_cam.linear() * Eigen::Vector3d((x - camera.cx) / camera.f, (y - camera.cy) / camera.f, 1));
  };
  for (int y = 0; y < camera.height; ++y) {
    for (int x = 0; x < camera.width; ++x) {
      double grey = 0;
      for (const double dy : {-0.25, 0.25})
        for (const double dx : {-0.25, 0.25}) grey += ray(x + dx, y + dy).second;
      view.image(y, x) = static_cast<uint8_t>(std::lround(std::min(255.0, grey / 4 * 255)));
      const double depth = ray(x, y).first;  // the direction's z is 1
      view.disparity.disparity(y, x) = static_cast<float>(camera.f * camera.baseline / depth - camera.disparity_offset);
    }
  }
  return view;
}

// World from camera: turned by yaw about y (down), then pitch about x (right), then roll about z (forward) [deg].
inline Pose pose(const Eigen::Vector3d& position, double yaw, double pitch, double roll) {
  constexpr double kDegree = std::numbers::pi / 180;
  Pose world_from_cam = Pose::Identity();
  world_from_cam.linear() = (Eigen::AngleAxisd(yaw * kDegree, Eigen::Vector3d::UnitY()) *
                             Eigen::AngleAxisd(pitch * kDegree, Eigen::Vector3d::UnitX()) *
                             Eigen::AngleAxisd(roll * kDegree, Eigen::Vector3d::UnitZ()))
                                .toRotationMatrix();
  world_from_cam.translation() = position;
  return world_from_cam;
}

}  // namespace iris::testing
