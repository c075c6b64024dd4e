#include "iris/render/dsnv.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>

#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "tile_kernels.h"

namespace iris::render {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kBeyond = 1e30;    // [m]
constexpr double kRangeMargin = 1;  // [px] a ray is walked from and to this far outside the source's disparity range
constexpr double kSmallestDisparity = 0.01;  // [px] everything beyond is at infinity

// What the walk needs of a source, once a picture.
struct Source {
  const PreparedSource* prepared;
  Matrix3d cam_from_novel;  // R of (7.2): R_i^T R_n
  Vector3d novel_in_cam;    // T of (7.2): R_i^T (T_n - T_i), the novel optical centre
  double distance;          // |T| [m]
  // Depths [m] at which the disparity range with its margin begins and ends.
  double nearest, farthest;
};

struct DepthRange {
  double nearest, farthest;  // [m]
};

DepthRange depth_range(const PreparedSource& source) {
  const RectifiedCamera& camera = source.view().camera;
  const double high = source.max_disparity() + kRangeMargin;
  const double low = std::max(source.min_disparity() - kRangeMargin, 0.5 * source.min_disparity());
  const double ft = camera.f * camera.baseline;
  return {ft / std::max(high + camera.disparity_offset, kSmallestDisparity),
          ft / std::max(low + camera.disparity_offset, kSmallestDisparity)};
}

// The ranges of a source without disparities are empty.
Source source_of(const NovelCamera& camera, const PreparedSource& prepared) {
  const Pose cam_from_novel = prepared.view().world_from_cam.inverse() * camera.world_from_cam;
  const DepthRange range = prepared.max_disparity() > 0 ? depth_range(prepared) : DepthRange{1, 0};
  return {.prepared = &prepared,
          .cam_from_novel = cam_from_novel.linear(),
          .novel_in_cam = cam_from_novel.translation(),
          .distance = cam_from_novel.translation().norm(),
          .nearest = range.nearest,
          .farthest = range.farthest};
}

// The disparity surface between two pixels of a row or column, or the nearer pixel if they belong to different objects.
// `at` must lie within the line of `count` pixels.
inline float on_line(const float* line, ptrdiff_t stride, int count, float at, float max_step) {
  const int i = std::min(static_cast<int>(at), std::max(count - 2, 0));
  const float part = at - static_cast<float>(i);
  const float a = line[i * stride], b = line[std::min(i + 1, count - 1) * stride];
  if (a > 0 && b > 0 && std::abs(a - b) <= max_step) return a + part * (b - a);
  return part < 0.5f ? a : b;
}

float inside(const cv::Mat1f& disparity, float x, float y, float max_step) {
  const int x0 = std::clamp(static_cast<int>(x), 0, std::max(disparity.cols - 2, 0));
  const int x1 = std::min(x0 + 1, disparity.cols - 1);
  const float part = x - static_cast<float>(x0);
  const auto column = [&](int at) {
    return on_line(&disparity(0, at), static_cast<ptrdiff_t>(disparity.step1()), disparity.rows, y, max_step);
  };
  const float a = column(x0), b = column(x1);
  if (a > 0 && b > 0 && std::abs(a - b) <= max_step) return a + part * (b - a);
  return part < 0.5f ? a : b;
}

// A sample of delta = d_ray - d_image (7.9).
struct Sample {
  float delta = 0;
  float image = 0;  // [px] 0 = no surface here
};

// What lies between two neighbouring samples. Connected is what is continuous in the disparity *image*: where the novel
// camera is near the source, the ray's own disparity may change by any amount a pixel.
Meeting between(const Sample& a, const Sample& b, float max_step) {
  if (a.image <= 0 || b.image <= 0 || std::abs(a.image - b.image) > max_step) return Meeting::nothing;
  if (a.delta > 0 && b.delta <= 0) return Meeting::surface;
  if (a.delta < 0 && b.delta >= 0) return Meeting::back_side;
  return Meeting::nothing;
}

// The part of a ray that is walked, by s of (7.2).
struct Span {
  double from = 0, to = kBeyond;  // empty if from >= to
};

// Cuts a ray to what the source can see. Depth and the sides of the image are linear in s when multiplied by the
// depth (which is positive), so that neither the epipole (7.8) nor a ray parallel to the image plane is special.
Span clip(const PreparedSource& source, const DepthRange& range, const Vector3d& q, const Vector3d& t, Span part) {
  const RectifiedCamera& camera = source.view().camera;
  const double last_x = source.disparity().cols - 1, last_y = source.disparity().rows - 1;
  const auto keep_where_positive = [&](double slope, double value_at_0) {
    if (slope * part.from + value_at_0 < 0) {
      part.from = slope > 0 ? -value_at_0 / slope : kBeyond;
    } else if (slope * part.to + value_at_0 < 0) {
      part.to = -value_at_0 / slope;
    }
  };
  keep_where_positive(q.z(), t.z() - range.nearest);
  keep_where_positive(-q.z(), range.farthest - t.z());
  if (part.from >= part.to) return part;
  const double qx = camera.f * q.x() + camera.cx * q.z(), tx = camera.f * t.x() + camera.cx * t.z();
  const double qy = camera.f * q.y() + camera.cy * q.z(), ty = camera.f * t.y() + camera.cy * t.z();
  keep_where_positive(qx, tx);
  keep_where_positive(last_x * q.z() - qx, last_x * t.z() - tx);
  if (part.from >= part.to) return part;
  keep_where_positive(qy, ty);
  keep_where_positive(last_y * q.z() - qy, last_y * t.z() - ty);
  return part;
}

Line line_of(const PreparedSource& source, const Vector3d& q, const Vector3d& t, double from, double to) {
  const RectifiedCamera& camera = source.view().camera;
  const double last_x = source.disparity().cols - 1, last_y = source.disparity().rows - 1;
  const double w0 = camera.f / (from * q.z() + t.z()), w1 = camera.f / (to * q.z() + t.z());
  const auto within = [](double value, double last) {
    return static_cast<float>(std::min(std::max(value, 0.0), last));
  };
  return {.x0 = within((from * q.x() + t.x()) * w0 + camera.cx, last_x),
          .y0 = within((from * q.y() + t.y()) * w0 + camera.cy, last_y),
          .d0 = static_cast<float>(camera.baseline * w0 - camera.disparity_offset),
          .x1 = within((to * q.x() + t.x()) * w1 + camera.cx, last_x),
          .y1 = within((to * q.y() + t.y()) * w1 + camera.cy, last_y),
          .d1 = static_cast<float>(camera.baseline * w1 - camera.disparity_offset)};
}

// Where on a line the surface is met; `along` is left to the caller.
RayHit walk(const cv::Mat1f& disparity, const Line& line, float max_step) {
  const float dx = line.x1 - line.x0, dy = line.y1 - line.y0, dd = line.d1 - line.d0;
  const float length = std::max(std::abs(dx), std::abs(dy));
  if (length < 1) {  // (7.6): a ray through the source's optical centre is a point in the image
    const float image0 = inside(disparity, line.x0, line.y0, max_step);
    const float image1 = inside(disparity, line.x1, line.y1, max_step);
    const Sample a{line.d0 - image0, image0}, b{line.d1 - image1, image1};
    const Meeting meeting = between(a, b, max_step);
    if (meeting == Meeting::nothing) return {};
    const float v = a.delta / (a.delta - b.delta);  // (7.9)
    return {.meeting = meeting, .x = line.x0 + v * dx, .y = line.y0 + v * dy, .disparity = line.d0 + v * dd};
  }

  const LineMeeting met = walk_line(disparity[0], static_cast<ptrdiff_t>(disparity.step1()), disparity.cols,
                                    disparity.rows, line, max_step);
  if (met.side == 0) return {};
  const float part = met.travelled / length;
  return {.meeting = met.side > 0 ? Meeting::surface : Meeting::back_side,
          .x = line.x0 + part * dx,
          .y = line.y0 + part * dy,
          .disparity = line.d0 + part * dd};
}

// s of a point of the source image with its disparity.
float along_ray(const PreparedSource& source, const Vector3d& q, const Vector3d& t, const RayHit& hit) {
  const RectifiedCamera& camera = source.view().camera;
  if (q.z() * q.z() > 0.1 * q.squaredNorm()) {
    const double depth = camera.f * camera.baseline / (hit.disparity + camera.disparity_offset);
    return static_cast<float>((depth - t.z()) / q.z());
  }
  // Nearly parallel to the image plane: the depth says little about s.
  return static_cast<float>(q.dot(camera.point(hit.x, hit.y, hit.disparity) - t) / q.squaredNorm());
}

RayHit walk(const PreparedSource& source, const DepthRange& range, const Vector3d& q, const Vector3d& t, double from,
            float max_step) {
  const Span part = clip(source, range, q, t, {.from = from});
  if (part.from >= part.to) return {};
  RayHit hit = walk(source.disparity(), line_of(source, q, t, part.from, part.to), max_step);
  if (hit.meeting != Meeting::nothing) hit.along = along_ray(source, q, t, hit);
  return hit;
}

// The stretch in which the rays of a tile can meet a surface of the source, by disparity [px] with the camera's offset:
// at larger ones all of them run through space that the source knows to be free (or does not see), at smaller ones
// behind everything it sees.
struct Stretch {
  float near = 0, far = 0;  // empty if near <= far
  bool judged = false;      // not just the source's range of disparities
  bool in_image = false;    // all of it lies in the image: it needs no clipping
};

// Sides of a rectangle that holds image points, all as upper bounds: x, -x, y, -y [px].
using Sides = std::array<float, 4>;

// At one disparity the rays of the tile lie between its four corner rays, whose image points are linear in it (7.4).
Stretch tile_stretch(const Source& source, const TileSource& constants, const TileLines& lines) {
  constexpr float kLongest = 64, kFirst = 16, kShortest = 2;  // [px] lengths of the pieces that are judged at once
  constexpr float kRounding = 1e-3f;                          // [px] of disparities
  const PreparedSource& prepared = *source.prepared;
  const auto ft = static_cast<float>(constants.f * constants.baseline);
  const float tz = constants.translation[2], offset = constants.disparity_offset;
  Stretch part{.near = ft / std::max(static_cast<float>(source.nearest), tz),
               .far = ft / static_cast<float>(source.farthest)};
  if (part.near <= part.far) return part;
  constexpr std::array<size_t, 4> kCorners = {ray_index(0, 0), ray_index(kTile, 0), ray_index(0, kTile),
                                              ray_index(kTile, kTile)};
  std::array<Sides, 4> at_zero, slopes;
  float mx = 0, my = 0;
  for (size_t k = 0; k < 4; ++k) {
    const size_t i = kCorners[k];
    if (lines.per_qz[i] <= 0) return part;
    at_zero[k] = {lines.x0[i], -lines.x0[i], lines.y0[i], -lines.y0[i]};
    slopes[k] = {lines.mx[i], -lines.mx[i], lines.my[i], -lines.my[i]};
    mx += 0.25f * lines.mx[i], my += 0.25f * lines.my[i];
  }
  const float per_pixel = 1 / std::max(1e-6f, std::max(std::abs(mx), std::abs(my)));  // [disparities]
  const auto sides_at = [&](float disparity) {
    Sides most;
    for (size_t i = 0; i < 4; ++i) most[i] = at_zero[0][i] + slopes[0][i] * disparity;
    for (size_t k = 1; k < 4; ++k) {
      for (size_t i = 0; i < 4; ++i) most[i] = std::max(most[i], at_zero[k][i] + slopes[k][i] * disparity);
    }
    return most;
  };
  // Pixels that can matter between two disparities, with one more on each side: the surface at a point depends on its
  // neighbours.
  const auto last_x = static_cast<float>(constants.width - 1), last_y = static_cast<float>(constants.height - 1);
  struct Area {
    int x0, y0, x1, y1;
    bool empty() const { return x0 > x1 || y0 > y1; }
  };
  const auto area = [&](const Sides& a, const Sides& b) {
    Sides most;
    for (size_t i = 0; i < 4; ++i) most[i] = std::max(a[i], b[i]);
    return Area{.x0 = static_cast<int>(std::clamp(-most[1] - 1, 0.0f, last_x + 1)),
                .y0 = static_cast<int>(std::clamp(-most[3] - 1, 0.0f, last_y + 1)),
                .x1 = static_cast<int>(std::clamp(most[0] + 2, -1.0f, last_x)),
                .y1 = static_cast<int>(std::clamp(most[2] + 2, -1.0f, last_y))};
  };
  const auto is_free = [&](const Sides& a, const Sides& b, float smallest) {
    const Area seen = area(a, b);
    return seen.empty() || prepared.max_in(seen.x0, seen.y0, seen.x1, seen.y1) < smallest - offset - kRounding;
  };
  const auto is_behind = [&](const Sides& a, const Sides& b, float largest) {
    const Area seen = area(a, b);
    return seen.empty() || prepared.min_in(seen.x0, seen.y0, seen.x1, seen.y1) > largest - offset + kRounding;
  };

  // Ever longer pieces until one of them does not lie in free space (behind everything), then halves of it.
  Sides near = sides_at(part.near), far = sides_at(part.far);
  bool growing = true;
  for (float stride = kFirst; stride >= kShortest;) {
    const float next = std::max(part.near - stride * per_pixel, part.far);
    const Sides sides = sides_at(next);
    if (is_free(near, sides, next)) {
      part.near = next;
      if (part.near <= part.far) return part;
      near = sides;
    } else {
      growing = false;
    }
    stride = growing ? std::min(2 * stride, kLongest) : 0.5f * stride;
  }
  growing = true;
  for (float stride = kFirst; stride >= kShortest;) {
    const float next = std::min(part.far + stride * per_pixel, part.near);
    const Sides sides = sides_at(next);
    if (is_behind(far, sides, next)) {
      part.far = next;
      if (part.near <= part.far) return part;
      far = sides;
    } else {
      growing = false;
    }
    stride = growing ? std::min(2 * stride, kLongest) : 0.5f * stride;
  }
  part.judged = true;
  part.in_image = std::max(near[0], far[0]) <= last_x && std::max(near[1], far[1]) <= 0 &&
                  std::max(near[2], far[2]) <= last_y && std::max(near[3], far[3]) <= 0;
  return part;
}

// Cuts the stretch of a ray with x (or y) = at_zero + slope * disparity to what lies in [0, last].
void clip(float at_zero, float slope, float last, Stretch& part) {
  const float at_near = at_zero + slope * part.near, at_far = at_zero + slope * part.far;
  if ((at_near < 0 && at_far < 0) || (at_near > last && at_far > last)) {
    part.near = part.far;
    return;
  }
  if (at_near < 0) part.near = -at_zero / slope;
  if (at_near > last) part.near = (last - at_zero) / slope;
  if (at_far < 0) part.far = -at_zero / slope;
  if (at_far > last) part.far = (last - at_zero) / slope;
}

cv::Vec3f colour_at(const cv::Mat& image, float x, float y) {
  const int x0 = std::clamp(static_cast<int>(x), 0, std::max(image.cols - 2, 0)), x1 = std::min(x0 + 1, image.cols - 1);
  const int y0 = std::clamp(static_cast<int>(y), 0, std::max(image.rows - 2, 0)), y1 = std::min(y0 + 1, image.rows - 1);
  const float fx = x - static_cast<float>(x0), fy = y - static_cast<float>(y0);
  const float w00 = (1 - fx) * (1 - fy), w01 = fx * (1 - fy), w10 = (1 - fx) * fy, w11 = fx * fy;
  if (image.type() == CV_8UC1) {
    const uint8_t *a = image.ptr<uint8_t>(y0), *b = image.ptr<uint8_t>(y1);
    const float grey = w00 * a[x0] + w01 * a[x1] + w10 * b[x0] + w11 * b[x1];
    return {grey, grey, grey};
  }
  const cv::Vec3b *a = image.ptr<cv::Vec3b>(y0), *b = image.ptr<cv::Vec3b>(y1);
  cv::Vec3f colour;
  for (int c = 0; c < 3; ++c) colour[c] = w00 * a[x0][c] + w01 * a[x1][c] + w10 * b[x0][c] + w11 * b[x1][c];
  return colour;
}

struct Pixel {
  cv::Vec3b colour;
  float depth = 0;
  int16_t source = -1;
};

Pixel seen(const Source& source, int index, const RayHit& hit) {
  const cv::Vec3f colour = colour_at(source.prepared->view().image, hit.x, hit.y);
  Pixel pixel;
  pixel.depth = hit.along;
  pixel.source = static_cast<int16_t>(index);
  for (int c = 0; c < 3; ++c) pixel.colour[c] = static_cast<uint8_t>(colour[c] + 0.5f);
  return pixel;
}

// (7.10): the smallest V' = V + |T| wins; a back side is black and opaque.
Pixel fuse_nearest(const std::vector<Source>& sources, const std::vector<RayHit>& hits) {
  int best = -1;
  double best_distance = kBeyond;
  for (size_t i = 0; i < sources.size(); ++i) {
    if (hits[i].meeting == Meeting::nothing || hits[i].along <= 0) continue;
    const double distance = hits[i].along + sources[i].distance;
    if (distance < best_distance) best_distance = distance, best = static_cast<int>(i);
  }
  if (best < 0) return {};
  const size_t winner = static_cast<size_t>(best);
  if (hits[winner].meeting == Meeting::back_side) return {};
  return seen(sources[winner], best, hits[winner]);
}

TileSource tile_source(const Source& source) {
  const StereoView& view = source.prepared->view();
  const cv::Mat& image = source.prepared->view().image;
  const cv::Mat1f& disparity = source.prepared->disparity();
  const cv::Mat1b& origin = view.disparity.origin;
  TileSource tile{.rotation = {},
                  .translation = {},
                  .f = static_cast<float>(view.camera.f),
                  .cx = static_cast<float>(view.camera.cx),
                  .cy = static_cast<float>(view.camera.cy),
                  .baseline = static_cast<float>(view.camera.baseline),
                  .disparity_offset = static_cast<float>(view.camera.disparity_offset),
                  .distance = static_cast<float>(source.distance),
                  .width = disparity.cols,
                  .height = disparity.rows,
                  .disparity = disparity[0],
                  .disparity_stride = static_cast<ptrdiff_t>(disparity.step1()),
                  .image = image.data,
                  .image_stride = static_cast<ptrdiff_t>(image.step[0]),
                  .channels = image.channels(),
                  .origin = origin.empty() ? nullptr : origin.data,
                  .origin_stride = origin.empty() ? 0 : static_cast<ptrdiff_t>(origin.step[0])};
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) tile.rotation[3 * i + j] = static_cast<float>(source.cam_from_novel(i, j));
    tile.translation[i] = static_cast<float>(source.novel_in_cam[i]);
  }
  return tile;
}

