// Pairs of stored views that may show the same place: by where the poses say they are, or by what they look like.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "iris/geometry/rectified_camera.h"
#include "iris/loop/odometry.h"
#include "iris/loop/options.h"
#include "iris/loop/retrieval.h"
#include "iris/motion/features.h"

namespace iris::loop {

// Two stored views, named by their frames.
struct Candidate {
  enum class Source { overlap, appearance };
  int i = 0, j = 0;  // frame_idx, i < j
  double score = 0;  // part of the views that is expected to overlap, or their likeness; 0 to 1
  Source source = Source::overlap;
};

// What predicting the overlap needs of a view.
struct ViewSketch {
  static constexpr int kColumns = 12, kRows = 8;  // cells of the image

  int frame_idx = 0;
  std::vector<Eigen::Vector3f> points_in_cam;  // [m] some of its corners, spread over the image
  std::vector<float> depth;                    // [m] of the farthest measured surface in each cell; 0 = none
};

ViewSketch sketch(int frame_idx, const motion::ViewFeatures& features, const RectifiedCamera& camera);

// The part of view i's points that view j is expected to see from a similar direction and distance, each weighted with
// the probability that it falls into j's image, given how uncertain their relative pose is; and the other way round;
// the smaller of both. Points behind what j measured are hidden. at_best: what overlap there can be if the pose is
// wrong by up to three standard deviations, each point on its own.
double expected_overlap(const ViewSketch& i, const ViewSketch& j, const RelativePose& i_from_j,
                        const RectifiedCamera& camera, bool at_best = false);

// Pairs of at least options.min_overlap that odometry joins and that are options.min_gap views apart; at most
// options.overlap_candidates a view, well apart in time. Views in the order of their frames. Places are found by a
// spatial hash, at most a few hundred for each view, so that the time grows with the number of views. Ordered by (i,
// j).
std::vector<Candidate> overlap_candidates(const std::vector<ViewSketch>& views, const Odometry& odometry,
                                          const RectifiedCamera& camera, const LoopOptions& options);

// Pairs that look alike and are options.min_gap views apart or without relation by odometry; at most
// options.appearance_candidates a view. Pairs whose poses exclude that they see the same are left out. index and views:
// the same views in the same order. Ordered by (i, j).
std::vector<Candidate> appearance_candidates(const ViewIndex& index, const std::vector<ViewSketch>& views,
                                             const Odometry& odometry, const RectifiedCamera& camera,
                                             const LoopOptions& options);

}  // namespace iris::loop
