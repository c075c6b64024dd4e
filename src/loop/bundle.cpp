#include "iris/loop/bundle.h"

#include <ceres/loss_function.h>
#include <ceres/ordered_groups.h>
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <deque>
#include <limits>
#include <map>
#include <memory>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "block_cholesky.h"
#include "iris/core/error.h"
#include "iris/core/median.h"
#include "iris/core/parallel.h"
#include "iris/loop/candidates.h"
#include "iris/loop/pose_graph.h"
#include "iris/motion/corner_disparity.h"
#include "iris/motion/correspondences.h"
#include "iris/motion/minimise.h"
#include "iris/reconstruct/error_models.h"
#include "pose_problem.h"

namespace iris::loop {

void BundleOptions::declare(OptionSet& set) {
  set.section("loop");
  set.add("bundle_window", window, "stored views", 1, 100,
          "bundle adjustment looks for the corners of a view in so many later ones; more ties the path together better "
          "and takes longer");
  set.add("bundle_partners", partners, "stored views", 0, 1000,
          "and in so many others that see the same by the path with its loops closed, wherever they are along it; they "
          "find what no loop joins");
  set.add("bundle_points", points, "", 20, 4000, "most points a view in bundle adjustment");
  set.add("calibrate", calibrate,
          "correct the disparity offset and the focal length when bundle adjustment shows that they are off");
  set.add("min_offset", min_offset, "px", 0, 10,
          "a disparity offset below this is not corrected; matching alone has such errors");
  set.add("max_offset", max_offset, "px", 0, 100,
          "a larger disparity offset is reported, not corrected: then more is wrong than that");
  set.add("max_focal", max_focal, "", 0, 1, "a larger error of the focal length is reported, not corrected");
  set.add("min_focal", min_focal, "", 0, 1, "an error of the focal length below this part is not corrected");
  set.add(
      "bundle_sigma", sigma, "times", 0.1, 100,
      "standard deviations after bundle adjustment are taken this many times as large as its residuals say, or more "
      "if loops have shown that motions are worse");
  set.add("bundle_iterations", max_iterations, "", 1, 1000, "most iterations of bundle adjustment");
}

ObservationResidual observe(const RectifiedCamera& camera, const Pose& world_from_cam, const Eigen::Vector3d& point,
                            const Eigen::Vector3d& calibration, const Eigen::Vector3d& seen) {
  const Eigen::Matrix3d cam_from_world = world_from_cam.linear().transpose();
  const Eigen::Vector3d from_cam = point - world_from_cam.translation();
  const Eigen::Vector3d in_cam = cam_from_world * from_cam;
  ObservationResidual result;
  result.valid = in_cam.z() > 0;
  if (!result.valid) return result;
  const Eigen::Vector3d projected = reconstruct::image_coordinates(camera, in_cam);
  const double y = seen.y() * M_SQRT1_2;
  result.residual = (1 + calibration(1)) * projected - seen;
  result.residual.z() += calibration(0) + calibration(2) * y;
  result.by_point = (1 + calibration(1)) * reconstruct::image_jacobian(camera, in_cam) * cam_from_world;
  result.by_pose << -result.by_point, result.by_point * motion::cross_matrix(from_cam);
  result.by_calibration.col(0) = Eigen::Vector3d::UnitZ();
  result.by_calibration.col(1) = projected;
  result.by_calibration.col(2) = y * Eigen::Vector3d::UnitZ();
  return result;
}

namespace {

constexpr int kCalibration = 3;
constexpr double kLeastSlope = 1e-3;      // smaller ones change disparities by a quarter of a pixel at most
constexpr double kMostSlope = 0.05;       // recordings that do not tell this one from none say nothing of it
constexpr double kWidth = 3;              // [standard deviations] of Cauchy's loss
constexpr double kScaleOfMedian = 2.366;  // median of the chi-square distribution with three degrees of freedom
constexpr double kMedianOfTwo = 1.386;    // with two
constexpr double kMedianOfOne = 0.455;    // and with one

struct Observation {
  int view = 0;
  Eigen::Vector3d seen;
};

struct Landmark {
  int anchor = 0;  // the view whose corner it is
  std::vector<Observation> observations;
  Eigen::Vector3d point;  // in the world
};

// Standard deviations [px] of a position in the left image, in each direction, and of a disparity. They come from
// different measurements: the position from tracking the corner's surroundings, the disparity from matching the images.
struct Noise {
  double left = 1, disparity = 1;
};

// The residual in units of its standard deviations: x left, y, disparity; and its derivatives.
ObservationResidual whitened(ObservationResidual at, const Noise& noise) {
  const auto whiten = [&](auto& rows) {
    rows.row(2) = (rows.row(0) - rows.row(2)).eval() / noise.disparity;
    rows.row(0) /= noise.left;
    rows.row(1) *= M_SQRT1_2 / noise.left;
  };
  whiten(at.residual);
  whiten(at.by_point);
  whiten(at.by_pose);
  whiten(at.by_calibration);
  return at;
}

// A landmark as a view sees it.
struct Seen {
  int landmark = 0;
  motion::Corner corner;
};

// Positions of a view that are taken.
class Occupied {
 public:
  Occupied(const RectifiedCamera& camera, int cell)
      : cell_(cell), taken_(camera.height / cell + 3, camera.width / cell + 3, static_cast<uint8_t>(0)) {}
  bool near(double x, double y) const {
    const int row = static_cast<int>(y) / cell_ + 1, column = static_cast<int>(x) / cell_ + 1;
    for (int v = -1; v <= 1; ++v) {
      for (int u = -1; u <= 1; ++u) {
        if (taken_(row + v, column + u)) return true;
      }
    }
    return false;
  }
  void take(double x, double y) { taken_(static_cast<int>(y) / cell_ + 1, static_cast<int>(x) / cell_ + 1) = 1; }

