// Textured surfaces of views for a scene.
#pragma once

#include <vector>

#include "export/scene_file.h"
#include "iris/types/triangle_mesh.h"

namespace iris::exporters {

struct SceneSurface {
  int view = 0;       // index into the store
  TriangleMesh mesh;  // in the view's camera frame, without texture
  std::vector<unsigned char> jpeg;
  // As in the file.
  size_t bytes() const { return mesh.vertices.size() * 20 + mesh.triangles.size() * 12 + jpeg.size(); }
};

// Surfaces of the views that together show what all views see, in the order of what they add; at most `budget` bytes.
std::vector<SceneSurface> scene_surfaces(const views::ViewStore& views, const SceneOptions& options,
                                         const CloudOptions& cloud_options, size_t budget,
                                         const pipeline::RunControl& control);

}  // namespace iris::exporters
