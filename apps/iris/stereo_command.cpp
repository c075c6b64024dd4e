// iris stereo LEFT RIGHT -o disparity.png: one rectified pair.
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cctype>
#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "apps/iris/command.h"
#include "iris/calibrate/calibration_file.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/rectify/rectifier.h"
#include "iris/stereo/disparity_file.h"
#include "iris/stereo/disparity_picture.h"
#include "iris/stereo/search_range.h"
#include "iris/workspace/view_files.h"

namespace iris::app {
namespace {

struct Stereo {
  explicit Stereo(CLI::App& command) : arguments(command, {"stereo"}) {}
  std::string left, right, out, picture, depth, ply, calibration;
  double focal = 0, baseline = 0, cx = -1, cy = -1, offset = 0;
  Arguments arguments;
};

cv::Mat read_image(const std::string& path) {
  if (!std::filesystem::exists(path)) throw InputError(path, "there is no such file", "check the name");
  const cv::Mat image = cv::imread(path, cv::IMREAD_COLOR);
  if (image.empty()) throw InputError(path, "is no image that can be read", "give a PNG, JPEG, PGM or TIFF file");
  return image;
}

std::string extension(const std::string& path) {
  std::string text = std::filesystem::path(path).extension().string();
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return std::tolower(c); });
  return text;
}

// Before anything is computed.
void check_names(const Stereo& state) {
  const auto want = [](const std::string& path, std::initializer_list<const char*> known) {
    if (path.empty()) return;
    for (const char* name : known) {
      if (extension(path) == name) return;
    }
    throw UsageError(fmt::format("{}: the name must end in {}", path, fmt::join(known, " or ")));
  };
  want(state.out, {".png", ".pfm"});
  want(state.picture, {".png"});
  want(state.depth, {".png", ".pfm"});
  want(state.ply, {".ply"});
  const bool by_hand = state.focal > 0 && state.baseline > 0;
  if ((!state.depth.empty() || !state.ply.empty()) && state.calibration.empty() && !by_hand) {
    throw UsageError("--depth and --ply need the camera: give --calibration FILE, or --focal and --baseline");
  }
  if (!state.calibration.empty() && (state.focal > 0 || state.baseline > 0)) {
    throw UsageError("give either --calibration or --focal and --baseline");
  }
}