 private:
  int cell_;
  cv::Mat1b taken_;
};

cv::Mat1b grey_of(const cv::Mat& image) {
  if (image.channels() == 1) return image;
  cv::Mat1b grey;
  cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);
  return grey;
}

// The stored views as bundle adjustment counts them.
struct Views {
  std::vector<int> frames, submaps;
  std::vector<Pose> poses;
  std::vector<std::vector<std::pair<int, Pose>>> loops;  // of each view: earlier ones and earlier_from_view
};

// What predicts whether a view sees the same as others, and where that lies.
struct Sight {
  ViewSketch sketch;
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();  // of what it sees [m], in the world
  double radius = 0;                                 // RMS distance from there [m]
};

Sight sight_of(ViewSketch sketch, const Pose& world_from_cam) {
  Sight sight{.sketch = std::move(sketch)};
  const auto& points = sight.sketch.points_in_cam;
  if (points.empty()) return sight;
  const auto count = static_cast<double>(points.size());
  for (const Eigen::Vector3f& p : points) sight.centre += p.cast<double>() / count;
  double square = 0;
  for (const Eigen::Vector3f& p : points) square += (p.cast<double>() - sight.centre).squaredNorm() / count;
  sight.radius = std::sqrt(square);
  sight.centre = world_from_cam * sight.centre;
  return sight;
}

// Views before the window of view k that see the same by the poses as they are, those that share most first; none is
// a loop, or next to a better one.
std::vector<int> partners_of(int k, const std::vector<Sight>& sights, const Views& views, const RectifiedCamera& camera,
                             const BundleOptions& options) {
  constexpr double kLeastOverlap = 0.05;  // a few corners that are seen again tell already
  constexpr int kMost = 400;              // of views near by are asked, evenly
  std::vector<int> near;
  for (int e = 0; e < k - options.window && options.partners > 0; ++e) {
    const double reach = 2 * (sights[e].radius + sights[k].radius);
    if (views.submaps[e] != views.submaps[k] || sights[e].sketch.points_in_cam.empty()) continue;
    if ((sights[e].centre - sights[k].centre).squaredNorm() < reach * reach) near.push_back(e);
  }
  const int count = std::min(static_cast<int>(near.size()), kMost);
  std::vector<std::pair<double, int>> overlaps(static_cast<size_t>(count));
  parallel_chunks(0, count, 16, [&](int begin, int end) {
    for (int n = begin; n < end; ++n) {
      const int e = near[n * near.size() / count];
      const RelativePose relative{.i_from_j = views.poses[e].inverse() * views.poses[k]};
      overlaps[n] = {-expected_overlap(sights[e].sketch, sights[k].sketch, relative, camera), e};
    }
  });
  std::sort(overlaps.begin(), overlaps.end());
  std::vector<int> chosen;
  for (const auto& [overlap, e] : overlaps) {
    if (static_cast<int>(chosen.size()) == options.partners || -overlap < kLeastOverlap) break;
    const auto beside = [e = e](int other) { return std::abs(other - e) <= 1; };
    const auto is_loop = [e = e](const auto& loop) { return loop.first == e; };
    if (std::any_of(chosen.begin(), chosen.end(), beside)) continue;
    if (std::none_of(views.loops[k].begin(), views.loops[k].end(), is_loop)) chosen.push_back(e);
  }
  return chosen;
}

// Landmarks and where they are seen. Each corner that is not yet a landmark becomes one; it is looked for where the
// poses predict it in the next views, and what a view sees is looked for in the later ends of its loops and in its
// later partners. Always from the landmark's own surroundings, or those of that view: positions do not drift from view
// to view.
std::vector<Landmark> find_landmarks(const Views& views, const std::function<StereoView(int)>& view,
                                     const RectifiedCamera& camera, const BundleOptions& options,
                                     motion::ScsOptions scs, const std::function<bool()>& stopped) {
  constexpr int kBlock = 8;                                // views that are read at once
  constexpr int kFoundCell = 3;                            // [px] two landmarks nearer to each other are one
  constexpr int kNewCell = 6;                              // [px] no new landmark so near to one
  scs.max_refinement = std::max(scs.max_refinement, 3.0);  // poses are not as good as the motion between two views
  const int count = static_cast<int>(views.frames.size());
  std::vector<Landmark> landmarks;
  std::vector<std::vector<Seen>> seen(static_cast<size_t>(count));
  std::deque<motion::ViewFeatures> recent;  // of the last options.window views, and those of the block from `k` on
  int first_recent = 0;
  std::vector<Sight> sights;
  for (int k = 0; k < count; ++k) {
    if (k % kBlock == 0) {
      if (stopped && stopped()) throw Interrupted();
      std::vector<motion::ViewFeatures> block(static_cast<size_t>(std::min(kBlock, count - k)));
      parallel_chunks(0, static_cast<int>(block.size()), 1, [&](int begin, int end) {
        for (int b = begin; b < end; ++b) {
          const StereoView stored = view(views.frames[k + b]);
          block[b] = motion::extract_features(grey_of(stored.image), stored.disparity, camera, scs);
        }
      });
      for (auto& features : block) recent.push_back(std::move(features));
    }
    const motion::ViewFeatures& current = recent[k - first_recent];

    // Where landmarks are looked for from: loops first, they are rarer.
    struct Source {
      int view = 0;
      Pose source_from_current;
      std::vector<Seen> wanted;
      std::vector<motion::Correspondence> found;
    };
    std::vector<Source> sources;
    for (const auto& [earlier, earlier_from_current] : views.loops[k]) {
      sources.push_back({.view = earlier, .source_from_current = earlier_from_current});
      sources.back().wanted = seen[earlier];
    }
    sights.push_back(sight_of(sketch(views.frames[k], current, camera), views.poses[k]));
    for (const int earlier : partners_of(k, sights, views, camera, options)) {
      sources.push_back({.view = earlier, .source_from_current = views.poses[earlier].inverse() * views.poses[k]});
      sources.back().wanted = seen[earlier];
    }
    for (int earlier = k - 1; earlier >= std::max(0, k - options.window); --earlier) {
      if (views.submaps[earlier] != views.submaps[k]) continue;
      sources.push_back({.view = earlier, .source_from_current = views.poses[earlier].inverse() * views.poses[k]});
      for (const Seen& one : seen[earlier]) {
        if (landmarks[one.landmark].anchor == earlier) sources.back().wanted.push_back(one);
      }
    }
    parallel_chunks(0, static_cast<int>(sources.size()), 1, [&](int begin, int end) {
      for (int s = begin; s < end; ++s) {
        Source& source = sources[s];
        motion::ViewFeatures from;
        if (source.view >= first_recent) {
          from.image = recent[source.view - first_recent].image;
          from.disparity = recent[source.view - first_recent].disparity;
        } else {
          const StereoView stored = view(views.frames[source.view]);
          from.image = grey_of(stored.image);
          from.disparity = stored.disparity;
        }
        for (const Seen& one : source.wanted) from.corners.push_back(one.corner);
        motion::measure_disparities(from, camera);  // the planes around them; there is no right image
        source.found = motion::predicted_matches(from, current, source.source_from_current, camera, scs);
      }
    });
    Occupied occupied(camera, kFoundCell), for_new(camera, kNewCell);
    std::vector<int> seen_here;
    const auto add = [&](int landmark, const motion::Corner& corner) {
      landmarks[landmark].observations.push_back({k, reconstruct::image_coordinates(camera, corner.point_in_cam)});
      seen[k].push_back({landmark, corner});
      occupied.take(corner.x, corner.y);
      for_new.take(corner.x, corner.y);
    };
    for (const Source& source : sources) {
      for (const motion::Correspondence& match : source.found) {
        if (static_cast<int>(seen[k].size()) >= options.points) break;
        const int landmark = source.wanted[match.prev_corner].landmark;
        if (landmarks[landmark].observations.back().view == k) continue;
        const Eigen::Vector3d at = camera.project(match.cur_point);
        if (occupied.near(at.x(), at.y())) continue;
        add(landmark, {.x = at.x(), .y = at.y(), .disparity = at.z(), .point_in_cam = match.cur_point});
      }
    }
    for (const motion::Corner& corner : current.corners) {
      if (static_cast<int>(seen[k].size()) >= options.points) break;
      if (for_new.near(corner.x, corner.y)) continue;
      landmarks.push_back({.anchor = k, .point = views.poses[k] * corner.point_in_cam});
      add(static_cast<int>(landmarks.size()) - 1, corner);
    }
    while (first_recent < k + 1 - options.window) {
      recent.pop_front();
      ++first_recent;
    }
  }
  // A loop's motion and the poses may differ so much that a near point is behind the camera.
  for (Landmark& landmark : landmarks) {
    std::erase_if(landmark.observations, [&](const Observation& seen) {
      return !((views.poses[seen.view].inverse() * landmark.point).z() > 0);
    });
  }
  std::erase_if(landmarks, [](const Landmark& landmark) { return landmark.observations.size() < 2; });
  return landmarks;
}

// Between successive views: the relative pose as it was.
struct Bridge {
  int i = 0, j = 0;
  Pose i_from_j = Pose::Identity();
  Matrix6d information = Matrix6d::Zero();
  bool needed = false;  // these views share too few points
};

struct State {
  std::vector<Pose> poses;
  std::vector<Eigen::Vector3d> points;
  Eigen::Vector3d calibration = Eigen::Vector3d::Zero();
};

// An observation by the pose of its view, its point and the calibration.
class ObservationCost final : public ceres::SizedCostFunction<3, kPoseNumbers, 3, kCalibration> {
 public:
  ObservationCost(const RectifiedCamera& camera, const Eigen::Vector3d& seen, const Noise& noise)
      : camera_(camera), seen_(seen), noise_(noise) {}

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const Pose world_from_cam = pose_at(parameters[0]);
    const ObservationResidual at =
        whitened(observe(camera_, world_from_cam, Eigen::Map<const Eigen::Vector3d>(parameters[1]),
                         Eigen::Map<const Eigen::Vector3d>(parameters[2]), seen_),
                 noise_);
    if (!at.valid) return false;
    Eigen::Map<Eigen::Vector3d>{residuals} = at.residual;
    if (!jacobians) return true;
    using Square = Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>;
    if (jacobians[0]) {
      Eigen::Map<Eigen::Matrix<double, 3, kPoseNumbers, Eigen::RowMajor>>{jacobians[0]}.noalias() =
          at.by_pose * step_from_numbers(world_from_cam);
    }
    if (jacobians[1]) Square{jacobians[1]} = at.by_point;
    if (jacobians[2]) Square{jacobians[2]} = at.by_calibration;
    return true;
  }

