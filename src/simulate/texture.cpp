#include "texture.h"

#include <algorithm>
#include <cmath>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

namespace iris::simulate {

namespace {

constexpr int kRows = 16;  // a chunk of parallel work

using Vec3f = cv::Vec3f;

Vec3f mix(const Vec3f& a, const Vec3f& b, float t) { return a * (1 - t) + b * t; }
Vec3f colour_of(const cv::Vec3b& c) { return {float(c[0]), float(c[1]), float(c[2])}; }
float step(float low, float high, float x) {
  const float t = std::clamp((x - low) / (high - low), 0.0f, 1.0f);
  return t * t * (3 - 2 * t);
}
// A bump of height 1 about 0 that falls to 0 within `width` on both sides.
float bump(float x, float width) { return 1 - step(0, width, std::abs(x)); }

// Wave of period 1 and range [-1, 1], close to a sine.
float wave(float x) {
  x -= std::floor(x);
  const float t = x < 0.5f ? 4 * x - 1 : 3 - 4 * x;
  return t * (1.5f - 0.5f * t * t);
}

template <class Paint>
cv::Mat3b paint(int width, int height, const Paint& colour_at) {
  cv::Mat3b image(height, width);
  parallel_chunks(0, height, kRows, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; ++x) {
        const Vec3f c = colour_at(x, y);
        for (int i = 0; i < 3; ++i) {
          image(y, x)[i] = static_cast<uint8_t>(std::clamp(std::floor(c[i] + 0.5f), 0.0f, 255.0f));
        }
      }
    }
  });
  return image;
}

float random_unit(uint32_t seed, int a, int b = 0) {  // [0, 1)
  return static_cast<float>(hash(seed, static_cast<uint32_t>(a), static_cast<uint32_t>(b)) >> 8) * 0x1p-24f;
}
cv::Vec3f random_colour(Random& random, double low, double high) {
  const double level = random.uniform(low, high), warm = random.uniform(-50, 50), green = random.uniform(-30, 30);
  return {float(level - warm), float(level + green), float(level + warm)};
}

constexpr double kTexel = 0.0025;  // [m] of surfaces

// random_unit of 0, 1, … count - 1 (times `rows`).
std::vector<float> random_units(uint32_t seed, int count, int rows = 0) {
  std::vector<float> units;
  for (int b = 0; b < std::max(1, rows); ++b) {
    for (int a = 0; a < count; ++a) units.push_back(random_unit(seed, a, b));
  }
  return units;
}

int pixels_for(double metres, double texel) { return std::max(16, static_cast<int>(metres / texel + 1e-6)); }

// How many pieces cover a length.
int whole(double metres, double piece) { return std::max(1, static_cast<int>(std::ceil(metres / piece - 1e-6))); }

// Rows of blocks (bricks, planks, paving): which block a pixel lies in and how far it is from the block's border [px].
struct Block {
  int index, row;
  float along;   // [px] from its left end
  float border;  // [px] distance to it
};
struct Blocks {
  int width, height, columns, rows;  // [px], blocks a row, rows
  float shift;                       // of each row against the one before, in blocks
  Block at(int x, int y) const {
    const float block_width = float(width) / columns, block_height = float(height) / rows;
    const int row = y * rows / height;
    float u = x / block_width + row * shift;
    u -= columns * std::floor(u / columns);
    const int column = std::min(static_cast<int>(u), columns - 1);
    const float along = (u - column) * block_width, down = y - row * block_height;
    return {row * columns + column, row, along,
            std::min({along, block_width - along, down + 0.5f, block_height - down - 0.5f})};
  }
};

}  // namespace

uint32_t hash(uint32_t a, uint32_t b, uint32_t c, uint32_t d) {
  uint32_t h = 0x9E3779B9u;
  for (const uint32_t value : {a, b, c, d}) {
    h ^= value;
    h *= 0x85EBCA6Bu;
    h ^= h >> 15;
    h *= 0xC2B2AE35u;
    h ^= h >> 13;
  }
  return h ^ (h >> 16);
}

