// Bundle adjustment: the poses of all stored views and all points that several of them share, so that the images agree
// best (the image based model of thesis 4.4 over many views at once). It also tells whether the calibration is off.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "iris/core/options.h"
#include "iris/geometry/rectified_camera.h"
#include "iris/loop/pose_graph.h"
#include "iris/motion/scs_options.h"
#include "iris/types/pose_graph.h"
#include "iris/types/stereo_view.h"

namespace iris::loop {

struct BundleOptions {
  int window = 5;            // [stored views] corners of a view are looked for in so many later ones, and in loops
  int partners = 8;          // [stored views] and in so many earlier ones that see the same by the refined poses
  int points = 250;          // most points of a view
  bool calibrate = true;     // correct the disparity offset and the focal length if they are off significantly
  double min_offset = 0.1;   // [px] a smaller disparity offset is not corrected: matching alone has such errors
  double min_focal = 0.002;  // [parts] a smaller error of the focal length is not corrected. What is not corrected
                             // stays uncertain by as much (one standard deviation), which all poses share
  double max_offset = 1.0;   // [px] a larger one is reported only: then more than the offset is wrong
  double max_focal = 0.02;   // [parts] the same for the focal length
  double sigma = 2.5;  // standard deviations are taken this many times as large as residuals say, or as many times
                       // as loops have shown odometry to be worse (RefinedGraph): errors of neighbouring views and
                       // points go together
  int max_iterations = 30;

  void declare(OptionSet& set);  // section "loop"
};

// An estimate with its standard deviation.
struct Estimated {
  double value = 0, sigma = 0;
  bool told = true;      // the recording tells it: sigma is small enough to see a gross error
  bool off = false;      // significantly, and by more than matching alone may bring
  bool applied = false;  // corrected
};

// What the recording says about its calibration. Nothing is corrected if one of the errors cannot be: it would be taken
// for the others.
struct CalibrationCorrection {
  Estimated disparity_offset;  // [px] to be added to measured disparities (RectifiedCamera::disparity_offset)
  Estimated focal;             // the focal length is larger by this part
  Estimated slope;        // slope * (y - cy) is to be added as well: [rad] a turn of the right camera about its optical
                          // axis, which tilts its rows as well, or a shear that rectification without knowledge
                          // of the lenses leaves, which does not. Never applied, since all disparities would
                          // change: calibrate again
  std::string words;      // for people; empty: too few views to tell
  bool is_wrong = false;  // something is off that is not corrected
};

struct BundleResult {
  bool ok = false;      // false: too few shared points; poses are as they were
  std::string problem;  // then why
  // Nodes of the input in their order. Poses of stored views are adjusted, the first one of each sub-map keeps its
  // pose; between stored views the corrections of both neighbours are blended, in proportion to the way.
  std::vector<PoseNode> nodes;
  // Of each node relative to the first stored view of its sub-map; a node that is no stored view moves rigidly with the
  // nearest one. Perturbation as everywhere: t' = t + dt, R' = exp(dw) R.
  std::vector<Matrix6d> covariance;
  CalibrationCorrection calibration;
  RectifiedCamera camera;  // the input's with what is applied of it
  int views = 0, points = 0, observations = 0, iterations = 0;
  double rms_before = 0, rms_after = 0;  // [px] of an image coordinate, robust (1.48 times the median)
};

// refined: poses, odometry between them and loops; loops that are rejected or end elsewhere than at stored views are
// left out. view_frames: frame_idx of the stored views, ascending, each a node. view: gives them; called from several
// threads at once, for a view that takes part in loops again for each of them. Memory does not depend on their number
// but for the points (about 150 kB a view). Odometry between successive views counts as well, with the errors that
// `refined` tells of: it knows the frames in between. The result is the same for any number of threads. `stopped` is
// asked now and then; true: Interrupted is thrown; may be empty.
BundleResult bundle(const RefinedGraph& refined, const std::vector<int>& view_frames,
                    const std::function<StereoView(int frame_idx)>& view, const RectifiedCamera& camera,
                    const BundleOptions& options, const motion::ScsOptions& scs,
                    const std::function<bool()>& stopped = {});

// One observation: residual (x left, sqrt(2) y, x right) [px], predicted less seen, and its derivatives. `seen`:
// reconstruct::image_coordinates of the measured point. calibration: disparity offset [px], focal part, slope.
struct ObservationResidual {
  bool valid = false;  // the point is before the camera
  Eigen::Vector3d residual = Eigen::Vector3d::Zero();
  Eigen::Matrix3d by_point;             // of the point in the world
  Eigen::Matrix<double, 3, 6> by_pose;  // of the perturbation of world_from_cam
  Eigen::Matrix<double, 3, 3> by_calibration;
};
ObservationResidual observe(const RectifiedCamera& camera, const Pose& world_from_cam, const Eigen::Vector3d& point,
                            const Eigen::Vector3d& calibration, const Eigen::Vector3d& seen);

}  // namespace iris::loop