// The rays of a tile and those just beyond its right and lower sides: what is known of them for one source.
class TileWalk {
 public:
  static constexpr int kSide = kTile + 1;
  using Rays = std::array<std::array<Vector3d, kSide>, kSide>;

  TileWalk(const Source& source, float max_step)
      : source_(source),
        range_{source.nearest, source.farthest},
        max_step_(max_step),
        constants_(tile_source(source)) {}

  const TileSource& constants() const { return constants_; }

  // All meetings of the tile's rays. Where squares of the tile show one smooth surface, rays at their corners are
  // walked and the disparities between them are a guess that leads to the surface; all else is walked. `continues`: the
  // tile is the right neighbour of the one before, with which it shares a column of rays.
  void meet(const Rays& rays, const TileRays& vectors, bool continues, TileHits& hits) {
    const bool was_empty = part_.near <= part_.far;
    rays_ = &rays;
    find_lines(constants_, vectors, lines_);
    part_ = tile_stretch(source_, constants_, lines_);
    if (part_.near <= part_.far) {
      hits = {};
      return;
    }
    for (size_t row = 0; row < known_.size(); row += kSide) {
      const bool shared = continues && !was_empty && known_[row + kTile];
      if (shared) met_[row] = met_[row + kTile];
      std::fill_n(known_.begin() + static_cast<ptrdiff_t>(row), kSide, false);
      known_[row] = shared;
    }
    wanted_ = {};
    split(0, 0, part_.judged ? kTile : 2, hits);
    uint64_t failed = settle(constants_, lines_, wanted_, max_step_, hits);
    for (; failed != 0; failed &= failed - 1) {
      const int pixel = std::countr_zero(failed);
      put(pixel % kTile, pixel / kTile, hits);
    }
  }

