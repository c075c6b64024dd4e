// Chapter 5: counts of correspondences (fig. 5.5, with Rank and with SAD), errors of closed sequences (table 5.1,
// fig. 5.7), dependency on the frame rate (fig. 5.10).
#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <tuple>
#include <utility>
#include <vector>

#include "iris/core/parallel.h"
#include "iris/motion/agreement.h"
#include "iris/motion/scs.h"
#include "thesis/sequence.h"
#include "thesis/tables.h"

namespace iris::thesis {
namespace {

using motion::ScsOptions;
using motion::ViewFeatures;

constexpr std::array<const char*, 4> kModels = {"spherical", "ellipsoid", "drift", "image"};

std::vector<MotionEstimate> motions_of(const std::vector<ViewFeatures>& views, const RectifiedCamera& camera,
                                       const ScsOptions& options) {
  std::vector<MotionEstimate> motions(views.size() - 1);
  parallel_chunks(0, static_cast<int>(motions.size()), 4, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      const size_t k = static_cast<size_t>(i);
      motions[k] = motion::estimate_motion(views[k], views[k + 1], camera, options);
    }
  });
  return motions;
}

struct Closing {
  int failures = 0;
  double rotation = 0;     // [deg]
  double translation = 0;  // [mm]
};

// The error of a closed sequence (5.4.2): all motions chained, then the motion from the last view back to the first.
Closing closing_error(const std::vector<ViewFeatures>& views, const std::vector<MotionEstimate>& motions,
                      const RectifiedCamera& camera, const ScsOptions& options) {
  Closing closing;
  Pose first_from_last = Pose::Identity();
  for (const MotionEstimate& motion : motions) {
    closing.failures += motion.status != MotionStatus::ok;
    first_from_last = first_from_last * motion.prev_from_cur;
  }
  const MotionEstimate back = motion::estimate_motion(views.back(), views.front(), camera, options);
  closing.failures += back.status != MotionStatus::ok;
  const Pose round = first_from_last * back.prev_from_cur;
  closing.rotation = rotation_angle(round) * 180 / M_PI;
  closing.translation = round.translation().norm() * 1000;
  return closing;
}

std::string text(const Closing& closing) {
  if (closing.failures > 0) return fmt::format("{} failed", closing.failures);
  return fmt::format("{:.2f}° {:.1f} mm", closing.rotation, closing.translation);
}

// Mean of the normalised squared errors e^T C^-1 e of the motions that were found; 6 if their covariances are right.
double mean_nees(const std::vector<MotionEstimate>& motions, const Sequence& sequence, int stride) {
  double sum = 0;
  int count = 0;
  for (size_t i = 0; i < motions.size(); ++i) {
    if (motions[i].status != MotionStatus::ok) continue;
    const size_t from = i * static_cast<size_t>(stride), to = from + static_cast<size_t>(stride);
    const Pose truth = sequence.truth[from].inverse() * sequence.truth[to];
    const Pose& found = motions[i].prev_from_cur;
    const Eigen::AngleAxisd turn(Eigen::Matrix3d(found.linear() * truth.linear().transpose()));
    Vector6d error;
    error << found.translation() - truth.translation(), turn.angle() * turn.axis();
    sum += error.dot(motions[i].covariance.llt().solve(error));
    ++count;
  }
  return sum / std::max(1, count);
}

simulate::SimulateOptions arbitrary(double rate) {
  simulate::SimulateOptions options = thesis_camera();
  options.path = "roam";
  options.rate = rate;
  options.speed = 0.2;  // about the motion between views of the thesis's sequence (5.4.1)
  return options;
}

