#include "export/surface.h"

#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <numbers>

#include "iris/core/error.h"
#include "iris/core/options.h"
#include "iris/core/parallel.h"

namespace iris::exporters {
namespace {

// Points all over a ball, evenly (Fibonacci), normals outwards; the upper half is red, the lower one blue.
PointCloud ball(int count, double radius, double from_z = -1) {
  PointCloud cloud{.edge = radius * std::sqrt(4 * std::numbers::pi / count), .points = {}};
  for (int i = 0; i < count; ++i) {
    const double z = 1 - (2 * i + 1.0) / count, angle = i * std::numbers::pi * (3 - std::sqrt(5.0));
    if (z < from_z) continue;
    CloudPoint p;
    p.normal = Eigen::Vector3d(std::sqrt(1 - z * z) * std::cos(angle), std::sqrt(1 - z * z) * std::sin(angle), z)
                   .cast<float>();
    p.position = static_cast<float>(radius) * p.normal + Eigen::Vector3f(0.3f, -7.1f, 2.05f);
    p.rgb = z > 0 ? std::array<uint8_t, 3>{200, 0, 0} : std::array<uint8_t, 3>{0, 0, 200};
    p.sigma = 0.005f;
    cloud.points.push_back(p);
  }
  return cloud;
}

const Eigen::Vector3f kMiddle(0.3f, -7.1f, 2.05f);

TEST(Surface, OfABallIsClosedAndOnTheBall) {
  const TriangleMesh mesh = surface_of(ball(20000, 1), {.cell = 0.06});
  ASSERT_GT(mesh.triangles.size(), 5000u);
  ASSERT_EQ(mesh.vertex_colours.size(), mesh.vertices.size());
  for (size_t i = 0; i < mesh.vertices.size(); ++i) {
    const Eigen::Vector3f p = mesh.vertices[i] - kMiddle;
    // The planes that touch a ball lie outside of it: by R^2 / 6 of the reach 0.12 m at most, less half of a cell's
    // sag.
    EXPECT_NEAR(p.norm(), 1, 0.004);
    if (std::abs(p.z()) < 0.15) continue;
    EXPECT_EQ(mesh.vertex_colours[i], p.z() > 0 ? cv::Vec3b(0, 0, 200) : cv::Vec3b(200, 0, 0));
  }
  // Closed: every edge belongs to two triangles, once in each direction; and Euler's number is that of a ball.
  std::map<std::pair<int, int>, int> edges;
  double volume = 0;
  for (const Eigen::Vector3i& t : mesh.triangles) {
    for (int i = 0; i < 3; ++i) ++edges[{t[i], t[(i + 1) % 3]}];
    const auto p = [&](int i) -> Eigen::Vector3d {
      return (mesh.vertices[static_cast<size_t>(t[i])] - kMiddle).cast<double>();
    };
    volume += p(0).dot(p(1).cross(p(2))) / 6;
  }
  for (const auto& [edge, count] : edges) {
    EXPECT_EQ(count, 1);
    EXPECT_TRUE(edges.contains({edge.second, edge.first}));
  }
  EXPECT_EQ(static_cast<int>(mesh.vertices.size()) - static_cast<int>(edges.size() / 2) +
                static_cast<int>(mesh.triangles.size()),
            2);
  EXPECT_NEAR(volume, 4 * std::numbers::pi / 3, 0.05);  // > 0: fronts are outside
}

TEST(Surface, EndsWhereThePointsEnd) {
  const TriangleMesh mesh = surface_of(ball(20000, 1, 0.2), {.cell = 0.06});
  ASSERT_GT(mesh.triangles.size(), 1000u);
  double lowest = 9;
  for (const Eigen::Vector3f& p : mesh.vertices) lowest = std::min(lowest, double{p.z()} - kMiddle.z());
  EXPECT_GT(lowest, 0.2 - 2 * 0.06);
  EXPECT_LT(lowest, 0.2 + 2 * 0.06);
}

TEST(Surface, BudgetMakesItCoarser) {
  const PointCloud cloud = ball(20000, 1);
  const size_t all = surface_of(cloud, {.cell = 0.06}).triangles.size();
  const TriangleMesh mesh = surface_of(cloud, {.cell = 0.06, .max_triangles = 2000});
  EXPECT_LE(mesh.triangles.size(), 2000u);
  EXPECT_GT(mesh.triangles.size(), 200u);
  EXPECT_GT(all, 2000u);
}

TEST(Surface, SmallPartsAreDropped) {
  PointCloud cloud = ball(20000, 1);
  const TriangleMesh alone = surface_of(cloud, {.cell = 0.06});
  for (CloudPoint p : ball(400, 0.12).points) {
    p.position.x() += 3;
    cloud.points.push_back(p);
  }
  const TriangleMesh with_all = surface_of(cloud, {.cell = 0.06, .min_part = 0});
  const TriangleMesh without = surface_of(cloud, {.cell = 0.06, .min_part = 400});
  EXPECT_GT(with_all.triangles.size(), alone.triangles.size());
  EXPECT_EQ(without.triangles, alone.triangles);
  EXPECT_EQ(without.vertices, alone.vertices);
}

TEST(Surface, SameForAnyNumberOfThreadsAndEmptyForNothing) {
  const PointCloud cloud = ball(5000, 1.3);
  TriangleMesh one, three;
  with_threads(1, [&] { one = surface_of(cloud, {.cell = 0.1}); });
  with_threads(3, [&] { three = surface_of(cloud, {.cell = 0.1}); });
  EXPECT_EQ(one.vertices, three.vertices);
  EXPECT_EQ(one.triangles, three.triangles);
  EXPECT_TRUE(surface_of({.edge = 0.02, .points = {}}, {}).triangles.empty());
}

TEST(Surface, Formats) {
  EXPECT_EQ(mesh_formats({.formats = "ply,obj,ply"}), (std::vector<std::string>{"ply", "obj"}));
  EXPECT_THROW(mesh_formats({.formats = "ply,xyz"}), UsageError);
  EXPECT_THROW(mesh_formats({.formats = ""}), UsageError);
  MeshOptions options;
  OptionSet set;
  options.declare(set);
  set.validate();
}

}  // namespace
}  // namespace iris::exporters
