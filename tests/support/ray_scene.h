// A scene of textured rectangles that is ray-cast exactly: pictures, depths and disparities without any error.
#pragma once

#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include "iris/types/novel_view.h"
#include "iris/types/stereo_view.h"

namespace iris::testing {

// Rectangle: corner + a u + b v, u and v in [0, 1]. `a` and `b` are perpendicular [m].
struct Rectangle {
  Eigen::Vector3d corner, a, b;
  double phase = 0;  // makes textures differ
};

struct SceneHit {
  double along = std::numeric_limits<double>::infinity();  // s of origin + s direction
  Eigen::Vector3d colour = Eigen::Vector3d::Zero();        // BGR
};

struct RayScene {
  std::vector<Rectangle> rectangles;

  // A smooth texture with details down to `kFinest` metres.
  static constexpr double kFinest = 0.12;
  static Eigen::Vector3d texture(double u, double v, double phase) {
    constexpr double k = 2 * M_PI / kFinest;
    Eigen::Vector3d colour;
    for (int c = 0; c < 3; ++c) {
      const double p = phase + 1.3 * c;
      colour[c] = 128 + 35 * std::sin(k * u / 4 + p) + 35 * std::sin(k * v / 3 - p) +
                  25 * std::sin(k * (u + v) / 2 + 2 * p) + 15 * std::sin(k * u + p) * std::sin(k * v);
    }
    return colour;
  }

  SceneHit cast(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) const {
    SceneHit hit;
    for (const Rectangle& r : rectangles) {
      const Eigen::Vector3d normal = r.a.cross(r.b);
      const double slope = normal.dot(direction);
      if (std::abs(slope) < 1e-12) continue;
      const double s = normal.dot(r.corner - origin) / slope;
      if (s <= 1e-9 || s >= hit.along) continue;
      const Eigen::Vector3d on = origin + s * direction - r.corner;
      const double u = on.dot(r.a) / r.a.squaredNorm(), v = on.dot(r.b) / r.b.squaredNorm();
      if (u < 0 || u > 1 || v < 0 || v > 1) continue;
      hit.along = s;
      hit.colour = texture(u * r.a.norm(), v * r.b.norm(), r.phase);
    }
    return hit;
  }

  // What a stereo camera records of the scene, with exact disparities of full density.
  StereoView view(const RectifiedCamera& camera, const Pose& world_from_cam, int frame_idx = 0) const {
    StereoView view{.frame_idx = frame_idx,
                    .stamp_ns = frame_idx * 100000000LL,
                    .camera = camera,
                    .image = cv::Mat3b(camera.height, camera.width),
                    .disparity = {cv::Mat1f(camera.height, camera.width, 0.0f),
                                  cv::Mat1b(camera.height, camera.width, static_cast<uint8_t>(0))},
                    .world_from_cam = world_from_cam};
    for (int y = 0; y < camera.height; ++y) {
      for (int x = 0; x < camera.width; ++x) {
        const Eigen::Vector3d ray((x - camera.cx) / camera.f, (y - camera.cy) / camera.f, 1);
        const SceneHit hit = cast(world_from_cam.translation(), world_from_cam.linear() * ray);
        cv::Vec3b& pixel = view.image.at<cv::Vec3b>(y, x);
        for (int c = 0; c < 3; ++c) pixel[c] = cv::saturate_cast<uint8_t>(hit.colour[c]);
        if (!std::isfinite(hit.along)) continue;
        const double disparity = camera.f * camera.baseline / hit.along - camera.disparity_offset;
        if (disparity <= 0) continue;
        view.disparity.disparity(y, x) = static_cast<float>(disparity);
        view.disparity.origin(y, x) = static_cast<uint8_t>(DisparityOrigin::measured);
      }
    }
    return view;
  }

  // What the novel camera must see. `ray(x, y)` gives the direction of a pixel in its frame.
  template <typename Ray>
  NovelView truth(const NovelCamera& camera, const Ray& ray) const {
    NovelView view{.image = cv::Mat3b(camera.height, camera.width),
                   .depth = cv::Mat1f(camera.height, camera.width, 0.0f),
                   .source = cv::Mat1s(camera.height, camera.width, static_cast<int16_t>(-1))};
    for (int y = 0; y < camera.height; ++y) {
      for (int x = 0; x < camera.width; ++x) {
        const SceneHit hit = cast(camera.world_from_cam.translation(), camera.world_from_cam.linear() * ray(x, y));
        for (int c = 0; c < 3; ++c) view.image(y, x)[c] = cv::saturate_cast<uint8_t>(hit.colour[c]);
        if (std::isfinite(hit.along)) view.depth(y, x) = static_cast<float>(hit.along);
      }
    }
    return view;
  }
};

// A room of 6 x 3 x 8 m with two boards standing in it; camera frame of the identity pose: x right, y down, z forward.
inline RayScene room() {
  using V = Eigen::Vector3d;
  RayScene scene;
  scene.rectangles = {
      {V(-3, -1.5, 6), V(6, 0, 0), V(0, 3, 0), 0.1},           // far wall
      {V(-3, 1.5, -2), V(6, 0, 0), V(0, 0, 8), 0.9},           // floor
      {V(-3, -1.5, -2), V(6, 0, 0), V(0, 0, 8), 1.7},          // ceiling
      {V(-3, -1.5, -2), V(0, 3, 0), V(0, 0, 8), 2.3},          // left wall
      {V(3, -1.5, -2), V(0, 3, 0), V(0, 0, 8), 3.1},           // right wall
      {V(-1.2, -0.6, 2.6), V(1, 0, 0), V(0, 1.2, 0), 4.0},     // near board
      {V(0.7, -0.8, 4.2), V(1.2, 0, 0.5), V(0, 1.6, 0), 5.2},  // far, slanting board
  };
  return scene;
}

inline RectifiedCamera scene_camera() {
  return {.f = 260, .cx = 155.3, .cy = 121.8, .baseline = 0.2, .disparity_offset = 0, .width = 320, .height = 240};
}

// A pose from a position [m] and a rotation vector [rad].
inline Pose pose_at(const Eigen::Vector3d& position, const Eigen::Vector3d& rotation = Eigen::Vector3d::Zero()) {
  Pose pose = Pose::Identity();
  if (rotation.norm() > 0) pose.linear() = Eigen::AngleAxisd(rotation.norm(), rotation.normalized()).matrix();
  pose.translation() = position;
  return pose;
}

inline NovelCamera novel_of(const RectifiedCamera& camera, const Pose& world_from_cam) {
  return {.projection = Projection::pinhole,
          .width = camera.width,
          .height = camera.height,
          .f = camera.f,
          .cx = camera.cx,
          .cy = camera.cy,
          .world_from_cam = world_from_cam};
}

// [dB] over the pixels that `shown` has and `truth` too.
inline double psnr(const NovelView& shown, const NovelView& truth) {
  double sum = 0, count = 0;
  for (int y = 0; y < shown.image.rows; ++y) {
    for (int x = 0; x < shown.image.cols; ++x) {
      if (shown.source(y, x) < 0 || truth.depth(y, x) <= 0) continue;
      for (int c = 0; c < 3; ++c) {
        const double difference = double(shown.image(y, x)[c]) - truth.image(y, x)[c];
        sum += difference * difference;
        ++count;
      }
    }
  }
  return count == 0 ? 0 : 10 * std::log10(255.0 * 255.0 / (sum / count));
}

inline double coverage(const NovelView& view) {
  double seen = 0;
  for (const int16_t source : view.source) seen += source >= 0;
  return seen / static_cast<double>(view.source.total());
}

}  // namespace iris::testing
