// The surface that one stereo view saw, as a textured mesh of few triangles.
#pragma once

#include <functional>
#include <vector>

#include "iris/reconstruct/fusion.h"
#include "iris/types/triangle_mesh.h"

namespace iris::exporters {

// Triangles over the grid of fused pixels (`step` px apart), in the view's camera frame, with texture coordinates of
// its image; the texture itself is left empty. Counter-clockwise seen from the camera.
//   * A right-triangulated irregular network (Evans, Kirkpatrick, Townsend 2001): a triangle is split at the middle of
//     its longest side as long as the disparity there, or at any such place within, differs from the plane by more than
//     `tolerance` standard deviations of the disparity: the mesh is as coarse as the depth error allows, without
//     cracks. Planes are planes in disparity space, too.
//   * The smallest triangles are kept if all three pixels have disparities that differ by at most 2 px (thesis 7.3) and
//     a tenth: far away 2 px are many metres.
//   * Only triangles with a pixel for which `wanted` is true.
TriangleMesh view_surface(const StereoView& view, const reconstruct::FusedView& fused, int step, double tolerance,
                          const std::function<bool(const reconstruct::FusedPixel&)>& wanted);

}  // namespace iris::exporters
