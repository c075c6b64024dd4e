// The last minimisation of the motion as a problem for Ceres.
#pragma once

#include <vector>

#include "iris/motion/minimise.h"

namespace iris::bench {

// The same cost and first guess as motion::minimise_motion(), derivatives by Ceres's automatic differentiation. With
// ErrorModel::image the points are unknowns that Ceres eliminates (Schur complement).
Pose minimise_with_ceres(const RectifiedCamera& camera, const std::vector<motion::PointPair>& pairs,
                         motion::ErrorModel model, double pixel_error, double huber, const Pose& guess);

}  // namespace iris::bench