// One sequence at 25 frames a second holds the slower ones.
void print_frame_rates(const Sequence& sequence) {
  fmt::print("\n### Figures 5.5 and 5.10: counts and closing error over the frame rate, {}\n\n", sequence.name);
  print_heading({"fps", "views", "turn, move between views", "usable", "initial", "consistent", "used: mean", "least",
                 "ellipsoid", "with drift compensation", "image based", "NEES"});
  for (const int stride : {1, 3, 8, 17}) {
    ScsOptions options;
    const std::vector<ViewFeatures> views = features_of(sequence, thesis_stereo(), options, stride);
    double turn = 0, move = 0;
    for (size_t i = 1; i < views.size(); ++i) {
      const Pose step = sequence.truth[(i - 1) * stride].inverse() * sequence.truth[i * stride];
      turn += rotation_angle(step) * 180 / M_PI, move += step.translation().norm() * 1000;
    }
    options.model = "image";
    const std::vector<MotionEstimate> motions = motions_of(views, sequence.camera, options);
    double usable = 0, initial = 0, consistent = 0, used = 0;
    int least = 1 << 30;
    for (const MotionEstimate& motion : motions) {
      usable += motion.corners, initial += motion.initial, consistent += motion.consistent, used += motion.used;
      least = std::min(least, motion.used);
    }
    const double n = static_cast<double>(motions.size());
    std::vector<std::string> cells = {fmt::format("{:.1f}", sequence.rate / stride),
                                      fmt::format("{}", views.size()),
                                      fmt::format("{:.1f}° {:.0f} mm", turn / n, move / n),
                                      fmt::format("{:.0f}", usable / n),
                                      fmt::format("{:.0f}", initial / n),
                                      fmt::format("{:.0f}", consistent / n),
                                      fmt::format("{:.0f}", used / n),
                                      fmt::format("{}", least)};
    const std::string image = text(closing_error(views, motions, sequence.camera, options));
    for (const char* model : {"ellipsoid", "drift"}) {
      options.model = model;
      cells.push_back(
          text(closing_error(views, motions_of(views, sequence.camera, options), sequence.camera, options)));
    }
    cells.push_back(image);
    cells.push_back(fmt::format("{:.1f}", mean_nees(motions, sequence, stride)));
    print_row(cells);
  }
}

// What the surroundings of corners are compared by, without the second search where a first motion predicts the
// corners.
void print_measures(const Sequence& sequence) {
  fmt::print("\n### Figure 5.5b: correspondences by Rank and by SAD, {}\n\n", sequence.name);
  print_heading(
      {"fps", "compared by", "initial", "consistent", "of the initial ones", "used: mean", "least", "failed"});
  for (const int stride : {3, 8, 17}) {
    for (const char* measure : {"rank", "sad"}) {
      ScsOptions options;
      options.compare = measure;
      options.predict = false;
      const std::vector<MotionEstimate> motions =
          motions_of(features_of(sequence, thesis_stereo(), options, stride), sequence.camera, options);
      double initial = 0, consistent = 0, used = 0;
      int least = 1 << 30, failed = 0;
      for (const MotionEstimate& motion : motions) {
        initial += motion.initial, consistent += motion.consistent, used += motion.used;
        least = std::min(least, motion.used);
        failed += motion.status != MotionStatus::ok;
      }
      const double n = static_cast<double>(motions.size());
      print_row({fmt::format("{:.1f}", sequence.rate / stride), measure, fmt::format("{:.0f}", initial / n),
                 fmt::format("{:.0f}", consistent / n), fmt::format("{:.0f} %", 100 * consistent / initial),
                 fmt::format("{:.0f}", used / n), fmt::format("{}", least), fmt::format("{}", failed)});
    }
  }
}

void print_closed_sequences() {
  fmt::print("\n### Table 5.1 and figure 5.7: error of closed sequences, 8 fps, with and without rejection\n\n");
  print_heading(
      {"sequence", "views", "path", "rejection", "spherical", "ellipsoid", "with drift compensation", "image based"});
  const auto closed = [](const char* scene, const char* path) {
    simulate::SimulateOptions options = thesis_camera();
    options.path = path;
    return simulate_sequence(scene, options);
  };
  for (const auto& [scene, path] : {std::pair("seminar-room", "circle"), std::pair("apartment", "circle"),
                                    std::pair("boxes", "circle"), std::pair("yard", "circle")}) {
    const Sequence sequence = closed(scene, path);
    double length = 0;
    for (size_t i = 1; i < sequence.truth.size(); ++i) {
      length += (sequence.truth[i].translation() - sequence.truth[i - 1].translation()).norm();
    }
    ScsOptions options;
    const std::vector<ViewFeatures> views = features_of(sequence, thesis_stereo(), options);
    for (const bool reject : {false, true}) {
      options.reject_suspicious = reject;
      std::vector<std::string> cells = {sequence.name, fmt::format("{}", views.size()), fmt::format("{:.1f} m", length),
                                        reject ? "with" : "without"};
      for (const char* model : kModels) {
        options.model = model;
        const std::vector<MotionEstimate> motions = motions_of(views, sequence.camera, options);
        cells.push_back(text(closing_error(views, motions, sequence.camera, options)));
      }
      print_row(cells);
    }
  }
}

