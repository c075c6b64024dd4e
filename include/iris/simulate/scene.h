// Made-up places with known geometry, all from triangles and procedural textures: nothing is read from disk.
// World: z up, floor at z = 0 [m].
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "iris/geometry/pose.h"
#include "iris/simulate/options.h"
#include "iris/types/triangle_mesh.h"

namespace iris::simulate {

struct SceneObject {
  TriangleMesh mesh;  // in the object's frame; both sides of a triangle are seen
  // Pose of the object at time t [s]; none = it stands still and its frame is the world.
  std::function<Pose(double t)> world_from_object;
  bool textured = true;  // stereo can measure it: its grey values vary enough everywhere
};

// Where a camera can go in the scene. What a scene does not offer is empty.
struct ScenePlaces {
  std::vector<Eigen::Vector3d> round;      // closed polyline through the rooms and back at eye height [m]
  std::vector<Eigen::Vector3d> corridor;   // two ends of a straight walk
  Eigen::Vector3d circle_centre{0, 0, 0};  // of circles and of free movement
  double circle_radius = 0;                // [m] 0 = none
  std::vector<Eigen::Vector3d> look_at;    // what cameras circle around and look at (boxes, targets, hand)
  double look_at_distance = 0;             // [m]
};

struct Scene {
  std::string name;
  std::vector<SceneObject> objects;
  cv::Vec3b sky{230, 210, 190};  // BGR where a ray hits nothing
  ScenePlaces places;
};

// Names that make_scene understands: apartment, seminar-room, yard, boxes, grasp, calibration (squares of the thesis),
// calibration:chessboard, calibration:charuco.
const std::vector<std::string>& scene_names();

// The scene; the same bytes for the same seed on every machine. Throws UsageError that lists the names for an unknown
// one.
Scene make_scene(const std::string& name, int seed);

// The way of the left camera (as recorded: x right, y down, z forward).
struct SimulatedPath {
  std::string name;
  double seconds = 0;
  double length = 0;                             // [m] without the shaking
  std::function<Pose(double t)> world_from_cam;  // smooth, t in [0, seconds]
};

// Path `options.path` through the scene ("auto" = the scene's first), at options.speed, shaken by options.jitter.
// Throws UsageError that names the paths the scene offers if it has no such path.
SimulatedPath make_path(const Scene& scene, const SimulateOptions& options);

}  // namespace iris::simulate
