#pragma once

#include <cstdint>
#include <opencv2/core.hpp>

#include "iris/geometry/pose.h"
#include "iris/geometry/rectified_camera.h"
#include "iris/types/disparity_image.h"

namespace iris {

// A stored stereo view: all that mapping, tours and exports need of a frame.
struct StereoView {
  int frame_idx = 0;
  int64_t stamp_ns = 0;
  int submap = 0;
  RectifiedCamera camera;
  cv::Mat image;  // left rectified image, CV_8UC1 or CV_8UC3 (BGR)
  DisparityImage disparity;
  Pose world_from_cam = Pose::Identity();
};

}  // namespace iris
