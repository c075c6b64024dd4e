#include "iris/motion/correspondences.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

namespace iris::motion {
namespace {

constexpr double kMaxMoved = kPatchSize / 2;  // [px] beyond this it is the surroundings of something else

int difference(const RankPatch& a, const RankPatch& b) {
  int sum = 0;
  for (size_t i = 0; i < a.size(); ++i) sum += std::abs(a[i] - b[i]);
  return sum;
}

// Position in the image turned by `turns` quarter turns clockwise.
cv::Point2f to_turned(double x, double y, int turns, const cv::Size& size) {
  switch (turns) {
    case 1:
      return cv::Point2d(size.height - 1 - y, x);
    case 2:
      return cv::Point2d(size.width - 1 - x, size.height - 1 - y);
    case 3:
      return cv::Point2d(y, size.width - 1 - x);
    default:
      return cv::Point2d(x, y);
  }
}

cv::Point2d from_turned(const cv::Point2f& p, int turns, const cv::Size& size) {
  switch (turns) {
    case 1:
      return cv::Point2d(p.y, size.height - 1.0 - p.x);
    case 2:
      return cv::Point2d(size.width - 1.0 - p.x, size.height - 1.0 - p.y);
    case 3:
      return cv::Point2d(size.width - 1.0 - p.y, p.x);
    default:
      return p;
  }
}

}  // namespace

RankPatch turned(const RankPatch& patch) {
  RankPatch result{};
  for (int row = 0; row < kPatchSize; ++row)
    for (int column = 0; column < kPatchSize; ++column)
      result[row * kPatchSize + column] = patch[(kPatchSize - 1 - column) * kPatchSize + row];
  return result;
}

std::vector<std::pair<int, int>> match_corners(const ViewFeatures& prev, const ViewFeatures& cur, int turns) {
  std::vector<RankPatch> cur_patches = cur.patches;
  for (RankPatch& patch : cur_patches)
    for (int turn = 0; turn < turns; ++turn) patch = turned(patch);

  struct Best {
    int difference = std::numeric_limits<int>::max();
    int index = -1;
  };
  std::vector<Best> of_prev(prev.patches.size()), of_cur(cur_patches.size());
  for (size_t i = 0; i < prev.patches.size(); ++i) {
    for (size_t j = 0; j < cur_patches.size(); ++j) {
      const int d = difference(prev.patches[i], cur_patches[j]);
      if (d < of_prev[i].difference) of_prev[i] = {d, static_cast<int>(j)};
      if (d < of_cur[j].difference) of_cur[j] = {d, static_cast<int>(i)};
    }
  }
  std::vector<std::pair<int, int>> matches;
  for (int i = 0; i < static_cast<int>(of_prev.size()); ++i) {
    const int j = of_prev[i].index;
    if (j >= 0 && of_cur[j].index == i) matches.emplace_back(i, j);
  }
  return matches;
}

std::vector<Correspondence> refine_matches(const std::vector<std::pair<int, int>>& matches, const ViewFeatures& prev,
                                           const ViewFeatures& cur, int turns, const RectifiedCamera& camera,
                                           const ScsOptions& options) {
  std::vector<Correspondence> result;
  if (matches.empty()) return result;
  const cv::Size size = cur.image.size();
  cv::Mat prev_image = prev.image, cur_image = cur.image;
  if (turns > 0) {
    cur_image = cv::Mat();                        // its own memory: `cur` stays as it is
    cv::rotate(cur.image, cur_image, turns - 1);  // ROTATE_90_CLOCKWISE, 180, 90_COUNTERCLOCKWISE
    // Lucas-Kanade wants images of one size; what is added lies to the right and below.
    const int side = std::max({prev_image.cols, prev_image.rows, size.width, size.height});
    for (cv::Mat* image : {&prev_image, &cur_image}) {
      cv::copyMakeBorder(*image, *image, 0, side - image->rows, 0, side - image->cols, cv::BORDER_REPLICATE);
    }
  }
  std::vector<cv::Point2f> from, to, start;
  for (const auto& [i, j] : matches) {
    from.emplace_back(static_cast<float>(prev.corners[i].x), static_cast<float>(prev.corners[i].y));
    start.push_back(to_turned(cur.corners[j].x, cur.corners[j].y, turns, size));
  }
  to = start;
  std::vector<uint8_t> found;
  const cv::TermCriteria stop(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 20, 0.005);
  cv::calcOpticalFlowPyrLK(prev_image, cur_image, from, to, found, cv::noArray(), cv::Size(15, 15), 0, stop,
                           cv::OPTFLOW_USE_INITIAL_FLOW);
  for (size_t k = 0; k < matches.size(); ++k) {
    const double moved = cv::norm(to[k] - start[k]);
    if (!found[k] || !(moved <= kMaxMoved)) continue;
    const cv::Point2d at = from_turned(to[k], turns, size);
    const double disparity = usable_disparity(cur.disparity, at.x, at.y, camera, options);
    if (disparity == 0) continue;
    result.push_back({matches[k].first, matches[k].second, prev.corners[matches[k].first].point_in_cam,
                      camera.point(at.x, at.y, disparity), moved});
  }
  return result;
}

}  // namespace iris::motion
