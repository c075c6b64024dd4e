// iris calibrate IMAGES… -o calibration.yaml --target …: a stereo calibration from images of a target.
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spdlog/spdlog.h>

#include <filesystem>
#include <memory>

#include "apps/iris/command.h"
#include "export/calibration_report.h"
#include "iris/calibrate/calibration_writer.h"
#include "iris/calibrate/quality.h"
#include "iris/calibrate/stereo.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/pipeline/calibration_images.h"

namespace iris::app {
namespace fs = std::filesystem;
namespace {

struct Calibrate {
  explicit Calibrate(CLI::App& command) : arguments(command, {"session", "calibrate"}) {}
  std::vector<std::string> images;
  std::string out, target, format, report;
  Arguments arguments;
};

int run(Calibrate& state) {
  state.arguments.resolve();
  calibrate::CalibrateOptions& options = state.arguments.calibrate;
  const calibrate::Target target = calibrate::parse_target(state.target);
  const calibrate::FileFormat format = calibrate::file_format(state.format, state.out);
  if (options.distortion == "auto") options.distortion = calibrate::holds_k3(format) ? "radtan" : "radtan4";
  const bool four =
      options.distortion == "radial" || options.distortion == "radtan4" || options.distortion == "fisheye";
  if (!four && !calibrate::holds_k3(format)) {
    throw UsageError(
        fmt::format("the output's format has no {} lenses; choose --calibrate.distortion radtan4 or fisheye, "
                    "or --format opencv or ros",
                    options.distortion));
  }

  pipeline::CalibrationImages images;
  with_threads(state.arguments.threads(), [&] {
    images =
        pipeline::read_calibration_images({state.images.begin(), state.images.end()},
                                          state.arguments.options.library.session, target, state.arguments.control());
  });
  for (const std::string& note : images.notes) spdlog::warn("{}", note);
  const calibrate::ViewSelection selection = calibrate::select_views(images.views, options);
  const std::string used =
      fmt::format("{} of {} pairs of images are used ({}{} without target, {} blurred, {} that show nothing new)",
                  selection.views.size(), images.views.size() + static_cast<size_t>(images.unreadable),
                  images.unreadable > 0 ? fmt::format("{} damaged, ", images.unreadable) : "", selection.unseen,
                  selection.blurred, selection.duplicates + selection.surplus);
  spdlog::info("{}: {}", calibrate::to_text(target), used);
  const calibrate::StereoCalibrationResult result =
      calibrate::calibrate_stereo(selection.views, target, images.width, images.height, options);
  if (result.status != calibrate::StereoCalibrationResult::Status::ok) {
    std::string problem = result.problem;
    if (!images.hints.empty()) problem += fmt::format("; {}", fmt::join(images.hints, "; "));
    throw InputError(state.images.front(), problem, result.remedy);
  }
  const std::string comment =
      fmt::format("iris calibrate --target {}, {} pairs, RMS {:.3f} px", state.target, result.pairs, result.rms);
  const std::vector<fs::path> written = calibrate::write_calibration(state.out, format, result.calibration, comment);
  spdlog::info("RMS {:.3f} px (left {:.3f}, right {:.3f}), before both were calibrated together {:.3f} px", result.rms,
               result.left_rms, result.right_rms, result.start_rms);
  if (result.sheet_along > 0) {
    spdlog::info(
        "the target is uneven, which is allowed for: its corners lie {:.2f} mm beside their places and {:.2f} mm "
        "above or below its plane (RMS)",
        1000 * result.sheet_along, 1000 * result.sheet_across);
  }
  for (const calibrate::Parameter& p : result.parameters) {
    spdlog::info("  {:<14} {:>12.5g} +- {:.2g} {}", p.name, p.value, p.sigma, p.unit);
  }
  const calibrate::CrossValidation validation = calibrate::cross_validate(selection.views, target, result, options);
  spdlog::info("rows of unseen pairs differ by {:.3f} px (RMS) after rectification", validation.rms);
  const std::vector<std::string> warnings = calibrate::warnings(selection.views, target, result, validation);
  for (const std::string& warning : warnings) spdlog::warn("{}", warning);
  if (!state.report.empty()) {
    exporters::write_calibration_report(state.report, {.target = calibrate::to_text(target),
                                                       .views = selection.views,
                                                       .result = result,
                                                       .validation = validation,
                                                       .depths = calibrate::depth_errors(result),
                                                       .warnings = warnings,
                                                       .images = used});
    spdlog::info("written: {}", state.report);
  }
  for (const fs::path& path : written) spdlog::info("written: {}", path.string());
  return kGood;
}

}  // namespace

Command add_calibrate(CLI::App& program) {
  CLI::App* command = program.add_subcommand(
      "calibrate",
      "Calibrates a stereo rig from images of a flat target: both cameras, their lenses and how they stand.\n"
      "5 pairs or more; tilt the target in all directions and let it fill all parts of both images.");
  auto state = std::make_shared<Calibrate>(*command);
  command
      ->add_option("IMAGES", state->images,
                   "Recordings of the target in any layout that 'iris run' reads, or image files of both cameras")
      ->required();
  command
      ->add_option("-o,--output", state->out,
                   "Calibration to write: x.yaml; *camchain*.yaml Kalibr, *camera_info*.yaml "
                   "ROS (two files), a folder EuRoC")
      ->type_name("FILE")
      ->check(kNotEmpty)
      ->required();
  command
      ->add_option("--target", state->target,
                   "What is seen: squares:7x5:20mm (dark squares as far apart as wide), chessboard:9x6:25mm (inner "
                   "corners), charuco:10x7:30mm:22.5mm[:4X4_50] (squares), aprilgrid:6x6:88mm:0.3 (gap / tag)")
      ->type_name("KIND:COLSxROWS:SIZE")
      ->required();
  command->add_option("--format", state->format, "opencv, kalibr, ros, euroc; otherwise as the output's name says")
      ->type_name("NAME");
  command
      ->add_option("--report", state->report,
                   "Web page (one HTML file) on its quality: residuals, coverage, uncertainties, expected depth errors")
      ->type_name("FILE");
  return [state] { return run(*state); };
}

}  // namespace iris::app
