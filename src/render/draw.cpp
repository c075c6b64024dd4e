#include "iris/render/draw.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "iris/render/dsnv.h"

namespace iris::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

// Draws the picture of a straight piece of a line between two image points, `a` and `b` [px], with the reciprocals of
// the depths there (which are linear in the image).
void draw_piece(NovelView& view, const Vector2d& a, double inverse_depth_a, const Vector2d& b, double inverse_depth_b,
                const cv::Vec3b& colour, double width) {
  const double reach = 0.5 * width + 0.5;
  const int x0 = static_cast<int>(std::clamp(std::floor(std::min(a.x(), b.x()) - reach), 0.0, double(view.image.cols)));
  const int x1 = static_cast<int>(std::clamp(std::ceil(std::max(a.x(), b.x()) + reach), -1.0, view.image.cols - 1.0));
  const int y0 = static_cast<int>(std::clamp(std::floor(std::min(a.y(), b.y()) - reach), 0.0, double(view.image.rows)));
  const int y1 = static_cast<int>(std::clamp(std::ceil(std::max(a.y(), b.y()) + reach), -1.0, view.image.rows - 1.0));
  const Vector2d along = b - a;
  const double length2 = std::max(along.squaredNorm(), 1e-12);
  for (int y = y0; y <= y1; ++y) {
    for (int x = x0; x <= x1; ++x) {
      const Vector2d from_a = Vector2d(x, y) - a;
      const double part = std::clamp(from_a.dot(along) / length2, 0.0, 1.0);
      const double cover = std::min(1.0, reach - (from_a - part * along).norm());
      if (cover <= 0) continue;
      const double depth = 1 / (inverse_depth_a + part * (inverse_depth_b - inverse_depth_a));
      const float scene = view.depth(y, x);
      if (scene > 0 && scene < depth) continue;
      cv::Vec3b& pixel = view.image(y, x);
      for (int c = 0; c < 3; ++c) pixel[c] = static_cast<uint8_t>(pixel[c] + cover * (colour[c] - pixel[c]) + 0.5);
    }
  }
}

void draw_pinhole(NovelView& view, const NovelCamera& camera, Vector3d from, Vector3d to, const cv::Vec3b& colour,
                  double width) {
  // Cut by the planes of the picture (a little outside of it) and by one just in front of the optical centre.
  const double left = (-width - camera.cx) / camera.f, right = (camera.width + width - camera.cx) / camera.f;
  const double top = (-width - camera.cy) / camera.f, bottom = (camera.height + width - camera.cy) / camera.f;
  const double nearest = 1e-3 * (from - to).norm() + 1e-9;
  const std::array<std::pair<Vector3d, double>, 5> planes = {
      {{{0, 0, 1}, -nearest}, {{1, 0, -left}, 0}, {{-1, 0, right}, 0}, {{0, 1, -top}, 0}, {{0, -1, bottom}, 0}}};
  for (const auto& [normal, offset] : planes) {
    const double a = normal.dot(from) + offset, b = normal.dot(to) + offset;
    if (a < 0 && b < 0) return;
    if (a < 0) from = from + (to - from) * (a / (a - b));
    if (b < 0) to = to + (from - to) * (b / (b - a));
  }
  if (from.z() <= 0 || to.z() <= 0) return;
  const auto image = [&](const Vector3d& p) {
    return Vector2d(camera.f * p.x() / p.z() + camera.cx, camera.f * p.y() / p.z() + camera.cy);
  };
  // In short pieces, so that a long slanting line does not search the whole picture.
  const Vector2d a = image(from), b = image(to);
  const int pieces = std::max(1, static_cast<int>(std::ceil((b - a).norm() / 24)));
  for (int i = 0; i < pieces; ++i) {
    const double p = static_cast<double>(i) / pieces, q = static_cast<double>(i + 1) / pieces;
    const double wa = 1 / from.z(), wb = 1 / to.z();
    draw_piece(view, a + p * (b - a), wa + p * (wb - wa), a + q * (b - a), wa + q * (wb - wa), colour, width);
  }
}

