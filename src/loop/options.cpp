#include "iris/loop/options.h"

namespace iris::loop {

void LoopOptions::declare(OptionSet& set) {
  set.section("loop");
  set.add("enabled", enabled, "recognise places that were seen before and correct the path by them");
  set.add("bundle", bundle,
          "after loops are closed, adjust all poses over all points that several views share (bundle adjustment)");
  set.add("min_gap", min_gap, "", 1, 100000, "views nearer to each other than this many stored views are no loops");
  set.add("overlap_candidates", overlap_candidates, "", 0, 1000,
          "most earlier views that a view is compared with because the poses say that they see the same; 0 = none");
  set.add("min_overlap", min_overlap, "", 0.01, 1,
          "least part of a view that is expected to be seen in the other one, given the poses and their uncertainty");
  set.add("appearance_candidates", appearance_candidates, "", 0, 1000,
          "most views that a view is compared with because they look alike, whatever the poses say; 0 = none");
  set.add("min_similarity", min_similarity, "", 0, 1,
          "least likeness of such views, as a part of how much a view resembles its neighbour in time");
  set.add("descriptors", descriptors, "", 20, 2000, "features a view by which views are found that look alike");
  set.add("sigma", sigma, "times", 0.1, 100,
          "how many times the standard deviations that motions claim are too small; larger keeps more loops after long "
          "ways, true and false ones");
  set.add("estimate_sigma", estimate_sigma,
          "find out by how well loops close how many times too small they are; else it is as loop.sigma says");
  set.add(
      "drift", drift, "", 0, 1,
      "systematic error of the path's length, as a part of it (one standard deviation): no loop is rejected for it");
  set.add("turn_drift", turn_drift, "deg/m", 0, 90,
          "systematic error of the path's direction (one standard deviation)");
  set.add("max_turn", max_turn, "deg", 1, 180,
          "largest rotation between the views of a loop; replaces motion.max_turn");
  set.add("rescue", rescue, "compare by SIFT what corners cannot match; slow");
  set.add("min_used", min_used, "", 4, 1000, "fewer correspondences than this are no loop");
  set.add("min_spread", min_spread, "", 0, 1,
          "least part of the image over which the correspondences are spread, in both views");
  set.add("min_agreement", min_agreement, "", 0, 1,
          "least part of the disparities of one view that those of the other do not contradict");
  set.add("max_chi_square", max_chi_square, "", 1, 1e9,
          "largest disagreement between loops and odometry: chi-square of six degrees of freedom, 22.5 keeps 99.9 % of "
          "the true loops; beyond it a loop loses its weight quickly");
  set.add("min_joining_loops", min_joining_loops, "loops", 1, 1000,
          "so many loops must agree on how two sub-maps lie to each other before they are joined; a loop of twice "
          "loop.min_used correspondences counts as two, and so on; 1 trusts a single one");
  set.add("max_iterations", max_iterations, "", 1, 1000, "most iterations of the minimisation over all motions");
  set.add("cache_mb", cache_mb, "MB", 16, 1000000,
          "memory for views while loops are verified; larger reads less often");
}

}  // namespace iris::loop
