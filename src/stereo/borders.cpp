#include "borders.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <vector>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

namespace iris::stereo {
namespace {

constexpr int kRowsPerChunk = 16;

// A step of disparity between the pixels x - 1 and x.
struct Step {
  int x;
  float before, after;  // [px]
};

// Steps of at least `min_step` in one row.
void find_steps(const float* disparity, int width, float min_step, std::vector<Step>& steps) {
  steps.clear();
  float before = 0;  // disparity of the valid pixel to the left
  int begin = 0;     // of the invalid run behind it
  for (int x = 0; x < width; ++x) {
    const float after = disparity[x];
    if (!(after > 0)) continue;
    // The invalid run belongs to the lower side: the border stands at the end that touches the higher one.
    if (before > 0 && std::abs(after - before) >= min_step)
      steps.push_back({before < after ? x : begin, before, after});
    before = after;
    begin = x + 1;
  }
}

class Row {
 public:
  Row(const cv::Mat1b& left, const cv::Mat1b& right, int y, const BorderParameters& p)
      : left_(left), right_(right), y_(y), p_(p) {}

  // Sum over the rows of the capped differences between column x_left and column x_right. Images continue with their
  // border pixels.
  int difference(int x_left, int x_right) const {
    const int a = std::clamp(x_left, 0, left_.cols - 1), b = std::clamp(x_right, 0, right_.cols - 1);
    int sum = 0;
    for (int v = y_ - p_.rows / 2; v <= y_ + p_.rows / 2; ++v) {
      const int row = std::clamp(v, 0, left_.rows - 1);
      sum += std::min(p_.cap, std::abs(left_(row, a) - right_(row, b)));
    }
    return sum;
  }

  // The new place of a border, at most `reach` away and inside [low, high].
  int place(const Step& step, int low, int high) const {
    const int d_before = static_cast<int>(std::lround(step.before));
    const int d_after = static_cast<int>(std::lround(step.after));
    const int begin = std::max(low, step.x - p_.reach), end = std::min(high, step.x + p_.reach);
    // The image in which both sides are adjacent: with u for its columns and a border at u = x - shift, the pixels
    // before the border are explained by the disparity `before`, those from it on by `after`.
    const bool left_border = d_after > d_before;
    const auto explained = [&](int u, int d) { return left_border ? difference(u + d, u) : difference(u, u - d); };
    const int shift = left_border ? d_after : 0;
    int best = step.x, lowest = -1;
    const auto consider = [&](int x, int value) {  // of equal places the one next to where the border was
      if (lowest < 0 || value < lowest || (value == lowest && std::abs(x - step.x) < std::abs(best - step.x))) {
        best = x;
        lowest = value;
      }
    };
    if (p_.criterion == BorderCriterion::support) {
      int sum = 0;
      for (int u = begin - shift; u < end - shift; ++u) sum += explained(u, d_after);
      for (int x = begin; x <= end; ++x) {
        consider(x, sum);
        sum += explained(x - shift, d_before) - explained(x - shift, d_after);
      }
    } else {
      const int half = p_.reach + 1;
      for (int x = begin; x <= end; ++x) {
        int before = 0, after = 0;
        for (int k = 0; k < half; ++k) {
          before += explained(x - shift - 1 - k, d_before);
          after += explained(x - shift + k, d_after);
        }
        consider(x, std::abs(before - after));
      }
    }
    return best;
  }

 private:
  const cv::Mat1b& left_;
  const cv::Mat1b& right_;
  int y_;
  const BorderParameters& p_;
};

}  // namespace

cv::Mat1f correct_borders(const cv::Mat1b& left, const cv::Mat1b& right, const cv::Mat1f& disparity,
                          const BorderParameters& p) {
  IRIS_CHECK(left.size() == right.size() && left.size() == disparity.size());
  IRIS_CHECK(p.min_step >= 1 && p.reach >= 0 && p.rows % 2 == 1 && p.cap >= 0);
  cv::Mat1f out = disparity.clone();
  parallel_chunks(0, disparity.rows, kRowsPerChunk, [&](int y0, int y1) {
    std::vector<Step> steps;
    for (int y = y0; y < y1; ++y) {
      find_steps(disparity[y], disparity.cols, static_cast<float>(p.min_step), steps);
      const Row row(left, right, y, p);
      for (size_t i = 0; i < steps.size(); ++i) {
        // Borders do not pass each other.
        const int low = i == 0 ? 1 : (steps[i - 1].x + steps[i].x + 1) / 2;
        const int high = i + 1 == steps.size() ? disparity.cols - 1 : (steps[i].x + steps[i + 1].x) / 2;
        const int x = row.place(steps[i], std::min(low, steps[i].x), std::max(high, steps[i].x));
        std::fill(out[y] + std::min(x, steps[i].x), out[y] + steps[i].x, steps[i].after);
        std::fill(out[y] + steps[i].x, out[y] + std::max(x, steps[i].x), steps[i].before);
      }
    }
  });
  return out;
}

}  // namespace iris::stereo
