#include "iris/motion/features.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <tuple>
#include <utility>

#include "corner_kernels.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/motion/corner_disparity.h"

namespace iris::motion {
namespace {

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

// The strongest of each cell first.
bool weaker(const Maximum& a, const Maximum& b) {
  return std::make_tuple(a.value, -a.y, -a.x) < std::make_tuple(b.value, -b.y, -b.x);
}

}  // namespace

RankPatch grey_patch(const cv::Mat1b& image, int x, int y) {
  IRIS_CHECK(x >= kPatchBorder && y >= kPatchBorder && x < image.cols - kPatchBorder && y < image.rows - kPatchBorder);
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
                              const RectifiedCamera& camera, const ScsOptions& options, const cv::Mat1b& right_image) {
  IRIS_CHECK(left_image.size() == disparity.disparity.size() && left_image.size() == disparity.origin.size());
  ViewFeatures features{
      .image = left_image, .right = right_image, .disparity = disparity, .corners = {}, .patches = {}};
  const int width = left_image.cols, height = left_image.rows;
  const cv::Mat1f response = harris_response(left_image);
  const int columns = options.grid_columns;
  const int rows = std::max(1, static_cast<int>(std::lround(static_cast<double>(columns) * height / width)));
  std::vector<std::vector<Maximum>> cells(static_cast<size_t>(rows) * columns);
  for (const Maximum& m : local_maxima(response, static_cast<float>(options.min_strength), kPatchBorder)) {
    cells[static_cast<size_t>(m.y * rows / height) * columns + m.x * columns / width].push_back(m);
  }
  for (std::vector<Maximum>& cell : cells) std::make_heap(cell.begin(), cell.end(), weaker);
  const auto usable_corner = [&](const Maximum& m) {
    const Eigen::Vector2d offset = surface_maximum(response, m.x, m.y);
    Corner corner{.x = m.x + offset.x(), .y = m.y + offset.y(), .strength = m.value};
    corner.disparity = usable_disparity(disparity, corner.x, corner.y, camera, options);
    return corner;
  };

  // Every cell gives its strongest usable corner, then every cell its second strongest, and so on.
  std::vector<Maximum> chosen;
  const size_t count = static_cast<size_t>(options.max_corners);
  for (bool more = true; more && chosen.size() < count;) {
    std::vector<std::pair<Maximum, Corner>> given;
    for (std::vector<Maximum>& cell : cells) {
      while (!cell.empty()) {
        std::pop_heap(cell.begin(), cell.end(), weaker);
        const Maximum maximum = cell.back();
        cell.pop_back();
        const Corner corner = usable_corner(maximum);
        if (corner.disparity == 0) continue;
        given.emplace_back(maximum, corner);
        break;
      }
    }
    more = !given.empty();
    std::sort(given.begin(), given.end(), [](const auto& a, const auto& b) { return weaker(b.first, a.first); });
    if (given.size() > count - chosen.size()) given.resize(count - chosen.size());
    for (auto& [maximum, corner] : given) {
      corner.point_in_cam = camera.point(corner.x, corner.y, corner.disparity);
      chosen.push_back(maximum);
      features.corners.push_back(corner);
    }
  }
  measure_disparities(features, camera);

  constexpr int kPatchesPerChunk = 64;
  const bool rank = options.compare == "rank";
  const cv::Mat1b compared = rank ? left_image : laplacian_of_gaussian(left_image);
  features.patches.resize(chosen.size());
  parallel_chunks(0, static_cast<int>(chosen.size()), kPatchesPerChunk, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      features.patches[i] = (rank ? rank_patch : grey_patch)(compared, chosen[i].x, chosen[i].y);
    }
  });
  return features;
}

}  // namespace iris::motion
