// The true map of a simulated session: what mapping should find.
#pragma once

#include <opencv2/core.hpp>
#include <vector>

#include "iris/simulate/simulator.h"

namespace iris::simulate {

// Grey values of a floor plan: a map of ROS reads all three occupied values as occupied.
enum PlanValue : uint8_t {
  kPlanOccupied = 0,         // a textured surface lies in the cell, and a camera saw it
  kPlanOccupiedPlain = 32,   // only untextured surfaces were seen in it
  kPlanOccupiedUnseen = 64,  // a surface that no camera saw
  kPlanUnknown = 205,        // nothing there, and no camera saw through it
  kPlanFree = 254,           // empty, and a camera saw through it
};

struct FloorPlan {
  double cell = 0.05;                 // [m]
  double origin_x = 0, origin_y = 0;  // [m] world, lower-left corner of the lower-left cell
  std::vector<double> layer_bounds;   // [m] world z, ascending, layers + 1
  std::vector<cv::Mat1b> layers;      // PlanValue; row 0 = largest y
  cv::Mat1b combined;                 // over all layers: occupied (seen before unseen), else free, else unknown
};

// Number of cells that floor_plan works on, all layers together: a rectangle around all that stands still and the
// cameras. A double, since it can exceed every integer.
double floor_plan_cells(const Scene& scene, const Simulator& simulator, double cell, int layers);
constexpr double kMostFloorPlanCells = 2e8;  // each is a byte, several times

// Cells as mapping::FlogMap has them (cell bounds are multiples of `cell` in the world), seen from every frame up to
// `max_range` [m]. Requires floor_plan_cells within kMostFloorPlanCells.
FloorPlan floor_plan(const Scene& scene, const Simulator& simulator, double cell,
                     const std::vector<double>& layer_bounds, double max_range);

}  // namespace iris::simulate
