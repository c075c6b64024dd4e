#include "export/trajectory_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <random>
#include <sstream>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "support/temporary_folder.h"

namespace iris::exporters {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::StartsWith;

class TrajectoryFile : public ::testing::Test {
 protected:
  const testing::TemporaryFolder temporary_;
  const fs::path folder_ = temporary_.path();
};

Eigen::Vector3d random_vector(std::mt19937& random, double scale) {
  std::uniform_real_distribution<double> uniform(-scale, scale);
  const double x = uniform(random), y = uniform(random), z = uniform(random);
  return {x, y, z};
}

Eigen::Matrix3d rotation_of(const Eigen::Vector3d& w) {
  const double angle = w.norm();
  return angle == 0 ? Eigen::Matrix3d::Identity() : Eigen::AngleAxisd(angle, w / angle).toRotationMatrix();
}

Pose random_pose(std::mt19937& random) {
  Pose pose = Pose::Identity();
  pose.linear() = rotation_of(random_vector(random, 1.7));
  pose.translation() = random_vector(random, 20);
  return pose;
}

Matrix6d random_information(std::mt19937& random) {
  std::normal_distribution<double> normal;
  Matrix6d root;
  for (double& value : root.reshaped()) value = normal(random);
  return 100 * root * root.transpose() + Matrix6d::Identity();
}

PoseGraph random_graph(int nodes) {
  std::mt19937 random(7);
  PoseGraph graph;
  for (int i = 0; i < nodes; ++i) {
    graph.nodes.push_back({.frame_idx = i,
                           .stamp_ns = 1403636579763555584 + 50000000LL * i + i,
                           .world_from_cam = random_pose(random),
                           .submap = 0});
    if (i > 0) {
      graph.edges.push_back({.i = i - 1,
                             .j = i,
                             .i_from_j = graph.nodes[i - 1].world_from_cam.inverse() * graph.nodes[i].world_from_cam,
                             .information = random_information(random),
                             .kind = PoseEdgeKind::odometry});
    }
  }
  return graph;
}

std::vector<std::string> lines_of(const fs::path& path) {
  std::ifstream file(path);
  std::vector<std::string> lines;
  for (std::string line; std::getline(file, line);) lines.push_back(line);
  return lines;
}

// Numbers of a line after `skip` words; reads "nan" too.
std::vector<double> numbers_of(const std::string& line, int skip = 0) {
  std::istringstream stream(line);
  std::vector<double> numbers;
  for (std::string word; stream >> word;) {
    if (skip-- > 0) continue;
    numbers.push_back(std::stod(word));
  }
  return numbers;
}

Pose pose_of(const double* tq) {  // tx ty tz qx qy qz qw
  Pose pose = Pose::Identity();
  pose.translation() = Eigen::Vector3d(tq[0], tq[1], tq[2]);
  pose.linear() = Eigen::Quaterniond(tq[6], tq[3], tq[4], tq[5]).toRotationMatrix();
  return pose;
}

TEST_F(TrajectoryFile, TumRoundTrip) {
  const PoseGraph graph = random_graph(30);
  write_tum(folder_ / "tum.txt", graph);
  const std::vector<std::string> lines = lines_of(folder_ / "tum.txt");
  ASSERT_EQ(lines.size(), 30u);
  EXPECT_THAT(lines[3], StartsWith("1403636579.913555587 "));
  for (size_t i = 0; i < lines.size(); ++i) {
    EXPECT_EQ(std::count(lines[i].begin(), lines[i].end(), ' '), 7);
    const std::vector<double> values = numbers_of(lines[i]);
    ASSERT_EQ(values.size(), 8u);
    EXPECT_GE(values[7], 0);
    const Pose pose = pose_of(values.data() + 1);
    // Translations come back bit for bit, rotations within the rounding of matrix -> quaternion -> matrix.
    EXPECT_EQ(pose.translation(), graph.nodes[i].world_from_cam.translation());
    EXPECT_LT((pose.linear() - graph.nodes[i].world_from_cam.linear()).norm(), 1e-14);
  }
  EXPECT_EQ(std::distance(fs::directory_iterator(folder_), {}), 1);
}

TEST_F(TrajectoryFile, TumWritesExactText) {
  PoseGraph graph;
  graph.nodes.push_back({.frame_idx = 0, .stamp_ns = 5, .world_from_cam = Pose::Identity(), .submap = 0});
  graph.nodes.push_back({.frame_idx = 1, .stamp_ns = -1500000000, .world_from_cam = Pose::Identity(), .submap = 0});
  graph.nodes[1].world_from_cam.translation() = Eigen::Vector3d(0.1, -2, -0.0);
  write_tum(folder_ / "tum.txt", graph);
  EXPECT_EQ(read_file(folder_ / "tum.txt"), "0.000000005 0 0 0 0 0 0 1\n-1.500000000 0.1 -2 0 0 0 0 1\n");
}

TEST_F(TrajectoryFile, TumKeepsSubmapsApartAndRemovesThoseOfAnEarlierRun) {
  PoseGraph graph = random_graph(10);
  for (size_t i = 0; i < 10; ++i) graph.nodes[i].submap = i < 3 ? 0 : i < 8 ? 1 : 2;
  write_tum(folder_ / "tum.txt", graph);
  EXPECT_EQ(lines_of(folder_ / "tum.txt").size(), 5u);  // sub-map 1 has the most poses
  EXPECT_EQ(lines_of(folder_ / "tum_submap0.txt").size(), 3u);
  EXPECT_EQ(lines_of(folder_ / "tum_submap2.txt").size(), 2u);
  EXPECT_FALSE(fs::exists(folder_ / "tum_submap1.txt"));

  write_file(folder_ / "tum_submapless.txt", std::string_view("not ours"));
  for (PoseNode& node : graph.nodes) node.submap = 0;
  write_tum(folder_ / "tum.txt", graph);
  EXPECT_EQ(lines_of(folder_ / "tum.txt").size(), 10u);
  EXPECT_FALSE(fs::exists(folder_ / "tum_submap0.txt"));
  EXPECT_FALSE(fs::exists(folder_ / "tum_submap2.txt"));
  EXPECT_TRUE(fs::exists(folder_ / "tum_submapless.txt"));
}

TEST_F(TrajectoryFile, KittiHasALineForEveryFrameInTheFrameOfTheFirst) {
  PoseGraph graph = random_graph(12);
  graph.nodes.erase(graph.nodes.begin() + 4);  // frame 4 has no pose
  graph.nodes[9].submap = 1;                   // frame 10 is elsewhere
  write_kitti(folder_ / "kitti.txt", graph, 14);
  const std::vector<std::string> lines = lines_of(folder_ / "kitti.txt");
  ASSERT_EQ(lines.size(), 14u);
  EXPECT_EQ(lines[0], "1 0 0 0 0 1 0 0 0 0 1 0");
  const Pose cam0_from_world = graph.nodes[0].world_from_cam.inverse();
  for (const PoseNode& node : graph.nodes) {
    const std::vector<double> values = numbers_of(lines[static_cast<size_t>(node.frame_idx)]);
    ASSERT_EQ(values.size(), 12u);
    if (node.submap != 0 || node.frame_idx == 0) continue;
    const Eigen::Matrix<double, 3, 4, Eigen::RowMajor> read(values.data());
    EXPECT_EQ(read, (cam0_from_world * node.world_from_cam).matrix().topRows<3>()) << "frame " << node.frame_idx;
  }
  for (const int frame : {4, 10, 12, 13}) {
    EXPECT_THAT(numbers_of(lines[static_cast<size_t>(frame)]), ::testing::Each(::testing::IsNan())) << frame;
    EXPECT_EQ(numbers_of(lines[static_cast<size_t>(frame)]).size(), 12u);
  }
}

TEST_F(TrajectoryFile, KittiRefersToTheFirstPoseWhenFrame0HasNone) {
  PoseGraph graph = random_graph(5);
  graph.nodes.erase(graph.nodes.begin(), graph.nodes.begin() + 2);
  write_kitti(folder_ / "kitti.txt", graph, 5);
  const std::vector<std::string> lines = lines_of(folder_ / "kitti.txt");
  ASSERT_EQ(lines.size(), 5u);
  EXPECT_THAT(lines[1], StartsWith("nan nan"));
  EXPECT_EQ(lines[2], "1 0 0 0 0 1 0 0 0 0 1 0");
  EXPECT_THROW(write_kitti(folder_ / "kitti.txt", graph, 4), Bug);
}

TEST_F(TrajectoryFile, G2oRoundTrip) {
  PoseGraph graph = random_graph(6);
  graph.edges.push_back({.i = 5,
                         .j = 0,
                         .i_from_j = graph.nodes[5].world_from_cam.inverse() * graph.nodes[0].world_from_cam,
                         .information = Matrix6d::Identity(),
                         .kind = PoseEdgeKind::loop});
  for (size_t i = 4; i < 6; ++i) graph.nodes[i].submap = 1;
  write_g2o(folder_ / "graph.g2o", graph, {});
  size_t vertices = 0, edges = 0;
  std::vector<int> fixed;
  for (const std::string& line : lines_of(folder_ / "graph.g2o")) {
    const std::string tag = line.substr(0, line.find(' '));
    const std::vector<double> values = numbers_of(line, 1);
    if (tag == "VERTEX_SE3:QUAT") {
      ASSERT_EQ(values.size(), 8u);
      const PoseNode& node = graph.nodes[vertices++];
      EXPECT_EQ(values[0], node.frame_idx);
      EXPECT_LT((pose_of(values.data() + 1).matrix() - node.world_from_cam.matrix()).norm(), 1e-14);
    } else if (tag == "EDGE_SE3:QUAT") {
      ASSERT_EQ(values.size(), 2 + 7 + 21u);
      const PoseEdge& edge = graph.edges[edges++];
      EXPECT_EQ(values[0], edge.i);
      EXPECT_EQ(values[1], edge.j);
      EXPECT_LT((pose_of(values.data() + 2).matrix() - edge.i_from_j.matrix()).norm(), 1e-13);
      Matrix6d information;
      const double* value = values.data() + 9;
      for (int row = 0; row < 6; ++row) {
        for (int column = row; column < 6; ++column) {
          information(row, column) = information(column, row) = *value++;
        }
      }
      EXPECT_EQ(information, g2o_information(edge));
    } else {
      ASSERT_EQ(tag, "FIX");
      fixed.push_back(static_cast<int>(values.at(0)));
    }
  }
  EXPECT_EQ(vertices, graph.nodes.size());
  EXPECT_EQ(edges, graph.edges.size());
  EXPECT_THAT(fixed, ElementsAre(0, 4));  // the first frame of each sub-map
}

// g2o's EdgeSE3: error of the estimate x of i_from_j under the measurement z.
Vector6d g2o_error(const Pose& z, const Pose& x) {
  const Pose delta = z.inverse() * x;
  Eigen::Quaterniond q(delta.linear());
  if (q.w() < 0) q.coeffs() = -q.coeffs();
  Vector6d e;
  e << delta.translation(), q.vec();
  return e;
}

TEST(G2oInformation, GivesTheSameCostUnderG2osErrorAsOursUnderOurPerturbation) {
  std::mt19937 random(3);
  for (int i = 0; i < 50; ++i) {
    PoseEdge edge;
    edge.i_from_j = random_pose(random);
    edge.information = random_information(random);
    Vector6d step;  // (dt, dw)
    step << random_vector(random, 1e-4), random_vector(random, 1e-4);
    Pose x = edge.i_from_j;
    x.translation() += step.head<3>();
    x.linear() = rotation_of(step.tail<3>()) * x.linear();
    const double ours = step.dot(edge.information * step);
    const Vector6d e = g2o_error(edge.i_from_j, x);
    // The vector part is sin(angle/2): equal up to a relative error of (1e-4)^2 and the rounding of the quaternion.
    EXPECT_NEAR(e.dot(g2o_information(edge) * e), ours, 1e-7 * ours);
  }
}

TEST(G2oInformation, EqualsTheOneFromNumericDerivativesOfG2osError) {
  std::mt19937 random(4);
  PoseEdge edge;
  edge.i_from_j = random_pose(random);
  edge.information = random_information(random);
  Matrix6d e_by_step;
  const double h = 1e-5;
  for (int k = 0; k < 6; ++k) {
    Vector6d e[2];
    for (int side = 0; side < 2; ++side) {
      Vector6d step = Vector6d::Zero();
      step[k] = side == 0 ? -h : h;
      Pose x = edge.i_from_j;
      x.translation() += step.head<3>();
      x.linear() = rotation_of(step.tail<3>()) * x.linear();
      e[side] = g2o_error(edge.i_from_j, x);
    }
    e_by_step.col(k) = (e[1] - e[0]) / (2 * h);
  }
  // information_ours = (de/dstep)^T information_g2o (de/dstep); central differences are good to about 1e-10.
  const Matrix6d back = e_by_step.transpose() * g2o_information(edge) * e_by_step;
  EXPECT_LT((back - edge.information).norm(), 1e-7 * edge.information.norm());
}

TEST(G2oInformation, ScalesPerRadianToHalfAngles) {
  PoseEdge edge;
  edge.information = Matrix6d::Constant(1) + Matrix6d::Identity();
  const Matrix6d information = g2o_information(edge);
  EXPECT_EQ(information(0, 0), 2);
  EXPECT_EQ(information(0, 3), 2);
  EXPECT_EQ(information(3, 3), 8);
  EXPECT_EQ(information(3, 4), 4);
}

TEST_F(TrajectoryFile, SameGraphSameBytesAndEveryChangeShows) {
  const PoseGraph graph = random_graph(8);
  const auto bytes = [&](const PoseGraph& g) {
    write_tum(folder_ / "a.tum", g);
    write_kitti(folder_ / "a.kitti", g, 8);
    write_g2o(folder_ / "a.g2o", g, {});
    return std::array{read_file(folder_ / "a.tum"), read_file(folder_ / "a.kitti"), read_file(folder_ / "a.g2o")};
  };
  const auto before = bytes(graph);
  EXPECT_EQ(bytes(graph), before);

  PoseGraph moved = graph;
  double& x = moved.nodes[5].world_from_cam.translation().x();
  x = std::nextafter(x, 100);
  const auto after = bytes(moved);
  EXPECT_NE(after[0], before[0]);
  EXPECT_NE(after[2], before[2]);

  PoseGraph turned = graph;
  turned.nodes[5].world_from_cam.linear() *= rotation_of({0, 0, 1e-12});
  EXPECT_NE(bytes(turned)[1], before[1]);

  PoseGraph later = graph;
  later.nodes[5].stamp_ns += 1;
  EXPECT_NE(bytes(later)[0], before[0]);

  PoseGraph surer = graph;
  surer.edges[2].information(4, 4) *= 1 + 1e-12;
  EXPECT_NE(bytes(surer)[2], before[2]);
}

TEST_F(TrajectoryFile, NoPosesGiveEmptyFilesAndUnwritablePlacesAnError) {
  write_tum(folder_ / "tum.txt", PoseGraph());
  write_g2o(folder_ / "graph.g2o", PoseGraph(), {});
  write_kitti(folder_ / "kitti.txt", PoseGraph(), 2);
  EXPECT_EQ(read_file(folder_ / "tum.txt"), "");
  EXPECT_EQ(read_file(folder_ / "graph.g2o"), "");
  EXPECT_EQ(lines_of(folder_ / "kitti.txt").size(), 2u);
  const PoseGraph graph = random_graph(2);
  EXPECT_THROW(write_tum(folder_ / "tum.txt" / "below_a_file.txt", graph), InputError);
  EXPECT_THROW(write_kitti(folder_ / "tum.txt" / "below_a_file.txt", graph, 2), InputError);
  EXPECT_THROW(write_g2o(folder_ / "tum.txt" / "below_a_file.txt", graph, {}), InputError);
}

}  // namespace
}  // namespace iris::exporters
