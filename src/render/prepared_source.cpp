#include <algorithm>
#include <cstring>

#include "iris/core/error.h"
#include "iris/render/dsnv.h"

namespace iris::render {
namespace {

DisparityOrigin accepted_origin(const std::string& name) {
  if (name == "measured") return DisparityOrigin::corrected;
  if (name == "within") return DisparityOrigin::within_segment;
  IRIS_CHECK(name == "everywhere");
  return DisparityOrigin::between_segments;
}

}  // namespace

void DsnvOptions::declare(OptionSet& set) {
  set.section("render");
  set.add("max_sources", max_sources, "", 1, 32,
          "Stored views that one picture is made from. More views fill more holes and cost time in proportion.");
  set.add("max_disparity_step", max_disparity_step, "px", 0.1, 100,
          "Neighbouring pixels whose disparities differ by more belong to different objects: no surface is put between "
          "them (thesis 7.9).");
  set.add("step", step, "px", 1, 4,
          "Trace every n-th pixel and interpolate the rest (1, 2 or 4): 2 is about four times as fast, and softer.");
  set.add("fusion", fusion, {"agreement", "nearest"},
          "Which surface wins where the views differ. agreement: the one most views support, their colours blended. "
          "nearest: the smallest distance (thesis 7.10); any wrongly near surface shows.");
  set.add("use_origin", use_origin, {"measured", "within", "everywhere"},
          "Which disparities make surfaces: measured ones only, also those interpolated within segments, or all. "
          "Everything gives the fewest holes.");
  set.add("fill_holes", fill_holes, "px", 0, 64,
          "Holes of the picture up to this width are filled from their rims; 0 leaves all of them dark.");
}

PreparedSource::PreparedSource(std::shared_ptr<const StereoView> view, const DsnvOptions& options)
    : view_(std::move(view)) {
  const cv::Mat1f& all = view_->disparity.disparity;
  IRIS_CHECK(!all.empty() && all.size() == view_->image.size());
  IRIS_CHECK(view_->camera.width == all.cols && view_->camera.height == all.rows);
  IRIS_CHECK(view_->image.type() == CV_8UC1 || view_->image.type() == CV_8UC3);
  const DisparityOrigin up_to = accepted_origin(options.use_origin);
  if (up_to == DisparityOrigin::between_segments || view_->disparity.origin.empty()) {
    disparity_ = all.isContinuous() ? all : cv::Mat1f(all.clone());
  } else {
    disparity_.create(all.size());
    for (int y = 0; y < all.rows; ++y) {
      for (int x = 0; x < all.cols; ++x) disparity_(y, x) = view_->disparity.at(y, x, up_to);
    }
  }

  cv::Mat1f level((all.rows + 3) >> kFirstBits, (all.cols + 3) >> kFirstBits, 0.0f);
  float low = 1e9f;
  for (int y = 0; y < all.rows; ++y) {
    const float* row = disparity_[y];
    float* blocks = level[y >> kFirstBits];
    for (int x = 0; x < all.cols; ++x) {
      const float d = row[x];
      low = d > 0 ? std::min(low, d) : low;
      blocks[x >> kFirstBits] = std::max(blocks[x >> kFirstBits], d);
    }
  }
  for (const float d : level) max_disparity_ = std::max(max_disparity_, d);
  min_disparity_ = max_disparity_ > 0 ? low : 0;
  max_levels_.push_back(level);
  while (level.rows > 1 || level.cols > 1) {
    cv::Mat1f next((level.rows + 1) / 2, (level.cols + 1) / 2, 0.0f);
    for (int y = 0; y < level.rows; ++y) {
      for (int x = 0; x < level.cols; ++x) next(y / 2, x / 2) = std::max(next(y / 2, x / 2), level(y, x));
    }
    max_levels_.push_back(next);
    level = next;
  }
}

float PreparedSource::max_in(int x0, int y0, int x1, int y1) const {
  const int longest = std::max(x1 - x0, y1 - y0);
  int level = 0, bits = kFirstBits;
  while ((longest >> bits) > 3 && level + 1 < static_cast<int>(max_levels_.size())) ++level, ++bits;
  const cv::Mat1f& blocks = max_levels_[static_cast<size_t>(level)];
  float largest = 0;
  for (int y = y0 >> bits; y <= y1 >> bits; ++y) {
    for (int x = x0 >> bits; x <= x1 >> bits; ++x) largest = std::max(largest, blocks(y, x));
  }
  return largest;
}

}  // namespace iris::render
