#include "iris/simulate/floor_plan.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <mutex>

#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/rectify/rectifier.h"
#include "tracer.h"

namespace iris::simulate {
namespace {

constexpr int kRayStep = 2;         // [px] every second row and column of each frame
constexpr double kBorder = 0.5e-3;  // [m] a surface on the border of a cell may be met on its other side

enum CellBits : uint8_t { kSurface = 1, kSeenThrough = 2, kSeenTextured = 4, kSeenPlain = 8 };

// Cells in a rectangle, layer after layer, rows of growing y.
struct Cells {
  double cell = 0;
  std::vector<double> bounds;  // [m] of the layers
  int x0 = 0, y0 = 0, width = 0, height = 0;
  std::vector<uint8_t> bits;

  int layers() const { return static_cast<int>(bounds.size()) - 1; }
  int index_of(double metres) const { return static_cast<int>(std::floor(metres / cell)); }
  bool contains(int ix, int iy) const { return ix >= x0 && iy >= y0 && ix < x0 + width && iy < y0 + height; }
  size_t at(int ix, int iy, int layer) const {
    return (static_cast<size_t>(layer) * height + (iy - y0)) * width + (ix - x0);
  }
};

// A convex polygon: a triangle cut by up to six planes.
struct Polygon {
  std::array<Eigen::Vector3d, 9> corners;
  int count = 0;

