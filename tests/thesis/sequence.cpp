#include "thesis/sequence.h"

#include <fmt/format.h>

#include "iris/core/parallel.h"
#include "iris/rectify/rectifier.h"

namespace iris::thesis {

simulate::SimulateOptions thesis_camera() {
  simulate::SimulateOptions options;
  options.rate = 8;
  options.width = 320;
  options.height = 240;
  options.fov = 60;          // f = 277 px
  options.baseline = 0.144;  // f t / 4 px = 10 m
  return options;
}

stereo::MwmfOptions thesis_stereo() {
  stereo::MwmfOptions options;
  options.disparities = 64;
  options.interpolation = "off";
  return options;
}

stereo::MwmfOptions plain_correlation() {
  stereo::MwmfOptions options;
  options.preset = "thesis";
  options.apply_preset();
  options.measure = "sad";
  options.windows = 1;
  options.window_width = options.window_height = 9;
  options.log_sigma = 1.0;
  options.min_margin = 0;
  options.borders = "off";
  options.min_segment = 0;
  options.interpolation = "off";
  return options;
}

Sequence simulate_sequence(const std::string& scene_name, const simulate::SimulateOptions& options) {
  const simulate::Scene scene = simulate::make_scene(scene_name, options.seed);
  const simulate::SimulatedPath path = simulate::make_path(scene, options);
  const simulate::Simulator simulator(scene, path, options);
  const rectify::Rectifier rectifier(simulator.calibration());
  Sequence sequence{
      .name = fmt::format("{}, {}", scene_name, path.name), .camera = rectifier.camera(), .rate = options.rate};
  sequence.pairs.resize(static_cast<size_t>(simulator.frames()));
  sequence.truth.resize(sequence.pairs.size());
  Pose left_from_rect = Pose::Identity();
  left_from_rect.linear() = rectifier.rect_from_left().transpose();
  parallel_chunks(0, simulator.frames(), 1, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      sequence.pairs[static_cast<size_t>(i)] = rectifier.rectify(simulator.frame(i));
      sequence.truth[static_cast<size_t>(i)] = simulator.world_from_left(i) * left_from_rect;
    }
  });
  return sequence;
}

std::vector<motion::ViewFeatures> features_of(const Sequence& sequence, const stereo::MwmfOptions& stereo,
                                              const motion::ScsOptions& options, int stride) {
  std::vector<motion::ViewFeatures> features((sequence.pairs.size() + static_cast<size_t>(stride) - 1) /
                                             static_cast<size_t>(stride));
  parallel_chunks(0, static_cast<int>(features.size()), 1, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      const StereoPair& pair = sequence.pairs[static_cast<size_t>(i) * static_cast<size_t>(stride)];
      features[static_cast<size_t>(i)] = motion::extract_features(
          pair.left, stereo::mwmf(pair.left, pair.right, stereo), sequence.camera, options, pair.right);
    }
  });
  return features;
}

void print_row(const std::vector<std::string>& cells) { fmt::print("| {} |\n", fmt::join(cells, " | ")); }

void print_heading(const std::vector<std::string>& names) {
  print_row(names);
  print_row(std::vector<std::string>(names.size(), "---"));
}

}  // namespace iris::thesis
