#include <fmt/format.h>
#include <hwy/highway.h>

#include <opencv2/imgproc.hpp>

#include "bench/bench.h"
#include "bench/inputs.h"
#include "bench/opencv_peers.h"
#include "iris/stereo/mwmf.h"
#include "src/stereo/correlation.h"
#include "src/stereo/filters.h"
#include "src/stereo/interpolation.h"
#include "src/stereo/log_filter.h"

namespace iris::bench {
namespace {

using namespace iris::stereo;
using benchmark::DoNotOptimize;
using benchmark::State;

struct Pair {
  cv::Mat1b left, right;
  int disparities;
};
using PairSource = std::function<const Pair&()>;

const Pair& hand_held_pair() {
  static const Pair pair{hand_held().pairs[0].left, hand_held().pairs[0].right, 128};
  return pair;
}

// 640x480, 64 disparities and 1242x375, 128 disparities: what others report.
const Pair& vga_pair() {
  static const Pair pair = [] {
    const Sequence room = render_sequence({500, 319.5, 239.5, 0.12, 0, 640, 480}, 1);
    return Pair{room.pairs[0].left, room.pairs[0].right, 64};
  }();
  return pair;
}
const Pair& wide_pair() {
  static const Pair pair = [] {
    const Sequence room = render_sequence({720, 620.5, 187, 0.25, 0, 1242, 375}, 1);
    return Pair{room.pairs[0].left, room.pairs[0].right, 128};
  }();
  return pair;
}
const Pair& street_pair() {
  static const Pair pair{street()->pairs[0].left, street()->pairs[0].right, 128};
  return pair;
}

MwmfOptions options_for(const Pair& pair) {
  MwmfOptions options;
  options.disparities = pair.disparities;
  return options;
}

// Evaluations of the cost of a window: pixels times disparities.
double evaluations(const Pair& pair) { return static_cast<double>(pair.left.total()) * pair.disparities; }

Contender mwmf_contender(const std::string& who, int threads, const PairSource& source,
                         const std::function<void(MwmfOptions&)>& change = {}) {
  return {who, [=](State& state) {
            const Pair& pair = source();
            MwmfOptions options = options_for(pair);
            if (change) change(options);
            measure(state, threads, [&] { DoNotOptimize(mwmf(pair.left, pair.right, options)); });
            set_rate(state, "Mdisparities/s", evaluations(pair) * 1e-6);
          }};
}

Contender opencv_contender(const std::string& who, int threads, const PairSource& source,
                           const std::function<cv::Ptr<cv::StereoMatcher>(int)>& create) {
  return {who, [=](State& state) {
            const Pair& pair = source();
            const auto matcher = create(pair.disparities);
            cv::Mat disparity;
            measure(state, threads, [&] { matcher->compute(pair.left, pair.right, disparity); });
            set_rate(state, "Mdisparities/s", evaluations(pair) * 1e-6);
          }};
}

const auto kSgbm = [](int disparities) { return semi_global_matcher(disparities, cv::StereoSGBM::MODE_SGBM); };
const auto kSgbm3 = [](int disparities) { return semi_global_matcher(disparities, cv::StereoSGBM::MODE_SGBM_3WAY); };

// One step after another, each on what those before it made.
struct Steps {
  cv::Mat1b left_log, right_log;
  Census left_census, right_census;
  Correlation correlation;
  cv::Mat1w winner;
  cv::Mat1f raw, disparity;
  Segments segments;