 private:
  const RayHit& ray(int x, int y) {
    const size_t i = static_cast<size_t>(y * kSide + x);
    if (!known_[i]) {
      known_[i] = true;
      const size_t line = ray_index(x, y);
      met_[i] = lines_.per_qz[line] > 0
                    ? along_line(line)
                    : walk(*source_.prepared, range_,
                           source_.cam_from_novel * (*rays_)[static_cast<size_t>(y)][static_cast<size_t>(x)],
                           source_.novel_in_cam, 0, max_step_);
    }
    return met_[i];
  }

  RayHit along_line(size_t i) const {
    const float x0 = lines_.x0[i], y0 = lines_.y0[i], mx = lines_.mx[i], my = lines_.my[i];
    const auto last_x = static_cast<float>(constants_.width - 1), last_y = static_cast<float>(constants_.height - 1);
    Stretch part = part_;
    if (!part.in_image) {
      clip(x0, mx, last_x, part);
      if (part.near > part.far) clip(y0, my, last_y, part);
      if (part.near <= part.far) return {};
    }
    const auto within = [](float value, float last) { return std::min(std::max(value, 0.0f), last); };
    const float offset = constants_.disparity_offset;
    RayHit hit = walk(source_.prepared->disparity(),
                      {.x0 = within(x0 + mx * part.near, last_x),
                       .y0 = within(y0 + my * part.near, last_y),
                       .d0 = part.near - offset,
                       .x1 = within(x0 + mx * part.far, last_x),
                       .y1 = within(y0 + my * part.far, last_y),
                       .d1 = part.far - offset},
                      max_step_);
    if (hit.meeting != Meeting::nothing) {
      const float depth = constants_.f * constants_.baseline / (hit.disparity + offset);
      hit.along = (depth - constants_.translation[2]) * lines_.per_qz[i];
    }
    return hit;
  }

