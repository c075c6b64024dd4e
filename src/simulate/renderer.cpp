#include "renderer.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

namespace iris::simulate {
namespace {

constexpr float kAmbient = 0.7f;

const Eigen::Vector3f& sun() {
  static const Eigen::Vector3f direction = Eigen::Vector3f(0.45f, 0.3f, 0.84f).normalized();
  return direction;
}

// Within 0.09 of the logarithm, continuous, and the same on every machine.
float rough_log2(float value) {
  const auto bits = std::bit_cast<uint32_t>(value);
  const float mantissa = std::bit_cast<float>((bits & 0x007fffffu) | 0x3f800000u);
  return static_cast<float>(static_cast<int>(bits >> 23) - 127) + (mantissa - 1);
}

}  // namespace

float shade(const Eigen::Vector3f& normal) { return kAmbient + (1 - kAmbient) * std::max(0.0f, normal.dot(sun())); }

LensTable::LensTable(const CameraModel& camera)
    : width(camera.width),
      height(camera.height),
      pixel(static_cast<float>(1 / std::sqrt(camera.K(0, 0) * camera.K(1, 1)))),
      x(static_cast<size_t>(width + 1) * (height + 1)),
      y(x.size()) {
  parallel_chunks(0, height + 1, 16, [&](int begin, int end) {
    for (int row = begin; row < end; ++row) {
      for (int column = 0; column <= width; ++column) {
        const Eigen::Vector3d direction = camera.unproject(Eigen::Vector2d(column - 0.5, row - 0.5));
        const size_t i = static_cast<size_t>(row) * (width + 1) + column;
        x[i] = static_cast<float>(direction.x() / direction.z());
        y[i] = static_cast<float>(direction.y() / direction.z());
      }
    }
  });
}

Renderer::Renderer(const Scene& scene, bool colour) : channels_(colour ? 3 : 1), tracer_(scene) {
  const auto converted = [&](const cv::Mat3b& image) -> cv::Mat {
    if (colour) return image;
    cv::Mat grey;
    cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);
    return grey;
  };
  const cv::Mat sky = converted(cv::Mat3b(1, 1, scene.sky));
  for (int c = 0; c < channels_; ++c) sky_[c] = sky.ptr<uchar>(0)[c];
  surfaces_.resize(scene.objects.size());
  parallel_chunks(0, static_cast<int>(surfaces_.size()), 1, [&](int begin, int end) {
    for (int object_idx = begin; object_idx < end; ++object_idx) {
      const TriangleMesh& mesh = scene.objects[static_cast<size_t>(object_idx)].mesh;
      Surface& surface = surfaces_[static_cast<size_t>(object_idx)];
      const bool textured = !mesh.texture.empty();
      IRIS_CHECK(!textured || mesh.texture_coordinates.size() == mesh.vertices.size());
      cv::Mat image = converted(textured ? mesh.texture : cv::Mat3b(1, 1, mesh.colour));
      while (true) {
        Texture::Level level{image.cols, image.rows, {}};
        for (int y = 0; y < image.rows; ++y) {
          const uchar* row = image.ptr<uchar>(y);
          level.texels.insert(level.texels.end(), row, row + static_cast<ptrdiff_t>(image.cols) * channels_);
        }
        surface.texture.levels.push_back(std::move(level));
        if (image.cols == 1 && image.rows == 1) break;
        cv::Mat half;
        cv::resize(image, half, cv::Size(std::max(1, image.cols / 2), std::max(1, image.rows / 2)), 0, 0,
                   cv::INTER_AREA);
        image = half;
      }
      const double texels = static_cast<double>(mesh.texture.cols) * mesh.texture.rows;
      for (const Eigen::Vector3i& triangle : mesh.triangles) {
        const auto corner = [&](int i) {
          return mesh.vertices[static_cast<size_t>(triangle(i))].cast<double>().eval();
        };
        const Eigen::Vector3d a = corner(0), ab = corner(1) - a, ac = corner(2) - a, normal = ab.cross(ac);
        Face face{};
        const double area = normal.norm();
        if (area > 0) {
          Eigen::Map<Eigen::Vector3f>(face.corner) = a.cast<float>();
          Eigen::Map<Eigen::Vector3f>(face.normal) = (normal / area).cast<float>();
        }
        if (area > 0 && textured) {
          const auto coordinates = [&](int i) {
            return mesh.texture_coordinates[static_cast<size_t>(triangle(i))].cast<double>().eval();
          };
          const Eigen::Vector2d uv = coordinates(0), uv_ab = coordinates(1) - uv, uv_ac = coordinates(2) - uv;
          // The vectors of the plane whose products with (ab, ac) are (1, 0) and (0, 1).
          const Eigen::Vector3d to_ab = ac.cross(normal) / (area * area), to_ac = normal.cross(ab) / (area * area);
          Eigen::Map<Eigen::Vector3f>(face.u) = (uv_ab.x() * to_ab + uv_ac.x() * to_ac).cast<float>();
          Eigen::Map<Eigen::Vector3f>(face.v) = (uv_ab.y() * to_ab + uv_ac.y() * to_ac).cast<float>();
          face.u0 = static_cast<float>(uv.x() - std::floor(uv.x()));
          face.v0 = static_cast<float>(uv.y() - std::floor(uv.y()));
          const double uv_area = std::abs(uv_ab.x() * uv_ac.y() - uv_ab.y() * uv_ac.x());
          face.texels = static_cast<float>(texels * uv_area / area);
        }
        surface.faces.push_back(face);
      }
    }
  });
}

