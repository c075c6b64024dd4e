// Two boxes on a table, circled near and far, as in the thesis's figure 6.4.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "iris/core/parallel.h"
#include "iris/mapping/flog.h"
#include "iris/rectify/rectifier.h"
#include "iris/simulate/simulator.h"
#include "iris/stereo/mwmf.h"

namespace iris::mapping {
namespace {

// The larger box of the scene covers 0.4 x 0.28 m about the origin and stands on a table, 0.752 m high.
constexpr double kHalfX = 0.2, kHalfY = 0.14;

MapRaster map_of_boxes(const std::string& path, double& distance) {
  simulate::SimulateOptions options;
  options.path = path;
  options.rate = 5;
  options.width = 320;
  options.height = 240;
  options.fov = 60;
  options.baseline = 0.144;
  const simulate::Scene scene = simulate::make_scene("boxes", options.seed);
  const simulate::Simulator simulator(scene, simulate::make_path(scene, options), options);
  const rectify::Rectifier rectifier(simulator.calibration());
  stereo::MwmfOptions stereo;
  stereo.disparities = 64;
  stereo.interpolation = "within";
  Pose left_from_rect = Pose::Identity();
  left_from_rect.linear() = rectifier.rect_from_left().transpose();

  std::vector<StereoView> views(static_cast<size_t>(simulator.frames()));
  parallel_chunks(0, simulator.frames(), 1, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      const StereoPair pair = rectifier.rectify(simulator.frame(i));
      views[static_cast<size_t>(i)] = {.frame_idx = i,
                                       .camera = rectifier.camera(),
                                       .image = pair.left,
                                       .disparity = stereo::mwmf(pair.left, pair.right, stereo),
                                       .world_from_cam = simulator.world_from_left(i) * left_from_rect};
    }
  });
  FlogOptions flog;
  flog.cell = 0.02;
  flog.layers = 1;
  flog.slices = 1;
  flog.bottom = 0.77;  // above the table
  flog.height = 0.32;
  FlogBuilder builder(flog, rectifier.camera());
  for (const StereoView& view : views) builder.add(view);
  distance = views.front().world_from_cam.translation().head<2>().norm();
  return rasterise(builder.map(), flog);
}

float at(const MapRaster& raster, double x, double y) {
  const int column = static_cast<int>(std::floor((x - raster.origin_x) / raster.cell));
  const int row = raster.height - 1 - static_cast<int>(std::floor((y - raster.origin_y) / raster.cell));
  const bool inside = column >= 0 && row >= 0 && column < raster.width && row < raster.height;
  return inside ? raster.M(row, column) : 0;
}

// Mean over the lines across a side of the box.
struct Side {
  double offset = 0;     // [m] of the darkest cell from the true side
  double thickness = 0;  // [cells] sum of the map's values
};

// Lines across the side x = `side` (or y = `side`), where neither the corners nor the smaller box are near.
Side across(const MapRaster& raster, bool along_y, double side) {
  constexpr double kReach = 0.1;
  const double half = (along_y ? kHalfY : kHalfX) - 0.05;
  Side result;
  int lines = 0;
  for (double along = -half; along <= half; along += raster.cell, ++lines) {
    float darkest = -1;
    double offset = 0;
    for (double off = -kReach + raster.cell / 2; off < kReach; off += raster.cell) {  // the middles of the cells
      const float value = along_y ? at(raster, side + off, along) : at(raster, along, side + off);
      result.thickness += value;
      if (value > darkest) darkest = value, offset = off;
    }
    result.offset += std::abs(offset);
  }
  result.offset /= lines;
  result.thickness /= lines;
  return result;
}

TEST(Boxes, SidesAreWithinACellOfTheTruthAndThickerFromFarther) {
  double near_distance = 0, far_distance = 0;
  const MapRaster near = map_of_boxes("circle", near_distance), far = map_of_boxes("circle-far", far_distance);
  EXPECT_NEAR(near_distance, 1.1, 0.1);
  EXPECT_GT(far_distance, 1.5);
  EXPECT_LT(far_distance, 2.1);
  double near_thickness = 0, far_thickness = 0;
  // The fourth side, y = +0.14, is hidden by the smaller box.
  for (const auto& [along_y, side] : {std::pair(true, -kHalfX), std::pair(true, kHalfX), std::pair(false, -kHalfY)}) {
    const Side a = across(near, along_y, side), b = across(far, along_y, side);
    EXPECT_LE(a.offset, near.cell) << side;
    EXPECT_LE(b.offset, far.cell) << side;
    EXPECT_GT(b.thickness, a.thickness) << side;
    near_thickness += a.thickness / 3;
    far_thickness += b.thickness / 3;
  }
  RecordProperty("near_cells", std::to_string(near_thickness));
  RecordProperty("far_cells", std::to_string(far_thickness));
  // (4.24): e grows with the square of the distance, 1.1 m against 1.6 to 2 m.
  EXPECT_GT(far_thickness, 1.15 * near_thickness);
}

}  // namespace
}  // namespace iris::mapping
