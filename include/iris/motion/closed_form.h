// First guess of the motion and rejection of suspicious correspondences (thesis 5.3.4).
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "iris/geometry/pose.h"

namespace iris::motion {

// The motion prev_from_cur with the least weighted sum of |prev - (R cur + T)|^2, in closed form (Arun, Huang and
// Blostein; reflections are turned into the nearest rotation, which planar or noisy sets need). Nothing if the points
// are fewer than three or lie on a line.
std::optional<Pose> spherical_motion(const std::vector<Eigen::Vector3d>& prev, const std::vector<Eigen::Vector3d>& cur,
                                     const std::vector<double>& weights);

// Chauvenet's criterion (5.4) on errors (not squared) of mean 0: true for each error e to keep, which is so as long as
// n (1 - erf(e / (S sqrt(2)))) >= 0.5 with S^2 = sum e^2 / (n - 1).
std::vector<bool> chauvenet(const std::vector<double>& errors);

}  // namespace iris::motion
