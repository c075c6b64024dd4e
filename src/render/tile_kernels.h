// The work of novel views that is the same for each pixel of a tile, as vectors.
#pragma once

#include <cstddef>
#include <cstdint>

namespace iris::render {

inline constexpr int kTile = 8;  // [px] side of the square of rays that are worked on together
inline constexpr size_t kTilePixels = kTile * kTile;
inline constexpr size_t kMostSources = 32;

// One float per pixel, row by row.
struct alignas(64) TileFloats {
  float at[kTilePixels];
};

// The rays of a tile row by row, then those just beyond its right side from the top, then those below it.
inline constexpr size_t kTileRays = 96;  // a multiple of all vectors' lengths
constexpr size_t ray_index(int x, int y) {
  const int index = x == kTile ? kTile * kTile + y : y == kTile ? kTile * kTile + kTile + 1 + x : y * kTile + x;
  return static_cast<size_t>(index);
}

// Directions in the novel camera frame.
struct alignas(64) TileRays {
  float x[kTileRays], y[kTileRays], z[kTileRays];
};

// The rays in the disparity space of a source (7.4): x = x0 + mx d, y = y0 + my d, where d [px] is the disparity with
// the camera's offset and (x0, y0) the ray's vanishing point.
struct alignas(64) TileLines {
  float x0[kTileRays], y0[kTileRays], mx[kTileRays], my[kTileRays];
  float per_qz[kTileRays];  // 1 / Qz; 0 = nearly parallel to the image plane or away from it: not a line of this kind
};

// Meetings of the rays with the surface of one source, as RayHit has them.
struct TileHits {
  TileFloats meeting;  // 1 = surface, -1 = back side, 0 = nothing
  TileFloats x, y, disparity, along;
};

// What the kernels need of a source.
struct TileSource {
  float rotation[9], translation[3];  // (7.2), row by row: rays of the novel camera in the frame of the source
  float f, cx, cy, baseline, disparity_offset;
  float distance;  // |T| [m]
  int width, height;
  const float* disparity;      // [px]
  ptrdiff_t disparity_stride;  // [floats]
  const uint8_t* image;
  ptrdiff_t image_stride;   // [bytes]
  int channels;             // 1 or 3
  const uint8_t* origin;    // nullptr = all measured
  ptrdiff_t origin_stride;  // [bytes]
};

struct TilePixels {
  TileFloats colour[3];  // BGR
  TileFloats depth;
  int16_t source[kTilePixels];  // -1 = hole
};

// A stretch of a ray in disparity space, where it is straight (7.4): points of the image and the disparities that the
// image has where the ray meets its surface, all [px].
struct Line {
  float x0, y0, d0, x1, y1, d1;
};
struct LineMeeting {
  int side = 0;         // 1 = surface, -1 = back side, 0 = nothing
  float travelled = 0;  // [px] from the line's begin along its longer axis
};
// Walks a line that is at least one pixel long and lies in the image, pixel by pixel along its longer axis (7.5).
LineMeeting walk_line(const float* disparity, ptrdiff_t stride, int width, int height, const Line& line,
                      float max_step);

void find_lines(const TileSource& source, const TileRays& rays, TileLines& lines);

// Finds the meetings of pixels of which `hits` holds meeting and a first guess of the disparity, and of which `wanted`
// is 1: an image point of the ray is linear in its disparity (7.4), and a step of the secant method on delta (7.9)
// leads from the guess to the surface. Returns the pixels (bit = index) at which it did not; these are undefined.
uint64_t settle(const TileSource& source, const TileLines& lines, const TileFloats& wanted, float max_step,
                TileHits& hits);

// The surface that most sources support; their colours and depths are blended, near sources more. Back sides
// hide nothing here: a source that sees a front there knows better.
void fuse_by_agreement(const TileSource* sources, const TileHits* hits, size_t count, TilePixels& pixels);

}  // namespace iris::render
