// Made-up surfaces. Integer hashes and plain arithmetic alone: the same bytes for the same seed on every machine.
// Every texture repeats without a seam, except pictures (which are shown once).
#pragma once

#include <cstdint>
#include <opencv2/core.hpp>
#include <vector>

namespace iris::simulate {

struct Texture {
  cv::Mat3b image;               // BGR
  double width = 1, height = 1;  // [m] that the image covers
};

// [m] of a surface that is to be covered; whole tiles, bricks, … may cover a little more. The defaults are those of
// things whose surfaces share one texture; what is larger should have a texture of its own, since what repeats is
// mistaken for the same place.
struct Extent {
  double width = 2.56, height = 2.56;
};

uint32_t hash(uint32_t a, uint32_t b, uint32_t c = 0, uint32_t d = 0);

// A sequence of random numbers (those of the standard library differ from machine to machine).
class Random {
 public:
  explicit Random(uint32_t seed) : seed_(seed) {}
  uint32_t next() { return hash(seed_, count_++); }
  double uniform() { return next() * 0x1p-32; }  // [0, 1)
  double uniform(double low, double high) { return low + (high - low) * uniform(); }
  int below(int n) { return static_cast<int>(uniform() * n); }

 private:
  uint32_t seed_, count_ = 0;
};

// One layer of noise: random values on a lattice of columns x rows cells over the image, blended between.
struct Octave {
  int columns, rows;
  float amplitude;
};

// Sum of octaves that repeats at the image's borders; mean 0, standard deviation 1.
cv::Mat1f fractal_noise(int width, int height, const std::vector<Octave>& octaves, uint32_t seed);

// Octaves of square cells from `coarsest` down to `finest` [px], each of half the size of the one before; amplitudes
// fall by `fall` with each.
std::vector<Octave> octaves(int width, int height, int coarsest, int finest, float fall = 1);

// Surfaces. `contrast`: standard deviation of the brightness relative to the colour.
Texture plaster(uint32_t seed, const cv::Vec3b& colour, double contrast, const Extent& extent = {});
Texture wallpaper(uint32_t seed, const cv::Vec3b& ground, const cv::Vec3b& pattern,
                  const Extent& extent = {});                                   // scattered blossoms and stalks
Texture stripes(const cv::Vec3b& light, const cv::Vec3b& dark, double period);  // exactly alike (thesis fig. 5.9)
Texture exact_tiles(uint32_t seed, const cv::Vec3b& colour, double edge);       // one tile, exactly repeated
// Each differs from the others; `edge` [m] and `pixels` of one.
Texture tiles(uint32_t seed, const cv::Vec3b& colour, const cv::Vec3b& other, double edge, int pixels,
              const Extent& extent = {});
Texture brick(uint32_t seed, const cv::Vec3b& colour, const Extent& extent = {});
Texture parquet(uint32_t seed, const cv::Vec3b& colour, const Extent& extent = {});
Texture wood(uint32_t seed, const cv::Vec3b& colour, const Extent& extent = {1.28, 1.28});  // grain along u
Texture fabric(uint32_t seed, const cv::Vec3b& colour, const cv::Vec3b& other);             // checked
Texture carpet(uint32_t seed, const cv::Vec3b& colour, const cv::Vec3b& other, const Extent& extent = {});
Texture granite(uint32_t seed, const cv::Vec3b& colour, int pixels = 256);  // hard fine grains: worktop, gravel, leaves
Texture grass(uint32_t seed, int pixels = 1024, double metres = 3);
Texture paving(uint32_t seed, int pixels = 1024);
Texture bark(uint32_t seed, int pixels = 256);

// Pictures, shown once.
Texture landscape(uint32_t seed, double width, double height);
Texture abstract_painting(uint32_t seed, double width, double height);
Texture printed_page(uint32_t seed, double width, double height);  // poster, paper: lines and figures
Texture chalk_board(uint32_t seed, double width, double height);
Texture view_outside(uint32_t seed, double width, double height);  // bright, for windows
Texture rug(uint32_t seed, double width, double height);

// Backs of books side by side: book i covers [starts[i], starts[i + 1]) metres of the width.
struct BookBacks {
  Texture texture;
  std::vector<double> starts;
};
BookBacks book_backs(uint32_t seed);

}  // namespace iris::simulate
