#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "iris/core/error.h"
#include "iris/simulate/scene.h"

namespace iris::simulate {
namespace {

using ::testing::HasSubstr;

const Scene& scene_of(const std::string& name) {
  static std::map<std::string, Scene> scenes;
  const auto found = scenes.find(name);
  return found != scenes.end() ? found->second : scenes.emplace(name, make_scene(name, 1)).first->second;
}

SimulateOptions options_of(const std::string& path, double jitter = 0) {
  SimulateOptions options;
  options.path = path;
  options.jitter = jitter;
  return options;
}

const std::vector<std::pair<std::string, std::string>> kPaths = {
    {"apartment", "round"},     {"apartment", "corridor"}, {"apartment", "circle"},  {"apartment", "roam"},
    {"seminar-room", "circle"}, {"seminar-room", "roam"},  {"yard", "round"},        {"boxes", "circle"},
    {"boxes", "circle-far"},    {"grasp", "static"},       {"calibration", "around"}};

class EveryPath : public ::testing::TestWithParam<std::pair<std::string, std::string>> {
 protected:
  const Scene& scene_ = scene_of(GetParam().first);
};
INSTANTIATE_TEST_SUITE_P(Paths, EveryPath, ::testing::ValuesIn(kPaths), [](const auto& info) {
  std::string name = info.param.first + "_" + info.param.second;
  std::replace(name.begin(), name.end(), '-', '_');
  return name;
});

TEST_P(EveryPath, IsSmoothAndWithinItsLimits) {
  const SimulateOptions options = options_of(GetParam().second);
  const SimulatedPath path = make_path(scene_, options);
  EXPECT_EQ(path.name, GetParam().second);
  ASSERT_GT(path.seconds, 5);
  const double limit = GetParam().second == "roam" ? 60 : 45;  // [deg/s]
  constexpr double h = 0.005;
  double length = 0;
  Eigen::Vector3d last_velocity = Eigen::Vector3d::Zero(), last_turning = Eigen::Vector3d::Zero();
  for (double t = 0; t + h <= path.seconds; t += h) {
    const Pose a = path.world_from_cam(t), b = path.world_from_cam(t + h);
    const Eigen::Vector3d velocity = (b.translation() - a.translation()) / h;
    const Eigen::AngleAxisd turn(Eigen::Matrix3d(a.linear().transpose() * b.linear()));
    const Eigen::Vector3d turning = a.linear() * turn.axis() * (turn.angle() * 180 / M_PI / h);
    length += velocity.norm() * h;
    EXPECT_LE(velocity.norm(), options.speed * 1.01) << t;
    EXPECT_LE(turning.norm(), limit * 1.03) << t;
    if (t > 0) {
      // No jump of velocity (C1): at most 5 m/s^2 and 400 deg/s^2.
      EXPECT_LE((velocity - last_velocity).norm() / h, 5) << t;
      EXPECT_LE((turning - last_turning).norm() / h, 400) << t;
    }
    last_velocity = velocity;
    last_turning = turning;
    const Eigen::Matrix3d r = a.linear();
    ASSERT_LT((r.transpose() * r - Eigen::Matrix3d::Identity()).norm(), 1e-9);
    ASSERT_NEAR(r.determinant(), 1, 1e-9);
  }
  EXPECT_NEAR(length, path.length, 0.02 * path.length + 0.01);
}

TEST_P(EveryPath, ClosesAndBeginsLevel) {
  for (const double jitter : {0.0, 1.0}) {
    const SimulatedPath path = make_path(scene_, options_of(GetParam().second, jitter));
    const Pose first = path.world_from_cam(0), last = path.world_from_cam(path.seconds);
    EXPECT_LT((first.translation() - last.translation()).norm(), 1e-6);
    EXPECT_LT(rotation_angle(first.inverse() * last), 1e-6);
    if (GetParam().second == "static") continue;
    // x of the camera is horizontal, y points down: what z_up_from_camera assumes.
    EXPECT_NEAR(first.linear()(2, 0), 0, 0.02);
    EXPECT_NEAR(first.linear()(2, 1), -1, 0.01);
  }
}

TEST_P(EveryPath, TheSameSeedGivesTheSamePath) {
  SimulateOptions options = options_of(GetParam().second, 1);
  const SimulatedPath a = make_path(scene_, options), b = make_path(scene_, options);
  options.seed = 2;
  const SimulatedPath other = make_path(scene_, options);
  double difference = 0;
  for (double t = 0; t < a.seconds; t += 0.37) {
    EXPECT_EQ(a.world_from_cam(t).matrix(), b.world_from_cam(t).matrix());
    difference = std::max(difference, (a.world_from_cam(t).matrix() - other.world_from_cam(t).matrix()).norm());
  }
  EXPECT_EQ(difference > 1e-3, GetParam().second != "static");
}

TEST_P(EveryPath, ShakesAsAsked) {
  if (GetParam().second == "static") GTEST_SKIP() << "nobody holds the camera";
  const SimulatedPath still = make_path(scene_, options_of(GetParam().second)),
                      shaken = make_path(scene_, options_of(GetParam().second, 1.5));
  ASSERT_EQ(still.seconds, shaken.seconds);
  if (still.seconds < 20) GTEST_SKIP() << "too short for the statistics";
  Vector6d sum = Vector6d::Zero(), square = Vector6d::Zero();
  int count = 0;
  for (double t = 1; t < still.seconds - 1; t += 0.01, ++count) {
    const Pose offset = still.world_from_cam(t).inverse() * shaken.world_from_cam(t);
    const Eigen::AngleAxisd turn(offset.linear());
    Vector6d v;
    v << offset.translation(), turn.angle() * turn.axis();
    sum += v;
    square += v.cwiseProduct(v);
  }
  for (int i = 0; i < 6; ++i) {
    const double mean = sum[i] / count, deviation = std::sqrt(square[i] / count - mean * mean);
    const double expected = 1.5 * (i < 3 ? 0.008 : 0.6 * M_PI / 180);
    EXPECT_NEAR(deviation, expected, 0.1 * expected) << i;
    EXPECT_NEAR(mean, 0, 0.1 * expected);
  }
}

TEST(Paths, TheRoundGoesThroughAllRoomsOfTheApartment) {
  const SimulatedPath path = make_path(scene_of("apartment"), options_of("auto"));
  EXPECT_EQ(path.name, "round");
  EXPECT_GT(path.length, 60);
  const std::vector<Eigen::AlignedBox2d> rooms = {
      {Eigen::Vector2d(0, 3.9), Eigen::Vector2d(11, 5.3)}, {Eigen::Vector2d(0, 0), Eigen::Vector2d(5, 3.8)},
      {Eigen::Vector2d(5.1, 0), Eigen::Vector2d(8, 3.8)},  {Eigen::Vector2d(8.1, 0), Eigen::Vector2d(11, 3.8)},
      {Eigen::Vector2d(0, 5.4), Eigen::Vector2d(4.2, 9)},  {Eigen::Vector2d(4.3, 5.4), Eigen::Vector2d(7.4, 9)},
      {Eigen::Vector2d(7.5, 5.4), Eigen::Vector2d(11, 9)}};
  std::vector<double> seconds(rooms.size());
  for (double t = 0; t < path.seconds; t += 0.1) {
    const Eigen::Vector3d place = path.world_from_cam(t).translation();
    for (size_t i = 0; i < rooms.size(); ++i) seconds[i] += 0.1 * rooms[i].contains(Eigen::Vector2d(place.head<2>()));
    EXPECT_NEAR(place.z(), 1.4, 1e-9);
  }
  for (const double s : seconds) EXPECT_GT(s, 4);
}

TEST(Paths, SlowerWalksTakeLonger) {
  SimulateOptions options = options_of("round");
  const double quick = make_path(scene_of("apartment"), options).seconds;
  options.speed = 0.25;
  const SimulatedPath slow = make_path(scene_of("apartment"), options);
  EXPECT_GT(slow.seconds, 2 * quick);
  EXPECT_NEAR(slow.seconds, slow.length / 0.25, 0.15 * slow.seconds);  // turning hardly limits it
}

TEST(Paths, RoamTurnsFullyAboutTheOpticalAxis) {
  const Scene& scene = scene_of("seminar-room");
  const SimulatedPath path = make_path(scene, options_of("roam"));
  // Angle of the image's x axis about the optical axis, against the horizontal.
  double total = 0, highest = 0, last = 0;
  for (double t = 0; t <= path.seconds; t += 0.02) {
    const Eigen::Matrix3d r = path.world_from_cam(t).linear();
    const Eigen::Vector3d level = Eigen::Vector3d(r(1, 2), -r(0, 2), 0).normalized();
    const double roll = std::atan2(r.col(0).dot(r.col(2).cross(level)), r.col(0).dot(level));
    if (t > 0) total += std::remainder(roll - last, 2 * M_PI);
    last = roll;
    highest = std::max(highest, total);
    EXPECT_LE((path.world_from_cam(t).translation() - scene.places.circle_centre).norm(), scene.places.circle_radius);
  }
  EXPECT_GT(highest, 0.95 * 2 * M_PI);
  EXPECT_NEAR(total, 0, 1e-3);
}

TEST(Paths, CirclesKeepTheirDistance) {
  const auto distances = [](const std::string& name) {
    const Scene& scene = scene_of("boxes");
    const SimulatedPath path = make_path(scene, options_of(name));
    double least = 1e9, most = 0;
    for (double t = 0; t < path.seconds; t += 0.05) {
      const Pose pose = path.world_from_cam(t);
      const double d = (pose.translation() - scene.places.look_at[0]).head<2>().norm();
      least = std::min(least, d), most = std::max(most, d);
      // The thing is in the middle of the image's width.
      const Eigen::Vector3d in_cam = pose.inverse() * scene.places.look_at[0];
      EXPECT_LT(std::abs(in_cam.x()), 0.02);
      EXPECT_GT(in_cam.z(), 1);
    }
    return std::pair(least, most);
  };
  EXPECT_THAT(distances("circle"),
              ::testing::Pair(::testing::DoubleNear(1.1, 0.002), ::testing::DoubleNear(1.1, 0.002)));
  EXPECT_THAT(distances("circle-far"),
              ::testing::Pair(::testing::DoubleNear(1.6, 0.005), ::testing::DoubleNear(2.0, 0.005)));
}

// Calibration needs the target in all parts of both images, near and far, and from all sides.
TEST(Paths, AroundShowsTheTargetEverywhere) {
  for (const std::string name : {"calibration", "calibration:chessboard"}) {
    const Scene& scene = scene_of(name);
    const SimulateOptions options = options_of("around");
    const SimulatedPath path = make_path(scene, options);
    const double f = options.width / 2.0 / std::tan(options.fov / 2 * M_PI / 180);
    constexpr int kGrid = 5;
    std::vector<int> hits(kGrid * kGrid);
    double nearest = 1e9, farthest = 0, most_right = -90, most_left = 90, most_up = -90, most_down = 90;
    int whole = 0, frames = 0;
    for (double t = 0; t < path.seconds; t += 0.2, ++frames) {
      const Pose cam = path.world_from_cam(t);
      bool all = true;
      for (const Eigen::Vector3d& corner : scene.target_corners) {
        const Eigen::Vector3d p = cam.inverse() * corner;
        const double x = f * p.x() / p.z() + options.width / 2.0, y = f * p.y() / p.z() + options.height / 2.0,
                     right = f * (p.x() - options.baseline) / p.z() + options.width / 2.0;
        if (p.z() <= 0 || x < 0 || y < 0 || x >= options.width || y >= options.height || right < 0 ||
            right >= options.width) {
          all = false;
          continue;
        }
        ++hits[static_cast<size_t>(static_cast<int>(y * kGrid / options.height) * kGrid +
                                   static_cast<int>(x * kGrid / options.width))];
      }
      whole += all;
      const Eigen::Vector3d from = cam.translation() - scene.places.look_at[0];
      nearest = std::min(nearest, from.norm()), farthest = std::max(farthest, from.norm());
      const double side = std::atan2(from.x(), -from.y()) * 180 / M_PI,
                   up = std::asin(from.z() / from.norm()) * 180 / M_PI;
      most_right = std::max(most_right, side), most_left = std::min(most_left, side);
      most_up = std::max(most_up, up), most_down = std::min(most_down, up);
    }
    // The right camera does not see the left rim of near things, so that the four corners may stay empty.
    EXPECT_GE(std::count_if(hits.begin(), hits.end(), [](int h) { return h > 0; }), kGrid * kGrid - 4) << name;
    EXPECT_GT(whole, frames * 6 / 10) << name;
    EXPECT_LT(nearest, 0.4);
    EXPECT_GT(farthest, 0.75);
    EXPECT_GT(most_right, 20);
    EXPECT_LT(most_left, -20);
    EXPECT_GT(most_up, 20);
    EXPECT_LT(most_down, -20);
    EXPECT_LT(std::max({most_right, -most_left, most_up, -most_down}), 36);
  }
}

TEST(Paths, AnUnknownPathIsAnErrorThatListsWhatThereIs) {
  try {
    make_path(scene_of("boxes"), options_of("round"));
    FAIL();
  } catch (const UsageError& error) {
    EXPECT_THAT(error.what(), HasSubstr("boxes"));
    EXPECT_THAT(error.what(), HasSubstr("circle-far"));
  }
  EXPECT_EQ(make_path(scene_of("grasp"), options_of("auto")).name, "static");
}

}  // namespace
}  // namespace iris::simulate
