// FLOG: a map from above by a fuzzy logic based, layered occupancy grid (thesis ch. 6 and A.5).
#pragma once

#include <opencv2/core.hpp>
#include <optional>
#include <vector>

#include "iris/core/options.h"
#include "iris/types/flog_map.h"
#include "iris/types/stereo_view.h"

namespace iris::mapping {

struct FlogOptions {
  double cell = 0.05;   // [m] side of a cell (6.4.2)
  int layers = 3;       // layers of cells, told apart by height (6.3.2)
  int slices = 6;       // cells of a layer above each other; 1 = the thesis. A cell's memberships say to which part
                        // it is filled (6.3.3): where a cell is as high as its layer, the rays that pass over a
                        // bed outvote those that end on it
  double bottom = 0.1;  // [m] lowest bound, relative to the world's z = 0: above the floor, below most obstacles
  double height = 1.8;  // [m] of all layers together (6.4.2: 2.1); the default ends below the lintels of doors
  double min_disparity = 4;  // [px] rays of smaller disparities are followed to the distance of this one only (6.3.3)
  double pixel_error = 0.1;  // [px] error of image coordinates, dp of (4.24)
  double min_spread = 1;     // [cells] lower bound of e of (6.1), which knows nothing of the size of cells; 0 = the
                             // thesis. A triangle narrower than a cell falls between the middles of the cells: with
                             // f = 440 px, 0.4 m baseline and walls at 1 to 3 m, 46 of 298 wall cells remain with
                             // 0, 243 with 0.5, all with 1
  double max_range = 20;     // [m] rays are cut here; what lies beyond is left unknown
  int ray_step = 1;          // [px] every n-th row and column gives rays (the thesis uses every second row)
  double bundle = 0.5;       // [cells] rays that lie within this of each other are followed together where it is empty
  double min_move = 4;       // [cells] a view that moved less since the last added one …
  double min_turn = 0.5;     // [fields of view] … and did not turn by more is not added (6.3.3)
  double min_confidence = 0.05;  // K of (6.3) below which a cell is unknown in the trinary map
  double occupied_level = 0.2;   // memberships of occupancy from here on make an obstacle in the trinary map
  bool seen_only = true;         // cells that no view can have seen past the obstacles of the map are unknown in it
  int min_views = 2;             // what rays of fewer views say of a cell is believed only if their sight of it keeps
                                 // clear of obstacles: where texture repeats itself, one view looks through a gap in a
                                 // wall that is narrower than its matching windows. 1 = always

  void declare(OptionSet& set);
};

// NK of (6.3): rays through a cell that is seen completely from 1 m: it covers f cell x f slice-height pixels, or what
// the image holds of them.
int full_rays(const FlogOptions& options, const RectifiedCamera& camera);

// Adds views to the grid, one after the other. The map does not depend on the number of threads, bit by bit: each tile
// takes its rays in the order of the pixels.
class FlogBuilder {
 public:
  FlogBuilder(const FlogOptions& options, const RectifiedCamera& camera);

  // False: too similar to the last added view; several views from one place carry the same systematic errors (6.3.3).
  bool add(const StereoView& view);

  const FlogMap& map() const { return map_; }
  FlogMap take() { return std::move(map_); }

 private:
  FlogOptions options_;
  double half_view_;  // [rad] half the horizontal field of view
  FlogMap map_;
  std::optional<Pose> last_added_;
};

// What a cell of the trinary map holds.
enum class MapState : uint8_t { unknown = 0, free = 1, occupied = 2 };

// The map as images. Column ix, row 0 = largest y; all images have the same size.
struct MapRaster {
  double cell = 0;                     // [m]
  double origin_x = 0, origin_y = 0;   // [m] world, lower-left corner of the lower-left cell
  int width = 0, height = 0;           // [cells]
  std::vector<double> layer_bounds;    // [m] layers + 1
  std::vector<cv::Mat1f> layer_M;      // Mk of (6.4), 0 = free or unknown, 1 = occupied
  std::vector<cv::Mat1f> layer_U;      // Mk without K: how unsafe a known cell is; 0 where the layer is unknown
  std::vector<cv::Mat1b> layer_state;  // MapState of each layer alone
  cv::Mat1f M;                         // (6.5)
  cv::Mat1f U;                         // max over the layers
  cv::Mat1b known;                     // 0 = unknown, 1 = enough evidence: state is not unknown
  cv::Mat1b state;                     // MapState
  // Centre of a cell, row counted from the top.
  double x_of(int column) const { return origin_x + (column + 0.5) * cell; }
  double y_of(int row) const { return origin_y + (height - row - 0.5) * cell; }
};

// (6.3) - (6.5) over the rectangle of all known cells; of all touched ones if none is known, one unknown
// cell at the origin if there is none.
// A layer's cell is known with K >= min_confidence and one membership >= occupied_level (occupied) or > 1/2 (free);
// I of (6.4) is what remains. Above each other: occupied before free before unknown.
MapRaster rasterise(const FlogMap& map, const FlogOptions& options = {});

}  // namespace iris::mapping
