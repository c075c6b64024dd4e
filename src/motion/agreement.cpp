#include "iris/motion/agreement.h"

#include <algorithm>
#include <cmath>

namespace iris::motion {
namespace {

enum class Sight { nothing, agrees, hidden, through };

// What `to` shows within `around` pixels of where the point is predicted.
Sight sight(const DisparityImage& to, const Eigen::Vector3d& point_in_to, const RectifiedCamera& camera, int around) {
  constexpr double kNearest = 0.05;                              // [m]
  constexpr double kTolerance = 1.5, kRelativeTolerance = 0.03;  // [px], part of the disparity
  if (point_in_to.z() < kNearest) return Sight::nothing;
  const Eigen::Vector3d expected = camera.project(point_in_to);
  if (!(expected.x() >= around && expected.y() >= around && expected.x() < to.disparity.cols - 1 - around &&
        expected.y() < to.disparity.rows - 1 - around)) {
    return Sight::nothing;
  }
  const int x = static_cast<int>(std::lround(expected.x())), y = static_cast<int>(std::lround(expected.y()));
  const double tolerance = kTolerance + kRelativeTolerance * expected.z();
  double largest = 0;
  // From the middle: mostly it agrees there.
  for (int ring = 0; ring <= around; ++ring) {
    for (int v = -ring; v <= ring; ++v) {
      for (int u = -ring; u <= ring; u += std::abs(v) == ring ? 1 : std::max(1, 2 * ring)) {
        const double there = to.at(y + v, x + u, DisparityOrigin::corrected);
        if (!(there > 0)) continue;
        if (std::abs(there - expected.z()) <= tolerance) return Sight::agrees;
        largest = std::max(largest, there);
      }
    }
  }
  return largest == 0 ? Sight::nothing : largest < expected.z() ? Sight::through : Sight::hidden;
}

void compare(const DisparityImage& from, const DisparityImage& to, const Pose& to_from_from,
             const RectifiedCamera& camera, Agreement& result) {
  constexpr int kStep = 8, kAround = 2;  // [px]
  for (int y = kStep / 2; y < from.disparity.rows; y += kStep) {
    for (int x = kStep / 2; x < from.disparity.cols; x += kStep) {
      const double d = from.at(y, x, DisparityOrigin::corrected);
      if (!(d > 0) || !(d + camera.disparity_offset > 0)) continue;
      const Sight seen = sight(to, to_from_from * camera.point(x, y, d), camera, kAround);
      result.agreeing += seen == Sight::agrees;
      result.against += seen == Sight::through;
    }
  }
}

}  // namespace

Agreement agreement(const ViewFeatures& prev, const ViewFeatures& cur, const Pose& prev_from_cur,
                    const RectifiedCamera& camera) {
  constexpr int kBorder = 10, kAround = 1;  // [px]
  Agreement result;
  const Pose cur_from_prev = prev_from_cur.inverse();
  for (const Corner& corner : prev.corners) {
    const Eigen::Vector3d in_cur = cur_from_prev * corner.point_in_cam;
    if (!(in_cur.z() > 0)) continue;
    const Eigen::Vector3d expected = camera.project(in_cur);
    if (!(expected.x() >= kBorder && expected.y() >= kBorder && expected.x() < camera.width - 1 - kBorder &&
          expected.y() < camera.height - 1 - kBorder)) {
      continue;  // its surroundings would not be compared
    }
    result.expected += sight(cur.disparity, in_cur, camera, kAround) == Sight::agrees;
  }
  compare(prev.disparity, cur.disparity, cur_from_prev, camera, result);
  compare(cur.disparity, prev.disparity, prev_from_cur, camera, result);
  return result;
}

}  // namespace iris::motion