 private:
  const RectifiedCamera& camera_;
  Eigen::Vector3d seen_;
  Noise noise_;
};

// The landmarks of one anchor: the unit of parallel work. Their part of the reduced system is small and dense.
struct Group {
  int begin = 0, end = 0;                  // landmarks
  std::vector<int> views;                  // that see any of them, ascending
  std::vector<std::pair<int, int>> pairs;  // of places in `views`, that see a landmark together
  std::vector<int> pair_slots;             // of these in the reduced matrix
};

class Adjuster {
 public:
  Adjuster(const RectifiedCamera& camera, const std::vector<Landmark>& landmarks, const std::vector<Bridge>& bridges,
           const std::vector<int>& unknown_of_view, int unknowns, double times, const std::function<bool()>& stopped)
      : camera_(camera),
        landmarks_(landmarks),
        bridges_(bridges),
        unknown_of_view_(unknown_of_view),
        unknowns_(unknowns),
        groups_(grouped()),
        system_(unknowns, pairs_of_groups()),
        times_(times),
        stopped_(stopped) {}

  // How good the observations are: what residuals are compared with.
  void set_noise(const Noise& noise) { noise_ = noise; }

  // Whether odometry counts between all successive views, or only where it is needed: the errors of the calibration are
  // in it.
  void use_odometry(bool everywhere) { odometry_everywhere_ = everywhere; }

