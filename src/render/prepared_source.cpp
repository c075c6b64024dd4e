#include <algorithm>
#include <opencv2/core.hpp>

#include "iris/core/error.h"
#include "iris/render/dsnv.h"

namespace iris::render {
namespace {

constexpr float kNoDisparity = 1e9f;  // [px] beyond all

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
  set.add("hole_sources", hole_sources, "", 0, 32,
          "Where none of these views shows anything, so many others are asked at most: they cost time only for the "
          "parts of the picture that are missing.");
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
  set.add(
      "fill_holes", fill_holes, "px", 0, 64,
      "Holes of the picture up to this width are filled from the background beside them; 0 leaves all of them dark.");
  set.add("neighbours", neighbours, "", 0, 16,
          "Views that each stored view is compared with before pictures are made, for the two options below; 0 leaves "
          "the views as they are.");
  set.add("free_space", free_space,
          "Surfaces of a view that lie where its neighbours see through are replaced by what most views support, holes "
          "get the neighbours' surfaces, and agreeing disparities are averaged.");
  set.add("even_brightness", even_brightness,
          "Takes out what automatic exposure and the lens (vignetting) make of the brightness: no spots in pictures "
          "that are put together from several views.");
}

PreparedSource::PreparedSource(std::shared_ptr<const StereoView> view, const DsnvOptions& options)
    : view_(std::move(view)) {
  const cv::Mat1f& all = view_->disparity.disparity;
  IRIS_CHECK(!all.empty() && all.size() == view_->image.size() && all.total() >= 4);
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

  const cv::Size blocks((all.cols + 3) >> kFirstBits, (all.rows + 3) >> kFirstBits);
  max_levels_.emplace_back(blocks, 0.0f);
  min_levels_.emplace_back(blocks, kNoDisparity);
  for (int y = 0; y < all.rows; ++y) {
    const float* row = disparity_[y];
    float* high = max_levels_[0][y >> kFirstBits];
    float* low = min_levels_[0][y >> kFirstBits];
    for (int x = 0; x < all.cols; ++x) {
      const float d = row[x];
      const int block = x >> kFirstBits;
      high[block] = std::max(high[block], d);
      low[block] = std::min(low[block], d > 0 ? d : kNoDisparity);
    }
  }
  while (max_levels_.back().total() > 1) {
    const cv::Mat1f high = max_levels_.back(), low = min_levels_.back();
    cv::Mat1f next_high((high.rows + 1) / 2, (high.cols + 1) / 2, 0.0f);
    cv::Mat1f next_low(next_high.size(), kNoDisparity);
    for (int y = 0; y < high.rows; ++y) {
      for (int x = 0; x < high.cols; ++x) {
        next_high(y / 2, x / 2) = std::max(next_high(y / 2, x / 2), high(y, x));
        next_low(y / 2, x / 2) = std::min(next_low(y / 2, x / 2), low(y, x));
      }
    }
    max_levels_.push_back(next_high);
    min_levels_.push_back(next_low);
  }
  max_disparity_ = max_levels_.back()(0, 0);
  min_disparity_ = max_disparity_ > 0 ? min_levels_.back()(0, 0) : 0;
}

namespace {

// The level whose blocks a rectangle covers by few.
size_t level_of(int x0, int y0, int x1, int y1, int first_bits, size_t levels) {
  const int longest = std::max(x1 - x0, y1 - y0);
  size_t level = 0;
  while ((longest >> (first_bits + static_cast<int>(level))) > 3 && level + 1 < levels) ++level;
  return level;
}

}  // namespace

float PreparedSource::max_in(int x0, int y0, int x1, int y1) const {
  const size_t level = level_of(x0, y0, x1, y1, kFirstBits, max_levels_.size());
  const int bits = kFirstBits + static_cast<int>(level);
  float largest = 0;
  for (int y = y0 >> bits; y <= y1 >> bits; ++y) {
    const float* row = max_levels_[level][y];
    for (int x = x0 >> bits; x <= x1 >> bits; ++x) largest = std::max(largest, row[x]);
  }
  return largest;
}

float PreparedSource::min_in(int x0, int y0, int x1, int y1) const {
  const size_t level = level_of(x0, y0, x1, y1, kFirstBits, min_levels_.size());
  const int bits = kFirstBits + static_cast<int>(level);
  float smallest = kNoDisparity;
  for (int y = y0 >> bits; y <= y1 >> bits; ++y) {
    const float* row = min_levels_[level][y];
    for (int x = x0 >> bits; x <= x1 >> bits; ++x) smallest = std::min(smallest, row[x]);
  }
  return smallest;
}

}  // namespace iris::render