  void put(int x, int y, TileHits& hits) {
    const RayHit& hit = ray(x, y);
    const size_t i = static_cast<size_t>(y * kTile + x);
    wanted_.at[i] = 0;
    hits.meeting.at[i] = hit.meeting == Meeting::nothing ? 0.0f : hit.meeting == Meeting::surface ? 1.0f : -1.0f;
    hits.x.at[i] = hit.x;
    hits.y.at[i] = hit.y;
    hits.disparity.at[i] = hit.disparity;
    hits.along.at[i] = hit.along;
  }

  // A ray half-way between two others, alone.
  void between(const RayHit& a, const RayHit& b, int x, int y, TileHits& hits) {
    constexpr float kFarthestApart = 4;  // [px] in the source image
    if (a.meeting != b.meeting || std::abs(a.x - b.x) > kFarthestApart || std::abs(a.y - b.y) > kFarthestApart) {
      put(x, y, hits);
      return;
    }
    const size_t i = static_cast<size_t>(y * kTile + x);
    const bool nothing = a.meeting == Meeting::nothing;
    hits.meeting.at[i] = nothing ? 0.0f : a.meeting == Meeting::surface ? 1.0f : -1.0f;
    hits.disparity.at[i] = 0.5f * (a.disparity + b.disparity);
    hits.x.at[i] = hits.y.at[i] = hits.along.at[i] = 0;
    wanted_.at[i] = nothing ? 0.0f : 1.0f;
  }

