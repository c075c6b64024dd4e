#include "iris/loop/candidates.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <set>

#include "support/box_room.h"

namespace iris::loop {
namespace {

const RectifiedCamera kCamera{.f = 200, .cx = 159.5, .cy = 119.5, .baseline = 0.1, .width = 320, .height = 240};

// A view of a wall that is parallel to the image, `depth` [m] away.
ViewSketch wall(int frame_idx, double depth) {
  ViewSketch view{.frame_idx = frame_idx,
                  .points_in_cam = {},
                  .depth = std::vector<float>(ViewSketch::kColumns * ViewSketch::kRows, static_cast<float>(depth))};
  for (int row = 0; row < 6; ++row) {
    for (int column = 0; column < 8; ++column) {
      const double disparity = kCamera.f * kCamera.baseline / depth;
      view.points_in_cam.push_back(kCamera.point(20 + 40 * column, 20 + 40 * row, disparity).cast<float>());
    }
  }
  return view;
}

RelativePose shifted(double x, double z, double sigma, double yaw = 0) {
  RelativePose relative;
  relative.i_from_j = Eigen::Translation3d(x, 0, z) * Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitY());
  relative.covariance = Matrix6d::Identity() * 1e-12;
  relative.covariance.topLeftCorner<3, 3>() += Eigen::Matrix3d::Identity() * sigma * sigma;
  return relative;
}

TEST(ExpectedOverlap, IsThePartOfTheImageThatBothSee) {
  const ViewSketch view = wall(0, 2);
  EXPECT_NEAR(expected_overlap(view, view, shifted(0, 0, 0), kCamera), 1, 1e-6);
  // The wall is 3.2 m wide: moved by 1.2 m, three of eight columns leave the image. Points seen from more than 30
  // degrees aside count a little less.
  EXPECT_NEAR(expected_overlap(view, view, shifted(1.2, 0, 0), kCamera), 5.0 / 8, 0.02);
  EXPECT_NEAR(expected_overlap(view, view, shifted(-1.2, 0, 0), kCamera), 5.0 / 8, 0.02);
  EXPECT_EQ(expected_overlap(view, view, shifted(4, 0, 0), kCamera), 0);
  EXPECT_EQ(expected_overlap(view, view, shifted(0, 0, 0, M_PI), kCamera), 0);  // back to back
}

TEST(ExpectedOverlap, KnowsUncertainty) {
  const ViewSketch view = wall(0, 2);
  // Far outside, but it might be wrong by so much; exactly there, but it might be elsewhere.
  EXPECT_EQ(expected_overlap(view, view, shifted(5, 0, 0.01), kCamera), 0);
  EXPECT_GT(expected_overlap(view, view, shifted(5, 0, 2), kCamera), 0.005);
  EXPECT_LT(expected_overlap(view, view, shifted(0, 0, 2), kCamera), 0.7);
  EXPECT_GT(expected_overlap(view, view, shifted(5, 0, 2), kCamera, /*at_best=*/true), 0.9);
  EXPECT_EQ(expected_overlap(view, view, shifted(5, 0, 0.01), kCamera, /*at_best=*/true), 0);
}

TEST(ExpectedOverlap, KnowsWhatIsHiddenTooFarOrSeenFromTheSide) {
  // A wall at 1 m hides the one at 4 m that the other view sees from 3 m further on.
  EXPECT_EQ(expected_overlap(wall(0, 1), wall(1, 1), shifted(0, 3, 0), kCamera), 0);
  // 4 m and 1 m from the same wall: at a quarter of the size nothing is recognised.
  EXPECT_EQ(expected_overlap(wall(0, 4), wall(1, 1), shifted(0, 3, 0), kCamera), 0);
  EXPECT_GT(expected_overlap(wall(0, 2), wall(1, 1.5), shifted(0, 0.5, 0), kCamera), 0.45);
  // From directions 90 degrees apart.
  EXPECT_EQ(expected_overlap(wall(0, 2), wall(1, 2), shifted(-2, 2, 0, M_PI / 2), kCamera), 0);
}

// A path that runs `laps` times around a square, looking outwards onto walls 2 m away.
struct Round {
  PoseGraph graph;
  std::vector<ViewSketch> views;
  explicit Round(int views_a_lap, int laps) {
    for (int k = 0; k < views_a_lap * laps; ++k) {
      const double a = 2 * M_PI * k / views_a_lap, radius = 0.05 * views_a_lap;
      const Pose pose = testing::level_camera({radius * std::cos(a), radius * std::sin(a), 0}, a);
      graph.nodes.push_back({.frame_idx = 2 * k, .world_from_cam = pose});
      if (k > 0) {
        graph.edges.push_back({.i = 2 * k - 2,
                               .j = 2 * k,
                               .i_from_j = graph.nodes[graph.nodes.size() - 2].world_from_cam.inverse() * pose,
                               .information = Matrix6d::Identity() * 1e8});
      }
      views.push_back(wall(2 * k, 2));
    }
  }
};

TEST(OverlapCandidates, AreTheSightsOfAPlaceInEveryLap) {
  const LoopOptions options;
  const Round round(60, 3);
  const std::vector<Candidate> found =
      overlap_candidates(round.views, Odometry(round.graph, options), kCamera, options);
  std::map<int, int> proposals;
  std::set<std::pair<int, int>> pairs;
  for (const Candidate& c : found) {
    EXPECT_LT(c.i, c.j);
    EXPECT_EQ(c.source, Candidate::Source::overlap);
    EXPECT_GE(c.j - c.i, 2 * options.min_gap);
    EXPECT_TRUE(pairs.insert({c.i, c.j}).second);
    EXPECT_GE(c.score, options.min_overlap);
    ++proposals[c.j];
    const int around = (c.j - c.i) / 2 % 60;
    EXPECT_LE(std::min(around, 60 - around), 10) << c.i << " " << c.j;
  }
  for (int k = 60; k < 180; ++k) {
    EXPECT_TRUE(pairs.contains({2 * (k - 60), 2 * k})) << k;
    EXPECT_LE(proposals[2 * k], options.overlap_candidates);
    if (k >= 120) {
      EXPECT_TRUE(pairs.contains({2 * (k - 120), 2 * k})) << k;
    }
  }
}

TEST(OverlapCandidates, NeedOdometryBetweenThem) {
  const LoopOptions options;
  Round round(60, 2);
  round.graph.edges.erase(round.graph.edges.begin() + 59);  // the second lap is a sub-map of its own
  for (size_t k = 60; k < 120; ++k) round.graph.nodes[k].submap = 1;
  for (const Candidate& c : overlap_candidates(round.views, Odometry(round.graph, options), kCamera, options)) {
    EXPECT_EQ(c.i < 120, c.j < 120) << c.i << " " << c.j;
  }
}

TEST(OverlapCandidates, OfFiveThousandViewsAreFewForEach) {
  const LoopOptions options{.drift = 0, .turn_drift = 0};
  const Round round(1000, 5);
  const std::vector<Candidate> found =
      overlap_candidates(round.views, Odometry(round.graph, options), kCamera, options);
  EXPECT_GT(found.size(), 4000u);
  EXPECT_LE(found.size(), static_cast<size_t>(5000 * options.overlap_candidates));
}

// Descriptors that only views of one place share.
cv::Mat1b descriptors_of(int place) {
  cv::Mat1b result(50, kDescriptorBytes);
  cv::RNG random(static_cast<uint64_t>(place) + 1);
  random.fill(result, cv::RNG::UNIFORM, 0, 256);
  return result;
}

TEST(AppearanceCandidates, JoinSubmapsAndLeaveOutWhatPosesExclude) {
  LoopOptions options;
  Round round(60, 2);
  // Views 5 and 65 are of one place, truly; 10 and 40 look alike on opposite sides; 20 and 22 are near in time.
  std::map<int, int> looks{{65, 5}, {40, 10}, {22, 20}};
  ViewIndex index;
  std::vector<cv::Mat1b> all;
  for (int k = 0; k < 120; ++k) all.push_back(descriptors_of(looks.contains(k) ? looks[k] : k));
  for (int k = 0; k + 1 < 120; ++k) all[k + 1].row(0).copyTo(all[k].row(49));  // a little like their neighbours
  index.train(all);
  for (const cv::Mat1b& d : all) index.add(d);
  index.finish();
  const auto pairs_of = [&](const PoseGraph& graph) {
    std::set<std::pair<int, int>> pairs;
    for (const Candidate& c : appearance_candidates(index, round.views, Odometry(graph, options), kCamera, options)) {
      EXPECT_EQ(c.source, Candidate::Source::appearance);
      if (c.score > 0.5) pairs.insert({c.i / 2, c.j / 2});
    }
    return pairs;
  };
  EXPECT_THAT(pairs_of(round.graph), ::testing::ElementsAre(std::pair(5, 65)));
  // Without odometry in between nothing is excluded.
  PoseGraph broken = round.graph;
  broken.edges.erase(broken.edges.begin() + 29);
  EXPECT_THAT(pairs_of(broken), ::testing::ElementsAre(std::pair(5, 65), std::pair(10, 40)));
}

}  // namespace
}  // namespace iris::loop
