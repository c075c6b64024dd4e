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
  std::vector<std::string> paths;            // what make_path understands here; the first is "auto"
  std::vector<Eigen::Vector3d> round;        // closed polyline through the rooms and back at eye height [m]
  std::vector<Eigen::Vector3d> corridor;     // two ends of a straight walk
  Eigen::Vector3d circle_centre{0, 0, 0};    // of circles and of free movement
  double circle_radius = 0;                  // [m] 0 = none; free movement stays within it (half of it in height)
  std::vector<Eigen::Vector3d> look_at;      // what cameras circle around and look at (boxes, targets, hand)
  double look_at_distance = 0;               // [m] of the circle, and the usual one of `around`
  double look_at_near = 0, look_at_far = 0;  // [m] between which `around` and `circle-far` vary
  Eigen::Vector3d stand{0, 0, 0}, stand_look_at{1, 0, 0};  // of a camera that stands still
};

struct Scene {
  std::string name;
  std::vector<SceneObject> objects;
  cv::Vec3b sky{230, 210, 190};  // BGR where a ray hits nothing
  ScenePlaces places;
  // Corners of the calibration target [m] world, row by row from its upper left, as its front shows them: four of each
  // square clockwise from its upper left one (squares of the thesis), or the inner corners of the board. Empty in other
  // scenes.
  std::vector<Eigen::Vector3d> target_corners;
};

// Names that make_scene understands: apartment, seminar-room, yard, boxes, grasp, calibration (7 x 5 dark squares of
// 20 mm with gaps of 20 mm, thesis 2.3), calibration:chessboard (10 x 7 squares of 25 mm: 9 x 6 inner corners),
// calibration:charuco (10 x 7 squares of 30 mm, markers 0 to 34 of DICT_4X4_50 with 22.5 mm in the white ones).
const std::vector<std::string>& scene_names();

// The scene; the same bytes for the same seed on every machine. Throws UsageError that lists the names for an unknown
// one.
Scene make_scene(const std::string& name, int seed);

// A scene from any surface, z up; it stands still. Its places come from the bounding box and from what is free at its
// middle (at half of its height): a room is seen from a circle there and from free movement; what fills its middle is
// an object, which the camera circles around and looks at. Throws InputError that names `name` if there is no triangle,
// or if the scene is smaller than 1 mm or larger than 1 km (a model that is not in metres).
Scene scene_from_meshes(std::vector<TriangleMesh> meshes, const std::string& name);

// The way of the left camera (as recorded: x right, y down, z forward).
struct SimulatedPath {
  std::string name;
  double seconds = 0;
  double length = 0;                             // [m] without the shaking
  std::function<Pose(double t)> world_from_cam;  // smooth, t in [0, seconds]
};

// Paths:
//   circle      around circle_centre, looking outwards; or around look_at, looking at it
//   circle-far  around look_at, the distance varying between look_at_near and look_at_far
//   roam        free movement about circle_centre, with full turns about the optical axis
//   round       along places.round, looking ahead
//   corridor    along places.corridor and back
//   around      look_at from many sides, distances and image regions, standing still in between
//   static      from `stand`; the camera does not move (12 s without options.frames)
// All but static come back to their first pose. Speed is options.speed at most; the camera turns by at most 45 deg/s
// (60 deg/s in roam), slowing down for it. Shaking comes on top, except in static: each of the three axes has the
// standard deviation of options.jitter, from 0.5 to 3 Hz; it is absent in the first and the last instant, within a
// second of which it grows: the first pose is level, but in circle, circle-far and around of things that lie lower.
// Path `options.path` through the scene ("auto" = the scene's first), at options.speed, shaken by options.jitter.
// Throws UsageError that names the paths the scene offers if it has no such path.
SimulatedPath make_path(const Scene& scene, const SimulateOptions& options);

}  // namespace iris::simulate