  // The whole tile as squares of one size.
  void split(int x_begin, int y_begin, int size, TileHits& hits) {
    for (int y = y_begin; y < kTile; y += size) {
      for (int x = x_begin; x < kTile; x += size) square(x, y, size, hits);
    }
  }

  void square(int x0, int y0, int size, TileHits& hits) {
    const std::array<const RayHit*, 4> corners = {&ray(x0, y0), &ray(x0 + size, y0), &ray(x0, y0 + size),
                                                  &ray(x0 + size, y0 + size)};
    if (is_smooth(corners, size) &&
        (size == 2 || is_unhidden(corners, x0, y0, size) || (size == 4 && keeps_on(corners, x0 + 2, y0 + 2)))) {
      interpolate(corners, x0, y0, size, hits);
    } else if (size > 2) {
      const int half = size / 2;
      for (const auto& [x, y] : {std::pair{0, 0}, {half, 0}, {0, half}, {half, half}}) {
        square(x0 + x, y0 + y, half, hits);
      }
    } else {
      put(x0, y0, hits);
      between(*corners[0], *corners[1], x0 + 1, y0, hits);
      between(*corners[0], *corners[2], x0, y0 + 1, hits);
      put(x0 + 1, y0 + 1, hits);
    }
  }

  // True if the rays may well meet one surface.
  bool is_smooth(const std::array<const RayHit*, 4>& corners, int size) const {
    const float farthest_apart = 2 * static_cast<float>(size);  // [px] in the source image
    const RayHit& first = *corners[0];
    float low_x = first.x, high_x = low_x, low_y = first.y, high_y = low_y, low = first.disparity, high = low;
    for (const RayHit* corner : corners) {
      if (corner->meeting != first.meeting) return false;
      low_x = std::min(low_x, corner->x), high_x = std::max(high_x, corner->x);
      low_y = std::min(low_y, corner->y), high_y = std::max(high_y, corner->y);
      low = std::min(low, corner->disparity), high = std::max(high, corner->disparity);
    }
    if (first.meeting == Meeting::nothing) return size <= 4;
    return high_x - low_x <= farthest_apart && high_y - low_y <= farthest_apart &&
           (size == 2 || high - low <= max_step_);
  }

