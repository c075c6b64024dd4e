// Distances between points of the map, with what is known of their error: a ruler on the reconstruction.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "iris/core/options.h"
#include "iris/loop/pose_graph.h"
#include "iris/types/pose_graph.h"
#include "iris/views/view_store.h"

namespace iris::exporters {

struct MeasureOptions {
  double radius = 0.1;        // [m] a surface within this distance of a picked point is what was meant
  double pixel_error = 0.15;  // [px] dp of (4.26): standard deviation of image coordinates. Measured in a simulated
                              // flat, where it makes errors of distances as large as stated (see the tests)
  double low = -0.2;          // [m] of the world: where a point that was picked without z is looked for …
  double bottom = 0.1, top = 1.9;  // … first between bottom and top, then on the floor between low and bottom

  void declare(OptionSet& set);  // section "measure": radius and pixel_error
};

// A point that was picked, in the world of its sub-map [m]. Without z: on the map from above.
struct PickedPoint {
  Eigen::Vector2d xy = Eigen::Vector2d::Zero();
  std::optional<double> z;
};

// "x,y" or "x,y,z" in metres. Throws UsageError.
PickedPoint parse_point(const std::string& text);

// The surface point that a view measured there.
struct SeenPoint {
  Eigen::Vector3d in_world = Eigen::Vector3d::Zero();  // [m]
  int frame_idx = 0;
  double range = 0;  // [m] from the camera
};

struct Measurement {
  SeenPoint a, b;
  bool in_plan = false;       // a point had no z: the distance is horizontal
  double distance = 0;        // [m]
  double sigma = 0;           // [m] standard deviation, of both parts:
  double reconstruction = 0;  // [m] of the points as their views measured them (4.26)
  double path = 0;            // [m] of the motion between the views; 0 if one view sees both
};

// Each point is measured anew in the views that see it, nearest first; of all pairs of views the one whose distance is
// surest counts. Two points of one view carry errors of reconstruction alone. Between two views the error of the path
// is that of the pose graph (its joint covariance, so that what both poses have in common cancels), or that of both
// poses' covariances taken as independent where this is less: bundle adjustment knows more than the graph.
// Common errors of the calibration (a wrong baseline scales everything) are not contained. `graph`: refined, with
// loops. `where`: named in messages. Throws InputError if no view measured a surface near a point.
Measurement measure(const PoseGraph& graph, const views::ViewStore& views, const PickedPoint& a, const PickedPoint& b,
                    const MeasureOptions& options, const std::string& where);

}  // namespace iris::exporters
