#include "iris/stereo/mwmf.h"

#include <algorithm>
#include <cmath>

#include "correlation.h"
#include "filters.h"
#include "interpolation.h"
#include "iris/core/error.h"
#include "log_filter.h"

namespace iris::stereo {
namespace {

Interpolation parse_interpolation(const std::string& text) {
  if (text == "off") return Interpolation::off;
  if (text == "within") return Interpolation::within;
  IRIS_CHECK(text == "everywhere");
  return Interpolation::everywhere;
}

}  // namespace

void MwmfOptions::declare(OptionSet& set) {
  set.section("stereo");
  set.add("disparities", disparities, "px", 0, 512,
          "Number of disparities searched. Near objects need more: nearest distance = focal length * baseline / "
          "disparities. 0 = found from the recording.");
  set.add("min_disparity", min_disparity, "px", -256, 256,
          "First disparity searched. Other than 0 only if the cameras squint or nothing is far away.");
  set.add("interpolation", interpolation, {"off", "within", "everywhere"},
          "Filling of gaps: off; within = inside of surfaces only; everywhere = between surfaces as well, from the "
          "farther one. What was measured stays marked as measured in every case.");
  set.add(
      "measure", measure, {"census", "difference"},
      "How pixels are compared: difference = by grey values alone, as in the thesis; census = also by which of their "
      "neighbours are darker: fewer wrong matches, half as much time again.");
  set.add(
      "log_sigma", log_sigma, "px", 0, 5,
      "Laplacian of Gaussian before grey values are compared; removes differences of brightness between the cameras. "
      "0 = off (then difference_cap should be about 15).");
  set.add(
      "difference_cap", difference_cap, "grey levels", 0, 255,
      "Largest difference of grey values that one pixel contributes, so that pixels of another surface in the window "
      "count little. 0 = the largest that the arithmetic allows.");
  set.add("window_width", window_width, "px", 1, 13,
          "Width of the correlation windows, odd. Larger: fewer wrong matches, coarser borders of objects.");
  set.add("window_height", window_height, "px", 1, 13, "Height of the correlation windows, odd.");
  set.add("min_margin", min_margin, "grey levels per window pixel", 0, 100,
          "A match is ambiguous, and rejected, if another disparity fits nearly as well: worse by less than this. "
          "0 = keep all.");
  set.add("left_right_tolerance", left_right_tolerance, "px", -1, 512,
          "A match is rejected if searching from the right image gives a disparity that differs by more than this. "
          "Negative = off.");
  set.add("min_segment", min_segment, "px", 0, 100000,
          "Connected areas of similar disparity smaller than this are taken for errors. 0 = keep all.");
  set.add("segment_tolerance", segment_tolerance, "px", 0, 16,
          "Neighbouring pixels belong to one surface if their disparities differ by at most this.");
}

DisparityImage mwmf(const cv::Mat1b& left, const cv::Mat1b& right, const MwmfOptions& options) {
  IRIS_CHECK(options.disparities > 0);
  IRIS_CHECK(!left.empty() && left.size() == right.size());
  const Interpolation interpolation = parse_interpolation(options.interpolation);
  const bool census = options.measure == "census";
  IRIS_CHECK(census || options.measure == "difference");
  const bool use_log = options.log_sigma > 0;

  CorrelationParameters parameters;
  parameters.disparities = options.disparities;
  parameters.min_disparity = options.min_disparity;
  parameters.window_width = options.window_width | 1;
  parameters.window_height = options.window_height | 1;
  const int max_cap = largest_cap(parameters.window_width, parameters.window_height, census);
  IRIS_CHECK(max_cap >= 0);
  const double units = use_log ? kLogUnits : 1;  // of the compared images per grey level
  const double cap = options.difference_cap > 0 ? options.difference_cap * units : max_cap;
  parameters.cap = static_cast<int>(std::lround(std::min<double>(cap, max_cap)));
  const int pixels = 3 * parameters.window_width * parameters.window_height;  // that a cost sums up
  const double weight = census ? kGreyWeight : 1;
  const int min_margin = static_cast<int>(std::lround(options.min_margin * units * weight * pixels));

  // What is compared: grey values, filtered by the Laplacian of Gaussian (3.4.1), and how they are ordered.
  const auto prepare = [&](const cv::Mat1b& image) {
    return MatchImage{use_log ? log_filter(image, options.log_sigma) : image,
                      census ? census_transform(image) : Census()};
  };
  // Correlation with multiple windows (3.4.2).
  const Correlation correlation = correlate(prepare(left), prepare(right), parameters);
  // Filters (3.4.3, 3.4.1).
  cv::Mat1w winner = correlation.winner.clone();
  if (min_margin > 0) reject_ambiguous(correlation, min_margin, winner);
  if (options.left_right_tolerance >= 0) {
    reject_one_sided(correlation.right_winner, options.min_disparity, options.left_right_tolerance, winner);
  }
  // Sub-pixel disparities (3.4.1), segments and their filter, interpolation (3.4.5).
  cv::Mat1f disparity = refine(correlation, winner, options.min_disparity, kSmallestDisparity);
  Segments segments = find_segments(disparity, options.segment_tolerance);
  if (options.min_segment > 0) reject_small(options.min_segment, disparity, segments);
  return interpolate(disparity, segments, interpolation);
}

}  // namespace iris::stereo
