// iris rectify SESSION -o DIR: the rectified images, as a session of their own.
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <filesystem>
#include <memory>

#include "apps/iris/command.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/rectify/rectifier.h"
#include "iris/workspace/view_files.h"

namespace iris::app {
namespace fs = std::filesystem;
namespace {

struct Rectify {
  explicit Rectify(CLI::App& command) : arguments(command, {"session"}) {}
  std::string session, out;
  Arguments arguments;
};

int run(Rectify& state) {
  state.arguments.resolve();
  const auto session = session::open_session(state.session, state.arguments.options.library.session);
  for (const std::string& note : session->notes()) spdlog::warn("{}", note);
  const rectify::Rectifier rectifier(session->calibration());
  const fs::path out = state.out;
  if (fs::exists(out) && !(fs::is_directory(out) && fs::is_empty(out))) {
    throw InputError(out, "is not empty: images of different sessions would mix", "give a new folder with -o");
  }
  std::vector<char> written(static_cast<size_t>(session->size()), 0);
  const auto write = [&](int i) {
    StereoPair pair;
    try {
      pair = rectifier.rectify(session->read(i));
    } catch (const InputError& error) {
      spdlog::warn("frame {} is skipped: {}", i, error.what());
      return;
    }
    const std::string name = fmt::format("{:06}.png", i);
    const cv::Mat left = pair.left_colour.empty() ? cv::Mat(pair.left) : cv::Mat(pair.left_colour);
    write_file(out / "left" / name, workspace::encode_png(left));
    write_file(out / "right" / name, workspace::encode_png(pair.right));
    if (i == 0 || i == session->size() / 2) {
      write_file(out / "preview" / name, workspace::encode_png(rectify::rectified_pair_picture(pair)));
    }
    written[static_cast<size_t>(i)] = 1;
  };
  with_threads(state.arguments.threads(), [&] {
    Progress progress(state.arguments.control().progress, "rectify", session->size());
    const int block = session->random_access() ? 64 : 1;
    for (int begin = 0; begin < session->size(); begin += block) {
      if (stop_requested) throw Interrupted();
      const int end = std::min(begin + block, session->size());
      parallel_chunks(begin, end, 1, [&](int from, int to) {
        for (int i = from; i < to; ++i) write(i);
      });
      progress.update(end);
    }
  });

  const RectifiedCamera& c = rectifier.camera();
  const auto camera = [&](const char* k, const char* d, double cx) {
    return fmt::format(
        "{}: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ {}, 0., {}, 0., {}, {}, 0., 0., 1. ]\n"
        "{}: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ 0., 0., 0., 0., 0. ]\n",
        k, c.f, cx, c.f, c.cy, d);
  };
  write_file(
      out / "calibration.yaml",
      fmt::format("%YAML:1.0\n---\nimage_width: {}\nimage_height: {}\n", c.width, c.height) + camera("M1", "D1", c.cx) +
          camera("M2", "D2", c.cx + c.disparity_offset) +
          "R: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]\n" +
          fmt::format("T: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: d\n   data: [ {}, 0., 0. ]\n", -c.baseline));
  std::string times;
  for (int i = 0; i < session->size(); ++i) {
    if (!written[static_cast<size_t>(i)]) continue;
    const int64_t ns = session->stamp_ns(i);
    times += fmt::format("{}.{:09}\n", ns / 1000000000, ns % 1000000000);
  }
  write_file(out / "times.txt", times);
  const auto count = std::count(written.begin(), written.end(), 1);
  spdlog::info("{}: {} rectified pairs, f {:.2f} px, baseline {:.4f} m", out.string(), count, c.f, c.baseline);
  return count == session->size() ? kGood : kIncomplete;
}

}  // namespace

Command add_rectify(CLI::App& program) {
  CLI::App* command =
      program.add_subcommand("rectify", "Writes the rectified images with their calibration: DIR is again a session.");
  auto state = std::make_shared<Rectify>(*command);
  command->add_option("SESSION", state->session, "Recorded session")->required();
  command->add_option("-o,--output", state->out, "Folder to write")->type_name("DIR")->check(kNotEmpty)->required();
  return [state] { return run(*state); };
}

}  // namespace iris::app