cv::Mat1f fractal_noise(int width, int height, const std::vector<Octave>& octaves, uint32_t seed) {
  struct Lattice {
    cv::Mat1f values;
    std::vector<int> left, right;
    std::vector<float> weight;
    float amplitude;
  };
  std::vector<Lattice> lattices;
  for (size_t i = 0; i < octaves.size(); ++i) {
    const Octave& octave = octaves[i];
    IRIS_CHECK(octave.columns > 0 && octave.rows > 0);
    Lattice lattice{.values = cv::Mat1f(octave.rows, octave.columns), .amplitude = octave.amplitude};
    for (int y = 0; y < octave.rows; ++y) {
      for (int x = 0; x < octave.columns; ++x) {
        lattice.values(y, x) = 2 * random_unit(hash(seed, static_cast<uint32_t>(i)), x, y) - 1;
      }
    }
    for (int x = 0; x < width; ++x) {
      const float u = (x + 0.5f) * octave.columns / width;
      const int cell = std::min(static_cast<int>(u), octave.columns - 1);
      const float t = u - cell;
      lattice.left.push_back(cell);
      lattice.right.push_back((cell + 1) % octave.columns);
      lattice.weight.push_back(t * t * (3 - 2 * t));
    }
    lattices.push_back(std::move(lattice));
  }
  cv::Mat1f noise(height, width, 0.0f);
  std::vector<double> sums(static_cast<size_t>(height)), squares(static_cast<size_t>(height));
  parallel_chunks(0, height, kRows, [&](int begin, int end) {
    std::vector<float> blended;
    for (int y = begin; y < end; ++y) {
      float* row = noise[y];
      for (const Lattice& lattice : lattices) {
        const int rows = lattice.values.rows, columns = lattice.values.cols;
        const float v = (y + 0.5f) * rows / height;
        const int cell = std::min(static_cast<int>(v), rows - 1);
        const float t = v - cell, s = t * t * (3 - 2 * t);
        const float *upper = lattice.values[cell], *lower = lattice.values[(cell + 1) % rows];
        blended.resize(static_cast<size_t>(columns));
        for (int x = 0; x < columns; ++x) {
          blended[static_cast<size_t>(x)] = lattice.amplitude * (upper[x] + s * (lower[x] - upper[x]));
        }
        for (int x = 0; x < width; ++x) {
          const float a = blended[static_cast<size_t>(lattice.left[static_cast<size_t>(x)])];
          const float b = blended[static_cast<size_t>(lattice.right[static_cast<size_t>(x)])];
          row[x] += a + lattice.weight[static_cast<size_t>(x)] * (b - a);
        }
      }
      double sum = 0, square = 0;
      for (int x = 0; x < width; ++x) sum += row[x], square += double(row[x]) * row[x];
      sums[static_cast<size_t>(y)] = sum;
      squares[static_cast<size_t>(y)] = square;
    }
  });
  double sum = 0, square = 0;
  for (int y = 0; y < height; ++y) sum += sums[static_cast<size_t>(y)], square += squares[static_cast<size_t>(y)];
  const double count = double(width) * height, mean = sum / count;
  const float shift = static_cast<float>(mean);
  const float scale = static_cast<float>(1 / std::sqrt(std::max(square / count - mean * mean, 1e-12)));
  parallel_chunks(0, height, kRows, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; ++x) noise(y, x) = (noise(y, x) - shift) * scale;
    }
  });
  return noise;
}

std::vector<Octave> octaves(int width, int height, int coarsest, int finest, float fall) {
  std::vector<Octave> result;
  float amplitude = 1;
  for (int cell = coarsest; cell >= finest; cell /= 2, amplitude *= fall) {
    result.push_back({std::max(1, width / cell), std::max(1, height / cell), amplitude});
  }
  return result;
}

Texture plaster(uint32_t seed, const cv::Vec3b& colour, double contrast, const Extent& extent) {
  const int w = pixels_for(extent.width, kTexel), h = pixels_for(extent.height, kTexel);
  const cv::Mat1f noise = fractal_noise(w, h, octaves(w, h, std::min({w / 8, h / 8, 128}), 2, 1.04f), seed);
  const Vec3f base = colour_of(colour);
  const float amplitude = static_cast<float>(contrast);
  return {paint(w, h, [&](int x, int y) { return base * (1 + amplitude * noise(y, x)); }), w * kTexel, h * kTexel};
}

