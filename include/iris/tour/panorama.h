// Where the panoramas of a tour stand, and which of them lead to each other.
#pragma once

#include <vector>

#include "iris/tour/walk.h"

namespace iris::tour {

struct PanoramaOptions {
  int width = 4096;    // [px] of a panorama; the height is half of it
  double spacing = 2;  // [m] least distance of automatically placed ones; half of it round corners: panorama_places()
  int nodes = 0;       // at most so many of them; 0 = as many as the spacing gives
  double reach = 6;    // [m] longest link, but for those that nothing else connects: link_panoramas()
  int sources = 24;    // stored views that a panorama is made from: it looks everywhere at once
  void declare(OptionSet& set);
};

struct PanoramaNode {
  Eigen::Vector2d position;  // [m]
  std::vector<int> links;    // indices of other nodes, ascending; every link goes both ways
};

// Places on the recorded path, but where the map holds an obstacle: the next one `spacing` away from all others, or
// from half of that on where the path turns out of their sight. If that gives more than options.nodes, those are kept
// that lie farthest apart.
std::vector<Eigen::Vector2d> panorama_places(const FreeSpace& space, const std::vector<PoseNode>& nodes,
                                             const PanoramaOptions& options);

// Links between places that see each other (the straight line between them is free) and are within reach; of several in
// nearly the same direction the nearest. Then, so that every place can be reached, the nearest pairs of groups without
// links, whatever the distance and the sight: a place that the map does not know sees nothing.
std::vector<PanoramaNode> link_panoramas(const FreeSpace& space, const std::vector<Eigen::Vector2d>& places,
                                         const PanoramaOptions& options);

}  // namespace iris::tour
