#include "iris/loop/bundle.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>

#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/evaluate/trajectory.h"
#include "iris/motion/minimise.h"
#include "iris/motion/scs.h"
#include "iris/reconstruct/error_models.h"
#include "iris/simulate/simulator.h"
#include "support/numeric.h"

namespace iris::loop {
namespace {

using iris::testing::numeric_jacobian;
using motion::perturbed;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

constexpr RectifiedCamera kCamera{.f = 420, .cx = 370, .cy = 230, .baseline = 0.11, .width = 752, .height = 480};

TEST(Observe, IsTheDifferenceOfImageCoordinates) {
  const Pose pose = perturbed(Pose::Identity(), (Vector6d() << 0.3, -0.1, 0.2, 0.1, -0.4, 0.2).finished());
  const Eigen::Vector3d in_cam(0.4, -0.3, 2.5), pixel = kCamera.project(in_cam);
  // Measured with a disparity that is 0.2 px too small by a camera whose focal length is 1 % longer than believed, and
  // whose right image is turned.
  const double slope = 0.001, y = 1.01 * (pixel.y() - kCamera.cy);
  const Eigen::Vector3d measured(1.01 * (pixel.x() - kCamera.cx) + kCamera.cx, y + kCamera.cy,
                                 1.01 * pixel.z() - 0.2 - slope * y);
  const Eigen::Vector3d seen =
      reconstruct::image_coordinates(kCamera, kCamera.point(measured.x(), measured.y(), measured.z()));
  const ObservationResidual exact = observe(kCamera, pose, pose * in_cam, {0.2, 0.01, slope}, seen);
  EXPECT_TRUE(exact.valid);
  EXPECT_LT(exact.residual.norm(), 1e-10);
  const ObservationResidual nominal = observe(kCamera, pose, pose * in_cam, Eigen::Vector3d::Zero(), seen);
  EXPECT_NEAR(nominal.residual.x(), -0.01 * (pixel.x() - kCamera.cx), 1e-10);
  EXPECT_NEAR(nominal.residual.y(), -0.01 * std::sqrt(2) * (pixel.y() - kCamera.cy), 1e-10);
  EXPECT_FALSE(observe(kCamera, pose, pose * Eigen::Vector3d(0, 0, -1), Eigen::Vector3d::Zero(), seen).valid);
}

TEST(Observe, JacobiansAreThoseOfCentralDifferences) {
  const Pose pose = perturbed(Pose::Identity(), (Vector6d() << 0.3, -0.1, 0.2, 0.1, -0.4, 0.2).finished());
  const Eigen::Vector3d point = pose * Eigen::Vector3d(0.4, -0.3, 2.5), calibration(0.1, 0.02, 0.003);
  const Eigen::Vector3d seen(30, 50, 10);
  const ObservationResidual at = observe(kCamera, pose, point, calibration, seen);
  const auto by_point = [&](const Eigen::VectorXd& x) -> Eigen::VectorXd {
    return observe(kCamera, pose, x, calibration, seen).residual;
  };
  const auto by_pose = [&](const Eigen::VectorXd& x) -> Eigen::VectorXd {
    return observe(kCamera, perturbed(pose, x), point, calibration, seen).residual;
  };
  const auto by_calibration = [&](const Eigen::VectorXd& x) -> Eigen::VectorXd {
    return observe(kCamera, pose, point, x, seen).residual;
  };
  EXPECT_LT((at.by_point - numeric_jacobian(by_point, point, 1e-5)).norm(), 1e-5);
  EXPECT_LT((at.by_pose - numeric_jacobian(by_pose, Vector6d::Zero(), 1e-5)).norm(), 1e-5);
  EXPECT_LT((at.by_calibration - numeric_jacobian(by_calibration, calibration, 1e-5)).norm(), 1e-6);
}

// A simulated walk along a corridor, with the true disparities. Rendered once for all tests.
struct Recording {
  RectifiedCamera camera;
  std::vector<StereoView> frames;
  std::vector<Pose> truth;
};

const Recording& recording() {
  static const Recording made = [] {
    simulate::SimulateOptions options;
    options.path = "corridor";
    options.frames = 24;
    options.rate = 5;
    options.rays = 1;
    options.lens = "ideal";
    options.exposure = 0;
    const simulate::Scene scene = simulate::make_scene("apartment", 1);
    const simulate::Simulator simulator(scene, simulate::make_path(scene, options), options);
    Recording result{.camera = simulator.rectified_camera()};
    result.frames.resize(static_cast<size_t>(options.frames));
    for (int n = 0; n < options.frames; ++n) result.truth.push_back(simulator.world_from_left(n));
    parallel_chunks(0, options.frames, 1, [&](int begin, int end) {
      for (int n = begin; n < end; ++n) {
        const simulate::FrameTruth known = simulator.truth(n);
        StereoView& view = result.frames[n];
        view = {.frame_idx = n,
                .stamp_ns = simulator.stamp_ns(n),
                .camera = result.camera,
                .image = simulator.frame(n).left};
        view.disparity.disparity = known.disparity;
        view.disparity.origin = cv::Mat1b(known.disparity.size(), static_cast<uint8_t>(DisparityOrigin::measured));
        view.disparity.disparity.setTo(0, known.discontinuity | (known.disparity < 2));
        view.disparity.origin.setTo(0, view.disparity.disparity == 0);
      }
    });
    return result;
  }();
  return made;
}

// Its disparities have independent errors of 0.1 px, are `offset` too small and `slope` a row too large. Every second
// frame is stored; odometry comes from these very images.
struct Session {
  RectifiedCamera camera;
  std::vector<StereoView> frames;
  std::vector<Pose> truth;
  RefinedGraph refined;
  std::vector<int> views;

