// Stored views are made consistent with each other before novel views are rendered from them: what the thesis leaves
// open (ch. 7.5, ch. 10). Each view is compared with its neighbours, the stored views that show most of what it shows.
#pragma once

#include <memory>
#include <vector>

#include "iris/render/dsnv.h"
#include "iris/views/view_store.h"

namespace iris::render {

// For each view, the indices of at most `count` others of its sub-map that see most of what it sees.
std::vector<std::vector<int>> find_neighbours(const std::vector<views::ViewSummary>& views, int count);

// How a camera responds to the light it gets, in grey levels: image = (gain * light + bias) * (1 - vignetting * r²), r
// = distance from the principal point, 1 in the image's corner. The mean gain of all views is 1.
struct Brightness {
  double gain = 1, bias = 0, vignetting = 0;
};

// The image as a camera of gain 1, bias 0 and without vignetting would have taken it.
cv::Mat even_image(const cv::Mat& image, const RectifiedCamera& camera, const Brightness& brightness);

// Gains and biases of all views and the vignetting that they have in common: robust least squares over surface points
// that neighbouring pictures show (Ceres). Of each view a reduced copy of 0.3 MB is kept, for a limited number of
// views.
std::vector<Brightness> find_brightness(const views::ViewStore& store, const std::vector<std::vector<int>>& neighbours);

// The view's disparities after comparison with its neighbours' (free space). A surface that lies where neighbours see
// through, farther than the errors of both disparities explain, is replaced by the surface that most views support (if
// there is none, it stays, but counts as filled in); pixels without disparity get the neighbours' surface; where views
// agree, their mean is taken, weighted by the variances propagated from the disparities. Origin: replaced surfaces
// count as interpolated.
StereoView check_free_space(const StereoView& view, const std::vector<std::shared_ptr<const StereoView>>& neighbours);

// The views of another store after all that `options` asks for. Neighbours and brightness are found once, when it is
// made; a view is worked on when it is loaded, and at most `cache_bytes` of finished ones are kept. The store must
// outlive this one. Bit-identical for any number of threads and any order of loading.
class RefinedViewStore : public views::ViewStore {
 public:
  RefinedViewStore(const views::ViewStore& store, const DsnvOptions& options, size_t cache_bytes);
  ~RefinedViewStore() override;
  const std::vector<views::ViewSummary>& summaries() const override;
  std::shared_ptr<const StereoView> load(int index) const override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iris::render