template <int kChannels>
void Renderer::add_texel(const Texture::Level& level, float u, float v, float weight, float* sums) {
  // Texel (i, j) covers [i, i+1) x [j, j+1) of width x height.
  const float x = u * static_cast<float>(level.width) - 0.5f, y = v * static_cast<float>(level.height) - 0.5f;
  const float floor_x = std::floor(x), floor_y = std::floor(y);
  const float fx = x - floor_x, fy = y - floor_y;
  const int w = level.width, h = level.height;
  const int left = static_cast<int>(floor_x), top = static_cast<int>(floor_y);
  const int x0 = left < 0 ? w - 1 : left, y0 = top < 0 ? h - 1 : top;
  const int x1 = left + 1 >= w ? 0 : left + 1, y1 = top + 1 >= h ? 0 : top + 1;
  const uint8_t* const row0 = level.texels.data() + static_cast<ptrdiff_t>(y0) * w * kChannels;
  const uint8_t* const row1 = level.texels.data() + static_cast<ptrdiff_t>(y1) * w * kChannels;
  for (int c = 0; c < kChannels; ++c) {
    const float a = row0[x0 * kChannels + c], b = row0[x1 * kChannels + c];
    const float d = row1[x0 * kChannels + c], e = row1[x1 * kChannels + c];
    const float upper = a + fx * (b - a), lower = d + fx * (e - d);
    sums[c] += weight * (upper + fy * (lower - upper));
  }
}

