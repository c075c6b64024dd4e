// What makes a candidate a loop: a motion between the two views that many well spread points support, that is the same
// both ways, that fits what both views measured, and that agrees with odometry and with the other loops.
#pragma once

#include <vector>

#include "iris/loop/candidates.h"
#include "iris/loop/odometry.h"
#include "iris/loop/options.h"
#include "iris/motion/rescue.h"
#include "iris/motion/scs.h"

namespace iris::loop {

enum class LoopVerdict {
  accepted,
  no_motion,      // no rigid motion explains enough correspondences
  too_few_pairs,  // it has less than loop.min_used of them
  poorly_spread,  // they cover less than loop.min_spread of one of the images
  not_symmetric,  // the motion from j to i is not the inverse of that from i to j
  contradicted,   // where one view measures surfaces, the other one looks through
  inconsistent,   // it contradicts odometry, or the majority of the other loops
  unsupported,    // too few loops join these two sub-maps, or two ways of joining them are equally likely
};

// "accepted", "no motion", …, for people.
const char* name_of(LoopVerdict verdict);

// A candidate and what became of it. From the verdict contradicted on, and if accepted, the motion is known.
struct LoopEdge {
  int i = 0, j = 0;  // frame_idx, i < j
  Pose i_from_j = Pose::Identity();
  Matrix6d covariance = Matrix6d::Zero();               // as in MotionEstimate
  int used = 0, consistent = 0;                         // correspondences, as in MotionEstimate
  MotionStatus motion = MotionStatus::too_few_corners;  // from i to j
  double rms_px = 0;
  double score = 0;  // of the candidate
  Candidate::Source source = Candidate::Source::overlap;
  bool rescued = false;    // compared with SIFT
  double spread = 0;       // part of the image that the correspondences cover, of the worse view
  double agreement = 0;    // part of what the two views measured that fits together (motion::agreement)
  double chi_square = -1;  // of the motion against odometry, six degrees of freedom; -1: odometry does not join them
  LoopVerdict verdict = LoopVerdict::no_motion;
};

// motion's options as loops use them.
motion::ScsOptions loop_motion_options(const motion::ScsOptions& scs, const LoopOptions& options);

// The motion between the views of a candidate, found by corners, and the tests that need nothing but the two views.
// scs: loop_motion_options().
LoopEdge verify(const Candidate& candidate, const motion::ViewFeatures& i, const motion::ViewFeatures& j,
                const RectifiedCamera& camera, const motion::ScsOptions& scs, const LoopOptions& options);

// The same by SIFT.
LoopEdge verify(const Candidate& candidate, const motion::RescueFeatures& i, const motion::RescueFeatures& j,
                const RectifiedCamera& camera, const motion::ScsOptions& scs, const LoopOptions& options);

// The part of an image that points are spread over: occupied cells of a grid of 8 x 6.
double spread_of(const std::vector<Eigen::Vector2d>& points, const RectifiedCamera& camera);

// Judges accepted edges together: those that contradict odometry become inconsistent, then those outside of the largest
// set of mutually consistent ones (pairwise consistency maximisation, Mangelson et al. 2018), for each pair of sub-maps
// on its own. Two loops i-j and k-l agree if the way i -> j -> l -> k -> i comes back to where it began, within its
// covariance. Two sub-maps are joined by options.min_joining_loops votes of agreeing loops at least, and not if a
// second such set is nearly as large.
void judge_consistency(std::vector<LoopEdge>& edges, const Odometry& odometry, const LoopOptions& options);

// The chi-square of the way around two loops, six degrees of freedom. Both run between the same two sub-maps, in the
// same direction.
double chi_square_of(const LoopEdge& a, const LoopEdge& b, const Odometry& odometry, const LoopOptions& options);

}  // namespace iris::loop
