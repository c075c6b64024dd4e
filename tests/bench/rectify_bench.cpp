#include <Eigen/Core>
#include <opencv2/calib3d.hpp>
#include <opencv2/core/eigen.hpp>
#include <opencv2/imgproc.hpp>

#include "bench/bench.h"
#include "bench/inputs.h"
#include "iris/rectify/rectifier.h"

namespace iris::bench {
namespace {

using benchmark::State;

StereoFrame recorded_frame(bool colour) {
  StereoFrame frame{.left = hand_held().pairs[0].left, .right = hand_held().pairs[0].right};
  if (colour) {
    cv::cvtColor(frame.left, frame.left, cv::COLOR_GRAY2BGR);
    cv::cvtColor(frame.right, frame.right, cv::COLOR_GRAY2BGR);
  }
  return frame;
}

Contender ours(bool colour) {
  return {"IRIS", [=](State& state) {
            const rectify::Rectifier rectifier(distorted_rig());
            const StereoFrame frame = recorded_frame(colour);
            measure(state, 1, [&] { benchmark::DoNotOptimize(rectifier.rectify(frame)); });
          }};
}

// stereoRectify's maps; grey images of both cameras and, if recorded in colour, the left one in colour.
Contender opencv(bool colour) {
  return {"OpenCV remap", [=](State& state) {
            const StereoCalibration rig = distorted_rig();
            const cv::Size size(rig.left.width, rig.left.height);
            cv::Mat k[2], r, t, rotation[2], projection[2], q, map[2], fraction[2];
            cv::eigen2cv(rig.left.K, k[0]);
            cv::eigen2cv(rig.right.K, k[1]);
            cv::eigen2cv(Eigen::Matrix3d(rig.right_from_left.linear()), r);
            cv::eigen2cv(Eigen::Vector3d(rig.right_from_left.translation()), t);
            const std::vector<double>* lens[] = {&rig.left.coefficients, &rig.right.coefficients};
            cv::stereoRectify(k[0], *lens[0], k[1], *lens[1], size, r, t, rotation[0], rotation[1], projection[0],
                              projection[1], q, cv::CALIB_ZERO_DISPARITY, 0);
            for (const int i : {0, 1}) {
              cv::initUndistortRectifyMap(k[i], *lens[i], rotation[i], projection[i], size, CV_16SC2, map[i],
                                          fraction[i]);
            }
            const StereoFrame frame = recorded_frame(colour);
            measure(state, 1, [&] {
              for (const int i : {0, 1}) {
                cv::Mat grey = i == 0 ? frame.left : frame.right, result;
                if (colour) cv::cvtColor(grey, grey, cv::COLOR_BGR2GRAY);
                cv::remap(grey, result, map[i], fraction[i], cv::INTER_LINEAR);
                benchmark::DoNotOptimize(result);
              }
              if (colour) {
                cv::Mat result;
                cv::remap(frame.left, result, map[0], fraction[0], cv::INTER_LINEAR);
                benchmark::DoNotOptimize(result);
              }
            });
          }};
}

}  // namespace

void register_rectify() {
  compare("rectify", "a grey pair", "752x480", {ours(false), opencv(false)});
  compare("rectify", "a colour pair", "752x480", {ours(true), opencv(true)});
}

}  // namespace iris::bench
