#include "iris/render/dsnv.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

namespace iris::render {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr int kTile = 8;            // [px] side of the square of rays that share one search for free space
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
  if (a.delta < 0 && b.delta > 0) return Meeting::back_side;
  return Meeting::nothing;
}

RayHit walk(const PreparedSource& source, const DepthRange& range, const Vector3d& q, const Vector3d& t, double from,
            float max_step) {
  const RectifiedCamera& camera = source.view().camera;
  const cv::Mat1f& disparity = source.disparity();
  const double last_x = disparity.cols - 1, last_y = disparity.rows - 1;

  // The part of the ray that the source can see. Depth and the sides of the image are linear in s when multiplied by
  // the depth (which is positive), so that neither the epipole (7.8) nor a ray parallel to the image plane is special.
  double s0 = from, s1 = kBeyond;
  const auto keep_where_positive = [&](double slope, double value_at_0) {
    if (slope * s0 + value_at_0 < 0) {
      s0 = slope > 0 ? -value_at_0 / slope : kBeyond;
    } else if (slope * s1 + value_at_0 < 0) {
      s1 = -value_at_0 / slope;
    }
  };
  keep_where_positive(q.z(), t.z() - range.nearest);
  keep_where_positive(-q.z(), range.farthest - t.z());
  if (s0 >= s1) return {};
  const double qx = camera.f * q.x() + camera.cx * q.z(), tx = camera.f * t.x() + camera.cx * t.z();
  const double qy = camera.f * q.y() + camera.cy * q.z(), ty = camera.f * t.y() + camera.cy * t.z();
  keep_where_positive(qx, tx);
  keep_where_positive(last_x * q.z() - qx, last_x * t.z() - tx);
  if (s0 >= s1) return {};
  keep_where_positive(qy, ty);
  keep_where_positive(last_y * q.z() - qy, last_y * t.z() - ty);
  if (s0 >= s1) return {};

  // Its ends in disparity space, where it is a straight line (7.4).
  const double w0 = 1 / (s0 * q.z() + t.z()), w1 = 1 / (s1 * q.z() + t.z());
  const double ft = camera.f * camera.baseline;
  const double x0 = std::clamp((s0 * qx + tx) * w0, 0.0, last_x), x1 = std::clamp((s1 * qx + tx) * w1, 0.0, last_x);
  const double y0 = std::clamp((s0 * qy + ty) * w0, 0.0, last_y), y1 = std::clamp((s1 * qy + ty) * w1, 0.0, last_y);
  const double d0 = ft * w0 - camera.disparity_offset, d1 = ft * w1 - camera.disparity_offset;

  const auto meet = [&](Meeting meeting, double x, double y, double d) {
    const Vector3d p = camera.point(x, y, d);
    return RayHit{.meeting = meeting,
                  .x = static_cast<float>(x),
                  .y = static_cast<float>(y),
                  .disparity = static_cast<float>(d),
                  .along = static_cast<float>(q.dot(p - t) / q.squaredNorm())};
  };

  const double dx = x1 - x0, dy = y1 - y0;
  const double length = std::max(std::abs(dx), std::abs(dy));
  if (length < 1) {  // (7.6): a ray through the source's optical centre is a point in the image
    const float image0 = inside(disparity, static_cast<float>(x0), static_cast<float>(y0), max_step);
    const float image1 = inside(disparity, static_cast<float>(x1), static_cast<float>(y1), max_step);
    const Sample a{static_cast<float>(d0) - image0, image0}, b{static_cast<float>(d1) - image1, image1};
    const Meeting meeting = between(a, b, max_step);
    if (meeting == Meeting::nothing) return {};
    const double v = a.delta / (a.delta - b.delta);  // (7.9)
    return meet(meeting, x0 + v * dx, y0 + v * dy, d0 + v * (d1 - d0));
  }

  // Pixel by pixel along the longer axis (7.5), one pixel beyond both ends where the image goes on.
  const bool by_x = std::abs(dx) >= std::abs(dy);
  const double major0 = by_x ? x0 : y0, minor0 = by_x ? y0 : x0;
  const double slope_minor = by_x ? dy / dx : dx / dy, slope_d = (d1 - d0) / (by_x ? dx : dy);
  const int direction = (by_x ? dx : dy) > 0 ? 1 : -1;
  const double major1 = by_x ? x1 : y1;
  const int first = static_cast<int>(direction > 0 ? std::floor(major0) : std::ceil(major0));
  const int last = static_cast<int>(direction > 0 ? std::ceil(major1) : std::floor(major1));
  const int steps = (last - first) * direction;
  const ptrdiff_t row = static_cast<ptrdiff_t>(disparity.step1());
  const ptrdiff_t major_stride = by_x ? 1 : row, minor_stride = by_x ? row : 1;
  const int minor_count = by_x ? disparity.rows : disparity.cols;
  const float minor_last = static_cast<float>(minor_count - 1);
  const float minor_first = static_cast<float>(minor0 + (first - major0) * slope_minor);
  const float d_first = static_cast<float>(d0 + (first - major0) * slope_d);
  const float minor_step = static_cast<float>(slope_minor * direction),
              d_step = static_cast<float>(slope_d * direction);
  const float* start = disparity[0] + first * major_stride;
  const ptrdiff_t advance = direction * major_stride;

  const auto exact = [&](int i) {
    const float minor = std::clamp(minor_first + static_cast<float>(i) * minor_step, 0.0f, minor_last);
    const float image = on_line(start + i * advance, minor_stride, minor_count, minor, max_step);
    return Sample{d_first + static_cast<float>(i) * d_step - image, image};
  };

  // The nearest pixel tells in most cases that the ray stays in front (or behind): the surface between connected pixels
  // is at most half a step away from it. Only near the surface, or when the side changes, the surface itself is looked
  // up.
  const float clear = 0.5f * max_step;
  int side = 0, known = -2;
  Sample previous;
  for (int i = 0; i <= steps; ++i) {
    const float minor = std::clamp(minor_first + static_cast<float>(i) * minor_step, 0.0f, minor_last);
    const float rough = d_first + static_cast<float>(i) * d_step -
                        start[i * advance + static_cast<ptrdiff_t>(static_cast<int>(minor + 0.5f)) * minor_stride];
    const int side_here = (rough > clear) - (rough < -clear);
    if (side_here != 0 && side_here == side) continue;
    if (known != i - 1 && i > 0) previous = exact(i - 1);
    const Sample here = exact(i);
    if (i > 0) {
      const Meeting meeting = between(previous, here, max_step);
      if (meeting != Meeting::nothing) {
        const double v = previous.delta / (previous.delta - here.delta);  // (7.9)
        const double major = first + direction * (i - 1 + v);
        const double travelled = (major - major0) * direction;
        if (travelled >= -1e-3 && travelled <= length + 1e-3) {
          const double minor_v = minor0 + (major - major0) * slope_minor, d_v = d0 + (major - major0) * slope_d;
          return by_x ? meet(meeting, major, minor_v, d_v) : meet(meeting, minor_v, major, d_v);
        }
      }
    }
    side = side_here;
    previous = here;
    known = i;
  }
  return {};
}

