#include "iris/evaluate/trajectory.h"

#include <Eigen/Eigenvalues>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "iris/core/error.h"

namespace iris::evaluate {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

int64_t median_period(const Trajectory& path) {
  constexpr int64_t kSinglePose = 100'000'000;
  if (path.size() < 2) return kSinglePose;
  std::vector<int64_t> periods;
  for (size_t i = 1; i < path.size(); ++i) periods.push_back(path[i].stamp_ns - path[i - 1].stamp_ns);
  const auto middle = periods.begin() + static_cast<std::ptrdiff_t>(periods.size() / 2);
  std::nth_element(periods.begin(), middle, periods.end());
  return *middle;
}

Pose interpolate(const Pose& a, const Pose& b, double part) {
  Pose pose = Pose::Identity();
  pose.linear() = Eigen::Quaterniond(a.linear()).slerp(part, Eigen::Quaterniond(b.linear())).toRotationMatrix();
  pose.translation() = (1 - part) * a.translation() + part * b.translation();
  return pose;
}

// period: of the estimate; end_reach: how far behind its ends the truth is taken.
std::optional<Pose> pose_at(const Trajectory& truth, int64_t stamp_ns, int64_t period, int64_t end_reach) {
  const auto after = std::lower_bound(truth.begin(), truth.end(), stamp_ns,
                                      [](const StampedPose& pose, int64_t stamp) { return pose.stamp_ns < stamp; });
  if (after != truth.end() && after->stamp_ns == stamp_ns) return after->world_from_cam;
  const bool inside = after != truth.begin() && after != truth.end();
  if (inside && 2 * (after->stamp_ns - (after - 1)->stamp_ns) <= 3 * period) {
    const StampedPose& before = *(after - 1);
    const double part =
        static_cast<double>(stamp_ns - before.stamp_ns) / static_cast<double>(after->stamp_ns - before.stamp_ns);
    return interpolate(before.world_from_cam, after->world_from_cam, part);
  }
  const StampedPose* nearest = nullptr;
  int64_t distance = (inside ? period / 2 : end_reach) + 1;
  for (auto it = after == truth.begin() ? after : after - 1; it != truth.end() && it <= after; ++it) {
    const int64_t d = std::abs(it->stamp_ns - stamp_ns);
    if (d < distance) nearest = &*it, distance = d;
  }
  return nearest ? std::optional(nearest->world_from_cam) : std::nullopt;
}

// Means and the sums of products about them.
struct Moments {
  Vector3d mean_e = Vector3d::Zero(), mean_t = Vector3d::Zero();
  Matrix3d te = Matrix3d::Zero(), tt = Matrix3d::Zero();
  double ee = 0;

