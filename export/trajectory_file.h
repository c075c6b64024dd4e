// The camera path in the formats that other programs read.
//
// Numbers are written with the fewest digits that read back as the same double; the same graph gives the same bytes.
// All writers throw InputError if the file cannot be written and never leave half a file.
//
// Sub-maps have no known relation to each other. The *main* sub-map is the one with the most poses (the first of them
// if several have as many).
#pragma once

#include <filesystem>
#include <vector>

#include "iris/types/pose_graph.h"
#include "iris/workspace/workspace.h"

namespace iris::exporters {

// TUM: a line `t tx ty tz qx qy qz qw` for each pose: seconds with 9 decimals, metres, world from left camera, qw >= 0;
// single spaces. `path` holds the main sub-map; sub-map k of the others goes to a file of its own beside it, since
// readers accept nothing but these 8 columns: tum.txt, tum_submap<k>.txt. Such neighbours of an earlier run are
// removed.
void write_tum(const std::filesystem::path& path, const PoseGraph& graph);

// KITTI: line i holds the 12 row-major numbers of the 3x4 matrix that maps points of the left camera of frame i into
// the left camera of the main sub-map's first frame (frame 0, unless the path begins later), which is the identity
// there. Exactly `frames_in_session` lines, the line number is the frame: a frame without a pose, or with a pose in
// another sub-map, gets twelve `nan`, so that it shifts no other frame and cannot be mistaken for a pose.
void write_kitti(const std::filesystem::path& path, const PoseGraph& graph, int frames_in_session);

// g2o: VERTEX_SE3:QUAT (world from left camera, id = frame), FIX for the first frame of each sub-map, EDGE_SE3:QUAT
// with the measurement i_from_j and the upper triangle of its information, see g2o_information. Lines that begin with
// #, which readers skip, tell of each of `loops` whether it is among the edges, or why not.
void write_g2o(const std::filesystem::path& path, const PoseGraph& graph,
               const std::vector<workspace::LoopRecord>& loops);

// A picture of the path from above: as motions were chained (each sub-map laid on the refined path by its first camera)
// and as refined, with the loops between. `refined` and `odometry` have the same frames.
void write_path_picture(const std::filesystem::path& path, const PoseGraph& odometry, const PoseGraph& refined);

// Information of an edge in g2o's coordinates. With X the estimate of i_from_j and Z its measurement, g2o's error is
// e = (translation, vector part of the quaternion) of Z^-1 X: expressed in frame j, and the rotation as half its angle.
// PoseEdge::information is for (dt, dw) with t_X = t_Z + dt, R_X = exp(dw) R_Z. Then Z^-1 X has the translation
// R_Z^T dt and the rotation exp(R_Z^T dw), hence dt = R_Z e_t, dw = 2 R_Z e_q to first order, and the information is
// J^T information J with J = diag(R_Z, 2 R_Z).
Matrix6d g2o_information(const PoseEdge& edge);

}  // namespace iris::exporters
