#include "iris/motion/features.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "iris/core/error.h"

namespace iris::motion {
namespace {

constexpr int kBorder = kPatchSize / 2 + kRankWindow / 2;  // a corner nearer to the image's edge has no full patch

struct Candidate {
  Corner corner;
  int x = 0, y = 0;  // pixel of the strongest response
  int cell = 0;
};

// Maximum of the quadratic surface that fits the 3x3 responses best; offset of at most half a pixel each way.
Eigen::Vector2d surface_maximum(const cv::Mat1f& response, int x, int y) {
  double r[3][3];
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i) r[j][i] = response(y + j - 1, x + i - 1);
  const double left = r[0][0] + r[1][0] + r[2][0], right = r[0][2] + r[1][2] + r[2][2];
  const double top = r[0][0] + r[0][1] + r[0][2], bottom = r[2][0] + r[2][1] + r[2][2];
  const double centre_column = r[0][1] + r[1][1] + r[2][1], centre_row = r[1][0] + r[1][1] + r[1][2];
  const double dx = (right - left) / 6, dy = (bottom - top) / 6;
  const double dxx = (left - 2 * centre_column + right) / 3, dyy = (top - 2 * centre_row + bottom) / 3;
  const double dxy = (r[0][0] + r[2][2] - r[0][2] - r[2][0]) / 4;
  const double det = dxx * dyy - dxy * dxy;
  if (!(dxx < 0) || !(det > 0)) return {0, 0};
  const Eigen::Vector2d offset((dxy * dy - dyy * dx) / det, (dxy * dx - dxx * dy) / det);
  return {std::clamp(offset.x(), -0.5, 0.5), std::clamp(offset.y(), -0.5, 0.5)};
}

bool is_maximum(const cv::Mat1f& response, int x, int y) {
  const float r = response(y, x);
  const float *above = response[y - 1] + x, *here = response[y] + x, *below = response[y + 1] + x;
  // Of equal neighbours the first in reading order wins.
  return r > above[-1] && r > above[0] && r > above[1] && r > here[-1] && r >= here[1] && r >= below[-1] &&
         r >= below[0] && r >= below[1];
}

// Every cell gives its strongest, then every cell its second strongest, and so on until there are `count`.
void spread(std::vector<Candidate>& candidates, int cells, int count) {
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const Candidate& a, const Candidate& b) { return a.corner.strength > b.corner.strength; });
  if (static_cast<int>(candidates.size()) <= count) return;
  std::vector<int> taken(cells, 0);
  std::vector<std::pair<int, int>> order;  // place in its cell, index
  for (int i = 0; i < static_cast<int>(candidates.size()); ++i) order.emplace_back(taken[candidates[i].cell]++, i);
  std::sort(order.begin(), order.end());
  std::vector<Candidate> chosen;
  for (int i = 0; i < count; ++i) chosen.push_back(candidates[order[i].second]);
  candidates = std::move(chosen);
}

}  // namespace

cv::Mat1f harris_response(const cv::Mat1b& image) {
  constexpr double kSigma = 2.0;
  constexpr float kKappa = 0.04f;
  cv::Mat1f dx, dy;
  cv::Sobel(image, dx, CV_32F, 1, 0, 3, 1.0 / 8);
  cv::Sobel(image, dy, CV_32F, 0, 1, 3, 1.0 / 8);
  cv::Mat1f xx = dx.mul(dx), xy = dx.mul(dy), yy = dy.mul(dy);
  const cv::Size window(11, 11);
  for (cv::Mat1f* m : {&xx, &xy, &yy}) cv::GaussianBlur(*m, *m, window, kSigma);
  cv::Mat1f response(image.size());
  for (int y = 0; y < image.rows; ++y) {
    const float *a = xx[y], *b = xy[y], *c = yy[y];
    float* out = response[y];
    for (int x = 0; x < image.cols; ++x) {
      const float trace = a[x] + c[x];
      out[x] = a[x] * c[x] - b[x] * b[x] - kKappa * trace * trace;
    }
  }
  return response;
}

RankPatch rank_patch(const cv::Mat1b& image, int x, int y) {
  IRIS_CHECK(x >= kBorder && y >= kBorder && x < image.cols - kBorder && y < image.rows - kBorder);
  constexpr int kSpan = 2 * kBorder + 1;  // pixels that take part
  constexpr int kWidth = 32;              // a whole number of vector registers; columns beyond the patch are ignored
  uint8_t pixels[kSpan][kWidth + kRankWindow + 5] = {};
  for (int j = 0; j < kSpan; ++j) std::copy_n(image[y - kBorder + j] + x - kBorder, kSpan, pixels[j]);
  RankPatch patch{};
  for (int j = 0; j < kPatchSize; ++j) {
    uint8_t rank[kWidth] = {};
    const uint8_t* centre = pixels[j + kRankWindow / 2] + kRankWindow / 2;
    for (int v = 0; v < kRankWindow; ++v) {
      for (int u = 0; u < kRankWindow; ++u) {
        const uint8_t* other = pixels[j + v] + u;
        for (int i = 0; i < kWidth; ++i) rank[i] = static_cast<uint8_t>(rank[i] + (other[i] < centre[i] ? 1 : 0));
      }
    }
    std::copy_n(rank, kPatchSize, patch.begin() + j * kPatchSize);
  }
  return patch;
}

