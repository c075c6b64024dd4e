// Chapter 3 on the Tsukuba images: errors of plain correlation (tables 3.1 and 3.2), measures (fig. 3.10), steps
// (fig. 3.19).
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <numeric>
#include <opencv2/imgproc.hpp>

#include "iris/evaluate/disparities.h"
#include "iris/stereo/mwmf.h"
#include "support/stereo_pairs.h"
#include "support/test_data.h"
#include "thesis/sequence.h"
#include "thesis/tables.h"

namespace iris::thesis {
namespace {

using stereo::MwmfOptions;

MwmfOptions tsukuba_correlation() {
  MwmfOptions options = plain_correlation();
  options.disparities = 32;
  return options;
}

evaluate::DisparityScore score(const testing::TruthPair& pair, const MwmfOptions& options) {
  return evaluate::score_disparities(stereo::mwmf(pair.left, pair.right, options), pair.truth, {}, {}, {.round = true});
}

// Percent of the pixels with truth: wrong, wrong next to borders, invalid.
std::vector<std::string> percentages(const evaluate::DisparityScore& score) {
  const double all = static_cast<double>(score.all.known) / 100;
  return {fmt::format("{:.2f}", static_cast<double>(score.all.bad[1]) / all),
          fmt::format("{:.2f}", static_cast<double>(score.at_borders.bad[1]) / all),
          fmt::format("{:.1f}", 100 - score.all.density())};
}

void print_plain_errors(const testing::TruthPair& pair) {
  const evaluate::DisparityScore result = score(pair, tsukuba_correlation());
  const std::vector<std::string> measured = percentages(result);
  fmt::print("\n### Tables 3.1 and 3.2: LoG 1.0, SAD 9x9, left/right check\n\n");
  print_heading({"", "thesis [%]", "here [%]"});
  print_row({"wrong", "6.0", measured[0]});
  print_row({"of these at borders", "4.53", measured[1]});
  print_row({"invalid", "11", measured[2]});
  fmt::print("\n");
  print_heading({"border", "wrongly object [%]", "wrongly background [%]", "worst case [%]", "fraction [%]"});
  constexpr const char* kNames[] = {"left", "right", "top", "bottom"};
  for (size_t kind = 0; kind < evaluate::kBorderKinds; ++kind) {
    const evaluate::BorderScore& border = result.borders[kind];
    const auto percent = [&](int64_t count) {
      return 100.0 * static_cast<double>(count) / static_cast<double>(result.all.known);
    };
    print_row({kNames[kind], fmt::format("{:.2f}", percent(border.wrong_object)),
               fmt::format("{:.2f}", percent(border.wrong_background)), fmt::format("{:.2f}", percent(border.possible)),
               fmt::format("{:.1f}", 100.0 * static_cast<double>(border.wrong_object + border.wrong_background) /
                                         static_cast<double>(border.possible))});
  }
}

// Costs of single pixels for measures that the library does not offer: one image a disparity, of the left image's size.
using PixelCosts = std::vector<cv::Mat1f>;

PixelCosts pixel_costs(cv::Size size, int disparities, const std::function<int(int y, int x, int partner)>& cost) {
  PixelCosts costs;
  for (int d = 0; d < disparities; ++d) {
    cv::Mat1f of_disparity(size, 0.0f);
    for (int y = 0; y < size.height; ++y) {
      for (int x = d; x < size.width; ++x) of_disparity(y, x) = static_cast<float>(cost(y, x, x - d));
    }
    costs.push_back(of_disparity);
  }
  return costs;
}

// Whether each pixel of a window, row by row and without its middle, is darker than the middle (Zabih and Woodfill).
std::vector<bool> darker_neighbours(const cv::Mat1b& image, int y, int x, cv::Size window) {
  std::vector<bool> darker;
  for (int j = -window.height / 2; j <= window.height / 2; ++j) {
    for (int i = -window.width / 2; i <= window.width / 2; ++i) {
      if (i == 0 && j == 0) continue;
      darker.push_back(image(std::clamp(y + j, 0, image.rows - 1), std::clamp(x + i, 0, image.cols - 1)) < image(y, x));
    }
  }
  return darker;
}

PixelCosts census_costs(const testing::TruthPair& pair, cv::Size window, int disparities) {
  std::vector<std::vector<bool>> left, right;
  for (int y = 0; y < pair.left.rows; ++y) {
    for (int x = 0; x < pair.left.cols; ++x) {
      left.push_back(darker_neighbours(pair.left, y, x, window));
      right.push_back(darker_neighbours(pair.right, y, x, window));
    }
  }
  return pixel_costs(pair.left.size(), disparities, [&](int y, int x, int partner) {
    const size_t row = static_cast<size_t>(y) * pair.left.cols;
    return std::inner_product(left[row + x].begin(), left[row + x].end(), right[row + partner].begin(), 0, std::plus(),
                              std::not_equal_to());
  });
}

PixelCosts rank_costs(const testing::TruthPair& pair, cv::Size window, int disparities) {
  cv::Mat1i rank[2];
  for (const cv::Mat1b* image : {&pair.left, &pair.right}) {
    cv::Mat1i& of_image = rank[image == &pair.right];
    of_image.create(image->size());
    for (int y = 0; y < image->rows; ++y) {
      for (int x = 0; x < image->cols; ++x) {
        const std::vector<bool> darker = darker_neighbours(*image, y, x, window);
        of_image(y, x) = static_cast<int>(std::count(darker.begin(), darker.end(), true));
      }
    }
  }
  return pixel_costs(pair.left.size(), disparities,
                     [&](int y, int x, int partner) { return std::abs(rank[0](y, x) - rank[1](y, partner)); });
}

PixelCosts sad_costs(const testing::TruthPair& pair, int disparities) {
  return pixel_costs(pair.left.size(), disparities,
                     [&](int y, int x, int partner) { return std::abs(pair.left(y, x) - pair.right(y, partner)); });
}

// Sums over windows (those that lie inside of both images), of which the lowest wins; with `shifted`, the pixel stands
// in the middle, at a side or in a corner of its window, whichever is best. Then the left/right check.
DisparityImage winners(const PixelCosts& costs, cv::Size window, bool shifted) {
  const cv::Size size = costs.front().size();
  const int rx = window.width / 2, ry = window.height / 2, disparities = static_cast<int>(costs.size());
  constexpr float kNone = std::numeric_limits<float>::infinity();
  PixelCosts sums;
  for (int d = 0; d < disparities; ++d) {
    cv::Mat1f sum, best;
    cv::boxFilter(costs[d], sum, CV_32F, window, cv::Point(-1, -1), false);
    sum(cv::Rect(0, 0, d + rx, size.height)) = kNone;
    sum(cv::Rect(size.width - rx, 0, rx, size.height)) = kNone;
    sum(cv::Rect(0, 0, size.width, ry)) = kNone;
    sum(cv::Rect(0, size.height - ry, size.width, ry)) = kNone;
    best = sum.clone();
    for (int j = -ry; shifted && j <= ry; j += ry) {
      for (int i = -rx; i <= rx; i += rx) {
        const cv::Rect to = cv::Rect({}, size) & cv::Rect({-i, -j}, size);
        best(to) = cv::min(best(to), sum(to + cv::Point(i, j)));
      }
    }
    sums.push_back(best);
  }
  DisparityImage out{cv::Mat1f(size, 0.0f), cv::Mat1b(size, uint8_t{0})};
  for (int y = 0; y < size.height; ++y) {
    const auto search = [&](const auto& column, int x) {  // of the left image
      int winner = -1;
      float lowest = kNone;
      for (int d = 0; d < disparities; ++d) {
        if (column(x, d) >= size.width || !(sums[d](y, column(x, d)) < lowest)) continue;
        lowest = sums[d](y, column(x, d));
        winner = d;
      }
      return winner;
    };
    for (int x = 0; x < size.width; ++x) {
      const int d = search([](int u, int) { return u; }, x);
      if (d < 0 || std::abs(search([](int u, int k) { return u + k; }, x - d) - d) > 1) continue;
      out.disparity(y, x) = std::max(static_cast<float>(d), stereo::kSmallestDisparity);
      out.origin(y, x) = static_cast<uint8_t>(DisparityOrigin::measured);
    }
  }
  return out;
}

void print_measures(const testing::TruthPair& pair) {
  fmt::print("\n### Figure 3.10: measures, left/right check alone\n\n");
  print_heading({"measure", "LoG", "window", "wrong [%]", "at borders [%]", "invalid [%]"});
  const auto print = [&](const std::string& name, const std::string& log, cv::Size window,
                         const DisparityImage& result) {
    std::vector<std::string> row = {name, log, fmt::format("{}x{}", window.width, window.height)};
    const auto errors = evaluate::score_disparities(result, pair.truth, {}, {}, {.round = true});
    for (const std::string& text : percentages(errors)) row.push_back(text);
    print_row(row);
  };
  const auto library = [&](const char* name, const char* measure, int windows, double log_sigma, cv::Size window) {
    MwmfOptions options = tsukuba_correlation();
    options.measure = measure;
    options.windows = windows;
    options.log_sigma = log_sigma;
    options.window_width = window.width;
    options.window_height = window.height;
    print(name, log_sigma > 0 ? fmt::format("{:.1f}", log_sigma) : "-", window,
          stereo::mwmf(pair.left, pair.right, options));
  };
  constexpr int kDisparities = 32;
  library("NCC", "ncc", 1, 0, {9, 19});
  library("SSD", "ssd", 1, 1.0, {9, 9});
  library("SAD", "sad", 1, 1.0, {9, 9});
  print("Rank 9x7", "-", {11, 11}, winners(rank_costs(pair, {9, 7}, kDisparities), {11, 11}, false));
  print("Census 9x7", "-", {9, 11}, winners(census_costs(pair, {9, 7}, kDisparities), {9, 11}, false));
  print("MW-SAD", "-", {11, 9}, winners(sad_costs(pair, kDisparities), {11, 9}, true));
  library("SAD5", "sad", 5, 0, {7, 9});
  library("SAD9", "sad", 9, 0, {5, 5});
  library("SAD25", "sad", 25, 1.0, {3, 5});
}

void print_steps(const testing::TruthPair& pair) {
  fmt::print("\n### Figure 3.19: step by step\n\n");
  print_heading({"step", "thesis: wrong [%]", "wrong [%]", "at borders [%]", "invalid [%]"});
  MwmfOptions options = tsukuba_correlation();
  MwmfOptions thesis;
  thesis.preset = "thesis";
  thesis.apply_preset();
  const auto step = [&](const char* name, const char* number, const std::function<void()>& change) {
    change();
    std::vector<std::string> row = {name, number};
    for (const std::string& text : percentages(score(pair, options))) row.push_back(text);
    print_row(row);
  };
  step("LoG 1.0, SAD 9x9", "6.0", [] {});
  step("SAD5 7x9", "", [&] { options.windows = 5, options.log_sigma = 0, options.window_width = 7; });
  step("+ correlation function error filter", "", [&] { options.min_margin = thesis.min_margin; });
  step("+ border correction", "", [&] { options.borders = thesis.borders; });
  step("+ segment filter 100 px", "2.5", [&] { options.min_segment = 100; });
  step("+ interpolation within segments", "", [&] { options.interpolation = "within"; });
  step("+ interpolation everywhere", "4.1", [&] { options.interpolation = "everywhere"; });
  // What the criterion for borders changes.
  step("borders by `support`, before interpolation", "2.5",
       [&] { options.borders = "support", options.interpolation = "off"; });
  step("borders by `support`, interpolation everywhere", "4.1", [&] { options.interpolation = "everywhere"; });
  const auto preset = [&](const char* name) {
    options = {};
    options.preset = name;
    options.apply_preset();
    options.disparities = 32;
  };
  step("preset `default`", "", [&] { preset("default"); });
  step("preset `quality`", "", [&] { preset("quality"); });
}

}  // namespace

void print_stereo_tables() {
  fmt::print("\n## Chapter 3: stereo, Tsukuba, all pixels with truth, error > 1 px\n");
  if (!std::filesystem::exists(testing::test_data("middlebury/tsukuba"))) {
    fmt::print("\nskipped: no Tsukuba images in the test data\n");
    return;
  }
  const testing::TruthPair pair = testing::middlebury_pair("tsukuba");
  print_plain_errors(pair);
  print_measures(pair);
  print_steps(pair);
}

}  // namespace iris::thesis
