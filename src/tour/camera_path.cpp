#include "iris/tour/camera_path.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "iris/core/error.h"

namespace iris::tour {
namespace {

using Eigen::Matrix3d;
using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kDegrees = std::numbers::pi / 180;

double seconds_between(int64_t from_ns, int64_t to_ns) { return static_cast<double>(to_ns - from_ns) * 1e-9; }

// Length of the tour [s] for a recording of that length.
double tour_seconds(double recorded, const TourOptions& options) {
  if (options.seconds > 0) return options.seconds;
  return std::max(std::clamp(recorded, 8.0, 10.0), recorded / options.max_speed);
}

// Gaussian mean of the poses around a moment. The recording's ends keep their weight: beyond them the path is continued
// point-symmetrically, so that a straight flight at constant speed stays what it is.
Pose smoothed_pose(const std::vector<PoseNode>& nodes, double at, double sigma) {
  const int64_t origin = nodes.front().stamp_ns;
  const double length = seconds_between(origin, nodes.back().stamp_ns);
  const auto pose_at = [&](double t) { return recorded_pose(nodes, origin + std::llround(t * 1e9)); };
  const Pose middle = pose_at(at);
  if (sigma <= 0 || length <= 0) return middle;
  constexpr int kSamples = 12;  // on each side, three standard deviations
  Vector3d position = Vector3d::Zero();
  Vector3d turn = Vector3d::Zero();  // mean rotation vector relative to the middle
  double total = 0;
  for (int i = -kSamples; i <= kSamples; ++i) {
    const double offset = 3.0 * i / kSamples;
    const double weight = std::exp(-0.5 * offset * offset);
    double t = at + offset * sigma;
    Pose pose;
    if (t < 0 || t > length) {
      const double end = t < 0 ? 0 : length;
      const Pose pose_end = pose_at(end), inside = pose_at(2 * end - t);
      pose = pose_end * inside.inverse() * pose_end;
      pose.translation() = 2 * pose_end.translation() - inside.translation();
    } else {
      pose = pose_at(t);
    }
    position += weight * pose.translation();
    const Eigen::AngleAxisd relative(Matrix3d(middle.linear().transpose() * pose.linear()));
    turn += weight * relative.angle() * relative.axis();
    total += weight;
  }
  Pose smooth = Pose::Identity();
  turn /= total;
  smooth.linear() = middle.linear();
  if (turn.norm() > 1e-12)
    smooth.linear() = middle.linear() * Eigen::AngleAxisd(turn.norm(), turn.normalized()).matrix();
  smooth.translation() = position / total;
  return smooth;
}

}  // namespace

void TourOptions::declare(OptionSet& set) {
  set.section("tour");
  set.add("width", width, "px", 16, 16384, "Width of the tour's pictures; even.");
  set.add("height", height, "px", 16, 16384, "Height of the tour's pictures; even.");
  set.add("fps", fps, "1/s", 0.1, 240, "Pictures of the tour per second.");
  set.add("seconds", seconds, "s", 0, 86400,
          "Length of the tour. 0 chooses it: as long as the recording, but at least 8 s, and at most 10 s as long as "
          "max_speed allows.");
  set.add("max_speed", max_speed, "times", 0.01, 10000,
          "The automatic length shows a recording at most so much faster.");
  set.add(
      "back", back, "m", -1, 10000,
      "Distance of the virtual camera behind the recording one; negative: a third of the median depth of the scene.");
  set.add(
      "above", above, "m", -1, 10000,
      "Height of the virtual camera above the recording one; negative: an eighth of the median depth of the scene.");
  set.add(
      "smoothing", smoothing, "s", 0, 100,
      "Standard deviation, in recorded time, of the Gaussian that calms the recorded motion. 0 follows every shake.");
  set.add("fov", fov, "deg", 1, 170, "Vertical field of view of the virtual camera.");
  set.add("draw_camera", draw_camera, "Draw the recording camera as a pyramid.");
  set.add("draw_path", draw_path, "Draw the recorded path as a line.");
}

Pose interpolate(const Pose& from, const Pose& to, double part) {
  Pose pose = Pose::Identity();
  pose.translation() = from.translation() + part * (to.translation() - from.translation());
  pose.linear() = Quaterniond(from.linear()).slerp(part, Quaterniond(to.linear())).toRotationMatrix();
  return pose;
}

Pose recorded_pose(const std::vector<PoseNode>& nodes, int64_t stamp_ns) {
  IRIS_CHECK(!nodes.empty());
  const auto next = std::upper_bound(nodes.begin(), nodes.end(), stamp_ns,
                                     [](int64_t stamp, const PoseNode& node) { return stamp < node.stamp_ns; });
  if (next == nodes.begin()) return nodes.front().world_from_cam;
  if (next == nodes.end()) return nodes.back().world_from_cam;
  const PoseNode &a = *(next - 1), &b = *next;
  const double part = seconds_between(a.stamp_ns, stamp_ns) / seconds_between(a.stamp_ns, b.stamp_ns);
  return interpolate(a.world_from_cam, b.world_from_cam, part);
}

CameraPath along(const std::vector<PoseNode>& nodes, const TourOptions& options, double scene_depth) {
  IRIS_CHECK(!nodes.empty() && scene_depth > 0);
  const double recorded = seconds_between(nodes.front().stamp_ns, nodes.back().stamp_ns);
  const double length = tour_seconds(recorded, options);
  const double back = options.back >= 0 ? options.back : scene_depth / 3;
  const double above = options.above >= 0 ? options.above : scene_depth / 8;
  const int last = std::max(1, static_cast<int>(std::ceil(length * options.fps - 1e-9)));
  CameraPath path;
  for (int i = 0; i <= last; ++i) {
    const double part = static_cast<double>(i) / last;
    const Pose recording = smoothed_pose(nodes, part * recorded, options.smoothing);
    // In the smoothed camera's frame: the virtual camera, and the turn about x that puts the looked-at point in the
    // middle.
    const Vector3d behind_and_above(0, -above, -back);
    const double pitch = std::atan2(above, back + scene_depth);
    Pose recording_from_virtual = Pose::Identity();
    recording_from_virtual.translation() = behind_and_above;
    recording_from_virtual.linear() = Eigen::AngleAxisd(-pitch, Vector3d::UnitX()).matrix();
    path.keyframes.push_back(
        {.t = part * length, .world_from_cam = recording * recording_from_virtual, .fov = options.fov * kDegrees});
  }
  return path;
}

double duration(const CameraPath& path) {
  return path.keyframes.empty() ? 0 : path.keyframes.back().t - path.keyframes.front().t;
}

CameraKeyframe sample(const CameraPath& path, double t) {
  IRIS_CHECK(!path.keyframes.empty());
  const auto next = std::upper_bound(path.keyframes.begin(), path.keyframes.end(), t,
                                     [](double time, const CameraKeyframe& key) { return time < key.t; });
  if (next == path.keyframes.begin()) return path.keyframes.front();
  if (next == path.keyframes.end()) return path.keyframes.back();
  const CameraKeyframe &a = *(next - 1), &b = *next;
  const double part = (t - a.t) / (b.t - a.t);
  return {.t = t,
          .world_from_cam = interpolate(a.world_from_cam, b.world_from_cam, part),
          .fov = a.fov + part * (b.fov - a.fov)};
}

NovelCamera novel_camera(const CameraKeyframe& keyframe, const TourOptions& options) {
  return {.projection = Projection::pinhole,
          .width = options.width,
          .height = options.height,
          .f = 0.5 * options.height / std::tan(0.5 * keyframe.fov),
          .cx = 0.5 * (options.width - 1),
          .cy = 0.5 * (options.height - 1),
          .world_from_cam = keyframe.world_from_cam};
}

}  // namespace iris::tour
