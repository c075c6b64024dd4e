// Errors of a camera path against truth (thesis 5.4; the measures of the TUM and KITTI benchmarks).
#pragma once

#include <cstdint>
#include <map>
#include <vector>

#include "iris/geometry/pose.h"

namespace iris::evaluate {

struct StampedPose {
  int64_t stamp_ns = 0;
  Pose world_from_cam = Pose::Identity();
};

// In the order of the stamps, which differ.
using Trajectory = std::vector<StampedPose>;

// An estimated pose and the truth at the same moment, each in its own world.
struct PosePair {
  int64_t stamp_ns = 0;
  Pose estimate = Pose::Identity();
  Pose truth = Pose::Identity();
};

// The truth at the time of each estimated pose. Where the truth is as dense as the estimate (gap of its neighbours not
// above 1.5 periods of the estimate) it is interpolated, linearly and along the shortest rotation; else the nearest
// true pose is taken if it is within half a period (behind the ends of a denser truth: half of its period). Estimated
// poses without truth are left out. The period is the median difference of the estimate's stamps (of a single pose: 0.1
// s).
std::vector<PosePair> associate(const Trajectory& estimate, const Trajectory& truth);

// truth = scale * R * estimate + t.
struct Alignment {
  double scale = 1;
  Pose truth_from_estimate = Pose::Identity();

  // The estimated pose in the world of the truth.
  Pose apply(const Pose& estimate) const;
};

// Least squares over the positions (Umeyama 1991). Requires at least one pair.
Alignment align_positions(const std::vector<PosePair>& pairs, bool with_scale);

// As align_positions, but the rotation about the main direction of the path comes from the orientations where the
// positions cannot tell it: paths whose second principal extent is below 2 % of the first, or below 20 times the error
// that align_positions leaves. It assumes that both describe the same camera up to a small constant rotation. For maps
// and orientations. `from_orientations` says whether that was so.
Alignment align_worlds(const std::vector<PosePair>& pairs, bool with_scale, bool& from_orientations);

struct Spread {
  int count = 0;
  double rmse = 0, mean = 0, median = 0, max = 0;
};
Spread spread_of(std::vector<double> values);

struct MotionError {
  Spread translation;  // [m]
  Spread rotation;     // [rad]
};

struct SegmentDrift {
  double length = 0;  // [m] of the true path
  int segments = 0;
  double translation = 0;  // [m / m] mean error / length
  double rotation = 0;     // [rad / m] mean error / length
};

struct TrajectoryOptions {
  bool with_scale = false;  // align with a similarity instead of a rigid motion
};

struct TrajectoryErrors {
  std::vector<PosePair> pairs;
  int unmatched = 0;          // estimated poses without truth
  double true_path = 0;       // [m] length along the pairs
  double estimated_path = 0;  // [m]
  double duration = 0;        // [s]

  Alignment alignment;                      // for the positions
  Alignment world_alignment;                // see align_worlds
  bool rotation_from_orientations = false;  // in world_alignment
  double scale_error = 0;                   // ratio by which estimated lengths are too long (best similarity); NaN
                                            // if one of the two does not move

  // The camera of the truth may be turned by a constant rotation against the estimated one (recorded and rectified
  // camera): the mean of R_estimate^T R_alignment^T R_truth.
  Eigen::Matrix3d estimate_from_truth_cam = Eigen::Matrix3d::Identity();
  std::vector<Pose> true_poses;  // of the pairs, with that rotation taken out

  MotionError absolute;  // after alignment: positions as they are, rotations with the constant one taken out
  std::vector<double> translations;   // [m] of each pair
  std::vector<double> rotations;      // [rad] of each pair
  MotionError per_frame;              // relative, between neighbouring pairs
  MotionError per_second, per_metre;  // relative, over 1 s and over 1 m of the true path (count 0: too short)
  std::vector<SegmentDrift> drift;    // segments begin at each pair
  SegmentDrift mean_drift;            // over all segments (length 0)

  // Thesis 5.4.2: difference of the motion between the first and the last view.
  double closing_translation = 0;  // [m]
  double closing_rotation = 0;     // [rad]
  double true_gap = 0;             // [m] true distance of first and last view
};

// Requires at least two pairs after association.
TrajectoryErrors evaluate_trajectory(const Trajectory& estimate, const Trajectory& truth,
                                     const TrajectoryOptions& options);

// Lengths [m] over which drift is measured: KITTI's 100, 200 … 800 m if the path has at least 200 m, else the four
// largest of 1, 2, 5 times powers of ten that the path contains.
std::vector<double> drift_lengths(double path);

// A measured motion and its information in g2o's coordinates: the error is translation and vector part of the
// quaternion of measurement^-1 * truth.
struct MotionEdge {
  int64_t stamp_i_ns = 0, stamp_j_ns = 0;
  Pose i_from_j = Pose::Identity();
  Matrix6d information = Matrix6d::Identity();
};

// Normalised estimation error squared: e^T information e, chi² distributed if the stated covariances are right.
struct Consistency {
  int edges = 0;
  int skipped = 0;                     // without truth, or with an information that is not positive definite
  double mean = 0;                     // expected: 6
  double median = 0;                   // expected: 5.35
  double mean_low = 0, mean_high = 0;  // 95 % band of the mean
  double edge_low = 0, edge_high = 0;  // 95 % band of one edge
  double share_within = 0;             // ratio of the edges within their band; expected: 0.95
  double share_above = 0;              // ratio of those above it; expected: 0.025
  double translation_mean = 0;         // the same of each half; expected: 3
  double rotation_mean = 0;
  double translation_factor = 0;  // stated deviations must be multiplied by this for a mean of 3
  double rotation_factor = 0;
};

// `true_poses`: of the same camera, by time stamp.
Consistency evaluate_consistency(const std::vector<MotionEdge>& edges, const std::map<int64_t, Pose>& true_poses);

// The value that a chi² variable of `degrees` exceeds with probability 1 - p. Requires degrees >= 1, 0 < p < 1.
double chi_squared_quantile(double p, int degrees);

}  // namespace iris::evaluate