  // Least squares over poses, points and those parameters of the calibration that are free (1, else 0). Returns whether
  // it has come to rest.
  bool run(State& state, const Eigen::Array3d& free, int max_iterations, int& iterations) const {
    PoseManifold manifold;
    std::vector<int> fixed;
    for (int k = 0; k < kCalibration; ++k) {
      if (free(k) == 0) fixed.push_back(k);
    }
    std::optional<ceres::SubsetManifold> free_part;
    if (static_cast<int>(fixed.size()) < kCalibration) free_part.emplace(kCalibration, fixed);
    ceres::CauchyLoss loss(kWidth);

    ceres::Problem problem(lent());
    auto order = std::make_shared<ceres::ParameterBlockOrdering>();  // points are eliminated first
    for (size_t v = 0; v < state.poses.size(); ++v) {
      problem.AddParameterBlock(state.poses[v].data(), kPoseNumbers, &manifold);
      if (unknown_of_view_[v] < 0) problem.SetParameterBlockConstant(state.poses[v].data());
      order->AddElementToGroup(state.poses[v].data(), 1);
    }
    problem.AddParameterBlock(state.calibration.data(), kCalibration);
    order->AddElementToGroup(state.calibration.data(), 1);
    if (free_part) {
      problem.SetManifold(state.calibration.data(), &*free_part);
    } else {
      problem.SetParameterBlockConstant(state.calibration.data());
    }
    for (size_t l = 0; l < landmarks_.size(); ++l) {
      double* const point = state.points[l].data();
      for (const Observation& seen : landmarks_[l].observations) {
        problem.AddResidualBlock(new ObservationCost(camera_, seen.seen, noise_), &loss, state.poses[seen.view].data(),
                                 point, state.calibration.data());
      }
      order->AddElementToGroup(point, 0);
    }
    for (const Bridge& bridge : bridges_) {
      const double weight = weight_of(bridge);
      if (weight == 0) continue;
      problem.AddResidualBlock(new EdgeCost(bridge.i_from_j, weight * bridge.information), nullptr,
                               state.poses[bridge.i].data(), state.poses[bridge.j].data());
    }
    ceres::Solver::Options options = near_the_minimum(ceres::SPARSE_SCHUR);
    options.linear_solver_ordering = order;
    options.initial_trust_region_radius = 1e8;
    Watch watch(stopped_);
    watch.rest = kRest * static_cast<double>(3 * landmarks_.size() + 6 * unknowns_);
    return minimise(problem, options, watch, max_iterations, iterations);
  }

  // Standard deviations of all calibration parameters together (linearised, all free): what the noise of the
  // observations brings, or what parts of the recording disagree by, whichever is more. The latter holds whatever is
  // wrong with the images: with s the gradient that a part adds, points and poses eliminated, and H the Hessian, it is
  // H^-1 (sum of s s') H^-1. `error`: of an observation, in units of what is set.
  Eigen::Array3d calibration_sigma(const State& state, double error) {
    linearise(state);
    if (!system_.factorise(1e-12)) return Eigen::Array3d::Constant(std::numeric_limits<double>::infinity());
    const Eigen::MatrixXd y = system_.solve(coupling_);
    const Eigen::Matrix3d reduced = calibration_hessian_ - coupling_.transpose() * y;
    const Eigen::Matrix3d inverse = reduced.inverse();

    constexpr int kParts = 8;
    Eigen::Matrix<double, 3, kParts> parts = Eigen::Matrix<double, 3, kParts>::Zero();
    for (size_t g = 0; g < groups_.size(); ++g) {
      const Group& group = groups_[g];
      const Eigen::VectorXd& gradient = gradients_[g];
      // Parts of the recording, of equally many points.
      auto part = parts.col(static_cast<Eigen::Index>(group.begin * kParts / landmarks_.size()));
      part += gradient.tail<kCalibration>();
      for (size_t v = 0; v < group.views.size(); ++v) {
        const int u = unknown_of_view_[group.views[v]];
        if (u >= 0) part -= y.middleRows<6>(6 * u).transpose() * gradient.segment<6>(6 * static_cast<Eigen::Index>(v));
      }
    }
    const Eigen::Matrix3d disagreement =
        inverse * (parts * parts.transpose() * kParts / (kParts - 1.0)) * inverse.transpose();
    const Eigen::Array3d variance = (error * error * inverse.diagonal().array()).max(disagreement.diagonal().array());
    return (inverse.diagonal().array() > 0).select(variance.abs().sqrt(), std::numeric_limits<double>::infinity());
  }

  // Marginal covariances of the unknown poses. variance: of an observation, in units of what is set. free: parameters
  // of the calibration that the images have decided; the others are where they are taken to be only as far as
  // calibration_sigma says, which moves all poses together. Odometry does not hold against that: it has the same
  // errors.
  std::vector<Matrix6d> covariances(const State& state, double variance, const Eigen::Array3d& free,
                                    const Eigen::Array3d& calibration_sigma) {
    linearise(state);
    system_.factorise_nearly();
    std::vector<Matrix6d> result = system_.inverse().diagonal;
    use_odometry(false);
    linearise(state);
    system_.factorise_nearly();
    const Eigen::MatrixXd y = system_.solve(coupling_);
    Eigen::Matrix3d reduced = calibration_hessian_ - coupling_.transpose() * y;
    reduced.diagonal().array() += (free != 0).select(0.0, variance / calibration_sigma.square());
    const Eigen::Matrix3d inverse = reduced.inverse();
    for (int u = 0; u < unknowns_; ++u) {
      const auto part = y.middleRows<6>(6 * u);
      result[u] = variance * (result[u] + part * inverse * part.transpose());
    }
    return result;
  }

