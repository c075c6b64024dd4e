#include "iris/workspace/workspace.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>
#include <fstream>
#include <opencv2/core.hpp>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/workspace/view_files.h"
#include "support/temporary_folder.h"

namespace iris::workspace {
namespace {

using iris::testing::TemporaryFolder;

StereoView test_view(int frame_idx, bool colour) {
  StereoView view;
  view.frame_idx = frame_idx;
  view.camera = {
      .f = 100.25, .cx = 15.5, .cy = 9.75, .baseline = 0.11, .disparity_offset = 0.5, .width = 32, .height = 20};
  view.image = cv::Mat(20, 32, colour ? CV_8UC3 : CV_8UC1);
  cv::RNG random(frame_idx + 7);
  random.fill(view.image, cv::RNG::UNIFORM, 0, 256);
  view.disparity.disparity = cv::Mat1f(20, 32);
  random.fill(view.disparity.disparity, cv::RNG::UNIFORM, 1.0, 90.0);
  view.disparity.disparity(3, 4) = 0;
  view.disparity.disparity(5, 6) = 0.001f;  // less than one unit of the file, yet valid
  view.disparity.origin = cv::Mat1b(20, 32, uint8_t(DisparityOrigin::measured));
  view.disparity.origin(3, 4) = 0;
  view.disparity.origin(8, 8) = uint8_t(DisparityOrigin::between_segments);
  return view;
}

FrameRecord posed(int frame_idx, int submap) {
  FrameRecord record{.frame_idx = frame_idx, .stamp_ns = 1403636584763555584 + frame_idx};
  record.submap = submap;
  record.submap_from_cam.linear() =
      Eigen::AngleAxisd(0.1 * frame_idx + 0.05, Eigen::Vector3d(1, 2, 3).normalized()).matrix();
  record.submap_from_cam.translation() = Eigen::Vector3d(0.1, 1.0 / 3, -0.7) * frame_idx;
  if (frame_idx > 0) {
    record.reference_frame = frame_idx - 1;
    record.motion.status = MotionStatus::ok;
    record.motion.prev_from_cur = record.submap_from_cam.inverse();
    record.motion.covariance = Matrix6d::Identity() * 1e-5;
    record.motion.covariance(0, 5) = 1.0 / 7e7;
    record.motion.used = 42;
    record.motion.rms_px = 0.123456789;
  }
  return record;
}

TEST(ViewFiles, RoundTripKeepsValidityAndDisparityToHalfAUnit) {
  const TemporaryFolder folder;
  for (const bool colour : {false, true}) {
    const StereoView view = test_view(12, colour);
    write_view(folder.path(), view, 256);
    StereoView read;
    read.frame_idx = 12;
    read_view(folder.path(), 256, read);
    EXPECT_EQ(cv::norm(read.image, view.image, cv::NORM_INF), 0);
    EXPECT_EQ(cv::norm(read.disparity.origin, view.disparity.origin, cv::NORM_INF), 0);
    // Half a unit of 1/256 px, or up to one where a tiny disparity is kept valid.
    EXPECT_LE(cv::norm(read.disparity.disparity, view.disparity.disparity, cv::NORM_INF), 1.0 / 256);
    EXPECT_EQ(read.disparity.disparity(3, 4), 0);
    EXPECT_GT(read.disparity.disparity(5, 6), 0);
  }
}

TEST(ViewFiles, LargeDisparitiesFitByACoarserScale) {
  EXPECT_EQ(disparity_scale(130), 256);
  EXPECT_EQ(disparity_scale(255.9), 256);
  EXPECT_EQ(disparity_scale(256), 128);
  const TemporaryFolder folder;
  StereoView view = test_view(0, false);
  view.disparity.disparity(1, 1) = 500.25f;
  write_view(folder.path(), view, disparity_scale(500.25));
  StereoView read;
  read_view(folder.path(), 128, read);
  EXPECT_EQ(read.disparity.disparity(1, 1), 500.25f);
}

TEST(ViewFiles, DamageIsNamed) {
  const TemporaryFolder folder;
  write_view(folder.path(), test_view(3, false), 256);
  std::filesystem::resize_file(folder.path() / "000003.disparity.png", 20);
  StereoView read;
  read.frame_idx = 3;
  try {
    read_view(folder.path(), 256, read);
    FAIL() << "a truncated file was read";
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), ::testing::HasSubstr("000003.disparity.png"));
  }
}

