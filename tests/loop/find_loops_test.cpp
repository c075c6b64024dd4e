#include "iris/loop/find_loops.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <random>

#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/loop/pose_graph.h"
#include "iris/motion/minimise.h"
#include "iris/rectify/rectifier.h"
#include "iris/simulate/simulator.h"
#include "support/box_room.h"

namespace iris::loop {
namespace {

using simulate::SimulatedPath;
using simulate::SimulateOptions;

// A rendered walk: true disparities where a camera could measure them, noisy odometry.
struct Session {
  RectifiedCamera camera;
  std::vector<StereoView> views;
  std::vector<Pose> truth;  // world from rectified left camera
  PoseGraph graph;
  std::vector<int> frames;

  Session(const simulate::Scene& scene, const SimulatedPath& path, int count, const std::vector<int>& breaks = {}) {
    SimulateOptions options;
    options.width = 320;
    options.height = 240;
    options.rays = 1;
    options.frames = count;
    options.lens = "ideal";
    options.exposure = 0;
    const simulate::Simulator simulator(scene, path, options);
    const rectify::Rectifier rectifier(simulator.calibration());
    camera = simulator.rectified_camera();
    views.resize(static_cast<size_t>(simulator.frames()));
    parallel_chunks(0, simulator.frames(), 1, [&](int k, int) {
      const simulate::FrameTruth seen = simulator.truth(k);
      StereoView& view = views[static_cast<size_t>(k)];
      view.frame_idx = k;
      view.camera = camera;
      view.image = rectifier.rectify(simulator.frame(k)).left;
      view.disparity.disparity = seen.disparity.clone();
      view.disparity.disparity.setTo(0, seen.occluded | seen.discontinuity | (seen.textured == 0));
      view.disparity.origin = (view.disparity.disparity > 0) / 255;
      cv::RNG noise(static_cast<uint64_t>(k) + 1);
      cv::Mat1f error(view.image.size());
      noise.fill(error, cv::RNG::NORMAL, 0, 0.1);
      cv::add(view.disparity.disparity, error, view.disparity.disparity, view.disparity.origin);
    });
    std::mt19937 random(1);
    std::normal_distribution<double> normal(0, 1);
    Vector6d sigma;
    sigma << 0.002, 0.002, 0.002, 0.0005, 0.0005, 0.0005;
    int submap = 0;
    for (int k = 0; k < simulator.frames(); ++k) {
      Pose pose = simulator.world_from_left(k);
      pose.linear() = pose.linear() * rectifier.rect_from_left().transpose();
      truth.push_back(pose);
      frames.push_back(k);
      const bool begins = k == 0 || std::count(breaks.begin(), breaks.end(), k) > 0;
      submap += begins && k > 0;
      graph.nodes.push_back({.frame_idx = k, .submap = submap});
      if (begins) continue;
      Vector6d noise;
      for (double& v : noise) v = normal(random);
      const Pose step = motion::perturbed(truth[k - 1].inverse() * truth[k], sigma.cwiseProduct(noise));
      graph.nodes.back().world_from_cam = graph.nodes[k - 1].world_from_cam * step;
      graph.edges.push_back({.i = k - 1,
                             .j = k,
                             .i_from_j = step,
                             .information = sigma.cwiseAbs2().cwiseInverse().asDiagonal().toDenseMatrix()});
    }
  }

  std::vector<LoopEdge> loops(const LoopOptions& options) const {
    return find_loops(graph, frames, [&](int k) { return views[static_cast<size_t>(k)]; }, camera, options, {});
  }

