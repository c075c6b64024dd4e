#include "iris/motion/scs.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "iris/motion/agreement.h"
#include "iris/motion/closed_form.h"
#include "iris/motion/consistency.h"
#include "iris/motion/correspondences.h"
#include "iris/motion/minimise.h"
#include "iris/reconstruct/error_models.h"
#include "iris/reconstruct/error_propagation.h"
#include "rolled_matches.h"

namespace iris::motion {
namespace {

constexpr double kRadians = std::numbers::pi / 180;

// Closed form with the spherical model: each pair weighs the inverse of its points' variances (4.10).
std::optional<Pose> spherical_guess(const std::vector<PointPair>& pairs, const RectifiedCamera& camera,
                                    double pixel_error) {
  std::vector<Eigen::Vector3d> prev, cur;
  std::vector<double> weights;
  for (const PointPair& pair : pairs) {
    prev.push_back(pair.prev);
    cur.push_back(pair.cur);
    weights.push_back(1 / (reconstruct::point_covariance(camera, pair.prev, pixel_error).trace() +
                           reconstruct::point_covariance(camera, pair.cur, pixel_error).trace()));
  }
  return spherical_motion(prev, cur, weights);
}

// What makes differences of the image coordinates of a correspondence as uncertain as pixel_error.
Eigen::Matrix3d whitening_of(const Correspondence& c, double pixel_error) {
  if (c.right_variance == 0) return Eigen::Matrix3d::Identity();
  Eigen::Matrix3d result = Eigen::Matrix3d::Zero();
  Eigen::Matrix2d covariance = c.left_covariance;
  covariance.row(1) *= std::numbers::sqrt2;
  covariance.col(1) *= std::numbers::sqrt2;
  const Eigen::Matrix2d l = covariance.llt().matrixL();
  result.topLeftCorner<2, 2>() = pixel_error * l.inverse();
  result(2, 2) = pixel_error / std::sqrt(c.right_variance);
  return result;
}

std::vector<PointPair> points_of(const std::vector<Correspondence>& correspondences, double pixel_error) {
  std::vector<PointPair> pairs;
  for (const Correspondence& c : correspondences)
    pairs.push_back({c.prev_point, c.cur_point, whitening_of(c, pixel_error)});
  return pairs;
}

std::vector<Correspondence> without_suspicious(const std::vector<Correspondence>& correspondences, const Pose& motion,
                                               const RectifiedCamera& camera, double pixel_error) {
  std::vector<double> errors;
  for (const Correspondence& c : correspondences) {
    errors.push_back(std::sqrt(reconstruct::ellipsoid_error(camera, c.prev_point, c.cur_point, motion, pixel_error)));
  }
  const std::vector<bool> keep = chauvenet(errors);
  std::vector<Correspondence> kept;
  for (size_t i = 0; i < correspondences.size(); ++i)
    if (keep[i]) kept.push_back(correspondences[i]);
  return kept;
}

// The ellipsoid minimisation with the centres of the error contours instead of the points, until they rest (4.4.4).
MinimisedMotion minimise_with_drift(const RectifiedCamera& camera, const std::vector<PointPair>& pairs,
                                    const ScsOptions& options, double huber, const Pose& guess) {
  MinimisedMotion result = minimise_motion(camera, pairs, ErrorModel::ellipsoid, options.pixel_error, huber, guess);
  std::vector<PointPair> centres = pairs;
  for (int round = 0; round < 10 && result.converged; ++round) {
    for (size_t i = 0; i < pairs.size(); ++i) {
      const double square = reconstruct::ellipsoid_error(camera, centres[i].prev, centres[i].cur, result.prev_from_cur,
                                                         options.pixel_error);
      const double error_px = options.pixel_error * std::sqrt(square / 2);
      centres[i] = {reconstruct::drifted_centre(camera, pairs[i].prev, error_px),
                    reconstruct::drifted_centre(camera, pairs[i].cur, error_px)};
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

// A motion that is less certain than pixel_error promises anyway, because it has small residuals, stays so.
Matrix6d inflated_covariance(const MinimisedMotion& minimised, const ScsOptions& options) {
  const double factor = minimised.variance_factor;
  return minimised.covariance * (std::max(1.0, options.inflation * factor) / std::max(1.0, factor));
}

// Root mean square of the image based residuals over the eight coordinates of each pair [px].
double image_rms(const RectifiedCamera& camera, const std::vector<PointPair>& pairs, const Pose& motion) {
  double sum = 0;
  for (const PointPair& pair : pairs) sum += reconstruct::image_error(camera, pair.prev, pair.cur, motion, 1.0).square;
  return std::sqrt(sum / (8 * static_cast<double>(pairs.size())));
}

// Whether the places of the points let them tell the motion. The scatter of points that lie on a line or close together
// is mostly their own noise, which the minimisation takes for structure: what that noise contributes to the information
// about the rotation is subtracted here, doubled because the scatter of few points is itself a matter of chance.
bool well_determined(const Pose& motion, const std::vector<Correspondence>& used, const RectifiedCamera& camera,
                     const ScsOptions& options) {
  std::vector<double> depths;
  Matrix6d information = Matrix6d::Zero();
  const Eigen::Matrix3d& r = motion.linear();
  for (const Correspondence& c : used) {
    depths.push_back(c.prev_point.z());
    const Eigen::Matrix3d of_prev = reconstruct::point_covariance(camera, c.prev_point, options.pixel_error);
    const Eigen::Matrix3d of_cur =
        r * reconstruct::point_covariance(camera, c.cur_point, options.pixel_error) * r.transpose();
    const Eigen::Matrix3d weight = (of_prev + of_cur).inverse();
    Eigen::Matrix<double, 3, 6> jacobian;
    jacobian << Eigen::Matrix3d::Identity(), -cross_matrix(r * c.cur_point);
    information += jacobian.transpose() * weight * jacobian;
    const Eigen::Matrix3d l = of_cur.llt().matrixL();  // the noise of the point is a sum over its columns
    for (int k = 0; k < 3; ++k) {
      const Eigen::Matrix3d x = cross_matrix(l.col(k));
      information.bottomRightCorner<3, 3>() -= 2 * x.transpose() * weight * x;
    }
  }
  const Eigen::LLT<Matrix6d> solver(information);
  if (solver.info() != Eigen::Success) return false;
  const Matrix6d covariance = solver.solve(Matrix6d::Identity());
  const auto middle = depths.begin() + static_cast<std::ptrdiff_t>(depths.size() / 2);
  std::nth_element(depths.begin(), middle, depths.end());
  const auto largest_error = [](const Eigen::Matrix3d& of) {
    return std::sqrt(Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(of, Eigen::EigenvaluesOnly).eigenvalues()(2));
  };
  return largest_error(covariance.topLeftCorner<3, 3>()) <= options.max_translation_error * *middle &&
         largest_error(covariance.bottomRightCorner<3, 3>()) <= options.max_rotation_error * kRadians;
}

// Rejection of correspondences that do not fit the guess, minimisation (5.3.4). The guess is rough, so that the
// minimised motion shows further suspicious ones: repeated until it shows none.
void refine(TracedMotion& motion, std::vector<Correspondence> correspondences, const Pose& guess,
            const RectifiedCamera& camera, const ScsOptions& options) {
  MotionEstimate& estimate = motion.estimate;
  Pose at = guess;
  MinimisedMotion minimised;
  for (bool suspicious = true; suspicious;) {
    const size_t before = correspondences.size();
    if (options.reject_suspicious)
      correspondences = without_suspicious(correspondences, at, camera, options.pixel_error);
    suspicious = correspondences.size() != before || !minimised.converged;
    estimate.used = static_cast<int>(correspondences.size());
    estimate.status = MotionStatus::too_few_consistent;
    if (estimate.used < options.min_used) return;
    if (suspicious) minimised = minimise(camera, points_of(correspondences, options.pixel_error), options, at);
    estimate.status = MotionStatus::degenerate;
    if (!minimised.converged) return;
    at = minimised.prev_from_cur;
  }
  estimate.rms_px = image_rms(camera, points_of(correspondences, options.pixel_error), at);
  if (estimate.rms_px > options.max_rms_px) {
    estimate.status = MotionStatus::too_few_consistent;
    return;
  }
  if (!well_determined(at, correspondences, camera, options)) return;
  estimate.prev_from_cur = at;
  estimate.covariance = inflated_covariance(minimised, options);
  estimate.status = MotionStatus::ok;
  motion.used = std::move(correspondences);
}

// A successful motion, minimised over the correspondences that it predicted; the better of both.
TracedMotion with_found(const TracedMotion& motion, const std::vector<Correspondence>& found,
                        const RectifiedCamera& camera, const ScsOptions& options) {
  TracedMotion next = motion;
  refine(next, found, motion.estimate.prev_from_cur, camera, options);
  return next.estimate.status == MotionStatus::ok && next.estimate.used >= motion.estimate.used ? next : motion;
}

// Whether a second set of correspondences contradicts the motion that a set of `consistent` supports (fig. 5.9).
bool is_ambiguous(const TracedMotion& motion, double roll, const RectifiedCamera& camera, const ScsOptions& options) {
  constexpr double kSame = 3;  // [px] what the motion explains so well may well belong to it
  const Pose cur_from_prev = motion.estimate.prev_from_cur.inverse();
  std::vector<Correspondence> others;
  for (const Correspondence& c : motion.initial) {
    const Eigen::Vector3d predicted = cur_from_prev * c.prev_point;
    if (predicted.z() > 0 && (camera.project(predicted) - camera.project(c.cur_point)).norm() <= kSame) continue;
    others.push_back(c);
  }
  const auto least = std::max<size_t>(static_cast<size_t>(options.min_used),
                                      static_cast<size_t>(options.ambiguity * motion.estimate.consistent));
  if (others.size() < least) return false;
  const BitMatrix matrix = consistency_matrix(camera, others, options.pixel_error, options.max_turn * kRadians, roll);
  return consistent_set(matrix).size() >= least;
}

// The motion that matches tell, at a known roll of the current view.
TracedMotion trace_matches(const std::vector<Correspondence>& all, double roll, const ViewFeatures& prev,
                           const ViewFeatures& cur, const RectifiedCamera& camera, const ScsOptions& options) {
  // The well placed ones alone are more accurate; blur and large motion need all.
  std::vector<Correspondence> well_placed;
  for (const Correspondence& c : all)
    if (c.moved <= options.max_refinement) well_placed.push_back(c);
  TracedMotion motion = motion_from(well_placed, roll, camera, options);
  if (motion.estimate.status != MotionStatus::ok && well_placed.size() < all.size()) {
    TracedMotion with_all = motion_from(all, roll, camera, options);
    if (with_all.estimate.status == MotionStatus::ok) motion = std::move(with_all);
  }
  return motion.estimate.status == MotionStatus::ok && options.predict ? confirmed(motion, prev, cur, camera, options)
                                                                       : motion;
}

// Initial correspondences (5.3.2) with the surroundings as they are.
TracedMotion trace_upright(const ViewFeatures& prev, const ViewFeatures& cur, const RectifiedCamera& camera,
                           const ScsOptions& options) {
  return trace_matches(refine_matches(match_corners(prev, cur), prev, cur, camera, options), 0, prev, cur, camera,
                       options);
}

// With the surroundings turned and scaled.
TracedMotion trace_rolled(const ViewFeatures& prev, const ViewFeatures& cur, const RectifiedCamera& camera,
                          const ScsOptions& options) {
  constexpr int kGroups = 3;
  for (const RolledMatches& group : rolled_matches(prev, cur, options, kGroups)) {
    std::vector<Correspondence> all;
    for (const auto& [i, j, roll] : group.matches) {
      const double scale = prev.corners[i].point_in_cam.z() / cur.corners[j].point_in_cam.z();
      // The current view, turned clockwise, looks like the previous one.
      const Eigen::Matrix2d cur_from_prev = scale * Eigen::Rotation2Dd(-roll).toRotationMatrix();
      if (const auto match = refined_match(i, j, cur_from_prev, prev, cur, camera, options)) all.push_back(*match);
    }
    TracedMotion motion = trace_matches(all, group.roll, prev, cur, camera, options);
    if (motion.estimate.status == MotionStatus::ok) return motion;
  }
  return {};
}

}  // namespace

void ScsOptions::declare(OptionSet& set) {
  set.section("motion");
  set.add(
      "model", model, {"spherical", "ellipsoid", "drift", "image"},
      "error model of the camera motion: spherical is rough, ellipsoid good, drift corrects its bias, image minimises "
      "reprojection errors (thesis 4.4)");
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
      "compare", compare, {"rank", "sad"},
      "what the surroundings of corners are compared by: ranks of grey values bear perspective and brightness; sad, "
      "differences of grey values after a Laplacian of Gaussian, is there for comparison (5.3.2)");
  set.add(
      "max_refinement", max_refinement, "px", 0, 10,
      "a match whose position moves further than this when it is refined is only used if the others do not suffice");
  set.add("any_roll", any_roll,
          "when no motion is found, compare the surroundings of corners turned by any angle about the optical axis and "
          "scaled by their depths");
  set.add("predict", predict,
          "when a motion is found, look for all corners again where it predicts them, and minimise over these");
  set.add("min_similarity", min_similarity, "", -1, 1,
          "least correlation coefficient of the surroundings of a corner that was found by prediction");
  set.add("min_support", min_support, "", 0, 1,
          "of the corners whose surface is where a motion predicts it, the part that must be found there again");
  set.add(
      "max_contradiction", max_contradiction, "", 0, 1,
      "most points that the other view looks through, as a part of all that it shows, times the part of those corners "
      "that are found again and fit the motion");
  set.add("max_turn", max_turn, "deg", 1, 180, "largest rotation between two views, theta (5.3)");
  set.add("ambiguity", ambiguity, "", 0.1, 2,
          "a second consistent set that is at least this part as large as the first and moves otherwise makes a motion "
          "ambiguous: repetitive texture, or something large that moves (fig. 5.9)");
  set.add("min_used", min_used, "", 4, 1000, "fewer correspondences than this are a failure");
  set.add("reject_suspicious", reject_suspicious,
          "drop correspondences that fit a first estimate too badly to belong to the others (Chauvenet, 5.4)");
  set.add("huber_px", huber_px, "px", 0, 100, "errors beyond this count linearly in the last minimisation; 0 = off");
  set.add("max_rms_px", max_rms_px, "px", 0.01, 100, "a motion that leaves larger image errors than this is rejected");
  set.add("max_rotation_error", max_rotation_error, "deg", 0.001, 180,
          "a motion whose rotation is less certain than this (one standard deviation) is rejected");
  set.add("max_translation_error", max_translation_error, "", 0.0001, 10,
          "a motion whose translation is less certain than this part of the points' median depth (one standard "
          "deviation) is rejected");
  set.add(
      "inflation", inflation, "times", 0.1, 100,
      "variances of a motion are larger than the residuals of its correspondences say; raise it where motions prove "
      "less certain than they state (iris evaluate: NEES above 6)");
  set.add("window", window, "", 1, 50,
          "earlier views that a motion is measured against at once, for less drift (with the model image); 1 = the "
          "previous view only (thesis)");
  set.add("window_corners", window_corners, "", 8, 4000,
          "most corners that each of these earlier views adds to those of the previous one");
  set.add("rest", rest, "px", 0, 100,
          "when the corners moved by less than this in the middle, the camera rests: the following views are measured "
          "against the same earlier view, so that errors do not add up; 0 = off");
  set.add("retry_views", retry_views, "", 0, 100, "earlier views that a failed estimate is retried against");
  set.add("rescue", rescue,
          "when all of these fail, try them again with many more corners and with SIFT; slow, but on failures only");
  set.add("guess", guess,
          "when that fails too, continue the last motion, marked as guessed, instead of beginning a sub-map");
}

TracedMotion motion_from(const std::vector<Correspondence>& initial, double roll, const RectifiedCamera& camera,
                         const ScsOptions& options) {
  TracedMotion motion;
  motion.initial = initial;
  motion.estimate.initial = static_cast<int>(initial.size());
  motion.estimate.status = MotionStatus::too_few_consistent;

  // Those that are consistent with each other (5.3.3).
  const BitMatrix matrix = consistency_matrix(camera, initial, options.pixel_error, options.max_turn * kRadians, roll);
  for (const int i : consistent_set(matrix)) motion.consistent.push_back(initial[i]);
  motion.estimate.consistent = static_cast<int>(motion.consistent.size());
  if (motion.estimate.consistent < options.min_used) return motion;

  // First guess, rejection of what does not fit it, minimisation (5.3.4).
  motion.estimate.status = MotionStatus::degenerate;
  const std::optional<Pose> guess =
      spherical_guess(points_of(motion.consistent, options.pixel_error), camera, options.pixel_error);
  if (!guess) return motion;
  refine(motion, motion.consistent, *guess, camera, options);
  if (motion.estimate.status == MotionStatus::ok && is_ambiguous(motion, roll, camera, options)) {
    motion.estimate = {.status = MotionStatus::ambiguous,
                       .initial = motion.estimate.initial,
                       .consistent = motion.estimate.consistent};
    motion.used.clear();
  }
  return motion;
}

TracedMotion with_predicted(const TracedMotion& motion, const ViewFeatures& prev, const ViewFeatures& cur,
                            const RectifiedCamera& camera, const ScsOptions& options) {
  const Pose& guess = motion.estimate.prev_from_cur;
  return with_found(motion, predicted_matches(prev, cur, guess, camera, options), camera, options);
}

TracedMotion confirmed(const TracedMotion& motion, const ViewFeatures& prev, const ViewFeatures& cur,
                       const RectifiedCamera& camera, const ScsOptions& options) {
  const auto matches = predicted_matches(prev, cur, motion.estimate.prev_from_cur, camera, options);
  TracedMotion result = with_found(motion, matches, camera, options);
  const Agreement views = agreement(prev, cur, result.estimate.prev_from_cur, camera);
  const double found = static_cast<double>(matches.size()), used = result.estimate.used;
  const double support = found / std::max(1, views.expected), fitting = used / std::max(1, views.expected);
  // A motion finds its own corners again, and most of what it finds fits it.
  constexpr double kLeastAgain = 0.5, kLeastUsed = 0.35;
  std::vector<char> is_found(prev.corners.size(), 0);
  for (const Correspondence& c : matches) is_found[c.prev_corner] = 1;
  int own = 0, again = 0;
  for (const Correspondence& c : motion.used) {
    if (c.prev_corner < 0) continue;
    ++own;
    again += is_found[c.prev_corner];
  }
  if (support < options.min_support || views.contradiction() > options.max_contradiction * std::min(fitting, 1.0) ||
      again < kLeastAgain * own || used < kLeastUsed * found) {
    result.estimate = {.status = MotionStatus::too_few_consistent,
                       .initial = result.estimate.initial,
                       .consistent = result.estimate.consistent};
    result.used.clear();
  }
  return result;
}

TracedMotion with_window(const TracedMotion& motion, const std::vector<WindowView>& others, const ViewFeatures& cur,
                         const RectifiedCamera& camera, const ScsOptions& options) {
  if (options.model != "image") return motion;
  const Pose& guess = motion.estimate.prev_from_cur;
  std::vector<PointPair> pairs = points_of(motion.used, options.pixel_error);
  for (const WindowView& other : others) {
    const Pose other_from_cur = other.prev_from_view.inverse() * guess;
    std::vector<Correspondence> seen =
        predicted_matches(*other.features, cur, other_from_cur, camera, options, options.window_corners);
    if (options.reject_suspicious) seen = without_suspicious(seen, other_from_cur, camera, options.pixel_error);
    if (static_cast<int>(seen.size()) < options.min_used) continue;
    for (PointPair& pair : points_of(seen, options.pixel_error)) {
      pair.prev_from_seeing = other.prev_from_view;
      pairs.push_back(pair);
    }
  }
  const MinimisedMotion minimised = minimise(camera, pairs, options, guess);
  if (!minimised.converged) return motion;
  TracedMotion result = motion;
  result.estimate.prev_from_cur = minimised.prev_from_cur;
  result.estimate.covariance = inflated_covariance(minimised, options);
  return result;
}

TracedMotion trace_motion(const ViewFeatures& prev, const ViewFeatures& cur, const RectifiedCamera& camera,
                          const ScsOptions& options) {
  TracedMotion result;
  if (static_cast<int>(std::min(prev.corners.size(), cur.corners.size())) >= options.min_used) {
    result = trace_upright(prev, cur, camera, options);
    const MotionStatus status = result.estimate.status;
    if (status != MotionStatus::ok && status != MotionStatus::ambiguous && options.any_roll) {
      TracedMotion rolled = trace_rolled(prev, cur, camera, options);
      if (rolled.estimate.status == MotionStatus::ok) result = std::move(rolled);
    }
  }
  result.estimate.corners = static_cast<int>(cur.corners.size());
  return result;
}

MotionEstimate estimate_motion(const ViewFeatures& prev, const ViewFeatures& cur, const RectifiedCamera& camera,
                               const ScsOptions& options) {
  return trace_motion(prev, cur, camera, options).estimate;
}

}  // namespace iris::motion
