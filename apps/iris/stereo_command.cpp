// iris stereo LEFT RIGHT -o disparity.png: one rectified pair.
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <memory>
#include <opencv2/imgcodecs.hpp>

#include "apps/iris/command.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/stereo/disparity_picture.h"
#include "iris/stereo/search_range.h"
#include "iris/workspace/view_files.h"

namespace iris::app {
namespace {

struct Stereo {
  explicit Stereo(CLI::App& command) : arguments(command, {"stereo"}) {}
  std::string left, right, out, picture;
  Arguments arguments;
};

cv::Mat1b read_grey(const std::string& path) {
  if (!std::filesystem::exists(path)) throw InputError(path, "there is no such file", "check the name");
  const cv::Mat1b image = cv::imread(path, cv::IMREAD_GRAYSCALE);
  if (image.empty()) throw InputError(path, "is no image that can be read", "give a PNG, JPEG, PGM or TIFF file");
  return image;
}

int run(Stereo& state) {
  state.arguments.resolve();
  const StereoPair pair{.left = read_grey(state.left), .right = read_grey(state.right), .left_colour = {}};
  if (pair.left.size() != pair.right.size()) {
    throw InputError(state.right,
                     fmt::format("is {} x {} px, but {} is {} x {} px", pair.right.cols, pair.right.rows, state.left,
                                 pair.left.cols, pair.left.rows),
                     "give the two images of one rectified stereo pair");
  }
  with_threads(state.arguments.threads(), [&] {
    stereo::MwmfOptions options = state.arguments.options.library.stereo;
    if (options.disparities == 0) options.disparities = stereo::estimate_search_range({pair}, options).disparities;
    const DisparityImage image = stereo::mwmf(pair.left, pair.right, options);
    const double reach = options.min_disparity + options.disparities;
    if (reach * 256 > 65535)
      throw UsageError("a 16-bit disparity image reaches 255 px only; lower --stereo.disparities");
    cv::Mat1w code;
    image.disparity.convertTo(code, CV_16U, 256);
    write_file(state.out, workspace::encode_png(code));
    if (!state.picture.empty()) {
      write_file(state.picture, workspace::encode_png(stereo::disparity_picture(image.disparity, reach)));
    }
    spdlog::info("{}: {} disparities searched, {:.1f} % of the pixels measured, {:.1f} % filled", state.out,
                 options.disparities,
                 100.0 * cv::countNonZero(image.origin == uint8_t(DisparityOrigin::measured)) / image.origin.total(),
                 100.0 * cv::countNonZero(image.origin > uint8_t(DisparityOrigin::corrected)) / image.origin.total());
  });
  return kGood;
}

}  // namespace

Command add_stereo(CLI::App& program) {
  CLI::App* command = program.add_subcommand(
      "stereo", "Disparities of one rectified pair of images (16-bit PNG, value = disparity x 256, 0 = none).");
  auto state = std::make_shared<Stereo>(*command);
  command->add_option("LEFT", state->left, "Left rectified image")->required();
  command->add_option("RIGHT", state->right, "Right rectified image")->required();
  command->add_option("-o,--output", state->out, "Disparity image to write")->type_name("FILE.png")->required();
  command->add_option("--picture", state->picture, "Also write a coloured picture of it")->type_name("FILE.png");
  return [state] { return run(*state); };
}

}  // namespace iris::app
