// Real recordings from their images to their paths, against public ground truth.
#include <gtest/gtest.h>
#include <spdlog/spdlog.h>

#include <cmath>
#include <iostream>

#include "iris/core/atomic_file.h"
#include "iris/core/parallel.h"
#include "iris/evaluate/formats.h"
#include "iris/evaluate/trajectory.h"
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
  using workspace::Poses;
  return {workspace.pose_graph(Poses::odometry), summarise_frames(workspace, Poses::odometry), session->size()};
}

evaluate::Trajectory trajectory_of(const PoseGraph& graph) {
  evaluate::Trajectory trajectory;
  for (const PoseNode& node : graph.nodes) trajectory.push_back({node.stamp_ns, node.world_from_cam});
  return trajectory;
}

TEST(Recordings, EurocMachineHall) {
  IRIS_NEEDS_TEST_DATA("euroc_mh01");
  const Result result = reconstruct(test_data("euroc_mh01"));
  EXPECT_EQ(result.summary.posed, 160);
  EXPECT_EQ(result.summary.submaps, 1);

  // Rectification turns the camera about its centre: positions are those of the recorded left camera.
  const auto truth_path = test_data("euroc_mh01") / "truth_left_camera.tum";
  const evaluate::TrajectoryErrors errors = evaluate::evaluate_trajectory(
      trajectory_of(result.graph), evaluate::parse_tum(read_file(truth_path), truth_path), {});
  EXPECT_EQ(errors.pairs.size(), 160u);
  const double error = errors.absolute.translation.rmse;
  std::cout << "ATE " << error * 1000 << " mm\n";
  EXPECT_LE(error, 0.030);  // a plain feature odometry gets 6 mm, a stereo matcher with few valid pixels 36 mm
  EXPECT_LE(errors.absolute.rotation.rmse, 0.5 * M_PI / 180);
}

TEST(Recordings, KittiStreet) {
  IRIS_NEEDS_TEST_DATA("kitti_street");
  const Result result = reconstruct(test_data("kitti_street"));
  EXPECT_EQ(result.summary.posed, 51);
  EXPECT_EQ(result.summary.submaps, 1);
  ASSERT_EQ(result.graph.nodes.size(), 51u);
  const auto truth_path = test_data("kitti_street") / "poses.txt";
  const auto poses = evaluate::parse_kitti(read_file(truth_path), truth_path);
  evaluate::Trajectory truth;
  for (const PoseNode& node : result.graph.nodes) {
    truth.push_back({node.stamp_ns, poses.at(static_cast<size_t>(node.frame_idx)).value()});
  }
  const evaluate::TrajectoryErrors errors = evaluate::evaluate_trajectory(trajectory_of(result.graph), truth, {});
  const double end_point = errors.closing_translation / errors.true_path;
  std::cout << "end-point error " << errors.closing_translation << " m of " << errors.true_path
            << " m = " << 100 * end_point << " %\n";
  EXPECT_LE(end_point, 0.03);
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
