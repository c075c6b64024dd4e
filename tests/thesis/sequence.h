// Simulated sequences like those of the thesis: small images, hand-held, 8 frames a second unless said otherwise.
#pragma once

#include <string>
#include <vector>

#include "iris/motion/features.h"
#include "iris/simulate/simulator.h"
#include "iris/stereo/mwmf.h"
#include "iris/types/stereo_frame.h"

namespace iris::thesis {

// Images of 320 x 240 px; a disparity of 4 px is 10 m away, as with the thesis's camera (5.4.1).
simulate::SimulateOptions thesis_camera();

// MWMF without interpolation, 64 disparities.
stereo::MwmfOptions thesis_stereo();

// SAD 9 x 9 on LoG filtered images and the left/right check alone, with which the thesis compares
// (3.3.3, 3.5.2, 7.4.1).
stereo::MwmfOptions plain_correlation();

struct Sequence {
  std::string name;
  RectifiedCamera camera;
  double rate = 0;  // [1/s]
  std::vector<StereoPair> pairs;
  std::vector<Pose> truth;  // world_from_cam, rectified left camera
};

Sequence simulate_sequence(const std::string& scene, const simulate::SimulateOptions& options);

// What motion needs of every `stride`-th view of the sequence.
std::vector<motion::ViewFeatures> features_of(const Sequence& sequence, const stereo::MwmfOptions& stereo,
                                              const motion::ScsOptions& options, int stride = 1);

// Prints one row of a Markdown table.
void print_row(const std::vector<std::string>& cells);
// The heading of a table: names and the line under them.
void print_heading(const std::vector<std::string>& names);

}  // namespace iris::thesis