  explicit Moments(const std::vector<PosePair>& pairs) {
    for (const PosePair& pair : pairs) {
      mean_e += pair.estimate.translation();
      mean_t += pair.truth.translation();
    }
    const auto n = static_cast<double>(pairs.size());
    mean_e /= n;
    mean_t /= n;
    for (const PosePair& pair : pairs) {
      const Vector3d e = pair.estimate.translation() - mean_e, t = pair.truth.translation() - mean_t;
      te += t * e.transpose() / n;
      tt += t * t.transpose() / n;
      ee += e.squaredNorm() / n;
    }
  }
};

// Mean of R_truth R_estimate^T, with `turn` in front of the estimate.
Matrix3d summed_rotation(const std::vector<PosePair>& pairs, const Matrix3d& turn) {
  Matrix3d sum = Matrix3d::Zero();
  for (const PosePair& pair : pairs) sum += pair.truth.linear() * (turn * pair.estimate.linear()).transpose();
  return sum;
}

Alignment with_rotation(const Moments& moments, const Matrix3d& rotation, double scale) {
  Alignment alignment{.scale = scale};
  alignment.truth_from_estimate.linear() = rotation;
  alignment.truth_from_estimate.translation() = moments.mean_t - scale * (rotation * moments.mean_e);
  return alignment;
}

double position_rmse(const std::vector<PosePair>& pairs, const Alignment& alignment) {
  double sum = 0;
  for (const PosePair& pair : pairs) {
    sum += (alignment.apply(pair.estimate).translation() - pair.truth.translation()).squaredNorm();
  }
  return std::sqrt(sum / static_cast<double>(pairs.size()));
}

// (translation [m], rotation [rad]) of truth^-1 * estimate, both relative motions.
struct Difference {
  double translation, rotation;
};
Difference difference(const Pose& estimate, const Pose& truth) {
  const Pose error = truth.inverse() * estimate;
  return {error.translation().norm(), rotation_angle(error)};
}

MotionError relative_errors(const TrajectoryErrors& errors, const std::vector<std::pair<size_t, size_t>>& steps) {
  std::vector<double> translations, rotations;
  for (const auto& [i, j] : steps) {
    const Difference d = difference(errors.pairs[i].estimate.inverse() * errors.pairs[j].estimate,
                                    errors.true_poses[i].inverse() * errors.true_poses[j]);
    translations.push_back(d.translation);
    rotations.push_back(d.rotation);
  }
  return {spread_of(std::move(translations)), spread_of(std::move(rotations))};
}

// For each start the first later index whose coordinate (ascending) lies `step` further, if there is one.
std::vector<std::pair<size_t, size_t>> steps_of(const std::vector<double>& coordinate, double step) {
  std::vector<std::pair<size_t, size_t>> steps;
  const double tolerance = 1e-6 * step;  // of sums that are meant to be round
  size_t j = 0;
  for (size_t i = 0; i < coordinate.size(); ++i) {
    while (j < coordinate.size() && coordinate[j] < coordinate[i] + step - tolerance) ++j;
    if (j == coordinate.size()) break;
    steps.emplace_back(i, j);
  }
  return steps;
}

// Lower regularised incomplete gamma function P(a, x) by its power series.
double lower_gamma(double a, double x) {
  double term = 1 / a, sum = term;
  for (int n = 1; term > 1e-17 * sum; ++n) {
    term *= x / (a + n);
    sum += term;
  }
  return sum * std::exp(a * std::log(x) - x - std::lgamma(a));
}

}  // namespace

Pose Alignment::apply(const Pose& estimate) const {
  Pose pose = Pose::Identity();
  pose.linear() = truth_from_estimate.linear() * estimate.linear();
  pose.translation() =
      scale * (truth_from_estimate.linear() * estimate.translation()) + truth_from_estimate.translation();
  return pose;
}

std::vector<PosePair> associate(const Trajectory& estimate, const Trajectory& truth) {
  const int64_t period = median_period(estimate), end_reach = std::min(period, median_period(truth)) / 2;
  std::vector<PosePair> pairs;
  for (const StampedPose& pose : estimate) {
    if (const auto at = pose_at(truth, pose.stamp_ns, period, end_reach)) {
      pairs.push_back({pose.stamp_ns, pose.world_from_cam, *at});
    }
  }
  return pairs;
}