  explicit Session(double offset, int count = 24, double slope = 0)
      : camera(recording().camera), truth(recording().truth) {
    truth.resize(static_cast<size_t>(count));
    for (int n = 0; n < count; ++n) {
      StereoView view = recording().frames[n];
      view.disparity.disparity = view.disparity.disparity.clone();
      std::mt19937 random(static_cast<unsigned>(n));
      std::normal_distribution<float> error(static_cast<float>(-offset), 0.1f);
      for (int y = 0; y < view.disparity.disparity.rows; ++y) {
        const auto sloped = static_cast<float>(slope * (y - camera.cy));
        for (float& d : view.disparity.disparity.row(y)) d = d > 0 ? d + error(random) + sloped : 0;
      }
      frames.push_back(view);
    }
    const motion::ScsOptions scs;
    std::vector<motion::ViewFeatures> features(frames.size());
    parallel_chunks(0, count, 1, [&](int begin, int end) {
      for (int n = begin; n < end; ++n) {
        features[n] = motion::extract_features(frames[n].image, frames[n].disparity, camera, scs);
      }
    });
    PoseGraph graph;
    Pose pose = Pose::Identity();
    for (int n = 0; n < count; ++n) {
      if (n > 0) {
        const MotionEstimate motion = motion::estimate_motion(features[n - 1], features[n], camera, scs);
        EXPECT_EQ(motion.status, MotionStatus::ok) << n;
        pose = pose * motion.prev_from_cur;
        graph.edges.push_back({n - 1, n, motion.prev_from_cur, motion.covariance.inverse(), PoseEdgeKind::odometry});
      }
      graph.nodes.push_back({.frame_idx = n, .stamp_ns = frames[n].stamp_ns, .world_from_cam = pose});
      if (n % 2 == 0) views.push_back(n);
    }
    refined = refine(graph, {});
  }

  BundleResult bundle(const BundleOptions& options = {}, const std::function<bool()>& stopped = {}) const {
    return loop::bundle(
        refined, views, [&](int frame_idx) { return frames[frame_idx]; }, camera, options, {}, stopped);
  }

