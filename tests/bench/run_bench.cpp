#include <fcntl.h>
#include <fmt/format.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "bench/bench.h"
#include "bench/inputs.h"
#include "bench/opencv_peers.h"
#include "iris/pipeline/frames.h"
#include "iris/rectify/rectifier.h"
#include "iris/session/session.h"
#include "support/temporary_folder.h"

namespace iris::bench {
namespace {

using benchmark::State;
namespace fs = std::filesystem;

constexpr int kFrames = 40;

session::SessionOptions at_most(int frames) {
  session::SessionOptions options;
  options.max_frames = frames;
  return options;
}

// The program, with all that it makes: path, map, octree, scene, tour.
void whole_run(State& state, int frames) {
  const auto session = session::open_session(recorded_session(), at_most(frames));
  rusage used{};
  int status = 0;
  for (auto _ : state) {
    const testing::TemporaryFolder folder;
    const std::string count = fmt::format("--session.max_frames={}", frames), out = (folder.path() / "out").string();
    const std::string session_path = recorded_session().string();
    const pid_t child = fork();
    if (child == 0) {
      const int nothing = open("/dev/null", O_WRONLY);
      dup2(nothing, STDOUT_FILENO);
      dup2(nothing, STDERR_FILENO);
      execl(IRIS_PROGRAM, "iris", "run", session_path.c_str(), "-o", out.c_str(), "--quiet", count.c_str(), nullptr);
      _exit(127);
    }
    if (child < 0 || wait4(child, &status, 0, &used) != child) {
      state.SkipWithError("cannot start " IRIS_PROGRAM);
      return;
    }
  }
  if (!WIFEXITED(status) || (WEXITSTATUS(status) != 0 && WEXITSTATUS(status) != 4)) {
    state.SkipWithError("iris run failed");
    return;
  }
  set_rate(state, "frames/s", session->size());
  state.counters["CPU s"] = static_cast<double>(used.ru_utime.tv_sec + used.ru_stime.tv_sec) +
                            1e-6 * static_cast<double>(used.ru_utime.tv_usec + used.ru_stime.tv_usec);
  state.counters["MB"] = static_cast<double>(used.ru_maxrss) / 1000;
}

void read_all(State& state, int frames) {
  const auto session = session::open_session(recorded_session(), at_most(frames));
  measure(state, 1, [&] {
    for (int i = 0; i < session->size(); ++i) benchmark::DoNotOptimize(session->read(i));
  });
}

// The streaming stage alone: disparities and pose of each frame, stored views.
void frames_stage(State& state) {
  pipeline::Options options;
  options.stereo.disparities = 128;
  const auto session = session::open_session(recorded_session(), at_most(kFrames));
  OptionSet set;
  options.declare(set);
  measure(state, available_threads(), [&] {
    const testing::TemporaryFolder folder;
    auto workspace = workspace::Workspace::create(folder.path() / "out", "bench", session->identity());
    pipeline::run_stages({pipeline::frames_stage(*session, options)}, set, workspace, {});
  });
  set_rate(state, "frames/s", session->size());
}

// The same from OpenCV's parts, frame by frame, each part as parallel as OpenCV makes it; nothing is stored.
void opencv_frames(State& state, bool semi_global) {
  const auto session = session::open_session(recorded_session(), at_most(kFrames));
  const rectify::Rectifier rectifier(session->calibration());
  const auto matcher = semi_global ? semi_global_matcher(128, cv::StereoSGBM::MODE_SGBM_3WAY) : block_matcher(128);
  measure(state, available_threads(), [&] {
    cv::Mat1b prev;
    cv::Mat1f prev_disparity;
    for (int i = 0; i < session->size(); ++i) {
      const StereoPair pair = rectifier.rectify(session->read(i));
      cv::Mat fixed;
      cv::Mat1f disparity;
      matcher->compute(pair.left, pair.right, fixed);
      fixed.convertTo(disparity, CV_32F, 1.0 / 16);
      if (i > 0) benchmark::DoNotOptimize(plain_motion(prev, prev_disparity, pair.left, rectifier.camera()));
      prev = pair.left;
      prev_disparity = disparity;
    }
  });
}

}  // namespace

void register_run(bool quick) {
  const std::string recording = recorded_session_name();
  compare("run", "disparities and path, all processors", fmt::format("{}, {} frames", recording, kFrames),
          {{"IRIS", frames_stage},
           {"OpenCV BM, LK, PnP", [](State& state) { opencv_frames(state, false); }},
           {"OpenCV SGBM 3WAY, LK, PnP", [](State& state) { opencv_frames(state, true); }}},
          Uses::several);
  const int frames = quick ? 20 : 0;
  compare("run", "iris run, all processors", quick ? fmt::format("{}, {} frames", recording, frames) : recording,
          {{"IRIS", [=](State& state) { whole_run(state, frames); }},
           {"reading the images alone, one thread", [=](State& state) { read_all(state, frames); }}},
          Uses::several);
}

}  // namespace iris::bench
