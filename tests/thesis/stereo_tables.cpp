// Chapter 3 on the Tsukuba images: errors of plain correlation (tables 3.1 and 3.2), measures (fig. 3.10), steps
// (fig. 3.19).
#include <fmt/format.h>

#include <cmath>
#include <filesystem>
#include <functional>

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

void print_measures(const testing::TruthPair& pair) {
  fmt::print("\n### Figure 3.10: measures, left/right check alone\n\n");
  print_heading({"measure", "LoG", "window", "wrong [%]", "at borders [%]", "invalid [%]"});
  struct Setting {
    const char *name, *measure;
    int windows;
    double log_sigma;
    int width, height;
  };
  for (const Setting& s : {Setting{"NCC", "ncc", 1, 1.0, 9, 9}, Setting{"SSD", "ssd", 1, 1.0, 9, 9},
                           Setting{"SAD", "sad", 1, 1.0, 9, 9}, Setting{"Rank", "rank", 1, 0, 9, 9},
                           Setting{"Census", "census", 1, 0, 9, 9}, Setting{"SAD5", "sad", 5, 0, 7, 9},
                           Setting{"SAD9", "sad", 9, 0, 5, 5}, Setting{"SAD25", "sad", 25, 1.0, 3, 5}}) {
    MwmfOptions options = tsukuba_correlation();
    options.measure = s.measure;
    options.windows = s.windows;
    options.log_sigma = s.log_sigma;
    options.window_width = s.width;
    options.window_height = s.height;
    std::vector<std::string> row = {s.name, s.log_sigma > 0 ? fmt::format("{:.1f}", s.log_sigma) : "-",
                                    fmt::format("{}x{}", s.width, s.height)};
    for (const std::string& text : percentages(score(pair, options))) row.push_back(text);
    print_row(row);
  }
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