  // True if nothing that belongs to another object stands before the surface that the corners meet.
  bool is_unhidden(const std::array<const RayHit*, 4>& corners, int x0, int y0, int size) const {
    const RayHit& first = *corners[0];
    if (first.meeting == Meeting::nothing) return true;
    float low_x = first.x, high_x = low_x, low_y = first.y, high_y = low_y, nearest = first.disparity;
    for (const RayHit* corner : corners) {
      low_x = std::min(low_x, corner->x), high_x = std::max(high_x, corner->x);
      low_y = std::min(low_y, corner->y), high_y = std::max(high_y, corner->y);
      nearest = std::max(nearest, corner->disparity);
    }
    for (const int y : {y0, y0 + size}) {
      for (const int x : {x0, x0 + size}) {
        const size_t i = ray_index(x, y);
        const float at_x = lines_.x0[i] + lines_.mx[i] * part_.near, at_y = lines_.y0[i] + lines_.my[i] * part_.near;
        low_x = std::min(low_x, at_x), high_x = std::max(high_x, at_x);
        low_y = std::min(low_y, at_y), high_y = std::max(high_y, at_y);
      }
    }
    const int width = constants_.width, height = constants_.height;
    const auto pixel = [](float at, int count) {
      return static_cast<int>(std::clamp(at, 0.0f, static_cast<float>(count - 1)));
    };
    return source_.prepared->max_in(pixel(low_x, width), pixel(low_y, height), pixel(high_x + 1, width),
                                    pixel(high_y + 1, height)) <= nearest + max_step_;
  }

  // True if the ray in the middle of a square meets the surface that its corners meet.
  bool keeps_on(const std::array<const RayHit*, 4>& corners, int x, int y) {
    constexpr float kBend = 0.5f;  // [px]
    const RayHit& middle = ray(x, y);
    const float expected =
        0.25f * (corners[0]->disparity + corners[1]->disparity + corners[2]->disparity + corners[3]->disparity);
    return middle.meeting == corners[0]->meeting && std::abs(middle.disparity - expected) <= kBend;
  }

  void interpolate(const std::array<const RayHit*, 4>& corners, int x0, int y0, int size, TileHits& hits) {
    const bool nothing = corners[0]->meeting == Meeting::nothing;
    const float meeting = nothing ? 0.0f : corners[0]->meeting == Meeting::surface ? 1.0f : -1.0f;
    const float part = 1 / static_cast<float>(size);
    for (int y = 0; y < size; ++y) {
      const float fy = static_cast<float>(y) * part;
      const float left = corners[0]->disparity + fy * (corners[2]->disparity - corners[0]->disparity);
      const float right = corners[1]->disparity + fy * (corners[3]->disparity - corners[1]->disparity);
      const float slope = (right - left) * part;
      const size_t row = static_cast<size_t>((y0 + y) * kTile + x0);
      for (int x = 0; x < size; ++x) {
        const size_t i = row + static_cast<size_t>(x);
        hits.meeting.at[i] = meeting;
        hits.disparity.at[i] = left + static_cast<float>(x) * slope;
        hits.x.at[i] = hits.y.at[i] = hits.along.at[i] = 0;
        wanted_.at[i] = nothing ? 0.0f : 1.0f;
      }
    }
    put(x0, y0, hits);
  }

  const Source& source_;
  DepthRange range_;
  float max_step_;
  TileSource constants_;
  const Rays* rays_ = nullptr;
  TileLines lines_;
  Stretch part_;
  std::array<bool, kSide * kSide> known_{};
  std::array<RayHit, kSide * kSide> met_;
  TileFloats wanted_;
};

RayHit ray_hit(const TileHits& hits, size_t i) {
  const float meeting = hits.meeting.at[i];
  return {.meeting = meeting == 0  ? Meeting::nothing
                     : meeting > 0 ? Meeting::surface
                                   : Meeting::back_side,
          .x = hits.x.at[i],
          .y = hits.y.at[i],
          .disparity = hits.disparity.at[i],
          .along = hits.along.at[i]};
}

void tile_rays(const NovelCamera& camera, int step, int x_begin, int y_begin, TileWalk::Rays& rays, TileRays& vectors) {
  for (int y = 0; y <= kTile; ++y) {
    for (int x = 0; x <= kTile; ++x) {
      const Vector3d ray = pixel_ray(camera, (x_begin + x) * step, (y_begin + y) * step);
      rays[static_cast<size_t>(y)][static_cast<size_t>(x)] = ray;
      const size_t i = ray_index(x, y);
      vectors.x[i] = static_cast<float>(ray.x());
      vectors.y[i] = static_cast<float>(ray.y());
      vectors.z[i] = static_cast<float>(ray.z());
    }
  }
}