TEST(Workspace, GivesBackEveryRecordBitForBitAfterReopening) {
  const TemporaryFolder folder;
  {
    Workspace workspace = Workspace::create(folder.path() / "out", "/recordings/a", "aaaa");
    for (int i = 0; i < 5; ++i) {
      const StereoView view = test_view(i, true);
      FrameRecord record = posed(i, i < 3 ? 0 : 1);
      record.too_near = i == 3;
      workspace.add_frame(record, i % 2 == 0 ? &view : nullptr);
    }
    workspace.add_frame(
        {.frame_idx = 5, .stamp_ns = 9, .state = FrameState::unreadable, .message = "left.png: truncated"}, nullptr);
  }
  const Workspace workspace = Workspace::open(folder.path() / "out");
  EXPECT_EQ(workspace.session_folder(), "/recordings/a");
  EXPECT_EQ(workspace.frame_count(), 6);
  EXPECT_EQ(workspace.view_count(), 3);
  EXPECT_EQ(workspace.last_view_frame(), 4);
  EXPECT_FALSE(workspace.frame(6).has_value());
  EXPECT_EQ(workspace.frame(5)->state, FrameState::unreadable);
  EXPECT_EQ(workspace.frame(5)->message, "left.png: truncated");
  EXPECT_TRUE(workspace.frame(3)->too_near);
  EXPECT_FALSE(workspace.frame(2)->too_near);
  const FrameRecord expected = posed(4, 1), record = *workspace.frame(4);
  EXPECT_EQ(record.stamp_ns, expected.stamp_ns);
  EXPECT_EQ(record.submap, 1);
  EXPECT_TRUE(record.submap_from_cam.affine() == expected.submap_from_cam.affine());
  EXPECT_TRUE(record.motion.covariance == expected.motion.covariance);
  EXPECT_TRUE(record.motion.prev_from_cur.affine() == expected.motion.prev_from_cur.affine());
  EXPECT_EQ(record.motion.rms_px, expected.motion.rms_px);
  const auto last = workspace.last_posed_frames(2);
  ASSERT_EQ(last.size(), 2u);
  EXPECT_EQ(last[0].frame_idx, 3);
  EXPECT_EQ(last[1].frame_idx, 4);
}

TEST(Workspace, PoseGraphAndViewsAreThoseThatAreAskedFor) {
  const TemporaryFolder folder;
  Workspace workspace = Workspace::create(folder.path() / "out", "s", "f");
  for (int i = 0; i < 4; ++i) {
    const StereoView view = test_view(i, false);
    workspace.add_frame(posed(i, i / 2), &view);
  }
  const PoseGraph graph = workspace.pose_graph(Poses::odometry);
  ASSERT_EQ(graph.nodes.size(), 4u);
  ASSERT_EQ(graph.edges.size(), 3u);
  EXPECT_TRUE(graph.nodes[2].world_from_cam.affine() == posed(2, 1).submap_from_cam.affine());
  EXPECT_TRUE(graph.nodes[2].covariance.isZero());
  EXPECT_LT((graph.edges[0].information * posed(1, 0).motion.covariance - Matrix6d::Identity()).norm(), 1e-9);
  EXPECT_TRUE(workspace.pose_graph(Poses::refined).nodes.empty());
  EXPECT_TRUE(workspace.loops().empty());

  // Refined: turned upright, and frame 2 has come to the first sub-map by a loop; another pair was rejected.
  const Pose world = z_up_from_camera();
  RefinedPath refined{.nodes = graph.nodes, .loops = {}};
  for (PoseNode& node : refined.nodes) {
    node.world_from_cam = world * node.world_from_cam;
    node.covariance = (1 + node.frame_idx) * Matrix6d::Identity();
  }
  refined.nodes[2].submap = 0;
  LoopRecord accepted{.edge = {.i = 0, .j = 2, .i_from_j = world, .used = 50}, .error = 1.5};
  accepted.edge.covariance = 0.25 * Matrix6d::Identity();
  accepted.edge.verdict = loop::LoopVerdict::accepted;
  refined.loops = {accepted, {.edge = {.i = 1, .j = 3, .score = 0.3, .verdict = loop::LoopVerdict::no_motion}}};
  refined.worlds = {{.submap = 0, .floor_found = true, .alignment = "floor"},
                    {.submap = 1, .alignment = "first camera", .up_guessed = true}};
  refined.calibration = {.text = "disparity offset", .is_wrong = true};
  workspace.set_refined(refined);
  EXPECT_EQ(workspace.calibration().text, "disparity offset");
  EXPECT_TRUE(workspace.calibration().is_wrong);
  ASSERT_EQ(workspace.worlds().size(), 2u);
  EXPECT_TRUE(workspace.worlds()[0].floor_found);
  EXPECT_EQ(workspace.worlds()[0].guess_text(), "");
  EXPECT_NE(workspace.worlds()[1].guess_text().find("first camera"), std::string::npos);
  const PoseGraph path = workspace.pose_graph(Poses::refined);
  ASSERT_EQ(path.nodes.size(), 4u);
  EXPECT_TRUE(path.nodes[3].world_from_cam.affine() == refined.nodes[3].world_from_cam.affine());
  EXPECT_TRUE(path.nodes[3].covariance == refined.nodes[3].covariance);
  EXPECT_EQ(path.nodes[2].submap, 0);
  ASSERT_EQ(path.edges.size(), 4u);
  EXPECT_EQ(path.edges[3].kind, PoseEdgeKind::loop);
  EXPECT_EQ(path.edges[3].i, 0);
  EXPECT_EQ(path.edges[3].j, 2);
  EXPECT_TRUE(path.edges[3].i_from_j.affine() == world.affine());
  EXPECT_LT((path.edges[3].information - 4 * Matrix6d::Identity()).norm(), 1e-12);
  const std::vector<LoopRecord> loops = workspace.loops();
  ASSERT_EQ(loops.size(), 2u);
  EXPECT_EQ(loops[0].edge.used, 50);
  EXPECT_EQ(loops[0].error, 1.5);
  EXPECT_EQ(loops[1].edge.verdict, loop::LoopVerdict::no_motion);
  EXPECT_EQ(loops[1].edge.score, 0.3);

  const auto all = workspace.views(Poses::refined, -1, 1);
  const auto second = workspace.views(Poses::odometry, 1, 1);
  const auto first = workspace.views(Poses::refined, 0, 1);
  ASSERT_EQ(first->summaries().size(), 3u);
  EXPECT_TRUE(first->load(2)->world_from_cam.affine() == refined.nodes[2].world_from_cam.affine());
  EXPECT_EQ(all->summaries().size(), 4u);
  ASSERT_EQ(second->summaries().size(), 2u);
  const auto view = second->load(1);
  EXPECT_EQ(view->frame_idx, 3);
  EXPECT_EQ(view->camera.f, 100.25);
  EXPECT_EQ(cv::norm(view->image, test_view(3, false).image, cv::NORM_INF), 0);
  EXPECT_TRUE(view->world_from_cam.affine() == posed(3, 1).submap_from_cam.affine());
  EXPECT_NEAR(second->summaries()[1].max_disparity, 90, 0.5);
}

