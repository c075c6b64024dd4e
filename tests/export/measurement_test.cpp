#include "export/measurement.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <random>

#include "iris/core/error.h"
#include "iris/reconstruct/error_propagation.h"
#include "support/box_room.h"

namespace iris::exporters {
namespace {

using iris::testing::BoxRoom;
using iris::testing::level_camera;
using iris::testing::view_of;
using ::testing::AllOf;
using ::testing::HasSubstr;

const RectifiedCamera kCamera{.f = 130, .cx = 79.5, .cy = 59.5, .baseline = 0.12, .width = 160, .height = 120};

Vector6d normal6(std::mt19937& random, double shift, double turn) {
  std::normal_distribution<double> normal(0, 1);
  Vector6d v;
  for (int i = 0; i < 6; ++i) v[i] = normal(random) * (i < 3 ? shift : turn);
  return v;
}

Pose moved(const Pose& pose, const Vector6d& step) {
  Pose result = pose;
  const double angle = step.tail<3>().norm();
  if (angle > 0) result.linear() = Eigen::AngleAxisd(angle, step.tail<3>() / angle) * pose.linear();
  result.translation() += step.head<3>();
  return result;
}

// A camera that goes round in a room, twice; its poses as noisy motions and loops let them be refined, its views with
// errors of the disparity that neighbouring pixels share.
struct World {
  std::vector<Pose> truth;
  std::vector<StereoView> exact;
  PoseGraph graph;
  std::vector<StereoView> views;

  World(uint32_t seed, double shift, double turn, double disparity_error) {
    std::mt19937 random(seed);
    std::normal_distribution<double> normal(0, 1);
    constexpr int kRound = 14;
    for (int k = 0; k < 2 * kRound; ++k) {
      const double angle = 2 * M_PI * k / kRound;
      truth.push_back(level_camera({0.5 * std::cos(angle), 0.5 * std::sin(angle), 0.1 * std::sin(3 * angle)},
                                   angle + 0.4, 0.1 * std::cos(angle)));
      exact.push_back(view_of(BoxRoom(), kCamera, truth.back()));
    }
    Matrix6d covariance = Matrix6d::Zero();
    covariance.diagonal() << Eigen::Vector3d::Constant(shift * shift), Eigen::Vector3d::Constant(turn * turn);
    const auto edge = [&](int i, int j, PoseEdgeKind kind) {
      graph.edges.push_back({.i = i,
                             .j = j,
                             .i_from_j = moved(truth[i].inverse() * truth[j], normal6(random, shift, turn)),
                             .information = covariance.inverse(),
                             .kind = kind});
    };
    for (int k = 0; k < 2 * kRound; ++k) {
      graph.nodes.push_back({.frame_idx = k, .world_from_cam = truth[k]});
      if (k > 0) edge(k - 1, k, PoseEdgeKind::odometry);
      if (k > 0) graph.nodes[k].world_from_cam = graph.nodes[k - 1].world_from_cam * graph.edges.back().i_from_j;
    }
    for (const int k : {0, 5, 9}) edge(k, k + kRound, PoseEdgeKind::loop);
    const loop::RefinedGraph refined = loop::refine(graph, {.sigma = 1, .estimate_sigma = false});
    for (size_t k = 0; k < refined.graph.nodes.size(); ++k) {
      graph.nodes[k].world_from_cam = refined.graph.nodes[k].world_from_cam;
      graph.nodes[k].covariance = refined.covariance[k];
      StereoView view = exact[k];
      view.frame_idx = static_cast<int>(k);
      view.world_from_cam = graph.nodes[k].world_from_cam;
      view.disparity.disparity = exact[k].disparity.disparity.clone();
      constexpr int kBlock = 12;
      for (int y = 0; y < kCamera.height; y += kBlock) {
        for (int x = 0; x < kCamera.width; x += kBlock) {
          const cv::Rect block = cv::Rect(x, y, kBlock, kBlock) & cv::Rect(0, 0, kCamera.width, kCamera.height);
          view.disparity.disparity(block) += static_cast<float>(disparity_error * normal(random));
        }
      }
      views.push_back(std::move(view));
    }
  }

