// Derivatives by central differences.
#pragma once

#include <Eigen/Core>

namespace iris::testing {

// Jacobian of f: R^n -> R^m at x; exact to about the square of `step` relative to the scale of f's curvature.
template <class Function>
Eigen::MatrixXd numeric_jacobian(const Function& f, const Eigen::VectorXd& x, double step) {
  const Eigen::VectorXd at = f(x);
  Eigen::MatrixXd jacobian(at.size(), x.size());
  for (Eigen::Index i = 0; i < x.size(); ++i) {
    Eigen::VectorXd up = x, down = x;
    up(i) += step;
    down(i) -= step;
    jacobian.col(i) = (f(up) - f(down)) / (2 * step);
  }
  return jacobian;
}

}  // namespace iris::testing