  // What all residuals tell of the observations, by their medians: errors that are told are those that remain, smaller
  // than those of the observations, which points and poses follow in part.
  struct Errors {
    double rms = 0;  // [px] of a coordinate in both images
    Noise noise;
    double times = 1;  // as many times as set
  };
  Errors errors(const State& state) const {
    std::vector<double> all, left, disparity, relative;
    for (size_t l = 0; l < landmarks_.size(); ++l) {
      for (const Observation& seen : landmarks_[l].observations) {
        const ObservationResidual at =
            observe(camera_, state.poses[seen.view], state.points[l], state.calibration, seen.seen);
        if (!at.valid) continue;
        const Eigen::Vector3d in_pixels = whitened(at, {}).residual;
        all.push_back(at.residual.squaredNorm());
        left.push_back(in_pixels.head<2>().squaredNorm());
        disparity.push_back(in_pixels.z() * in_pixels.z());
        relative.push_back(left.back() / (noise_.left * noise_.left) +
                           disparity.back() / (noise_.disparity * noise_.disparity));
      }
    }
    return {.rms = std::sqrt(median(all) / kScaleOfMedian),
            .noise = {.left = std::sqrt(median(left) / kMedianOfTwo),
                      .disparity = std::sqrt(median(disparity) / kMedianOfOne)},
            .times = std::sqrt(median(relative) / kScaleOfMedian)};
  }

 private:
  // Half of the square of the steps of all points and poses, for each of them: 4 % of a standard deviation on average.
  // Robust weights settle slowly, those of points last; poses no longer notice.
  static constexpr double kRest = 1e-3;

  std::vector<Group> grouped() const {
    std::vector<Group> groups;
    const int count = static_cast<int>(landmarks_.size());
    for (int begin = 0; begin < count;) {
      Group group{.begin = begin, .end = begin};
      // A hundred landmarks at most: views with many of them do not hold up the others.
      while (group.end < count && group.end < begin + 100 && landmarks_[group.end].anchor == landmarks_[begin].anchor) {
        for (const Observation& seen : landmarks_[group.end].observations) group.views.push_back(seen.view);
        ++group.end;
      }
      std::sort(group.views.begin(), group.views.end());
      group.views.erase(std::unique(group.views.begin(), group.views.end()), group.views.end());
      for (int l = begin; l < group.end; ++l) {
        const auto& observations = landmarks_[l].observations;
        for (size_t a = 0; a < observations.size(); ++a) {
          for (size_t b = a + 1; b < observations.size(); ++b) {
            group.pairs.emplace_back(place_in(group, observations[a].view), place_in(group, observations[b].view));
          }
        }
      }
      std::sort(group.pairs.begin(), group.pairs.end());
      group.pairs.erase(std::unique(group.pairs.begin(), group.pairs.end()), group.pairs.end());
      begin = group.end;
      groups.push_back(std::move(group));
    }
    return groups;
  }

  static int place_in(const Group& group, int view) {
    return static_cast<int>(std::lower_bound(group.views.begin(), group.views.end(), view) - group.views.begin());
  }

  std::vector<std::pair<int, int>> pairs_of_groups() {
    std::vector<std::pair<int, int>> pairs;
    for (Group& group : groups_) {
      for (const auto& [a, b] : group.pairs) {
        group.pair_slots.push_back(static_cast<int>(pairs.size()));
        pairs.emplace_back(unknown_of_view_[group.views[a]], unknown_of_view_[group.views[b]]);
      }
    }
    first_bridge_slot_ = static_cast<int>(pairs.size());
    for (const Bridge& bridge : bridges_) pairs.emplace_back(unknown_of_view_[bridge.i], unknown_of_view_[bridge.j]);
    return pairs;
  }

  // Takes odometry's information to the units of the observations, which are `times_` as uncertain as they look.
  double weight_of(const Bridge& bridge) const { return bridge.needed || odometry_everywhere_ ? times_ * times_ : 0; }

  // Gauss and Newton's matrix at some state with all points eliminated by their 3x3 Schur complements: what covariances
  // follow from.
  void linearise(const State& state) {
    std::vector<Eigen::MatrixXd> parts(groups_.size());
    gradients_.resize(groups_.size());
    parallel_chunks(0, static_cast<int>(groups_.size()), 1, [&](int begin, int end) {
      for (int g = begin; g < end; ++g) parts[g] = part_of(groups_[g], state, gradients_[g]);
    });
    system_.set_zero();
    coupling_ = Eigen::MatrixXd::Zero(6 * unknowns_, kCalibration);
    calibration_hessian_.setZero();
    for (size_t g = 0; g < groups_.size(); ++g) {
      const Group& group = groups_[g];
      const Eigen::MatrixXd& part = parts[g];
      const int last = 6 * static_cast<int>(group.views.size());
      for (size_t v = 0; v < group.views.size(); ++v) {
        const int u = unknown_of_view_[group.views[v]], at = 6 * static_cast<int>(v);
        if (u < 0) continue;
        system_.add(u, part.block<6, 6>(at, at));
        coupling_.middleRows<6>(6 * u) += part.block<6, kCalibration>(at, last);
      }
      for (size_t p = 0; p < group.pairs.size(); ++p) {
        const auto& [a, b] = group.pairs[p];
        system_.add_pair(group.pair_slots[p], part.block<6, 6>(6 * a, 6 * b));
      }
      calibration_hessian_ += part.bottomRightCorner<kCalibration, kCalibration>();
    }
    for (size_t b = 0; b < bridges_.size(); ++b) {
      const Bridge& bridge = bridges_[b];
      const Pose &i = state.poses[bridge.i], &j = state.poses[bridge.j];
      const EdgeJacobians jacobians = edge_jacobians(i, j, edge_residual(i, j, bridge.i_from_j));
      const int ui = unknown_of_view_[bridge.i], uj = unknown_of_view_[bridge.j];
      const Matrix6d information = weight_of(bridge) * bridge.information;
      const Matrix6d weighted_i = information * jacobians.by_i, weighted_j = information * jacobians.by_j;
      if (ui >= 0) system_.add(ui, jacobians.by_i.transpose() * weighted_i);
      if (uj >= 0) system_.add(uj, jacobians.by_j.transpose() * weighted_j);
      system_.add_pair(first_bridge_slot_ + static_cast<int>(b), jacobians.by_i.transpose() * weighted_j);
    }
  }

