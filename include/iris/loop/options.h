#pragma once

#include <algorithm>

#include "iris/core/options.h"

namespace iris::loop {

// Loop closures: which views are compared, what makes a motion between them a loop, and what follows from it (thesis
// 5.5 and ch. 10, which leave loops to later work).
struct LoopOptions {
  bool enabled = true;  // look for loops and correct the path by them
  bool bundle = true;   // adjust all poses over all points afterwards
  // Candidates.
  int min_gap = 10;               // [stored views] pairs nearer in time are no loops: odometry links them well enough
  int overlap_candidates = 6;     // most pairs a view that predicted overlap proposes; 0 = none
  double min_overlap = 0.3;       // part of a view that is expected to be seen in the other one
  int appearance_candidates = 4;  // most pairs a view that look alike, whatever the poses say; 0 = none
  double min_similarity = 0.2;    // of appearance, as a part of how much the view resembles its neighbour in time
  int descriptors = 500;          // features a view that stand for its appearance
  // What odometry is trusted for.
  // [times] by which the errors of motions are larger than their covariances say: errors of neighbouring corners go
  // together, which those do not know. What is assumed before the recording itself has told (see RefinedGraph). In a
  // simulated flat loops tell 1.5 of odometry and 1.4 of themselves; then the normalised squared errors of the poses,
  // 1 if all is right, are 1.3 against the first view (0.4 with 2.5 for both). On EuRoC MH01 loops tell 2.6 and 2.1,
  // which is too little: those of the poses stay far above 1, errors of its truth included.
  double sigma = 2.5;
  bool estimate_sigma = true;  // let it tell
  double drift = 0.005;        // [m/m] standard deviation of a systematic error in odometry's translation
  double turn_drift = 0.05;    // [deg/m] and in its rotation
  // Verification.
  double max_turn = 180;       // [deg] largest rotation between the views (theta of 5.3), replaces motion.max_turn
  bool rescue = true;          // compare with SIFT where corners do not match
  int min_used = 25;           // least number of correspondences of a loop
  double min_spread = 0.08;    // least part of the image (of both views) that they cover
  double min_agreement = 0.8;  // least part of what both views measure that fits together
  // Consistency between loops.
  double max_chi_square = 22.5;  // of six degrees of freedom: 99.9 % of true ones. From there on a loop loses weight
  // Least number of loops that agree about how two sub-maps lie; one of n min_used correspondences counts as n.
  int min_joining_loops = 3;
  // Minimisation over all motions.
  int max_iterations = 50;  // in each of at most three rounds
  // Resources.
  int cache_mb = 256;  // [MB] of views that are kept while candidates are verified

  // What a loop of so many correspondences (0 = not known) counts when sub-maps are joined.
  double votes(int used) const { return std::max(1.0, static_cast<double>(used) / min_used); }

  void declare(OptionSet& set);
};

}  // namespace iris::loop
