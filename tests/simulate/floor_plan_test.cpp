#include "iris/simulate/floor_plan.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <string>

#include "iris/core/parallel.h"
#include "simulate/simple_scenes.h"

namespace iris::simulate {
namespace {

// Level, in the world's z-up frame, at eye height, turning once around.
SimulatedPath turning(double z) {
  return moving_path(11, [z](double t) {
    Pose pose = shifted(0, 0, z);
    pose.linear() = Eigen::AngleAxisd(t * CV_PI / 6, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    return Pose(pose * z_up_from_camera());
  });
}

SimulateOptions turning_options() {
  SimulateOptions options = plain_options("real");
  options.rate = 1;
  options.frames = 12;
  options.width = 640;
  options.height = 400;
  return options;
}

// Walls at x = +-2.03 and y = +-1.52, floor at 0, ceiling at 2.5; a plain wall at -y; a box [0.91, 1.22]^2 x [0, 0.75].
Scene room() {
  std::vector<SceneObject> objects;
  const Eigen::Vector3d X(4.06, 0, 0), Y(0, 3.04, 0), Z(0, 0, 2.5), corner(-2.03, -1.52, 0);
  objects.push_back(rectangle(corner, X, Y));
  objects.push_back(rectangle(corner + Z, X, Y));
  objects.push_back(rectangle(corner, X, Z));
  objects.back().textured = false;
  objects.push_back(rectangle(corner + Y, X, Z));
  objects.push_back(rectangle(corner, Y, Z));
  objects.push_back(rectangle(corner + X, Y, Z));
  const Eigen::Vector3d x(0.31, 0, 0), y(0, 0.31, 0), z(0, 0, 0.75), box(0.91, 0.91, 0);
  for (const auto& [o, a, b] : {std::tuple(box, x, z),
                                {box, y, z},
                                {Eigen::Vector3d(box + x), y, z},
                                {Eigen::Vector3d(box + y), x, z},
                                {Eigen::Vector3d(box + z), x, y}}) {
    objects.push_back(rectangle(o, a, b));
  }
  return scene_of(objects);
}

uint8_t value_at(const FloorPlan& plan, const cv::Mat1b& layer, int ix, int iy) {
  const int column = ix - static_cast<int>(std::lround(plan.origin_x / plan.cell));
  const int row = layer.rows - 1 - (iy - static_cast<int>(std::lround(plan.origin_y / plan.cell)));
  if (column < 0 || row < 0 || column >= layer.cols || row >= layer.rows) return kPlanUnknown;
  return layer(row, column);
}

TEST(FloorPlan, OfARoomIsWhatItsMeasuresSay) {
  const Simulator simulator(room(), turning(1.0), turning_options());
  const FloorPlan plan = floor_plan(room(), simulator, 0.05, {0.1, 0.6, 1.1, 1.6}, 10);
  ASSERT_EQ(plan.layers.size(), 3u);
  // The cells of the walls: 2.03 lies in [2.00, 2.05), -2.03 in [-2.05, -2.00), 1.52 in [1.50, 1.55).
  EXPECT_NEAR(plan.origin_x, -2.05, 1e-12);
  EXPECT_NEAR(plan.origin_y, -1.55, 1e-12);
  EXPECT_EQ(plan.combined.size(), cv::Size(82, 62));
  for (size_t k = 0; k < 3; ++k) {
    int wrong = 0;
    std::string where;
    for (int iy = -31; iy <= 30; ++iy) {
      for (int ix = -41; ix <= 40; ++ix) {
        const int wrong_before = wrong;
        const uint8_t value = value_at(plan, plan.layers[k], ix, iy);
        const bool box_layer = k < 2;  // 0.75 m high
        const bool in_box = box_layer && ix >= 18 && ix <= 24 && iy >= 18 && iy <= 24;
        const bool box_side = in_box && (ix == 18 || ix == 24 || iy == 18 || iy == 24);
        const bool x_wall = ix == -41 || ix == 40, y_wall = iy == -31 || iy == 30;
        if (x_wall || y_wall) {
          // Behind the box nothing of the walls is seen from 1 m below 0.75 m.
          const bool behind = box_layer && ix >= 22 && iy >= 18;
          if (behind) {
            wrong += value != kPlanOccupied && value != kPlanOccupiedUnseen;
          } else if (x_wall) {
            wrong += value != kPlanOccupied && !(iy == -31 && value == kPlanOccupiedPlain);
          } else {
            wrong += value != (iy == -31 ? kPlanOccupiedPlain : kPlanOccupied);
          }
        } else if (box_side) {
          // Two of its sides are seen; of the others 2 cm of the top, which rays may miss.
          const bool near_side = ix == 18 || iy == 18, far_side = k == 1 && !near_side;
          wrong += value != (near_side ? kPlanOccupied : kPlanOccupiedUnseen) && !(far_side && value == kPlanOccupied);
        } else if (in_box) {
          // Its inside, or its top.
          wrong += value != (k == 0 ? kPlanUnknown : kPlanOccupied);
        } else {
          // Behind the box, and what lies below the camera's view, may be unknown.
          const bool sure = std::hypot(ix, iy) * 0.05 > 0.3 && !(box_layer && ix >= 18 && iy >= 18);
          const double x = (ix + 0.5) * 0.05, y = (iy + 0.5) * 0.05;
          // Half of the height of the image sees 0.5 / 0.62 of the distance down (319.5 px / 400 px, f = 381).
          const double lowest = 1.0 - 0.40 * std::hypot(x, y);
          const bool in_view = lowest < plan.layer_bounds[k + 1] - 0.02;
          if (sure && in_view)
            wrong += value != kPlanFree;
          else
            wrong += value != kPlanFree && value != kPlanUnknown;
        }
        if (wrong > wrong_before) {
          where += " (" + std::to_string(ix) + ", " + std::to_string(iy) + "): " + std::to_string(value);
        }
      }
    }
    EXPECT_EQ(wrong, 0) << "layer " << k << where;
  }
  for (int row = 0; row < plan.combined.rows; ++row) {
    for (int column = 0; column < plan.combined.cols; ++column) {
      uint8_t occupied = 255, empty = kPlanUnknown;
      for (const cv::Mat1b& layer : plan.layers) {
        const uint8_t value = layer(row, column);
        if (value <= kPlanOccupiedUnseen) occupied = std::min(occupied, value);
        if (value == kPlanFree) empty = kPlanFree;
      }
      ASSERT_EQ(plan.combined(row, column), occupied < 255 ? occupied : empty);
    }
  }
}

TEST(FloorPlan, RaysEndAtTheRange) {
  const Simulator simulator(room(), turning(1.0), turning_options());
  const FloorPlan plan = floor_plan(room(), simulator, 0.05, {0.95, 1.05}, 1);
  for (int iy = -31; iy <= 30; ++iy) {
    for (int ix = -41; ix <= 40; ++ix) {
      const uint8_t value = value_at(plan, plan.layers[0], ix, iy);
      const auto near_side = [](int i) { return i >= 0 ? i * 0.05 : -(i + 1) * 0.05; };
      const double nearest = std::hypot(near_side(ix), near_side(iy));
      const double farthest = std::hypot(near_side(ix) + 0.05, near_side(iy) + 0.05);
      if (ix == -41 || ix == 40 || iy == -31 || iy == 30) {
        EXPECT_EQ(value, kPlanOccupiedUnseen);
      } else if (nearest > 1) {
        EXPECT_EQ(value, kPlanUnknown);
      } else if (farthest < 1) {
        EXPECT_EQ(value, kPlanFree) << ix << " " << iy;
      }
    }
  }
}

TEST(FloorPlan, MovingThingsAreNoPartOfIt) {
  Scene scene = room();
  SceneObject mover = rectangle({-0.9, -0.3, 0.2}, {0, 0.6, 0}, {0, 0, 1.5});
  mover.world_from_object = [](double) { return Pose::Identity(); };
  scene.objects.push_back(mover);
  const Simulator simulator(scene, turning(1.0), turning_options());
  const FloorPlan plan = floor_plan(scene, simulator, 0.05, {0.6, 1.1}, 10);
  for (int iy = -6; iy < 6; ++iy) EXPECT_NE(value_at(plan, plan.layers[0], -18, iy), kPlanOccupied);
  EXPECT_EQ(value_at(plan, plan.layers[0], -25, 0), kPlanUnknown);  // hidden behind it at all times
  EXPECT_EQ(value_at(plan, plan.layers[0], -41, 0), kPlanOccupiedUnseen);
}

TEST(FloorPlan, IsTheSameForAnyNumberOfThreads) {
  const Simulator simulator(room(), turning(1.0), turning_options());
  std::vector<FloorPlan> plans;
  for (const int threads : {1, 2, 5}) {
    with_threads(threads, [&] { plans.push_back(floor_plan(room(), simulator, 0.05, {0.1, 0.6, 1.1}, 3)); });
  }
  for (const FloorPlan& plan : plans) {
    for (size_t k = 0; k < 2; ++k) EXPECT_EQ(cv::norm(plan.layers[k], plans[0].layers[k], cv::NORM_INF), 0);
    EXPECT_EQ(cv::norm(plan.combined, plans[0].combined, cv::NORM_INF), 0);
  }
}

// Separating axes (Akenine-Moeller): does a triangle meet the closed box?
bool meets(const Eigen::Vector3d* corners, const Eigen::Vector3d& low, const Eigen::Vector3d& high) {
  std::vector<Eigen::Vector3d> axes;
  for (int i = 0; i < 3; ++i) axes.push_back(Eigen::Vector3d::Unit(i));
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      axes.push_back((corners[(i + 1) % 3] - corners[i]).cross(Eigen::Vector3d::Unit(j)));
    }
  }
  axes.push_back((corners[1] - corners[0]).cross(corners[2] - corners[0]));
  for (const Eigen::Vector3d& axis : axes) {
    double least = 1e300, most = -1e300;
    for (int i = 0; i < 3; ++i) {
      least = std::min(least, axis.dot(corners[i]));
      most = std::max(most, axis.dot(corners[i]));
    }
    const double middle = axis.dot(low + high) / 2, reach = axis.cwiseAbs().dot(high - low) / 2;
    if (least > middle + reach || most < middle - reach) return false;
  }
  return true;
}

TEST(FloorPlan, OccupiedAreTheCellsThatTrianglesMeet) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> unit(-1, 1);
  const std::vector<double> bounds = {-0.31, 0.13, 0.4};
  constexpr double kCell = 0.05;
  for (int i = 0; i < 30; ++i) {
    SceneObject object;
    const double size = std::exp(unit(random) * 1.5) * 0.3;
    const Eigen::Vector3d centre(unit(random), unit(random), 0.3 * unit(random));
    Eigen::Vector3d corners[3];
    for (Eigen::Vector3d& corner : corners) {
      const Eigen::Vector3f vertex =
          (centre + size * Eigen::Vector3d(unit(random), unit(random), unit(random))).cast<float>();
      object.mesh.vertices.push_back(vertex);
      corner = vertex.cast<double>();
    }
    object.mesh.triangles = {{0, 1, 2}};
    const Scene scene = scene_of({object});
    SimulateOptions options = plain_options("ideal");
    options.width = options.height = 16;
    const Simulator simulator(scene, still_path(shifted(0, 0, 50)), options);  // sees nothing of it
    const FloorPlan plan = floor_plan(scene, simulator, kCell, bounds, 1);
    for (size_t k = 0; k < 2; ++k) {
      for (int iy = -60; iy < 60; ++iy) {
        for (int ix = -60; ix < 60; ++ix) {
          const Eigen::Vector3d low(ix * kCell, iy * kCell, bounds[k]);
          const Eigen::Vector3d high((ix + 1) * kCell, (iy + 1) * kCell, bounds[k + 1]);
          const Eigen::Vector3d border = Eigen::Vector3d::Constant(1e-9);
          const bool occupied = value_at(plan, plan.layers[k], ix, iy) == kPlanOccupiedUnseen;
          const bool surely = meets(corners, low + border, high - border);
          const bool surely_not = !meets(corners, low - border, high + border);
          ASSERT_TRUE(occupied || !surely) << i << " " << ix << " " << iy;
          ASSERT_TRUE(!occupied || !surely_not) << i << " " << ix << " " << iy;
        }
      }
    }
  }
}

// A wall on the border between two cells belongs to the upper one alone.
TEST(FloorPlan, CellsHoldTheirLowerBorders) {
  const Scene scene = scene_of({rectangle({0.5, -1.01, 0}, {0, 2.02, 0}, {0, 0, 0.9})});
  SimulateOptions options = turning_options();
  const Simulator simulator(scene, turning(0.8), options);
  const FloorPlan plan = floor_plan(scene, simulator, 0.25, {0.5, 1.0, 1.5}, 10);
  EXPECT_EQ(value_at(plan, plan.layers[0], 2, 0), kPlanOccupied);
  EXPECT_EQ(value_at(plan, plan.layers[0], 1, 0), kPlanFree);
  EXPECT_EQ(value_at(plan, plan.layers[1], 2, 0), kPlanFree);  // above the wall
}

}  // namespace
}  // namespace iris::simulate