Texture wallpaper(uint32_t seed, const cv::Vec3b& ground, const cv::Vec3b& pattern, const Extent& extent) {
  constexpr double kCell = 2.56 / 12;  // [m] a blossom each, at its own place in its cell
  const int columns = whole(extent.width, kCell), rows = whole(extent.height, kCell);
  const int w = pixels_for(columns * kCell, kTexel), h = pixels_for(rows * kCell, kTexel);
  const cv::Mat1f noise = fractal_noise(w, h, octaves(w, h, 128, 2, 1), seed);
  const Vec3f base = colour_of(ground), ink = colour_of(pattern);
  const float cell = static_cast<float>(kCell / kTexel);
  const std::vector<float> right = random_units(seed + 1, columns, rows), down = random_units(seed + 2, columns, rows),
                           large = random_units(seed + 3, columns, rows);
  return {paint(w, h,
                [&](int x, int y) {
                  float covered = 0;
                  for (int j = -1; j <= 1; ++j) {
                    for (int i = -1; i <= 1; ++i) {
                      const int cx = static_cast<int>(x / cell) + i, cy = static_cast<int>(y / cell) + j;
                      const size_t k = static_cast<size_t>((cy + rows) % rows * columns + (cx + columns) % columns);
                      const float px = (cx + 0.2f + 0.6f * right[k]) * cell, py = (cy + 0.2f + 0.6f * down[k]) * cell;
                      const float dx = (x - px) / cell, dy = (y - py) / cell;
                      const float size = 0.16f + 0.16f * large[k];
                      // Five petals: the radius varies with the direction.
                      const float stalk = dy > 0 && dy < 0.6f ? 0.6f * bump(dx - 0.2f * dy * dy, 0.03f) : 0;
                      covered = std::max(covered, stalk);
                      const float r2 = dx * dx + dy * dy;
                      if (r2 > 0.25f) continue;
                      const float r = std::sqrt(r2) + 1e-6f, c = dx / r, s = dy / r;
                      const float five = c * (16 * c * c * c * c - 20 * c * c + 5) * 0.6f + 0.4f * s;
                      covered = std::max(covered, 0.9f * (1 - step(size * 0.8f, size * 0.9f, r / (1 + 0.3f * five))));
                    }
                  }
                  return mix(base, ink, covered) * (1 + 0.055f * noise(y, x));
                }),
          columns * kCell, rows * kCell};
}

Texture stripes(const cv::Vec3b& light, const cv::Vec3b& dark, double period) {
  constexpr int kPixels = 64;
  const Vec3f a = colour_of(light), b = colour_of(dark);
  return {paint(kPixels, kPixels,
                [&](int x, int y) {
                  const float u = (x + 0.5f) / kPixels, v = (y + 0.5f) / kPixels;
                  const float line = std::max(step(0.3f, 0.36f, u) - step(0.64f, 0.7f, u), bump(u - 0.1f, 0.05f));
                  const float spot =
                      1 - step(0.08f, 0.12f, std::sqrt((u - 0.85f) * (u - 0.85f) + (v - 0.5f) * (v - 0.5f)));
                  return mix(a, b, std::max(line, spot));
                }),
          period, period};
}

Texture exact_tiles(uint32_t seed, const cv::Vec3b& colour, double edge) {
  constexpr int kPixels = 96;
  const cv::Mat1f noise = fractal_noise(kPixels, kPixels, octaves(kPixels, kPixels, 32, 4), seed);
  const Vec3f base = colour_of(colour), grout(120, 125, 130);
  return {paint(kPixels, kPixels,
                [&](int x, int y) {
                  const float border = std::min({x + 0.5f, y + 0.5f, kPixels - x - 0.5f, kPixels - y - 0.5f});
                  const float u = (x + 0.5f) / kPixels - 0.5f, v = (y + 0.5f) / kPixels - 0.5f;
                  const float ring = bump(std::sqrt(u * u + v * v) - 0.3f, 0.05f);
                  const Vec3f tile = base * (1 + 0.05f * noise(y, x)) * (1 - 0.35f * ring);
                  return mix(grout, tile, step(1.5f, 3, border));
                }),
          edge, edge};
}

