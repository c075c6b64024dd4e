// A camera that is carried through the simulated seminar room and turns fully about its optical axis, at low and high
// frame rates: no motion fails, and errors are as large as stated. At larger images: docs/thesis.md, chapter 5.
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "iris/core/parallel.h"
#include "iris/motion/scs.h"
#include "iris/simulate/simulator.h"
#include "iris/stereo/mwmf.h"

namespace iris::motion {
namespace {

struct Room {
  RectifiedCamera camera;
  std::vector<ViewFeatures> views;
  std::vector<Pose> truth;
};

Room room_at(double rate, int frames) {
  simulate::SimulateOptions options;
  options.path = "roam";
  options.rate = rate;
  options.frames = frames;
  options.speed = 0.2;  // and turns of 10 degrees a second: what the thesis's sequence did (5.4.1)
  options.width = 240;
  options.height = 180;
  options.fov = 60;
  options.baseline = 0.144;
  options.lens = "ideal";
  static const simulate::Scene scene = simulate::make_scene("seminar-room", 1);
  const simulate::Simulator simulator(scene, simulate::make_path(scene, options), options);
  stereo::MwmfOptions stereo;
  stereo.disparities = 48;
  stereo.interpolation = "off";
  Room room{.camera = simulator.rectified_camera(), .views = {}, .truth = {}};
  room.views.resize(static_cast<size_t>(frames));
  for (int i = 0; i < frames; ++i) room.truth.push_back(simulator.world_from_left(i));
  parallel_chunks(0, frames, 1, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      const StereoFrame frame = simulator.frame(i);
      const cv::Mat1b left = frame.left, right = frame.right;
      room.views[static_cast<size_t>(i)] =
          extract_features(left, stereo::mwmf(left, right, stereo), room.camera, {}, right);
    }
  });
  return room;
}

class SimulatedRoom : public ::testing::TestWithParam<double> {};

TEST_P(SimulatedRoom, NoMotionFailsAndErrorsAreAsLargeAsStated) {
  const int frames = GetParam() < 2 ? 60 : 50;
  const Room room = room_at(GetParam(), frames);
  double nees = 0, turned = 0;
  for (size_t i = 0; i + 1 < room.views.size(); ++i) {
    const MotionEstimate estimate = estimate_motion(room.views[i], room.views[i + 1], room.camera, {});
    ASSERT_EQ(estimate.status, MotionStatus::ok) << i;
    const Pose truth = room.truth[i].inverse() * room.truth[i + 1];
    const Eigen::AngleAxisd turn(Eigen::Matrix3d(estimate.prev_from_cur.linear() * truth.linear().transpose()));
    Vector6d error;
    error << estimate.prev_from_cur.translation() - truth.translation(), turn.angle() * turn.axis();
    nees += error.dot(estimate.covariance.llt().solve(error)) / (frames - 1);
    turned += rotation_angle(truth) * 180 / M_PI;
  }
  RecordProperty("nees", std::to_string(nees));
  EXPECT_GT(turned, GetParam() < 2 ? 360 : 10);
  // Mean and variance of one are 6 and 12 if the covariance is right: 95 % of the means lie in this band.
  const double band = 1.96 * std::sqrt(12.0 / (frames - 1));
  EXPECT_NEAR(nees, 6, band);
}

INSTANTIATE_TEST_SUITE_P(FramesPerSecond, SimulatedRoom, ::testing::Values(1.5, 3.0, 8.0, 25.0),
                         [](const auto& info) { return std::to_string(static_cast<int>(info.param)); });

}  // namespace
}  // namespace iris::motion
