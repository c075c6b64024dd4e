// All stored views of a run become one point cloud.
#pragma once

#include "iris/pipeline/pipeline.h"
#include "iris/reconstruct/fusion.h"
#include "iris/types/point_cloud.h"
#include "iris/views/view_store.h"

namespace iris {
class OptionSet;
}

namespace iris::exporters {

struct CloudOptions {
  reconstruct::FusionOptions fusion;
  double voxel = 0.02;         // [m] edge of the cubes that thin the points: one point a cube
  int max_points = 3'000'000;  // budget of points, and thereby of memory; the cubes' edge is doubled until they fit
  int min_agree = 1;           // other views that must measure the same; 0 keeps what a single view has seen
  int outlier_points = 12;     // neighbours whose mean distance decides whether a point stands alone; 0 = off
  double outlier_sigma = 2;    // [standard deviations] of that distance above its mean
  int normal_points = 16;      // neighbours that a point's normal is fitted to
  bool ascii = false;          // cloud.ply as text

  void declare(OptionSet& set);  // section "cloud"
};

// The points of all views of a store that stand in one world (one sub-map).
//   * Each view's points are fused with the views that overlap it (reconstruct::fuse_view). A point stays if at least
//     min_agree other views measure it, and more of them than see through it.
//   * The points in a cube are merged with their error ellipsoids, K = dp^2 J J^T (4.14), to which the cube's own size
//     is added (edge^2 / 12: they are points of one surface, not one point): mean = (sum K^-1)^-1 sum K^-1 p. They
//     share their measurements, so that sigma is the mean of theirs and not smaller.
//   * Lonely points are removed and normals fitted by PCL (see cloud_filter.h).
//   * Cubes in the order in which they are first touched; the same bytes for any number of threads.
// Memory: about 0.1 kB for each of max_points and the views of a few places, however long the session.
// Throws Interrupted if `control` asks to stop, InputError if a view is damaged.
PointCloud fuse_cloud(const views::ViewStore& views, const CloudOptions& options,
                      const pipeline::RunControl& control = {});

// The other views to compare each view with, their errors' scale, and fusion of single views: for exporters that need
// pixels instead of points.
class ViewFusion {
 public:
  ViewFusion(const views::ViewStore& views, const CloudOptions& options);

  double error_scale() const { return error_scale_; }

  struct Fused {
    std::shared_ptr<const StereoView> view;
    reconstruct::FusedView fused;  // only the pixels that stay
  };
  // One view of the store; several threads may ask at the same time.
  Fused fuse(int index) const;

 private:
  std::vector<int> neighbours(const StereoView& view, int index) const;

  const views::ViewStore& views_;
  const CloudOptions& options_;
  std::vector<reconstruct::PlacedCamera> cameras_;
  double error_scale_ = 1;
};

}  // namespace iris::exporters