Alignment align_positions(const std::vector<PosePair>& pairs, bool with_scale) {
  IRIS_CHECK(!pairs.empty());
  const Moments moments(pairs);
  const Eigen::JacobiSVD<Matrix3d> svd(moments.te, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Vector3d signs = Vector3d::Ones();
  if ((svd.matrixU() * svd.matrixV().transpose()).determinant() < 0) signs.z() = -1;
  const Matrix3d rotation = svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose();
  const double scale = with_scale && moments.ee > 0 ? svd.singularValues().dot(signs) / moments.ee : 1;
  return with_rotation(moments, rotation, scale);
}

Alignment align_worlds(const std::vector<PosePair>& pairs, bool with_scale, bool& from_orientations) {
  const Alignment by_positions = align_positions(pairs, with_scale);
  const Moments moments(pairs);
  const Eigen::SelfAdjointEigenSolver<Matrix3d> axes(moments.tt);  // ascending
  const double first = std::sqrt(std::max(0.0, axes.eigenvalues()(2)));
  const double second = std::sqrt(std::max(0.0, axes.eigenvalues()(1)));
  const double error = position_rmse(pairs, by_positions);
  from_orientations = second <= 0.02 * first || second < 20 * error;
  if (!from_orientations) return by_positions;
  if (first < 20 * error || first == 0) {
    // Positions do not tell the direction either.
    return with_rotation(moments, nearest_rotation(summed_rotation(pairs, Matrix3d::Identity())), by_positions.scale);
  }
  // The turn about the axis u that brings the orientations together: it maximises trace(R(angle)^T M).
  const Matrix3d rotation = by_positions.truth_from_estimate.linear();
  const Matrix3d m = summed_rotation(pairs, rotation);
  const Vector3d u = axes.eigenvectors().col(2);
  const Vector3d skew(m(2, 1) - m(1, 2), m(0, 2) - m(2, 0), m(1, 0) - m(0, 1));
  const double angle = std::atan2(u.dot(skew), m.trace() - u.dot(m * u));
  return with_rotation(moments, Eigen::AngleAxisd(angle, u).toRotationMatrix() * rotation, by_positions.scale);
}

Spread spread_of(std::vector<double> values) {
  Spread spread{.count = static_cast<int>(values.size())};
  if (values.empty()) return spread;
  const auto n = static_cast<double>(values.size());
  double squares = 0, sum = 0;
  for (const double v : values) sum += v, squares += v * v;
  std::sort(values.begin(), values.end());
  const size_t half = values.size() / 2;
  spread.rmse = std::sqrt(squares / n);
  spread.mean = sum / n;
  spread.median = values.size() % 2 == 1 ? values[half] : 0.5 * (values[half - 1] + values[half]);
  spread.max = values.back();
  return spread;
}

std::vector<double> drift_lengths(double path) {
  std::vector<double> lengths;
  if (path >= 200) {
    for (int i = 1; i <= 8 && 100 * i <= path; ++i) lengths.push_back(100 * i);
    return lengths;
  }
  for (const double length : {100.0, 50.0, 20.0, 10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01}) {
    if (length <= path && lengths.size() < 4) lengths.insert(lengths.begin(), length);
  }
  return lengths;
}

TrajectoryErrors evaluate_trajectory(const Trajectory& estimate, const Trajectory& truth,
                                     const TrajectoryOptions& options) {
  TrajectoryErrors errors;
  errors.pairs = associate(estimate, truth);
  const std::vector<PosePair>& pairs = errors.pairs;
  IRIS_CHECK(pairs.size() >= 2);
  errors.unmatched = static_cast<int>(estimate.size() - pairs.size());
  errors.alignment = align_positions(pairs, options.with_scale);
  errors.world_alignment = align_worlds(pairs, options.with_scale, errors.rotation_from_orientations);
  const double scale = align_positions(pairs, true).scale;

  Matrix3d turns = Matrix3d::Zero();
  for (const PosePair& pair : pairs) {
    turns += errors.world_alignment.apply(pair.estimate).linear().transpose() * pair.truth.linear();
  }
  errors.estimate_from_truth_cam = nearest_rotation(turns);

  std::vector<double> path = {0}, time = {0};
  for (size_t i = 0; i < pairs.size(); ++i) {
    const Pose aligned = errors.alignment.apply(pairs[i].estimate);
    Pose true_pose = pairs[i].truth;
    true_pose.linear() = pairs[i].truth.linear() * errors.estimate_from_truth_cam.transpose();
    errors.true_poses.push_back(true_pose);
    errors.translations.push_back((aligned.translation() - pairs[i].truth.translation()).norm());
    errors.rotations.push_back(rotation_angle(
        Matrix3d(errors.world_alignment.apply(pairs[i].estimate).linear().transpose() * true_pose.linear())));
    if (i == 0) continue;
    path.push_back(path.back() + (pairs[i].truth.translation() - pairs[i - 1].truth.translation()).norm());
    time.push_back(static_cast<double>(pairs[i].stamp_ns - pairs[0].stamp_ns) * 1e-9);
    errors.estimated_path += (pairs[i].estimate.translation() - pairs[i - 1].estimate.translation()).norm();
  }
  errors.true_path = path.back();
  const bool both_move = errors.true_path > 0 && errors.estimated_path > 0;
  errors.scale_error = both_move && scale > 0 ? 1 / scale - 1 : std::numeric_limits<double>::quiet_NaN();
  errors.duration = time.back();
  errors.absolute = {spread_of(errors.translations), spread_of(errors.rotations)};

  std::vector<std::pair<size_t, size_t>> frames;
  for (size_t i = 1; i < pairs.size(); ++i) frames.emplace_back(i - 1, i);
  errors.per_frame = relative_errors(errors, frames);
  errors.per_second = relative_errors(errors, steps_of(time, 1));
  errors.per_metre = relative_errors(errors, steps_of(path, 1));

  for (const double length : drift_lengths(errors.true_path)) {
    const auto steps = steps_of(path, length);
    const MotionError error = relative_errors(errors, steps);
    if (steps.empty()) continue;
    errors.drift.push_back(
        {length, static_cast<int>(steps.size()), error.translation.mean / length, error.rotation.mean / length});
    const SegmentDrift& drift = errors.drift.back();
    errors.mean_drift.segments += drift.segments;
    errors.mean_drift.translation += drift.segments * drift.translation;
    errors.mean_drift.rotation += drift.segments * drift.rotation;
  }
  if (errors.mean_drift.segments > 0) {
    errors.mean_drift.translation /= errors.mean_drift.segments;
    errors.mean_drift.rotation /= errors.mean_drift.segments;
  }

  const Difference closing = difference(pairs.front().estimate.inverse() * pairs.back().estimate,
                                        errors.true_poses.front().inverse() * errors.true_poses.back());
  errors.closing_translation = closing.translation;
  errors.closing_rotation = closing.rotation;
  errors.true_gap = (pairs.back().truth.translation() - pairs.front().truth.translation()).norm();
  return errors;
}

double chi_squared_quantile(double p, int degrees) {
  IRIS_CHECK(degrees >= 1 && p > 0 && p < 1);
  double low = 0, high = degrees + 20 * std::sqrt(2.0 * degrees) + 20;
  for (int i = 0; i < 100; ++i) {
    const double middle = 0.5 * (low + high);
    (lower_gamma(0.5 * degrees, 0.5 * middle) < p ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

Consistency evaluate_consistency(const std::vector<MotionEdge>& edges, const std::map<int64_t, Pose>& true_poses) {
  Consistency result;
  result.edge_low = chi_squared_quantile(0.025, 6);
  result.edge_high = chi_squared_quantile(0.975, 6);
  int within = 0, above = 0;
  std::vector<double> values;
  for (const MotionEdge& edge : edges) {
    const auto i = true_poses.find(edge.stamp_i_ns), j = true_poses.find(edge.stamp_j_ns);
    const Eigen::LLT<Matrix6d> factor(edge.information);
    if (i == true_poses.end() || j == true_poses.end() || factor.info() != Eigen::Success) {
      ++result.skipped;
      continue;
    }
    const Pose difference = edge.i_from_j.inverse() * (i->second.inverse() * j->second);
    Eigen::Quaterniond q(difference.linear());
    if (q.w() < 0) q.coeffs() = -q.coeffs();
    Vector6d e;
    e << difference.translation(), q.vec();
    const Matrix6d covariance = factor.solve(Matrix6d::Identity());
    const double nees = e.dot(edge.information * e);
    const Vector3d et = e.head<3>(), er = e.tail<3>();
    const Matrix3d ct = covariance.topLeftCorner<3, 3>(), cr = covariance.bottomRightCorner<3, 3>();
    values.push_back(nees);
    result.translation_mean += et.dot(ct.llt().solve(et));
    result.rotation_mean += er.dot(cr.llt().solve(er));
    within += nees >= result.edge_low && nees <= result.edge_high;
    above += nees > result.edge_high;
    ++result.edges;
  }
  if (result.edges == 0) return result;
  const double n = result.edges;
  const Spread spread = spread_of(std::move(values));
  result.mean = spread.mean;
  result.median = spread.median;
  result.translation_mean /= n;
  result.rotation_mean /= n;
  result.translation_factor = std::sqrt(result.translation_mean / 3);
  result.rotation_factor = std::sqrt(result.rotation_mean / 3);
  result.share_within = within / n;
  result.share_above = above / n;
  // The sum of n independent values of 6 degrees has 6 n.
  result.mean_low = chi_squared_quantile(0.025, 6 * result.edges) / n;
  result.mean_high = chi_squared_quantile(0.975, 6 * result.edges) / n;
  return result;
}

}  // namespace iris::evaluate
