// Which stored views a novel view is made from (thesis 7.3.2).
#pragma once

#include <array>
#include <functional>
#include <memory>
#include <vector>

#include "iris/render/dsnv.h"
#include "iris/views/view_store.h"

namespace iris::render {

// Indices into `views` of at most options.max_sources views, the most useful first. A view qualifies if what it can see
// (the pyramid between its nearest and its farthest disparity) overlaps what the novel camera sees (up to the distance
// of disparity 1). Views are then taken one by one: each time the one that adds most to the rays of the novel view that
// are not yet well covered, where a view counts the more the smaller the angle between its line of sight and the novel
// one, and the nearer it is to the surface. Only views of one sub-map may be given.
std::vector<int> select_sources(const NovelCamera& camera, const std::vector<views::ViewSummary>& views,
                                const DsnvOptions& options);

// Index into `views` of the view that may show most of the holes of a picture, or -1 if none can show a hundredth of
// the picture. What is missing is looked for at the depths around the holes. `used` views, which show nothing there,
// are not taken again, and speak against those that look along the same lines. The picture has every step-th pixel of
// the camera.
int select_for_holes(const NovelCamera& camera, const NovelView& picture, int step,
                     const std::vector<views::ViewSummary>& views, const std::vector<int>& used);

// The picture of the novel camera from the views that select_sources names, and from options.hole_sources others at
// most where these leave holes. `prepare` is called with indices into `views`.
NovelView render_from_views(const NovelCamera& camera, const std::vector<views::ViewSummary>& views,
                            const std::function<std::shared_ptr<const PreparedSource>(int view)>& prepare,
                            const DsnvOptions& options);

// A convex body with flat faces, in world coordinates [m].
struct Frustum {
  std::vector<Eigen::Vector3d> corners;
  std::vector<std::array<int, 2>> edges;
  std::vector<std::array<int, 3>> triangles;
};
Frustum source_frustum(const views::ViewSummary& view);             // max_disparity > 0
Frustum novel_frustum(const NovelCamera& camera, double farthest);  // pinhole only; farthest [m]
// True if the bodies have a point in common: an edge of one cuts a triangle of the other, or one lies inside the other.
bool overlap(const Frustum& a, const Frustum& b);

}  // namespace iris::render
