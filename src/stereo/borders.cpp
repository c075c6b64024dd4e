#include "borders.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
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

// 0 where a pixel and the one before it are valid and no step, else 1. In a form that compilers turn into vectors.
void find_changes(const float* __restrict disparity, int width, float min_step, uint8_t* __restrict changes) {
  changes[0] = 1;
  for (int x = 1; x < width; ++x) {
    const float before = disparity[x - 1], after = disparity[x];
    changes[x] = (before > 0) & (after > 0) & (std::abs(after - before) < min_step) ? 0 : 1;
  }
}

// Steps of at least `min_step` in one row; `changes` is as long.
void find_steps(const float* disparity, int width, float min_step, std::vector<uint8_t>& changes,
                std::vector<Step>& steps) {
  find_changes(disparity, width, min_step, changes.data());
  steps.clear();
  float before = 0;  // disparity of the valid pixel to the left
  int begin = 0;     // of the invalid run behind it
  for (int x = 0; x < width; ++x) {
    if (changes[x] == 0) {
      const void* const next = std::memchr(&changes[x], 1, width - x);
      if (next == nullptr) return;
      x = static_cast<int>(static_cast<const uint8_t*>(next) - changes.data());
      before = disparity[x - 1];
      begin = x;
    }
    const float after = disparity[x];
    if (!(after > 0)) continue;
    // The invalid run belongs to the lower side: the border stands at the end that touches the higher one.
    if (before > 0 && std::abs(after - before) >= min_step)
      steps.push_back({before < after ? x : begin, before, after});
    before = after;
    begin = x + 1;
  }
}

// The rows of both images that take part in the borders of one row, and what they say.
class Rows {
 public:
  Rows(int width, const BorderParameters& p)
      : width_(width), p_(p), left_(p.rows), right_(p.rows), with_before_(padded(p)), with_after_(padded(p)) {}

  // Images continue with their border rows.
  void move_to(const cv::Mat1b& left, const cv::Mat1b& right, int y) {
    for (int i = 0; i < p_.rows; ++i) {
      const int row = std::clamp(y - p_.rows / 2 + i, 0, left.rows - 1);
      left_[i] = left[row];
      right_[i] = right[row];
    }
  }

  // The new place of a border, at most `reach` away and inside [low, high].
  int place(const Step& step, int low, int high) {
    const int d_before = static_cast<int>(std::lround(step.before));
    const int d_after = static_cast<int>(std::lround(step.after));
    const int begin = std::max(low, step.x - p_.reach), end = std::min(high, step.x + p_.reach);
    // The image in which both sides are adjacent: with u for its columns and a border at u = x - shift, the pixels
    // before the border are explained by the disparity `before`, those from it on by `after`.
    const bool left_border = d_after > d_before;
    const int shift = left_border ? d_after : 0;
    const bool support = p_.criterion == BorderCriterion::support;
    // `halves` looks at the `half` columns on either side of the border as well.
    const int half = support ? 0 : p_.reach + 1;
    const int u0 = begin - half - shift, columns = end - begin + 2 * half;
    explain(u0, d_before, left_border, columns, with_before_.data());
    explain(u0, d_after, left_border, columns, with_after_.data());
    int best = step.x, lowest = -1;
    const auto consider = [&](int x, int value) {  // of equal places the one next to where the border was
      if (lowest < 0 || value < lowest || (value == lowest && std::abs(x - step.x) < std::abs(best - step.x))) {
        best = x;
        lowest = value;
      }
    };
    // before: sum over the columns that are explained by `before`; after: by `after`.
    int before = 0, after = 0;
    for (int i = 0; i < half; ++i) before += with_before_[i];
    for (int i = half; i < (support ? columns : 2 * half); ++i) after += with_after_[i];
    for (int i = 0; begin + i <= end; ++i) {
      consider(begin + i, support ? before + after : std::abs(before - after));
      if (begin + i == end) break;
      before += with_before_[half + i] - (support ? 0 : with_before_[i]);
      after += (support ? 0 : with_after_[2 * half + i]) - with_after_[half + i];
    }
    return best;
  }