Texture tiles(uint32_t seed, const cv::Vec3b& colour, const cv::Vec3b& other, double edge, int pixels,
              const Extent& extent) {
  // Two of them make one turn of the chequered pattern.
  const int columns = 2 * whole(extent.width, 2 * edge), rows = 2 * whole(extent.height, 2 * edge);
  const int w = columns * pixels, h = rows * pixels;
  const cv::Mat1f noise = fractal_noise(w, h, octaves(w, h, pixels / 2, 4, 0.9f), seed);
  const Blocks blocks{w, h, columns, rows, 0};
  const std::vector<float> tones = random_units(seed + 7, columns * rows);
  const Vec3f a = colour_of(colour), b = colour_of(other), grout = mix(a, Vec3f(90, 95, 100), 0.7f);
  return {paint(w, h,
                [&](int x, int y) {
                  const Block block = blocks.at(x, y);
                  const bool second = (block.index / columns + block.index % columns) % 2;
                  const float tone = 1 + 0.16f * (tones[static_cast<size_t>(block.index)] - 0.5f);
                  const Vec3f tile = (second ? b : a) * (tone * (1 + 0.08f * noise(y, x)));
                  return mix(grout * (1 + 0.05f * noise(y, x)), tile, step(1, 2.5f, block.border));
                }),
          edge * columns, edge * rows};
}

Texture brick(uint32_t seed, const cv::Vec3b& colour, const Extent& extent) {
  // Bricks of 0.25 x 0.0833 m, with joints of 1 cm; every second row is shifted by half a brick.
  constexpr double kLong = 0.25, kHigh = 0.25 / 3;
  const int columns = whole(extent.width, kLong), rows = 2 * whole(extent.height, 2 * kHigh);
  const int w = pixels_for(columns * kLong, kTexel), h = pixels_for(rows * kHigh, kTexel);
  const cv::Mat1f noise = fractal_noise(w, h, octaves(w, h, 64, 4, 0.95f), seed);
  const Blocks blocks{w, h, columns, rows, 0.5f};
  const std::vector<float> tones = random_units(seed + 5, columns * rows),
                           warms = random_units(seed + 6, columns * rows);
  const float joint = static_cast<float>(0.005 / kTexel);
  const Vec3f base = colour_of(colour), mortar(165, 172, 176);
  return {paint(w, h,
                [&](int x, int y) {
                  const Block block = blocks.at(x, y);
                  const float tone = 0.75f + 0.5f * tones[static_cast<size_t>(block.index)];
                  const float warm = 12 * (warms[static_cast<size_t>(block.index)] - 0.5f);
                  const Vec3f face = base * (tone * (1 + 0.09f * noise(y, x))) + Vec3f(-warm, 0, warm);
                  const float edge = block.border + 0.6f * noise(y, x);
                  return mix(mortar * (1 + 0.05f * noise(y, x)), face, step(joint - 1, joint + 1, edge));
                }),
          columns * kLong, rows * kHigh};
}

Texture parquet(uint32_t seed, const cv::Vec3b& colour, const Extent& extent) {
  constexpr double kLong = 0.6, kWide = 0.12;  // [m] a plank
  const int columns = whole(extent.width, kLong), rows = whole(extent.height, kWide);
  const int w = pixels_for(columns * kLong, kTexel), h = pixels_for(rows * kWide, kTexel);
  constexpr int kGrain = 1024;  // [px] each plank is cut from another place of it
  const cv::Mat1f grain = fractal_noise(
      kGrain, kGrain,
      {{4, 64, 0.7f}, {8, kGrain / 8, 0.8f}, {16, kGrain / 4, 0.8f}, {64, kGrain / 2, 0.6f}, {48, 96, 0.5f}}, seed);
  const Blocks blocks{w, h, columns, rows, std::round(0.37f * rows) / rows};
  const std::vector<float> right = random_units(seed + 3, columns * rows),
                           down = random_units(seed + 4, columns * rows),
                           tones = random_units(seed + 5, columns * rows);
  const Vec3f base = colour_of(colour);
  return {paint(w, h,
                [&](int x, int y) {
                  const Block block = blocks.at(x, y);
                  const size_t plank = static_cast<size_t>(block.index);
                  const int dx = static_cast<int>(right[plank] * kGrain), dy = static_cast<int>(down[plank] * kGrain);
                  const float tone = 0.8f + 0.36f * tones[plank];
                  const float n = grain((y + dy) % kGrain, (static_cast<int>(block.along) + dx) % kGrain);
                  return base * (tone * (1 + 0.11f * n) * (0.45f + 0.55f * step(0, 1.8f, block.border)));
                }),
          columns * kLong, rows * kWide};
}

