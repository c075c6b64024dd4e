// Options of calibrating from images of a target.
#pragma once

#include <string>

#include "iris/core/options.h"

namespace iris::calibrate {

struct CalibrateOptions {
  // Lens model: auto | radial (k1 k2, thesis 2.3) | radtan4 (k1 k2 p1 p2) | radtan (k1 k2 p1 p2 k3) | rational (eight)
  // | fisheye (Kannala-Brandt, four). auto: radtan, or radtan4 for formats that have no k3.
  std::string distortion = "auto";
  double robust = 3;  // [times the corners' standard deviation] larger errors count less (Huber); 0 = all alike
  // [of the sheet's longer side] by how much corners lie beside their places on the sheet (standard deviation), which
  // prints and boards do; where they are is then estimated together with the cameras, if the images want it. 0 = the
  // sheet is perfect, as in the thesis.
  double flatness = 0.001;
  double max_blur = 1.8;  // [times the median of all images] images with more blurred borders are left out
  double min_change = 3;  // [px] pairs whose corners moved less on the average since an earlier pair are left out
  int max_pairs = 80;     // at most so many pairs, those that differ most; (2.8) needs no more
  int folds = 5;          // parts into which the pairs are split for cross-validation

  void declare(OptionSet& set);
};

}  // namespace iris::calibrate
