#include "iris/tour/camera_path.h"

#include <algorithm>
#include <cmath>
#include <functional>
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

// As many keyframes as frames, evenly over the length of a tour.
CameraPath dense_path(double length, const TourOptions& options, const std::function<Pose(double part)>& pose_at) {
  const int last = std::max(1, static_cast<int>(std::ceil(length * options.fps - 1e-9)));
  CameraPath path;
  for (int i = 0; i <= last; ++i) {
    const double part = static_cast<double>(i) / last;
    path.keyframes.push_back({.t = part * length, .world_from_cam = pose_at(part), .fov = options.fov * kDegrees});
  }
  return path;
}

constexpr double kSecondsPerTurn = 12;

double turning_seconds(const TourOptions& options) {
  return options.seconds > 0 ? options.seconds : std::max(1.0, kSecondsPerTurn * std::abs(options.turns));
}

// Rotation vector that takes a to b.
Vector3d turn_between(const Matrix3d& a, const Matrix3d& b) {
  const Eigen::AngleAxisd relative(Matrix3d(a.transpose() * b));
  return relative.angle() * relative.axis();
}

Matrix3d turned(const Matrix3d& from, const Vector3d& turn) {
  const double angle = turn.norm();
  return angle < 1e-15 ? from : Matrix3d(from * Eigen::AngleAxisd(angle, turn / angle).toRotationMatrix());
}

// Velocity at a keyframe: that of the parabola through it and its neighbours; at the ends that of the parabola through
// the three last.
struct Velocity {
  Vector3d position = Vector3d::Zero();  // [m/s]
  Vector3d turn = Vector3d::Zero();      // [rad/s] in the keyframe's own frame
  double fov = 0;                        // [rad/s]
};

Velocity mean_velocity(const CameraKeyframe& a, const CameraKeyframe& b) {
  const double dt = b.t - a.t;
  return {.position = (b.world_from_cam.translation() - a.world_from_cam.translation()) / dt,
          .turn = turn_between(a.world_from_cam.linear(), b.world_from_cam.linear()) / dt,
          .fov = (b.fov - a.fov) / dt};
}

Velocity blend(const Velocity& a, double weight_a, const Velocity& b, double weight_b) {
  return {.position = weight_a * a.position + weight_b * b.position,
          .turn = weight_a * a.turn + weight_b * b.turn,
          .fov = weight_a * a.fov + weight_b * b.fov};
}

Velocity velocity_at(const std::vector<CameraKeyframe>& keys, size_t i) {
  const size_t last = keys.size() - 1;
  if (last == 1) return mean_velocity(keys[0], keys[1]);
  if (i > 0 && i < last) {
    const double before = keys[i].t - keys[i - 1].t, after = keys[i + 1].t - keys[i].t;
    return blend(mean_velocity(keys[i - 1], keys[i]), after / (before + after), mean_velocity(keys[i], keys[i + 1]),
                 before / (before + after));
  }
  const size_t n = i == 0 ? 1 : last - 1;  // the neighbour
  const Velocity near = i == 0 ? mean_velocity(keys[0], keys[1]) : mean_velocity(keys[last - 1], keys[last]);
  return blend(near, 2, velocity_at(keys, n), -1);
}

CameraKeyframe spline(const std::vector<CameraKeyframe>& keys, size_t i, double t) {
  const CameraKeyframe &a = keys[i], &b = keys[i + 1];
  const double dt = b.t - a.t, u = (t - a.t) / dt;
  const Velocity va = velocity_at(keys, i), vb = velocity_at(keys, i + 1);
  Pose controls[4] = {a.world_from_cam, a.world_from_cam, b.world_from_cam, b.world_from_cam};
  controls[1].translation() += va.position * (dt / 3);
  controls[1].linear() = turned(a.world_from_cam.linear(), va.turn * (dt / 3));
  controls[2].translation() -= vb.position * (dt / 3);
  controls[2].linear() = turned(b.world_from_cam.linear(), -vb.turn * (dt / 3));
  for (int level = 3; level > 0; --level) {
    for (int k = 0; k < level; ++k) controls[k] = interpolate(controls[k], controls[k + 1], u);
  }
  double fov[4] = {a.fov, a.fov + va.fov * dt / 3, b.fov - vb.fov * dt / 3, b.fov};
  for (int level = 3; level > 0; --level) {
    for (int k = 0; k < level; ++k) fov[k] += u * (fov[k + 1] - fov[k]);
  }
  return {.t = t, .world_from_cam = controls[0], .fov = std::clamp(fov[0], 1 * kDegrees, 170 * kDegrees)};
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
  set.add("ease", ease, "s", 0, 100,
          "Time in which the camera gathers speed at the beginning and loses it at the end of an orbit, a turn, a walk "
          "or a spline.");
  set.add("eye", eye, "m", -1, 10000,
          "Height of the eye above the world's zero (the floor, where one was found) on walks, orbits and panoramas; "
          "negative: the median height of the recording camera, from where pictures are best.");
  set.add("clearance", clearance, "m", 0, 10, "A walk keeps so far from everything that the map does not show free.");
  set.add("walk_speed", walk_speed, "m/s", 0.01, 100, "Speed of a walk.");
  set.add("turn_rate", turn_rate, "deg/s", 1, 1000,
          "A walk, and a spline whose keyframes have no times, turn at most so fast.");
  set.add("radius", radius, "m", 0, 100000,
          "Radius of an orbit. 0 chooses it: the distance from which the recording camera saw its centre, or less "
          "where the map is not free.");
  set.add("turns", turns, "turns", -100, 100, "Full turns of an orbit or a panorama; negative: clockwise from above.");
  set.add("swing", swing, "deg", -180, 180,
          "follow, fixed: the virtual camera stands so far to the right round what the recording camera looks at.");
  set.add("rise", rise, "deg", -80, 80, "follow, fixed: and so far up.");
  set.add("distance", distance, "m", 0, 10000,
          "follow, fixed: distance of that point in front of the recording camera; 0 = the median depth of the scene.");
  set.add("layout", layout, {"plain", "side-by-side"},
          "What a picture shows: the novel view alone, or recorded image, map with both cameras and novel view.");
  set.add("fade", fade, "s", 0, 60, "Time of fading in from black and out to black.");
  set.add("frame_format", frame_format, {"png", "jpeg"}, "Pictures of a tour that is written as a folder.");
  set.add("depth", depth, {"none", "png", "exr", "both"},
          "Depth images beside the pictures: 16-bit PNG [mm], floating-point EXR [m]; 0 = unknown.");
  set.add("robot_scale", robot_scale, "m", 1e-6, 1e6, "Length of the unit of the robot's model (0.001: millimetres).");
  set.add("robot_camera", robot_camera, {},
          "x,y,z: where the left camera is in the robot's model, in metres (x forward, y left, z up).");
}