template <int kChannels>
void Renderer::add_rows(const Tracer::Moment& moment, const View& view, int begin, int end, float* sums) const {
  constexpr int kSide = 4;  // of the square of pixels that is traced together
  static_assert(kSide * kSide == kPacket);
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  const LensTable& lens = *view.lens;
  const int width = lens.width;
  const Eigen::Matrix3f R = view.world_from_cam.linear().cast<float>();
  const Eigen::Vector3f origin = view.world_from_cam.translation().cast<float>();
  const float dx = static_cast<float>(view.dx), dy = static_cast<float>(view.dy);
  const float w00 = (1 - dx) * (1 - dy), w10 = dx * (1 - dy), w01 = (1 - dx) * dy, w11 = dx * dy;
  const float spacing = lens.pixel * static_cast<float>(view.spacing);
  struct Seen {
    Eigen::Vector3f origin, sun;
    Eigen::Matrix3f object_from_world;
  };
  std::vector<Seen> seen;  // camera and sun in the frames of the objects
  for (const Pose& pose : moment.world_from_object) {
    const Pose object_from_world = pose.inverse();
    seen.push_back({(object_from_world * view.world_from_cam.translation()).cast<float>(),
                    (object_from_world.linear() * sun().cast<double>()).cast<float>(),
                    object_from_world.linear().cast<float>()});
  }

  alignas(64) RTCRayHit16 packet;
  bool wanted[kPacket];
  for (int i = 0; i < kPacket; ++i) {
    packet.ray.org_x[i] = origin.x();
    packet.ray.org_y[i] = origin.y();
    packet.ray.org_z[i] = origin.z();
    packet.ray.time[i] = 0;
    packet.ray.mask[i] = ~0u;
    packet.ray.flags[i] = 0;
  }
  for (int tile_y = begin; tile_y < end; tile_y += kSide) {
    for (int tile_x = 0; tile_x < width; tile_x += kSide) {
      for (int i = 0; i < kPacket; ++i) {
        const int x = std::min(tile_x + i % kSide, width - 1), y = std::min(tile_y + i / kSide, end - 1);
        const size_t at = static_cast<size_t>(y) * (width + 1) + x, below = at + width + 1;
        float rx = w00 * lens.x[at] + w10 * lens.x[at + 1] + w01 * lens.x[below] + w11 * lens.x[below + 1];
        float ry = w00 * lens.y[at] + w10 * lens.y[at + 1] + w01 * lens.y[below] + w11 * lens.y[below + 1];
        const bool inside = tile_x + i % kSide < width && tile_y + i / kSide < end;
        const bool reached = rx == rx && ry == ry;
        if (!reached) rx = ry = 0;  // the ray is traced, but not used
        wanted[i] = inside && reached;
        packet.ray.dir_x[i] = R(0, 0) * rx + R(0, 1) * ry + R(0, 2);
        packet.ray.dir_y[i] = R(1, 0) * rx + R(1, 1) * ry + R(1, 2);
        packet.ray.dir_z[i] = R(2, 0) * rx + R(2, 1) * ry + R(2, 2);
        packet.ray.tnear[i] = 0;
        packet.ray.tfar[i] = kInfinity;
        packet.hit.geomID[i] = RTC_INVALID_GEOMETRY_ID;
        packet.hit.instID[0][i] = RTC_INVALID_GEOMETRY_ID;
      }
      tracer_.intersect(moment, packet);
      for (int i = 0; i < kPacket; ++i) {
        if (!wanted[i]) continue;
        float* const sum =
            sums + (static_cast<ptrdiff_t>(tile_y + i / kSide - begin) * width + tile_x + i % kSide) * kChannels;
        const unsigned object_idx = packet.hit.geomID[i];
        if (object_idx == RTC_INVALID_GEOMETRY_ID) {
          for (int c = 0; c < kChannels; ++c) sum[c] += sky_[c];
          continue;
        }
        Eigen::Vector3f direction(packet.ray.dir_x[i], packet.ray.dir_y[i], packet.ray.dir_z[i]);
        Eigen::Vector3f from = origin, light = sun();
        if (!seen.empty()) {
          const Seen& object = seen[object_idx];
          direction = object.object_from_world * direction;
          from = object.origin;
          light = object.sun;
        }
        const Surface& surface = surfaces_[object_idx];
        const Face& face = surface.faces[packet.hit.primID[i]];
        const float along = packet.ray.tfar[i];
        const float slant =
            face.normal[0] * direction.x() + face.normal[1] * direction.y() + face.normal[2] * direction.z();
        const float sunny = face.normal[0] * light.x() + face.normal[1] * light.y() + face.normal[2] * light.z();
        const float bright = kAmbient + (1 - kAmbient) * std::max(0.0f, slant < 0 ? sunny : -sunny);
        if (face.texels == 0) {
          for (int c = 0; c < kChannels; ++c)
            sum[c] += bright * surface.texture.levels.front().texels[static_cast<size_t>(c)];
          continue;
        }
        // From the point itself, not from Embree's barycentric coordinates: what is uncertain of it lies along the ray,
        // where it moves nothing in the image.
        const float px = from.x() - face.corner[0] + along * direction.x();
        const float py = from.y() - face.corner[1] + along * direction.y();
        const float pz = from.z() - face.corner[2] + along * direction.z();
        float u = face.u0 + face.u[0] * px + face.u[1] * py + face.u[2] * pz;
        float v = face.v0 + face.v[0] * px + face.v[1] * py + face.v[2] * pz;
        // In this order of arguments NaN, of texture coordinates beyond the range of float, becomes 0.
        u = std::min(std::max(0.0f, u - std::floor(u)), 1.0f);
        v = std::min(std::max(0.0f, v - std::floor(v)), 1.0f);
        // A ray stands for the square `spacing` on the plane z = 1; what that covers of the surface is stretched by
        // 1/slant in one direction. Half of that length is smoothed at least, since bilinear interpolation reaches one
        // texel to both sides; otherwise the area counts, so that slanted surfaces stay sharp in the other direction.
        const float facing = std::max(std::abs(slant), 1e-6f);
        const float width_on_axis = along * spacing;
        const float area = width_on_axis * width_on_axis / facing * std::max(1.0f, 0.25f / facing);
        const float level = 0.5f * rough_log2(std::max(area * face.texels, 1.0f));
        const int last = static_cast<int>(surface.texture.levels.size()) - 1;
        const int fine = std::min(static_cast<int>(level), last);
        const float coarser = fine < last ? level - static_cast<float>(fine) : 0.0f;
        const auto* levels = surface.texture.levels.data();
        add_texel<kChannels>(levels[fine], u, v, bright * (1 - coarser), sum);
        if (coarser > 0) add_texel<kChannels>(levels[fine + 1], u, v, bright * coarser, sum);
      }
    }
  }
}

void Renderer::add_rows(const Tracer::Moment& moment, const View& view, int begin, int end, float* sums) const {
  if (channels_ == 1) {
    add_rows<1>(moment, view, begin, end, sums);
  } else {
    add_rows<3>(moment, view, begin, end, sums);
  }
}

}  // namespace iris::simulate