  // A group's part of it: its views, then the calibration; and of the gradient.
  Eigen::MatrixXd part_of(const Group& group, const State& state, Eigen::VectorXd& gradient) const {
    const int last = 6 * static_cast<int>(group.views.size());
    Eigen::MatrixXd part = Eigen::MatrixXd::Zero(last + kCalibration, last + kCalibration);
    gradient = Eigen::VectorXd::Zero(last + kCalibration);
    std::vector<int> places;
    std::vector<Eigen::Matrix<double, 6, 3>> by_point;  // of each observation: pose by point
    for (int l = group.begin; l < group.end; ++l) {
      places.clear();
      by_point.clear();
      Eigen::Matrix3d point_hessian = Eigen::Matrix3d::Zero(), calibration_by_point = Eigen::Matrix3d::Zero();
      Eigen::Vector3d point_gradient = Eigen::Vector3d::Zero();
      for (const Observation& seen : landmarks_[l].observations) {
        const ObservationResidual at =
            whitened(observe(camera_, state.poses[seen.view], state.points[l], state.calibration, seen.seen), noise_);
        IRIS_CHECK(at.valid);
        const double weight = 1 / (1 + at.residual.squaredNorm() / (kWidth * kWidth));
        const int place = 6 * place_in(group, seen.view);
        const Eigen::Matrix<double, 6, 3> pose = weight * at.by_pose.transpose();
        const Eigen::Matrix3d calibration = weight * at.by_calibration.transpose();
        point_hessian.noalias() += weight * at.by_point.transpose() * at.by_point;
        part.block<6, 6>(place, place).noalias() += pose * at.by_pose;
        part.block<6, 3>(place, last).noalias() += pose * at.by_calibration;
        part.block<3, 3>(last, last).noalias() += calibration * at.by_calibration;
        calibration_by_point.noalias() += calibration * at.by_point;
        point_gradient.noalias() += weight * at.by_point.transpose() * at.residual;
        gradient.segment<6>(place).noalias() += pose * at.residual;
        gradient.tail<kCalibration>().noalias() += calibration * at.residual;
        places.push_back(place);
        by_point.push_back(pose * at.by_point);
      }
      const Eigen::Matrix3d inverse = point_hessian.inverse();
      for (size_t a = 0; a < places.size(); ++a) {
        const Eigen::Matrix<double, 6, 3> reduced = by_point[a] * inverse;
        part.block<6, 3>(places[a], last).noalias() -= reduced * calibration_by_point.transpose();
        gradient.segment<6>(places[a]).noalias() -= reduced * point_gradient;
        for (size_t b = a; b < places.size(); ++b) {
          part.block<6, 6>(places[a], places[b]).noalias() -= reduced * by_point[b].transpose();
        }
      }
      part.block<3, 3>(last, last).noalias() -= calibration_by_point * inverse * calibration_by_point.transpose();
      gradient.tail<kCalibration>().noalias() -= calibration_by_point * inverse * point_gradient;
    }
    return part;
  }

  const RectifiedCamera& camera_;
  const std::vector<Landmark>& landmarks_;
  const std::vector<Bridge>& bridges_;
  const std::vector<int>& unknown_of_view_;
  int unknowns_ = 0, first_bridge_slot_ = 0;
  std::vector<Group> groups_;
  BlockCholesky<6> system_;
  Eigen::MatrixXd coupling_;
  Eigen::Matrix3d calibration_hessian_;
  std::vector<Eigen::VectorXd> gradients_;  // of each group: its views, then the calibration; points eliminated
  double times_ = 1;
  const std::function<bool()>& stopped_;  // may be empty
  bool odometry_everywhere_ = true;
  Noise noise_;
};

// Covariance of a motion carried on: of a from c, c being rigidly `way` away from b, for that of a from b.
Matrix6d carried(const Matrix6d& covariance, const Eigen::Vector3d& way) {
  Matrix6d rigid = Matrix6d::Identity();
  rigid.topRightCorner<3, 3>() = -motion::cross_matrix(way);
  return rigid * covariance * rigid.transpose();
}

// What odometry says of successive views. It knows the frames in between, which images of the views alone do not.
std::vector<Bridge> bridges_between(const Views& views, const std::vector<Landmark>& landmarks,
                                    const RefinedGraph& refined) {
  constexpr int kLeastShared = 20;
  std::vector<int> shared(views.frames.size(), 0);  // with the view before
  for (const Landmark& landmark : landmarks) {
    for (size_t n = 1; n < landmark.observations.size(); ++n) {
      const int view = landmark.observations[n].view;
      if (landmark.observations[n - 1].view == view - 1) ++shared[view];
    }
  }
  std::map<int, const PoseEdge*> edge_to;  // of each frame: the edge from the earlier frame it was measured against
  for (const PoseEdge& edge : refined.graph.edges) {
    if (edge.kind != PoseEdgeKind::loop) edge_to[std::max(edge.i, edge.j)] = &edge;
  }
  std::vector<Bridge> bridges;
  for (size_t k = 1; k < views.frames.size(); ++k) {
    if (views.submaps[k] != views.submaps[k - 1]) continue;
    // From the later view back to the earlier one; edges that reach beyond it end there.
    Pose from_later = Pose::Identity();  // of the frame reached
    Matrix6d covariance = Matrix6d::Zero();
    bool known = true;
    for (int frame = views.frames[k]; known && frame > views.frames[k - 1];) {
      const auto edge = edge_to.find(frame);
      known =
          edge != edge_to.end() && edge->second->kind == PoseEdgeKind::odometry && edge->second->i < edge->second->j;
      if (!known) break;
      const Pose& step = edge->second->i_from_j;
      Matrix6d turn = Matrix6d::Zero();
      turn.topLeftCorner<3, 3>() = turn.bottomRightCorner<3, 3>() = step.linear();
      covariance = turn * covariance * turn.transpose() +
                   carried(edge->second->information.inverse(), step.linear() * from_later.translation());
      from_later = step * from_later;
      frame = edge->second->i;
    }
    Bridge bridge{.i = static_cast<int>(k) - 1, .j = static_cast<int>(k)};
    bridge.needed = shared[k] < kLeastShared;
    bridge.i_from_j = views.poses[k - 1].inverse() * views.poses[k];
    if (known) {
      bridge.information = (covariance * refined.odometry_sigma * refined.odometry_sigma).inverse();
    } else {
      const double step = 0.05 + 0.1 * bridge.i_from_j.translation().norm(), turn = 0.05;  // [m], [rad]
      bridge.information.diagonal() << Eigen::Vector3d::Constant(1 / (step * step)),
          Eigen::Vector3d::Constant(1 / (turn * turn));
    }
    bridges.push_back(bridge);
  }
  return bridges;
}

