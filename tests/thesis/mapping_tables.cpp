// Chapter 6: two boxes circled near and far (fig. 6.4).
#include <fmt/format.h>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "iris/mapping/flog.h"
#include "iris/motion/chain.h"
#include "iris/motion/scs.h"
#include "thesis/sequence.h"
#include "thesis/tables.h"

namespace iris::thesis {
namespace {

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
  flog.bottom = 0.82;  // above the table, up to the top of the larger box
  flog.height = 0.3;
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

  // Thickness of the sides: cells whose map value exceeds 1/2, within 0.6 m of the boxes.
  double occupied = 0;
  cv::Mat1b picture(raster.height, raster.width);
  for (int y = 0; y < raster.height; ++y) {
    for (int x = 0; x < raster.width; ++x) {
      picture(y, x) = cv::saturate_cast<uchar>(255 * (1 - raster.M(y, x)));
      if (std::hypot(raster.x_of(x), raster.y_of(y)) < 0.6) occupied += raster.M(y, x);
    }
  }
  cv::imwrite(fmt::format("boxes_{}.png", path), picture);
  print_row({path, fmt::format("{}", sequence.pairs.size()),
             fmt::format("{:.1f}° {:.0f} mm", rotation_angle(error) * 180 / M_PI, error.translation().norm() * 1000),
             fmt::format("{:.0f} cells", occupied)});
}

}  // namespace

void print_mapping_tables() {
  fmt::print("\n## Chapter 6: map of two boxes (figure 6.4)\n\n");
  print_heading({"path", "views", "error of the last pose", "sum of the map values around the boxes"});
  print_boxes("circle");
  print_boxes("circle-far");
}

}  // namespace iris::thesis