// Pixel (x, y) of `view` is pixel (step x, step y) of the camera.
void trace(const NovelCamera& camera, const std::vector<Source>& sources, const DsnvOptions& options, NovelView& view) {
  const int step = options.step, width = view.image.cols, height = view.image.rows;
  const float max_step = static_cast<float>(options.max_disparity_step);
  const bool agreement = options.fusion == "agreement";
  const size_t count = sources.size();
  parallel_chunks(0, height, kTile, [&](int y_begin, int y_end) {
    std::vector<TileWalk> walks;
    std::vector<TileSource> constants;
    for (const Source& source : sources) {
      walks.emplace_back(source, max_step);
      constants.push_back(walks.back().constants());
    }
    std::vector<TileHits> hits(count);
    std::vector<RayHit> of_pixel(count);
    TileWalk::Rays rays;
    TileRays vectors{};
    TilePixels pixels;
    for (int x_begin = 0; x_begin < width; x_begin += kTile) {
      tile_rays(camera, step, x_begin, y_begin, rays, vectors);
      for (size_t i = 0; i < count; ++i) walks[i].meet(rays, vectors, x_begin > 0, hits[i]);
      if (agreement) fuse_by_agreement(constants.data(), hits.data(), count, pixels);
      const int columns = std::min(kTile, width - x_begin), rows = y_end - y_begin;
      for (int y = 0; y < rows; ++y) {
        for (int x = 0; x < columns; ++x) {
          const size_t i = static_cast<size_t>(y * kTile + x);
          if (agreement) {
            for (int k = 0; k < 3; ++k) {
              view.image(y_begin + y, x_begin + x)[k] = static_cast<uint8_t>(pixels.colour[k].at[i] + 0.5f);
            }
            view.depth(y_begin + y, x_begin + x) = pixels.depth.at[i];
            view.source(y_begin + y, x_begin + x) = pixels.source[i];
            continue;
          }
          for (size_t k = 0; k < count; ++k) of_pixel[k] = ray_hit(hits[k], i);
          const Pixel pixel = fuse_nearest(sources, of_pixel);
          view.image(y_begin + y, x_begin + x) = pixel.colour;
          view.depth(y_begin + y, x_begin + x) = pixel.depth;
          view.source(y_begin + y, x_begin + x) = pixel.source;
        }
      }
    }
  });
}

// What one more source shows of the pixels that are holes so far; its index is `index`.
void trace_holes(const NovelCamera& camera, const Source& source, int16_t index, const DsnvOptions& options,
                 NovelView& view) {
  const int width = view.image.cols, height = view.image.rows;
  parallel_chunks(0, height, kTile, [&](int y_begin, int y_end) {
    TileWalk walk(source, static_cast<float>(options.max_disparity_step));
    TileHits hits;
    TileWalk::Rays rays;
    TileRays vectors{};
    TilePixels pixels;
    for (int x_begin = 0; x_begin < width; x_begin += kTile) {
      const int columns = std::min(kTile, width - x_begin);
      const cv::Mat1s sources = view.source(cv::Rect(x_begin, y_begin, columns, y_end - y_begin));
      if (std::none_of(sources.begin(), sources.end(), [](int16_t of) { return of < 0; })) continue;
      tile_rays(camera, options.step, x_begin, y_begin, rays, vectors);
      walk.meet(rays, vectors, false, hits);
      fuse_by_agreement(&walk.constants(), &hits, 1, pixels);
      for (int y = y_begin; y < y_end; ++y) {
        for (int x = x_begin; x < x_begin + columns; ++x) {
          const size_t i = ray_index(x - x_begin, y - y_begin);
          if (view.source(y, x) >= 0 || pixels.source[i] < 0) continue;
          for (int k = 0; k < 3; ++k) view.image(y, x)[k] = static_cast<uint8_t>(pixels.colour[k].at[i] + 0.5f);
          view.depth(y, x) = pixels.depth.at[i];
          view.source(y, x) = index;
        }
      }
    }
  });
}

NovelView blank(int width, int height) {
  return {.image = cv::Mat3b(height, width, cv::Vec3b(0, 0, 0)),
          .depth = cv::Mat1f(height, width, 0.0f),
          .source = cv::Mat1s(height, width, static_cast<int16_t>(-1))};
}

// Full size from the traced pixels: bilinear on one surface, the nearest traced pixel across the borders of objects.
NovelView interpolate(const NovelView& coarse, int width, int height, int step) {
  constexpr float kSameSurface = 0.1f;  // largest relative difference of the four depths
  NovelView view = blank(width, height);
  parallel_chunks(0, height, 16, [&](int y_begin, int y_end) {
    for (int y = y_begin; y < y_end; ++y) {
      const int y0 = y / step, y1 = std::min(y0 + 1, coarse.image.rows - 1);
      const float fy = static_cast<float>(y % step) / static_cast<float>(step);
      for (int x = 0; x < width; ++x) {
        const int x0 = x / step, x1 = std::min(x0 + 1, coarse.image.cols - 1);
        const float fx = static_cast<float>(x % step) / static_cast<float>(step);
        const int ny = fy < 0.5f ? y0 : y1, nx = fx < 0.5f ? x0 : x1;
        view.image(y, x) = coarse.image(ny, nx);
        view.depth(y, x) = coarse.depth(ny, nx);
        view.source(y, x) = coarse.source(ny, nx);
        const float d00 = coarse.depth(y0, x0), d01 = coarse.depth(y0, x1), d10 = coarse.depth(y1, x0),
                    d11 = coarse.depth(y1, x1);
        const float low = std::min(std::min(d00, d01), std::min(d10, d11));
        const float high = std::max(std::max(d00, d01), std::max(d10, d11));
        if (low <= 0 || high > (1 + kSameSurface) * low) continue;
        const float w00 = (1 - fx) * (1 - fy), w01 = fx * (1 - fy), w10 = (1 - fx) * fy, w11 = fx * fy;
        view.depth(y, x) = w00 * d00 + w01 * d01 + w10 * d10 + w11 * d11;
        const cv::Vec3b &a = coarse.image(y0, x0), &b = coarse.image(y0, x1), &c = coarse.image(y1, x0),
                        &d = coarse.image(y1, x1);
        for (int k = 0; k < 3; ++k) {
          view.image(y, x)[k] = static_cast<uint8_t>(w00 * a[k] + w01 * b[k] + w10 * c[k] + w11 * d[k] + 0.5f);
        }
      }
    }
  });
  return view;
}

