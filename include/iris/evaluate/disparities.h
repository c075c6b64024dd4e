// Errors of disparity images against truth (thesis 3.5: correct, invalid, wrong at borders, wrong elsewhere).
#pragma once

#include <array>
#include <cstdint>
#include <opencv2/core.hpp>
#include <vector>

#include "iris/types/disparity_image.h"

namespace iris::evaluate {

struct DisparityOptions {
  bool round = false;       // round the estimate to whole pixels first (for truth of whole pixels, as Tsukuba's)
  int border_distance = 9;  // [px] what lies nearer to a jump of the true disparity is at a border: "within the size of
                            // a correlation window" (3.1.4, window of 9 x 9)
  double border_jump = 1;   // [px] true disparities that differ by more are a jump
};

constexpr std::array<double, 4> kBadThresholds = {0.5, 1, 2, 4};  // [px] off by more is bad

// Pixels of one region of the images.
struct RegionScore {
  int64_t known = 0;             // with truth
  int64_t valid = 0;             // of these with an estimate
  std::array<int64_t, 4> bad{};  // valid and off by more than each threshold
  int64_t outliers_kitti = 0;    // valid and off by more than 3 px and 5 %
  void add(const RegionScore& other);

  // [%] of the pixels with truth; NaN if there are none.
  double density() const;
  double wrong(size_t threshold) const;             // valid, but bad
  double wrong_or_missing(size_t threshold) const;  // bad or invalid
};

// Valid pixels that are off by at most 1 px.
struct SubpixelScore {
  int64_t valid = 0;  // all valid pixels with truth
  int64_t count = 0;
  double sum = 0, absolute_sum = 0, square_sum = 0;
  void add(double error);
  void add(const SubpixelScore& other);
  // Of the `count` pixels; NaN if there are none.
  double mean() const;      // [px] estimate - truth
  double absolute() const;  // [px]
  double rms() const;       // [px]
};

// Errors above 1 px near one kind of object border (thesis tables 3.1 and 3.2). An object is what is nearer to the
// camera; its left border is the jump on its left side.
struct BorderScore {
  int64_t possible = 0;          // pixels with truth near this kind of border: the worst case
  int64_t wrong_object = 0;      // background taken for the object (estimate too near)
  int64_t wrong_background = 0;  // object taken for background
};
enum BorderKind { kBorderLeft, kBorderRight, kBorderTop, kBorderBottom, kBorderKinds };

constexpr int kFractionBins = 10;
constexpr int kHistogramBins = 81;  // of signed errors: 0.1 px wide, centred on -4 … 4 px; the outer ones hold the rest

struct DisparityScore {
  int images = 0;
  RegionScore all;
  RegionScore visible, occluded;      // if there are occlusion masks
  RegionScore at_borders, elsewhere;  // of the discontinuity mask, or of the borders in the truth
  bool has_occlusion = false, has_discontinuity = false, has_origin = false;
  SubpixelScore subpixel;                                // all origins
  std::array<SubpixelScore, 5> by_origin;                // index: DisparityOrigin
  std::array<SubpixelScore, kFractionBins> by_fraction;  // by the fractional part of the true disparity; measured
                                                         // pixels only if origins are known (pixel locking)
  std::array<BorderScore, kBorderKinds> borders;
  std::array<int64_t, kHistogramBins> histogram{};

  void add(const DisparityScore& other);
};

// For each pixel 0, or 1 + the BorderKind of the nearest jump of the true disparity along its row (left, right) or
// column (top, bottom) if it is nearer than the options' distance; a tie goes to the first kind. Unknown pixels between
// two known ones that are closer than that distance hide no jump.
cv::Mat1b border_kinds(const cv::Mat1f& truth, const DisparityOptions& options);

// `truth` [px]: 0, negative, infinite or NaN = unknown. `occluded`, `discontinuity`: 255 = set, may be empty.
// `estimate.origin` may be empty. All images have the same size.
DisparityScore score_disparities(const DisparityImage& estimate, const cv::Mat1f& truth, const cv::Mat1b& occluded,
                                 const cv::Mat1b& discontinuity, const DisparityOptions& options);

// BGR: white where right, growing orange to dark red where too near, growing light to dark blue where too far (full at
// 4 px), black without estimate, grey without truth.
cv::Mat3b error_picture(const cv::Mat1f& estimate, const cv::Mat1f& truth, const DisparityOptions& options);

}  // namespace iris::evaluate