Texture wood(uint32_t seed, const cv::Vec3b& colour, const Extent& extent) {
  const int width = pixels_for(extent.width, kTexel), height = pixels_for(extent.height, kTexel);
  const int parts = std::max(1, width / 512);  // a grain is 0.02 m to 0.64 m long
  const cv::Mat1f grain = fractal_noise(width, height,
                                        {{2 * parts, std::max(2, height / 32), 0.8f},
                                         {4 * parts, height / 16, 0.8f},
                                         {8 * parts, height / 8, 0.8f},
                                         {24 * parts, height / 4, 0.8f},
                                         {64 * parts, height / 3, 0.5f},
                                         {64 * parts, std::max(2, height / 8), 0.4f}},
                                        seed);
  const Vec3f base = colour_of(colour);
  return {paint(width, height,
                [&](int x, int y) {
                  const float n = grain(y, x), vein = bump(n - 1.1f, 0.35f);
                  return base * (1 + 0.12f * n - 0.18f * vein);
                }),
          width * kTexel, height * kTexel};
}

Texture fabric(uint32_t seed, const cv::Vec3b& colour, const cv::Vec3b& other) {
  constexpr int kPixels = 512, kChecks = 2;  // checks a side
  const cv::Mat1f noise = fractal_noise(kPixels, kPixels, octaves(kPixels, kPixels, 64, 2, 0.9f), seed);
  const Vec3f a = colour_of(colour), b = colour_of(other);
  return {paint(kPixels, kPixels,
                [&](int x, int y) {
                  const float u = float(x * kChecks % kPixels) / kPixels, v = float(y * kChecks % kPixels) / kPixels;
                  // Stripes of uneven widths in both directions, as in a checked cloth.
                  const float across = step(0.55f, 0.6f, u) * (1 - step(0.8f, 0.85f, u)) + 0.7f * bump(u - 0.2f, 0.04f);
                  const float along =
                      step(0.5f, 0.55f, v) * (1 - step(0.72f, 0.77f, v)) + 0.7f * bump(v - 0.25f, 0.03f);
                  return mix(a, b, std::min(1.0f, 0.45f * (across + along))) * (1 + 0.1f * noise(y, x));
                }),
          kPixels * kTexel, kPixels * kTexel};
}

Texture carpet(uint32_t seed, const cv::Vec3b& colour, const cv::Vec3b& other, const Extent& extent) {
  const int w = pixels_for(extent.width, kTexel), h = pixels_for(extent.height, kTexel);
  const cv::Mat1f noise = fractal_noise(w, h, octaves(w, h, 64, 2, 0.95f), seed);
  const cv::Mat1f patches = fractal_noise(w, h, octaves(w, h, 128, 16, 0.9f), seed + 1);
  const Vec3f a = colour_of(colour), b = colour_of(other);
  return {paint(w, h,
                [&](int x, int y) {
                  return mix(a, b, 0.8f * step(0.1f, 1.2f, patches(y, x))) * (1 + 0.12f * noise(y, x));
                }),
          w * kTexel, h * kTexel};
}

Texture granite(uint32_t seed, const cv::Vec3b& colour, int pixels) {
  const cv::Mat1f noise = fractal_noise(pixels, pixels, octaves(pixels, pixels, pixels / 8, 2, 1), seed);
  const Vec3f base = colour_of(colour);
  return {paint(pixels, pixels,
                [&](int x, int y) {
                  const float n = noise(y, x);
                  return base * (1 + 0.16f * n + 0.3f * step(1.2f, 1.6f, n) - 0.3f * step(1.0f, 1.5f, -n));
                }),
          pixels * 0.0025, pixels * 0.0025};
}

Texture grass(uint32_t seed, int pixels, double metres) {
  const cv::Mat1f fine =
      fractal_noise(pixels, pixels,
                    {{pixels / 3, pixels / 8, 1}, {pixels / 6, pixels / 12, 1}, {pixels / 8, pixels / 4, 0.8f}}, seed);
  const cv::Mat1f coarse = fractal_noise(pixels, pixels, octaves(pixels, pixels, 256, 16, 0.9f), seed + 1);
  return {paint(pixels, pixels,
                [&](int x, int y) {
                  const Vec3f ground = mix(Vec3f(52, 118, 96), Vec3f(70, 140, 150), step(-1, 2, coarse(y, x)));
                  const Vec3f earth(70, 92, 112);
                  return mix(ground, earth, 0.7f * step(1.2f, 2, coarse(y, x))) *
                         (1 + 0.16f * fine(y, x) + 0.1f * coarse(y, x));
                }),
          metres, metres};
}

