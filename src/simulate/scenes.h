// The scenes behind make_scene, a file each.
#pragma once

#include "iris/simulate/scene.h"

namespace iris::simulate {

Scene apartment(uint32_t seed);
Scene seminar_room(uint32_t seed);
Scene yard(uint32_t seed);
Scene boxes(uint32_t seed);
Scene grasp(uint32_t seed);

enum class TargetKind { squares, chessboard, charuco };
Scene calibration_target(TargetKind kind, uint32_t seed);

// Square of the shortest distance from a point to a triangle.
double squared_distance(const Eigen::Vector3d& point, const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                        const Eigen::Vector3d& c);

}  // namespace iris::simulate
