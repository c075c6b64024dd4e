#include "iris/motion/consistency.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <bit>
#include <cmath>

#include "iris/reconstruct/error_propagation.h"

namespace iris::motion {
namespace {

// (5.2) and (5.3); undo_roll turns differences of points in the current camera clockwise.
bool consistent_pair(const RectifiedCamera& camera, const Correspondence& a, const Correspondence& b,
                     double pixel_error, double cos_max_turn, const Eigen::Matrix3d& undo_roll) {
  const Eigen::Vector3d u = a.prev_point - b.prev_point;
  const Eigen::Vector3d v = undo_roll * (a.cur_point - b.cur_point);
  const double length_u = u.norm(), length_v = v.norm();
  if (u.dot(v) < cos_max_turn * length_u * length_v) return false;  // (5.3)
  const double error_u = reconstruct::length_error(camera, a.prev_point, b.prev_point, pixel_error);
  const double error_v = reconstruct::length_error(camera, a.cur_point, b.cur_point, pixel_error);
  const double difference = length_u - length_v;
  return difference * difference <= 9 * (error_u * error_u + error_v * error_v);  // (5.2)
}

// x right, y down, z forward.
Eigen::Matrix3d clockwise(double roll) { return Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitZ()).toRotationMatrix(); }

}  // namespace

bool consistent(const RectifiedCamera& camera, const Correspondence& a, const Correspondence& b, double pixel_error,
                double max_turn, double roll) {
  return consistent_pair(camera, a, b, pixel_error, std::cos(max_turn), clockwise(roll));
}

BitMatrix consistency_matrix(const RectifiedCamera& camera, const std::vector<Correspondence>& correspondences,
                             double pixel_error, double max_turn, double roll) {
  const int n = static_cast<int>(correspondences.size());
  BitMatrix matrix(n);
  const double cos_max_turn = std::cos(max_turn);
  const Eigen::Matrix3d undo_roll = clockwise(roll);
  for (int i = 0; i < n; ++i)
    for (int k = i + 1; k < n; ++k)
      if (consistent_pair(camera, correspondences[i], correspondences[k], pixel_error, cos_max_turn, undo_roll))
        matrix.set_pair(i, k);
  return matrix;
}

std::vector<int> consistent_set(const BitMatrix& matrix) {
  const int words = matrix.words();
  // Correspondences that are consistent with all chosen ones.
  std::vector<uint64_t> candidates(words, 0);
  for (int i = 0; i < matrix.size(); ++i) candidates[i / 64] |= uint64_t{1} << (i % 64);
  std::vector<int> chosen;
  for (;;) {
    int best = -1, most = -1;
    for (int i = 0; i < matrix.size(); ++i) {
      if (!(candidates[i / 64] >> (i % 64) & 1)) continue;
      const uint64_t* row = matrix.row(i);
      int kept = 0;
      for (int w = 0; w < words; ++w) kept += std::popcount(row[w] & candidates[w]);
      if (kept > most) {
        most = kept;
        best = i;
      }
    }
    if (best < 0) break;
    chosen.push_back(best);
    for (int w = 0; w < words; ++w) candidates[w] &= matrix.row(best)[w];  // the diagonal removes `best` itself
  }
  std::sort(chosen.begin(), chosen.end());
  return chosen;
}

}  // namespace iris::motion
