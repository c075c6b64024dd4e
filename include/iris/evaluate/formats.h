// Texts of files that hold truth or estimates: parsers without disk access. `path` is for messages only. All throw
// InputError that names file, line and remedy.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "iris/evaluate/trajectory.h"

namespace iris::evaluate {

// TUM: `t tx ty tz qx qy qz qw` a line; separated by spaces, tabs or commas; lines that begin with # are comments.
// Stamps in seconds, or in nanoseconds if they are whole numbers above 10^15; read without rounding. Quaternions are
// normalised.
Trajectory parse_tum(std::string_view text, const std::filesystem::path& path);

// KITTI: 12 row-major numbers of a 3x4 matrix a line; the line is the frame. Twelve `nan`: no pose. Deviations from a
// rotation by rounding are removed.
std::vector<std::optional<Pose>> parse_kitti(std::string_view text, const std::filesystem::path& path);

// True if the first line with content has 12 numbers (KITTI) rather than TUM's 8.
bool is_kitti(std::string_view text);

// EDGE_SE3:QUAT lines; vertices are named by their frame.
struct GraphEdge {
  int i = 0, j = 0;
  Pose i_from_j = Pose::Identity();
  Matrix6d information = Matrix6d::Identity();  // g2o's coordinates, see MotionEdge
};
std::vector<GraphEdge> parse_g2o_edges(std::string_view text, const std::filesystem::path& path);

// The yaml file of a ROS map.
struct RosMapHeader {
  std::string image;                           // relative to the yaml file
  double resolution = 0;                       // [m]
  double origin_x = 0, origin_y = 0, yaw = 0;  // [m], [rad] lower-left corner of the lower-left cell
  double occupied_thresh = 0.65, free_thresh = 0.196;
  bool negate = false;
  // [m] of the world: what lies between is drawn. From a comment "between z = A m and B m"; both 0 if there is none.
  double bottom = 0, top = 0;
};
RosMapHeader parse_ros_map(const std::string& text, const std::filesystem::path& path);

}  // namespace iris::evaluate
