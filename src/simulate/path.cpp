// Ways are closed curves through space, direction and roll. They are sampled, walked as fast as speed and turning
// allow, and smoothed in time by a cubic B-spline: twice differentiable everywhere.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <memory>
#include <vector>

#include "iris/core/error.h"
#include "iris/simulate/scene.h"
#include "texture.h"

namespace iris::simulate {

namespace {

using Vector3 = Eigen::Vector3d;

constexpr double kTurn = 45 * M_PI / 180;      // [rad/s]
constexpr double kRoamTurn = 60 * M_PI / 180;  // [rad/s]
constexpr double kStatic = 12;                 // [s]
constexpr double kStep = 0.05;                 // [s] between the control points of the spline

// x, y, z [m]; yaw (about world z, from x), pitch (up), roll (about the optical axis) [rad].
using Channels = Vector6d;

Pose pose_of(const Channels& c) {
  const double yaw = c[3], pitch = c[4];
  const Vector3 forward(std::cos(yaw) * std::cos(pitch), std::sin(yaw) * std::cos(pitch), std::sin(pitch));
  const Vector3 right(std::sin(yaw), -std::cos(yaw), 0);
  Pose pose = Pose::Identity();
  pose.linear().col(0) = right;
  pose.linear().col(1) = forward.cross(right);
  pose.linear().col(2) = forward;
  pose.linear() = pose.linear() * Eigen::AngleAxisd(c[5], Vector3::UnitZ()).matrix();
  pose.translation() = c.head<3>();
  return pose;
}

Channels channels(const Vector3& place, double yaw, double pitch, double roll = 0) {
  Channels c;
  c << place, yaw, pitch, roll;
  return c;
}

// Control points at equal times. After the last comes the first again, `turn` further.
struct Track {
  std::vector<Channels> points;
  Channels turn = Channels::Zero();
  double step = kStep;  // [s]

