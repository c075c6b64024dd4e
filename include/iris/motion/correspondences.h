// Pairs of corners that look alike in two views (thesis 5.3.2), without any prediction of the motion.
#pragma once

#include <optional>
#include <utility>
#include <vector>

#include "iris/geometry/pose.h"
#include "iris/motion/features.h"

namespace iris::motion {

// Two reconstructions of what is probably one point.
struct Correspondence {
  int prev_corner = 0, cur_corner = 0;                   // indices of the corners; -1: not a corner
  Eigen::Vector3d prev_point = Eigen::Vector3d::Zero();  // [m] in the previous camera
  Eigen::Vector3d cur_point = Eigen::Vector3d::Zero();   // [m] in the current camera
  double moved = 0;                                      // [px] by how much the current position was refined
  // Covariance of x and y and variance of x in the right image [px^2], alike in both views; 0 = not known.
  Eigen::Matrix2d left_covariance = Eigen::Matrix2d::Zero();
  double right_variance = 0;
};

// Corner indices (previous, current) that are each other's best match: every patch is compared with every patch by the
// sum of absolute differences of Rank values, and the best match must be the same both ways. Ordered by the previous
// corner's index.
std::vector<std::pair<int, int>> match_corners(const ViewFeatures& prev, const ViewFeatures& cur);

// Moves the current position of a match onto the surroundings of the previous corner (track_patch) and takes its
// disparity anew. cur_from_prev: how the surroundings appear turned and scaled in the current view. Nothing if it moves
// by more than half a patch or loses its disparity.
std::optional<Correspondence> refined_match(int prev_corner, int cur_corner, const Eigen::Matrix2d& cur_from_prev,
                                            const ViewFeatures& prev, const ViewFeatures& cur,
                                            const RectifiedCamera& camera, const ScsOptions& options);

// Those of the matches that can be refined, neither turned nor scaled.
std::vector<Correspondence> refine_matches(const std::vector<std::pair<int, int>>& matches, const ViewFeatures& prev,
                                           const ViewFeatures& cur, const RectifiedCamera& camera,
                                           const ScsOptions& options);

// Looks for every corner of the previous view where a motion predicts it in the current one, its surroundings turned
// and scaled accordingly; whether there is a corner too does not matter. Dropped are those that are not found within
// options.max_refinement of the predicted position and disparity, or that look different (options.min_similarity).
// most_corners: only the first of them (features are ordered such that they are spread over the image); 0 = all.
std::vector<Correspondence> predicted_matches(const ViewFeatures& prev, const ViewFeatures& cur,
                                              const Pose& prev_from_cur, const RectifiedCamera& camera,
                                              const ScsOptions& options, int most_corners = 0);

// The patch of the image turned by a quarter turn clockwise.
RankPatch turned(const RankPatch& patch);

}  // namespace iris::motion
