// Milliseconds a frame of mwmf and of OpenCV's block matchers on one thread, in one run: stereo_bench [LEFT RIGHT [D]]
// Without images: a rectified EuRoC pair if it is there, else a synthetic pair of the same size.
#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "iris/core/parallel.h"
#include "iris/stereo/mwmf.h"
#include "src/stereo/correlation.h"
#include "src/stereo/filters.h"
#include "src/stereo/interpolation.h"
#include "src/stereo/log_filter.h"
#include "support/simd_targets.h"
#include "support/stereo_pairs.h"

namespace {

double fastest_ms(int repetitions, const std::function<void()>& work) {
  double best = 1e30;
  for (int i = 0; i < repetitions; ++i) {
    const auto start = std::chrono::steady_clock::now();
    work();
    best = std::min(best, std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count());
  }
  return best;
}

}  // namespace

int main(int argc, char** argv) {
  cv::setNumThreads(1);
  cv::Mat1b left, right;
  if (argc >= 3) {
    left = cv::imread(argv[1], cv::IMREAD_GRAYSCALE);
    right = cv::imread(argv[2], cv::IMREAD_GRAYSCALE);
  } else if (std::filesystem::exists(iris::testing::test_data("euroc_mh01"))) {
    std::tie(left, right) = iris::testing::rectified_euroc_pair(40);
  } else {
    std::tie(left, right) = iris::testing::slanted_pair(cv::Size(752, 480), 40.0, 0.05);
  }
  if (left.empty() || left.size() != right.size()) {
    fmt::print(stderr, "cannot read the images\n");
    return 2;
  }
  iris::stereo::MwmfOptions options;
  options.disparities = argc >= 4 ? std::atoi(argv[3]) : 128;
  fmt::print("{}x{}, {} disparities, one thread, fastest of 10 [ms]\n", left.cols, left.rows, options.disparities);

  iris::with_threads(1, [&] {
    using namespace iris::stereo;
    cv::Mat1b left_log, right_log;
    fmt::print("  LoG, both images  {:6.1f}\n", fastest_ms(10, [&] {
                 left_log = log_filter(left, options.log_sigma);
                 right_log = log_filter(right, options.log_sigma);
               }));
    Census census_left, census_right;
    fmt::print("  census, both      {:6.1f}\n", fastest_ms(10, [&] {
                 census_left = census_transform(left);
                 census_right = census_transform(right);
               }));
    Correlation correlation;
    const CorrelationParameters parameters{options.disparities, 0, options.window_width, options.window_height, 16};
    fmt::print("  correlation       {:6.1f}\n", fastest_ms(10, [&] {
                 correlation = correlate({left_log, census_left}, {right_log, census_right}, parameters);
               }));
    iris::testing::for_each_simd_target([&](const char* target) {
      fmt::print("    with {:12s} {:6.1f}\n", target, fastest_ms(3, [&] {
                   correlation = correlate({left_log, census_left}, {right_log, census_right}, parameters);
                 }));
    });
    cv::Mat1w winner;
    cv::Mat1f disparity;
    fmt::print("  filters, sub-pixel{:6.1f}\n", fastest_ms(10, [&] {
                 winner = correlation.winner.clone();
                 reject_ambiguous(correlation, 30, winner);
                 reject_one_sided(correlation.right_winner, 0, 1, winner);
                 disparity = refine(correlation, winner, 0, kSmallestDisparity);
               }));
    Segments segments;
    fmt::print("  segments          {:6.1f}\n", fastest_ms(10, [&] {
                 segments = find_segments(disparity, 1);
                 reject_small(100, disparity, segments);
               }));
    fmt::print("  interpolation     {:6.1f}\n",
               fastest_ms(10, [&] { interpolate(disparity, segments, Interpolation::everywhere); }));
    fmt::print("mwmf, all of it     {:6.1f}\n", fastest_ms(10, [&] { mwmf(left, right, options); }));
  });
  cv::Mat disparity;
  const auto bm = cv::StereoBM::create((options.disparities + 15) / 16 * 16, 9);
  fmt::print("OpenCV StereoBM     {:6.1f}\n", fastest_ms(10, [&] { bm->compute(left, right, disparity); }));
  const auto sgbm = cv::StereoSGBM::create(0, (options.disparities + 15) / 16 * 16, 5, 200, 800, 1, 63, 10, 100, 2);
  fmt::print("OpenCV StereoSGBM   {:6.1f}\n", fastest_ms(3, [&] { sgbm->compute(left, right, disparity); }));
}