TEST(Workspace, TheCacheHoldsTheMostRecentViewsOnly) {
  const TemporaryFolder folder;
  Workspace workspace = Workspace::create(folder.path() / "out", "s", "f");
  for (int i = 0; i < 3; ++i) {
    const StereoView view = test_view(i, false);
    workspace.add_frame(posed(i, 0), &view);
  }
  const size_t one_view = 32 * 20 * 6;
  const auto store = workspace.views(Poses::odometry, 0, 2 * one_view);
  const std::weak_ptr<const StereoView> first = store->load(0);
  EXPECT_FALSE(first.expired());
  store->load(1);
  EXPECT_FALSE(first.expired());
  EXPECT_EQ(store->load(0).get(), first.lock().get());
  store->load(1);
  store->load(2);
  EXPECT_TRUE(first.expired());
}

TEST(Workspace, StagesAreFinishedByFingerprintAndOutputs) {
  const TemporaryFolder folder;
  Workspace workspace = Workspace::create(folder.path() / "out", "s", "f");
  EXPECT_FALSE(workspace.finished("map", "1"));
  write_file(folder.path() / "out/map/map.png", "x");
  workspace.finish("map", {.fingerprint = "1", .outputs = {"map/map.png"}});
  EXPECT_TRUE(workspace.finished("map", "1"));
  EXPECT_FALSE(workspace.finished("map", "2"));
  EXPECT_EQ(workspace.stage("map")->outputs, std::vector<std::string>{"map/map.png"});
  write_file(folder.path() / "out/map/map.png", "");
  EXPECT_FALSE(workspace.finished("map", "1"));
  write_file(folder.path() / "out/map/map.png", "y");
  EXPECT_TRUE(workspace.finished("map", "1"));
  std::filesystem::remove(folder.path() / "out/map/map.png");
  EXPECT_FALSE(workspace.finished("map", "1"));
  write_file(folder.path() / "out/map/map.png", "x");
  workspace.forget("map");
  EXPECT_FALSE(workspace.finished("map", "1"));
}

TEST(Workspace, ClearingFramesKeepsNothingOfThem) {
  const TemporaryFolder folder;
  Workspace workspace = Workspace::create(folder.path() / "out", "s", "f");
  const StereoView view = test_view(0, false);
  workspace.add_frame(posed(0, 0), &view);
  workspace.set_value("stereo.disparities", "64");
  workspace.clear_frames();
  EXPECT_EQ(workspace.frame_count(), 0);
  EXPECT_EQ(workspace.view_count(), 0);
  EXPECT_FALSE(workspace.value("stereo.disparities").has_value());
  EXPECT_FALSE(std::filesystem::exists(folder.path() / "out/views/000000.left.png"));
}