// Holes that are nowhere more than `widest` pixels across get the colours of the background beside them, as wholes: a
// hole that is filled in part looks worse than one left dark. What is not seen lies behind the objects that hide it.
// Depth and source go on saying that nothing is known.
void fill_small_holes(NovelView& view, int widest) {
  if (widest <= 0) return;
  const int width = view.image.cols, height = view.image.rows;
  const cv::Mat1b mask = view.source < 0;
  cv::Mat1i labels;
  const int components = cv::connectedComponents(mask, labels, 8, CV_32S);
  if (components == 1) return;
  cv::Mat1f to_rim;  // [px] 1 beside the rim
  cv::distanceTransform(mask, to_rim, cv::DIST_C, 3, CV_32F);
  std::vector<bool> small(static_cast<size_t>(components), true);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const int label = labels(y, x);
      const bool at_border = x == 0 || y == 0 || x == width - 1 || y == height - 1;
      if (label > 0 && (at_border || 2 * to_rim(y, x) - 1 > static_cast<float>(widest))) {
        small[static_cast<size_t>(label)] = false;
      }
    }
  }
  parallel_chunks(0, height, 16, [&](int y_begin, int y_end) {
    for (int y = y_begin; y < y_end; ++y) {
      for (int x = 0; x < width; ++x) {
        if (labels(y, x) == 0 || !small[static_cast<size_t>(labels(y, x))]) continue;
        // The nearest known pixel in each of the four directions counts by the reciprocal of its distance, if it shows
        // the background. All lie inside the picture, since small holes do not touch its border.
        constexpr float kForeground = 0.9f;  // of the farthest depth: what is nearer belongs to another object
        std::array<cv::Point, 4> rim;
        std::array<float, 4> weights{};
        float farthest = 0;
        size_t known = 0;
        for (const auto& [dx, dy] : {std::pair{-1, 0}, {1, 0}, {0, -1}, {0, 1}}) {
          int n = 1;
          while (labels(y + n * dy, x + n * dx) != 0) ++n;
          rim[known] = {x + n * dx, y + n * dy};
          weights[known] = 1 / static_cast<float>(n);
          farthest = std::max(farthest, view.depth(rim[known]));
          ++known;
        }
        cv::Vec3f sum(0, 0, 0);
        float total = 0;
        for (size_t i = 0; i < known; ++i) {
          if (view.depth(rim[i]) < kForeground * farthest) continue;
          sum += weights[i] * cv::Vec3f(view.image(rim[i]));
          total += weights[i];
        }
        for (int k = 0; k < 3; ++k) view.image(y, x)[k] = static_cast<uint8_t>(sum[k] / total + 0.5f);
      }
    }
  });
}

}  // namespace

Vector3d pixel_ray(const NovelCamera& camera, double x, double y) {
  if (camera.projection == Projection::pinhole) return {(x - camera.cx) / camera.f, (y - camera.cy) / camera.f, 1};
  const double longitude = ((x + 0.5) / camera.width - 0.5) * 2 * std::numbers::pi;
  const double latitude = ((y + 0.5) / camera.height - 0.5) * std::numbers::pi;  // down is positive
  return {std::cos(latitude) * std::sin(longitude), std::sin(latitude), std::cos(latitude) * std::cos(longitude)};
}

RayHit walk_ray(const PreparedSource& source, const Vector3d& direction, const Vector3d& origin, double from,
                double max_disparity_step) {
  if (source.max_disparity() <= 0) return {};
  return walk(source, depth_range(source), direction, origin, from, static_cast<float>(max_disparity_step));
}

NovelView render_novel_view(const NovelCamera& camera,
                            const std::vector<std::shared_ptr<const PreparedSource>>& prepared,
                            const DsnvOptions& options, const FurtherSource& further) {
  IRIS_CHECK(camera.width > 0 && camera.height > 0);
  IRIS_CHECK(camera.projection == Projection::equirectangular || camera.f > 0);
  IRIS_CHECK(options.step == 1 || options.step == 2 || options.step == 4);
  IRIS_CHECK(options.fusion == "agreement" || options.fusion == "nearest");
  IRIS_CHECK(prepared.size() <= kMostSources);
  std::vector<Source> sources;
  for (const auto& source : prepared) sources.push_back(source_of(camera, *source));
  const int step = options.step;
  NovelView view = blank((camera.width + step - 1) / step, (camera.height + step - 1) / step);
  trace(camera, sources, options, view);
  auto index = static_cast<int16_t>(sources.size());
  for (int i = 0; further && i < options.hole_sources; ++i, ++index) {
    const std::shared_ptr<const PreparedSource> source = further(view);
    if (source == nullptr) break;
    trace_holes(camera, source_of(camera, *source), index, options, view);
  }
  if (step > 1) view = interpolate(view, camera.width, camera.height, step);
  fill_small_holes(view, options.fill_holes);
  return view;
}

NovelView render_novel_view(const NovelCamera& camera, const std::vector<std::shared_ptr<const StereoView>>& sources,
                            const DsnvOptions& options) {
  std::vector<std::shared_ptr<const PreparedSource>> prepared(sources.size());
  parallel_chunks(0, static_cast<int>(sources.size()), 1, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      prepared[static_cast<size_t>(i)] = std::make_shared<PreparedSource>(sources[static_cast<size_t>(i)], options);
    }
  });
  return render_novel_view(camera, prepared, options);
}

}  // namespace iris::render
