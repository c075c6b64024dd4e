#include "rolled_matches.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <tuple>

#include "corner_kernels.h"
#include "iris/core/parallel.h"
#include "iris/motion/correspondences.h"

namespace iris::motion {
namespace {

constexpr int kRolls = 12;                               // steps of a full turn
constexpr int kResampled = kRolls / 4;                   // of them by resampling, the others by quarter turns of these
constexpr double kStep = 2 * std::numbers::pi / kRolls;  // [rad]
constexpr int kLevels = 3;                               // scales 1 … 1/2
constexpr int kLevelsPerOctave = 2;
constexpr size_t kMostCorners = 400;  // the first ones are the strongest, and spread over the image

// Patches of all corners at one scale and roll.
std::vector<RankPatch> resampled_patches(const ViewFeatures& view, int level, double roll, const ScsOptions& options) {
  const double scale = std::exp2(-static_cast<double>(level) / kLevelsPerOctave);
  const double c = scale * std::cos(roll), s = scale * std::sin(roll);
  const double width = view.image.cols - 1, height = view.image.rows - 1;
  // The turned image's box, with room for the patches of corners at its edges.
  constexpr int kRoom = kPatchBorder + 2;
  const double left = std::min({0.0, c * width, -s * height, c * width - s * height});
  const double right = std::max({0.0, c * width, -s * height, c * width - s * height});
  const double top = std::min({0.0, s * width, c * height, s * width + c * height});
  const double bottom = std::max({0.0, s * width, c * height, s * width + c * height});
  const cv::Matx23d to(c, -s, kRoom - left, s, c, kRoom - top);  // clockwise: x right, y down
  const cv::Size size(static_cast<int>(std::ceil(right - left)) + 2 * kRoom,
                      static_cast<int>(std::ceil(bottom - top)) + 2 * kRoom);
  cv::Mat1b source = view.image, turned_image;
  if (level > 0) {
    cv::Mat1b smooth;  // the view's image stays as it is
    cv::GaussianBlur(source, smooth, {}, 0.5 * std::sqrt(1 / (scale * scale) - 1));
    source = smooth;
  }
  cv::warpAffine(source, turned_image, to, size, cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  const bool rank = options.compare == "rank";
  if (!rank) turned_image = laplacian_of_gaussian(turned_image);
  std::vector<RankPatch> patches;
  const size_t count = std::min(kMostCorners, view.corners.size());
  patches.reserve(count);
  for (size_t i = 0; i < count; ++i) {
    const Corner& corner = view.corners[i];
    const int x = static_cast<int>(std::lround(to(0, 0) * corner.x + to(0, 1) * corner.y + to(0, 2)));
    const int y = static_cast<int>(std::lround(to(1, 0) * corner.x + to(1, 1) * corner.y + to(1, 2)));
    patches.push_back((rank ? rank_patch : grey_patch)(turned_image, x, y));
  }
  return patches;
}

// Indices of the corners in each step of depth; a step is one level of scale.
std::map<int, std::vector<int>> by_depth(const std::vector<Corner>& corners) {
  std::map<int, std::vector<int>> steps;
  for (int i = 0; i < static_cast<int>(std::min(kMostCorners, corners.size())); ++i) {
    const double depth = corners[i].point_in_cam.z();
    steps[static_cast<int>(std::lround(kLevelsPerOctave * std::log2(depth)))].push_back(i);
  }
  return steps;
}

struct Best {
  int difference = std::numeric_limits<int>::max();
  int index = -1, roll = -1;

  bool operator<(const Best& other) const {
    return std::tie(difference, index, roll) < std::tie(other.difference, other.index, other.roll);
  }
};

// Of every corner the most similar one of the other view, at one roll.
struct BestMatches {
  std::vector<Best> of_prev, of_cur;

  BestMatches(size_t prev, size_t cur) : of_prev(prev), of_cur(cur) {}
  void add(const BestMatches& other) {
    for (size_t i = 0; i < of_prev.size(); ++i) of_prev[i] = std::min(of_prev[i], other.of_prev[i]);
    for (size_t j = 0; j < of_cur.size(); ++j) of_cur[j] = std::min(of_cur[j], other.of_cur[j]);
  }
  std::vector<RolledMatch> mutual() const {
    std::vector<RolledMatch> matches;
    for (int i = 0; i < static_cast<int>(of_prev.size()); ++i) {
      const auto& [difference, j, roll] = of_prev[i];
      if (j >= 0 && of_cur[j].index == i && of_cur[j].roll == roll) matches.push_back({i, j, roll * kStep});
    }
    return matches;
  }
};

std::vector<RankPatch> part(const std::vector<RankPatch>& patches, const std::vector<int>& indices) {
  std::vector<RankPatch> result;
  result.reserve(indices.size());
  for (const int i : indices) result.push_back(patches[i]);
  return result;
}

}  // namespace

std::vector<RolledMatches> rolled_matches(const ViewFeatures& prev, const ViewFeatures& cur, const ScsOptions& options,
                                          int groups) {
  std::array<std::vector<RankPatch>, kLevels> of_prev;
  std::array<std::array<std::vector<RankPatch>, kResampled>, kLevels> of_cur;
  parallel_chunks(0, kLevels * (1 + kResampled), 1, [&](int begin, int end) {
    for (int k = begin; k < end; ++k) {
      const int level = k / (1 + kResampled), roll = k % (1 + kResampled) - 1;
      if (roll < 0) {
        of_prev[level] = level == 0 ? prev.patches : resampled_patches(prev, level, 0, options);
      } else {
        of_cur[level][roll] = level + roll == 0 ? cur.patches : resampled_patches(cur, level, roll * kStep, options);
      }
    }
  });

  const auto prev_steps = by_depth(prev.corners), cur_steps = by_depth(cur.corners);
  std::vector<BestMatches> at(kRolls, BestMatches(prev.corners.size(), cur.corners.size()));
  parallel_chunks(0, kRolls, 1, [&](int begin, int end) {
    for (int roll = begin; roll < end; ++roll) {
      for (int level_of_cur = 0; level_of_cur < kLevels; ++level_of_cur) {
        std::vector<RankPatch> turned_patches = of_cur[level_of_cur][roll % kResampled];
        for (RankPatch& patch : turned_patches)
          for (int turn = 0; turn < roll / kResampled; ++turn) patch = turned(patch);
        for (const auto& [cur_step, cur_indices] : cur_steps) {
          const std::vector<RankPatch> cur_part = part(turned_patches, cur_indices);
          for (const auto& [prev_step, prev_indices] : prev_steps) {
            // The one that is nearer is shrunk until both are as large.
            const int nearer = prev_step - cur_step;
            if (std::max(0, nearer) != level_of_cur || -nearer >= kLevels) continue;
            const NearestPatches nearest = nearest_patches(part(of_prev[std::max(0, -nearer)], prev_indices), cur_part);
            for (size_t i = 0; i < prev_indices.size(); ++i) {
              const auto [difference, j] = nearest.of_a[i];
              Best& best = at[roll].of_prev[prev_indices[i]];
              best = std::min(best, Best{difference, cur_indices[j], roll});
            }
            for (size_t j = 0; j < cur_indices.size(); ++j) {
              const auto [difference, i] = nearest.of_b[j];
              Best& best = at[roll].of_cur[cur_indices[j]];
              best = std::min(best, Best{difference, prev_indices[i], roll});
            }
          }
        }
      }
    }
  });

  BestMatches of_all(prev.corners.size(), cur.corners.size());
  for (const BestMatches& matches : at) of_all.add(matches);
  std::array<int, kRolls> votes{};
  for (const RolledMatch& match : of_all.mutual()) ++votes[static_cast<size_t>(std::lround(match.roll / kStep))];
  const auto neighbour = [](int roll, int step) { return (roll + step + kRolls) % kRolls; };
  std::array<int, kRolls> order{}, support{};
  for (int roll = 0; roll < kRolls; ++roll) {
    order[roll] = roll;
    support[roll] = votes[neighbour(roll, -1)] + 2 * votes[roll] + votes[neighbour(roll, 1)];
  }
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return support[a] > support[b]; });
  std::vector<RolledMatches> result;
  for (int k = 0; k < std::min(groups, kRolls); ++k) {
    BestMatches matches = at[order[k]];
    for (const int step : {-1, 1}) matches.add(at[neighbour(order[k], step)]);
    result.push_back({order[k] * kStep, matches.mutual()});
  }
  return result;
}

}  // namespace iris::motion
