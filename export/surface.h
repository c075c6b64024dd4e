// One surface from a point cloud.
#pragma once

#include <string>

#include "iris/pipeline/pipeline.h"
#include "iris/types/point_cloud.h"
#include "iris/types/triangle_mesh.h"

namespace iris {
class OptionSet;
}

namespace iris::exporters {

struct MeshOptions {
  std::string formats = "ply";    // of OUT/model/mesh.*, separated by commas
  double cell = 0.04;             // [m] edge of the cubes whose corners the surface is sampled at
  int max_triangles = 1'000'000;  // budget; the cubes' edge is doubled until the surface fits
  int min_part = 100;             // [triangles] smaller separate pieces are dropped

  void declare(OptionSet& set);  // section "mesh"
};

// The formats of MeshOptions::formats. Throws UsageError that names one that is unknown.
std::vector<std::string> mesh_formats(const MeshOptions& options);

// The zero surface of the signed distance to the points' tangent planes, averaged with a weight that falls with the
// distance and with the points' variance (implicit moving least squares):
//   f(x) = sum w_i n_i . (x - p_i) / sum w_i,  w_i = (1 - |x - p_i|^2 / R^2)^2 / (sigma_i^2 + (cell / 4)^2),  R = 2
//   cells.
// It is sampled at the corners of cubes and made into triangles by surface nets (Gibson 1998): a vertex in each cube
// that it crosses, at the mean of the crossings on its edges, two triangles for each crossed edge. Cubes with a corner
// that fewer than three points reach are left out: there is no surface where nothing was measured.
// Vertex colours are the points'; triangles are counter-clockwise seen from the cameras' side.
// Works in tiles: the memory beside cloud and surface does not grow with them. The same bytes for any number of
// threads. Throws Interrupted if `control` asks to stop.
TriangleMesh surface_of(const PointCloud& cloud, const MeshOptions& options, const pipeline::RunControl& control = {});

}  // namespace iris::exporters