// Any two views at most `reach` places apart, in either order: how many motions are found and how many of these are
// wrong, by how much of the one view the other one shows.
void print_any_pairs(const Sequence& sequence, const stereo::MwmfOptions& stereo, int stride, int reach) {
  fmt::print("\n### Motions between any two views, {}, {:.1f} fps\n\n", sequence.name, sequence.rate / stride);
  const ScsOptions options;
  const std::vector<ViewFeatures> views = features_of(sequence, stereo, options, stride);
  std::vector<std::pair<size_t, size_t>> pairs;
  for (size_t i = 0; i < views.size(); ++i) {
    for (size_t k = i + 1; k < views.size() && k <= i + static_cast<size_t>(reach); ++k) {
      pairs.push_back(i % 2 == 0 ? std::pair(i, k) : std::pair(k, i));
    }
  }
  struct Outcome {
    double overlap = 0;  // part of the corners that the other view shows, by the true motion
    bool found = false, wrong = false;
  };
  std::vector<Outcome> outcomes(pairs.size());
  parallel_chunks(0, static_cast<int>(pairs.size()), 4, [&](int begin, int end) {
    for (int n = begin; n < end; ++n) {
      const auto& [i, k] = pairs[static_cast<size_t>(n)];
      const Pose truth =
          sequence.truth[i * static_cast<size_t>(stride)].inverse() * sequence.truth[k * static_cast<size_t>(stride)];
      const MotionEstimate motion = motion::estimate_motion(views[i], views[k], sequence.camera, options);
      const Pose error = truth.inverse() * motion.prev_from_cur;
      Outcome& outcome = outcomes[static_cast<size_t>(n)];
      outcome.overlap = motion::agreement(views[i], views[k], truth, sequence.camera).expected /
                        std::max(1.0, static_cast<double>(views[i].corners.size()));
      outcome.found = motion.status == MotionStatus::ok;
      outcome.wrong = outcome.found && (error.translation().norm() > 0.1 + 0.05 * truth.translation().norm() ||
                                        rotation_angle(error) * 180 / M_PI > 1.5);
    }
  });
  print_heading({"overlap", "pairs", "found", "of these wrong by more than 0.1 m + 5 % or 1.5°"});
  constexpr std::array<double, 7> kLimits = {0, 0.02, 0.1, 0.2, 0.3, 0.5, 1.01};
  for (size_t limit = 0; limit + 1 < kLimits.size(); ++limit) {
    int all = 0, found = 0, wrong = 0;
    for (const Outcome& outcome : outcomes) {
      if (outcome.overlap < kLimits[limit] || outcome.overlap >= kLimits[limit + 1]) continue;
      ++all, found += outcome.found, wrong += outcome.wrong;
    }
    print_row({fmt::format("{:.0f} to {:.0f} %", 100 * kLimits[limit], 100 * std::min(1.0, kLimits[limit + 1])),
               fmt::format("{}", all), fmt::format("{} ({:.0f} %)", found, 100.0 * found / std::max(1, all)),
               fmt::format("{}", wrong)});
  }
}

// Whether motions are as uncertain as they say, at 752 x 480 px, through real lenses, with noise and motion blur.
void print_covariances() {
  fmt::print("\n### Normalised squared errors of motions\n\n");
  print_heading({"sequence", "motions", "mean NEES (6 expected)", "95 % band of the mean"});
  // The apartment's rooms differ so much that only the whole walk tells.
  for (const auto& [scene, path, frames] : {std::tuple("seminar-room", "circle", 41), std::tuple("boxes", "circle", 41),
                                            std::tuple("apartment", "round", 0)}) {
    simulate::SimulateOptions options;
    options.path = path;
    options.frames = frames;
    const Sequence sequence = simulate_sequence(scene, options);
    stereo::MwmfOptions stereo = thesis_stereo();
    stereo.disparities = 128;
    const ScsOptions motion;
    const std::vector<MotionEstimate> motions =
        motions_of(features_of(sequence, stereo, motion), sequence.camera, motion);
    const double band = 1.96 * std::sqrt(12.0 / static_cast<double>(motions.size()));
    print_row({sequence.name, fmt::format("{}", motions.size()), fmt::format("{:.1f}", mean_nees(motions, sequence, 1)),
               fmt::format("{:.1f} to {:.1f}", 6 - band, 6 + band)});
  }
}

}  // namespace

void print_motion_tables() {
  fmt::print("\n## Chapter 5: camera motion\n");
  print_closed_sequences();
  const Sequence room = simulate_sequence("seminar-room", arbitrary(25));
  print_frame_rates(room);
  print_measures(room);
  print_covariances();
  print_any_pairs(room, thesis_stereo(), 17, 6);
  simulate::SimulateOptions walk;
  walk.rate = 0.5;
  stereo::MwmfOptions stereo;
  stereo.disparities = 128;
  stereo.interpolation = "off";
  print_any_pairs(simulate_sequence("apartment", walk), stereo, 1, 1000);
}

}  // namespace iris::thesis
