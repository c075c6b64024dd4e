#include "iris/pipeline/pipeline.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <spdlog/spdlog.h>

#include <atomic>
#include <thread>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/pipeline/frames.h"
#include "support/synthetic_session.h"
#include "support/temporary_folder.h"

namespace iris::pipeline {
namespace {

using iris::testing::TemporaryFolder;
using ::testing::ElementsAre;
using ::testing::IsEmpty;

struct Numbers {
  double first = 1, second = 2;
  void declare(OptionSet& set) {
    set.section("first");
    set.add("value", first, "", 0, 9, "a number");
    set.section("second");
    set.add("value", second, "", 0, 9, "a number");
  }
};

class RunStages : public ::testing::Test {
 protected:
  RunStages() : workspace_(workspace::Workspace::create(folder_.path() / "out", "s", "f")) {
    spdlog::set_level(spdlog::level::warn);
    numbers_.declare(set_);
    const auto nothing = [](workspace::Workspace&, const RunControl&, const std::string&) {
      return std::vector<std::string>{};
    };
    stages_ = {{.name = "a", .sections = {"first"}, .after = {}, .inputs = "x", .run = nothing},
               {.name = "b", .sections = {"second"}, .after = {"a"}, .inputs = "", .run = nothing},
               {.name = "c", .sections = {}, .after = {"a"}, .inputs = "", .run = nothing}};
  }
  std::vector<std::string> run() { return run_stages(stages_, set_, workspace_, {}); }