  double seconds() const { return step * static_cast<double>(points.size()); }
  Channels point(int64_t i) const {
    const int64_t n = static_cast<int64_t>(points.size());
    const int64_t round = i >= 0 ? i / n : -((-i + n - 1) / n);
    return points[static_cast<size_t>(i - round * n)] + static_cast<double>(round) * turn;
  }
  Channels at(double t) const {
    const double u = t / step, cell = std::floor(u), s = u - cell;
    const int64_t i = static_cast<int64_t>(cell);
    const double s2 = s * s, s3 = s2 * s;
    return ((1 - 3 * s + 3 * s2 - s3) * point(i - 1) + (4 - 6 * s2 + 3 * s3) * point(i) +
            (1 + 3 * s + 3 * s2 - 3 * s3) * point(i + 1) + s3 * point(i + 2)) /
           6;
  }
};

// A closed way: samples at equal steps of its parameter; the one after the last is the first, `turn` further.
struct Way {
  std::vector<Channels> samples;
  Channels turn = Channels::Zero();
};

// Weighted mean over neighbours on a ring; each value of `channels` counts `turn` more a round.
template <class Value>
std::vector<Value> smooth_ring(const std::vector<Value>& values, const Value& turn, double sigma) {
  const int n = static_cast<int>(values.size()), reach = static_cast<int>(std::ceil(3 * sigma));
  std::vector<double> weights;  // by distance
  double sum = 0;
  for (int k = 0; k <= reach; ++k) {
    weights.push_back(std::exp(-k * k / (2 * sigma * sigma)));
    sum += (k == 0 ? 1 : 2) * weights.back();
  }
  std::vector<Value> result(values.size());
  for (int i = 0; i < n; ++i) {
    Value total = turn * 0.0;
    for (int k = -reach; k <= reach; ++k) {
      const int j = i + k, round = j >= 0 ? j / n : -((-j + n - 1) / n);
      const int inside = j - round * n, apart = std::abs(k);
      total += (weights[static_cast<size_t>(apart)] / sum) *
               (values[static_cast<size_t>(inside)] + static_cast<double>(round) * turn);
    }
    result[static_cast<size_t>(i)] = total;
  }
  return result;
}

double distance(const Channels& a, const Channels& b) { return (b - a).head<3>().norm(); }

double way_length(const Way& way) {
  double sum = 0;
  for (size_t i = 0; i < way.samples.size(); ++i)
    sum += distance(way.samples[i], i + 1 < way.samples.size() ? way.samples[i + 1] : way.samples[0]);
  return sum;
}

// Walks the way at `speed`, slower where the camera would turn by more than `turn_rate`.
Track walk(const Way& way, double speed, double turn_rate) {
  const int n = static_cast<int>(way.samples.size());
  const auto sample = [&](int i) -> Channels {
    return i < n ? way.samples[static_cast<size_t>(i)] : Channels(way.samples[static_cast<size_t>(i - n)] + way.turn);
  };
  std::vector<double> pace(static_cast<size_t>(n));  // [s] a step
  double total = 0;
  for (int i = 0; i < n; ++i) {
    const double angle =
        rotation_angle(Eigen::Matrix3d(pose_of(sample(i)).linear().transpose() * pose_of(sample(i + 1)).linear()));
    pace[static_cast<size_t>(i)] = std::max({distance(sample(i), sample(i + 1)) / speed, angle / turn_rate, 1e-6});
    total += pace[static_cast<size_t>(i)];
  }
  // Slow down before the turn and speed up after it: the largest of the neighbours within 0.3 s, then their mean. It
  // is nowhere faster than allowed.
  const int reach = std::max(1, static_cast<int>(std::lround(0.3 / (total / n))));
  std::vector<double> slow(pace.size());
  for (int i = 0; i < n; ++i) {
    double most = 0;
    for (int k = -reach; k <= reach; ++k) most = std::max(most, pace[static_cast<size_t>(((i + k) % n + n) % n)]);
    slow[static_cast<size_t>(i)] = most;
  }
  slow = smooth_ring(slow, 0.0, reach / 3.0);
  std::vector<double> time = {0};
  for (const double step : slow) time.push_back(time.back() + step);
  Track track{.turn = way.turn};
  const int points = std::max(8, static_cast<int>(std::ceil(time.back() / kStep)));
  track.step = time.back() / points;
  int i = 0;
  for (int k = 0; k < points; ++k) {
    const double t = k * track.step;
    while (i + 1 < n && time[static_cast<size_t>(i) + 1] <= t) ++i;
    const double s = (t - time[static_cast<size_t>(i)]) / slow[static_cast<size_t>(i)];
    track.points.push_back((1 - s) * sample(i) + s * sample(i + 1));
  }
  return track;
}

// A closed polyline with rounded corners, looking ahead: the direction is that of the way, smoothed over about a metre
// and a half, so that the camera turns early and gently.
Way along_polyline(const std::vector<Vector3>& polyline) {
  constexpr double kSpacing = 0.02, kRounding = 0.2, kAhead = 0.55;  // [m]
  std::vector<Vector3> points;
  double carry = 0;
  for (size_t i = 0; i < polyline.size(); ++i) {
    const Vector3 &from = polyline[i], &to = polyline[(i + 1) % polyline.size()];
    const double length = (to - from).norm();
    double s = carry;
    for (; s < length; s += kSpacing) points.push_back(from + s / length * (to - from));
    carry = s - length;
  }
  points = smooth_ring(points, Vector3(0, 0, 0), kRounding / kSpacing);
  const size_t n = points.size();
  std::vector<double> yaw(n);
  const auto heading = [&](size_t i) {
    const Vector3 d = points[(i + 1) % n] - points[(i + n - 1) % n];
    return std::atan2(d.y(), d.x());
  };
  double previous = heading(0), turned = previous;
  for (size_t i = 0; i < n; ++i) {
    turned += std::remainder(heading(i) - previous, 2 * M_PI);
    previous = heading(i);
    yaw[i] = turned;
  }
  const double full = turned + std::remainder(heading(0) - previous, 2 * M_PI) - yaw[0];
  yaw = smooth_ring(yaw, full, kAhead / kSpacing);
  Way way;
  way.turn[3] = full;
  for (size_t i = 0; i < n; ++i) way.samples.push_back(channels(points[i], yaw[i], 0));
  return way;
}

Way outward_circle(const Vector3& centre, double radius) {
  constexpr int kSamples = 720;
  Way way;
  way.turn[3] = 2 * M_PI;
  for (int i = 0; i < kSamples; ++i) {
    const double angle = 2 * M_PI * i / kSamples;
    way.samples.push_back(channels(centre + radius * Vector3(std::cos(angle), std::sin(angle), 0), angle, 0));
  }
  return way;
}

// Level, a little above the thing: it is seen in the lower half of the image.
Way inward_circle(const Vector3& look_at, double near, double far) {
  constexpr int kSamples = 720;
  Way way;
  way.turn[3] = 2 * M_PI;
  const double mean = (near + far) / 2;
  for (int i = 0; i < kSamples; ++i) {
    const double angle = 2 * M_PI * i / kSamples - M_PI / 2, radius = mean + (far - near) / 2 * std::sin(2 * angle);
    way.samples.push_back(
        channels(look_at + Vector3(radius * std::cos(angle), radius * std::sin(angle), 0.2 * mean), angle + M_PI, 0));
  }
  return way;
}

double eased(double x) {
  x = std::clamp(x, 0.0, 1.0);
  return x * x * x * (10 - 15 * x + 6 * x * x);
}

// Two rounds about the centre with every kind of movement; one turn about the optical axis and one back.
Way roam(const Vector3& centre, double radius, uint32_t seed) {
  constexpr int kSamples = 3600;
  Random random(hash(seed, 77));
  std::array<double, 8> phase;
  for (double& p : phase) p = 2 * M_PI * random.uniform();
  Way way;
  way.turn[3] = 4 * M_PI;
  const auto sine = [](double u, int times, double p) { return std::sin(2 * M_PI * times * u + p); };
  for (int i = 0; i < kSamples; ++i) {
    const double u = static_cast<double>(i) / kSamples;
    const Vector3 offset(0.4 * sine(u, 3, phase[0]) + 0.25 * sine(u, 5, phase[1]),
                         0.4 * sine(u, 2, phase[2]) + 0.25 * sine(u, 7, phase[3]),
                         0.28 * sine(u, 4, phase[4]) + 0.17 * sine(u, 6, phase[5]));
    const double yaw = 4 * M_PI * u + 0.5 * sine(u, 3, phase[6]);
    const double level = eased(8 * u) * eased(8 * (1 - u));  // begins and ends level
    const double pitch = level * (0.4 * sine(u, 5, phase[7]) + 0.2 * sine(u, 11, phase[0]));
    const double roll =
        2 * M_PI * (eased((u - 0.12) / 0.3) - eased((u - 0.58) / 0.3)) + level * 0.25 * sine(u, 9, phase[2]);
    way.samples.push_back(channels(centre + radius * offset, yaw, pitch, roll));
  }
  return way;
}

// Directions to look from: `stand` from the thing, and up to 35 degrees off it.
Track around(const Scene& scene, const SimulateOptions& options) {
  const ScenePlaces& places = scene.places;
  const Vector3 look_at = places.look_at.front();
  const Vector3 axis = (places.stand - look_at).normalized();
  const double yaw0 = std::atan2(axis.y(), axis.x()), pitch0 = std::asin(std::clamp(axis.z(), -1.0, 1.0));
  double half_width = 0, half_height = 0;  // of what is to stay in the image [m]
  for (const Vector3& corner : scene.target_corners) {
    half_width = std::max(half_width, (corner - look_at).head<2>().norm());
    half_height = std::max(half_height, std::abs(corner.z() - look_at.z()));
  }
  constexpr int kStations = 28;
  Random random(hash(static_cast<uint32_t>(options.seed), 78));
  std::vector<Channels> stations;
  for (int i = 0; i < kStations; ++i) {
    // Distances near, usual, far in turn; the thing in each of 3 x 3 regions of the image; all sides.
    const double distances[] = {places.look_at_distance, places.look_at_near, places.look_at_far};
    const double d = i == 0 ? places.look_at_distance : distances[i % 3] * random.uniform(0.95, 1.05);
    const double tilt = i == 0 ? 0 : (0.25 + 0.7 * random.uniform()) * 35 * M_PI / 180, side = 2.39996 * i;
    const double yaw = yaw0 + tilt * std::cos(side), pitch = pitch0 + tilt * std::sin(side);
    const Vector3 towards(std::cos(yaw) * std::cos(pitch), std::sin(yaw) * std::cos(pitch), std::sin(pitch));
    const double half_fov = options.fov / 2 * M_PI / 180;
    const double half_fov_v = std::atan(std::tan(half_fov) * options.height / options.width);
    // The rig's middle looks at the thing, so that both cameras see it.
    const double middle = std::atan(options.baseline / 2 / d);
    const double room = std::max(0.0, 0.9 * half_fov - std::atan(half_width / d) - middle),
                 room_v = std::max(0.0, 0.85 * half_fov_v - std::atan(half_height / d));
    const int region = i == 0 ? 4 : (i * 4 + i / 9) % 9;
    const int column = region % 3 - 1, row = region / 3 - 1;
    const double off = room * column, off_v = room_v * row;
    const double roll = i == 0 ? 0 : random.uniform(-0.3, 0.3);
    // The camera looks back along -towards; turning left (yaw grows) moves the thing to the right.
    stations.push_back(channels(look_at + d * towards, yaw + M_PI + middle + off, -pitch + off_v, roll));
  }
  Track track;
  for (int i = 0; i < kStations; ++i) {
    const Channels &from = stations[static_cast<size_t>(i)], &to = stations[static_cast<size_t>((i + 1) % kStations)];
    const double angle = rotation_angle(Eigen::Matrix3d(pose_of(from).linear().transpose() * pose_of(to).linear()));
    // The quickest moment of the easing is 1.875 times its mean; the channels' sum can exceed the angle a little.
    const double seconds = std::max({0.5, 1.875 * distance(from, to) / options.speed, 2.2 * angle / kTurn});
    constexpr double kStill = 0.6;  // [s]
    for (double t = 0; t < kStill; t += kStep) track.points.push_back(from);
    const int steps = static_cast<int>(std::ceil(seconds / kStep));
    for (int k = 1; k < steps; ++k) track.points.push_back(from + eased(static_cast<double>(k) / steps) * (to - from));
  }
  return track;
}

// Band-limited shaking of three axes of position [m] and three of rotation [rad].
class Jitter {
 public:
  Jitter(double times, uint32_t seed, double seconds) : seconds_(seconds) {
    Random random(hash(seed, 79));
    const double position = 0.008 * times, angle = 0.6 * M_PI / 180 * times;
    for (int axis = 0; axis < 6; ++axis) {
      for (int k = 0; k < kSines; ++k) {
        // One frequency in each part of the band: no two are near each other, which would beat.
        frequency_[axis][k] = 0.5 + 2.5 * (k + random.uniform(0.2, 0.8)) / kSines;
        phase_[axis][k] = 2 * M_PI * random.uniform();
      }
      amplitude_[axis] = (axis < 3 ? position : angle) * std::sqrt(2.0 / kSines);
    }
  }
  Pose at(double t) const {
    const double fade = eased(t) * eased(seconds_ - t);
    Vector6d v = Vector6d::Zero();
    for (int axis = 0; axis < 6; ++axis) {
      for (int k = 0; k < kSines; ++k)
        v[axis] += fade * amplitude_[axis] * std::sin(2 * M_PI * frequency_[axis][k] * t + phase_[axis][k]);
    }
    Pose pose = Pose::Identity();
    pose.translation() = v.head<3>();
    const double angle = v.tail<3>().norm();
    if (angle > 0) pose.linear() = Eigen::AngleAxisd(angle, v.tail<3>() / angle).matrix();
    return pose;
  }