 private:
  static constexpr int kBlock = 8;  // columns summed up together

  static size_t padded(const BorderParameters& p) { return static_cast<size_t>(4 * p.reach + 2 + kBlock); }

  // sums[i]: of the capped differences, over the rows, of column u0 + i of the image in which both sides are adjacent
  // and its partner at disparity d. Images continue with their border columns.
  void explain(int u0, int d, bool in_right, int columns, int* sums) const {
    const int x_left = in_right ? u0 + d : u0, x_right = in_right ? u0 : u0 - d;
    const int whole = (columns + kBlock - 1) / kBlock * kBlock;
    if (std::min(x_left, x_right) >= 0 && std::max(x_left, x_right) + whole <= width_) {
      for (int i = 0; i < columns; i += kBlock) explain_block(x_left + i, x_right + i, sums + i);
      return;
    }
    for (int i = 0; i < columns; ++i) {
      const int a = std::clamp(x_left + i, 0, width_ - 1), b = std::clamp(x_right + i, 0, width_ - 1);
      sums[i] = 0;
      for (int k = 0; k < p_.rows; ++k) sums[i] += std::min(p_.cap, std::abs(left_[k][a] - right_[k][b]));
    }
  }

  // kBlock columns inside of the images, in a form that compilers turn into vectors.
  void explain_block(int x_left, int x_right, int* sums) const {
    const int16_t cap = static_cast<int16_t>(std::min(p_.cap, 255));
    std::array<int16_t, kBlock> sum{};
    for (int k = 0; k < p_.rows; ++k) {
      const uint8_t* const a = left_[k] + x_left;
      const uint8_t* const b = right_[k] + x_right;
      for (int i = 0; i < kBlock; ++i) {
        const int16_t difference = static_cast<int16_t>(a[i] - b[i]);
        const int16_t magnitude = std::max<int16_t>(difference, static_cast<int16_t>(-difference));
        sum[i] = static_cast<int16_t>(sum[i] + std::min(magnitude, cap));
      }
    }
    for (int i = 0; i < kBlock; ++i) sums[i] = sum[i];
  }

  int width_;
  const BorderParameters& p_;
  std::vector<const uint8_t*> left_, right_;
  std::vector<int> with_before_, with_after_;  // what each side's disparity explains badly, a column
};

}  // namespace

void correct_borders(const cv::Mat1b& left, const cv::Mat1b& right, const BorderParameters& p, cv::Mat1f& disparity,
                     cv::Mat1b& corrected) {
  IRIS_CHECK(left.size() == right.size() && left.size() == disparity.size());
  IRIS_CHECK(p.min_step >= 1 && p.reach >= 0 && p.rows % 2 == 1 && p.rows <= 127 && p.cap >= 0);
  corrected.create(disparity.size());
  parallel_chunks(0, disparity.rows, kRowsPerChunk, [&](int y0, int y1) {
    std::vector<Step> steps;
    std::vector<uint8_t> changes(disparity.cols);
    Rows rows(disparity.cols, p);
    for (int y = y0; y < y1; ++y) {
      float* const d = disparity[y];
      uint8_t* const changed = corrected[y];
      std::fill_n(changed, disparity.cols, uint8_t{0});
      const auto set = [&](int begin, int end, float value) {
        for (int x = begin; x < end; ++x) {
          changed[x] = d[x] != value ? 255 : 0;
          d[x] = value;
        }
      };
      find_steps(d, disparity.cols, static_cast<float>(p.min_step), changes, steps);
      if (!steps.empty()) rows.move_to(left, right, y);
      for (size_t i = 0; i < steps.size(); ++i) {
        // Borders do not pass each other.
        const int low = i == 0 ? 1 : (steps[i - 1].x + steps[i].x + 1) / 2;
        const int high = i + 1 == steps.size() ? disparity.cols - 1 : (steps[i].x + steps[i + 1].x) / 2;
        const int x = rows.place(steps[i], std::min(low, steps[i].x), std::max(high, steps[i].x));
        set(x, steps[i].x, steps[i].after);
        set(steps[i].x, x, steps[i].before);
      }
    }
  });
}

}  // namespace iris::stereo
