#include "iris/calibrate/options.h"

namespace iris::calibrate {

void CalibrateOptions::declare(OptionSet& set) {
  set.section("calibrate");
  set.add(
      "distortion", distortion, {"auto", "radial", "radtan4", "radtan", "rational", "fisheye"},
      "lens model: radial (k1 k2, thesis 2.3), radtan4 (and p1 p2), radtan (and k3), rational (and k4 k5 k6), fisheye "
      "(equidistant, k1 to k4); auto: radtan, or radtan4 for formats without k3 (Kalibr, EuRoC)");
  set.add("robust", robust, "sigma", 0, 100,
          "corners that are further off count less (Huber), so that single wrong ones do no harm; 0: all count alike");
  set.add("flatness", flatness, "of the longer side", 0, 0.05,
          "how far the target's corners lie beside where they should be, in the sheet and across it (standard "
          "deviation): their places are calibrated as well where that explains the images better; 0: a perfect target");
  set.add("max_blur", max_blur, "times", 1, 100,
          "images whose borders of black and white are so many times as blurred as those of the others are left out");
  set.add("min_change", min_change, "px", 0, 1000,
          "pairs whose corners moved less on the average since an earlier pair tell nothing new and are left out");
  set.add("max_pairs", max_pairs, "pairs", 3, 1000, "at most so many pairs are used: those that differ most");
  set.add("folds", folds, "parts", 2, 50,
          "cross-validation: each part of the pairs is rectified by a calibration from all others");
}

}  // namespace iris::calibrate