 private:
  static constexpr int kSines = 6;
  double seconds_;
  double frequency_[6][kSines], phase_[6][kSines], amplitude_[6];
};

}  // namespace

SimulatedPath make_path(const Scene& scene, const SimulateOptions& options) {
  const ScenePlaces& places = scene.places;
  IRIS_CHECK(!places.paths.empty());
  const std::string name = options.path == "auto" ? places.paths.front() : options.path;
  if (std::find(places.paths.begin(), places.paths.end(), name) == places.paths.end()) {
    throw UsageError(
        fmt::format("scene '{}' has no path '{}'; it has: auto, {}", scene.name, name, fmt::join(places.paths, ", ")));
  }
  SimulatedPath path{.name = name};
  if (name == "static") {
    const Vector3 to = places.stand_look_at - places.stand;
    const Pose pose = pose_of(channels(places.stand, std::atan2(to.y(), to.x()), std::asin(to.z() / to.norm())));
    path.seconds = options.frames > 0 ? options.frames / options.rate : kStatic;
    path.world_from_cam = [pose](double) { return pose; };
    return path;
  }
  auto track = std::make_shared<Track>();
  const auto take = [&](const Way& way, double turn_rate) {
    *track = walk(way, options.speed, turn_rate);
    path.length = way_length(way);
  };
  if (name == "around") {
    *track = around(scene, options);
    for (int64_t i = 0; i < static_cast<int64_t>(track->points.size()); ++i)
      path.length += distance(track->point(i), track->point(i + 1));
  } else if (name == "round") {
    take(along_polyline(places.round), kTurn);
  } else if (name == "corridor") {
    // There on one side of the middle, back on the other.
    const Vector3 a = places.corridor.front(), b = places.corridor.back();
    const Vector3 side = 0.15 * (b - a).cross(Vector3::UnitZ()).normalized();
    const Vector3 start = a + 0.1 * (b - a);
    take(along_polyline({start + side, b + side, b - side, a - side, a + side}), kTurn);
  } else if (name == "roam") {
    take(roam(places.circle_centre, places.circle_radius, static_cast<uint32_t>(options.seed)), kRoamTurn);
  } else if (name == "circle-far") {
    take(inward_circle(places.look_at.front(), places.look_at_near, places.look_at_far), kTurn);
  } else {
    IRIS_CHECK(name == "circle");
    take(places.look_at.empty()
             ? outward_circle(places.circle_centre, places.circle_radius)
             : inward_circle(places.look_at.front(), places.look_at_distance, places.look_at_distance),
         kTurn);
  }
  path.seconds = track->seconds();
  const Jitter jitter(options.jitter, static_cast<uint32_t>(options.seed), path.seconds);
  path.world_from_cam = [track, jitter](double t) { return Pose(pose_of(track->at(t)) * jitter.at(t)); };
  return path;
}

}  // namespace iris::simulate
