#include "export/view_surface.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>

#include "iris/core/error.h"

namespace iris::exporters {
namespace {

using reconstruct::FusedPixel;
using reconstruct::FusedView;

constexpr float kJump = 2;      // [px]
constexpr float kSteep = 0.1f;  // of the disparity: far away 2 px are many metres

// Samples in a square of 2^k + 1 on each side, of which the image covers a corner.
class Grid {
 public:
  Grid(const StereoView& view, const FusedView& fused, int step, const std::function<bool(const FusedPixel&)>& wanted)
      : step_(step), offset_(step / 2) {
    columns_ = (view.disparity.disparity.cols - offset_ + step - 1) / step;
    rows_ = (view.disparity.disparity.rows - offset_ + step - 1) / step;
    side_ = static_cast<int>(std::bit_ceil(static_cast<unsigned>(std::max({columns_, rows_, 2}) - 1)));
    samples_.resize(static_cast<size_t>(side_ + 1) * static_cast<size_t>(side_ + 1));
    for (const FusedPixel& pixel : fused.pixels) {
      Sample& sample = samples_[index((pixel.x - offset_) / step, (pixel.y - offset_) / step)];
      sample = {pixel.disparity, pixel.sigma, wanted(pixel) ? State::wanted : State::known};
    }
  }

  TriangleMesh mesh(const RectifiedCamera& camera, double tolerance) {
    find_errors();
    TriangleMesh result;
    vertices_.assign(samples_.size(), -1);
    for (const Triangle& half : halves()) add(half, tolerance, camera, result);
    return result;
  }

 private:
  enum class State : uint8_t { none, known, wanted };
  struct Sample {
    float disparity = 0, sigma = 0;
    State state = State::none;
    float error = 0;  // [standard deviations] of triangles whose longest side has its middle here, and of those within
  };
  struct Corner {
    int x, y;
  };
  struct Triangle {
    Corner a, b, c;  // c is the right angle
    Corner middle() const { return {(a.x + b.x) / 2, (a.y + b.y) / 2}; }
    bool smallest() const { return std::abs(a.x - c.x) + std::abs(a.y - c.y) <= 1; }
  };

  size_t index(int x, int y) const {
    return static_cast<size_t>(y) * static_cast<size_t>(side_ + 1) + static_cast<size_t>(x);
  }
  static bool jumps(const Sample& a, const Sample& b) {
    return std::abs(a.disparity - b.disparity) > std::min(kJump, kSteep * std::min(a.disparity, b.disparity));
  }
  Sample& at(const Corner& c) { return samples_[index(c.x, c.y)]; }

  // Of the square.
  std::array<Triangle, 2> halves() const {
    const Corner low{0, 0}, high{side_, side_};
    return {Triangle{low, high, {side_, 0}}, Triangle{high, low, {0, side_}}};
  }

  // All parts of a triangle after so many splits that are not outside of the image.
  template <class Visit>
  void for_each_part(const Triangle& t, int splits, const Visit& visit) {
    if (std::min({t.a.x, t.b.x, t.c.x}) >= columns_ || std::min({t.a.y, t.b.y, t.c.y}) >= rows_) return;
    if (splits == 0) {
      visit(t);
      return;
    }
    const Corner m = t.middle();
    for_each_part({t.c, t.a, m}, splits - 1, visit);
    for_each_part({t.b, t.c, m}, splits - 1, visit);
  }

  // From the smallest triangles that can be split to the largest, so that each has its parts' errors.
  void find_errors() {
    const int last = 2 * std::countr_zero(static_cast<unsigned>(side_)) - 1;
    for (int splits = last; splits >= 0; --splits) {
      for (const Triangle& half : halves()) {
        for_each_part(half, splits, [&](const Triangle& t) { find_error(t, splits == last); });
      }
    }
  }

  // `last`: its halves are the smallest.
  void find_error(const Triangle& t, bool last) {
    const Corner m = t.middle();
    Sample& middle = at(m);
    const Sample &a = at(t.a), &b = at(t.b);
    float error = 0;
    if (a.state != b.state || a.state != middle.state) {
      error = std::numeric_limits<float>::infinity();
    } else if (middle.state != State::none) {
      error = std::abs((a.disparity + b.disparity) / 2 - middle.disparity) / middle.sigma;
    }
    if (last) {
      // The smallest decide for themselves where the right angle belongs to another surface.
      const Sample& c = at(t.c);
      if (c.state != a.state || jumps(a, c) || jumps(b, c) || jumps(a, b)) {
        error = std::numeric_limits<float>::infinity();
      }
    }
    middle.error = std::max(middle.error, error);
    if (last) return;
    for (const Triangle& part : {Triangle{t.c, t.a, m}, Triangle{t.b, t.c, m}}) {
      middle.error = std::max(middle.error, at(part.middle()).error);
    }
  }

  void add(const Triangle& t, double tolerance, const RectifiedCamera& camera, TriangleMesh& result) {
    const Corner m = t.middle();
    if (!t.smallest() && at(m).error > tolerance) {
      add({t.c, t.a, m}, tolerance, camera, result);
      add({t.b, t.c, m}, tolerance, camera, result);
      return;
    }
    const Sample &a = at(t.a), &b = at(t.b), &c = at(t.c);
    if (a.state == State::none || b.state == State::none || c.state == State::none) return;
    if (a.state != State::wanted && b.state != State::wanted && c.state != State::wanted) return;
    if (t.smallest() && (jumps(a, b) || jumps(b, c) || jumps(c, a))) return;
    // x right, y down: clockwise in the image is counter-clockwise for whom z points away.
    const bool clockwise = (t.b.x - t.a.x) * (t.c.y - t.a.y) - (t.b.y - t.a.y) * (t.c.x - t.a.x) > 0;
    const int ia = vertex(t.a, camera, result), ib = vertex(t.b, camera, result), ic = vertex(t.c, camera, result);
    result.triangles.push_back(clockwise ? Eigen::Vector3i(ia, ic, ib) : Eigen::Vector3i(ia, ib, ic));
  }

  int vertex(const Corner& corner, const RectifiedCamera& camera, TriangleMesh& result) {
    int& vertex = vertices_[index(corner.x, corner.y)];
    if (vertex >= 0) return vertex;
    vertex = static_cast<int>(result.vertices.size());
    const int x = offset_ + corner.x * step_, y = offset_ + corner.y * step_;
    result.vertices.push_back(camera.point(x, y, at(corner).disparity).cast<float>());
    result.texture_coordinates.emplace_back((x + 0.5f) / static_cast<float>(camera.width),
                                            (y + 0.5f) / static_cast<float>(camera.height));
    return vertex;
  }

  int step_, offset_;
  int columns_ = 0, rows_ = 0;  // of the samples that the image has
  int side_ = 0;
  std::vector<Sample> samples_;
  std::vector<int> vertices_;
};

}  // namespace

TriangleMesh view_surface(const StereoView& view, const FusedView& fused, int step, double tolerance,
                          const std::function<bool(const FusedPixel&)>& wanted) {
  IRIS_CHECK(view.camera.width == view.disparity.disparity.cols);
  return Grid(view, fused, step, wanted).mesh(view.camera, tolerance);
}

}  // namespace iris::exporters
