// What pose graph and bundle adjustment give to Ceres: poses as unknowns, motions between them, when to stop.
#pragma once

#include <ceres/cost_function.h>
#include <ceres/iteration_callback.h>
#include <ceres/manifold.h>
#include <ceres/problem.h>
#include <ceres/sized_cost_function.h>
#include <ceres/solver.h>

#include <functional>

#include "iris/geometry/pose.h"

namespace iris::loop {

// A pose as a parameter block: the 4x4 matrix as Eigen stores it, pose.data().
constexpr int kPoseNumbers = 16;
inline Pose pose_at(const double* numbers) { return Pose(Eigen::Map<const Eigen::Matrix4d>(numbers)); }

// Steps (dt, dw) are those of screwed(): large ones keep what lies far away in place, to first order they are the
// perturbation that all covariances of poses refer to.
class PoseManifold final : public ceres::Manifold {
 public:
  int AmbientSize() const override { return kPoseNumbers; }
  int TangentSize() const override { return 6; }
  bool Plus(const double* x, const double* delta, double* x_plus_delta) const override;
  bool PlusJacobian(const double* x, double* jacobian) const override;
  bool Minus(const double* y, const double* x, double* y_minus_x) const override;
  bool MinusJacobian(const double* x, double* jacobian) const override;
};

// Takes a change of a pose's 16 numbers to the step (dt, dw) that makes it; 0 for changes that leave rotations.
// Derivatives by the step times this are those by the numbers, as Ceres wants them.
Eigen::Matrix<double, 6, kPoseNumbers> step_from_numbers(const Pose& pose);

// A measured motion between two poses: edge_residual() in units of its standard deviations.
class EdgeCost final : public ceres::SizedCostFunction<6, kPoseNumbers, kPoseNumbers> {
 public:
  EdgeCost(const Pose& i_from_j, const Matrix6d& information);
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;

 private:
  Pose i_from_j_;
  Matrix6d root_;  // of the information: root^T root
};

// Of a problem to which manifolds and losses are lent, not given: many blocks share them.
ceres::Problem::Options lent();

// Options for a minimisation that begins near its end: steps are those of Gauss and Newton until one fails, since the
// weak modes of a long chain are 1e-12 of its diagonal. One thread: the result does not depend on their number.
ceres::Solver::Options near_the_minimum(ceres::LinearSolverType solver);

// Ends a minimisation when its cost (Ceres's: half of the sum) falls by less than `rest` in an undamped step, after a
// first successful step if that is wanted, and aborts it when `stopped` says so.
class Watch final : public ceres::IterationCallback {
 public:
  explicit Watch(const std::function<bool()>& stopped) : stopped_(stopped) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary& summary) override;

  double rest = 0;
  bool single_step = false;

 private:
  const std::function<bool()>& stopped_;  // may be empty
};

// Minimises until `watch` is satisfied, at most `max_iterations`; counts them. Returns whether it came to rest. Throws
// Interrupted.
bool minimise(ceres::Problem& problem, ceres::Solver::Options options, Watch& watch, int max_iterations,
              int& iterations);

}  // namespace iris::loop
