#include "iris/motion/scs.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "iris/motion/closed_form.h"
#include "iris/motion/consistency.h"
#include "iris/motion/correspondences.h"
#include "iris/motion/minimise.h"
#include "iris/reconstruct/error_models.h"
#include "iris/reconstruct/error_propagation.h"

namespace iris::motion {
namespace {

constexpr double kRadians = std::numbers::pi / 180;

// Closed form with the spherical model: each pair weighs the inverse of its points' variances (4.10).
std::optional<Pose> spherical_guess(const std::vector<PointPair>& pairs, const RectifiedCamera& camera,
                                    double pixel_error) {
  std::vector<Eigen::Vector3d> prev, cur;
  std::vector<double> weights;
  for (const auto& [p, q] : pairs) {
    prev.push_back(p);
    cur.push_back(q);
    weights.push_back(1 / (reconstruct::point_covariance(camera, p, pixel_error).trace() +
                           reconstruct::point_covariance(camera, q, pixel_error).trace()));
  }
  return spherical_motion(prev, cur, weights);
}

std::vector<PointPair> without_suspicious(const std::vector<PointPair>& pairs, const Pose& motion,
                                          const RectifiedCamera& camera, double pixel_error) {
  std::vector<double> errors;
  for (const auto& [p, q] : pairs) {
    errors.push_back(std::sqrt(reconstruct::ellipsoid_error(camera, p, q, motion, pixel_error)));
  }
  const std::vector<bool> keep = chauvenet(errors);
  std::vector<PointPair> kept;
  for (size_t i = 0; i < pairs.size(); ++i)
    if (keep[i]) kept.push_back(pairs[i]);
  return kept;
}

// The ellipsoid minimisation with the centres of the error contours instead of the points, until they rest (4.4.4).
MinimisedMotion minimise_with_drift(const RectifiedCamera& camera, const std::vector<PointPair>& pairs,
                                    const ScsOptions& options, double huber, const Pose& guess) {
  MinimisedMotion result = minimise_motion(camera, pairs, ErrorModel::ellipsoid, options.pixel_error, huber, guess);
  std::vector<PointPair> centres = pairs;
  for (int round = 0; round < 10 && result.converged; ++round) {
    for (size_t i = 0; i < pairs.size(); ++i) {
      const double square = reconstruct::ellipsoid_error(camera, centres[i].first, centres[i].second,
                                                         result.prev_from_cur, options.pixel_error);
      const double error_px = options.pixel_error * std::sqrt(square / 2);
      centres[i] = {reconstruct::drifted_centre(camera, pairs[i].first, error_px),
                    reconstruct::drifted_centre(camera, pairs[i].second, error_px)};
    }
    const Pose before = result.prev_from_cur;
    result = minimise_motion(camera, centres, ErrorModel::ellipsoid, options.pixel_error, huber, before);
    if ((result.prev_from_cur.matrix() - before.matrix()).norm() < 1e-7) break;
  }
  return result;
}

MinimisedMotion minimise(const RectifiedCamera& camera, const std::vector<PointPair>& pairs, const ScsOptions& options,
                         const Pose& guess) {
  const double huber = options.huber_px / options.pixel_error;
  if (options.model == "drift") return minimise_with_drift(camera, pairs, options, huber, guess);
  if (options.model == "image") {
    return minimise_motion(camera, pairs, ErrorModel::image, options.pixel_error, huber, guess);
  }
  MinimisedMotion result = minimise_motion(camera, pairs, ErrorModel::ellipsoid, options.pixel_error, huber, guess);
  if (options.model == "spherical") {  // the ellipsoid only says how certain it is
    const std::optional<Pose> closed_form = spherical_guess(pairs, camera, options.pixel_error);
    result.converged = result.converged && closed_form;
    if (closed_form) result.prev_from_cur = *closed_form;
  }
  return result;
}

// Root mean square of the image based residuals over the eight coordinates of each pair [px].
double image_rms(const RectifiedCamera& camera, const std::vector<PointPair>& pairs, const Pose& motion) {
  double sum = 0;
  for (const auto& [p, q] : pairs) sum += reconstruct::image_error(camera, p, q, motion, 1.0).square;
  return std::sqrt(sum / (8 * static_cast<double>(pairs.size())));
}

// The motion that most of the correspondences agree on.
MotionEstimate estimate_from(const std::vector<Correspondence>& initial, int turns, const RectifiedCamera& camera,
                             const ScsOptions& options) {
  MotionEstimate estimate;
  estimate.initial = static_cast<int>(initial.size());

  // Those that are consistent with each other (5.3.3).
  const BitMatrix matrix = consistency_matrix(camera, initial, options.pixel_error, options.max_turn * kRadians, turns);
  std::vector<PointPair> pairs;
  for (const int i : consistent_set(matrix)) pairs.emplace_back(initial[i].prev_point, initial[i].cur_point);
  estimate.consistent = static_cast<int>(pairs.size());
  estimate.status = MotionStatus::too_few_consistent;
  if (estimate.consistent < options.min_used) return estimate;

  // First guess, rejection of what does not fit it, minimisation (5.3.4). The guess is rough, so that the minimised
  // motion shows further suspicious ones: repeated until it shows none.
  std::optional<Pose> motion = spherical_guess(pairs, camera, options.pixel_error);
  MinimisedMotion minimised;
  for (bool suspicious = true; suspicious;) {
    estimate.status = MotionStatus::degenerate;
    if (!motion) return estimate;
    const size_t before = pairs.size();
    if (options.reject_suspicious) pairs = without_suspicious(pairs, *motion, camera, options.pixel_error);
    suspicious = pairs.size() != before || !minimised.converged;
    estimate.used = static_cast<int>(pairs.size());
    estimate.status = MotionStatus::too_few_consistent;
    if (estimate.used < options.min_used) return estimate;
    if (suspicious) minimised = minimise(camera, pairs, options, *motion);
    motion.reset();
    if (minimised.converged) motion = minimised.prev_from_cur;
  }
  estimate.prev_from_cur = *motion;
  estimate.covariance = minimised.covariance;
  estimate.rms_px = image_rms(camera, pairs, *motion);
  if (estimate.rms_px > options.max_rms_px) return estimate;
  estimate.status = MotionStatus::degenerate;
  const Eigen::Matrix3d rotation_covariance = minimised.covariance.bottomRightCorner<3, 3>();
  const double largest =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(rotation_covariance, Eigen::EigenvaluesOnly).eigenvalues()(2);
  if (largest <= std::pow(options.max_rotation_error * kRadians, 2)) estimate.status = MotionStatus::ok;
  return estimate;
}

// With the current view turned by a number of quarter turns.
MotionEstimate estimate_turned(const ViewFeatures& prev, const ViewFeatures& cur, int turns,
                               const RectifiedCamera& camera, const ScsOptions& options) {
  // Initial correspondences (5.3.2). The well placed ones alone are more accurate; blur and large motion need all.
  const auto matches = match_corners(prev, cur, turns);
  const auto all = refine_matches(matches, prev, cur, turns, camera, options);
  std::vector<Correspondence> well_placed;
  for (const Correspondence& c : all)
    if (c.moved <= options.max_refinement) well_placed.push_back(c);
  const MotionEstimate estimate = estimate_from(well_placed, turns, camera, options);
  if (estimate.status == MotionStatus::ok || well_placed.size() == all.size()) return estimate;
  const MotionEstimate with_all = estimate_from(all, turns, camera, options);
  return with_all.status == MotionStatus::ok ? with_all : estimate;
}

}  // namespace

void ScsOptions::declare(OptionSet& set) {
  set.section("motion");
  set.add(
      "model", model, {"spherical", "ellipsoid", "drift", "image"},
      "error model of the camera motion: spherical is rough, ellipsoid good and fast, drift corrects its bias, image "
      "minimises reprojection errors (thesis 4.4)");
  set.add("pixel_error", pixel_error, "px", 0.01, 5,
          "standard deviation of image coordinates; all error bounds of points and distances follow from it (4.4)");
  set.add("max_corners", max_corners, "", 20, 4000, "most corners a view (5.3.1)");
  set.add("grid_columns", grid_columns, "", 1, 200, "cells across the image over which the corners are spread");
  set.add(
      "min_strength", min_strength, "", 0, 1e9,
      "least Harris response in (grey levels per px)^4; lower finds corners in weak texture, but noise too (5.3.1)");
  set.add("min_disparity", min_disparity, "px", 0.1, 1000,
          "corners with less disparity are too far away to help (5.3.1)");
  set.add(
      "max_refinement", max_refinement, "px", 0, 10,
      "a match whose position moves further than this when it is refined is only used if the others do not suffice");
  set.add("quarter_turns", quarter_turns,
          "when no motion is found, also try the view turned by 90, 180 and 270 degrees about its axis");
  set.add("max_turn", max_turn, "deg", 1, 180, "largest rotation between two views, theta (5.3)");
  set.add("min_used", min_used, "", 4, 1000, "fewer correspondences than this are a failure");
  set.add("reject_suspicious", reject_suspicious,
          "drop correspondences that fit a first estimate too badly to belong to the others (Chauvenet, 5.4)");
  set.add("huber_px", huber_px, "px", 0, 100, "errors beyond this count linearly in the last minimisation; 0 = off");
  set.add("max_rms_px", max_rms_px, "px", 0.01, 100, "a motion that leaves larger image errors than this is rejected");
  set.add("max_rotation_error", max_rotation_error, "deg", 0.001, 180,
          "a motion whose rotation is less certain than this (one standard deviation) is rejected");
  set.add("retry_views", retry_views, "", 0, 100, "earlier views that a failed estimate is retried against");
}

MotionEstimate estimate_motion(const ViewFeatures& prev, const ViewFeatures& cur, const RectifiedCamera& camera,
                               const ScsOptions& options) {
  MotionEstimate result;
  if (static_cast<int>(std::min(prev.corners.size(), cur.corners.size())) < options.min_used) {
    result.status = MotionStatus::too_few_corners;
  } else {
    result = estimate_turned(prev, cur, 0, camera, options);
    for (const int turns : {1, 3, 2}) {
      if (result.status == MotionStatus::ok || !options.quarter_turns) break;
      const MotionEstimate turned = estimate_turned(prev, cur, turns, camera, options);
      if (turned.status == MotionStatus::ok) result = turned;
    }
  }
  result.corners = static_cast<int>(cur.corners.size());
  return result;
}

}  // namespace iris::motion
