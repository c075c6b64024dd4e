// Paths of the virtual camera of a tour (thesis 8.2).
#pragma once

#include <string>
#include <vector>

#include "iris/core/options.h"
#include "iris/types/novel_view.h"
#include "iris/types/pose_graph.h"

namespace iris::tour {

struct TourOptions {
  int width = 640;       // [px] even (the video format wants it)
  int height = 480;      // [px] even
  double fps = 10;       // [1/s] frames of the tour per second
  double seconds = 0;    // [s] length of the tour; 0 = automatic: the recording's own length, at least 8 and at most 10
  double max_speed = 8;  // [times] but the automatic length shows a long recording at most so many times faster
  double back = -1;      // [m] the virtual camera flies so far behind the recording one; < 0 = automatic
  double above = -1;     // [m] and so far above it; < 0 = automatic
  double smoothing = 0.7;   // [s] standard deviation of the Gaussian that calms the recorded motion, in recorded time
  double fov = 50;          // [deg] vertical field of view of the virtual camera
  bool draw_camera = true;  // the recording camera as a pyramid
  bool draw_path = true;    // the recorded path as a line

  double ease = 1;          // [s] gathering and losing speed at the ends of orbits, turns, walks and splines
  double eye = -1;          // [m] height of the eye above the world's zero; < 0 = the recording camera's median height
  double clearance = 0.25;  // [m] a walk keeps so far from everything that is not free
  double walk_speed = 0.8;  // [m/s] of a walk
  double turn_rate = 45;    // [deg/s] a walk and a spline without times turn at most so fast
  double radius = 0;        // [m] of an orbit; 0 = automatic
  double turns = 1;         // orbit, panorama: full turns; negative: clockwise seen from above
  double swing = 0;         // [deg] follow, fixed: the camera goes so far round what the recording one looks at, to the
                            // right of it
  double rise = 15;         // [deg] and so far up
  double distance = 0;      // [m] follow, fixed: distance of that point in front of the recording camera; 0 = automatic

  std::string layout = "plain";        // plain, or side-by-side as in fig. 8.4: recorded image, map, novel view
  double fade = 0;                     // [s] from black at the beginning, to black at the end
  std::string frame_format = "png";    // png or jpeg: pictures of a tour that is written as a folder
  std::string depth = "none";          // none, png, exr or both: depth images beside the pictures
  double robot_scale = 1;              // [m] length of the robot model's unit
  std::string robot_camera = "0,0,0";  // [m] where the left camera is in the model (x forward, y left, z up)

  void declare(OptionSet& set);
};

// The recorded path, smoothed, flown after by a virtual camera behind and above that looks where the recording camera
// looks: at the point `scene_depth` [m] (median depth of the scene) in front of it. "Above" and "behind" are those of
// the smoothed recording camera, so that no assumption about the world's axes is needed. Keyframes as dense as the
// frames. `nodes`: one sub-map, in order, not empty.
CameraPath along(const std::vector<PoseNode>& nodes, const TourOptions& options, double scene_depth);

// Like a camera on a pole at the recording one: moved round the point `scene_depth` [m] in front of it by options.swing
// and options.rise, looking at it, following it without smoothing; in recorded time if options.seconds is 0. For
// dynamic novel views (8.3.3). `fixed`: it stays where it is at the beginning.
CameraPath follow(const std::vector<PoseNode>& nodes, const TourOptions& options, double scene_depth, bool fixed);

// Once round `centre` (options.turns times) on a level circle, looking at it. `from`: where to begin, by the direction
// seen from the centre; `height` [m] of the circle in the world. 12 s a turn if options.seconds is 0.
CameraPath orbit(const Eigen::Vector3d& centre, double radius, double height, const Eigen::Vector3d& from,
                 const TourOptions& options);

// Turns on the spot, level, to the left (options.turns times), beginning in the direction `yaw` [rad] from x to y.
CameraPath turn_around(const Eigen::Vector3d& position, double yaw, const TourOptions& options);

// The camera frame of a look from a point in a direction; level: the picture's rows are horizontal in the world (z up).
// A look straight up or down has the world's y to the left.
Pose looking(const Eigen::Vector3d& position, const Eigen::Vector3d& direction);

// Length of a path [s].
double duration(const CameraPath& path);

// Camera at time t [s], clamped to the path. linear: positions linearly, orientations along the shortest arc. spline: a
// cubic curve through the keyframes with continuous velocity: Bezier segments on R^3 x SO(3) by de Casteljau's scheme,
// whose tangents are those of the parabola through each keyframe and its neighbours. (Not on SE(3) as one group: its
// geodesics are screws, and a straight flight with a turn would leave the straight line.)
CameraKeyframe sample(const CameraPath& path, double t);

// Time [s] on the path at `since` [s] after the beginning of the tour: equal but for path.ease, which reaches the end
// at the same moment with smooth speed.
double eased_time(const CameraPath& path, double since);

// Pose of the recording camera at a moment [ns], clamped to the nodes; interpolated likewise.
Pose recorded_pose(const std::vector<PoseNode>& nodes, int64_t stamp_ns);

// The pinhole camera of a keyframe.
NovelCamera novel_camera(const CameraKeyframe& keyframe, const TourOptions& options);

// Moves `from` (part 0) to `to` (part 1).
Pose interpolate(const Pose& from, const Pose& to, double part);

}  // namespace iris::tour
