#pragma once

#include <opencv2/core.hpp>
#include <vector>

#include "iris/geometry/pose.h"

namespace iris {

enum class Projection { pinhole, equirectangular };

// A virtual camera. Camera frame: x right, y down, z forward.
// pinhole: pixel = f * (x/z, y/z) + (cx, cy). equirectangular: the whole sphere, longitude over the width (the middle
// column looks along z), latitude over the height; f, cx, cy are unused.
struct NovelCamera {
  Projection projection = Projection::pinhole;
  int width = 0, height = 0;     // [px]
  double f = 0, cx = 0, cy = 0;  // [px]
  Pose world_from_cam = Pose::Identity();
};

// A picture from where no camera stood.
struct NovelView {
  cv::Mat3b image;   // BGR
  cv::Mat1f depth;   // [m] true depth along the optical axis (pinhole) or range (equirectangular); 0 = hole
  cv::Mat1s source;  // index of the source view, -1 = hole
};

// Keyframes of a virtual camera; t in seconds, ascending.
struct CameraKeyframe {
  double t = 0;
  Pose world_from_cam = Pose::Identity();
  double fov = 0;  // [rad] vertical
};
struct CameraPath {
  enum class Interpolation { linear, spline };  // between keyframes: straight, or as a smooth curve through them
  std::vector<CameraKeyframe> keyframes;
  Interpolation interpolation = Interpolation::linear;
  double ease = 0;  // [s] in which the camera gathers speed at the beginning, and loses it at the end
};

}  // namespace iris
