// iris rectify SESSION -o DIR: the rectified images, as a session of their own; --check: does the calibration fit?
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <cmath>
#include <filesystem>
#include <memory>
#include <numbers>

#include "apps/iris/command.h"
#include "iris/calibrate/calibration_writer.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/rectify/rectifier.h"
#include "iris/rectify/row_check.h"
#include "iris/workspace/view_files.h"

namespace iris::app {
namespace fs = std::filesystem;
namespace {

struct Rectify {
  explicit Rectify(CLI::App& command) : arguments(command, {"session", "rectify"}) {}
  std::string session, out, refined, format;
  bool check = false;
  Arguments arguments;
};

// Matches in frames spread over the recording, rectified by the calibration.
std::vector<rectify::RowMatch> match_frames(const Rectify& state, const session::Session& session,
                                            const StereoCalibration& calibration) {
  const rectify::RowCheckOptions& options = state.arguments.rectify;
  const rectify::Rectifier rectifier(calibration);
  const int count = std::min(options.frames, session.size());
  std::vector<std::vector<rectify::RowMatch>> found(static_cast<size_t>(count));
  const auto match = [&](int k) {
    const int frame = static_cast<int>(static_cast<int64_t>(k) * session.size() / count);
    try {
      found[static_cast<size_t>(k)] = rectify::match_rows(rectifier.rectify(session.read(frame)), options);
    } catch (const InputError& error) {
      spdlog::warn("frame {} is skipped: {}", frame, error.what());
    }
  };
  with_threads(state.arguments.threads(), [&] {
    Progress progress(state.arguments.control().progress, "match rows", count);
    const int block = session.random_access() ? 8 : 1;
    for (int begin = 0; begin < count; begin += block) {
      if (stop_requested) throw Interrupted();
      const int end = std::min(begin + block, count);
      parallel_chunks(begin, end, 1, [&](int from, int to) {
        for (int k = from; k < to; ++k) match(k);
      });
      progress.update(end);
    }
  });
  std::vector<rectify::RowMatch> matches;
  for (const auto& frame : found) matches.insert(matches.end(), frame.begin(), frame.end());
  return matches;
}

void print(const rectify::RowCheck& check) {
  fmt::print("matches              {}\n", check.matches);
  fmt::print("right row - left row {:+.2f} px (median), {:.2f} px (median of the absolute values)\n", check.median,
             check.median_absolute);
  fmt::print("systematic error     {:.2f} px (RMS of the medians below; single matches scatter by {:.2f} px)\n",
             check.systematic, check.scatter);
  for (int y = 0; y < check.cells.rows; ++y) {
    std::string line = y == 0 ? "over the image   [px]" : "                     ";
    for (int x = 0; x < check.cells.cols; ++x) {
      line += std::isnan(check.cells(y, x)) ? "     -" : fmt::format(" {:+5.2f}", check.cells(y, x));
    }
    fmt::print("{}\n", line);
  }
}

int check_calibration(Rectify& state, const session::Session& session) {
  constexpr double kDegrees = 180 / std::numbers::pi;
  const rectify::RowCheckOptions& options = state.arguments.rectify;
  StereoCalibration calibration = session.calibration();
  const int width = calibration.left.width, height = calibration.left.height;
  std::vector<rectify::RowMatch> matches = match_frames(state, session, calibration);
  rectify::RowCheck check = rectify::check_rows(matches, width, height, options);
  print(check);
  if (!check.enough) {
    fmt::print(
        "too few matches to judge the calibration: take frames with more texture (--session.first, "
        "--rectify.frames), or search further (--rectify.rows)\n");
    return kIncomplete;
  }
  if (check.fits) {
    fmt::print(
        "the calibration fits this recording (tolerance {:g} px), as far as rows tell: a turn about the vertical axis, "
        "wrong focal lengths and sheared images shift points along their rows only; 'iris run' estimates these (its "
        "line 'calibration')\n",
        options.tolerance);
  } else {
    fmt::print("the calibration does not fit this recording any more (tolerance {:g} px): {}\n", options.tolerance,
               state.refined.empty() ? "calibrate again, or let --refine FILE turn the right camera" : "it is refined");
  }
  if (state.refined.empty()) return check.fits ? kGood : kIncomplete;

  // Twice: matches are found better in images that are rectified better.
  const StereoCalibration first = calibration;
  Eigen::Vector3d sigma;
  for (int pass = 0; pass < 2; ++pass) {
    const rectify::RotationRefinement refinement = rectify::refine_rotation(calibration, matches);
    calibration = refinement.calibration;
    sigma = kDegrees * refinement.sigma;
    matches = match_frames(state, session, calibration);
  }
  const Eigen::AngleAxisd turn(
      Eigen::Matrix3d(calibration.right_from_left.linear().transpose() * first.right_from_left.linear()));
  const Eigen::Vector3d degrees = kDegrees * turn.angle() * turn.axis();
  check = rectify::check_rows(matches, width, height, options);
  fmt::print("\nright camera turned by {:.3f} +- {:.3f}, {:.3f} +- {:.3f}, {:.3f} +- {:.3f} deg about x, y, z; then\n",
             degrees.x(), sigma.x(), degrees.y(), sigma.y(), degrees.z(), sigma.z());
  print(check);
  const auto written = calibrate::write_calibration(
      state.refined, calibrate::file_format(state.format, state.refined), calibration,
      fmt::format("refined by iris rectify --check --refine: right camera turned by {:.3f} {:.3f} {:.3f} deg",
                  degrees.x(), degrees.y(), degrees.z()));
  for (const fs::path& path : written) fmt::print("written: {}\n", path.string());
  // Of two files the left one: the reader finds the other beside it.
  fmt::print("use it: iris run {} --session.calibration {} -o OUT\n", state.session, written.front().string());
  if (!check.fits) fmt::print("turning the right camera alone is not enough: calibrate again\n");
  return check.fits ? kGood : kIncomplete;
}

int run(Rectify& state) {
  state.arguments.resolve();
  if (state.out.empty() && !state.check) throw UsageError("give -o DIR for the rectified images, or --check");
  if (!state.out.empty() && state.check) {
    throw UsageError("--check writes no images: leave out -o, or --check (--refine FILE writes a calibration)");
  }
  if (!state.refined.empty()) calibrate::file_format(state.format, state.refined);  // a wrong name now, not at the end
  const auto session = session::open_session(state.session, state.arguments.options.library.session);
  for (const std::string& note : session->notes()) spdlog::warn("{}", note);
  if (state.check) return check_calibration(state, *session);
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
  if (session->has_stamps()) {  // an assumed rate must not look like a recorded one
    std::string times;
    for (int i = 0; i < session->size(); ++i) {
      if (!written[static_cast<size_t>(i)]) continue;
      const int64_t ns = session->stamp_ns(i);
      times += fmt::format("{}.{:09}\n", ns / 1000000000, ns % 1000000000);
    }
    write_file(out / "times.txt", times);
  }
  const auto count = std::count(written.begin(), written.end(), 1);
  spdlog::info("{}: {} rectified pairs, f {:.2f} px, baseline {:.4f} m", out.string(), count, c.f, c.baseline);
  return count == session->size() ? kGood : kIncomplete;
}

}  // namespace

Command add_rectify(CLI::App& program) {
  CLI::App* command = program.add_subcommand(
      "rectify",
      "Writes the rectified images with their calibration (DIR is again a session), or checks the calibration.");
  auto state = std::make_shared<Rectify>(*command);
  command->add_option("SESSION", state->session, "Recorded session")->required();
  command->add_option("-o,--output", state->out, "Folder to write")->type_name("DIR")->check(kNotEmpty);
  CLI::Option* check = command->add_flag(
      "--check", state->check,
      "Instead of writing images: does the calibration still fit? Rows of points that both images show are compared "
      "(exit code 4: it does not)");
  CLI::Option* refine =
      command
          ->add_option("--refine", state->refined,
                       "With --check: turn the right camera so that the rows agree, and write that calibration")
          ->type_name("FILE")
          ->needs(check);
  command->add_option("--format", state->format, "Of --refine: opencv, kalibr, ros, euroc; otherwise as the name says")
      ->type_name("NAME")
      ->needs(refine);
  return [state] { return run(*state); };
}

}  // namespace iris::app