  explicit Steps(const Pair& pair) {
    left_log = log_filter(pair.left, 1.0);
    right_log = log_filter(pair.right, 1.0);
    left_census = census_transform(pair.left);
    right_census = census_transform(pair.right);
    correlation = correlate(pair.disparities);
    refined();
    raw = disparity.clone();
    segments = find_segments(disparity, 1);
    reject_small(100, disparity, segments);
  }
  Correlation correlate(int disparities) const {
    return stereo::correlate({left_log, left_census}, {right_log, right_census}, {disparities, 0, 7, 7, 16});
  }
  void refined() {
    winner = correlation.winner.clone();
    reject_ambiguous(correlation, 30, winner);
    reject_one_sided(correlation.right_winner, 0, 1, winner);
    disparity.create(winner.size());
    refine(correlation, winner, 0, SubPixel::v, kSmallestDisparity, disparity);
  }
};
Steps& steps() {
  static Steps made(hand_held_pair());
  return made;
}

Contender step(const std::string& who, const std::function<void()>& work) {
  return {who, [=](State& state) {
            steps();
            measure(state, 1, work);
          }};
}

// With one of the targets of Highway; 0 = the best one.
void with_target(int64_t target, const std::function<void()>& work) {
  const auto choose = [](int64_t chosen) {
    hwy::SetSupportedTargetsForTest(chosen);
    hwy::GetChosenTarget().DeInit();
  };
  if (target != 0) choose(target);
  work();
  choose(0);
}

// What runs once with each target that this processor has.
std::vector<Contender> with_all_targets(const std::function<Contender(const std::string& who, int64_t target)>& make) {
  std::vector<Contender> targets = {make("IRIS", 0)};
  const std::vector<int64_t> supported = hwy::SupportedAndGeneratedTargets();
  for (size_t i = 1; i < supported.size(); ++i) {
    targets.push_back(make(fmt::format("IRIS with {}", hwy::TargetName(supported[i])), supported[i]));
  }
  return targets;
}

Contender correlation_with(const std::string& who, int64_t target) {
  return {who, [=](State& state) {
            const Steps& made = steps();
            with_target(target, [&] {
              measure(state, 1, [&] { DoNotOptimize(made.correlate(hand_held_pair().disparities)); });
            });
            set_rate(state, "Mdisparities/s", evaluations(hand_held_pair()) * 1e-6);
          }};
}

// The chain up to sub-pixel disparities that passed the filters: LoG, correlation, left/right check, sub-pixel.
void up_to_sub_pixel(MwmfOptions& options) {
  options.borders = "off";
  options.min_segment = 0;
  options.interpolation = "off";
  options.median = "off";
}

void register_core(const std::string& input, const PairSource& source) {
  compare("stereo step", "LoG to sub-pixel", input,
          with_all_targets([&](const std::string& who, int64_t target) -> Contender {
            const Contender made = mwmf_contender(who, 1, source, up_to_sub_pixel);
            return {who, [=](State& state) { with_target(target, [&] { made.run(state); }); }};
          }));
}

void register_steps(const std::string& input) {
  compare("stereo step", "LoG, both images", input,
          {step("IRIS",
                [] {
                  DoNotOptimize(log_filter(hand_held_pair().left, 1.0));
                  DoNotOptimize(log_filter(hand_held_pair().right, 1.0));
                }),
           step("OpenCV GaussianBlur, Laplacian", [] {
             for (const cv::Mat1b* image : {&hand_held_pair().left, &hand_held_pair().right}) {
               cv::Mat smooth, log;
               cv::GaussianBlur(*image, smooth, {7, 7}, 1);
               cv::Laplacian(smooth, log, CV_16S, 3);
               log.convertTo(log, CV_8U, 8, 128);
               DoNotOptimize(log);
             }
           })});
  compare("stereo step", "census, both images", input, {step("IRIS", [] {
            DoNotOptimize(census_transform(hand_held_pair().left));
            DoNotOptimize(census_transform(hand_held_pair().right));
          })});
  compare("stereo step", "correlation with census", input, with_all_targets(correlation_with));
  compare("stereo step", "filters, sub-pixel", input, {step("IRIS", [] { steps().refined(); })});
  compare("stereo step", "segment filter", input,
          {step("IRIS",
                [] {
                  cv::Mat1f disparity = steps().raw.clone();
                  Segments segments = find_segments(disparity, 1);
                  reject_small(100, disparity, segments);
                  DoNotOptimize(disparity);
                }),
           step("OpenCV filterSpeckles", [] {
             cv::Mat1s fixed;
             steps().raw.convertTo(fixed, CV_16S, 16);
             cv::filterSpeckles(fixed, 0, 100, 16);
             DoNotOptimize(fixed);
           })});
  compare("stereo step", "interpolation", input,
          {{"IRIS", [](State& state) {
              const Steps& made = steps();
              cv::Mat1f disparity = made.raw.clone();
              Segments segments = find_segments(disparity, 1);
              reject_small(100, disparity, segments);
              measure(state, 1, [&] { DoNotOptimize(interpolate(disparity, {}, segments, {})); });
            }}});
}

// Here, and nowhere else, callgrind counts.
[[gnu::noinline]] void counted(const std::function<void()>& work) { work(); }

}  // namespace

void register_stereo() {
  struct Input {
    std::string name;
    PairSource source;
  };
  std::vector<Input> inputs = {{hand_held().name + ", 128 disparities", hand_held_pair},
                               {"room 640x480, 64 disparities", vga_pair},
                               {"room 1242x375, 128 disparities", wide_pair}};
  if (street()) inputs.push_back({street()->name + ", 128 disparities", street_pair});
  for (const auto& [input, source] : inputs) {
    compare("stereo", "dense disparities", input,
            {mwmf_contender("IRIS", 1, source), opencv_contender("OpenCV StereoBM 11x11", 1, source, block_matcher),
             opencv_contender("OpenCV StereoSGBM", 1, source, kSgbm),
             opencv_contender("OpenCV StereoSGBM 3WAY", 1, source, kSgbm3)});
  }
  const auto& [input, source] = inputs[0];
  const auto preset = [](const char* name) {
    return [name](MwmfOptions& options) {
      options.preset = name;
      options.apply_preset();
    };
  };
  compare("stereo", "presets", input,
          {mwmf_contender("IRIS, quality", 1, source, preset("quality")),
           mwmf_contender("IRIS, thesis", 1, source, preset("thesis")), mwmf_contender("IRIS, default", 1, source)});
  for (size_t i = 0; i < 3; ++i) {
    const auto& [of_threads, pair] = inputs[i];
    compare("stereo", "two threads", of_threads,
            {mwmf_contender("IRIS", 2, pair), mwmf_contender("IRIS, one thread", 1, pair),
             opencv_contender("OpenCV StereoBM 11x11, two threads", 2, pair, block_matcher),
             opencv_contender("OpenCV StereoSGBM 3WAY, two threads", 2, pair, kSgbm3)},
            Uses::several);
  }
  for (size_t i = 1; i < 3; ++i) register_core(inputs[i].name, inputs[i].source);
  register_steps(input);
}

bool count_instructions(const std::string& work) {
  const Pair& pair = vga_pair();
  cv::setNumThreads(1);
  std::function<void()> body;
  if (work == "correlation") {
    const auto made = std::make_shared<Steps>(pair);
    body = [=, &pair] { DoNotOptimize(made->correlate(pair.disparities)); };
  } else if (work == "mwmf") {
    body = [&] { DoNotOptimize(mwmf(pair.left, pair.right, options_for(pair))); };
  } else if (work == "StereoBM" || work == "StereoSGBM") {
    const auto matcher = work == "StereoBM" ? block_matcher(pair.disparities) : kSgbm(pair.disparities);
    body = [=, &pair] {
      cv::Mat disparity;
      matcher->compute(pair.left, pair.right, disparity);
    };
  } else {
    return false;
  }
  with_threads(1, [&] { counted(body); });
  fmt::print("{:.0f}\n", evaluations(pair));
  return true;
}

}  // namespace iris::bench