Texture paving(uint32_t seed, int pixels) {
  const cv::Mat1f noise = fractal_noise(pixels, pixels, octaves(pixels, pixels, pixels / 16, 4, 0.95f), seed);
  const Blocks blocks{pixels, pixels, 6, 8, 0.5f};
  return {paint(pixels, pixels,
                [&](int x, int y) {
                  const Block block = blocks.at(x, y);
                  const float tone = 0.8f + 0.4f * random_unit(seed + 5, block.index);
                  const Vec3f stone = Vec3f(138, 146, 150) * (tone * (1 + 0.09f * noise(y, x)));
                  return mix(Vec3f(60, 80, 72) * (1 + 0.1f * noise(y, x)), stone,
                             step(1.5f, 3.5f, block.border + 0.8f * noise(y, x)));
                }),
          2.4, 2.4};
}

Texture bark(uint32_t seed, int pixels) {
  const cv::Mat1f noise =
      fractal_noise(pixels, pixels, {{pixels / 16, 6, 1}, {pixels / 8, 16, 1}, {pixels / 4, 40, 0.8f}}, seed);
  return {paint(pixels, pixels, [&](int x, int y) { return Vec3f(68, 88, 108) * (1 + 0.22f * noise(y, x)); }), 0.8,
          0.8};
}

Texture landscape(uint32_t seed, double width, double height) {
  const int w = pixels_for(width, 0.0022), h = pixels_for(height, 0.0022);
  const cv::Mat1f noise = fractal_noise(w, h, octaves(w, h, std::max(8, h / 4), 2, 0.85f), seed);
  const cv::Mat1f ridges = fractal_noise(w, 4, {{3, 4, 1}, {7, 4, 0.5f}, {17, 4, 0.3f}, {41, 4, 0.15f}}, seed + 1);
  Random random(seed + 2);
  const Vec3f top = random_colour(random, 150, 210), low = random_colour(random, 190, 240);
  const std::vector<Vec3f> hills = {random_colour(random, 120, 160), random_colour(random, 80, 120),
                                    random_colour(random, 50, 90)};
  const float sun_x = static_cast<float>(random.uniform(0.2, 0.8)) * w, sun_y = 0.2f * h, sun = 0.08f * h;
  return {paint(w, h,
                [&](int x, int y) {
                  const float v = float(y) / h;
                  Vec3f colour = mix(top, low, v * 2 > 1 ? 1 : v * 2) * (1 + 0.05f * noise(y, x));
                  const float dx = x - sun_x, dy = y - sun_y;
                  colour = mix(colour, Vec3f(190, 240, 255), bump(std::sqrt(dx * dx + dy * dy) / sun - 0.5f, 0.6f));
                  for (int i = 0; i < 3; ++i) {
                    const float ridge = 0.42f + 0.17f * i + 0.07f * ridges(i, x);
                    if (v > ridge) {
                      colour = hills[static_cast<size_t>(i)] *
                               (1.1f - 0.6f * (v - ridge) + (0.08f + 0.05f * i) * noise(y, x));
                    }
                  }
                  return colour;
                }),
          width, height};
}

Texture abstract_painting(uint32_t seed, double width, double height) {
  const int w = pixels_for(width, 0.0022), h = pixels_for(height, 0.0022);
  const cv::Mat1f noise = fractal_noise(w, h, octaves(w, h, std::max(8, h / 4), 2, 0.9f), seed);
  Random random(seed + 1);
  struct Shape {
    float x, y, rx, ry;
    bool round;
    Vec3f colour;
  };
  std::vector<Shape> shapes;
  const Vec3f ground = random_colour(random, 120, 220);
  for (int i = 0; i < 24; ++i) {
    const float size = static_cast<float>(random.uniform(0.05, 0.3)) * (1 - i / 30.0f);
    shapes.push_back({static_cast<float>(random.uniform()), static_cast<float>(random.uniform()), size,
                      size * static_cast<float>(random.uniform(0.3, 1.5)), random.below(2) == 0,
                      random_colour(random, 30, 230)});
  }
  return {paint(w, h,
                [&](int x, int y) {
                  Vec3f colour = ground;
                  const float u = float(x) / w, v = float(y) / h;
                  for (const Shape& shape : shapes) {
                    const float dx = std::abs(u - shape.x) / shape.rx, dy = std::abs(v - shape.y) / shape.ry;
                    if (shape.round ? dx * dx + dy * dy < 1 : std::max(dx, dy) < 0.8f) colour = shape.colour;
                  }
                  return colour * (1 + 0.09f * noise(y, x));
                }),
          width, height};
}

