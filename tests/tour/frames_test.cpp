#include "iris/tour/frames.h"

#include <gtest/gtest.h>

#include <cstring>

#include "iris/core/parallel.h"
#include "iris/tour/scene.h"
#include "support/ray_scene.h"

namespace iris::tour {
namespace {

using testing::pose_at;
using testing::room;
using testing::scene_camera;

struct Recording {
  std::vector<PoseNode> nodes;
  std::unique_ptr<views::MemoryViewStore> store;
};

// A flight of 1 s through the room; every second frame is stored. One view of another sub-map must not be used.
Recording recording() {
  Recording result;
  std::vector<StereoView> views;
  for (int i = 0; i <= 10; ++i) {
    const Pose pose = pose_at({-0.3 + 0.06 * i, 0, 0.03 * i});
    result.nodes.push_back({.frame_idx = i, .stamp_ns = i * 100'000'000LL, .world_from_cam = pose, .submap = 0});
    if (i % 2 == 0) views.push_back(room().view(scene_camera(), pose, i));
  }
  StereoView other = room().view(scene_camera(), pose_at({0, 0, 0}), 20);
  other.submap = 1;
  other.image = cv::Mat3b(240, 320, cv::Vec3b(255, 0, 255));
  views.insert(views.begin(), other);
  result.store = std::make_unique<views::MemoryViewStore>(std::move(views));
  return result;
}

TourOptions small() {
  TourOptions options;
  options.width = 160;
  options.height = 120;
  options.seconds = 1;
  return options;
}

TEST(RenderTour, FramesComeInOrderAndShowTheScene) {
  const Recording session = recording();
  const TourOptions options = small();
  const CameraPath path = along(session.nodes, options, 2);
  int next = 0;
  render_tour(path, session.nodes, *session.store, options, {}, [&](int frame, int frames, const NovelView& view) {
    EXPECT_EQ(frame, next++);
    EXPECT_EQ(frames, 11);
    EXPECT_EQ(view.image.size(), cv::Size(160, 120));
    EXPECT_GT(testing::coverage(view), 0.7);
    int foreign = 0;
    for (const cv::Vec3b& pixel : view.image) foreign += pixel == cv::Vec3b(255, 0, 255);
    EXPECT_EQ(foreign, 0);
  });
  EXPECT_EQ(next, 11);
}

TEST(RenderTour, DrawsCameraAndPathOnRequest) {
  const Recording session = recording();
  TourOptions options = small();
  options.seconds = 0.2;
  const CameraPath path = along(session.nodes, options, 2);
  const auto first = [&](bool camera, bool line) {
    TourOptions drawn = options;
    drawn.draw_camera = camera;
    drawn.draw_path = line;
    cv::Mat3b image;
    render_tour(path, session.nodes, *session.store, drawn, {}, [&](int frame, int, const NovelView& view) {
      if (frame == 1) image = view.image.clone();
    });
    return image;
  };
  const auto differ = [](const cv::Mat3b& a, const cv::Mat3b& b) {
    return std::memcmp(a.data, b.data, a.total() * 3) != 0;
  };
  const cv::Mat3b bare = first(false, false);
  EXPECT_TRUE(differ(bare, first(true, false)));
  EXPECT_TRUE(differ(bare, first(false, true)));
}

TEST(RenderTour, ThreadsDoNotMatter) {
  const Recording session = recording();
  const TourOptions options = small();
  const CameraPath path = along(session.nodes, options, 2);
  std::vector<cv::Mat3b> images[2];
  for (const int threads : {1, 2}) {
    with_threads(threads, [&] {
      render_tour(path, session.nodes, *session.store, options, {},
                  [&](int, int, const NovelView& view) { images[threads - 1].push_back(view.image.clone()); });
    });
  }
  ASSERT_EQ(images[0].size(), images[1].size());
  for (size_t i = 0; i < images[0].size(); ++i) {
    EXPECT_EQ(std::memcmp(images[0][i].data, images[1][i].data, images[0][i].total() * 3), 0);
  }
}

TEST(RenderTour, AFailingSinkEndsTheTour) {
  const Recording session = recording();
  const TourOptions options = small();
  const CameraPath path = along(session.nodes, options, 2);
  int calls = 0;
  EXPECT_THROW(render_tour(path, session.nodes, *session.store, options, {},
                           [&](int frame, int, const NovelView&) {
                             ++calls;
                             if (frame == 2) throw std::runtime_error("full");
                           }),
               std::runtime_error);
  EXPECT_EQ(calls, 3);
}

TEST(SceneDepth, IsTheMedianOfTheSubMap) {
  std::vector<StereoView> views;
  for (int i = 0; i < 5; ++i) views.push_back(room().view(scene_camera(), Pose::Identity(), i));
  const double ft = scene_camera().f * scene_camera().baseline;
  for (int i = 0; i < 5; ++i)
    views[static_cast<size_t>(i)].disparity.disparity = static_cast<float>(ft / (i < 3 ? 2 + i : 50));
  views[3].submap = views[4].submap = 1;
  const views::MemoryViewStore store(views);
  EXPECT_NEAR(scene_depth(store, 0), 3, 1e-5);
  EXPECT_NEAR(scene_depth(store, 1), 50, 1e-4);
  EXPECT_EQ(scene_depth(store, 2), 0);
}

TEST(FrameCount, OneAtTheBeginningThenOneEveryFrameTime) {
  CameraPath path;
  path.keyframes = {{.t = 2}, {.t = 3.5}};
  TourOptions options;
  options.fps = 10;
  EXPECT_EQ(frame_count(path, options), 16);
  options.fps = 24;
  EXPECT_EQ(frame_count(path, options), 37);
}

}  // namespace
}  // namespace iris::tour
