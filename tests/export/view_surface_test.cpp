#include "export/view_surface.h"

#include <gtest/gtest.h>

#include <map>

#include "support/box_room.h"

namespace iris::exporters {
namespace {

const RectifiedCamera kCamera{.f = 100, .cx = 59.5, .cy = 39.5, .baseline = 0.1, .width = 120, .height = 80};

StereoView wall(float jump) {
  StereoView view = testing::view_of({}, kCamera, testing::level_camera({0, 0, 0}, 0));
  for (int y = 0; y < kCamera.height; ++y) {
    for (int x = 0; x < kCamera.width; ++x) {
      view.disparity.disparity(y, x) = 5 + 0.01f * static_cast<float>(x) + (x >= 61 ? jump : 0.0f);
    }
  }
  return view;
}

reconstruct::FusedView fused_of(const StereoView& view) {
  return reconstruct::fuse_view(view, {}, {.min_disparity = 1, .step = 1});
}

const auto kAll = [](const reconstruct::FusedPixel&) { return true; };

double area_in_image(const TriangleMesh& mesh) {
  double area = 0;
  for (const Eigen::Vector3i& t : mesh.triangles) {
    const auto uv = [&](int i) -> Eigen::Vector2d {
      return mesh.texture_coordinates[static_cast<size_t>(t[i])].cast<double>().cwiseProduct(
          Eigen::Vector2d(kCamera.width, kCamera.height));
    };
    const Eigen::Vector2d a = uv(1) - uv(0), b = uv(2) - uv(0);
    area -= (a.x() * b.y() - a.y() * b.x()) / 2;  // image y points down: fronts are counter-clockwise
  }
  return area;
}

TEST(ViewSurface, APlaneNeedsFewTrianglesAndIsWhole) {
  const StereoView view = wall(0);
  const TriangleMesh mesh = view_surface(view, fused_of(view), 1, 0.5, kAll);
  EXPECT_LT(mesh.triangles.size(), 1500u);  // of 2 * 119 * 79 = 18802; the border of the image needs small ones
  EXPECT_NEAR(area_in_image(mesh), 119 * 79, 1e-3);
  for (size_t i = 0; i < mesh.vertices.size(); ++i) {
    const Eigen::Vector3d seen = kCamera.project(mesh.vertices[i].cast<double>());
    EXPECT_NEAR(seen.x() + 0.5, mesh.texture_coordinates[i].x() * kCamera.width, 1e-3);
    EXPECT_NEAR(seen.y() + 0.5, mesh.texture_coordinates[i].y() * kCamera.height, 1e-3);
    EXPECT_NEAR(seen.z(), 5 + 0.01 * seen.x(), 1e-4);
  }
}

TEST(ViewSurface, IsCutWhereTheDisparityJumps) {
  const StereoView near = wall(2.5f), joined = wall(0.4f), far = wall(1.2f);
  EXPECT_NEAR(area_in_image(view_surface(near, fused_of(near), 1, 0.5, kAll)), 118 * 79, 1e-3);
  EXPECT_NEAR(area_in_image(view_surface(far, fused_of(far), 1, 0.5, kAll)), 118 * 79, 1e-3);
  EXPECT_NEAR(area_in_image(view_surface(joined, fused_of(joined), 1, 0.5, kAll)), 119 * 79, 1e-3);
}

TEST(ViewSurface, HolesStayOpenAndOnlyWhatIsWantedIsThere) {
  StereoView view = wall(0);
  view.disparity.disparity(cv::Rect(20, 20, 11, 11)) = 0;
  EXPECT_NEAR(area_in_image(view_surface(view, fused_of(view), 1, 0.5, kAll)), 119 * 79 - 12 * 12, 1e-3);
  const StereoView whole = wall(0);
  const TriangleMesh left =
      view_surface(whole, fused_of(whole), 1, 0.5, [](const reconstruct::FusedPixel& pixel) { return pixel.x < 50; });
  const double area = area_in_image(left);
  EXPECT_GE(area, 49 * 79);
  EXPECT_LE(area, 51 * 79);
}

TEST(ViewSurface, WithinTheTolerance) {
  // A room's corner with noise: the finest mesh has every triangle, coarser ones stay within their tolerance.
  StereoView view = testing::view_of({}, kCamera, testing::level_camera({0, 0, 0}, 0.6, 0.2), 0.02);
  const reconstruct::FusedView fused = fused_of(view);
  const TriangleMesh exact = view_surface(view, fused, 1, 0, kAll);
  const TriangleMesh coarse = view_surface(view, fused, 1, 1, kAll);
  EXPECT_NEAR(area_in_image(exact), 119 * 79, 1e-3);
  EXPECT_NEAR(area_in_image(coarse), 119 * 79, 1e-3);
  EXPECT_LT(2 * coarse.triangles.size(), exact.triangles.size());
  // No cracks: each inner edge is shared by two triangles.
  std::map<std::pair<int, int>, int> edges;
  for (const Eigen::Vector3i& t : coarse.triangles) {
    for (int i = 0; i < 3; ++i) ++edges[{t[i], t[(i + 1) % 3]}];
  }
  const auto on_border = [&](int vertex) {
    const Eigen::Vector2f uv = coarse.texture_coordinates[static_cast<size_t>(vertex)];
    return uv.x() * 120 < 1 || uv.y() * 80 < 1 || uv.x() * 120 > 119 || uv.y() * 80 > 79;
  };
  for (const auto& [edge, count] : edges) {
    EXPECT_EQ(count, 1);
    if (on_border(edge.first) && on_border(edge.second)) continue;
    EXPECT_TRUE(edges.contains({edge.second, edge.first}));
  }
}

}  // namespace
}  // namespace iris::exporters
