// The stored views for other tools: structure from motion, neural rendering, Gaussian splats.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "iris/pipeline/pipeline.h"
#include "iris/views/view_store.h"

namespace iris::exporters {

// A scene point that stored views measured.
struct ScenePoint {
  struct Observation {
    int view_idx = 0;     // into the store's summaries
    double x = 0, y = 0;  // [px]
  };
  Eigen::Vector3d position;  // world [m]
  cv::Vec3b colour;          // BGR
  double error = 0;  // [px] mean difference of the disparities that the observing views measured from the point's
  std::vector<Observation> observations;  // the first is where it was measured, the others where it projects to
};

// About one point a square of `step` x `step` pixels of each view: measured disparities, none where an earlier point is
// already seen. A point is observed by those of the 12 views before and after whose own disparity there differs by at
// most a pixel.
std::vector<ScenePoint> scene_points(const views::ViewStore& views, int step = 16);

// COLMAP's text model, as its documentation describes it, in `folder`:
//   images/000012.png …
//   sparse/0/cameras.txt images.txt points3D.txt
// One PINHOLE camera; its pixel (0.5, 0.5) is the centre of the upper-left one. World as in the run.
void write_colmap(const std::filesystem::path& folder, const views::ViewStore& views,
                  const pipeline::RunControl& control);

// nerfstudio's transforms.json in `folder`, with images/, depth/ (16-bit PNG [mm], 0 = unknown) and the points as
// sparse_pc.ply. Cameras look along -z with y up, in the run's world (z up).
void write_nerfstudio(const std::filesystem::path& folder, const views::ViewStore& views,
                      const pipeline::RunControl& control);

// The stages "colmap" and "nerfstudio" of `iris export`: OUT/colmap and OUT/nerfstudio, of the largest sub-map. They
// are no part of a run.
std::vector<pipeline::Stage> view_export_stages();

}  // namespace iris::exporters
