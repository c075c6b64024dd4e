// What a camera makes of the light: brightness, noise, 8 bits.
#pragma once

#include <cstdint>
#include <vector>

#include "iris/simulate/options.h"

namespace iris::simulate {

class Sensor {
 public:
  explicit Sensor(const SimulateOptions& options);

  // Factor on the grey values of a camera (0 = left, 1 = right) at time t [s]:
  //   left   1 + a sin(2 pi t / 19 s + p),            a = exposure_drift
  //   right  left * (1 + g (1 + sin(2 pi t / 13 s + q) / 2)),   g = gain_difference
  // with phases p, q that follow from the seed.
  double gain(int camera, double t) const;

  // Factor on the grey values of a pixel: 1 - v r^2, v = vignetting, r = distance from the image's middle, 1 in the
  // corners.
  double vignetting(int x, int y) const;

  // One row of an image from the light that fell on it: gain, vignetting, Gaussian noise of standard deviation
  // noise_sigma() (independent for each pixel and channel, a function of seed, frame, camera and place alone), rounding
  // to 0 … 255. `light` and `values` hold `width * channels` numbers; `factor` is multiplied to all of them.
  void record_row(const float* light, double factor, int channels, int frame_idx, int camera, int row,
                  uint8_t* values) const;

  double noise_sigma() const { return noise_sigma_; }

 private:
  int width_, height_;
  uint64_t seed_;
  double exposure_drift_, gain_difference_, vignetting_, noise_sigma_;
};

}  // namespace iris::simulate
