#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>

#include "bench/bench.h"
#include "bench/inputs.h"
#include "bench/minimise_peer.h"
#include "bench/opencv_peers.h"
#include "iris/motion/closed_form.h"
#include "iris/motion/scs.h"
#include "iris/stereo/mwmf.h"
#include "support/synthetic_views.h"

namespace iris::bench {
namespace {

using benchmark::DoNotOptimize;
using benchmark::State;
using namespace iris::motion;

const StereoView& view(int i) { return *hand_held_views()[static_cast<size_t>(i)]; }

ViewFeatures features_of(int i) {
  return extract_features(view(i).image, view(i).disparity, view(i).camera, ScsOptions{});
}

void our_features(State& state) {
  hand_held_views();
  size_t corners = 0;
  measure(state, 1, [&] { corners = features_of(0).corners.size(); });
  state.counters["corners"] = static_cast<double>(corners);
}

void shi_tomasi(State& state) {
  std::vector<cv::Point2f> corners;
  measure(state, 1,
          [&] { cv::goodFeaturesToTrack(view(0).image, corners, 500, 0.01, 8, cv::noArray(), 3, true, 0.04); });
}

void orb(State& state) {
  const auto detector = cv::ORB::create(500);
  std::vector<cv::KeyPoint> corners;
  cv::Mat descriptors;
  measure(state, 1, [&] { detector->detectAndCompute(view(0).image, cv::noArray(), corners, descriptors); });
}

// The corners of the previous view are known from when it was the current one.
void our_motion(State& state, bool with_features) {
  const ViewFeatures prev = features_of(0), cur = features_of(1);
  MotionEstimate estimate;
  measure(state, 1, [&] {
    estimate = estimate_motion(prev, with_features ? features_of(1) : cur, view(0).camera, ScsOptions{});
  });
  if (estimate.status != MotionStatus::ok) state.SkipWithError("no motion found");
  state.counters["points"] = estimate.used;
}

void peer_motion(State& state) {
  hand_held_views();
  int inliers = 0;
  measure(state, 1,
          [&] { inliers = plain_motion(view(0).image, view(0).disparity.disparity, view(1).image, view(0).camera); });
  state.counters["points"] = inliers;
}

// The whole stage for one more view with 300 corners a view, and the stereo stage for the same view.
void register_stage(const Sequence& (*sequence)(), const std::string& input) {
  const auto disparity_of = [=](size_t i) {
    stereo::MwmfOptions options;
    options.disparities = 128;
    return stereo::mwmf(sequence().pairs[i].left, sequence().pairs[i].right, options);
  };
  compare("motion", "whole stage", input,
          {{"IRIS",
            [=](State& state) {
              ScsOptions options;
              options.max_corners = 300;
              const RectifiedCamera& camera = sequence().camera;
              const DisparityImage disparities[2] = {disparity_of(0), disparity_of(1)};
              const auto features = [&](size_t i) {
                return extract_features(sequence().pairs[i].left, disparities[i], camera, options);
              };
              const ViewFeatures prev = features(0);
              MotionEstimate estimate;
              measure(state, 1, [&] { estimate = estimate_motion(prev, features(1), camera, options); });
              if (estimate.status != MotionStatus::ok) state.SkipWithError("no motion found");
              state.counters["points"] = estimate.used;
            }},
           {"MWMF stereo (IRIS)", [=](State& state) { measure(state, 1, [&] { DoNotOptimize(disparity_of(1)); }); }}});
}

// 150 points 2 to 8 m away, seen with 0.1 px of noise before and after a motion of 10 cm and 2 degrees.
std::vector<PointPair> noisy_pairs(const RectifiedCamera& camera, double noise) {
  Pose prev_from_cur = Pose::Identity();
  prev_from_cur.linear() = Eigen::AngleAxisd(0.035, Eigen::Vector3d(1, 2, 0.5).normalized()).matrix();
  prev_from_cur.translation() = Eigen::Vector3d(0.03, -0.02, 0.09);
  int64_t draws = 0;
  const auto uniform = [&] { return testing::hashed(++draws, 0, 7); };
  const auto seen = [&](const Eigen::Vector3d& point) {
    Eigen::Vector3d image = camera.project(point);
    // The sum of three uniform numbers is nearly normal, of variance 1/4.
    for (int i = 0; i < 3; ++i) image[i] += 2 * noise * (uniform() + uniform() + uniform() - 1.5);
    return camera.point(image.x(), image.y(), image.z());
  };
  std::vector<PointPair> pairs;
  for (int i = 0; i < 150; ++i) {
    const double depth = 2 + 6 * uniform();
    const Eigen::Vector3d cur(depth * (uniform() - 0.5), depth * (uniform() - 0.5), depth);
    pairs.emplace_back(seen(prev_from_cur * cur), seen(cur));
  }
  return pairs;
}

Pose first_guess(const std::vector<PointPair>& pairs) {
  std::vector<Eigen::Vector3d> prev, cur;
  for (const PointPair& pair : pairs) {
    prev.push_back(pair.prev);
    cur.push_back(pair.cur);
  }
  return *spherical_motion(prev, cur, std::vector<double>(pairs.size(), 1.0));
}

void register_minimisers(ErrorModel model, const char* name) {
  constexpr double kPixelError = 0.1, kHuber = 3;
  static const RectifiedCamera camera{436, 366, 252, 0.11, 0, 752, 480};
  static const std::vector<PointPair> pairs = noisy_pairs(camera, kPixelError);
  static const Pose guess = first_guess(pairs);
  static const auto ours = [](ErrorModel m) {
    return minimise_motion(camera, pairs, m, kPixelError, kHuber, guess).prev_from_cur;
  };
  compare("motion", name, "150 points",
          {{"IRIS", [=](State& state) { measure(state, 1, [&] { DoNotOptimize(ours(model)); }); }},
           {"Ceres", [=](State& state) {
              Pose result;
              measure(state, 1,
                      [&] { result = minimise_with_ceres(camera, pairs, model, kPixelError, kHuber, guess); });
              const Pose difference = result.inverse() * ours(model);
              if (difference.translation().norm() > 1e-4 || rotation_angle(difference) > 1e-4) {
                state.SkipWithError("Ceres found another motion");
              }
            }}});
}

}  // namespace

void register_motion() {
  const std::string input = hand_held().name;
  compare("motion", "corners and their surroundings", input,
          {{"IRIS", our_features}, {"OpenCV goodFeaturesToTrack", shi_tomasi}, {"OpenCV ORB", orb}});
  compare("motion", "motion of a pair, corners known", input,
          {{"IRIS", [](State& state) { our_motion(state, false); }}, {"LK, PnP RANSAC (OpenCV)", peer_motion}});
  compare("motion", "motion of a pair, with corners", input,
          {{"IRIS", [](State& state) { our_motion(state, true); }}, {"LK, PnP RANSAC (OpenCV)", peer_motion}});
  register_stage(hand_held, input);
  if (street()) register_stage([]() -> const Sequence& { return *street(); }, street()->name);
  register_minimisers(ErrorModel::ellipsoid, "minimisation, ellipsoids");
  register_minimisers(ErrorModel::image, "minimisation, image errors");
}

}  // namespace iris::bench
