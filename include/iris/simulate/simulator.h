// Renders what a stereo camera sees on its way through a scene, and the truth that belongs to it.
#pragma once

#include <cstdint>
#include <memory>
#include <opencv2/core.hpp>
#include <vector>

#include "iris/geometry/rectified_camera.h"
#include "iris/simulate/scene.h"
#include "iris/types/stereo_frame.h"

namespace iris::simulate {

// What is known of one frame, in the rectified left camera (that of rectify::Rectifier for the rig's calibration).
struct FrameTruth {
  cv::Mat1f disparity;      // [px] of the pixel's central ray; 0 = sky or outside of what the recorded camera sees
  cv::Mat1b occluded;       // 255 where the right camera does not see the point (hidden, or outside of its image)
  cv::Mat1b discontinuity;  // 255 within 3 px of neighbours whose disparities differ by more than 1 px
  cv::Mat1b textured;       // 255 where the surface carries texture that can be matched
};

// Embree traces the rays (options.rays a pixel). Everything is a function of scene, options and frame index: frames may
// be asked for in any order, from any number of threads; the bytes are always the same.
class Simulator {
 public:
  Simulator(const Scene& scene, const SimulatedPath& path, const SimulateOptions& options);
  ~Simulator();

  int frames() const;
  const StereoCalibration& calibration() const;
  const RectifiedCamera& rectified_camera() const;
  // The middle of the frame's exposure; sessions of different scenes or options do not overlap in time.
  int64_t stamp_ns(int frame_idx) const;
  Pose world_from_left(int frame_idx) const;  // left camera as recorded

  StereoFrame frame(int frame_idx) const;
  FrameTruth truth(int frame_idx) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iris::simulate
