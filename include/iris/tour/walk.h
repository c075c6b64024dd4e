// Walks through the free space of the map: planned on its cells, at the height of an eye, never through walls or
// through what is not known.
#pragma once

#include <optional>
#include <vector>

#include "iris/mapping/flog.h"
#include "iris/tour/camera_path.h"

namespace iris::tour {

// Where one can stand. World coordinates [m], z up; a point belongs to the cell that it lies in.
class FreeSpace {
 public:
  explicit FreeSpace(const mapping::MapRaster& raster);

  bool free(const Eigen::Vector2d& point) const;
  mapping::MapState state(const Eigen::Vector2d& point) const;  // unknown outside of the map
  // Distance [m] to the nearest cell that is not free: between the middles of the cells, less half a cell, so that it
  // is wrong by less than a cell. 0 where the point's own cell is not free.
  double clearance(const Eigen::Vector2d& point) const;
  // The nearest point (the middle of a cell) with at least that clearance.
  std::optional<Eigen::Vector2d> nearest(const Eigen::Vector2d& point, double least_clearance) const;
  // The nearest point to which way() leads from `from`; none if it cannot begin there.
  std::optional<Eigen::Vector2d> nearest_reachable(const Eigen::Vector2d& point, const Eigen::Vector2d& from,
                                                   double least_clearance) const;
  // Whether the straight line between two points keeps that clearance, looked at every half cell.
  bool straight(const Eigen::Vector2d& from, const Eigen::Vector2d& to, double least_clearance) const;

  double cell() const { return cell_; }
  // The shortest way between two points over cells with at least that clearance, where cells nearer than twice as far
  // from an obstacle count up to five times: the middle of a door is better than its post (A*, eight neighbours). Ends
  // at the points themselves; empty if there is none.
  std::vector<Eigen::Vector2d> way(const Eigen::Vector2d& from, const Eigen::Vector2d& to,
                                   double least_clearance) const;

 private:
  int index_of(const Eigen::Vector2d& point) const;  // of the cell; -1 outside of the map
  Eigen::Vector2d middle_of(int index) const;
  double cost(double clearance, double least_clearance) const;  // of a metre
  double cost_of_line(const Eigen::Vector2d& from, const Eigen::Vector2d& to, double least_clearance) const;

  double cell_ = 0, origin_x_ = 0, origin_y_ = 0;
  int width_ = 0, height_ = 0;
  cv::Mat1b state_;      // row 0 = smallest y
  cv::Mat1f clearance_;  // [m]
};

enum class WalkStatus { ok, not_free, not_connected };

struct WalkPlan {
  WalkStatus status = WalkStatus::ok;
  int stop_idx = 0;                                   // of the first stop that cannot be reached
  mapping::MapState state = mapping::MapState::free;  // not_free: what is there instead
  std::optional<Eigen::Vector2d> nearest;  // where one could stand instead; with not_connected: coming from the stop
                                           // before
  std::vector<Eigen::Vector2d> points;     // ok: the way, smooth, about a cell apart
};

// A way that visits the stops in their order. Stops in free space that lie too near to something are moved away from
// it. options: clearance.
WalkPlan plan_walk(const FreeSpace& space, const std::vector<Eigen::Vector2d>& stops, const TourOptions& options);

// A camera that walks along the points at height `eye` [m] and looks ahead, level. Duration by walk_speed and
// turn_rate, or options.seconds.
CameraPath walk(const std::vector<Eigen::Vector2d>& points, double eye, const TourOptions& options);

}  // namespace iris::tour
