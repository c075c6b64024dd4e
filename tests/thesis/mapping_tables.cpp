// Chapter 6: two boxes circled near and far (fig. 6.4).
#include <fmt/format.h>

#include <cmath>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "iris/mapping/flog.h"
#include "iris/motion/chain.h"
#include "iris/motion/scs.h"
#include "thesis/sequence.h"
#include "thesis/tables.h"

namespace iris::thesis {
namespace {

constexpr double kShown = 1.6;  // [m] side of the square about the boxes that the pictures show

// Maps the boxes with poses from SCS alone, the image based model; the first camera is set to its true pose, so that
// the map can be laid over the truth.
void print_boxes(const std::string& path) {
  simulate::SimulateOptions options = thesis_camera();
  options.path = path;
  const Sequence sequence = simulate_sequence("boxes", options);
  motion::ScsOptions scs;
  scs.model = "image";
  stereo::MwmfOptions stereo = thesis_stereo();
  stereo.interpolation = "within";

  mapping::FlogOptions flog;
  flog.cell = 0.02;
  flog.layers = 1;
  flog.slices = 1;
  flog.bottom = 0.77;  // from the table, at 0.752 m, to the top of the larger box, at 1.092 m
  flog.height = 0.32;
  mapping::FlogBuilder builder(flog, sequence.camera);
  motion::MotionChain chain(sequence.camera, scs);
  Pose last = Pose::Identity();
  for (size_t i = 0; i < sequence.pairs.size(); ++i) {
    const StereoPair& pair = sequence.pairs[i];
    const DisparityImage disparity = stereo::mwmf(pair.left, pair.right, stereo);
    const motion::ChainStep step =
        chain.push(motion::extract_features(pair.left, disparity, sequence.camera, scs), static_cast<int>(i));
    last = sequence.truth.front() * step.world_from_cam;
    builder.add({.frame_idx = static_cast<int>(i),
                 .camera = sequence.camera,
                 .image = pair.left,
                 .disparity = disparity,
                 .world_from_cam = last});
  }
  const Pose error = sequence.truth.back().inverse() * last;
  const mapping::MapRaster raster = mapping::rasterise(builder.map(), flog);

  // The larger box covers 0.4 x 0.28 m about the origin; the smaller one begins at y = 0.22 m.
  double sum = 0;
  cv::Mat1b picture(static_cast<int>(kShown / flog.cell), static_cast<int>(kShown / flog.cell), uchar{255});
  for (int y = 0; y < raster.height; ++y) {
    for (int x = 0; x < raster.width; ++x) {
      const double wx = raster.x_of(x), wy = raster.y_of(y);
      if (std::abs(wx) < 0.3 && std::abs(wy) < 0.2) sum += raster.M(y, x);
      const cv::Point pixel(static_cast<int>((wx + kShown / 2) / flog.cell),
                            static_cast<int>((kShown / 2 - wy) / flog.cell));
      if (std::abs(wx) < kShown / 2 && std::abs(wy) < kShown / 2) {
        picture(pixel) = cv::saturate_cast<uchar>(255 * (1 - raster.M(y, x)));
      }
    }
  }
  cv::resize(picture, picture, {}, 4, 4, cv::INTER_NEAREST);
  cv::imwrite(fmt::format("boxes_{}.png", path), picture);
  const double distance = sequence.truth.front().translation().head<2>().norm();
  print_row({path, fmt::format("{:.1f} m", distance), fmt::format("{}", sequence.pairs.size()),
             fmt::format("{:.1f}° {:.0f} mm", rotation_angle(error) * 180 / M_PI, error.translation().norm() * 1000),
             fmt::format("{:.2f} cells", sum * flog.cell / (2 * (0.4 + 0.28)))});
}

}  // namespace

void print_mapping_tables() {
  fmt::print("\n## Chapter 6: map of two boxes (figure 6.4)\n\n");
  print_heading(
      {"path", "distance at first", "views", "error of the last pose", "thickness of the larger box's sides"});
  print_boxes("circle");
  print_boxes("circle-far");
}

}  // namespace iris::thesis
