// Models in the picture: where they must be, and hidden where they must be (thesis 7.3.5).
#include <gtest/gtest.h>

#include <array>

#include "iris/core/error.h"
#include "iris/render/draw.h"
#include "iris/tour/frames.h"
#include "support/ray_scene.h"

namespace iris::tour {
namespace {

using Eigen::Vector3d;
using testing::pose_at;

const cv::Vec3b kGreen(0, 200, 0);

// An axis-parallel box, counter-clockwise seen from outside.
TriangleMesh box_mesh(const Vector3d& low, const Vector3d& high) {
  TriangleMesh mesh{.colour = kGreen};
  for (int i = 0; i < 8; ++i) {
    mesh.vertices.push_back(
        Vector3d(i & 1 ? high.x() : low.x(), i & 2 ? high.y() : low.y(), i & 4 ? high.z() : low.z()).cast<float>());
  }
  constexpr std::array<std::array<int, 4>, 6> kSides = {
      {{0, 4, 6, 2}, {1, 3, 7, 5}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 2, 3, 1}, {4, 5, 7, 6}}};
  for (const auto& [a, b, c, d] : kSides) {
    mesh.triangles.push_back({a, b, c});
    mesh.triangles.push_back({a, c, d});
  }
  return mesh;
}

// Distance along the ray to an axis-parallel box by slabs; < 0: missed.
double slab(const Vector3d& low, const Vector3d& high, const Vector3d& origin, const Vector3d& direction) {
  double enter = 0, leave = 1e9;
  for (int a = 0; a < 3; ++a) {
    const double t0 = (low[a] - origin[a]) / direction[a], t1 = (high[a] - origin[a]) / direction[a];
    enter = std::max(enter, std::min(t0, t1));
    leave = std::min(leave, std::max(t0, t1));
  }
  return enter < leave ? enter : -1;
}

NovelView empty_view(const NovelCamera& camera, float depth) {
  return {.image = cv::Mat3b(camera.height, camera.width, cv::Vec3b(0, 0, 0)),
          .depth = cv::Mat1f(camera.height, camera.width, depth),
          .source = cv::Mat1s(camera.height, camera.width, static_cast<int16_t>(0))};
}

bool is_green(const cv::Vec3b& pixel) { return pixel[1] > 0 && pixel[0] == 0 && pixel[2] == 0; }

TEST(DrawMeshes, CoverWhatTheRaysOfTheBoxCover) {
  const Vector3d low(-0.3, -0.2, 1.7), high(0.5, 0.4, 2.2);
  const Pose world_from_mesh = pose_at({0.1, 0.05, 0.2}, {0.2, -0.3, 0.1});
  for (const Projection projection : {Projection::pinhole, Projection::equirectangular}) {
    // In front, at the seam behind, straight above, and with the camera inside of the box.
    for (const Vector3d& turn :
         {Vector3d(0.1, 0.2, 0), Vector3d(0, 3.1, 0), Vector3d(1.5, 0.1, 0), Vector3d(0, 0, 0)}) {
      for (const Vector3d& position : {Vector3d(0, 0, 0), Vector3d(0.2, 0.1, 2.1)}) {
        const NovelCamera camera{.projection = projection,
                                 .width = 160,
                                 .height = projection == Projection::pinhole ? 120 : 80,
                                 .f = 130,
                                 .cx = 79.5,
                                 .cy = 59.5,
                                 .world_from_cam = pose_at(position, turn)};
        NovelView view = empty_view(camera, 0);
        render::draw_meshes(view, camera, {box_mesh(low, high)}, world_from_mesh);
        const Pose mesh_from_cam = world_from_mesh.inverse() * camera.world_from_cam;
        const bool inside = slab(low, high, mesh_from_cam.translation(), Vector3d(1, 1e-9, 1e-9)) == 0;
        int wrong = 0, covered = 0;
        for (int y = 0; y < camera.height; ++y) {
          for (int x = 0; x < camera.width; ++x) {
            const Vector3d ray = mesh_from_cam.linear() * render::pixel_ray(camera, x, y);
            const bool hit = inside || slab(low, high, mesh_from_cam.translation(), ray) > 0;
            covered += hit;
            wrong += hit != is_green(view.image(y, x));
          }
        }
        EXPECT_EQ(wrong, 0) << static_cast<int>(projection) << ", turned by " << turn.transpose() << ", " << covered
                            << " pixels";
      }
    }
  }
}

TEST(DrawMeshes, NearerPartsHideFartherOnes) {
  const NovelCamera camera{.width = 100, .height = 100, .f = 100, .cx = 49.5, .cy = 49.5};
  TriangleMesh near = box_mesh({-0.2, -0.2, 1}, {0.2, 0.2, 1.1}), far = box_mesh({-1, -1, 2}, {1, 1, 2.1});
  far.colour = {0, 0, 200};
  for (const bool near_first : {true, false}) {
    NovelView view = empty_view(camera, 0);
    render::draw_meshes(view, camera, near_first ? std::vector{near, far} : std::vector{far, near}, Pose::Identity());
    EXPECT_TRUE(is_green(view.image(50, 50)));
    EXPECT_GT(view.image(50, 10)[2], 0);
    EXPECT_EQ(view.depth(50, 50), 0);  // stays that of the scene
  }
}

TEST(DrawMeshes, TexturesLieWhereTheirCoordinatesSay) {
  TriangleMesh wall;
  wall.vertices = {{-1, -1, 2}, {1, -1, 2}, {1, 1, 2}, {-1, 1, 2}};
  wall.triangles = {{0, 1, 2}, {0, 2, 3}};
  wall.texture_coordinates = {{0, 0}, {2, 0}, {2, 1}, {0, 1}};  // twice beside each other
  wall.texture = cv::Mat3b(1, 2);
  wall.texture(0, 0) = {250, 0, 0};
  wall.texture(0, 1) = {0, 250, 0};
  const NovelCamera camera{.width = 100, .height = 100, .f = 100, .cx = 49.5, .cy = 49.5};
  NovelView view = empty_view(camera, 0);
  render::draw_meshes(view, camera, {wall}, Pose::Identity());
  for (int x = 0; x < 100; ++x) {
    const bool first = static_cast<int>(x / 25.0) % 2 == 0;
    EXPECT_EQ(view.image(50, x)[0] > 0, first) << x;
  }
}

// A recorded room with a box in it: the robot behind the box must show only where the box does not hide it, to within
// the pixels at the box's edges.
TEST(Robot, IsHiddenBehindABox) {
  testing::RayScene scene = testing::room();
  using V = Vector3d;
  // A closed front of a crate between the virtual camera and the robot, 0.8 m wide.
  scene.rectangles.resize(5);
  scene.rectangles.push_back({V(-0.4, -0.5, 3), V(0.8, 0, 0), V(0, 2, 0), 4.0});
  const RectifiedCamera camera = testing::scene_camera();
  std::vector<StereoView> views;
  std::vector<PoseNode> nodes;
  // Views from the virtual camera's side; the recording camera drives along behind the crate.
  for (int i = 0; i < 5; ++i) views.push_back(scene.view(camera, pose_at({-0.4 + 0.2 * i, 0, 0}), i));
  for (int i = 0; i < 5; ++i) {
    nodes.push_back(
        {.frame_idx = i, .stamp_ns = i * 1'000'000'000LL, .world_from_cam = pose_at({-1.2 + 0.6 * i, 0, 4.5})});
  }
  const views::MemoryViewStore store(views);
  CameraPath path;
  path.keyframes = {{.t = 0, .world_from_cam = Pose::Identity(), .fov = 1},
                    {.t = 4, .world_from_cam = Pose::Identity(), .fov = 1}};
  TourOptions options;
  options.width = 320;
  options.height = 240;
  options.fps = 1;
  options.draw_camera = options.draw_path = false;
  TourExtras extras;
  // The model: x forward, y left, z up; the camera sits at its origin.
  extras.robot = {box_mesh({-0.25, -0.25, -0.25}, {0.25, 0.25, 0.25})};
  int seen_frames = 0;
  std::vector<int> shown;
  render_tour(
      path, nodes, store, options, {},
      [&](int frame_idx, int, const NovelView& view) {
        const TourFrame frame = tour_frame(path, nodes, options, frame_idx);
        const Vector3d robot = frame.world_from_recording.translation();
        int wrong = 0, pixels = 0;
        for (int y = 0; y < 240; ++y) {
          for (int x = 0; x < 320; ++x) {
            const Vector3d ray = render::pixel_ray(frame.camera, x, y);
            const double at = slab(robot - V::Constant(0.25), robot + V::Constant(0.25), V::Zero(), ray);
            const double scene_at = scene.cast(V::Zero(), ray).along;
            const bool visible = at > 0 && at < scene_at;
            wrong += visible != is_green(view.image(y, x));
            pixels += visible;
          }
        }
        EXPECT_LE(wrong, 150) << "frame " << frame_idx;  // two pixels along the 75 rows that robot and crate share
        shown.push_back(pixels);
        ++seen_frames;
      },
      extras);
  ASSERT_EQ(seen_frames, 5);
  EXPECT_EQ(shown[2], 0);    // wholly behind the crate
  EXPECT_GT(shown[0], 500);  // beside it
  EXPECT_GT(shown[4], 500);
}

TEST(Robot, StandsWhereItsCameraIs) {
  TourOptions options;
  options.robot_camera = "0.3,-0.1,1.2";
  const Pose recording_from_robot = tour::recording_from_robot(options);
  EXPECT_LT((recording_from_robot * Vector3d(0.3, -0.1, 1.2)).norm(), 1e-12);
  // A metre ahead of the camera, and to its left, and above.
  EXPECT_LT((recording_from_robot * Vector3d(1.3, -0.1, 1.2) - Vector3d(0, 0, 1)).norm(), 1e-12);
  EXPECT_LT((recording_from_robot * Vector3d(0.3, 0.9, 1.2) - Vector3d(-1, 0, 0)).norm(), 1e-12);
  EXPECT_LT((recording_from_robot * Vector3d(0.3, -0.1, 2.2) - Vector3d(0, -1, 0)).norm(), 1e-12);
  for (const char* bad : {"", "1,2", "1,2,3,4", "a,b,c", "1,2,nan"}) {
    options.robot_camera = bad;
    EXPECT_THROW(tour::recording_from_robot(options), UsageError) << bad;
  }
}

TEST(RenderTour, RendersTheWantedFramesAloneAndOfOneMomentAlone) {
  std::vector<StereoView> views;
  std::vector<PoseNode> nodes;
  for (int i = 0; i < 6; ++i) {
    const Pose pose = pose_at({0.05 * i, 0, 0});
    nodes.push_back({.frame_idx = i, .stamp_ns = i * 100'000'000LL, .world_from_cam = pose});
    StereoView view = testing::room().view(testing::scene_camera(), pose, i);
    // Something changes: each moment has a colour of its own.
    view.image = cv::Mat3b(240, 320, cv::Vec3b(static_cast<uint8_t>(40 * i), 10, 10));
    views.push_back(view);
  }
  const views::MemoryViewStore store(views);
  CameraPath path;
  path.keyframes = {{.t = 0, .world_from_cam = Pose::Identity(), .fov = 0.8},
                    {.t = 0.5, .world_from_cam = Pose::Identity(), .fov = 0.8}};
  TourOptions options;
  options.width = 64;
  options.height = 48;
  options.draw_camera = options.draw_path = false;
  TourExtras extras;
  extras.frames = {1, 4};
  extras.moment = [&](int64_t stamp_ns) { return store.load(static_cast<int>(stamp_ns / 100'000'000)); };
  std::vector<int> frames;
  render_tour(
      path, nodes, store, options, {},
      [&](int frame_idx, int count, const NovelView& view) {
        EXPECT_EQ(count, 6);
        frames.push_back(frame_idx);
        EXPECT_NEAR(view.image(24, 32)[0], 40 * frame_idx, 1);
      },
      extras);
  EXPECT_EQ(frames, (std::vector<int>{1, 4}));
}

}  // namespace
}  // namespace iris::tour