// [px] of all observations.
double median_disparity(const std::vector<Landmark>& landmarks) {
  std::vector<double> disparities;
  for (const Landmark& landmark : landmarks) {
    for (const Observation& at : landmark.observations) disparities.push_back(at.seen.x() - at.seen.z());
  }
  return median(std::move(disparities));
}

// What is off, about which axis, and what it does to distances; of the rest the numbers alone. `disparity`: [px] that
// of a usual point.
std::string words_of(const CalibrationCorrection& c, const RectifiedCamera& camera, double disparity) {
  constexpr double kDegrees = 180 / M_PI;
  const double depth = camera.f * camera.baseline / disparity;
  std::vector<std::string> parts;
  if (const Estimated& e = c.disparity_offset; e.told) {
    std::string part = fmt::format("disparity offset {:+.2f} ± {:.2f} px", e.value, e.sigma);
    if (e.applied) {
      part += ", corrected";
    } else if (e.off) {
      part += fmt::format(
          ", not corrected: as if the right camera were turned by {:.2f} deg about the vertical axis, distances of "
          "{:.1f} m wrong by {:.1f} %",
          kDegrees * std::abs(e.value) / camera.f, depth, 100 * std::abs(e.value) / disparity);
    }
    parts.push_back(part);
  }
  if (const Estimated& e = c.focal; e.told) {
    std::string part = fmt::format("focal length {:+.2f} ± {:.2f} %", 100 * e.value, 100 * e.sigma);
    if (e.applied) {
      part += ", corrected";
    } else if (e.off) {
      part += fmt::format(", not corrected: distances wrong by {:.1f} %", 100 * std::abs(e.value));
    }
    parts.push_back(part);
  }
  if (const Estimated& e = c.slope; e.told) {
    const double border = camera.height / 2.0;
    std::string part =
        fmt::format("{:+.2f} ± {:.2f} px more at the image's lower border", e.value * border, e.sigma * border);
    if (e.off) {
      part += fmt::format(
          ", as much less at the upper one: distances of {:.1f} m there wrong by {:.0f} %. If 'iris rectify "
          "--check' finds rows {:.1f} px off at the image's sides, the right camera is turned by {:.2f} deg about its "
          "optical axis; if not, the images were rectified with lenses that are not theirs",
          depth, 100 * std::abs(e.value) * border / disparity, std::abs(e.value) * camera.width / 2,
          kDegrees * std::abs(e.value));
    }
    parts.push_back(part);
  }
  if (parts.empty()) return "this recording does not tell whether it fits";
  return fmt::format("{}{}", fmt::join(parts, "; "), c.is_wrong ? ": calibrate again" : "");
}

// The poses of all nodes from those of the views, see BundleResult.
void spread_over_nodes(const std::vector<PoseNode>& nodes, const Views& views, const std::vector<int>& node_of_view,
                       const std::vector<Pose>& poses, const std::vector<Matrix6d>& covariances, BundleResult& result) {
  std::vector<double> way(nodes.size(), 0);
  for (size_t n = 1; n < nodes.size(); ++n) {
    way[n] = way[n - 1] + (nodes[n].world_from_cam.translation() - nodes[n - 1].world_from_cam.translation()).norm();
  }
  const int count = static_cast<int>(nodes.size());
  std::map<int, std::vector<int>> views_of_submap;
  for (size_t v = 0; v < views.frames.size(); ++v) views_of_submap[views.submaps[v]].push_back(static_cast<int>(v));
  for (int n = 0; n < count; ++n) {
    const auto found = views_of_submap.find(nodes[n].submap);
    if (found == views_of_submap.end()) continue;
    const std::vector<int>& list = found->second;
    const auto after =
        std::upper_bound(list.begin(), list.end(), n, [&](int node, int v) { return node < node_of_view[v]; });
    const int b = after == list.end() ? -1 : *after, a = after == list.begin() ? -1 : *(after - 1);
    const auto moved_with = [&](int v) { return poses[v] * views.poses[v].inverse() * nodes[n].world_from_cam; };
    Pose pose;
    int nearest = a;
    if (a < 0 || b < 0) {
      nearest = a < 0 ? b : a;
      pose = moved_with(nearest);
    } else {
      const double length = way[node_of_view[b]] - way[node_of_view[a]];
      const double s = length > 0 ? (way[n] - way[node_of_view[a]]) / length : 0;
      if (s > 0.5) nearest = b;
      const Pose with_a = moved_with(a), with_b = moved_with(b);
      pose.linear() = Eigen::Quaterniond(with_a.linear()).slerp(s, Eigen::Quaterniond(with_b.linear())).matrix();
      pose.translation() = (1 - s) * with_a.translation() + s * with_b.translation();
    }
    if (node_of_view[nearest] == n) pose = poses[nearest];
    pose.linear() = nearest_rotation(pose.linear());
    result.nodes[n].world_from_cam = pose;
    result.covariance[n] = carried(covariances[nearest], pose.translation() - poses[nearest].translation());
  }
}

}  // namespace

