// Made-up pose graphs with known poses: walks along the lines of a 3-D grid, so that places are seen again and again.
#pragma once

#include <Eigen/Cholesky>
#include <algorithm>
#include <map>
#include <random>
#include <set>
#include <vector>

#include "iris/motion/minimise.h"
#include "iris/types/pose_graph.h"

namespace iris::testing {

struct PoseGraphExample {
  std::vector<Pose> truth;  // world_from_cam of each node; that of the first is the identity
  PoseGraph graph;          // measured; nodes lie where odometry leads
};

class PoseGraphMaker {
 public:
  explicit PoseGraphMaker(unsigned seed) : random_(seed) {}

  double normal() { return std::normal_distribution<double>()(random_); }
  int below(int n) { return static_cast<int>(random_() % static_cast<unsigned>(n)); }
  Vector6d normals() {
    return Vector6d::NullaryExpr([&] { return normal(); });
  }

  // A full covariance of about these standard deviations [m], [rad].
  Matrix6d covariance(double translation_sigma, double rotation_sigma) {
    Vector6d sigma;
    sigma << Eigen::Vector3d::Constant(translation_sigma), Eigen::Vector3d::Constant(rotation_sigma);
    const Matrix6d mix = Matrix6d::Identity() + 0.3 * Matrix6d::NullaryExpr([&] { return normal(); });
    return sigma.asDiagonal() * mix * mix.transpose() * sigma.asDiagonal();
  }

  // What is measured of i_from_j: its error is drawn from the covariance, which the edge carries.
  PoseEdge measured(int i, int j, const Pose& i_from_j, PoseEdgeKind kind, const Matrix6d& covariance) {
    const Vector6d error = covariance.llt().matrixL() * normals();
    return {.i = i,
            .j = j,
            .i_from_j = motion::perturbed(i_from_j, error),
            .information = covariance.inverse(),
            .kind = kind};
  }

  // A walk of `count` steps of 0.5 m within a grid of `side` m, turning by quarters, with `loops` loops between places
  // at most 1 m apart, seen at least 20 steps apart. frame_idx = 3 * place in the list.
  PoseGraphExample walk(int count, int loops, int side, double translation_sigma = 0.005,
                        double rotation_sigma = 0.002) {
    PoseGraphExample example;
    Pose pose = Pose::Identity();
    for (int n = 0; n < count; ++n) {
      example.truth.push_back(pose);
      for (;;) {
        Pose next = pose;
        if (below(6) == 0) {
          const Eigen::Vector3d axis = below(4) == 0 ? Eigen::Vector3d::UnitX() : Eigen::Vector3d::UnitY();
          next.rotate(Eigen::AngleAxisd(below(2) ? M_PI_2 : -M_PI_2, axis));
        }
        next.translate(Eigen::Vector3d(0, 0, 0.5));
        const Eigen::Vector3d p = next.translation();
        if (p.cwiseAbs().maxCoeff() > 0.5 * side || std::abs(p.y()) > 2) {
          pose.rotate(Eigen::AngleAxisd(M_PI_2, Eigen::Vector3d::UnitY()));
          continue;
        }
        pose = next;
        break;
      }
    }
    Pose guess = Pose::Identity();
    for (int n = 0; n < count; ++n) {
      if (n > 0) {
        example.graph.edges.push_back(measured(3 * (n - 1), 3 * n, example.truth[n - 1].inverse() * example.truth[n],
                                               PoseEdgeKind::odometry, covariance(translation_sigma, rotation_sigma)));
        guess = guess * example.graph.edges.back().i_from_j;
      }
      example.graph.nodes.push_back({.frame_idx = 3 * n, .world_from_cam = guess});
    }
    std::vector<std::pair<int, int>> near;
    for (int i = 0; i < count; ++i) {
      for (int j = i + 20; j < count; ++j) {
        if ((example.truth[i].translation() - example.truth[j].translation()).norm() < 1.01) near.emplace_back(i, j);
      }
    }
    std::shuffle(near.begin(), near.end(), random_);
    near.resize(std::min(near.size(), static_cast<size_t>(loops)));
    for (const auto& [i, j] : near) {
      example.graph.edges.push_back(measured(3 * i, 3 * j, example.truth[i].inverse() * example.truth[j],
                                             PoseEdgeKind::loop, covariance(translation_sigma, rotation_sigma)));
    }
    return example;
  }

  // `count` loops between any two nodes with a motion that has nothing to do with the truth: what repeated texture
  // brings, a small motion between far places.
  void add_wrong_loops(PoseGraphExample& example, int count) {
    const int nodes = static_cast<int>(example.truth.size());
    for (int n = 0; n < count;) {
      const int i = below(nodes), j = below(nodes);
      if (std::abs(i - j) < 20 || (example.truth[i].translation() - example.truth[j].translation()).norm() < 2) {
        continue;
      }
      Vector6d motion;
      motion << 0.5 * normal(), 0.5 * normal(), 0.5 * normal(), 0.3 * normal(), 0.3 * normal(), 0.3 * normal();
      example.graph.edges.push_back(measured(3 * std::min(i, j), 3 * std::max(i, j),
                                             motion::perturbed(Pose::Identity(), motion), PoseEdgeKind::loop,
                                             covariance(0.005, 0.002)));
      ++n;
    }
  }

 private:
  std::mt19937 random_;
};

// Root mean square of the distance from the true positions [m].
inline double position_error(const PoseGraph& graph, const std::vector<Pose>& truth) {
  double sum = 0;
  for (size_t n = 0; n < truth.size(); ++n) {
    sum += (graph.nodes[n].world_from_cam.translation() - truth[n].translation()).squaredNorm();
  }
  return std::sqrt(sum / static_cast<double>(truth.size()));
}

}  // namespace iris::testing