Pose looking(const Vector3d& position, const Vector3d& direction) {
  IRIS_CHECK(direction.norm() > 0);
  const Vector3d forward = direction.normalized();
  Vector3d right = forward.cross(Vector3d::UnitZ());
  right = right.norm() > 1e-9 ? Vector3d(right.normalized()) : Vector3d(-Vector3d::UnitY());
  Pose pose = Pose::Identity();
  pose.linear().col(0) = right;
  pose.linear().col(1) = forward.cross(right);
  pose.linear().col(2) = forward;
  pose.translation() = position;
  return pose;
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
  return dense_path(length, options, [&](double part) {
    const Pose recording = smoothed_pose(nodes, part * recorded, options.smoothing);
    // In the smoothed camera's frame: the virtual camera, and the turn about x that puts the looked-at point in the
    // middle.
    Pose recording_from_virtual = Pose::Identity();
    recording_from_virtual.translation() = Vector3d(0, -above, -back);
    recording_from_virtual.linear() =
        Eigen::AngleAxisd(-std::atan2(above, back + scene_depth), Vector3d::UnitX()).matrix();
    return Pose(recording * recording_from_virtual);
  });
}

CameraPath follow(const std::vector<PoseNode>& nodes, const TourOptions& options, double scene_depth, bool fixed) {
  IRIS_CHECK(!nodes.empty() && scene_depth > 0);
  const int64_t begin_ns = nodes.front().stamp_ns;
  const double recorded = seconds_between(begin_ns, nodes.back().stamp_ns);
  // Turned about the looked-at point: first up, about the picture's x, then to the right, about its y.
  const Vector3d looked_at(0, 0, scene_depth);
  Pose recording_from_virtual = Pose::Identity();
  recording_from_virtual.linear() = (Eigen::AngleAxisd(-options.swing * kDegrees, Vector3d::UnitY()) *
                                     Eigen::AngleAxisd(-options.rise * kDegrees, Vector3d::UnitX()))
                                        .toRotationMatrix();
  recording_from_virtual.translation() = looked_at - recording_from_virtual.linear() * looked_at;
  return dense_path(options.seconds > 0 ? options.seconds : std::max(recorded, 1 / options.fps), options,
                    [&](double part) {
                      const double at = fixed ? 0 : part * recorded;
                      return Pose(recorded_pose(nodes, begin_ns + std::llround(at * 1e9)) * recording_from_virtual);
                    });
}

CameraPath orbit(const Vector3d& centre, double radius, double height, const Vector3d& from,
                 const TourOptions& options) {
  IRIS_CHECK(radius > 0);
  const Vector3d beginning = from - centre;
  const double first = beginning.head<2>().norm() > 0 ? std::atan2(beginning.y(), beginning.x()) : 0;
  CameraPath path = dense_path(turning_seconds(options), options, [&](double part) {
    const double angle = first + 2 * std::numbers::pi * options.turns * part;
    const Vector3d position(centre.x() + radius * std::cos(angle), centre.y() + radius * std::sin(angle), height);
    return looking(position, centre - position);
  });
  path.ease = options.ease;
  return path;
}

CameraPath turn_around(const Vector3d& position, double yaw, const TourOptions& options) {
  CameraPath path = dense_path(turning_seconds(options), options, [&](double part) {
    const double angle = yaw + 2 * std::numbers::pi * options.turns * part;
    return looking(position, {std::cos(angle), std::sin(angle), 0});
  });
  path.ease = options.ease;
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
  if (path.interpolation == CameraPath::Interpolation::spline) {
    return spline(path.keyframes, static_cast<size_t>(next - path.keyframes.begin()) - 1, t);
  }
  const double part = (t - a.t) / (b.t - a.t);
  return {.t = t,
          .world_from_cam = interpolate(a.world_from_cam, b.world_from_cam, part),
          .fov = a.fov + part * (b.fov - a.fov)};
}

double eased_time(const CameraPath& path, double since) {
  const double length = duration(path), ramp = std::min(path.ease, 0.5 * length);
  const double at = std::clamp(since, 0.0, length);
  const double begin = path.keyframes.empty() ? 0 : path.keyframes.front().t;
  if (ramp <= 0) return begin + at;
  // Speed rises as smoothstep 3 u^2 - 2 u^3 in `ramp`, whose integral is u^3 - u^4 / 2, half of the time.
  const double speed = length / (length - ramp);
  const auto gathered = [&](double seconds) {
    const double u = std::min(seconds / ramp, 1.0);
    return speed * (ramp * u * u * u * (1 - 0.5 * u) + std::max(0.0, seconds - ramp));
  };
  return begin + (at <= length - ramp ? gathered(at) : length - gathered(length - at));
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
