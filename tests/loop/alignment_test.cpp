#include "iris/loop/alignment.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "support/ray_scene.h"

namespace iris::loop {
namespace {

using iris::testing::RayScene;
using iris::testing::Rectangle;
using ::testing::HasSubstr;
using V = Eigen::Vector3d;

constexpr double kDegree = M_PI / 180;

// A made-up place (x right, y down, z forward, the floor at y = 1.4) that is seen by cameras on a way through it, and
// everything turned by a known rotation: up in the graph's world is graph_from_place * (0, -1, 0).
struct Walk {
  RayScene scene;
  std::vector<Pose> place_from_cam;
  Pose graph_from_place = Pose::Identity();
  double noise = 0.15;  // [px] of disparities

  std::vector<PoseNode> nodes() const {
    std::vector<PoseNode> nodes;
    for (size_t n = 0; n < place_from_cam.size(); ++n) {
      nodes.push_back({.frame_idx = 5 * static_cast<int>(n), .world_from_cam = graph_from_place * place_from_cam[n]});
    }
    return nodes;
  }
  std::vector<int> frames() const {
    std::vector<int> frames;
    for (size_t n = 0; n < place_from_cam.size(); ++n) frames.push_back(5 * static_cast<int>(n));
    return frames;
  }
  StereoView view(int frame_idx) const {
    const RectifiedCamera camera{.f = 170, .cx = 119.5, .cy = 89.5, .baseline = 0.11, .width = 240, .height = 180};
    StereoView view = scene.view(camera, place_from_cam[frame_idx / 5], frame_idx);
    std::mt19937 random(static_cast<unsigned>(frame_idx));
    std::normal_distribution<float> error(0, static_cast<float>(noise));
    for (float& d : view.disparity.disparity) {
      if (d > 0) d = std::max(0.5f, d + error(random));
    }
    return view;
  }
  Alignment align(const std::string& up = "floor") const {
    return loop::align(nodes(), frames(), [&](int frame_idx) { return view(frame_idx); }, {.up = up});
  }
  // Angle between the true and the found direction of up [deg].
  double error(const Alignment& alignment) const {
    const V up = alignment.world_from_graph.linear() * graph_from_place.linear() * V(0, -1, 0);
    return std::atan2(up.head<2>().norm(), up.z()) / kDegree;
  }
};

Pose turned(double x, double y, double z) {
  Pose pose = Pose::Identity();
  pose.rotate(Eigen::AngleAxisd(y * kDegree, V::UnitY()));
  pose.rotate(Eigen::AngleAxisd(x * kDegree, V::UnitX()));
  pose.rotate(Eigen::AngleAxisd(z * kDegree, V::UnitZ()));
  return pose;
}

// A way around, looking ahead, the camera held with this pitch and roll [deg], shaking by 3 cm and 2 degrees.
std::vector<Pose> circle(int count, double radius, double pitch, double roll) {
  std::mt19937 random(3);
  std::normal_distribution<double> shake(0, 1);
  std::vector<Pose> poses;
  for (int n = 0; n < count; ++n) {
    const double angle = 2 * M_PI * n / count;
    Pose pose = turned(pitch + 2 * shake(random), angle / kDegree, roll + 2 * shake(random));
    pose.translation() = V(-radius * std::cos(angle), 0.03 * shake(random), radius * std::sin(angle));
    poses.push_back(pose);
  }
  return poses;
}

// 8 x 2.6 x 8 m.
RayScene empty_room() {
  return {.rectangles = {{V(-4, 1.4, -4), V(8, 0, 0), V(0, 0, 8), 0.9},
                         {V(-4, -1.2, -4), V(8, 0, 0), V(0, 0, 8), 1.7},
                         {V(-4, -1.2, 4), V(8, 0, 0), V(0, 2.6, 0), 0.1},
                         {V(-4, -1.2, -4), V(8, 0, 0), V(0, 2.6, 0), 0.4},
                         {V(-4, -1.2, -4), V(0, 2.6, 0), V(0, 0, 8), 2.3},
                         {V(4, -1.2, -4), V(0, 2.6, 0), V(0, 0, 8), 3.1}}};
}

TEST(Align, FindsTheFloorOfARoomWhateverTheWorld) {
  for (const auto& [pitch, roll] : {std::pair{0.0, 0.0}, {-15.0, 6.0}, {10.0, -20.0}}) {
    Walk walk{.scene = empty_room(), .place_from_cam = circle(16, 1.5, pitch, roll)};
    walk.graph_from_place = turned(20, 70, -35);
    walk.graph_from_place.translation() = V(3, -2, 5);
    const Alignment alignment = walk.align();
    EXPECT_LT(walk.error(alignment), 0.2) << alignment.used;
    EXPECT_TRUE(alignment.floor_found) << alignment.used;
    EXPECT_THAT(alignment.used, HasSubstr("floor: "));
    // The floor is at z = 0, the first camera above the origin, its viewing direction over the x axis.
    const Pose world_from_place = alignment.world_from_graph * walk.graph_from_place;
    EXPECT_NEAR((world_from_place * V(0, 1.4, 0)).z(), 0, 0.01);
    const Pose world_from_first = world_from_place * walk.place_from_cam[0];
    EXPECT_NEAR(world_from_first.translation().head<2>().norm(), 0, 1e-9);
    EXPECT_NEAR(world_from_first.translation().z(), alignment.camera_height, 1e-9);
    EXPECT_NEAR(world_from_first.linear()(1, 2), 0, 1e-9);
    EXPECT_GT(world_from_first.linear()(0, 2), 0);
    EXPECT_NEAR(alignment.tilt, std::acos(walk.place_from_cam[0].linear()(1, 1)), 0.2 * kDegree);
  }
}

TEST(Align, IsNotMisledByTables) {
  Walk walk{.scene = empty_room(), .place_from_cam = circle(16, 1.2, -20, 3)};
  // Tables cover half of what is seen of the floor; one leans by 8 degrees, and there is a slanting board.
  for (const double angle : {0.3, 1.7, 3.1, 4.2, 5.3}) {
    const V middle(-2.6 * std::cos(angle), 0.65, 2.6 * std::sin(angle));
    walk.scene.rectangles.push_back({middle - V(0.8, 0, 0.5), V(1.6, 0, 0), V(0, 0, 1.0), angle});
  }
  walk.scene.rectangles.push_back({V(-0.5, 0.6, 2.0), V(1, std::tan(8 * kDegree), 0), V(0, 0, 1), 0.6});
  walk.scene.rectangles.push_back({V(1.8, 1.4, 1.5), V(0, 0, 1.2), V(1.2, -1.2, 0), 1.6});
  walk.graph_from_place = turned(-12, 10, 25);
  const Alignment alignment = walk.align();
  EXPECT_LT(walk.error(alignment), 0.2) << alignment.used;
  EXPECT_TRUE(alignment.floor_found) << alignment.used;
  EXPECT_NEAR(alignment.camera_height, 1.4 - walk.place_from_cam[0].translation().y(), 0.02) << alignment.used;
}

TEST(Align, FindsAStreetFromAStraightPath) {
  Walk walk{.scene = {.rectangles = {{V(-4, 1.4, -5), V(8, 0, 0), V(0, 0, 60), 0.9},
                                     {V(-6, -6, -5), V(0, 8, 0), V(0, 0, 60), 2.3},
                                     {V(6, -6, -5), V(0, 8, 0), V(0, 0, 60), 3.1}}}};
  for (int n = 0; n < 12; ++n) walk.place_from_cam.push_back(turned(1, 0, 2) * Pose(Eigen::Translation3d(0, 0, n)));
  walk.graph_from_place = turned(-10, 0, 5);
  const Alignment alignment = walk.align();
  EXPECT_TRUE(alignment.floor_found) << alignment.used;
  EXPECT_LT(walk.error(alignment), 0.3) << alignment.used;  // seen to 12 m at most, 4 m on each side
}

TEST(Align, UsesTheCeilingForDirectionOnly) {
  Walk walk{.scene = empty_room(), .place_from_cam = circle(16, 1.5, 35, 0)};
  walk.scene.rectangles.erase(walk.scene.rectangles.begin());
  walk.graph_from_place = turned(9, 0, 9);
  const Alignment alignment = walk.align();
  EXPECT_LT(walk.error(alignment), 0.2) << alignment.used;
  EXPECT_FALSE(alignment.floor_found);
  EXPECT_THAT(alignment.used, HasSubstr("ceiling"));
  EXPECT_THAT(alignment.used, HasSubstr("no floor was seen"));
  EXPECT_EQ(alignment.camera_height, 0);
}

TEST(Align, TakesThePathWithoutHorizontalSurfaces) {
  Walk walk{.scene = empty_room(), .place_from_cam = circle(24, 1.5, 5, 0)};
  walk.scene.rectangles.erase(walk.scene.rectangles.begin(), walk.scene.rectangles.begin() + 2);
  walk.graph_from_place = turned(9, 0, 9);
  const Alignment alignment = walk.align();
  EXPECT_THAT(alignment.used, HasSubstr("no horizontal surface was seen; plane of the path"));
  EXPECT_LT(walk.error(alignment), 1.0) << alignment.used;  // the cameras shake by 3 cm, on 3 m
  EXPECT_FALSE(alignment.floor_found);
  EXPECT_EQ((walk.align("path").world_from_graph.matrix()), alignment.world_from_graph.matrix());
}

// A slanting board is no floor, even if it is all there is.
TEST(Align, DoesNotTrustASmallSurface) {
  Walk walk{.scene = empty_room()};
  walk.scene.rectangles.erase(walk.scene.rectangles.begin(), walk.scene.rectangles.begin() + 2);
  walk.scene.rectangles.push_back({V(-0.6, 0.4, 2.0), V(1.2, 0.3, 0), V(0, 0, 1.0), 0.6});
  for (int n = 0; n < 6; ++n) walk.place_from_cam.push_back(Pose(Eigen::Translation3d(0, 0, 0.1 * n)));
  const Alignment alignment = walk.align();
  EXPECT_THAT(alignment.used, HasSubstr("first camera"));
  EXPECT_LT(walk.error(alignment), 1e-6);
}

// A camera that looks down at the ground, as on a drone: its own upright says nothing.
TEST(Align, UnderstandsACameraThatLooksDown) {
  Walk walk{.scene = empty_room()};
  for (int n = 0; n < 12; ++n) {
    Pose pose = turned(-90, 0, 0);
    pose.translation() = V(1.5 * std::cos(n), 0, 1.5 * std::sin(n));
    walk.place_from_cam.push_back(pose);
  }
  const Alignment alignment = walk.align();
  EXPECT_TRUE(alignment.floor_found) << alignment.used;
  EXPECT_LT(walk.error(alignment), 0.2) << alignment.used;
}

TEST(Align, SaysWhyItFallsBackToTheFirstCamera) {
  Walk walk{.scene = empty_room()};
  walk.scene.rectangles.erase(walk.scene.rectangles.begin(), walk.scene.rectangles.begin() + 2);
  for (int n = 0; n < 6; ++n) walk.place_from_cam.push_back(Pose(Eigen::Translation3d(0, 0, 0.2 * n)));
  walk.graph_from_place = turned(4, 0, 9);
  const Alignment alignment = walk.align();
  EXPECT_THAT(alignment.used, HasSubstr("no horizontal surface was seen; the path is too straight"));
  EXPECT_THAT(alignment.used, HasSubstr("first camera"));
  EXPECT_LT(walk.error(alignment), 1e-6);
  EXPECT_LT(walk.error(walk.align("first-camera")), 1e-6);
  // A path with turns about the optical axis and free movement tells nothing either.
  std::mt19937 random(1);
  std::normal_distribution<double> normal(0, 1);
  walk.place_from_cam.clear();
  for (int n = 0; n < 12; ++n) {
    walk.place_from_cam.push_back(turned(0, 0, 30 * n));
    walk.place_from_cam.back().translation() = V(normal(random), normal(random), normal(random));
  }
  EXPECT_THAT(walk.align().used, HasSubstr("the path does not lie in a plane; first camera"));
}

TEST(Align, TakesAGivenDirection) {
  Walk walk{.scene = empty_room(), .place_from_cam = circle(4, 1, 0, 0)};
  walk.graph_from_place = turned(50, 60, 70);
  const V up = walk.place_from_cam[0].linear().transpose() * V(0, -1, 0);
  std::string text;
  for (int k = 0; k < 3; ++k) text += (k ? "," : "") + std::to_string(3 * up(k));
  EXPECT_LT(walk.error(walk.align(text)), 1e-3);
  EXPECT_THAT(walk.align(text).used, HasSubstr("given direction"));
  for (const char* wrong : {"up", "0,1", "0,0,0", "0,1,x", "0,1,0,0", ""}) {
    EXPECT_THROW(walk.align(wrong), UsageError) << wrong;
  }
}

TEST(Align, DoesNotDependOnTheNumberOfThreads) {
  const Walk walk{.scene = empty_room(), .place_from_cam = circle(8, 1.5, -10, 0)};
  Alignment one, many;
  with_threads(1, [&] { one = walk.align(); });
  with_threads(6, [&] { many = walk.align(); });
  EXPECT_EQ(one.world_from_graph.matrix(), many.world_from_graph.matrix());
  EXPECT_EQ(one.used, many.used);
}

TEST(Align, SurvivesViewsWithoutDisparities) {
  Walk walk{.scene = {}, .place_from_cam = circle(3, 1.5, 0, 0)};
  EXPECT_THAT(walk.align().used, HasSubstr("no horizontal surface was seen"));
  EXPECT_NO_THROW(align(walk.nodes(), {}, [](int) { return StereoView{}; }, {}));
}

}  // namespace
}  // namespace iris::loop