  TemporaryFolder folder_;
  workspace::Workspace workspace_;
  Numbers numbers_;
  OptionSet set_;
  std::vector<Stage> stages_;
};

TEST_F(RunStages, EachRunsOnce) {
  EXPECT_THAT(run(), ElementsAre("a", "b", "c"));
  EXPECT_THAT(run(), IsEmpty());
}

TEST_F(RunStages, FilesThatOtherOptionsLeftAreRemoved) {
  stages_[0].run = [this](workspace::Workspace& workspace, const RunControl&, const std::string&) {
    const std::vector<std::string> files = {"all.txt", numbers_.first > 1 ? "large.txt" : "small.txt"};
    for (const std::string& file : files) write_file(workspace.folder() / file, std::string_view("x"));
    return files;
  };
  const auto there = [this](const char* file) { return std::filesystem::exists(workspace_.folder() / file); };
  run();
  EXPECT_TRUE(there("all.txt") && there("small.txt") && !there("large.txt"));
  write_file(workspace_.folder() / "mine.txt", std::string_view("x"));
  numbers_.first = 2;
  run();
  EXPECT_TRUE(there("all.txt") && there("large.txt") && !there("small.txt"));
  EXPECT_TRUE(there("mine.txt"));
}

TEST_F(RunStages, AnOptionRedoesItsStageAndTheOnesAfterIt) {
  run();
  numbers_.second = 3;
  EXPECT_THAT(run(), ElementsAre("b"));
  numbers_.first = 3;
  EXPECT_THAT(run(), ElementsAre("a", "b", "c"));
  stages_[0].inputs = "y";
  EXPECT_THAT(run(), ElementsAre("a", "b", "c"));
}

TEST_F(RunStages, AFailedStageAndThoseAfterItRunAgain) {
  const auto good = stages_[1].run;
  stages_[1].run = [](workspace::Workspace&, const RunControl&, const std::string&) -> std::vector<std::string> {
    throw InputError("disk", "full", "");
  };
  EXPECT_THROW(run(), InputError);
  stages_[1].run = good;
  EXPECT_THAT(run(), ElementsAre("b", "c"));
}

TEST_F(RunStages, AFailureWhileRedoingLeavesTheStageUnfinished) {
  run();
  numbers_.second = 3;
  const auto good = stages_[1].run;
  stages_[1].run = [](workspace::Workspace&, const RunControl&, const std::string&) -> std::vector<std::string> {
    throw InputError("disk", "full", "");
  };
  EXPECT_THROW(run(), InputError);
  stages_[1].run = good;
  numbers_.second = 2;  // what it wrote before the failure is gone, although the options are the first ones again
  EXPECT_THAT(run(), ElementsAre("b"));
}

TEST_F(RunStages, AStageMayStandAloneWhenThoseBeforeItAreFinished) {
  run();
  numbers_.second = 3;
  const std::vector<Stage> only = {stages_[1]};
  EXPECT_THAT(run_stages(only, set_, workspace_, {}), ElementsAre("b"));
  EXPECT_THAT(run(), IsEmpty());
}

TEST_F(RunStages, StopsBeforeTheNextStageWhenAsked) {
  std::atomic<bool> stop = true;
  EXPECT_THROW(run_stages(stages_, set_, workspace_, {.stop = &stop}), Interrupted);
  EXPECT_FALSE(workspace_.stage("a").has_value());
}

// The synthetic room, interrupted behind every frame: the chain must go on as if nothing had happened.
TEST(FramesStage, InterruptedBehindEveryFrameItGivesTheSamePoses) {
  const TemporaryFolder folder;
  constexpr int kFrames = 9;
  iris::testing::write_synthetic_session(folder.path() / "session", kFrames);
  Options options;
  options.stereo.disparities = 48;
  const auto session = session::open_session(folder.path() / "session", options.session);
  OptionSet set;
  options.declare(set);
  const std::vector<Stage> stages = {frames_stage(*session, options)};

  auto whole = workspace::Workspace::create(folder.path() / "whole", "s", "f");
  run_stages(stages, set, whole, {});

  // A pipeline that stops after each source frame: `stop` is set from the start, but for the number of frames in
  // flight.
  auto pieces = workspace::Workspace::create(folder.path() / "pieces", "s", "f");
  int interruptions = 0;
  for (bool done = false; !done;) {
    std::atomic<bool> stop = false;
    std::thread stopper([&, before = pieces.frame_count()] {
      while (!stop && pieces.frame_count() == before) std::this_thread::yield();
      stop = true;
    });
    try {
      run_stages(stages, set, pieces, {.stop = &stop});
      done = true;
    } catch (const Interrupted&) {
      ++interruptions;
    }
    stop = true;
    stopper.join();
  }
  EXPECT_GE(interruptions, 1);

  ASSERT_EQ(pieces.frame_count(), kFrames);
  EXPECT_EQ(pieces.view_count(), whole.view_count());
  for (int i = 0; i < kFrames; ++i) {
    const auto a = *whole.frame(i), b = *pieces.frame(i);
    EXPECT_TRUE(a.submap_from_cam.affine() == b.submap_from_cam.affine()) << i;
    EXPECT_TRUE(a.motion.covariance == b.motion.covariance) << i;
    EXPECT_EQ(a.reference_frame, b.reference_frame);
  }
}

TEST(FramesStage, KnownPosesAreThePath) {
  const TemporaryFolder folder;
  constexpr int kFrames = 5;
  iris::testing::write_synthetic_session(folder.path() / "session", kFrames);
  Options options;
  options.stereo.disparities = 48;
  const auto session = session::open_session(folder.path() / "session", options.session);
  // Any poses: they are not measured. Frame 2 has none.
  std::string text;
  std::vector<Pose> poses;
  for (int i = 0; i < kFrames; ++i) {
    const Eigen::Quaterniond q(Eigen::AngleAxisd(0.1 * i, Eigen::Vector3d::UnitY()));
    Pose pose(q);
    pose.translation() = Eigen::Vector3d(3 + i, 0.2 * i, -1);
    poses.push_back(pose);
    if (i == 2) continue;
    text += fmt::format("{}.{:09} {} {} {} {} {} {} {}\n", session->stamp_ns(i) / 1000000000,
                        session->stamp_ns(i) % 1000000000, pose.translation().x(), pose.translation().y(),
                        pose.translation().z(), q.x(), q.y(), q.z(), q.w());
  }
  OptionSet set;
  options.declare(set);
  auto workspace = workspace::Workspace::create(folder.path() / "out", "s", "f");
  const KnownPoses known = known_poses(text, "poses.txt", *session, options.session);
  run_stages({frames_stage(*session, options, known)}, set, workspace, {});
  Pose left_from_rect = Pose::Identity();
  left_from_rect.linear() = rectify::Rectifier(session->calibration()).rect_from_left().transpose();
  for (int i = 0; i < kFrames; ++i) {
    const auto record = *workspace.frame(i);
    if (i == 2) {
      // The truth's neighbours are two frames apart, too far to interpolate.
      EXPECT_EQ(record.state, workspace::FrameState::blind);
      continue;
    }
    const Pose first = poses[0] * left_from_rect, here = poses[static_cast<size_t>(i)] * left_from_rect;
    EXPECT_TRUE(record.submap_from_cam.isApprox(first.inverse() * here, 1e-9)) << i;
    EXPECT_EQ(record.submap, 0);
    EXPECT_EQ(record.reference_frame, i == 0 ? -1 : i == 3 ? 1 : i - 1);
  }
  EXPECT_THROW(known_poses("1.0 0 0 0 0 0 0 1\n", "other.txt", *session, options.session), InputError);
}

// The same recording with its own calibration and with one whose right camera looks 3 px too low.
TEST(FramesStage, TellsThatRowsDoNotCorrespondAndThatSurfacesAreTooNear) {
  const TemporaryFolder folder;
  const std::filesystem::path recording = folder.path() / "session";
  iris::testing::write_synthetic_session(recording, 6);
  const auto summary_of = [&](const std::string& name, int disparities) {
    Options options;
    options.stereo.disparities = disparities;
    const auto session = session::open_session(recording, options.session);
    OptionSet set;
    options.declare(set);
    auto workspace = workspace::Workspace::create(folder.path() / name, "s", "f");
    run_stages({frames_stage(*session, options)}, set, workspace, {});
    return summarise_frames(workspace, workspace::Poses::odometry);
  };
  const FramesSummary good = summary_of("good", 0);
  EXPECT_EQ(good.rows_text, "");
  EXPECT_EQ(good.too_near_text(), "");

  const FramesSummary near = summary_of("near", 16);
  EXPECT_EQ(near.too_near, 6);
  EXPECT_THAT(near.too_near_text(), ::testing::HasSubstr("--stereo.disparities 32"));

  std::string calibration = read_file(recording / "calibration.yaml");
  const size_t right = calibration.find("119.5", calibration.find("M2:"));
  ASSERT_NE(right, std::string::npos);
  write_file(recording / "calibration.yaml", calibration.replace(right, 5, "122.5"));
  EXPECT_THAT(summary_of("low", 0).rows_text, ::testing::HasSubstr("3.0 px apart"));
}

TEST(SummariseFrames, CountsPosesSubMapsAndPath) {
  const TemporaryFolder folder;
  auto workspace = workspace::Workspace::create(folder.path() / "out", "s", "f");
  for (int i = 0; i < 7; ++i) {
    workspace::FrameRecord record{.frame_idx = i};
    if (i == 3) record.state = workspace::FrameState::unreadable;
    record.submap = i < 3 ? 0 : 1;
    record.submap_from_cam.translation().x() = i < 3 ? i : 2.0 * (i - 4);
    workspace.add_frame(record, nullptr);
  }
  workspace.add_frame({.frame_idx = 7, .state = workspace::FrameState::blind}, nullptr);
  const FramesSummary summary = summarise_frames(workspace, workspace::Poses::odometry);
  EXPECT_EQ(summary.frames, 8);
  EXPECT_EQ(summary.blind, 1);
  EXPECT_EQ(summary.posed, 6);
  EXPECT_EQ(summary.unreadable, 1);
  EXPECT_EQ(summary.submaps, 2);
  EXPECT_EQ(summary.largest_submap, 0);  // three poses each: the first
  EXPECT_DOUBLE_EQ(summary.path_length, 2 + 4);
  EXPECT_FALSE(summary.complete());
}

}  // namespace
}  // namespace iris::pipeline