// How far all rays of a tile run through space that the source knows to be free (or does not see): they are walked from
// there. The rays of the tile lie between its four corner rays. Returns kBeyond if they meet nothing at all.
double free_until(const Source& source, const std::array<Vector3d, 4>& corner_rays) {
  const PreparedSource& prepared = *source.prepared;
  const RectifiedCamera& camera = prepared.view().camera;
  const Vector3d& t = source.novel_in_cam;
  double low_qz = corner_rays[0].z(), high_qz = low_qz;
  for (const Vector3d& q : corner_rays) low_qz = std::min(low_qz, q.z()), high_qz = std::max(high_qz, q.z());
  if (high_qz <= 0 && t.z() < source.nearest) return kBeyond;
  if (low_qz <= 1e-6) return 0;  // rays that turn away from the source: rare, walked from their beginning

  double s = t.z() < source.nearest ? (source.nearest - t.z()) / high_qz : 0;
  const double s_end = (source.farthest - t.z()) / low_qz;
  if (s_end <= 0) return kBeyond;
  const Vector3d middle = 0.25 * (corner_rays[0] + corner_rays[1] + corner_rays[2] + corner_rays[3]);
  const double ft = camera.f * camera.baseline;
  // Pixels that the middle ray moves in the image for one pixel of disparity: by (7.4), 1/md and my/md.
  const double pixels_per_disparity =
      std::hypot(middle.x() * t.z() - t.x() * middle.z(), middle.y() * t.z() - t.y() * middle.z()) /
      (camera.baseline * middle.z());
  constexpr double kLongest = 16, kShortest = 2;  // [px]
  double stride = kLongest;
  while (s < s_end) {
    if (s * low_qz + t.z() < 0.5 * source.nearest) return s;  // too wide a tile for its corners to bound it
    const double d_middle = ft / (s * middle.z() + t.z());
    const double d_next = d_middle - stride / std::max(pixels_per_disparity, 1e-9);
    double s_next = d_next > kSmallestDisparity ? (ft / d_next - t.z()) / middle.z() : s_end;
    s_next = std::min(s_next, s_end);
    double left = kBeyond, right = -kBeyond, top = kBeyond, bottom = -kBeyond;
    for (const double at : {s, s_next}) {
      for (const Vector3d& q : corner_rays) {
        const double w = 1 / (at * q.z() + t.z());
        const double x = camera.f * (at * q.x() + t.x()) * w, y = camera.f * (at * q.y() + t.y()) * w;
        left = std::min(left, x), right = std::max(right, x), top = std::min(top, y), bottom = std::max(bottom, y);
      }
    }
    // One pixel more on each side: the surface at a point depends on its neighbours.
    const int width = prepared.disparity().cols, height = prepared.disparity().rows;
    const int x0 = static_cast<int>(std::clamp(std::floor(left + camera.cx) - 1, 0.0, double(width)));
    const int x1 = static_cast<int>(std::clamp(std::ceil(right + camera.cx) + 1, -1.0, width - 1.0));
    const int y0 = static_cast<int>(std::clamp(std::floor(top + camera.cy) - 1, 0.0, double(height)));
    const int y1 = static_cast<int>(std::clamp(std::ceil(bottom + camera.cy) + 1, -1.0, height - 1.0));
    const double d_lowest = ft / (s_next * high_qz + t.z()) - camera.disparity_offset;
    const bool is_free = x0 > x1 || y0 > y1 || prepared.max_in(x0, y0, x1, y1) < d_lowest - 1e-3;
    if (is_free) {
      s = s_next;
      stride = std::min(2 * stride, kLongest);
    } else {
      stride *= 0.5;
      if (stride < kShortest) return s;
    }
  }
  return kBeyond;
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

// The surface that most sources support; their colours and depths are blended. Back sides hide nothing here: a source
// that sees a front there knows better.
Pixel fuse_by_agreement(const std::vector<Source>& sources, const std::vector<RayHit>& hits) {
  constexpr double kDisparityError = 0.5;  // [px] matching and pose error together
  constexpr double kRelativeError = 0.01;  // of the depth in the novel view
  constexpr float kRim = 16;               // [px] towards its border a source fades out, which hides the seam
  const size_t count = sources.size();
  struct Candidate {
    double weight = 0, votes = 0, tolerance = 0;
  };
  std::array<Candidate, 32> candidates;
  for (size_t i = 0; i < count; ++i) {
    Candidate& candidate = candidates[i];
    const RayHit& hit = hits[i];
    if (hit.meeting != Meeting::surface || hit.along <= 0) continue;
    const StereoView& view = sources[i].prepared->view();
    const RectifiedCamera& camera = view.camera;
    const double disparity = hit.disparity + camera.disparity_offset;
    const double depth = camera.f * camera.baseline / disparity;
    candidate.tolerance = kDisparityError * depth / disparity + kRelativeError * hit.along;
    double trust = 1;
    if (!view.disparity.origin.empty()) {
      const int x = std::min(static_cast<int>(hit.x + 0.5f), camera.width - 1);
      const int y = std::min(static_cast<int>(hit.y + 0.5f), camera.height - 1);
      const uint8_t origin = view.disparity.origin(y, x);
      if (origin == static_cast<uint8_t>(DisparityOrigin::within_segment)) trust = 0.7;
      if (origin == static_cast<uint8_t>(DisparityOrigin::between_segments)) trust = 0.3;
    }
    const float to_border =
        std::min(std::min(hit.x, camera.width - 1 - hit.x), std::min(hit.y, camera.height - 1 - hit.y));
    const double fade = std::clamp((to_border + 1) / kRim, 0.05f, 1.0f);
    candidate.votes = trust;
    candidate.weight = trust * fade / (sources[i].distance + 0.02 * hit.along);
  }
  int best = -1;
  double best_votes = 0;
  for (size_t i = 0; i < count; ++i) {
    if (candidates[i].votes == 0) continue;
    double votes = 0;
    for (size_t j = 0; j < count; ++j) {
      const double apart = std::abs(static_cast<double>(hits[i].along) - hits[j].along);
      if (apart <= candidates[i].tolerance + candidates[j].tolerance) votes += candidates[j].votes;
    }
    const bool nearer = best >= 0 && hits[i].along < hits[static_cast<size_t>(best)].along;
    if (votes > best_votes + 1e-9 || (votes > best_votes - 1e-9 && nearer))
      best_votes = votes, best = static_cast<int>(i);
  }
  if (best < 0) return {};

  const size_t winner = static_cast<size_t>(best);
  cv::Vec3d colour(0, 0, 0);
  double depth = 0, total = 0, most = 0;
  Pixel pixel;
  for (size_t j = 0; j < count; ++j) {
    const Candidate& candidate = candidates[j];
    if (candidate.votes == 0) continue;
    const double apart = std::abs(static_cast<double>(hits[winner].along) - hits[j].along);
    if (apart > candidates[winner].tolerance + candidate.tolerance) continue;
    colour += candidate.weight * cv::Vec3d(colour_at(sources[j].prepared->view().image, hits[j].x, hits[j].y));
    depth += candidate.weight * hits[j].along;
    total += candidate.weight;
    if (candidate.weight > most) most = candidate.weight, pixel.source = static_cast<int16_t>(j);
  }
  for (int c = 0; c < 3; ++c) pixel.colour[c] = static_cast<uint8_t>(colour[c] / total + 0.5);
  pixel.depth = static_cast<float>(depth / total);
  return pixel;
}

// Pixel (x, y) of `view` is pixel (step x, step y) of the camera.
void trace(const NovelCamera& camera, const std::vector<Source>& sources, const DsnvOptions& options, NovelView& view) {
  const int step = options.step, width = view.image.cols, height = view.image.rows;
  const float max_step = static_cast<float>(options.max_disparity_step);
  const bool agreement = options.fusion == "agreement";
  parallel_chunks(0, height, kTile, [&](int y_begin, int y_end) {
    const size_t count = sources.size();
    std::vector<std::array<RayHit, kTile * kTile>> hits(count);
    std::array<Vector3d, kTile * kTile> rays;
    std::vector<RayHit> of_pixel(count);
    for (int x_begin = 0; x_begin < width; x_begin += kTile) {
      const int x_end = std::min(x_begin + kTile, width), columns = x_end - x_begin;
      for (int y = y_begin; y < y_end; ++y) {
        for (int x = x_begin; x < x_end; ++x) {
          rays[static_cast<size_t>((y - y_begin) * columns + x - x_begin)] = pixel_ray(camera, x * step, y * step);
        }
      }
      const size_t pixels = static_cast<size_t>((y_end - y_begin) * columns);
      for (size_t i = 0; i < count; ++i) {
        const Source& source = sources[i];
        double from = 0;
        if (camera.projection == Projection::pinhole) {
          from = free_until(
              source, {source.cam_from_novel * rays[0], source.cam_from_novel * rays[static_cast<size_t>(columns - 1)],
                       source.cam_from_novel * rays[pixels - static_cast<size_t>(columns)],
                       source.cam_from_novel * rays[pixels - 1]});
        }
        const DepthRange range{source.nearest, source.farthest};
        for (size_t k = 0; k < pixels; ++k) {
          hits[i][k] = from >= kBeyond ? RayHit{}
                                       : walk(*source.prepared, range, source.cam_from_novel * rays[k],
                                              source.novel_in_cam, from, max_step);
        }
      }
      for (size_t k = 0; k < pixels; ++k) {
        for (size_t i = 0; i < count; ++i) of_pixel[i] = hits[i][k];
        const Pixel pixel = agreement ? fuse_by_agreement(sources, of_pixel) : fuse_nearest(sources, of_pixel);
        const int y = y_begin + static_cast<int>(k) / columns, x = x_begin + static_cast<int>(k) % columns;
        view.image(y, x) = pixel.colour;
        view.depth(y, x) = pixel.depth;
        view.source(y, x) = pixel.source;
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

// Holes up to `widest` pixels across get the colours of their rims; depth and source go on saying that nothing is
// known.
void fill_small_holes(NovelView& view, int widest) {
  if (widest <= 0) return;
  const int width = view.image.cols, height = view.image.rows;
  parallel_chunks(0, height, 16, [&](int y_begin, int y_end) {
    for (int y = y_begin; y < y_end; ++y) {
      for (int x = 0; x < width; ++x) {
        if (view.source(y, x) >= 0) continue;
        // Distance to the first known pixel in a direction, 0 if the picture ends or it is too far.
        const auto rim = [&](int dx, int dy) {
          for (int n = 1; n <= widest; ++n) {
            const int u = x + n * dx, v = y + n * dy;
            if (u < 0 || v < 0 || u >= width || v >= height) return 0;
            if (view.source(v, u) >= 0) return n;
          }
          return 0;
        };
        const int left = rim(-1, 0), right = rim(1, 0), up = rim(0, -1), down = rim(0, 1);
        const int across = left && right ? left + right - 1 : widest + 1;
        const int along = up && down ? up + down - 1 : widest + 1;
        if (std::min(across, along) > widest) continue;
        const bool by_row = across <= along;
        const int a = by_row ? left : up, b = by_row ? right : down;
        const cv::Vec3b ca = by_row ? view.image(y, x - a) : view.image(y - a, x);
        const cv::Vec3b cb = by_row ? view.image(y, x + b) : view.image(y + b, x);
        for (int k = 0; k < 3; ++k)
          view.image(y, x)[k] = static_cast<uint8_t>((ca[k] * b + cb[k] * a + (a + b) / 2) / (a + b));
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
                            const DsnvOptions& options) {
  IRIS_CHECK(camera.width > 0 && camera.height > 0);
  IRIS_CHECK(camera.projection == Projection::equirectangular || camera.f > 0);
  IRIS_CHECK(options.step == 1 || options.step == 2 || options.step == 4);
  IRIS_CHECK(options.fusion == "agreement" || options.fusion == "nearest");
  IRIS_CHECK(prepared.size() <= 32);
  // A source without disparities stays in the list, so that indices remain those of the caller; its ranges are empty.
  std::vector<Source> sources;
  for (const auto& source : prepared) {
    const Pose cam_from_novel = source->view().world_from_cam.inverse() * camera.world_from_cam;
    const DepthRange range = source->max_disparity() > 0 ? depth_range(*source) : DepthRange{1, 0};
    sources.push_back({.prepared = source.get(),
                       .cam_from_novel = cam_from_novel.linear(),
                       .novel_in_cam = cam_from_novel.translation(),
                       .distance = cam_from_novel.translation().norm(),
                       .nearest = range.nearest,
                       .farthest = range.farthest});
  }
  const int step = options.step;
  NovelView view = blank((camera.width + step - 1) / step, (camera.height + step - 1) / step);
  trace(camera, sources, options, view);
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