RankPatch grey_patch(const cv::Mat1b& image, int x, int y) {
  IRIS_CHECK(x >= kBorder && y >= kBorder && x < image.cols - kBorder && y < image.rows - kBorder);
  RankPatch patch{};
  for (int j = 0; j < kPatchSize; ++j) {
    std::copy_n(image[y - kPatchSize / 2 + j] + x - kPatchSize / 2, kPatchSize, patch.begin() + j * kPatchSize);
  }
  return patch;
}

cv::Mat1b laplacian_of_gaussian(const cv::Mat1b& image) {
  constexpr double kGain = 8;
  cv::Mat1f smooth, filtered;
  image.convertTo(smooth, CV_32F);
  cv::GaussianBlur(smooth, smooth, {}, 1.0);
  cv::Laplacian(smooth, filtered, CV_32F);
  cv::Mat1b result;
  filtered.convertTo(result, CV_8U, kGain, 128);
  return result;
}

double usable_disparity(const DisparityImage& disparity, double x, double y, const RectifiedCamera& camera,
                        const ScsOptions& options) {
  const int xi = static_cast<int>(std::lround(x)), yi = static_cast<int>(std::lround(y));
  if (xi < 1 || yi < 1 || xi + 1 >= disparity.disparity.cols || yi + 1 >= disparity.disparity.rows) return 0;
  for (int v = -1; v <= 1; ++v)
    for (int u = -1; u <= 1; ++u)
      if (!(disparity.at(yi + v, xi + u, DisparityOrigin::corrected) > 0)) return 0;
  const int x0 = static_cast<int>(std::floor(x)), y0 = static_cast<int>(std::floor(y));  // within 1 px of (xi, yi)
  const double d00 = disparity.disparity(y0, x0), d01 = disparity.disparity(y0, x0 + 1);
  const double d10 = disparity.disparity(y0 + 1, x0), d11 = disparity.disparity(y0 + 1, x0 + 1);
  const double fx = x - x0, fy = y - y0;
  const bool continuous = std::max({d00, d01, d10, d11}) - std::min({d00, d01, d10, d11}) <= 1;
  const double d = continuous ? (1 - fy) * ((1 - fx) * d00 + fx * d01) + fy * ((1 - fx) * d10 + fx * d11)
                              : static_cast<double>(disparity.disparity(yi, xi));
  return d + camera.disparity_offset >= options.min_disparity ? d : 0;
}

ViewFeatures extract_features(const cv::Mat1b& left_image, const DisparityImage& disparity,
                              const RectifiedCamera& camera, const ScsOptions& options) {
  IRIS_CHECK(left_image.size() == disparity.disparity.size() && left_image.size() == disparity.origin.size());
  ViewFeatures features{.image = left_image, .disparity = disparity, .corners = {}, .patches = {}};
  const int width = left_image.cols, height = left_image.rows;
  if (width <= 2 * kBorder || height <= 2 * kBorder) return features;
  const cv::Mat1f response = harris_response(left_image);
  const int columns = options.grid_columns;
  const int rows = std::max(1, static_cast<int>(std::lround(static_cast<double>(columns) * height / width)));
  std::vector<Candidate> candidates;
  for (int y = kBorder; y < height - kBorder; ++y) {
    for (int x = kBorder; x < width - kBorder; ++x) {
      if (response(y, x) < options.min_strength || !is_maximum(response, x, y)) continue;
      const Eigen::Vector2d offset = surface_maximum(response, x, y);
      Corner corner{.x = x + offset.x(), .y = y + offset.y(), .strength = response(y, x)};
      corner.disparity = usable_disparity(disparity, corner.x, corner.y, camera, options);
      if (corner.disparity == 0) continue;
      corner.point_in_cam = camera.point(corner.x, corner.y, corner.disparity);
      candidates.push_back({corner, x, y, y * rows / height * columns + x * columns / width});
    }
  }
  spread(candidates, rows * columns, options.max_corners);
  const bool rank = options.compare == "rank";
  const cv::Mat1b compared = rank ? left_image : laplacian_of_gaussian(left_image);
  for (const Candidate& candidate : candidates) {
    features.corners.push_back(candidate.corner);
    features.patches.push_back((rank ? rank_patch : grey_patch)(compared, candidate.x, candidate.y));
  }
  return features;
}

}  // namespace iris::motion
