#include "bench/minimise_peer.h"

#include <ceres/autodiff_cost_function.h>
#include <ceres/loss_function.h>
#include <ceres/problem.h>
#include <ceres/rotation.h>
#include <ceres/solver.h>

#include <cmath>

#include "iris/reconstruct/error_models.h"
#include "iris/reconstruct/error_propagation.h"

namespace iris::bench {
namespace {

template <typename T>
using Vector3 = Eigen::Matrix<T, 3, 1>;
template <typename T>
using Matrix3 = Eigen::Matrix<T, 3, 3>;

// (4.15): the Mahalanobis distance, whitened by the Cholesky factor of the covariance at the current rotation.
struct Ellipsoid {
  Eigen::Vector3d p, q;
  Eigen::Matrix3d p_covariance, q_covariance;

  template <typename T>
  bool operator()(const T* pose, T* residual) const {
    Matrix3<T> r;
    ceres::AngleAxisToRotationMatrix(pose, r.data());
    const Vector3<T> translation(pose[3], pose[4], pose[5]);
    const Vector3<T> e = p.cast<T>() - (r * q.cast<T>() + translation);
    const Matrix3<T> c = p_covariance.cast<T>() + r * q_covariance.cast<T>() * r.transpose();
    using std::sqrt;
    const T l00 = sqrt(c(0, 0)), l10 = c(1, 0) / l00, l20 = c(2, 0) / l00;
    const T l11 = sqrt(c(1, 1) - l10 * l10), l21 = (c(2, 1) - l20 * l10) / l11;
    const T l22 = sqrt(c(2, 2) - l20 * l20 - l21 * l21);
    residual[0] = e[0] / l00;
    residual[1] = (e[1] - l10 * residual[0]) / l11;
    residual[2] = (e[2] - l20 * residual[0] - l21 * residual[1]) / l22;
    return true;
  }
};

// (4.7), (4.8): eight differences of image coordinates, both rows of a view being one.
struct Image {
  RectifiedCamera camera;
  Eigen::Vector3d p_image, q_image;
  double pixel_error;

  template <typename T>
  void difference(const T* v, const Eigen::Vector3d& measured, T* residual) const {
    const T s = T(camera.f) / v[2];
    residual[0] = (s * v[0] - measured[0]) / pixel_error;
    residual[1] = (M_SQRT2 * s * v[1] - measured[1]) / pixel_error;
    residual[2] = (s * (v[0] - camera.baseline) - measured[2]) / pixel_error;
  }

  template <typename T>
  bool operator()(const T* pose, const T* v, T* residual) const {
    T in_prev[3];
    ceres::AngleAxisRotatePoint(pose, v, in_prev);
    for (int i = 0; i < 3; ++i) in_prev[i] += pose[3 + i];
    difference(in_prev, p_image, residual);
    difference(v, q_image, residual + 3);
    return true;
  }
};

}  // namespace

Pose minimise_with_ceres(const RectifiedCamera& camera, const std::vector<motion::PointPair>& pairs,
                         motion::ErrorModel model, double pixel_error, double huber, const Pose& guess) {
  double pose[6];
  const Eigen::Matrix3d rotation = guess.linear();
  ceres::RotationMatrixToAngleAxis(rotation.data(), pose);
  for (int i = 0; i < 3; ++i) pose[3 + i] = guess.translation()[i];
  std::vector<Eigen::Vector3d> points;
  points.reserve(pairs.size());
  ceres::Problem problem;
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_QR;
  options.logging_type = ceres::SILENT;
  if (model == motion::ErrorModel::image) {
    options.linear_solver_type = ceres::DENSE_SCHUR;
    options.linear_solver_ordering.reset(new ceres::ParameterBlockOrdering);
  }
  auto* loss = new ceres::HuberLoss(huber);
  for (const motion::PointPair& pair : pairs) {
    const Eigen::Vector3d &p = pair.prev, &q = pair.cur;
    if (model == motion::ErrorModel::ellipsoid) {
      using Cost = ceres::AutoDiffCostFunction<Ellipsoid, 3, 6>;
      problem.AddResidualBlock(new Cost(new Ellipsoid{p, q, reconstruct::point_covariance(camera, p, pixel_error),
                                                      reconstruct::point_covariance(camera, q, pixel_error)}),
                               loss, pose);
    } else {
      points.push_back(q);
      using Cost = ceres::AutoDiffCostFunction<Image, 6, 6, 3>;
      problem.AddResidualBlock(new Cost(new Image{camera, reconstruct::image_coordinates(camera, p),
                                                  reconstruct::image_coordinates(camera, q), pixel_error}),
                               loss, pose, points.back().data());
      options.linear_solver_ordering->AddElementToGroup(points.back().data(), 0);
    }
  }
  if (model == motion::ErrorModel::image) options.linear_solver_ordering->AddElementToGroup(pose, 1);
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  Pose result = Pose::Identity();
  Eigen::Matrix3d r;
  ceres::AngleAxisToRotationMatrix(pose, r.data());
  result.linear() = r;
  result.translation() = Eigen::Vector3d(pose[3], pose[4], pose[5]);
  return result;
}

}  // namespace iris::bench
