#include "iris/simulate/options.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

#include "iris/core/error.h"

namespace iris::simulate {

namespace {

// [deg] The distortion polynomial is a good lens within this field of view; farther out it smears the image.
constexpr double kWidestRealLens = 100;

}  // namespace

void SimulateOptions::declare(OptionSet& set) {
  set.section("simulate");
  set.add(
      "path", path, {},
      "way of the camera: auto (the scene's first), circle (level, round what there is to see or looking outwards), "
      "circle-far, roam (any direction, with full turns about the optical axis), round (through all rooms and back), "
      "corridor (forth and back), static, around (a target from many sides); a scene names those it offers");
  set.add("frames", frames, "", 0, 1000000, "number of stereo frames; 0 = as many as the way takes at this speed");
  set.add("rate", rate, "1/s", 0.01, 1000,
          "frames a second; between few frames the view changes much, the thesis recorded 1.5 and more");
  set.add("speed", speed, "m/s", 0.001, 100,
          "speed of the camera on straight stretches; it turns by 45 degrees a second at most (roam: 60)");
  set.add("jitter", jitter, "times", 0, 20,
          "shaking of the hand that carries the camera; 1 = 8 mm and 0.6 degrees standard deviation, 0 = none");
  set.add("seed", seed, "", 0, 2147483647, "another seed, another furniture, shaking and noise");

  set.add("width", width, "px", 16, 16384, "width of the recorded images");
  set.add("height", height, "px", 16, 16384, "height of the recorded images");
  set.add("fov", fov, "deg", 5, 150,
          "horizontal field of view of the lens without its distortion; wider sees more, with less precise distances");
  set.add("baseline", baseline, "m", 0.001, 100,
          "distance of the two cameras; wider measures farther, but nothing close by");
  set.add("lens", lens, {"real", "ideal"},
          "real: distorting lenses, two cameras that differ and are turned against each other a little: the recording "
          "must be rectified; ideal: a rectified recording");

  set.add("rays", rays, "", 1, 4096, "rays over the area of a pixel, a square number; more of them, finer edges");
  set.add("snr", snr, "dB", 0, 200,
          "signal to noise: 20 log10(255 / standard deviation of the grey values); 45 is a good camera, 30 a poor one, "
          "0 = no noise");
  set.add("exposure", exposure, "ms", 0, 10000, "images are the mean over this time: motion blur; 0 = none");
  set.add("exposure_drift", exposure_drift, "%", 0, 90,
          "amplitude of a slow change of brightness that both cameras have alike (automatic exposure)");
  set.add("gain_difference", gain_difference, "%", 0, 90,
          "the right camera is brighter by so much, and this difference drifts by half of its amount");
  set.add("vignetting", vignetting, "%", 0, 95, "loss of light in the corners of the images");
  set.add("colour", colour, "record colour images, else grey ones");
}

StereoCalibration simulated_rig(const SimulateOptions& options) {
  constexpr double kDegree = std::numbers::pi / 180;
  const double w = options.width, h = options.height;
  const double f = w / 2 / std::tan(options.fov / 2 * kDegree);
  const auto intrinsics = [&](double fx, double fy, double cx, double cy) {
    CameraModel camera;
    camera.width = options.width;
    camera.height = options.height;
    camera.K << fx * f, 0, (w - 1) / 2 + cx * w, 0, fy * f, (h - 1) / 2 + cy * h, 0, 0, 1;
    return camera;
  };
  StereoCalibration rig;
  rig.source = "simulated";
  if (options.lens == "ideal") {
    rig.left = rig.right = intrinsics(1, 1, 0, 0);
    rig.right_from_left.translation() = Eigen::Vector3d(-options.baseline, 0, 0);
    rig.rectified = true;
    return rig;
  }
  if (options.lens == "real" && options.fov > kWidestRealLens) {
    throw UsageError(
        fmt::format("simulate.fov = {} deg is too wide for the distortion of simulate.lens = real; at most {} "
                    "deg, or simulate.lens = ideal",
                    options.fov, kWidestRealLens));
  }
  if (options.lens != "real") throw UsageError("simulate.lens is '" + options.lens + "'; it must be real or ideal");
  // As two copies of one small camera differ; the mean of the four focal lengths, that of the rectified images, is f.
  rig.left = intrinsics(1.0030, 1.0005, -0.0090, 0.0085);
  rig.right = intrinsics(0.9990, 0.9975, 0.0065, -0.0060);
  rig.left.coefficients = {-0.2834, 0.0739, 1.9e-4, 1.8e-5};
  rig.right.coefficients = {-0.2771, 0.0702, -1.2e-4, 0.9e-4};
  const Eigen::Matrix3d turn = (Eigen::AngleAxisd(0.45 * kDegree, Eigen::Vector3d::UnitY()) *
                                Eigen::AngleAxisd(-0.30 * kDegree, Eigen::Vector3d::UnitX()) *
                                Eigen::AngleAxisd(0.35 * kDegree, Eigen::Vector3d::UnitZ()))
                                   .toRotationMatrix();
  // The cameras are as far from each other as the options say, along a line that is not quite the left camera's x.
  const double scale = std::min(1.0, options.baseline / 0.02);
  const double y = 0.0012 * scale, z = -0.0017 * scale;
  const Eigen::Vector3d right_centre(std::sqrt(options.baseline * options.baseline - y * y - z * z), y, z);
  rig.right_from_left.linear() = turn;
  rig.right_from_left.translation() = -turn * right_centre;
  return rig;
}

}  // namespace iris::simulate