  // Errors [m], [rad] of an edge.
  std::pair<double, double> errors_of(const LoopEdge& edge) const {
    const Pose true_motion = truth[edge.i].inverse() * truth[edge.j];
    return {(edge.i_from_j.translation() - true_motion.translation()).norm(),
            rotation_angle(edge.i_from_j.inverse() * true_motion)};
  }
};

int accepted(const std::vector<LoopEdge>& edges) {
  return static_cast<int>(
      std::count_if(edges.begin(), edges.end(), [](const LoopEdge& e) { return e.verdict == LoopVerdict::accepted; }));
}

// Twice around a circle in the seminar room, looking outwards; 22 views a lap.
const Session& two_rounds() {
  static const Session session = [] {
    const simulate::Scene scene = simulate::make_scene("seminar-room", 1);
    SimulatedPath path{.name = "two rounds", .seconds = 8.8, .length = 8.2, .world_from_cam = nullptr};
    const Eigen::Vector3d centre = scene.places.circle_centre;
    path.world_from_cam = [centre](double t) {
      const double a = 2 * M_PI * t / 4.4;
      const double radius = t < 4.4 ? 0.6 : 0.7;
      return testing::level_camera(centre + Eigen::Vector3d(radius * std::cos(a), radius * std::sin(a), 0.02 * t), a);
    };
    return Session(scene, path, 44);
  }();
  return session;
}

const std::vector<LoopEdge>& loops_of_two_rounds() {
  static const std::vector<LoopEdge> edges = two_rounds().loops({});
  return edges;
}

TEST(FindLoops, FindsTheSecondRound) {
  const Session& session = two_rounds();
  const std::vector<LoopEdge>& edges = loops_of_two_rounds();
  ASSERT_GE(accepted(edges), 20);
  std::vector<char> closed(44, 0);
  std::vector<double> shifts, turns;
  std::vector<int> attempts(44, 0);
  for (const LoopEdge& e : edges) {
    EXPECT_LT(e.i, e.j);
    EXPECT_GE(e.j - e.i, LoopOptions().min_gap);
    if (e.rescued) ++attempts[e.i], ++attempts[e.j];
    if (e.verdict != LoopVerdict::accepted) continue;
    closed[e.i] = closed[e.j] = 1;
    const auto [shift, turn] = session.errors_of(e);
    shifts.push_back(shift);
    turns.push_back(turn);
    EXPECT_LT(shift, 0.1) << e.i << " " << e.j;
    EXPECT_LT(turn, 0.03) << e.i << " " << e.j;
    EXPECT_GE(e.used, LoopOptions().min_used);
  }
  EXPECT_GE(std::count(closed.begin(), closed.end(), 1), 33);
  EXPECT_LE(*std::max_element(attempts.begin(), attempts.end()), 1);  // SIFT is slow
  // At 240 rows and f = 190 px, 0.1 px of noise in the disparity are 1.4 cm of depth 3 m away.
  std::nth_element(shifts.begin(), shifts.begin() + shifts.size() / 2, shifts.end());
  std::nth_element(turns.begin(), turns.begin() + turns.size() / 2, turns.end());
  EXPECT_LT(shifts[shifts.size() / 2], 0.014);
  EXPECT_LT(turns[turns.size() / 2], 0.005);
}

// Root mean square error of the positions [m] after the accepted loops are closed.
double error_after(const Session& session, const std::vector<LoopEdge>& loops) {
  PoseGraph graph = session.graph;
  for (const LoopEdge& e : loops) {
    if (e.verdict != LoopVerdict::accepted) continue;
    graph.edges.push_back({e.i, e.j, e.i_from_j, e.covariance.inverse(), PoseEdgeKind::loop});
  }
  const RefinedGraph refined = refine(graph, {});
  double sum = 0;
  for (size_t k = 0; k < session.truth.size(); ++k) {
    const Pose known = session.truth[0].inverse() * session.truth[k];
    sum += (refined.graph.nodes[k].world_from_cam.translation() - known.translation()).squaredNorm();
  }
  return std::sqrt(sum / static_cast<double>(session.truth.size()));
}

// The whole stage: for every five true loops one that passed all tests of its two views, and is wrong. Each has the
// motion of a true one, as repeated texture brings.
TEST(FindLoops, OneWrongLoopInSixChangesLittle) {
  const Session& session = two_rounds();
  std::vector<LoopEdge> edges = loops_of_two_rounds();
  const double none = error_after(session, {}), clean = error_after(session, edges);
  EXPECT_LT(clean, none);
  std::vector<LoopEdge> good;
  for (const LoopEdge& e : edges) {
    if (e.verdict == LoopVerdict::accepted) good.push_back(e);
  }
  std::mt19937 random(1);
  const size_t first_wrong = edges.size();
  for (size_t n = 0; n < good.size() / 5; ++n) {
    LoopEdge wrong = good[random() % good.size()];
    wrong.i = static_cast<int>(random() % 22);
    wrong.j = wrong.i + 11 + static_cast<int>(random() % 8);  // a quarter to half of a round further
    edges.push_back(wrong);
  }
  ASSERT_GE(edges.size(), first_wrong + 4);
  judge_consistency(edges, Odometry(session.graph, {}), {});
  for (size_t k = first_wrong; k < edges.size(); ++k) EXPECT_NE(edges[k].verdict, LoopVerdict::accepted);
  EXPECT_LT(error_after(session, edges), 1.1 * clean);
  // And if that had let them pass: all of them as accepted.
  for (size_t k = first_wrong; k < edges.size(); ++k) edges[k].verdict = LoopVerdict::accepted;
  EXPECT_LT(error_after(session, edges), 1.1 * clean);
}

// Two sights of one place: every condition on its own decides.
TEST(Verify, NamesTheConditionThatFails) {
  const Session& session = two_rounds();
  const Candidate candidate{.i = 3, .j = 25, .score = 0.5};
  const motion::ScsOptions scs = loop_motion_options({}, {});
  const auto features = [&](int k) {
    const StereoView& view = session.views[static_cast<size_t>(k)];
    return motion::extract_features(view.image, view.disparity, session.camera, scs);
  };
  const motion::ViewFeatures i = features(3), j = features(25), elsewhere = features(14);
  const auto verdict = [&](const motion::ViewFeatures& other, const LoopOptions& options) {
    return verify(candidate, i, other, session.camera, scs, options).verdict;
  };
  const LoopOptions usual;
  EXPECT_EQ(verdict(j, usual), LoopVerdict::accepted);
  // The opposite way through the same room, with the same chairs: what the camera turned away from.
  EXPECT_NE(verdict(elsewhere, usual), LoopVerdict::accepted);
  LoopOptions options = usual;
  options.min_used = 1000;
  EXPECT_EQ(verdict(j, options), LoopVerdict::too_few_pairs);
  options = usual;
  options.min_spread = 1;
  EXPECT_EQ(verdict(j, options), LoopVerdict::poorly_spread);
  options = usual;
  options.max_chi_square = 1e-9;
  EXPECT_EQ(verdict(j, options), LoopVerdict::not_symmetric);
  options = usual;
  options.min_agreement = 1.01;
  EXPECT_EQ(verdict(j, options), LoopVerdict::contradicted);

  const LoopEdge edge = verify(candidate, i, j, session.camera, scs, usual);
  EXPECT_EQ(edge.motion, MotionStatus::ok);
  EXPECT_LT(session.errors_of(edge).first, 0.03);
  const MotionEstimate estimate = motion::estimate_motion(i, j, session.camera, scs);
  EXPECT_EQ(edge.i_from_j.matrix(), estimate.prev_from_cur.matrix());
  EXPECT_EQ(edge.used, estimate.used);
  EXPECT_TRUE(edge.covariance.isApprox(estimate.covariance * std::max(1.0, estimate.used / 200.0), 1e-12));

  const auto by_sift = [&](const motion::ViewFeatures& other) {
    return verify(candidate, motion::rescue_features(i, session.camera, scs),
                  motion::rescue_features(other, session.camera, scs), session.camera, scs, usual);
  };
  const LoopEdge rescued = by_sift(j);
  EXPECT_EQ(rescued.verdict, LoopVerdict::accepted);
  EXPECT_TRUE(rescued.rescued);
  EXPECT_LT(session.errors_of(rescued).first, 0.03);
  EXPECT_NE(by_sift(elsewhere).verdict, LoopVerdict::accepted);
}

TEST(FindLoops, JoinsTwoSubmapsByTheirLooks) {
  Session session = two_rounds();
  std::erase_if(session.graph.edges, [](const PoseEdge& e) { return e.j == 22; });
  const Pose first = session.graph.nodes[22].world_from_cam;
  for (size_t k = 22; k < 44; ++k) {
    session.graph.nodes[k].submap = 1;
    session.graph.nodes[k].world_from_cam = first.inverse() * session.graph.nodes[k].world_from_cam;
  }
  int across = 0;
  for (const LoopEdge& e : session.loops({})) {
    if (e.verdict != LoopVerdict::accepted) continue;
    across += e.i < 22 && e.j >= 22;
    EXPECT_LT(session.errors_of(e).first, 0.1) << e.i << " " << e.j;
  }
  EXPECT_GE(across, 10);
}

TEST(FindLoops, IsTheSameForAnyNumberOfThreadsAndAnyCache) {
  const Session& session = two_rounds();
  std::vector<LoopEdge> results[2];
  for (const int round : {0, 1}) {
    LoopOptions options;
    options.cache_mb = round == 0 ? 16 : 512;
    options.overlap_candidates = 2;
    with_threads(1 + 2 * round, [&] { results[round] = session.loops(options); });
  }
  ASSERT_EQ(results[0].size(), results[1].size());
  for (size_t k = 0; k < results[0].size(); ++k) {
    const LoopEdge &a = results[0][k], &b = results[1][k];
    EXPECT_TRUE(a.i == b.i && a.j == b.j && a.verdict == b.verdict && a.used == b.used);
    EXPECT_EQ(a.i_from_j.matrix(), b.i_from_j.matrix());
    EXPECT_EQ(a.covariance, b.covariance);
    EXPECT_EQ(a.score, b.score);
  }
}

TEST(FindLoops, ReportsProgressAndStops) {
  const Session& session = two_rounds();
  const auto view = [&](int k) { return session.views[static_cast<size_t>(k)]; };
  std::vector<int> done;
  LoopOptions few;
  few.overlap_candidates = 1;
  few.appearance_candidates = 0;
  find_loops(session.graph, session.frames, view, session.camera, few, {},
             {.progress = [&](int at, int) { done.push_back(at); }, .stopped = nullptr});
  EXPECT_GE(done.size(), 3u);
  EXPECT_THROW(find_loops(session.graph, session.frames, view, session.camera, few, {},
                          {.progress = nullptr, .stopped = [] { return true; }}),
               Interrupted);
  few.enabled = false;
  EXPECT_THAT(session.loops(few), ::testing::IsEmpty());
}

// A straight corridor whose walls, doors included, repeat every two metres: what a view shows is seen again, exactly,
// one door further on. Only its length tells.
simulate::Scene corridor_of_equal_doors() {
  constexpr double kPeriod = 2, kLength = 40, kHalf = 1.0, kHeight = 2.2, kPixel = 0.01;
  simulate::Scene scene;
  scene.name = "corridor";
  std::mt19937 random(5);
  // Speckles of several sizes, and a door with a frame and a handle.
  const auto texture = [&](bool door) {
    cv::Mat3b image(static_cast<int>(kHeight / kPixel), static_cast<int>(kPeriod / kPixel), cv::Vec3b(150, 160, 170));
    for (int k = 0; k < 400; ++k) {
      const int x = static_cast<int>(random() % image.cols), y = static_cast<int>(random() % image.rows);
      const int size = 2 + static_cast<int>(random() % 12), grey = 40 + static_cast<int>(random() % 200);
      cv::rectangle(image, {x, y, size, size + static_cast<int>(random() % 9)}, cv::Scalar(grey, grey, grey), -1);
    }
    if (door) {
      cv::rectangle(image, {60, 30, 90, 190}, cv::Scalar(60, 70, 90), 4);
      cv::circle(image, {75, 130}, 5, cv::Scalar(20, 20, 20), -1);
    }
    return image;
  };
  const auto add = [&](const Eigen::Vector3f& corner, const Eigen::Vector3f& along, const Eigen::Vector3f& up,
                       const cv::Mat3b& image) {
    TriangleMesh mesh;
    mesh.vertices = {corner, corner + along, corner + along + up, corner + up};
    mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
    const float repeats = along.norm() / static_cast<float>(kPeriod);
    mesh.texture_coordinates = {{0, 1}, {repeats, 1}, {repeats, 0}, {0, 0}};
    mesh.texture = image;
    scene.objects.push_back({.mesh = mesh, .world_from_object = nullptr});
  };
  const auto length = static_cast<float>(kLength), half = static_cast<float>(kHalf), high = static_cast<float>(kHeight);
  add({0, -half, 0}, {length, 0, 0}, {0, 0, high}, texture(true));
  add({0, half, 0}, {length, 0, 0}, {0, 0, high}, texture(true));
  add({0, -half, 0}, {length, 0, 0}, {0, 2 * half, 0}, texture(false));
  add({0, -half, high}, {length, 0, 0}, {0, 2 * half, 0}, texture(false));
  return scene;
}

SimulatedPath along_the_corridor(double metres) {
  SimulatedPath path{.name = "along", .seconds = metres, .length = metres, .world_from_cam = nullptr};
  path.world_from_cam = [](double t) {
    return testing::level_camera({2 + t, 0.1 * std::sin(1.3 * t), 1.3}, 0.9 + 0.1 * std::sin(t));
  };
  return path;
}

TEST(FindLoops, IsNotFooledByACorridorOfEqualDoors) {
  const Session session(corridor_of_equal_doors(), along_the_corridor(10), 40);
  LoopOptions options;
  options.min_gap = 5;
  int fooled = 0;
  for (const LoopEdge& e : session.loops(options)) {
    const double error = e.used > 0 ? session.errors_of(e).first : 0;
    fooled += error > 1;
    if (e.verdict == LoopVerdict::accepted) {
      EXPECT_LT(error, 0.05) << e.i << " " << e.j;
    }
  }
  // Two views alone cannot tell: what rejects these is odometry.
  EXPECT_GE(fooled, 5);
}

// The same without odometry between the two halves: nothing but the number of doors tells how they lie.
TEST(FindLoops, DoesNotJoinSubmapsThatFitInSeveralWays) {
  const Session session(corridor_of_equal_doors(), along_the_corridor(10), 40, {20});
  LoopOptions options;
  options.min_gap = 5;
  for (const LoopEdge& e : session.loops(options)) {
    if (e.i < 20 && e.j >= 20 && e.verdict == LoopVerdict::accepted) {
      EXPECT_LT(session.errors_of(e).first, 0.05) << e.i << " " << e.j;
    }
  }
}

}  // namespace
}  // namespace iris::loop
