// Real recordings from their images to their paths, against public ground truth.
#include <gtest/gtest.h>
#include <spdlog/spdlog.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <fstream>
#include <iostream>

#include "iris/core/parallel.h"
#include "iris/pipeline/frames.h"
#include "support/temporary_folder.h"
#include "support/test_data.h"

namespace iris::pipeline {
namespace {

using iris::testing::TemporaryFolder;
using iris::testing::test_data;

struct Result {
  PoseGraph graph;
  FramesSummary summary;
  int frames = 0;
};

// Everything at its defaults.
Result reconstruct(const std::filesystem::path& recording) {
  spdlog::set_level(spdlog::level::warn);
  const TemporaryFolder folder;
  const Options defaults;
  Options options;
  OptionSet set;
  options.declare(set);
  const auto session = session::open_session(recording, defaults.session);
  auto workspace = workspace::Workspace::create(folder.path() / "out", "s", "f");
  with_threads(available_threads(), [&] { run_stages({frames_stage(*session, defaults)}, set, workspace, {}); });
  return {workspace.pose_graph(world_from_submap()), summarise_frames(workspace), session->size()};
}

// Root mean square distance of the positions after the best rigid alignment [m].
double absolute_trajectory_error(const Eigen::Matrix3Xd& estimate, const Eigen::Matrix3Xd& truth) {
  const Eigen::Matrix4d truth_from_estimate = Eigen::umeyama(estimate, truth, false);
  const Eigen::Matrix3Xd aligned =
      (truth_from_estimate.topLeftCorner<3, 3>() * estimate).colwise() + truth_from_estimate.topRightCorner<3, 1>();
  return std::sqrt((aligned - truth).colwise().squaredNorm().mean());
}

TEST(Recordings, EurocMachineHall) {
  IRIS_NEEDS_TEST_DATA("euroc_mh01");
  const Result result = reconstruct(test_data("euroc_mh01"));
  EXPECT_EQ(result.summary.posed, 160);
  EXPECT_EQ(result.summary.submaps, 1);

  // Truth at 200 Hz, interpolated at the time of each frame. Rectification turns the camera about its centre: positions
  // are those of the recorded left camera.
  std::vector<std::pair<double, Eigen::Vector3d>> truth;
  std::ifstream file(test_data("euroc_mh01") / "truth_left_camera.tum");
  for (std::string line; std::getline(file, line);) {
    std::istringstream numbers(line);
    double t, x, y, z;
    if (numbers >> t >> x >> y >> z) truth.emplace_back(t, Eigen::Vector3d(x, y, z));
  }
  ASSERT_GT(truth.size(), 100u);
  Eigen::Matrix3Xd estimate(3, result.graph.nodes.size()), expected(3, result.graph.nodes.size());
  for (size_t i = 0; i < result.graph.nodes.size(); ++i) {
    const PoseNode& node = result.graph.nodes[i];
    const double t = static_cast<double>(node.stamp_ns) * 1e-9;
    const auto after = std::lower_bound(truth.begin() + 1, truth.end() - 1, t,
                                        [](const auto& entry, double time) { return entry.first < time; });
    const auto before = after - 1;
    const double part = (t - before->first) / (after->first - before->first);
    estimate.col(i) = node.world_from_cam.translation();
    expected.col(i) = before->second + part * (after->second - before->second);
  }
  const double error = absolute_trajectory_error(estimate, expected);
  std::cout << "ATE " << error * 1000 << " mm\n";
  EXPECT_LE(error, 0.030);  // a plain feature odometry gets 6 mm, a stereo matcher with few valid pixels 36 mm
}

TEST(Recordings, KittiStreet) {
  IRIS_NEEDS_TEST_DATA("kitti_street");
  const Result result = reconstruct(test_data("kitti_street"));
  EXPECT_EQ(result.summary.posed, 51);
  EXPECT_EQ(result.summary.submaps, 1);
  ASSERT_EQ(result.graph.nodes.size(), 51u);
  std::ifstream file(test_data("kitti_street") / "poses.txt");
  Eigen::Vector3d truth_end;
  double number;
  for (int i = 0; file >> number; ++i) {
    if (i % 12 % 4 == 3) truth_end(i % 12 / 4) = number;  // the last line stays
  }
  const Pose first_from_last =
      result.graph.nodes.front().world_from_cam.inverse() * result.graph.nodes.back().world_from_cam;
  const double error = (first_from_last.translation() - truth_end).norm();
  std::cout << "end-point error " << error << " m of " << truth_end.norm() << " m = " << 100 * error / truth_end.norm()
            << " %\n";
  EXPECT_LE(error, 0.03 * truth_end.norm());
}

TEST(Recordings, RoverInASandbox) {
  IRIS_NEEDS_TEST_DATA("rover_sandbox_b");
  const Result result = reconstruct(test_data("rover_sandbox_b"));
  EXPECT_EQ(result.frames, 325);
  EXPECT_EQ(result.summary.frames, 325);  // each has a pose or a reason
  EXPECT_EQ(result.summary.posed + result.summary.unreadable, 325);
  std::cout << result.summary.submaps << " sub-maps\n";
}

}  // namespace
}  // namespace iris::pipeline
