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

std::vector<std::shared_ptr<const PreparedSource>> prepared_room(const std::vector<Pose>& poses) {
  std::vector<std::shared_ptr<const PreparedSource>> sources;
  for (const Pose& pose : poses) {
    auto view = std::make_shared<StereoView>(testing::room().view(scene_camera(), pose));
    sources.push_back(std::make_shared<PreparedSource>(std::move(view), DsnvOptions{}));
  }
  return sources;
}

std::vector<views::ViewSummary> summaries_of(const std::vector<std::shared_ptr<const PreparedSource>>& sources) {
  std::vector<views::ViewSummary> summaries;
  for (const auto& source : sources) summaries.push_back(views::summarise(source->view()));
  return summaries;
}

TEST(HoleSources, TheViewOfTheMissingSideIsChosen) {
  // The picture looks to the right of the only view it has; the others look left, right, and along the same line.
  const auto sources = prepared_room({pose_at({0, 0, 0}), pose_at({0.1, 0, 0}, {0, -0.5, 0}),
                                      pose_at({0.1, 0, 0}, {0, 0.5, 0}), pose_at({0.01, 0, 0})});
  const NovelCamera novel = novel_of(scene_camera(), pose_at({0, 0, 0}, {0, 0.4, 0}));
  const auto views = summaries_of(sources);
  const NovelView picture = render_novel_view(novel, {sources[0]}, {.fill_holes = 0});
  ASSERT_LT(testing::coverage(picture), 0.8);
  EXPECT_EQ(select_for_holes(novel, picture, 1, views, {0}), 2);
  EXPECT_NE(select_for_holes(novel, picture, 1, views, {0, 2}), 2);
  const NovelView whole = render_novel_view(novel_of(scene_camera(), pose_at({})), {sources[0]}, {});
  EXPECT_EQ(select_for_holes(novel_of(scene_camera(), pose_at({})), whole, 1, views, {0}), -1);
}

TEST(HoleSources, FillHolesAndNothingElse) {
  const auto sources = prepared_room({pose_at({0, 0, 0}), pose_at({0.1, 0, 0}, {0, 0.5, 0})});
  const NovelCamera novel = novel_of(scene_camera(), pose_at({0, 0, 0}, {0, 0.4, 0}));
  const DsnvOptions options{.hole_sources = 3, .fill_holes = 0};
  const NovelView first = render_novel_view(novel, {sources[0]}, options);
  const NovelView second = render_novel_view(novel, {sources[1]}, options);
  int asked = 0;
  const NovelView both = render_novel_view(novel, {sources[0]}, options, [&](const NovelView& so_far) {
    ++asked;
    EXPECT_EQ(cv::countNonZero(so_far.source >= 0) > cv::countNonZero(first.source >= 0), asked > 1);
    return asked == 1 ? sources[1] : nullptr;
  });
  EXPECT_EQ(asked, 2);
  int filled = 0, differ = 0;
  for (int y = 0; y < novel.height; ++y) {
    for (int x = 0; x < novel.width; ++x) {
      const bool known = first.source(y, x) >= 0;
      const NovelView& expected = known ? first : second;
      ASSERT_EQ(both.source(y, x), known ? 0 : second.source(y, x) < 0 ? -1 : 1);
      filled += !known && second.source(y, x) >= 0;
      // A tile shares walked rays with its left neighbour only where both are traced: settled within 1e-3 px.
      differ += std::abs(both.depth(y, x) - expected.depth(y, x)) > 1e-3f * expected.depth(y, x);
    }
  }
  EXPECT_GT(filled, novel.width * novel.height / 8);
  EXPECT_LE(differ, filled / 100);

  // Never more than the options allow.
  asked = 0;
  render_novel_view(novel, {sources[0]}, options, [&](const NovelView&) { return ++asked, sources[0]; });
  EXPECT_EQ(asked, 3);
}

TEST(HoleSources, FewSourcesAndTheirFillersCoverWhatManyDo) {
  std::vector<Pose> poses;
  for (int i = 0; i < 10; ++i) poses.push_back(pose_at({0.15 * i - 0.7, 0, 0}, {0, 0.14 * i - 0.6, 0}));
  const auto sources = prepared_room(poses);
  const auto views = summaries_of(sources);
  const auto prepare = [&](int view) { return sources[static_cast<size_t>(view)]; };
  const NovelCamera novel = novel_of(scene_camera(), pose_at({0.1, -0.1, -1}));
  const auto covered = [&](int most, int further) {
    return testing::coverage(render_from_views(novel, views, prepare, {.max_sources = most, .hole_sources = further}));
  };
  const double all = covered(10, 0), one = covered(1, 0), filled = covered(1, 6);
  EXPECT_LT(one, all - 0.05);
  EXPECT_GT(filled, all - 0.02);  // each filler must show a hundredth of the picture
}

}  // namespace
}  // namespace iris::render