int run(Stereo& state) {
  state.arguments.resolve();
  check_names(state);
  StereoFrame frame{.left = read_image(state.left), .right = read_image(state.right)};
  if (frame.left.size() != frame.right.size()) {
    throw InputError(state.right,
                     fmt::format("is {} x {} px, but {} is {} x {} px", frame.right.cols, frame.right.rows, state.left,
                                 frame.left.cols, frame.left.rows),
                     "give the two images of one rectified stereo pair");
  }
  RectifiedCamera camera{.f = state.focal,
                         .cx = state.cx >= 0 ? state.cx : (frame.left.cols - 1) / 2.0,
                         .cy = state.cy >= 0 ? state.cy : (frame.left.rows - 1) / 2.0,
                         .baseline = state.baseline,
                         .disparity_offset = state.offset,
                         .width = frame.left.cols,
                         .height = frame.left.rows};
  StereoPair pair;
  if (state.calibration.empty()) {
    pair.left_colour = frame.left;
    // Weights of OpenCV's decoder, so that grey images stay as they are.
    cv::cvtColor(frame.left, pair.left, cv::COLOR_BGR2GRAY);
    cv::cvtColor(frame.right, pair.right, cv::COLOR_BGR2GRAY);
  } else {
    StereoCalibration calibration = calibrate::read_calibration(state.calibration);
    for (CameraModel* model : {&calibration.left, &calibration.right}) {
      if (model->width == 0) std::tie(model->width, model->height) = std::pair(frame.left.cols, frame.left.rows);
      if (model->width == frame.left.cols && model->height == frame.left.rows) continue;
      throw InputError(state.calibration,
                       fmt::format("is for images of {} x {} px, but {} is {} x {} px", model->width, model->height,
                                   state.left, frame.left.cols, frame.left.rows),
                       "give the calibration of these images");
    }
    validate(calibration, state.calibration);
    const rectify::Rectifier rectifier(calibration);
    pair = rectifier.rectify(frame);
    camera = rectifier.camera();
  }
  with_threads(state.arguments.threads(), [&] {
    stereo::MwmfOptions options = state.arguments.options.library.stereo;
    if (options.disparities == 0) options.disparities = stereo::estimate_search_range({pair}, options).disparities;
    const double reach = options.min_disparity + options.disparities;
    const bool png = extension(state.out) == ".png";
    if (png && reach * 256 > 65535) {
      throw UsageError(
          "a 16-bit disparity image reaches 255 px only; lower --stereo.disparities, or write a .pfm file");
    }
    const DisparityImage image = stereo::mwmf(pair.left, pair.right, options);
    if (png) {
      write_file(state.out, workspace::encode_png(stereo::kitti_code(image.disparity)));
    } else {
      write_file(state.out, stereo::encode_pfm(image.disparity));
    }
    if (!state.picture.empty()) {
      write_file(state.picture, workspace::encode_png(stereo::disparity_picture(image.disparity, reach)));
    }
    if (!state.depth.empty()) {
      const cv::Mat1f depth = stereo::depth_image(image.disparity, camera);
      if (extension(state.depth) == ".pfm") {
        write_file(state.depth, stereo::encode_pfm(depth));
      } else {
        cv::Mat1w millimetres;
        depth.convertTo(millimetres, CV_16U, 1000);
        millimetres.setTo(0, depth > 65.535f);  // beyond what the file can say
        write_file(state.depth, workspace::encode_png(millimetres));
      }
    }
    if (!state.ply.empty()) {
      write_file(state.ply, stereo::encode_ply(image, pair.left_colour, camera, DisparityOrigin::within_segment));
    }
    const double measured = 100.0 *
                            cv::countNonZero((image.origin == uint8_t(DisparityOrigin::measured)) |
                                             (image.origin == uint8_t(DisparityOrigin::corrected))) /
                            image.origin.total();
    spdlog::info("{}: {} disparities searched, {:.1f} % of the pixels measured, {:.1f} % filled", state.out,
                 options.disparities, measured,
                 100.0 * cv::countNonZero(image.origin > uint8_t(DisparityOrigin::corrected)) / image.origin.total());
    constexpr double kLeast = 10;  // [%] rectified images of textured places have 40 to 80
    if (measured < kLeast) {
      spdlog::warn(
          "hardly anything matches: are these images rectified, in this order (left, then right), and is the search "
          "range large enough?");
    }
  });
  return kGood;
}

}  // namespace

Command add_stereo(CLI::App& program) {
  CLI::App* command = program.add_subcommand(
      "stereo",
      "Disparities of one rectified pair of images; .png: 16 bit, value = disparity x 256, 0 = none; .pfm: floats, "
      "infinite = none.");
  auto state = std::make_shared<Stereo>(*command);
  command->add_option("LEFT", state->left, "Left rectified image")->required();
  command->add_option("RIGHT", state->right, "Right rectified image")->required();
  command->add_option("-o,--output", state->out, "Disparity image to write")
      ->type_name("FILE.png|.pfm")
      ->check(kNotEmpty)
      ->required();
  command->add_option("--picture", state->picture, "Also write a coloured picture of it")->type_name("FILE.png");
  command
      ->add_option("--depth", state->depth, "Also write depths: .png in millimetres (16 bit, 0 = none), .pfm in metres")
      ->type_name("FILE.png|.pfm");
  command->add_option("--ply", state->ply, "Also write coloured points (what was measured or lies inside of surfaces)")
      ->type_name("FILE.ply");
  command
      ->add_option("--calibration", state->calibration,
                   "Calibration of the pair, any format that sessions may have; images that are not rectified are")
      ->type_name("FILE");
  command->add_option("--focal", state->focal, "Instead of a calibration: focal length [px]")
      ->check(CLI::PositiveNumber)
      ->type_name("px");
  command->add_option("--baseline", state->baseline, "… and distance between the cameras [m]")
      ->check(CLI::PositiveNumber)
      ->type_name("m");
  command->add_option("--cx", state->cx, "… and principal point [px]; without it the middle of the image")
      ->type_name("px");
  command->add_option("--cy", state->cy, "… and its row")->type_name("px");
  command->add_option("--offset", state->offset, "… and what is added to disparities before they become depths [px]")
      ->type_name("px");
  return [state] { return run(*state); };
}

}  // namespace iris::app