Texture printed_page(uint32_t seed, double width, double height) {
  const int w = pixels_for(width, 0.0015), h = pixels_for(height, 0.0015);
  const cv::Mat1f noise = fractal_noise(w, h, octaves(w, h, std::max(8, h / 4), 2, 0.9f), seed);
  Random random(seed + 1);
  const Vec3f paper(225, 232, 236), ink(50, 45, 45), title = random_colour(random, 60, 130),
                                                     figure = random_colour(random, 90, 180);
  const int line = std::max(5, h / 42), split = 3 + random.below(5);
  return {
      paint(w, h,
            [&](int x, int y) {
              const float u = float(x) / w, v = float(y) / h;
              const int row = y / line;
              Vec3f colour = paper;
              if (u > 0.06f && u < 0.94f && v > 0.04f && v < 0.96f) {
                const bool is_title = v < 0.16f, is_figure = !is_title && (row / 7 + split) % 3 == 0 && u > 0.35f;
                if (is_figure) {
                  colour = mix(figure, paper, step(-0.3f, 0.3f, noise(y, x)));
                } else {
                  // Letters: blocks of random widths with spaces; lines end raggedly.
                  const int letter = x * 2 / line, part = y % line;
                  const bool printed = part > line / 4 && part < line * 5 / 6 &&
                                       random_unit(seed + 2, letter, is_title ? row / 3 : row) < 0.62f &&
                                       u < 0.7f + 0.24f * random_unit(seed + 3, row);
                  if (is_title ? random_unit(seed + 4, x / (line * 2), 0) < 0.7f && v > 0.07f && v < 0.13f : printed) {
                    colour = is_title ? title : ink;
                  }
                }
              }
              return colour * (1 + 0.035f * noise(y, x));
            }),
      width, height};
}

Texture chalk_board(uint32_t seed, double width, double height) {
  const int w = pixels_for(width, 0.003), h = pixels_for(height, 0.003);
  const cv::Mat1f wiped = fractal_noise(w, h, {{6, 4, 1}, {14, 10, 0.8f}, {40, 24, 0.7f}, {w / 5, h / 5, 0.7f}}, seed);
  const int line = 32;
  return {paint(w, h,
                [&](int x, int y) {
                  Vec3f colour = Vec3f(58, 78, 48) * (1 + 0.14f * wiped(y, x));
                  const int row = y / line, letter = x / 7;
                  const float u = float(x) / w;
                  const bool in_line = row > 0 && y < h - line && y % line > 8 && y % line < 26;
                  if (in_line && u > 0.05f && u < 0.25f + 0.65f * random_unit(seed + 1, row) &&
                      random_unit(seed + 2, letter / 5, row) < 0.75f) {
                    // A letter is a 4 x 6 pattern of dots.
                    const uint32_t glyph = hash(seed + 3, static_cast<uint32_t>(letter), static_cast<uint32_t>(row));
                    const int bit = (x % 7) / 2 + 4 * ((y % line - 8) / 3);
                    if (x % 7 < 6 && (glyph >> (bit % 24) & 1)) colour = mix(colour, Vec3f(225, 235, 235), 0.85f);
                  }
                  return colour;
                }),
          width, height};
}