BundleResult bundle(const RefinedGraph& refined, const std::vector<int>& view_frames,
                    const std::function<StereoView(int)>& view, const RectifiedCamera& camera,
                    const BundleOptions& options, const motion::ScsOptions& scs, const std::function<bool()>& stopped) {
  const std::vector<PoseNode>& nodes = refined.graph.nodes;
  BundleResult result{.nodes = nodes, .camera = camera, .views = static_cast<int>(view_frames.size())};
  result.covariance.assign(nodes.size(), Matrix6d::Zero());

  Views views{.frames = view_frames};
  std::map<int, int> view_of_frame;
  std::vector<int> node_of_view, unknown_of_view;
  std::map<int, bool> submap_seen;
  int unknowns = 0;
  for (const int frame_idx : view_frames) {
    const auto node = std::lower_bound(nodes.begin(), nodes.end(), frame_idx,
                                       [](const PoseNode& a, int idx) { return a.frame_idx < idx; });
    IRIS_CHECK(node != nodes.end() && node->frame_idx == frame_idx);
    view_of_frame[frame_idx] = static_cast<int>(node_of_view.size());
    node_of_view.push_back(static_cast<int>(node - nodes.begin()));
    views.submaps.push_back(node->submap);
    views.poses.push_back(node->world_from_cam);
    unknown_of_view.push_back(submap_seen[node->submap] ? unknowns++ : -1);
    submap_seen[node->submap] = true;
  }
  views.loops.resize(view_frames.size());
  for (size_t k = 0; k < refined.graph.edges.size(); ++k) {
    const PoseEdge& loop = refined.graph.edges[k];
    if (loop.kind != PoseEdgeKind::loop || refined.edge_weight[k] < kRejectedWeight) continue;
    const auto i = view_of_frame.find(loop.i), j = view_of_frame.find(loop.j);
    if (i == view_of_frame.end() || j == view_of_frame.end() || i == j) continue;
    if (views.submaps[i->second] != views.submaps[j->second]) continue;
    if (i->second < j->second) {
      views.loops[j->second].emplace_back(i->second, loop.i_from_j);
    } else {
      views.loops[i->second].emplace_back(j->second, loop.i_from_j.inverse());
    }
  }

  const std::vector<Landmark> landmarks = find_landmarks(views, view, camera, options, scs, stopped);
  result.points = static_cast<int>(landmarks.size());
  for (const Landmark& landmark : landmarks) result.observations += static_cast<int>(landmark.observations.size());
  if (unknowns == 0 || 3 * (result.observations - result.points) < 12 * unknowns) {
    result.problem = fmt::format("{} views share only {} points", result.views, result.points);
    return result;
  }
  const std::vector<Bridge> bridges = bridges_between(views, landmarks, refined);

  // Only loose first: how good the observations are is told by what is left.
  // What makes odometry worse than its corners say is in these corners as well.
  const double times = std::max(options.sigma, refined.odometry_sigma);
  State state{.poses = views.poses};
  for (const Landmark& landmark : landmarks) state.points.push_back(landmark.point);
  Adjuster adjuster(camera, landmarks, bridges, unknown_of_view, unknowns, times, stopped);
  const Eigen::Array3d none = Eigen::Array3d::Zero();
  // Points begin where their anchor saw them; half of their disagreement is its own.
  result.rms_before = adjuster.errors(state).rms;
  adjuster.set_noise({.left = result.rms_before, .disparity = M_SQRT2 * result.rms_before});
  adjuster.run(state, none, 3, result.iterations);
  adjuster.set_noise(adjuster.errors(state).noise);

  // What the images say about the calibration, then with what of it is significant.
  const double freedom = 3.0 * (result.observations - result.points) - 6.0 * unknowns;
  const double few = std::sqrt(3.0 * result.observations / freedom);  // points and poses follow the errors in part
  State free_state = state;
  adjuster.use_odometry(false);
  adjuster.run(free_state, Eigen::Array3d::Ones(), options.max_iterations, result.iterations);
  const Eigen::Array3d calibration_sigma =
      adjuster.calibration_sigma(free_state, times * few * adjuster.errors(free_state).times);
  Estimated* const estimates[] = {&result.calibration.disparity_offset, &result.calibration.focal,
                                  &result.calibration.slope};
  const double least[] = {options.min_offset, options.min_focal, kLeastSlope};
  const double most[] = {options.max_offset, options.max_focal, 0};
  constexpr double kGross[] = {3, 0.05, kMostSlope};  // [px], parts: what a recording has to see to tell anything
  bool correctable = options.calibrate;               // one that cannot be corrected would be taken for the others
  for (int k = 0; k < kCalibration; ++k) {
    const double value = free_state.calibration(k), sigma = calibration_sigma(k);
    const bool told = 3 * sigma < kGross[k];
    const bool off = told && std::abs(value) > 3 * sigma && std::abs(value) > least[k];
    *estimates[k] = {.value = value, .sigma = sigma, .told = told, .off = off};
    correctable = correctable && (!off || std::abs(value) <= most[k]);
  }
  Eigen::Array3d free = none;
  for (int k = 0; k < kCalibration; ++k) {
    estimates[k]->applied = correctable && estimates[k]->off;
    free(k) = estimates[k]->applied ? 1 : 0;
  }
  if (free.any()) {
    state = free_state;
    state.calibration.array() *= free;
  }
  adjuster.use_odometry(!free.any());
  adjuster.run(state, free, options.max_iterations, result.iterations);
  for (int k = 0; k < kCalibration; ++k) {
    if (free(k) != 0) estimates[k]->value = state.calibration(k);
  }
  for (const Estimated* estimate : estimates) result.calibration.is_wrong |= estimate->off && !estimate->applied;
  result.calibration.words = words_of(result.calibration, camera, median_disparity(landmarks));
  result.camera.disparity_offset += state.calibration(0);
  result.camera.f *= 1 + state.calibration(1);
  const Adjuster::Errors after = adjuster.errors(state);
  result.rms_after = after.rms;

  const std::vector<Matrix6d> of_unknowns =
      adjuster.covariances(state, std::pow(times * few * after.times, 2), free,
                           Eigen::Array3d(options.min_offset, options.min_focal, kLeastSlope));
  std::vector<Matrix6d> covariances;
  for (const int u : unknown_of_view) covariances.push_back(u < 0 ? Matrix6d::Zero() : of_unknowns[u]);
  spread_over_nodes(nodes, views, node_of_view, state.poses, covariances, result);
  result.ok = true;
  return result;
}

}  // namespace iris::loop
