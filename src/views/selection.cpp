#include "iris/views/selection.h"

#include <cmath>

namespace iris::views {

void ViewsOptions::declare(OptionSet& set) {
  set.section("views");
  set.add("min_moved_baselines", min_moved_baselines, "baselines", 0, 1000,
          "Store a frame as a view when the camera moved at least so many stereo baselines since the last stored one. "
          "Fewer views save time and disk; more views fill more holes of a tour. 0 stores every frame.");
  set.add("min_turned", min_turned, "fields of view", 0, 4,
          "Or when it turned by more than this part of its horizontal field of view.");
}

double field_of_view(const RectifiedCamera& camera) {
  return std::atan((camera.width - 0.5 - camera.cx) / camera.f) + std::atan((camera.cx + 0.5) / camera.f);
}

bool is_new_view(const Pose& world_from_last, const Pose& world_from_cur, const RectifiedCamera& camera,
                 const ViewsOptions& options) {
  const Pose last_from_cur = world_from_last.inverse() * world_from_cur;
  return last_from_cur.translation().norm() >= options.min_moved_baselines * camera.baseline ||
         rotation_angle(last_from_cur) > options.min_turned * field_of_view(camera);
}

}  // namespace iris::views
