// How good the disparities are, beside OpenCV's: the tables of docs/benchmarks.md.
#include <fmt/format.h>

#include <cmath>
#include <filesystem>
#include <functional>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "bench/bench.h"
#include "bench/opencv_peers.h"
#include "iris/evaluate/disparities.h"
#include "iris/rectify/rectifier.h"
#include "iris/simulate/simulator.h"
#include "iris/stereo/mwmf.h"
#include "src/stereo/filters.h"
#include "src/stereo/interpolation.h"
#include "support/stereo_pairs.h"

namespace iris::bench {
namespace {

using stereo::MwmfOptions;

struct Image {
  cv::Mat1b left, right;
  cv::Mat1f truth;     // [px], 0 = unknown
  cv::Mat1b occluded;  // 255 = the right camera does not see it
};

// Images that count as one.
struct Scene {
  std::string name;
  int disparities;
  bool round;  // the truth is whole-pixel
  std::vector<Image> images;
};

Scene middlebury(const std::string& name, int disparities, bool round, const testing::TruthPair& pair) {
  return {name, disparities, round, {{pair.left, pair.right, pair.truth, testing::visible_in_both(pair.truth) == 0}}};
}

Scene rendered(const std::string& name, int frames) {
  simulate::SimulateOptions options;
  options.frames = frames;
  const simulate::Scene scene = simulate::make_scene(name, options.seed);
  const simulate::SimulatedPath path = simulate::make_path(scene, options);
  options.rate = frames / path.seconds;  // all along the path
  const simulate::Simulator simulator(scene, path, options);
  const rectify::Rectifier rectifier(simulator.calibration());
  Scene out{fmt::format("{}, rendered", name), 128, false, {}};
  for (int i = 0; i < simulator.frames(); ++i) {
    const StereoPair pair = rectifier.rectify(simulator.frame(i));
    const simulate::FrameTruth truth = simulator.truth(i);
    out.images.push_back({pair.left, pair.right, truth.disparity, truth.occluded});
  }
  return out;
}

std::vector<Scene> all_scenes() {
  std::vector<Scene> scenes;
  if (std::filesystem::exists(testing::test_data("middlebury"))) {
    scenes.push_back(middlebury("Tsukuba", 32, true, testing::middlebury_pair("tsukuba")));
    scenes.push_back(middlebury("Cones", 64, false, testing::middlebury_pair("cones")));
    scenes.push_back(middlebury("Motorcycle", 64, false, testing::motorcycle_pair()));
  }
  if (std::filesystem::exists(testing::aloe_folder() / "aloeGT.png")) {
    scenes.push_back(middlebury("Aloe", 96, false, testing::aloe_pair()));
  }
  constexpr int kFrames = 6;
  for (const char* name : {"apartment", "seminar-room", "yard"}) scenes.push_back(rendered(name, kFrames));
  return scenes;
}

struct Method {
  std::string name;
  std::function<DisparityImage(const cv::Mat1b&, const cv::Mat1b&, int disparities)> run;
};

Method preset(const std::string& name) {
  return {fmt::format("IRIS, `{}`", name), [name](const cv::Mat1b& left, const cv::Mat1b& right, int disparities) {
            MwmfOptions options;
            options.preset = name;
            options.apply_preset();
            options.disparities = disparities;
            return mwmf(left, right, options);
          }};
}

// OpenCV's matchers leave a strip as wide as the search range without disparities: the images get one more of it at
// their left. Matches with that strip are dropped, and gaps filled just as IRIS fills its own.
Method peer(const std::string& name, const std::function<cv::Ptr<cv::StereoMatcher>(int)>& create) {
  return {name, [create](const cv::Mat1b& left, const cv::Mat1b& right, int disparities) {
            cv::Mat1b wide_left, wide_right;
            cv::copyMakeBorder(left, wide_left, 0, 0, disparities, 0, cv::BORDER_REPLICATE);
            cv::copyMakeBorder(right, wide_right, 0, 0, disparities, 0, cv::BORDER_REPLICATE);
            cv::Mat1s fixed;
            create(disparities)->compute(wide_left, wide_right, fixed);
            cv::Mat1f disparity(left.size());
            for (int y = 0; y < left.rows; ++y) {
              for (int x = 0; x < left.cols; ++x) {
                const float d = static_cast<float>(fixed(y, x + disparities)) / 16;
                disparity(y, x) = d >= 0 && static_cast<float>(x) >= d ? std::max(d, stereo::kSmallestDisparity) : 0;
              }
            }
            return stereo::interpolate(disparity, {}, stereo::find_segments(disparity, 1), {});
          }};
}

std::vector<Method> all_methods() {
  const auto semi_global = [](int mode) {
    return [mode](int disparities) { return semi_global_matcher(disparities, mode); };
  };
  return {peer("StereoBM 11x11", block_matcher),
          peer("StereoSGBM", semi_global(cv::StereoSGBM::MODE_SGBM)),
          peer("StereoSGBM, 3 paths", semi_global(cv::StereoSGBM::MODE_SGBM_3WAY)),
          peer("StereoSGBM, 8 paths", semi_global(cv::StereoSGBM::MODE_HH)),
          preset("thesis"),
          preset("default"),
          preset("quality")};
}

struct Errors {
  evaluate::DisparityScore measured, dense;  // before and after interpolation
};

Errors score(const Scene& scene, const Method& method) {
  Errors errors;
  for (const Image& image : scene.images) {
    const DisparityImage result = method.run(image.left, image.right, scene.disparities);
    const auto rate = [&](const DisparityImage& estimate) {
      return evaluate::score_disparities(estimate, image.truth, image.occluded, {}, {.round = scene.round});
    };
    errors.measured.add(rate(testing::before_interpolation(result)));
    errors.dense.add(rate(result));
  }
  return errors;
}

void print_methods() {
  const std::vector<Scene> scenes = all_scenes();
  std::string heading = "| |", line = "|-|";
  for (const Scene& scene : scenes) {
    heading += fmt::format(" {} |", scene.name);
    line += "-:|";
  }
  heading += " mean |\n";
  line += "-:|\n";
  std::string dense = heading + line, measured = heading + line;
  for (const Method& method : all_methods()) {
    dense += fmt::format("| {} |", method.name);
    measured += fmt::format("| {} |", method.name);
    double all = 0, visible = 0, wrong = 0, density = 0;
    for (const Scene& scene : scenes) {
      const Errors e = score(scene, method);
      const double values[] = {e.dense.all.wrong_or_missing(1), e.dense.visible.wrong_or_missing(1),
                               e.measured.all.wrong(1), e.measured.all.density()};
      dense += fmt::format(" {:.2f} / {:.2f} |", values[0], values[1]);
      measured += fmt::format(" {:.2f} of {:.1f} |", values[2], values[3]);
      all += values[0], visible += values[1], wrong += values[2], density += values[3];
    }
    const auto n = static_cast<double>(scenes.size());
    dense += fmt::format(" {:.2f} / {:.2f} |\n", all / n, visible / n);
    measured += fmt::format(" {:.2f} of {:.1f} |\n", wrong / n, density / n);
  }
  fmt::print("Dense, percent of pixels off by more than 1 px: all / those that both cameras see\n\n{}\n", dense);
  fmt::print("Before interpolation, percent of all pixels: off by more than 1 px, of those with a disparity\n\n{}\n",
             measured);
}

void print_sub_pixel() {
  fmt::print("Slanted planes, noise 45 dB below the contrast of the texture and below the range of grey values\n\n");
  fmt::print("| preset | fit | RMS [px] | largest bias [px] | RMS, more noise [px] | largest bias [px] |\n");
  fmt::print("|-|-|-:|-:|-:|-:|\n");
  for (const char* preset : {"default", "quality"}) {
    for (const char* fit : {"off", "parabola", "v", "equalised"}) {
      std::string row = fmt::format("| {} | {} |", preset, fit);
      for (const double signal : {40.0, 255.0}) {
        MwmfOptions options;
        options.preset = preset;
        options.apply_preset();
        options.disparities = 32;
        options.sub_pixel = fit;
        evaluate::DisparityScore score;
        for (const testing::TruthPair& plane : testing::slanted_planes(signal / std::pow(10, 45.0 / 20))) {
          const DisparityImage result = testing::before_interpolation(mwmf(plane.left, plane.right, options));
          score.add(evaluate::score_disparities(result, plane.truth, {}, {}, {}));
        }
        double bias = 0;
        for (const evaluate::SubpixelScore& bin : score.by_fraction) bias = std::max(bias, std::abs(bin.mean()));
        row += fmt::format(" {:.3f} | {:.3f} |", score.subpixel.rms(), bias);
      }
      fmt::print("{}\n", row);
    }
  }
}

}  // namespace

void print_quality() {
  print_methods();
  print_sub_pixel();
}

}  // namespace iris::bench