void draw_equirectangular(NovelView& view, const NovelCamera& camera, const Vector3d& from, const Vector3d& to,
                          const cv::Vec3b& colour, double width) {
  const auto image = [&](const Vector3d& p) {
    return Vector2d(
        (std::atan2(p.x(), p.z()) / (2 * std::numbers::pi) + 0.5) * camera.width - 0.5,
        (std::asin(std::clamp(p.y() / p.norm(), -1.0, 1.0)) / std::numbers::pi + 0.5) * camera.height - 0.5);
  };
  // A straight line is curved in this projection: short pieces, without those that cross the seam behind the camera.
  const double angle = std::acos(std::clamp(from.normalized().dot(to.normalized()), -1.0, 1.0));
  const int pieces = std::max(1, static_cast<int>(std::ceil(angle / (2 * std::numbers::pi) * camera.width / 4)));
  for (int i = 0; i < pieces; ++i) {
    const Vector3d p = from + (to - from) * (static_cast<double>(i) / pieces);
    const Vector3d q = from + (to - from) * (static_cast<double>(i + 1) / pieces);
    if (p.norm() < 1e-9 || q.norm() < 1e-9) continue;
    const Vector2d a = image(p), b = image(q);
    if (std::abs(a.x() - b.x()) > 0.5 * camera.width) continue;
    draw_piece(view, a, 1 / p.norm(), b, 1 / q.norm(), colour, width);
  }
}

// A rectangle of pixels, all bounds included; empty if x1 < x0.
struct PixelBox {
  int x0 = 0, y0 = 0, x1 = -1, y1 = -1;
};

// The pixels that may see a triangle given in the camera's frame.
PixelBox box_of(const NovelCamera& camera, const std::array<Vector3d, 3>& corners) {
  if (camera.projection == Projection::pinhole) {
    constexpr double kNearest = 1e-3;  // [m] what is nearer is cut away
    double x0 = camera.width, x1 = -1, y0 = camera.height, y1 = -1;
    const auto take = [&](const Vector3d& p) {
      const double x = camera.f * p.x() / p.z() + camera.cx, y = camera.f * p.y() / p.z() + camera.cy;
      x0 = std::min(x0, x), x1 = std::max(x1, x), y0 = std::min(y0, y), y1 = std::max(y1, y);
    };
    for (size_t i = 0; i < 3; ++i) {
      const Vector3d &a = corners[i], &b = corners[(i + 1) % 3];
      if (a.z() >= kNearest) take(a);
      if ((a.z() < kNearest) != (b.z() < kNearest)) take(a + (b - a) * ((kNearest - a.z()) / (b.z() - a.z())));
    }
    x0 = std::max(std::ceil(x0), 0.0), x1 = std::min(std::floor(x1), camera.width - 1.0);
    y0 = std::max(std::ceil(y0), 0.0), y1 = std::min(std::floor(y1), camera.height - 1.0);
    if (x0 > x1 || y0 > y1) return {};
    return {static_cast<int>(x0), static_cast<int>(y0), static_cast<int>(x1), static_cast<int>(y1)};
  }
  // A cone about the triangle, then the longitudes and latitudes that it covers.
  const PixelBox all{0, 0, camera.width - 1, camera.height - 1};
  Vector3d axis = Vector3d::Zero();
  for (const Vector3d& corner : corners) axis += corner.normalized();
  if (axis.norm() < 0.5) return all;
  axis.normalize();
  double angle = 0;
  for (const Vector3d& corner : corners) {
    angle = std::max(angle, std::acos(std::clamp(axis.dot(corner.normalized()), -1.0, 1.0)));
  }
  if (angle > 1.4) return all;
  const double latitude = std::asin(std::clamp(axis.y(), -1.0, 1.0));
  const auto row = [&](double l) { return (l / std::numbers::pi + 0.5) * camera.height - 0.5; };
  PixelBox box = all;
  box.y0 = std::max(0, static_cast<int>(std::floor(row(latitude - angle))));
  box.y1 = std::min(camera.height - 1, static_cast<int>(std::ceil(row(latitude + angle))));
  if (std::abs(latitude) + angle >= std::numbers::pi / 2) return box;  // a pole: all longitudes
  const double half = std::asin(std::min(1.0, std::sin(angle) / std::cos(latitude)));
  const double longitude = std::atan2(axis.x(), axis.z());
  if (longitude - half < -std::numbers::pi || longitude + half > std::numbers::pi) return box;  // the seam
  const auto column = [&](double l) { return (l / (2 * std::numbers::pi) + 0.5) * camera.width - 0.5; };
  box.x0 = std::max(0, static_cast<int>(std::floor(column(longitude - half))));
  box.x1 = std::min(camera.width - 1, static_cast<int>(std::ceil(column(longitude + half))));
  return box;
}

cv::Vec3b texel(const cv::Mat3b& texture, double u, double v) {
  const auto at = [](double part, int size) {
    return std::min(static_cast<int>((part - std::floor(part)) * size), size - 1);
  };
  return texture(at(v, texture.rows), at(u, texture.cols));
}

}  // namespace