  evaluate::TrajectoryErrors errors(const std::vector<PoseNode>& nodes, int step = 1) const {
    evaluate::Trajectory estimate, known;
    for (size_t n = 0; n < nodes.size(); n += step) {
      estimate.push_back({nodes[n].stamp_ns, nodes[n].world_from_cam});
      known.push_back({nodes[n].stamp_ns, truth[n]});
    }
    return evaluate::evaluate_trajectory(estimate, known, {});
  }
};

TEST(Bundle, FindsAnOffsetOfTheDisparities) {
  const Session session(0.2);
  const double before = session.errors(session.refined.graph.nodes).scale_error;
  const BundleResult result = session.bundle();
  ASSERT_TRUE(result.ok) << result.problem;
  EXPECT_NEAR(result.calibration.disparity_offset.value, 0.2, 0.05) << result.calibration.words;
  EXPECT_TRUE(result.calibration.disparity_offset.applied);
  EXPECT_FALSE(result.calibration.focal.applied);
  EXPECT_THAT(result.calibration.words, HasSubstr("px, corrected"));
  EXPECT_EQ(result.camera.disparity_offset,
            session.camera.disparity_offset + result.calibration.disparity_offset.value);
  EXPECT_EQ(result.camera.f, session.camera.f);
  // The path had the wrong length, and has it no more.
  const evaluate::TrajectoryErrors errors = session.errors(result.nodes);
  EXPECT_GT(std::abs(before), 0.004);
  EXPECT_LT(std::abs(errors.scale_error), 0.002) << before;
  EXPECT_LT(errors.absolute.translation.rmse, 0.01);
  EXPECT_LT(result.rms_after, 0.2);

  // If it is said to be too large, it is told and left as it is; likewise if nothing shall be corrected.
  for (const BundleOptions& options : {BundleOptions{.max_offset = 0.12}, BundleOptions{.calibrate = false}}) {
    const BundleResult kept = session.bundle(options);
    EXPECT_TRUE(kept.calibration.disparity_offset.off);
    EXPECT_FALSE(kept.calibration.disparity_offset.applied);
    EXPECT_THAT(kept.calibration.words, HasSubstr("not corrected"));
    EXPECT_THAT(kept.calibration.words, HasSubstr("calibrate again"));
    EXPECT_EQ(kept.camera.disparity_offset, session.camera.disparity_offset);
  }
}

// 0.2 degrees about the optical axis: told in words with what it does, never corrected, and not taken for the others.
TEST(Bundle, TellsOfDisparitiesThatGrowDownwards) {
  const double slope = 0.0035;
  const Session session(0, 24, slope);
  const BundleResult result = session.bundle();
  ASSERT_TRUE(result.ok) << result.problem;
  const Estimated& found = result.calibration.slope;
  EXPECT_NEAR(found.value, -slope, 3 * found.sigma) << result.calibration.words;
  EXPECT_LT(found.sigma, 0.1 * slope);
  EXPECT_TRUE(found.off);
  EXPECT_FALSE(found.applied);
  EXPECT_FALSE(result.calibration.disparity_offset.applied) << result.calibration.words;
  EXPECT_FALSE(result.calibration.focal.applied) << result.calibration.words;
  EXPECT_THAT(result.calibration.words,
              AllOf(HasSubstr("at the image's lower border"), HasSubstr("0.20 deg about its optical axis"),
                    HasSubstr("iris rectify --check"), HasSubstr("calibrate again")));
}

TEST(Bundle, LeavesAGoodCalibrationAlone) {
  const Session session(0);
  const BundleResult result = session.bundle();
  ASSERT_TRUE(result.ok) << result.problem;
  EXPECT_LT(std::abs(result.calibration.disparity_offset.value), 0.06) << result.calibration.words;  // 3 sigma
  EXPECT_FALSE(result.calibration.disparity_offset.applied) << result.calibration.words;
  EXPECT_FALSE(result.calibration.focal.applied) << result.calibration.words;
  EXPECT_FALSE(result.calibration.slope.applied);
  EXPECT_THAT(result.calibration.words, Not(HasSubstr("corrected")));
  EXPECT_THAT(result.calibration.words, Not(HasSubstr("calibrate again")));
  EXPECT_EQ(result.camera.disparity_offset, session.camera.disparity_offset);
  // Poses are hardly worse than odometry's, which knows twice as many frames.
  EXPECT_LT(session.errors(result.nodes).absolute.translation.rmse,
            1.3 * session.errors(session.refined.graph.nodes).absolute.translation.rmse + 0.001);
  // The first view keeps its pose, and errors are as large as said: the mean of normalised squares is 1. Those of one
  // path go together.
  EXPECT_EQ(result.nodes[0].world_from_cam.matrix(), session.refined.graph.nodes[0].world_from_cam.matrix());
  EXPECT_EQ(result.covariance[0], Matrix6d::Zero());
  double sum = 0;
  for (size_t n = 1; n < session.truth.size(); ++n) {
    const Pose known = result.nodes[0].world_from_cam * session.truth[0].inverse() * session.truth[n];
    const Pose& pose = result.nodes[n].world_from_cam;
    const Eigen::AngleAxisd turn(known.linear() * pose.linear().transpose());
    Vector6d error;
    error << known.translation() - pose.translation(), turn.angle() * turn.axis();
    sum += error.dot(result.covariance[n].ldlt().solve(error)) / 6;
  }
  EXPECT_GT(sum / static_cast<double>(session.truth.size() - 1), 0.02);
  EXPECT_LT(sum / static_cast<double>(session.truth.size() - 1), 4.0);

  // The same for any number of threads.
  BundleResult one, many;
  with_threads(1, [&] { one = session.bundle({.window = 2, .points = 60}); });
  with_threads(5, [&] { many = session.bundle({.window = 2, .points = 60}); });
  EXPECT_EQ(one.calibration.words, many.calibration.words);
  for (size_t n = 0; n < one.nodes.size(); ++n) {
    EXPECT_EQ(one.nodes[n].world_from_cam.matrix(), many.nodes[n].world_from_cam.matrix());
    EXPECT_EQ(one.covariance[n], many.covariance[n]);
  }

  // Poses that were spoilt come back: odometry's certainty taken away, the images decide.
  Session spoilt = session;
  std::mt19937 random(1);
  std::normal_distribution<double> normal(0, 1);
  for (size_t n = 1; n < spoilt.truth.size(); ++n) {
    Vector6d step;
    for (int k = 0; k < 6; ++k) step(k) = 0.002 * normal(random);
    PoseNode& node = spoilt.refined.graph.nodes[n];
    node.world_from_cam = perturbed(node.world_from_cam, step);
  }
  for (PoseEdge& edge : spoilt.refined.graph.edges) edge.information *= 1e-6;
  EXPECT_LT(spoilt.errors(spoilt.bundle().nodes, 2).per_frame.translation.rmse,
            0.5 * spoilt.errors(spoilt.refined.graph.nodes, 2).per_frame.translation.rmse);

  // A loop beyond the window makes its end more certain; a rejected one does not count.
  Session looped = session;
  const Pose i_from_j = looped.truth[0].inverse() * looped.truth[6];
  looped.refined.graph.edges.push_back({0, 6, i_from_j, 1e6 * Matrix6d::Identity(), PoseEdgeKind::loop});
  looped.refined.edge_weight.push_back(1);
  const BundleOptions alone{.window = 1, .partners = 0};
  const BundleResult with = looped.bundle(alone);
  looped.refined.edge_weight.back() = 0;
  const BundleResult without = looped.bundle(alone);
  EXPECT_EQ(without.covariance[6], session.bundle(alone).covariance[6]);
  EXPECT_LT(with.covariance[6].determinant(), 0.5 * without.covariance[6].determinant());
  // So do views beyond the window that see the same, without any loop.
  const BundleResult partners = session.bundle({.window = 1, .partners = 2});
  EXPECT_LT(partners.covariance[6].determinant(), 0.5 * without.covariance[6].determinant());
}

TEST(Bundle, SaysWhenTooLittleIsShared) {
  Session session(0, 2);
  BundleResult result = session.bundle();  // a single stored view
  EXPECT_FALSE(result.ok);
  EXPECT_THAT(result.problem, HasSubstr("share only"));
  EXPECT_EQ(result.nodes.size(), 2u);
  session.views = {};
  EXPECT_FALSE(session.bundle().ok);
  // Two sub-maps share nothing.
  session.views = {0, 1};
  session.refined.graph.nodes[1].submap = 1;
  session.refined.graph.edges.clear();
  session.refined.edge_weight.clear();
  EXPECT_FALSE(session.bundle().ok);
}

TEST(Bundle, StopsWhenAsked) {
  const Session session(0, 12);
  const BundleOptions small{.window = 2, .points = 60};
  int all = 0, asked = 0;
  session.bundle(small, [&] { return ++all < 0; });
  EXPECT_GT(all, 5);
  for (const int last : {0, all - 1}) {  // before the first view is read, in the last iteration
    asked = 0;
    EXPECT_THROW(session.bundle(small, [&] { return ++asked > last; }), Interrupted);
    EXPECT_EQ(asked, last + 1);
  }
}

TEST(Bundle, OptionsAreDeclared) {
  BundleOptions options;
  OptionSet set;
  options.declare(set);
  set.set("loop.bundle_window", "7");
  EXPECT_EQ(options.window, 7);
  set.validate();
}

}  // namespace
}  // namespace iris::loop
