#include "iris/render/draw.h"

#include <gtest/gtest.h>

#include "support/ray_scene.h"

namespace iris::render {
namespace {

using Eigen::Vector3d;
using testing::novel_of;
using testing::pose_at;
using testing::scene_camera;

const cv::Vec3b kColour(10, 20, 250);

NovelView wall(float depth) {
  return {.image = cv::Mat3b(240, 320, cv::Vec3b(0, 0, 0)),
          .depth = cv::Mat1f(240, 320, depth),
          .source = cv::Mat1s(240, 320, static_cast<int16_t>(0))};
}

int painted(const NovelView& view, const cv::Rect& part = {0, 0, 320, 240}) {
  int count = 0;
  for (const cv::Vec3b& pixel : cv::Mat3b(view.image(part))) count += pixel != cv::Vec3b(0, 0, 0);
  return count;
}

TEST(DrawLine, CoversTheProjectedPixels) {
  const NovelCamera camera = novel_of(scene_camera(), pose_at({0.2, 0.1, -0.5}, {0.1, 0.2, 0.3}));
  const Vector3d from = camera.world_from_cam * Vector3d(-1, -0.5, 3),
                 to = camera.world_from_cam * Vector3d(1.2, 0.6, 5);
  NovelView view = wall(0);
  draw_line(view, camera, from, to, kColour, 3);
  for (int i = 0; i <= 100; ++i) {
    const Vector3d p = camera.world_from_cam.inverse() * (from + (to - from) * i / 100.0);
    const int x = static_cast<int>(std::lround(camera.f * p.x() / p.z() + camera.cx));
    const int y = static_cast<int>(std::lround(camera.f * p.y() / p.z() + camera.cy));
    EXPECT_EQ(view.image(y, x), kColour) << i;
  }
  const double length = std::hypot(camera.f * (1.2 / 5 + 1.0 / 3), camera.f * (0.6 / 5 + 0.5 / 3));
  EXPECT_GT(painted(view), 3 * length);
  EXPECT_LT(painted(view), 6 * length);
}

TEST(DrawLine, IsHiddenWhereTheSceneIsNearer) {
  // A line from 2 to 6 m through a wall at 4 m: 1/z runs linearly in the image, which says where it disappears.
  const NovelCamera camera = novel_of(scene_camera(), Pose::Identity());
  NovelView view = wall(4);
  draw_line(view, camera, Vector3d(-0.8, 0, 2), Vector3d(2.4, 0, 6), kColour, 3);
  const int border = static_cast<int>(camera.f * (0.8 / 4) + camera.cx);  // at z = 4 the line is at x = 0.8
  EXPECT_GT(painted(view, {0, 0, border - 1, 240}), 100);
  EXPECT_EQ(painted(view, {border + 2, 0, 320 - border - 2, 240}), 0);
  EXPECT_EQ(view.depth(121, 100), 4);  // the scene's depth stays
}

TEST(DrawLine, HolesHideNothingAndWhatIsBehindTheCameraIsNotDrawn) {
  const NovelCamera camera = novel_of(scene_camera(), Pose::Identity());
  NovelView view = wall(0);
  draw_line(view, camera, Vector3d(0, 0, -1), Vector3d(0.5, 0, -3), kColour, 2);
  EXPECT_EQ(painted(view), 0);
  draw_line(view, camera, Vector3d(0.1, 0, -1), Vector3d(0.1, 0, 3), kColour, 2);  // comes from behind
  EXPECT_GT(painted(view), 50);
  EXPECT_EQ(painted(view, {0, 0, 150, 240}), 0);
}

TEST(DrawPyramid, ApexAndBaseAreWhereTheCameraStands) {
  const RectifiedCamera recording = scene_camera();
  const NovelCamera camera = novel_of(recording, Pose::Identity());
  const Pose pose = pose_at({0.1, -0.1, 2}, {0.2, -0.3, 0.1});
  NovelView view = wall(0);
  draw_camera_pyramid(view, camera, recording, pose, kColour, 0.4);
  const auto at = [&](const Vector3d& p) {
    return view.image(static_cast<int>(std::lround(camera.f * p.y() / p.z() + camera.cy)),
                      static_cast<int>(std::lround(camera.f * p.x() / p.z() + camera.cx)));
  };
  EXPECT_NE(at(pose.translation()), cv::Vec3b(0, 0, 0));
  for (const double x : {-0.5, 319.5}) {
    for (const double y : {-0.5, 239.5}) {
      EXPECT_NE(at(pose * (0.4 * Vector3d((x - recording.cx) / recording.f, (y - recording.cy) / recording.f, 1))),
                cv::Vec3b(0, 0, 0));
    }
  }
}

TEST(DrawPyramid, NearerSurfacesHideIt) {
  const NovelCamera camera = novel_of(scene_camera(), Pose::Identity());
  NovelView hidden = wall(1.5f), half = wall(5);
  draw_camera_pyramid(hidden, camera, scene_camera(), pose_at({0, 0, 2}), kColour, 0.4);
  EXPECT_EQ(painted(hidden), 0);
  half.depth(cv::Rect(0, 0, 155, 240)) = 1.5f;
  draw_camera_pyramid(half, camera, scene_camera(), pose_at({0, 0, 2}), kColour, 0.4);
  EXPECT_EQ(painted(half, {0, 0, 155, 240}), 0);
  EXPECT_GT(painted(half, {155, 0, 165, 240}), 50);
}

TEST(DrawPath, EquirectangularLinesFollowTheSphere) {
  const NovelCamera camera{
      .projection = Projection::equirectangular, .width = 320, .height = 240, .world_from_cam = Pose::Identity()};
  NovelView view = wall(0);
  draw_path(view, camera, {Vector3d(0, 1, 1), Vector3d(1, 1, 0)}, kColour, 3);
  // Half-way: direction (1, 2, 1).
  const double longitude = std::atan2(1, 1), latitude = std::asin(2 / std::sqrt(6.0));
  EXPECT_EQ(view.image(static_cast<int>(std::lround((latitude / M_PI + 0.5) * 240 - 0.5)),
                       static_cast<int>(std::lround((longitude / (2 * M_PI) + 0.5) * 320 - 0.5))),
            kColour);
}

}  // namespace
}  // namespace iris::render