void draw_meshes(NovelView& view, const NovelCamera& camera, const std::vector<TriangleMesh>& meshes,
                 const Pose& world_from_mesh) {
  constexpr double kAmbient = 0.4;  // brightness of a surface that is seen edge-on
  constexpr double kEdge = 1e-9;    // neighbours share their edge: no gap between them
  const Pose cam_from_mesh = camera.world_from_cam.inverse() * world_from_mesh;
  cv::Mat1f nearest(view.image.size(), 0.0f);  // [m] of what is drawn; the view's depth stays that of the scene
  for (const TriangleMesh& mesh : meshes) {
    const bool textured = !mesh.texture.empty() && mesh.texture_coordinates.size() == mesh.vertices.size();
    std::vector<Vector3d> vertices;
    vertices.reserve(mesh.vertices.size());
    for (const Eigen::Vector3f& vertex : mesh.vertices) vertices.push_back(cam_from_mesh * vertex.cast<double>());
    for (const Eigen::Vector3i& triangle : mesh.triangles) {
      const std::array<Vector3d, 3> corners = {vertices[static_cast<size_t>(triangle[0])],
                                               vertices[static_cast<size_t>(triangle[1])],
                                               vertices[static_cast<size_t>(triangle[2])]};
      const PixelBox box = box_of(camera, corners);
      if (box.x1 < box.x0) continue;
      const Vector3d e1 = corners[1] - corners[0], e2 = corners[2] - corners[0];
      const Vector3d normal = e1.cross(e2);
      const double offset = normal.dot(corners[0]);
      if (normal.norm() == 0) continue;
      for (int y = box.y0; y <= box.y1; ++y) {
        for (int x = box.x0; x <= box.x1; ++x) {
          const Vector3d ray = pixel_ray(camera, x, y);
          const double slope = normal.dot(ray);
          if (slope == 0) continue;
          const double depth = offset / slope;
          if (depth <= 0) continue;
          const float scene = view.depth(y, x), before = nearest(y, x);
          if ((scene > 0 && scene < depth) || (before > 0 && before <= depth)) continue;
          const Vector3d on = depth * ray - corners[0];
          const double area = normal.squaredNorm();
          const double b = on.cross(e2).dot(normal) / area, c = e1.cross(on).dot(normal) / area;
          if (b < -kEdge || c < -kEdge || b + c > 1 + kEdge) continue;
          nearest(y, x) = static_cast<float>(depth);
          cv::Vec3b colour = mesh.colour;
          if (textured) {
            const auto uv = [&](int i) { return mesh.texture_coordinates[static_cast<size_t>(triangle[i])]; };
            const Eigen::Vector2d at =
                ((1 - b - c) * uv(0).cast<double>() + b * uv(1).cast<double>() + c * uv(2).cast<double>());
            colour = texel(mesh.texture, at.x(), at.y());
          }
          const double light = kAmbient + (1 - kAmbient) * std::abs(slope) / (std::sqrt(area) * ray.norm());
          for (int k = 0; k < 3; ++k) view.image(y, x)[k] = static_cast<uint8_t>(light * colour[k] + 0.5);
        }
      }
    }
  }
}

void draw_line(NovelView& view, const NovelCamera& camera, const Vector3d& from, const Vector3d& to,
               const cv::Vec3b& colour, double width) {
  const Pose cam_from_world = camera.world_from_cam.inverse();
  const Vector3d a = cam_from_world * from, b = cam_from_world * to;
  if (camera.projection == Projection::pinhole) {
    draw_pinhole(view, camera, a, b, colour, width);
  } else {
    draw_equirectangular(view, camera, a, b, colour, width);
  }
}

void draw_path(NovelView& view, const NovelCamera& camera, const std::vector<Vector3d>& points, const cv::Vec3b& colour,
               double width) {
  for (size_t i = 1; i < points.size(); ++i) draw_line(view, camera, points[i - 1], points[i], colour, width);
}

void draw_camera_pyramid(NovelView& view, const NovelCamera& camera, const RectifiedCamera& recording,
                         const Pose& world_from_cam, const cv::Vec3b& colour, double size) {
  constexpr double kWidth = 2;  // [px]
  std::array<Vector3d, 4> base;
  const std::array<std::pair<double, double>, 4> corners = {
      {{0, 0}, {recording.width, 0}, {recording.width, recording.height}, {0, recording.height}}};
  for (size_t i = 0; i < 4; ++i) {
    base[i] = world_from_cam * (size * Vector3d((corners[i].first - 0.5 - recording.cx) / recording.f,
                                                (corners[i].second - 0.5 - recording.cy) / recording.f, 1));
  }
  for (size_t i = 0; i < 4; ++i) {
    draw_line(view, camera, world_from_cam.translation(), base[i], colour, kWidth);
    draw_line(view, camera, base[i], base[(i + 1) % 4], colour, kWidth);
  }
}

}  // namespace iris::render
