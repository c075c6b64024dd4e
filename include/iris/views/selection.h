// Which frames are stored as stereo views: storing every frame would repeat the same pictures (thesis 7.2).
#pragma once

#include "iris/core/options.h"
#include "iris/geometry/pose.h"
#include "iris/geometry/rectified_camera.h"

namespace iris::views {

struct ViewsOptions {
  double min_moved_baselines = 2;  // [baselines] a view is stored when it moved at least so far; >= 0, 0 = every frame
  double min_turned = 0.5;         // [fields of view] or turned by more than this part of the horizontal field of view
  void declare(OptionSet& set);
};

// True if the current frame moved or turned far enough from the last stored one. Both poses in one sub-map.
bool is_new_view(const Pose& world_from_last, const Pose& world_from_cur, const RectifiedCamera& camera,
                 const ViewsOptions& options);

// Horizontal field of view [rad].
double field_of_view(const RectifiedCamera& camera);

}  // namespace iris::views