  double low(int axis) const {
    double value = std::numeric_limits<double>::infinity();
    for (int i = 0; i < count; ++i) value = std::min(value, corners[static_cast<size_t>(i)](axis));
    return value;
  }
  double high(int axis) const {
    double value = -std::numeric_limits<double>::infinity();
    for (int i = 0; i < count; ++i) value = std::max(value, corners[static_cast<size_t>(i)](axis));
    return value;
  }
  // What lies on the side `sign` of the plane, the plane included.
  Polygon cut(int axis, double plane, double sign) const {
    Polygon result;
    for (int i = 0; i < count; ++i) {
      const Eigen::Vector3d &a = corners[static_cast<size_t>(i)], &b = corners[static_cast<size_t>((i + 1) % count)];
      const double from = sign * (a(axis) - plane), to = sign * (b(axis) - plane);
      if (from >= 0) result.corners[static_cast<size_t>(result.count++)] = a;
      if ((from > 0 && to < 0) || (from < 0 && to > 0)) {
        Eigen::Vector3d met = a + (b - a) * (from / (from - to));
        met(axis) = plane;
        result.corners[static_cast<size_t>(result.count++)] = met;
      }
    }
    return result;
  }
  // What lies in [low, high). A polygon that touches `high` only has no part in it.
  Polygon between(int axis, double from, double to) const {
    Polygon result = cut(axis, from, 1).cut(axis, to, -1);
    if (result.count > 0 && result.low(axis) >= to) result.count = 0;
    return result;
  }
};

// Marks the cells [ix, ix+1) x [iy, iy+1) x [bounds[k], bounds[k+1]) that share a point with the triangle.
void mark_triangle(Cells& cells, const Polygon& triangle) {
  for (int k = 0; k < cells.layers(); ++k) {
    const double bottom = cells.bounds[static_cast<size_t>(k)], top = cells.bounds[static_cast<size_t>(k) + 1];
    const Polygon slice = triangle.between(2, bottom, top);
    if (slice.count == 0) continue;
    for (int iy = cells.index_of(slice.low(1)); iy <= cells.index_of(slice.high(1)); ++iy) {
      const Polygon row = slice.between(1, iy * cells.cell, (iy + 1) * cells.cell);
      if (row.count == 0 || row.low(2) >= top) continue;
      const int last = cells.index_of(row.high(0));
      for (int ix = cells.index_of(row.low(0)); ix <= last; ++ix) {
        if (ix == last) {  // the inner ones are crossed from side to side
          const Polygon part = row.between(0, ix * cells.cell, (ix + 1) * cells.cell);
          if (part.count == 0 || part.low(1) >= (iy + 1) * cells.cell || part.low(2) >= top) continue;
        }
        if (cells.contains(ix, iy)) cells.bits[cells.at(ix, iy, k)] |= kSurface;
      }
    }
  }
}

// Cuts [from, to] of a line to where one coordinate lies in [low, high].
void cut_line(double origin, double direction, double low, double high, double& from, double& to) {
  if (direction == 0) {
    if (!(origin >= low && origin < high)) to = from - 1;
    return;
  }
  const double a = (low - origin) / direction, b = (high - origin) / direction;
  from = std::max(from, std::min(a, b));
  to = std::min(to, std::max(a, b));
}

// Marks what a ray passes on its first `length` metres (Amanatides and Woo's walk, layer by layer).
void mark_ray(const Cells& cells, const Eigen::Vector3d& origin, const Eigen::Vector3d& direction, double length,
              uint8_t* bits) {
  double inside_from = 0, inside_to = length;
  cut_line(origin.x(), direction.x(), cells.x0 * cells.cell, (cells.x0 + cells.width) * cells.cell, inside_from,
           inside_to);
  cut_line(origin.y(), direction.y(), cells.y0 * cells.cell, (cells.y0 + cells.height) * cells.cell, inside_from,
           inside_to);
  for (int k = 0; k < cells.layers(); ++k) {
    double from = inside_from, to = inside_to;
    cut_line(origin.z(), direction.z(), cells.bounds[static_cast<size_t>(k)], cells.bounds[static_cast<size_t>(k) + 1],
             from, to);
    if (!(from < to)) continue;
    const Eigen::Vector3d start = origin + from * direction;
    int ix = std::clamp(cells.index_of(start.x()), cells.x0, cells.x0 + cells.width - 1);
    int iy = std::clamp(cells.index_of(start.y()), cells.y0, cells.y0 + cells.height - 1);
    const int step_x = direction.x() > 0 ? 1 : -1, step_y = direction.y() > 0 ? 1 : -1;
    const auto border = [&](int axis, int index) {
      if (direction(axis) == 0) return std::numeric_limits<double>::infinity();
      return ((index + (direction(axis) > 0 ? 1 : 0)) * cells.cell - origin(axis)) / direction(axis);
    };
    double next_x = border(0, ix), next_y = border(1, iy);
    while (true) {
      bits[cells.at(ix, iy, k)] |= kSeenThrough;
      if (std::min(next_x, next_y) >= to) break;
      if (next_x < next_y) {
        ix += step_x;
        next_x = border(0, ix);
      } else {
        iy += step_y;
        next_y = border(1, iy);
      }
      if (!cells.contains(ix, iy)) break;
    }
  }
}

// Marks the occupied cell that a point on a surface belongs to, or, if float precision has put it beyond the border of
// that cell, the occupied ones next to it.
void mark_hit(const Cells& cells, const Eigen::Vector3d& point, uint8_t mark, uint8_t* bits) {
  for (const double reach : {0.0, kBorder}) {
    bool found = false;
    for (int k = 0; k < cells.layers(); ++k) {
      if (point.z() + reach < cells.bounds[static_cast<size_t>(k)]) continue;
      if (point.z() - reach >= cells.bounds[static_cast<size_t>(k) + 1]) continue;
      for (int iy = cells.index_of(point.y() - reach); iy <= cells.index_of(point.y() + reach); ++iy) {
        for (int ix = cells.index_of(point.x() - reach); ix <= cells.index_of(point.x() + reach); ++ix) {
          if (!cells.contains(ix, iy) || !(cells.bits[cells.at(ix, iy, k)] & kSurface)) continue;
          bits[cells.at(ix, iy, k)] |= mark;
          found = true;
        }
      }
    }
    if (found) return;
  }
}

uint8_t plan_value(uint8_t bits) {
  if (bits & kSurface)
    return bits & kSeenTextured ? kPlanOccupied : bits & kSeenPlain ? kPlanOccupiedPlain : kPlanOccupiedUnseen;
  return bits & kSeenThrough ? kPlanFree : kPlanUnknown;
}

// Of cells above each other: occupied (seen before unseen), else free, else unknown.
uint8_t above_each_other(uint8_t a, uint8_t b) {
  const auto rank = [](uint8_t value) { return value == kPlanUnknown ? 256 : static_cast<int>(value); };
  return rank(a) < rank(b) ? a : b;
}

// The rectangle (x, y) [m] that holds what stands still and the cameras; what rays pass outside of it is of no
// interest.
Eigen::AlignedBox2d rectangle_of(const Scene& scene, const Simulator& simulator) {
  Eigen::AlignedBox2d box;
  for (const SceneObject& object : scene.objects) {
    if (object.world_from_object) continue;
    for (const Eigen::Vector3f& vertex : object.mesh.vertices) box.extend(vertex.head<2>().cast<double>());
  }
  for (int i = 0; i < simulator.frames(); ++i) {
    box.extend(simulator.world_from_left(i).translation().head<2>());
  }
  return box;
}

}  // namespace

double floor_plan_cells(const Scene& scene, const Simulator& simulator, double cell, int layers) {
  const Eigen::Vector2d size = rectangle_of(scene, simulator).sizes() / cell;
  return layers * (std::floor(size.x()) + 2) * (std::floor(size.y()) + 2);
}

FloorPlan floor_plan(const Scene& scene, const Simulator& simulator, double cell,
                     const std::vector<double>& layer_bounds, double max_range) {
  IRIS_CHECK(cell > 0 && max_range > 0 && layer_bounds.size() >= 2);
  IRIS_CHECK(std::is_sorted(layer_bounds.begin(), layer_bounds.end()));
  const int frames = simulator.frames();

  const Eigen::AlignedBox2d rectangle = rectangle_of(scene, simulator);
  const Eigen::Vector2d &low = rectangle.min(), &high = rectangle.max();
  IRIS_CHECK(floor_plan_cells(scene, simulator, cell, static_cast<int>(layer_bounds.size()) - 1) <=
             kMostFloorPlanCells);
  Cells cells;
  cells.cell = cell;
  cells.bounds = layer_bounds;
  cells.x0 = cells.index_of(low.x()), cells.y0 = cells.index_of(low.y());
  cells.width = cells.index_of(high.x()) - cells.x0 + 1, cells.height = cells.index_of(high.y()) - cells.y0 + 1;
  cells.bits.resize(static_cast<size_t>(cells.layers()) * cells.height * cells.width);

  for (const SceneObject& object : scene.objects) {
    if (object.world_from_object) continue;
    for (const Eigen::Vector3i& triangle : object.mesh.triangles) {
      Polygon polygon;
      for (int i = 0; i < 3; ++i) {
        polygon.corners[static_cast<size_t>(i)] = object.mesh.vertices[static_cast<size_t>(triangle(i))].cast<double>();
      }
      polygon.count = 3;
      mark_triangle(cells, polygon);
    }
  }

  const Tracer tracer(scene);
  const RectifiedCamera& camera = simulator.rectified_camera();
  const rectify::Rectifier rectifier(simulator.calibration());
  const Eigen::Matrix3d left_from_rect = rectifier.rect_from_left().transpose();
  std::vector<Eigen::Vector3d> in_left;  // rays of unit length that the recorded camera sees
  for (int y = 0; y < camera.height; y += kRayStep) {
    for (int x = 0; x < camera.width; x += kRayStep) {
      const Eigen::Vector2d source = rectifier.left_source(Eigen::Vector2d(x, y));
      const bool seen =
          source.x() >= 0 && source.y() >= 0 && source.x() <= camera.width - 1 && source.y() <= camera.height - 1;
      if (!seen) continue;
      in_left.push_back(left_from_rect *
                        Eigen::Vector3d((x - camera.cx) / camera.f, (y - camera.cy) / camera.f, 1).normalized());
    }
  }
  std::mutex merging;
  std::vector<uint8_t> seen(cells.bits.size());
  parallel_chunks(0, frames, 4, [&](int begin, int end) {
    std::vector<uint8_t> bits(cells.bits.size());
    std::vector<Eigen::Vector3d> directions(in_left.size());
    std::vector<Tracer::Point> hits(in_left.size());
    for (int frame = begin; frame < end; ++frame) {
      const Pose world_from_left = simulator.world_from_left(frame);
      const Eigen::Vector3d origin = world_from_left.translation();
      const Eigen::Matrix3d turn = world_from_left.linear();
      for (size_t i = 0; i < in_left.size(); ++i) directions[i] = turn * in_left[i];
      const double seconds = static_cast<double>(simulator.stamp_ns(frame) - simulator.stamp_ns(0)) * 1e-9;
      tracer.trace(tracer.at(seconds), origin, directions, hits);
      for (size_t i = 0; i < hits.size(); ++i) {
        const bool met = hits[i].object_idx >= 0 && hits[i].along <= max_range;
        mark_ray(cells, origin, directions[i], met ? hits[i].along : max_range, bits.data());
        if (!met) continue;
        const SceneObject& object = scene.objects[static_cast<size_t>(hits[i].object_idx)];
        if (object.world_from_object) continue;
        mark_hit(cells, origin + directions[i] * hits[i].along, object.textured ? kSeenTextured : kSeenPlain,
                 bits.data());
      }
    }
    // Whatever the order of the chunks, the union is the same.
    const std::lock_guard lock(merging);
    for (size_t i = 0; i < bits.size(); ++i) seen[i] |= bits[i];
  });
  for (size_t i = 0; i < seen.size(); ++i) cells.bits[i] |= seen[i];

  // The rectangle of the cells that are known, as mapping::rasterise has it.
  int x0 = std::numeric_limits<int>::max(), y0 = x0, x1 = std::numeric_limits<int>::min(), y1 = x1;
  for (int k = 0; k < cells.layers(); ++k) {
    for (int iy = cells.y0; iy < cells.y0 + cells.height; ++iy) {
      for (int ix = cells.x0; ix < cells.x0 + cells.width; ++ix) {
        if (cells.bits[cells.at(ix, iy, k)] == 0) continue;
        x0 = std::min(x0, ix), x1 = std::max(x1, ix), y0 = std::min(y0, iy), y1 = std::max(y1, iy);
      }
    }
  }
  if (x1 < x0) x0 = x1 = cells.x0, y0 = y1 = cells.y0;
  FloorPlan plan;
  plan.cell = cell;
  plan.origin_x = x0 * cell, plan.origin_y = y0 * cell;
  plan.layer_bounds = layer_bounds;
  plan.combined = cv::Mat1b(y1 - y0 + 1, x1 - x0 + 1, static_cast<uchar>(kPlanUnknown));
  for (int k = 0; k < cells.layers(); ++k) {
    cv::Mat1b layer(plan.combined.size());
    for (int row = 0; row < layer.rows; ++row) {
      for (int column = 0; column < layer.cols; ++column) {
        layer(row, column) = plan_value(cells.bits[cells.at(x0 + column, y1 - row, k)]);
        plan.combined(row, column) = above_each_other(plan.combined(row, column), layer(row, column));
      }
    }
    plan.layers.push_back(layer);
  }
  return plan;
}

}  // namespace iris::simulate