  // Where the surface really is that a view measured in a pixel.
  Eigen::Vector3d true_point(const SeenPoint& seen) const {
    const auto k = static_cast<size_t>(seen.frame_idx);
    const Eigen::Vector3d image = kCamera.project(views[k].world_from_cam.inverse() * seen.in_world);
    const int x = static_cast<int>(std::lround(image.x())), y = static_cast<int>(std::lround(image.y()));
    return truth[k] * kCamera.point(x, y, exact[k].disparity.disparity(y, x));
  }
};

struct Errors {
  double mean_square = 0;  // of the errors in standard deviations
  double within_one = 0, within_two = 0;
  double path_part = 0;  // mean of the path's part of the variance
};

Errors errors_of(double shift, double turn, double disparity_error, double pixel_error, bool plan) {
  Errors errors;
  int count = 0;
  for (uint32_t seed = 1; seed <= 12; ++seed) {
    const World world(seed, shift, turn, disparity_error);
    const views::MemoryViewStore store(world.views);
    std::mt19937 random(seed + 100);
    const auto pick = [&] {
      const size_t k = random() % world.views.size();
      const int x = 10 + static_cast<int>(random() % 140), y = 10 + static_cast<int>(random() % 100);
      const Eigen::Vector3d p = world.truth[k] * kCamera.point(x, y, world.exact[k].disparity.disparity(y, x));
      PickedPoint point{.xy = p.head<2>(), .z = {}};
      if (!plan) point.z = p.z();
      return point;
    };
    for (int pair = 0; pair < 40; ++pair) {
      const PickedPoint a = pick(), b = pick();
      if ((a.xy - b.xy).norm() < 0.5) continue;
      const Measurement m = measure(world.graph, store, a, b,
                                    {.pixel_error = pixel_error, .low = -1.3, .bottom = -1.1, .top = 1.3}, "OUT");
      Eigen::Vector3d way = world.true_point(m.b) - world.true_point(m.a);
      if (plan) way.z() = 0;
      EXPECT_EQ(m.in_plan, plan);
      EXPECT_NEAR(m.sigma, std::hypot(m.path, m.reconstruction), 1e-12);
      const double error = std::abs(m.distance - way.norm()) / m.sigma;
      errors.mean_square += error * error;
      errors.within_one += error < 1;
      errors.within_two += error < 2;
      errors.path_part += m.path * m.path / (m.sigma * m.sigma);
      ++count;
    }
  }
  EXPECT_GT(count, 300);
  for (double* sum : {&errors.mean_square, &errors.within_one, &errors.within_two, &errors.path_part}) *sum /= count;
  return errors;
}

// Of a normal distribution 0.683 lie within one standard deviation, 0.954 within two. Pairs of one world share poses:
// 12 worlds and some 400 pairs leave about 0.15 to the mean square.
TEST(Measurement, ErrorsOfThePathAreAsLargeAsStated) {
  const Errors errors = errors_of(0.004, 0.002, 0, 0.002, false);
  EXPECT_GT(errors.path_part, 0.7);
  EXPECT_NEAR(errors.mean_square, 1, 0.35);
  EXPECT_NEAR(errors.within_one, 0.683, 0.1);
  EXPECT_NEAR(errors.within_two, 0.954, 0.04);
}

TEST(Measurement, ErrorsOfReconstructionAreAsLargeAsStated) {
  // sqrt(2) 0.1 px of disparity are 0.1 px of each coordinate.
  const Errors errors = errors_of(1e-5, 1e-5, 0.1 * M_SQRT2, 0.1, false);
  EXPECT_LT(errors.path_part, 0.05);
  EXPECT_NEAR(errors.mean_square, 1, 0.35);
  EXPECT_NEAR(errors.within_one, 0.683, 0.1);
}

// Of all heights of a wall the one that is nearest to the picked place counts: errors of reconstruction are less
// than those of any one height, never more.
TEST(Measurement, DistancesInThePlanToo) {
  const Errors mixed = errors_of(0.003, 0.0015, 0.05 * M_SQRT2, 0.05, true);
  EXPECT_LT(mixed.mean_square, 1.3);
  EXPECT_GT(mixed.within_one, 0.6);
  const Errors path = errors_of(0.004, 0.002, 0, 0.002, true);
  EXPECT_NEAR(path.within_one, 0.683, 0.12);
  EXPECT_NEAR(path.within_two, 0.954, 0.08);  // where walls meet, disparities are off by more than 0.002 px
}

TEST(Measurement, TwoPointsOfOneViewCarryTheErrorOfReconstructionAlone) {
  const World world(3, 0.05, 0.02, 0);  // a path so bad that one view is always better
  const views::MemoryViewStore store(world.views);
  const StereoView& view = world.views[4];
  const auto point = [&](int x, int y) {
    const Eigen::Vector3d p = view.world_from_cam * kCamera.point(x, y, view.disparity.disparity(y, x));
    return PickedPoint{.xy = p.head<2>(), .z = p.z()};
  };
  const Measurement m = measure(world.graph, store, point(30, 40), point(120, 80), {.pixel_error = 0.1}, "OUT");
  EXPECT_EQ(m.a.frame_idx, m.b.frame_idx);
  EXPECT_EQ(m.path, 0);
  const Pose cam_from_world = world.views[static_cast<size_t>(m.a.frame_idx)].world_from_cam.inverse();
  EXPECT_NEAR(m.sigma,
              reconstruct::length_error(kCamera, cam_from_world * m.a.in_world, cam_from_world * m.b.in_world, 0.1),
              1e-9);
  EXPECT_NEAR(m.distance, (m.a.in_world - m.b.in_world).norm(), 1e-12);
  EXPECT_NEAR(m.distance, (world.true_point(m.a) - world.true_point(m.b)).norm(), 1e-5);  // float disparities
}

// The joint covariance against a dense inverse with numeric derivatives. What a common motion of all poses does not
// change must be the same whichever node is held fixed.
TEST(Measurement, JointCovarianceIsThatOfTheGraph) {
  World world(5, 0.01, 0.005, 0);
  PoseGraph& graph = world.graph;
  graph.nodes.resize(6);
  std::erase_if(graph.edges, [](const PoseEdge& edge) { return edge.i > 5 || edge.j > 5; });
  graph.edges.push_back(
      {.i = 1, .j = 4, .i_from_j = world.truth[1].inverse() * world.truth[4], .kind = PoseEdgeKind::loop});
  graph.edges.back().information *= 4e4;
  graph.nodes.push_back({.frame_idx = 90, .submap = 1});  // another sub-map is not looked at
  Eigen::MatrixXd dense = Eigen::MatrixXd::Zero(30, 30);
  for (const PoseEdge& edge : graph.edges) {
    const Pose &i = graph.nodes[edge.i].world_from_cam, &j = graph.nodes[edge.j].world_from_cam;
    Eigen::MatrixXd by = Eigen::MatrixXd::Zero(6, 36);
    constexpr double h = 1e-5;
    for (int c = 0; c < 6; ++c) {
      const Vector6d step = h * Vector6d::Unit(c);
      by.col(6 * edge.i + c) = (loop::edge_residual(moved(i, step), j, edge.i_from_j) -
                                loop::edge_residual(moved(i, -step), j, edge.i_from_j)) /
                               (2 * h);
      by.col(6 * edge.j + c) = (loop::edge_residual(i, moved(j, step), edge.i_from_j) -
                                loop::edge_residual(i, moved(j, -step), edge.i_from_j)) /
                               (2 * h);
    }
    const Eigen::MatrixXd free = by.rightCols(30);
    dense += free.transpose() * edge.information * free;
  }
  const Eigen::MatrixXd expected = dense.inverse();
  const Eigen::MatrixXd joint = loop::joint_covariance(graph, {2, 5, 0});
  const auto block = [&](int i, int j) { return expected.block<6, 6>(6 * (i - 1), 6 * (j - 1)); };
  const double scale = expected.cwiseAbs().maxCoeff();
  EXPECT_LT((joint.block<6, 6>(0, 0) - block(2, 2)).cwiseAbs().maxCoeff(), 1e-6 * scale);
  EXPECT_LT((joint.block<6, 6>(0, 6) - block(2, 5)).cwiseAbs().maxCoeff(), 1e-6 * scale);
  EXPECT_LT((joint.block<6, 6>(6, 6) - block(5, 5)).cwiseAbs().maxCoeff(), 1e-6 * scale);
  EXPECT_EQ(joint.rightCols(6).cwiseAbs().maxCoeff(), 0);  // the first node is the fixed one
}

std::string problem_of(const std::function<void()>& work) {
  try {
    work();
  } catch (const std::exception& error) {
    return error.what();
  }
  return "";
}

TEST(Measurement, PointsThatNothingMeasuredAreRefusedWithWhatToDo) {
  const World world(7, 1e-4, 1e-4, 0);
  const views::MemoryViewStore store(world.views);
  const auto problem = [&](const PickedPoint& a, double radius = 0.1) {
    return problem_of([&] {
      measure(world.graph, store, a, {.xy = {2.27, 0}, .z = 0.1}, {.radius = radius, .bottom = -1, .top = 1}, "OUT");
    });
  };
  EXPECT_EQ(problem({.xy = {2.27, 0.3}, .z = 0.2}), "");
  EXPECT_EQ(problem({.xy = {2.27, 0.3}, .z = {}}), "");
  // In the middle of the room; 0.4 m before the wall; far outside; above the ceiling.
  EXPECT_THAT(problem({.xy = {0, 0.02}, .z = 0.0}), HasSubstr("OUT: n"));
  EXPECT_THAT(problem({.xy = {1.87, 0}, .z = 0.1}), AllOf(HasSubstr("within 0.1 m of point A = (1.87, 0, 0.1)"),
                                                          HasSubstr("0.40 m away"), HasSubstr("--measure.radius")));
  EXPECT_EQ(problem({.xy = {1.87, 0}, .z = 0.1}, 0.5), "");
  EXPECT_THAT(problem({.xy = {500, 0}, .z = {}}),
              AllOf(HasSubstr("near point A = (500, 0)"), HasSubstr("the path goes from x -0.5"), HasSubstr("y -0.")));
  EXPECT_THAT(problem({.xy = {0, 0}, .z = 50}), HasSubstr("no stored view looks at point A = (0, 0, 50)"));
}

TEST(Measurement, PointsAreReadAsTwoOrThreeNumbers) {
  EXPECT_EQ(parse_point("1.5,-2").xy, Eigen::Vector2d(1.5, -2));
  EXPECT_FALSE(parse_point("1.5,-2").z);
  EXPECT_EQ(parse_point("-0.5,1e1,.25").z, 0.25);
  for (const char* wrong : {"", "1", "1,", ",1", "1,2,3,4", "1;2", "1, 2", "a,b", "1,2,", "nan,1", "1,inf", "+1,2"}) {
    EXPECT_THAT(problem_of([&] { parse_point(wrong); }), HasSubstr("is no point; give x,y or x,y,z")) << wrong;
  }
}

}  // namespace
}  // namespace iris::exporters
