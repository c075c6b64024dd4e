#pragma once

#include <string>

#include "iris/core/options.h"

namespace iris::motion {

// Camera motion from spatially consistent sets of corners (SCS, thesis ch. 5).
struct ScsOptions {
  std::string model = "image";  // error model of the last minimisation (4.4): spherical|ellipsoid|drift|image
  double pixel_error = 0.1;     // [px] standard deviation of image coordinates (dp, 4.4); wider lets wrong sets in
  // Corners (5.3.1).
  int max_corners = 500;       // most corners a view, spread over the image by a grid
  int grid_columns = 10;       // cells of that grid across the image; the rows follow from the image's shape
  double min_strength = 1.0;   // [(grey levels/px)^4] least Harris response
  double min_disparity = 4.0;  // [px] corners farther away than this have no useful depth
  // Correspondences (5.3.2).
  std::string compare = "rank";  // how surroundings are compared: rank|sad; sad is there for fig. 5.5
  double max_refinement =
      1.5;               // [px] matches whose refinement moves further are used only if the others do not suffice
  bool any_roll = true;  // after a failure, compare surroundings turned by any angle and scaled by depth
  bool predict = true;   // look for all corners again where the first motion predicts them
  double min_similarity = 0.8;  // correlation coefficient of a corner's surroundings that were found by prediction
  // Confirmation by the whole views, with `predict` only.
  double min_support = 0.15;        // part of the corners expected to be seen again that must be found
  double max_contradiction = 0.35;  // points that the other view looks through, part of those it shows; times support
  // Consistency (5.3.3).
  double max_turn = 45.0;  // [deg] largest rotation between the views (theta of 5.3)
  double ambiguity = 0.7;  // a second set at least this part as large, with another motion, makes the result ambiguous
  // Result.
  int min_used = 8;                     // fewer correspondences than this are a failure
  bool reject_suspicious = true;        // Chauvenet's criterion (5.4)
  double huber_px = 0.3;                // [px] errors beyond this count linearly in the last minimisation; 0 = off
  double max_rms_px = 0.5;              // [px] image error per coordinate that a good motion does not exceed
  double max_rotation_error = 1.0;      // [deg] an estimate whose rotation is less certain (one sigma) is degenerate
  double max_translation_error = 0.02;  // part of the median depth of the points by which the translation may be off
  // [times] by which variances are larger than the residuals show: bounded errors still count in the Hessian as if they
  // told something, and surroundings that are no plane move differently from what is taken for the corner. Measured on
  // simulated rooms and boxes: docs/thesis.md, chapter 5.
  double inflation = 1.5;
  // More than one earlier view (image model only).
  int window = 1;            // earlier views that a motion is measured against; 1 = the previous one, as in the thesis
  int window_corners = 100;  // most corners of each of the others
  double rest = 2.0;  // [px] a view whose corners moved by less (median) since its reference view rests: the next
                      // one is measured against that reference view too; 0 = none rests
  // Failures.
  int retry_views = 5;  // earlier views that a failed estimate is retried against
  bool rescue = true;   // after that, try again with many more corners and with SIFT
  bool guess = false;   // after that, continue the last motion (status guessed) instead of a new sub-map

  void declare(OptionSet& set);
};

}  // namespace iris::motion
