// From the disparity space of one view into that of another: (x, y, d, 1) of both are related by a 4x4 matrix.
#pragma once

#include <Eigen/Core>
#include <Eigen/LU>
#include <cmath>

#include "iris/types/stereo_view.h"

namespace iris::render {

class DisparityMap {
 public:
  // Disparities are as the images hold them, without the cameras' offsets.
  DisparityMap(const RectifiedCamera& to_camera, const RectifiedCamera& from_camera, const Pose& to_from_from) {
    matrix_ = (space_from_cam(to_camera) * to_from_from.matrix() * space_from_cam(from_camera).inverse()).cast<float>();
    from_offset_ = static_cast<float>(from_camera.disparity_offset);
    to_offset_ = static_cast<float>(to_camera.disparity_offset);
  }
  DisparityMap(const StereoView& to, const StereoView& from)
      : DisparityMap(to.camera, from.camera, to.world_from_cam.inverse() * from.world_from_cam) {}

  struct Image {
    float x = -1, y = -1;     // [px]; -1: behind the camera
    float disparity = 0;      // [px]
    float per_disparity = 0;  // change of this disparity with that of the other view, >= 0
  };
  Image apply(float x, float y, float disparity) const {
    const float d = disparity + from_offset_;
    const auto row = [&](int i) { return matrix_(i, 0) * x + matrix_(i, 1) * y + matrix_(i, 2) * d + matrix_(i, 3); };
    const float w = row(3);
    // w is the depth in the other camera over that in this one, both positive in front of it.
    if (!(w > 1e-6f)) return {};
    const float per_w = 1 / w, to = row(2) * per_w;
    return {.x = row(0) * per_w,
            .y = row(1) * per_w,
            .disparity = to - to_offset_,
            .per_disparity = std::abs((matrix_(2, 2) - to * matrix_(3, 2)) * per_w)};
  }

 private:
  // (x, y, d, 1) ~ M (X, Y, Z, 1), d with its offset; the last component is Z.
  static Eigen::Matrix4d space_from_cam(const RectifiedCamera& camera) {
    Eigen::Matrix4d m = Eigen::Matrix4d::Zero();
    m(0, 0) = m(1, 1) = camera.f;
    m(0, 2) = camera.cx;
    m(1, 2) = camera.cy;
    m(2, 3) = camera.f * camera.baseline;
    m(3, 2) = 1;
    return m;
  }

  Eigen::Matrix4f matrix_;
  float from_offset_ = 0, to_offset_ = 0;
};

}  // namespace iris::render