std::string error_of(const std::function<void()>& work) {
  try {
    work();
  } catch (const InputError& error) {
    return error.what();
  }
  return "no error";
}

TEST(Workspace, RefusesAnotherSessionsOutputForeignFoldersAndASecondRun) {
  const TemporaryFolder folder;
  const auto out = folder.path() / "out";
  {
    const Workspace workspace = Workspace::create(out, "/recordings/a", "aaaa");
    EXPECT_THAT(error_of([&] { Workspace::create(out, "/recordings/a", "aaaa"); }),
                ::testing::HasSubstr("another iris is working"));
    EXPECT_EQ(Workspace::open(out, Workspace::Access::read_only).session_folder(), "/recordings/a");
  }
  EXPECT_THAT(error_of([&] { Workspace::create(out, "/recordings/b", "bbbb"); }),
              ::testing::AllOf(::testing::HasSubstr("another session"), ::testing::HasSubstr("/recordings/a")));
  EXPECT_EQ(error_of([&] { Workspace::create(out, "/moved/a", "aaaa"); }), "no error");
  write_file(folder.path() / "photos/me.jpg", "x");
  EXPECT_THAT(error_of([&] { Workspace::create(folder.path() / "photos", "s", "f"); }), ::testing::HasSubstr("me.jpg"));
  EXPECT_THAT(error_of([&] { Workspace::open(folder.path() / "photos"); }), ::testing::HasSubstr("no output folder"));
  EXPECT_THAT(error_of([&] { Workspace::create(folder.path() / "photos/me.jpg/out", "s", "f"); }),
              ::testing::HasSubstr("cannot be made"));
}

// The output of somebody else, or on a medium that cannot be written.
TEST(Workspace, CanBeReadWhereNothingCanBeWritten) {
  const TemporaryFolder folder;
  const std::filesystem::path out = folder.path() / "out 50% #1?";
  {
    Workspace workspace = Workspace::create(out, "/recordings/a", "id");
    workspace.add_frame(posed(0, 0), nullptr);
  }
  for (const auto& path : {folder.path(), out}) {
    std::filesystem::permissions(path, static_cast<std::filesystem::perms>(0555));
  }
  const pid_t child = fork();
  if (child == 0) {
    // Permissions do not hold root back.
    if (geteuid() == 0 && (setgid(65534) != 0 || setuid(65534) != 0)) _exit(2);
    try {
      const Workspace workspace = Workspace::open(out, Workspace::Access::read_only);
      _exit(workspace.frame_count() == 1 && workspace.session_folder() == "/recordings/a" ? 0 : 3);
    } catch (const std::exception& error) {
      std::fputs(error.what(), stderr);
      _exit(4);
    }
  }
  int status = 0;
  waitpid(child, &status, 0);
  EXPECT_EQ(status, 0);
  for (const auto& path : {folder.path(), out}) {
    std::filesystem::permissions(path, static_cast<std::filesystem::perms>(0755));
  }
}

TEST(Workspace, AKilledWriterLeavesWholeRecordsAndNoTemporaries) {
  const TemporaryFolder folder;
  const auto out = folder.path() / "out";
  int pipe_ends[2];
  ASSERT_EQ(pipe(pipe_ends), 0);
  const pid_t child = fork();
  if (child == 0) {
    Workspace workspace = Workspace::create(out, "s", "f");
    for (int i = 0;; ++i) {
      const StereoView view = test_view(i, false);
      workspace.add_frame(posed(i, 0), &view);
      if (i == 5 && write(pipe_ends[1], "x", 1) != 1) _exit(1);
    }
  }
  char byte;
  ASSERT_EQ(read(pipe_ends[0], &byte, 1), 1);
  kill(child, SIGKILL);
  waitpid(child, nullptr, 0);
  close(pipe_ends[0]);
  close(pipe_ends[1]);
  write_file(out / "views/.tmp.1.000009.left.png", "left behind");
  const Workspace workspace = Workspace::create(out, "s", "f");
  EXPECT_GE(workspace.frame_count(), 6);
  const auto store = workspace.views(Poses::odometry, -1, 1);
  ASSERT_EQ(static_cast<int>(store->summaries().size()), workspace.frame_count());
  for (int i = 0; i < workspace.frame_count(); ++i) EXPECT_NO_THROW(store->load(i));
  EXPECT_FALSE(std::filesystem::exists(out / "views/.tmp.1.000009.left.png"));
}

}  // namespace
}  // namespace iris::workspace
