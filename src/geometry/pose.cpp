#include "iris/geometry/pose.h"

#include <Eigen/SVD>
#include <cmath>

namespace iris {

double rotation_angle(const Eigen::Matrix3d& rotation) {
  // atan2 of the skew part and the trace is accurate at both ends, where acos is not.
  const Eigen::Vector3d skew(rotation(2, 1) - rotation(1, 2), rotation(0, 2) - rotation(2, 0),
                             rotation(1, 0) - rotation(0, 1));
  return std::atan2(skew.norm(), rotation.trace() - 1.0);
}

Eigen::Matrix3d nearest_rotation(const Eigen::Matrix3d& matrix) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(matrix, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d u = svd.matrixU();
  if ((u * svd.matrixV().transpose()).determinant() < 0) u.col(2) = -u.col(2);
  return u * svd.matrixV().transpose();
}

Pose z_up_from_camera() {
  Pose pose = Pose::Identity();
  pose.linear() << 0, 0, 1,  //
      -1, 0, 0,              //
      0, -1, 0;
  return pose;
}

}  // namespace iris
