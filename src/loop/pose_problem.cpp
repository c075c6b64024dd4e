#include "pose_problem.h"

#include <Eigen/Cholesky>

#include "iris/core/error.h"
#include "iris/loop/pose_graph.h"
#include "iris/loop/twist.h"
#include "iris/motion/minimise.h"

namespace iris::loop {
namespace {

using motion::cross_matrix;
template <int Rows, int Columns>
using RowMajor = Eigen::Matrix<double, Rows, Columns, Eigen::RowMajor>;

}  // namespace

bool PoseManifold::Plus(const double* x, const double* delta, double* x_plus_delta) const {
  Eigen::Map<Eigen::Matrix4d> moved(x_plus_delta);
  moved = screwed(pose_at(x), Eigen::Map<const Vector6d>(delta)).matrix();
  return true;
}

bool PoseManifold::PlusJacobian(const double* x, double* jacobian) const {
  const Pose pose = pose_at(x);
  Eigen::Map<RowMajor<kPoseNumbers, 6>> result(jacobian);
  result.setZero();
  for (int column = 0; column < 3; ++column) {
    result.block<3, 3>(4 * column, 3) = -cross_matrix(pose.linear().col(column));
  }
  result.block<3, 3>(12, 0).setIdentity();
  return true;
}

bool PoseManifold::Minus(const double* y, const double* x, double* y_minus_x) const {
  const Pose from = pose_at(x);
  Eigen::Map<Vector6d> step(y_minus_x);
  step = twist_of(pose_at(y) * from.inverse());
  step.head<3>() += step.tail<3>().cross(from.translation());
  return true;
}

bool PoseManifold::MinusJacobian(const double* x, double* jacobian) const {
  Eigen::Map<RowMajor<6, kPoseNumbers>> result(jacobian);
  result = step_from_numbers(pose_at(x));
  return true;
}

Eigen::Matrix<double, 6, kPoseNumbers> step_from_numbers(const Pose& pose) {
  Eigen::Matrix<double, 6, kPoseNumbers> result = Eigen::Matrix<double, 6, kPoseNumbers>::Zero();
  // Columns r of a rotation change by dw x r, and the sum of r x (dw x r) is 2 dw.
  for (int column = 0; column < 3; ++column) {
    result.block<3, 3>(3, 4 * column) = 0.5 * cross_matrix(pose.linear().col(column));
  }
  result.block<3, 3>(0, 12).setIdentity();
  return result;
}

EdgeCost::EdgeCost(const Pose& i_from_j, const Matrix6d& information)
    : i_from_j_(i_from_j), root_(information.llt().matrixU()) {}

bool EdgeCost::Evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  const Pose i = pose_at(parameters[0]), j = pose_at(parameters[1]);
  const Vector6d residual = edge_residual(i, j, i_from_j_);
  Eigen::Map<Vector6d> result(residuals);
  result = root_ * residual;
  if (!jacobians) return true;
  const EdgeJacobians by = edge_jacobians(i, j, residual);
  using Jacobian = Eigen::Map<RowMajor<6, kPoseNumbers>>;
  if (jacobians[0]) Jacobian(jacobians[0]).noalias() = Matrix6d(root_ * by.by_i) * step_from_numbers(i);
  if (jacobians[1]) Jacobian(jacobians[1]).noalias() = Matrix6d(root_ * by.by_j) * step_from_numbers(j);
  return true;
}

ceres::Problem::Options lent() {
  ceres::Problem::Options options;
  options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  options.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  options.disable_all_safety_checks = true;
  return options;
}

ceres::Solver::Options near_the_minimum(ceres::LinearSolverType solver) {
  ceres::Solver::Options options;
  options.linear_solver_type = solver;
  options.sparse_linear_algebra_library_type = ceres::SUITE_SPARSE;
  options.num_threads = 1;
  options.logging_type = ceres::SILENT;
  options.initial_trust_region_radius = 1e16;
  options.max_trust_region_radius = 1e16;
  options.min_trust_region_radius = 1e-6;
  options.max_num_consecutive_invalid_steps = 20;
  // Watch decides. What is left to these is a large sum that rounding keeps from falling.
  options.function_tolerance = 1e-9;
  options.gradient_tolerance = 0;
  options.parameter_tolerance = 1e-16;
  return options;
}

ceres::CallbackReturnType Watch::operator()(const ceres::IterationSummary& summary) {
  constexpr double kUndamped = 1e6;  // radius of the trust region, in units of the diagonal
  if (stopped_ && stopped_()) return ceres::SOLVER_ABORT;
  if (summary.iteration == 0 || !summary.step_is_valid) return ceres::SOLVER_CONTINUE;
  const bool rests = std::abs(summary.cost_change) < rest && summary.trust_region_radius > kUndamped;
  const bool done = rests || (single_step && summary.step_is_successful);
  return done ? ceres::SOLVER_TERMINATE_SUCCESSFULLY : ceres::SOLVER_CONTINUE;
}

bool minimise(ceres::Problem& problem, ceres::Solver::Options options, Watch& watch, int max_iterations,
              int& iterations) {
  options.max_num_iterations = max_iterations;
  options.callbacks.push_back(&watch);
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  if (summary.termination_type == ceres::USER_FAILURE) throw Interrupted();
  iterations += static_cast<int>(summary.iterations.size()) - 1;
  return summary.IsSolutionUsable() && summary.termination_type != ceres::NO_CONVERGENCE;
}

}  // namespace iris::loop
