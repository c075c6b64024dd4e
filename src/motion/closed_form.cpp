#include "iris/motion/closed_form.h"

#include <Eigen/SVD>
#include <cmath>
#include <numbers>

#include "iris/core/error.h"

namespace iris::motion {

std::optional<Pose> spherical_motion(const std::vector<Eigen::Vector3d>& prev, const std::vector<Eigen::Vector3d>& cur,
                                     const std::vector<double>& weights) {
  IRIS_CHECK(prev.size() == cur.size() && prev.size() == weights.size());
  if (prev.size() < 3) return std::nullopt;
  double sum = 0;
  Eigen::Vector3d prev_mean = Eigen::Vector3d::Zero(), cur_mean = Eigen::Vector3d::Zero();
  for (size_t i = 0; i < prev.size(); ++i) {
    sum += weights[i];
    prev_mean += weights[i] * prev[i];
    cur_mean += weights[i] * cur[i];
  }
  prev_mean /= sum;
  cur_mean /= sum;
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (size_t i = 0; i < prev.size(); ++i)
    scatter += weights[i] * (prev[i] - prev_mean) * (cur[i] - cur_mean).transpose();

  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(scatter, Eigen::ComputeFullU | Eigen::ComputeFullV);
  // Points on a line leave the rotation about it open.
  if (!(svd.singularValues()(1) > 1e-9 * svd.singularValues()(0))) return std::nullopt;
  // The reflection case: the direction of least scatter is turned round.
  Eigen::Matrix3d sign = Eigen::Matrix3d::Identity();
  if ((svd.matrixU() * svd.matrixV().transpose()).determinant() < 0) sign(2, 2) = -1;
  Pose motion = Pose::Identity();
  motion.linear() = svd.matrixU() * sign * svd.matrixV().transpose();
  motion.translation() = prev_mean - motion.linear() * cur_mean;
  return motion;
}

std::vector<bool> chauvenet(const std::vector<double>& errors) {
  std::vector<bool> keep(errors.size(), true);
  if (errors.size() < 2) return keep;
  double sum = 0;
  for (const double e : errors) sum += e * e;
  const double s = std::sqrt(sum / static_cast<double>(errors.size() - 1));
  if (s == 0) return keep;
  for (size_t i = 0; i < errors.size(); ++i) {
    keep[i] = static_cast<double>(errors.size()) * std::erfc(std::abs(errors[i]) / (s * std::numbers::sqrt2)) >= 0.5;
  }
  return keep;
}

}  // namespace iris::motion