Texture view_outside(uint32_t seed, double width, double height) {
  const int w = pixels_for(width, 0.003), h = pixels_for(height, 0.003);
  const cv::Mat1f noise = fractal_noise(w, h, octaves(w, h, std::max(8, h / 4), 2, 0.9f), seed);
  const cv::Mat1f crowns = fractal_noise(w, 2, {{5, 2, 1}, {13, 2, 0.7f}, {37, 2, 0.5f}, {w / 4, 2, 0.3f}}, seed + 1);
  return {paint(w, h,
                [&](int x, int y) {
                  const float u = float(x) / w, v = float(y) / h;
                  Vec3f colour = mix(Vec3f(250, 225, 195), Vec3f(252, 246, 238), v) * (1 + 0.02f * noise(y, x));
                  colour = mix(colour, Vec3f(255, 255, 255), 0.8f * step(0.4f, 1.4f, noise(y, x)) * (1 - v));
                  // Houses with windows, then trees before them.
                  const int house = static_cast<int>(u * 4);
                  const float roof = 0.38f + 0.2f * random_unit(seed + 2, house);
                  if (v > roof) {
                    const float tone = 0.75f + 0.25f * random_unit(seed + 3, house);
                    colour = Vec3f(190, 205, 225) * (tone * (1 + 0.05f * noise(y, x)));
                    const float cu = u * 24 - std::floor(u * 24), cv = (v - roof) * 14 - std::floor((v - roof) * 14);
                    if (cu > 0.3f && cu < 0.75f && cv > 0.3f && cv < 0.8f) colour = Vec3f(130, 120, 110);
                  }
                  if (v > 0.68f + 0.07f * crowns(0, x)) colour = Vec3f(110, 185, 150) * (1 + 0.2f * noise(y, x));
                  if (v > 0.9f) colour = Vec3f(130, 200, 170) * (1 + 0.1f * noise(y, x));
                  return colour;
                }),
          width, height};
}

Texture rug(uint32_t seed, double width, double height) {
  const int w = pixels_for(width, 0.003), h = pixels_for(height, 0.003);
  const cv::Mat1f noise = fractal_noise(w, h, octaves(w, h, std::max(8, h / 8), 2, 0.95f), seed);
  Random random(seed + 1);
  const Vec3f ground = random_colour(random, 70, 110), second = random_colour(random, 150, 210),
              third = random_colour(random, 40, 200);
  return {paint(w, h,
                [&](int x, int y) {
                  const float border = std::min({x, y, w - 1 - x, h - 1 - y}) * 0.003f;
                  const float u = (x - 0.5f * w) * 0.003f, v = (y - 0.5f * h) * 0.003f;
                  Vec3f colour = ground;
                  const float diamond = std::abs(u) / 0.16f + std::abs(v) / 0.22f;
                  const float cell = diamond - 2 * std::floor(diamond / 2);
                  if (cell < 0.5f) colour = second;
                  if (wave(u * 4.3f + 0.2f) * wave(v * 3.1f) > 0.55f) colour = third;
                  if (border < 0.16f)
                    colour = mix(third, second,
                                 border > 0.04f && border < 0.12f ? 0.8f * step(-0.2f, 0.2f, wave((u + v) * 8)) : 0);
                  return colour * (1 + 0.1f * noise(y, x));
                }),
          width, height};
}

BookBacks book_backs(uint32_t seed) {
  constexpr int kWidth = 1024, kHeight = 128;
  constexpr double kTexel = 0.002;
  const cv::Mat1f noise = fractal_noise(kWidth, kHeight, octaves(kWidth, kHeight, 32, 2, 0.9f), seed);
  struct Book {
    int start, end;
    Vec3f colour, label;
    int label_at;
  };
  Random random(seed + 1);
  std::vector<Book> books;
  BookBacks backs;
  for (int x = 0; x < kWidth;) {
    int end = x + 9 + random.below(18);
    if (end > kWidth - 9) end = kWidth;
    books.push_back({x, end, random_colour(random, 40, 210), random_colour(random, 30, 240), 10 + random.below(60)});
    backs.starts.push_back(x * kTexel);
    x = end;
  }
  backs.starts.push_back(kWidth * kTexel);
  std::vector<int> book_at(kWidth);
  for (size_t i = 0; i < books.size(); ++i) {
    for (int x = books[i].start; x < books[i].end; ++x) book_at[static_cast<size_t>(x)] = static_cast<int>(i);
  }
  backs.texture = {
      paint(kWidth, kHeight,
            [&](int x, int y) {
              const int index = book_at[static_cast<size_t>(x)];
              const Book& book = books[static_cast<size_t>(index)];
              Vec3f colour = book.colour;
              const bool inner = x > book.start + 2 && x < book.end - 3;
              if (inner && y > book.label_at && y < book.label_at + 44 && random_unit(seed + 2, y / 4, index) < 0.6f) {
                colour = book.label;
              }
              if (y == 8 || y == 9 || y == 118 || y == 119) colour = book.label;
              const float round = std::min(x - book.start, book.end - 1 - x) < 1 ? 0.6f : 1.0f;
              return colour * (round * (1 + 0.07f * noise(y, x)));
            }),
      kWidth * kTexel, kHeight * kTexel};
  return backs;
}

}  // namespace iris::simulate
