// What rays through an image see: textures and light.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "iris/geometry/camera_model.h"
#include "tracer.h"

namespace iris::simulate {

// Light that a surface throws back, of what its texture says: a sun in a fixed direction and light from everywhere, the
// same for all views. `normal`: of unit length, in the world, on the side of the viewer.
float shade(const Eigen::Vector3f& normal);

// Where the corners of a camera's pixels look: a lens is smooth enough to be linear within a pixel (the error stays
// below 0.001 px).
struct LensTable {
  explicit LensTable(const CameraModel& camera);

  int width = 0, height = 0;  // [px]
  float pixel = 0;            // width of a pixel on the plane z = 1, in the middle of the image
  std::vector<float> x, y;    // (x/z, y/z) of each corner, rows of width + 1; NaN where the lens does not reach
};

class Renderer {
 public:
  Renderer(const Scene& scene, bool colour);

  const Tracer& tracer() const { return tracer_; }
  int channels() const { return channels_; }

  // One ray through each pixel, all through the same place within the pixel.
  struct View {
    const LensTable* lens = nullptr;
    double dx = 0.5, dy = 0.5;  // [px] from the upper-left corner of the pixel
    double spacing = 1;         // [px] of rays: texture finer than this is smoothed away
    Pose world_from_cam = Pose::Identity();
  };
  // Adds the grey values or BGR colours of the rows [begin, end) to `sums`, channels() floats a pixel, row by row.
  void add_rows(const Tracer::Moment& moment, const View& view, int begin, int end, float* sums) const;

 private:
  // A texture and its smaller versions, each half as large as the one before.
  struct Texture {
    struct Level {
      int width = 0, height = 0;
      std::vector<uint8_t> texels;
    };
    std::vector<Level> levels;
  };
  // What is needed of a triangle to colour it, in the object's frame: one line of the cache.
  struct alignas(64) Face {
    float corner[3];
    float u[3], v[3];  // gradient of the texture coordinates [1/m]
    float u0, v0;      // texture coordinates at the corner
    float normal[3];
    float texels;  // density of the texture [1/m^2]
    float unused;
  };
  struct Surface {
    Texture texture;
    std::vector<Face> faces;
  };

  template <int kChannels>
  void add_rows(const Tracer::Moment& moment, const View& view, int begin, int end, float* sums) const;
  template <int kChannels>
  static void add_texel(const Texture::Level& level, float u, float v, float weight, float* sums);

  int channels_;
  Tracer tracer_;
  float sky_[3];
  std::vector<Surface> surfaces_;  // one an object
};

}  // namespace iris::simulate
