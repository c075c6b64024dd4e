// What the stored views say about where to look.
#pragma once

#include <optional>

#include "iris/tour/camera_path.h"
#include "iris/tour/walk.h"
#include "iris/views/view_store.h"

namespace iris::tour {

// Median depth [m] of the scene before the stored views of a sub-map (from at most 16 of them, evenly chosen): what
// along() wants. 0 if no view has a disparity.
double scene_depth(const views::ViewStore& store, int submap);

struct LookedAt {
  Eigen::Vector3d point;  // world [m]
  double distance = 0;    // [m] median distance of the views that look at it
  int views = 0;          // how many of those asked do
};

// The surface point that most views look at: in the middle half of their image, and not hidden (their own disparity
// there is that of the point, or smaller). Candidates are the points in the middle of the images. At most 64 views,
// evenly chosen, are asked. None if no view has a disparity in its middle.
std::optional<LookedAt> most_looked_at(const views::ViewStore& store, int submap);

// The largest radius up to `radius` at which least of a circle about `centre` is not free: of those between a third of
// it and all of it, in steps of a cell.
double free_radius(const FreeSpace& space, const Eigen::Vector2d& centre, double radius);

// Number of frames of a tour that stand where the map is not free, and the first of them.
struct Standing {
  int blocked = 0;
  int first = -1;
};
Standing standing(const FreeSpace& space, const CameraPath& path, const TourOptions& options);

}  // namespace iris::tour
