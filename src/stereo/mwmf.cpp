#include "iris/stereo/mwmf.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <utility>
#include <vector>

#include "borders.h"
#include "comparison.h"
#include "correlation.h"
#include "filters.h"
#include "interpolation.h"
#include "iris/core/error.h"
#include "log_filter.h"
#include "median.h"
#include "plane_fill.h"
#include "semi_global.h"

namespace iris::stereo {
namespace {

// The value that stands beside `text` in a table.
template <class Value>
Value parse(const std::string& text, std::initializer_list<std::pair<const char*, Value>> table) {
  for (const auto& [name, value] : table) {
    if (text == name) return value;
  }
  IRIS_CHECK(!"a choice that the options do not offer");
  std::abort();
}

// How pixels are compared, in numbers.
struct Comparison {
  bool log = false;     // grey values are filtered
  bool census = false;  // census bits count
  bool rank = false;    // grey values are replaced by their rank among their neighbours
  Measure measure = Measure::sad;
};

Comparison comparison_of(const MwmfOptions& options) {
  Comparison c;
  const std::string& name = options.measure;
  c.measure = parse<Measure>(name, {{"sad", Measure::sad},
                                    {"census_sad", Measure::sad},
                                    {"census", Measure::sad},
                                    {"rank", Measure::sad},
                                    {"ssd", Measure::ssd},
                                    {"ncc", Measure::ncc}});
  c.census = name == "census" || name == "census_sad";
  c.rank = name == "rank";
  c.log = options.log_sigma > 0 && !c.rank && name != "census";
  return c;
}

// Correlation with multiple windows (3.4.2). The rows go to next(y0, rows, smallest margin of the winner [cost units]),
// from several threads at once.
void match(const cv::Mat1b& left, const cv::Mat1b& right, const MwmfOptions& options,
           const std::function<void(int, Correlation&, int)>& next) {
  const Comparison comparison = comparison_of(options);
  const auto prepare = [&](const cv::Mat1b& image) {
    MatchImage out{image, comparison.census || comparison.rank ? census_transform(image) : Census()};
    if (comparison.log) out.grey = log_filter(image, options.log_sigma);
    if (comparison.rank) out = {rank_transform(out.census), {}};
    return out;
  };
  ComparisonParameters parameters;
  CorrelationParameters& p = parameters.correlation;
  p.disparities = options.disparities;
  p.min_disparity = options.min_disparity;
  p.window_width = options.window_width | 1;
  p.window_height = options.window_height | 1;
  parameters.measure = comparison.measure;
  parameters.windows = options.windows;
  parameters.cut = options.cut_windows;
  const bool fast = comparison.measure == Measure::sad && options.windows == 5 && options.cut_windows;
  const int max_cap = fast                ? largest_cap(p.window_width, p.window_height, comparison.census)
                      : comparison.census ? (255 - 24 * kCensusWeight) / kGreyWeight
                                          : 255;
  IRIS_CHECK(max_cap >= 0);
  const double units = comparison.log ? kLogUnits : 1;  // of the compared images per grey level
  const double cap = options.difference_cap > 0 ? options.difference_cap * units : max_cap;
  p.cap = options.measure == "census" ? 0 : static_cast<int>(std::lround(std::min<double>(cap, max_cap)));

  if (fast && !comparison.census) p.shift = shift_for_bytes(p.window_width, p.window_height, p.cap);

  // The margin in the same units as the costs.
  double margin = options.min_margin * windows_in_cost(options.windows);
  if (comparison.measure == Measure::ncc) {
    margin *= kNccUnits;
  } else {
    margin *= p.window_width * p.window_height * (comparison.measure == Measure::ssd ? units * units : units);
    if (comparison.census) margin *= kGreyWeight;
    margin /= 1 << (fast ? p.shift : cost_shift(parameters, comparison.census));
  }
  const MatchImage a = prepare(left), b = prepare(right);
  const int min_margin = static_cast<int>(std::lround(margin));
  if (fast) {
    correlate(a, b, p, [&](int y0, Correlation& rows) { next(y0, rows, min_margin); });
  } else {
    Correlation all = compare(a, b, parameters);
    next(0, all, min_margin);
  }
}

// Correlation and what follows it up to sub-pixel disparities.
cv::Mat1f measure_disparities(const cv::Mat1b& left, const cv::Mat1b& right, const MwmfOptions& options) {
  // Sub-pixel disparities (3.4.1).
  const bool equalised = options.sub_pixel == "equalised";
  const auto fit = parse<SubPixel>(equalised ? "v" : options.sub_pixel,
                                   {{"off", SubPixel::off}, {"parabola", SubPixel::parabola}, {"v", SubPixel::v}});
  cv::Mat1w winner(left.size());
  cv::Mat1f disparity(left.size());
  match(left, right, options, [&](int y0, Correlation& rows, int min_margin) {
    // Filters (3.4.3, 3.4.1); nothing else needs the winners as they were.
    if (min_margin > 0) reject_ambiguous(rows, min_margin, rows.winner);
    if (options.left_right_tolerance >= 0) {
      reject_one_sided(rows.right_winner, options.min_disparity, options.left_right_tolerance, rows.winner);
    }
    if (options.reject_outermost) reject_outermost(options.min_disparity, rows.winner);
    const cv::Range of_image(y0, y0 + rows.winner.rows);
    if (equalised) rows.winner.copyTo(winner.rowRange(of_image));
    refine(rows, rows.winner, options.min_disparity, fit, kSmallestDisparity, disparity.rowRange(of_image));
  });
  if (equalised) equalise(winner, options.min_disparity, disparity);
  return disparity;
}

}  // namespace

void MwmfOptions::declare(OptionSet& set) {
  set.section("stereo");
  set.add_preset(
      "preset", preset, {"thesis", "default", "quality"}, [this] { apply_preset(); },
      "Values for all options of this section from 'method' on; what is given beside it wins. thesis = the "
      "method as Hirschmueller's thesis describes it; default = the same steps with what measurements have "
      "shown to be better; quality = fewer errors, slower.");
  set.add("disparities", disparities, "px", 0, 512,
          "Number of disparities searched. Near objects need more: nearest distance = focal length * baseline / "
          "disparities. 0 = found from the recording.");
  set.add("min_disparity", min_disparity, "px", -256, 256,
          "First disparity searched. Other than 0 only if the cameras squint or nothing is far away.");
  set.add("interpolation", interpolation, {"off", "within", "everywhere"},
          "Filling of gaps: off; within = inside of surfaces only; everywhere = between surfaces as well, from the "
          "farther one. What was measured stays marked as measured in every case.");
  set.add("method", method, {"mwmf", "sgbm"},
          "mwmf = correlation with multiple windows; sgbm = OpenCV's semi-global matching in its place (blocks of "
          "window_height x window_height), followed by the same steps from the correction of borders on.");
  set.add("measure", measure, {"sad", "census_sad", "census", "rank", "ssd", "ncc"},
          "How pixels are compared: sad = absolute differences of grey values; census = by which of their neighbours "
          "are darker; census_sad = both, fewer wrong matches but slower; rank, ssd and ncc for comparison.");
  set.add("windows", windows, "", 1, 25,
          "Correlation windows around each pixel: 1, or 5, 9, 25 of which the best support the middle one. Other "
          "numbers than 5 are for comparison, and slow.");
  set.add("window_width", window_width, "px", 1, 13,
          "Width of the correlation windows, odd. Larger: fewer wrong matches, coarser borders of objects.");
  set.add("window_height", window_height, "px", 1, 13, "Height of the correlation windows, odd.");
  set.add(
      "log_sigma", log_sigma, "px", 0, 5,
      "Laplacian of Gaussian before grey values are compared; removes differences of brightness between the cameras. "
      "0 = off (then difference_cap should be about 15).");
  set.add(
      "difference_cap", difference_cap, "grey levels", 0, 255,
      "Largest difference of grey values that one pixel contributes, so that pixels of another surface in the window "
      "count little. 0 = the largest that the arithmetic allows.");
  set.add("cut_windows", cut_windows,
          "Windows that reach beyond an image are cut; false = pixels whose windows do so get no disparity, and the "
          "search is slower.");
  set.add("min_margin", min_margin, "grey levels per window pixel", 0, 100,
          "A match is ambiguous, and rejected, if another disparity fits nearly as well: worse by less than this. "
          "0 = keep all.");
  set.add("left_right_tolerance", left_right_tolerance, "px", -1, 512,
          "A match is rejected if searching from the right image gives a disparity that differs by more than this. "
          "Negative = off.");
  set.add("reject_outermost", reject_outermost,
          "Rejects matches with the outermost column of the right image: mostly of pixels that the right camera does "
          "not see.");
  set.add("sub_pixel", sub_pixel, {"off", "parabola", "v", "equalised"},
          "What is fitted to the three lowest costs for disparities finer than a pixel; equalised = v, of which the "
          "remaining pull towards whole pixels is estimated over the image and taken out.");
  set.add("borders", borders, {"off", "halves", "support"},
          "Correction of the left and right borders of objects: halves = where both halves of a window fit equally "
          "well, as in the thesis; support = where every pixel is explained best by its side.");
  set.add("border_reach", border_reach, "px", 0, 32, "By how much the border of an object may be moved.");
  set.add("border_rows", border_rows, "px", 1, 15,
          "Rows above and below that take part in the correction of a border, odd.");
  set.add("min_segment", min_segment, "px", 0, 100000,
          "Connected areas of similar disparity smaller than this are taken for errors. 0 = keep all.");
  set.add("segment_tolerance", segment_tolerance, "px", 0, 16,
          "Neighbouring pixels belong to one surface if their disparities differ by at most this.");
  set.add("gaps", gaps, {"smallest", "second_smallest"},
          "Which of its four neighbours fills a gap between surfaces: the smallest disparity, as in the thesis, or the "
          "second smallest, which forgives one wrong neighbour.");
  set.add(
      "extrapolation", extrapolation, {"parallel", "plane"},
      "How a surface goes on in large gaps: parallel = at the disparity of its border, as in the thesis; plane = on "
      "the plane through its disparities next to the gap, where they lie on one.");
  set.add("left_from_right", left_from_right,
          "The strip at the left edge, which the right camera does not see, continues its right neighbour.");
  set.add("hidden_strips", hidden_strips,
          "A gap about as wide as the step of disparity at its right end is hidden from the right camera: it continues "
          "the background at its left.");
  set.add("median", median, {"off", "plain", "guided"},
          "Last step: a plain 5x5 median; or, next to steps of disparity, one in which pixels of similar grey value "
          "count most, so that borders of objects follow the image.");
}

void MwmfOptions::apply_preset() {
  MwmfOptions defaults;
  defaults.preset = preset;
  defaults.disparities = disparities;
  defaults.min_disparity = min_disparity;
  defaults.interpolation = interpolation;
  *this = defaults;
  if (preset == "thesis") {
    window_height = 9;
    log_sigma = 0;
    difference_cap = 0;
    cut_windows = false;
    min_margin = 0.045;
    reject_outermost = false;
    sub_pixel = "parabola";
    borders = "halves";
    border_reach = 3;
    border_rows = 3;
    min_segment = 100;
    gaps = "smallest";
    left_from_right = false;
    hidden_strips = false;
    median = "off";
  } else if (preset == "quality") {
    measure = "census_sad";
    window_height = 5;
    log_sigma = 0;
    difference_cap = 15;
    min_margin = 1.5;
    border_reach = 2;
    min_segment = 100;
    extrapolation = "plane";
  }
}

DisparityImage mwmf(const cv::Mat1b& left, const cv::Mat1b& right, const MwmfOptions& options) {
  IRIS_CHECK(options.disparities > 0);
  IRIS_CHECK(!left.empty() && left.size() == right.size());
  cv::Mat1f disparity = options.method == "sgbm"
                            ? semi_global(left, right, options.disparities, options.min_disparity,
                                          options.window_height | 1, options.left_right_tolerance, kSmallestDisparity)
                            : measure_disparities(left, right, options);
  // Borders of objects (3.4.4).
  cv::Mat1b corrected;
  if (options.borders != "off") {
    BorderParameters borders;
    borders.criterion = parse<BorderCriterion>(
        options.borders, {{"halves", BorderCriterion::halves}, {"support", BorderCriterion::support}});
    borders.reach = options.border_reach;
    borders.rows = options.border_rows | 1;
    correct_borders(left, right, borders, disparity, corrected);
  }
  // Segments and their filter (3.4.1), interpolation (3.4.5).
  Segments segments = find_segments(disparity, options.segment_tolerance);
  if (options.min_segment > 0) reject_small(options.min_segment, disparity, segments);
  InterpolationParameters interpolation;
  interpolation.mode = parse<Interpolation>(
      options.interpolation,
      {{"off", Interpolation::off}, {"within", Interpolation::within}, {"everywhere", Interpolation::everywhere}});
  interpolation.second_smallest = parse<bool>(options.gaps, {{"smallest", false}, {"second_smallest", true}});
  interpolation.left_from_right = options.left_from_right;
  interpolation.hidden_strips = options.hidden_strips;
  const bool planes = options.extrapolation == "plane" && interpolation.mode == Interpolation::everywhere;
  cv::Mat1i source;
  DisparityImage out = interpolate(disparity, corrected, segments, interpolation, planes ? &source : nullptr);
  if (planes) fill_planes(disparity, segments, source, kSmallestDisparity, {}, out);
  if (options.median == "plain") out.disparity = plain_median(out.disparity);
  if (options.median == "guided") guided_median(left, out);
  return out;
}

}  // namespace iris::stereo
