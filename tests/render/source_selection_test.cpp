#include "iris/render/source_selection.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "support/ray_scene.h"

namespace iris::render {
namespace {

using Eigen::Vector3d;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::Not;
using testing::novel_of;
using testing::pose_at;
using testing::scene_camera;
using ::testing::SizeIs;

views::ViewSummary summary(const Pose& pose) {  // surfaces between 1 and 6 m
  const RectifiedCamera camera = scene_camera();
  const double ft = camera.f * camera.baseline;
  return {.frame_idx = 0,
          .submap = 0,
          .camera = camera,
          .world_from_cam = pose,
          .min_disparity = ft / 6,
          .max_disparity = ft};
}

TEST(Frustum, CornersProjectOntoTheImageCorners) {
  const views::ViewSummary view = summary(pose_at({1, 2, 3}, {0.3, -0.2, 0.5}));
  const Frustum body = source_frustum(view);
  ASSERT_THAT(body.corners, SizeIs(8));
  for (size_t i = 0; i < 8; ++i) {
    const Vector3d p = view.camera.project(view.world_from_cam.inverse() * body.corners[i]);
    EXPECT_NEAR(std::min(std::abs(p.x() + 0.5), std::abs(p.x() - 319.5)), 0, 1e-9);
    EXPECT_NEAR(std::min(std::abs(p.y() + 0.5), std::abs(p.y() - 239.5)), 0, 1e-9);
    EXPECT_NEAR(p.z(), i < 4 ? view.max_disparity : view.min_disparity, 1e-9);
  }
}

TEST(Frustum, OverlapMatchesSampledPoints) {
  // Random pairs against the definition: a point that both cameras see. Sampling can miss a small overlap, never invent
  // one.
  std::mt19937 random(11);
  std::uniform_real_distribution<double> unit(-1, 1);
  int overlapping = 0, apart = 0, missed = 0;
  for (int trial = 0; trial < 300; ++trial) {
    const views::ViewSummary view = summary(pose_at({4 * unit(random), 2 * unit(random), 6 * unit(random)},
                                                    {unit(random), 3 * unit(random), unit(random)}));
    const NovelCamera novel = novel_of(scene_camera(), pose_at({4 * unit(random), 0, 0}, {0, 3 * unit(random), 0}));
    const double farthest = 8;
    const bool found = overlap(source_frustum(view), novel_frustum(novel, farthest));
    EXPECT_EQ(found, overlap(novel_frustum(novel, farthest), source_frustum(view)));
    bool sampled = false;
    for (int k = 0; k < 20000 && !sampled; ++k) {
      const Vector3d p =
          view.world_from_cam * view.camera.point(-0.5 + 320 * (0.5 + 0.5 * unit(random)),
                                                  -0.5 + 240 * (0.5 + 0.5 * unit(random)),
                                                  view.camera.f * view.camera.baseline / (3.5 + 2.5 * unit(random)));
      const Vector3d q = novel.world_from_cam.inverse() * p;
      sampled = q.z() > 0 && q.z() < farthest && std::abs(novel.f * q.x() / q.z() + novel.cx - 159.5) < 160 &&
                std::abs(novel.f * q.y() / q.z() + novel.cy - 119.5) < 120;
    }
    if (sampled) {
      EXPECT_TRUE(found) << trial;
    }
    overlapping += sampled;
    apart += !found;
    missed += found && !sampled;
  }
  EXPECT_GT(overlapping, 50);
  EXPECT_GT(apart, 50);
  EXPECT_LE(missed, 10);
}

TEST(Frustum, OneInsideTheOther) {
  views::ViewSummary small = summary(pose_at({0, 0, 2}));
  small.min_disparity = small.max_disparity * 0.99;
  EXPECT_TRUE(overlap(source_frustum(small), novel_frustum(novel_of(scene_camera(), pose_at({0, 0, -20})), 100)));
}

TEST(SelectSources, TakesTheViewsThatSeeTheScene) {
  const std::vector<views::ViewSummary> views = {summary(pose_at({0, 0, 0}, {0, M_PI, 0})),  // looks away
                                                 summary(pose_at({0.1, 0, 0})), summary(pose_at({30, 0, 0})),
                                                 summary(pose_at({-0.3, 0, 0.2}))};
  const std::vector<int> chosen = select_sources(novel_of(scene_camera(), pose_at({0, 0, -0.5})), views, {});
  EXPECT_THAT(chosen, ::testing::UnorderedElementsAre(1, 3));
}

TEST(SelectSources, TheViewAtTheSamePlaceComesFirst) {
  std::vector<views::ViewSummary> views;
  for (int i = 0; i < 9; ++i) views.push_back(summary(pose_at({0.4 * (i - 4), 0, 0})));
  for (const int at : {1, 4, 6}) {
    const NovelCamera novel = novel_of(scene_camera(), views[static_cast<size_t>(at)].world_from_cam);
    const std::vector<int> chosen = select_sources(novel, views, {});
    ASSERT_THAT(chosen, SizeIs(4));
    EXPECT_EQ(chosen.front(), at);
  }
}

TEST(SelectSources, NearViewsComeBeforeFarOnes) {
  // All of them see the whole scene: nothing but the angle between the lines of sight tells them apart.
  std::vector<views::ViewSummary> views;
  for (const double x : {0.5, -0.04, 0.35, 0.05, -0.45, 0.06, -0.05}) views.push_back(summary(pose_at({x, 0, 0})));
  NovelCamera novel = novel_of(scene_camera(), Pose::Identity());
  novel.f *= 4;
  EXPECT_THAT(select_sources(novel, views, {}), ::testing::UnorderedElementsAre(1, 3, 5, 6));
}

TEST(SelectSources, OfTwoViewsAlongTheLineOfSightTheOneNearerToTheSceneCounts) {
  const std::vector<views::ViewSummary> views = {summary(pose_at({0, 0, -0.5})), summary(pose_at({0, 0, 0.1}))};
  NovelCamera novel = novel_of(scene_camera(), Pose::Identity());
  novel.f *= 4;
  EXPECT_THAT(select_sources(novel, views, {.max_sources = 1}), ElementsAre(1));
}

TEST(SelectSources, CoverageComesBeforeRepetition) {
  // Three views of the left half and one of the right half: two sources must cover both.
  std::vector<views::ViewSummary> views;
  for (const double x : {0.0, 0.02, 0.04}) views.push_back(summary(pose_at({x, 0, 0}, {0, -0.5, 0})));
  views.push_back(summary(pose_at({0, 0, 0}, {0, 0.5, 0})));
  NovelCamera novel = novel_of(scene_camera(), Pose::Identity());
  novel.f *= 0.6;
  const std::vector<int> chosen = select_sources(novel, views, {.max_sources = 2});
  ASSERT_THAT(chosen, SizeIs(2));
  EXPECT_THAT(chosen, Contains(3));
}

TEST(SelectSources, ViewsWithoutDisparitiesAndEmptyListsGiveNothing) {
  views::ViewSummary blind = summary(Pose::Identity());
  blind.min_disparity = blind.max_disparity = 0;
  const NovelCamera novel = novel_of(scene_camera(), Pose::Identity());
  EXPECT_THAT(select_sources(novel, {blind}, {}), IsEmpty());
  EXPECT_THAT(select_sources(novel, {}, {}), IsEmpty());
}

TEST(SelectSources, APanoramaTakesViewsAllAround) {
  std::vector<views::ViewSummary> views;
  for (int i = 0; i < 8; ++i) views.push_back(summary(pose_at({0, 0, 0}, {0, i * M_PI / 4 + 1e-9, 0})));
  const NovelCamera novel{
      .projection = Projection::equirectangular, .width = 512, .height = 256, .world_from_cam = Pose::Identity()};
  EXPECT_THAT(select_sources(novel, views, {.max_sources = 8}), SizeIs(8));
}

}  // namespace
}  // namespace iris::render
