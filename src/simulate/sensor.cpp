#include "sensor.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace iris::simulate {
namespace {

// SplitMix64 (Steele, Lea, Flood 2014) as a function of its position in the sequence: any number can be had at any
// time.
uint64_t random_bits(uint64_t key, uint64_t position) {
  uint64_t z = key + (position + 1) * 0x9e3779b97f4a7c15u;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
  return z ^ (z >> 31);
}

// Phase of a slow wave, [0, 2 pi).
double phase(uint64_t seed, uint64_t which) {
  return static_cast<double>(random_bits(seed, which) >> 11) * 0x1p-53 * 2 * std::numbers::pi;
}

}  // namespace

Sensor::Sensor(const SimulateOptions& options)
    : width_(options.width),
      height_(options.height),
      seed_(random_bits(0, static_cast<uint64_t>(options.seed))),
      exposure_drift_(options.exposure_drift / 100),
      gain_difference_(options.gain_difference / 100),
      vignetting_(options.vignetting / 100),
      noise_sigma_(options.snr > 0 ? 255 * std::pow(10.0, -options.snr / 20) : 0) {}

double Sensor::gain(int camera, double t) const {
  constexpr double kTurn = 2 * std::numbers::pi;
  const double left = 1 + exposure_drift_ * std::sin(kTurn * t / 19 + phase(seed_, 0));
  if (camera == 0) return left;
  return left * (1 + gain_difference_ * (1 + std::sin(kTurn * t / 13 + phase(seed_, 1)) / 2));
}

double Sensor::vignetting(int x, int y) const {
  const double cx = (width_ - 1) / 2.0, cy = (height_ - 1) / 2.0;
  return 1 - vignetting_ * ((x - cx) * (x - cx) + (y - cy) * (y - cy)) / (cx * cx + cy * cy);
}

void Sensor::record_row(const float* light, double factor, int channels, int frame_idx, int camera, int row,
                        uint8_t* values) const {
  const int count = width_ * channels;
  const auto value_at = [&](int i) { return static_cast<double>(light[i]) * factor * vignetting(i / channels, row); };
  const auto rounded = [](double value) {
    return static_cast<uint8_t>(std::floor(std::clamp(value, 0.0, 255.0) + 0.5));
  };
  if (noise_sigma_ == 0) {
    for (int i = 0; i < count; ++i) values[i] = rounded(value_at(i));
    return;
  }
  const uint64_t key =
      random_bits(random_bits(seed_, 2 + static_cast<uint64_t>(frame_idx)), static_cast<uint64_t>(camera));
  const uint64_t pairs = static_cast<uint64_t>(count + 1) / 2;
  for (int i = 0; i < count; i += 2) {
    // Box and Muller: two normal numbers of two uniform ones. 32 bits reach 6.7 standard deviations.
    const uint64_t bits = random_bits(key, static_cast<uint64_t>(row) * pairs + static_cast<uint64_t>(i) / 2);
    const double u = (static_cast<double>(bits >> 32) + 0.5) * 0x1p-32;
    const double angle = static_cast<double>(bits & 0xffffffffu) * 0x1p-32 * 2 * std::numbers::pi;
    const double radius = noise_sigma_ * std::sqrt(-2 * std::log(u));
    values[i] = rounded(value_at(i) + radius * std::cos(angle));
    if (i + 1 < count) values[i + 1] = rounded(value_at(i + 1) + radius * std::sin(angle));
  }
}

}  // namespace iris::simulate
