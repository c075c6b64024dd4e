// What is simulated: the path, the rig and what its cameras do to the light.
#pragma once

#include <cstdint>
#include <string>

#include "iris/core/options.h"
#include "iris/geometry/stereo_calibration.h"

namespace iris::simulate {

struct SimulateOptions {
  std::string path =
      "auto";  // auto | circle | circle-far | roam | round | corridor | static | around (what a scene offers differs)
  int frames = 0;     // 0 = as many as the path takes at this rate and speed
  double rate = 5;    // [1/s] frames a second (thesis 5.4.3: 1.5 to 25)
  double speed = 1;   // [m/s] of the camera
  double jitter = 1;  // [times] shaking of the hand: 1 = 8 mm and 0.6 deg (standard deviation), 0 = none
  int seed = 1;       // of scene, shaking and noise

  int width = 752;            // [px]
  int height = 480;           // [px]
  double fov = 80;            // [deg] horizontal, of the lens without its distortion
  double baseline = 0.11;     // [m]
  std::string lens = "real";  // real: radial-tangential distortion, unequal intrinsics, slightly turned right camera;
                              // ideal: neither

  int rays = 4;                // rays over a pixel's area (averaged); a square number
  double snr = 45;             // [dB] 20 log10(255 / standard deviation of the noise); 0 = no noise
  double exposure = 8;         // [ms] the image is the mean over this time: motion blur; 0 = none
  double exposure_drift = 0;   // [%] amplitude of the slow change of brightness, both cameras alike
  double gain_difference = 0;  // [%] the right camera is brighter by so much, and drifts
  double vignetting = 0;       // [%] loss of light in the corners of the image
  bool colour = false;         // colour images, else grey

  void declare(OptionSet& set);
};

// The rig of the options: its calibration is what the recorded session carries.
StereoCalibration simulated_rig(const SimulateOptions& options);

}  // namespace iris::simulate
