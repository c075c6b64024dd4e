// Virtual objects in a novel view, hidden where the scene stands before them (thesis 7.3.5: the buffer of true depths).
#pragma once

#include <vector>

#include "iris/geometry/rectified_camera.h"
#include "iris/types/novel_view.h"
#include "iris/types/triangle_mesh.h"

namespace iris::render {

// Straight line between two points of the world [m], smooth edges, `width` px wide. Where the scene has no depth
// (holes) the line is visible. Depth and source of the view stay those of the scene. Pinhole and equirectangular.
void draw_line(NovelView& view, const NovelCamera& camera, const Eigen::Vector3d& from, const Eigen::Vector3d& to,
               const cv::Vec3b& colour, double width);

// Polyline through points of the world [m].
void draw_path(NovelView& view, const NovelCamera& camera, const std::vector<Eigen::Vector3d>& points,
               const cv::Vec3b& colour, double width);

// A recording camera as a pyramid: apex in the optical centre, base = the image's rectangle at depth `size` [m].
void draw_camera_pyramid(NovelView& view, const NovelCamera& camera, const RectifiedCamera& recording,
                         const Pose& world_from_cam, const cv::Vec3b& colour, double size);

// A model, such as the robot's: opaque, lit from the viewer's side, hidden by the scene and by itself. Each pixel's ray
// is cut with the triangles, so that pinhole and equirectangular pictures are exact; both sides of a triangle are seen.
void draw_meshes(NovelView& view, const NovelCamera& camera, const std::vector<TriangleMesh>& meshes,
                 const Pose& world_from_mesh);

}  // namespace iris::render
