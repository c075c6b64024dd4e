#include "iris/calibrate/detect.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <opencv2/imgproc.hpp>

#include "support/target_images.h"

namespace iris::calibrate {
namespace {

using iris::testing::Sheet;
using iris::testing::target_poses;
using iris::testing::target_rig;
using iris::testing::TargetRenderer;
using ::testing::HasSubstr;

struct Accuracy {
  double rms = 0, largest = 0;  // [px] of the distance
  int corners = 0, images = 0;
};

// Corners found in rendered images against their true projections. Symmetric sheets may be numbered in several ways.
Accuracy accuracy(const Target& target, double snr, int count) {
  const StereoCalibration rig = target_rig();
  const TargetRenderer renderer(rig.left);
  const Sheet sheet(target);
  const auto points = target_points(target);
  Accuracy result;
  double sum = 0;
  unsigned seed = 0;
  for (const Pose& pose : target_poses(target, rig, count, 3)) {
    const Detection found = find_target(renderer.render(sheet, pose, snr, ++seed), target);
    if (found.corners.empty()) continue;
    ++result.images;
    double least = 1e300, largest = 0;
    for (const auto& numbers : target_symmetries(target)) {
      double total = 0, most = 0;
      for (size_t i = 0; i < found.corners.size(); ++i) {
        const auto id = static_cast<size_t>(numbers[static_cast<size_t>(found.corners.ids[i])]);
        const double d = (found.corners.points[i] - rig.left.project(pose * points[id])).norm();
        total += d * d;
        most = std::max(most, d);
      }
      if (total < least) {
        least = total;
        largest = most;
      }
    }
    sum += least;
    result.largest = std::max(result.largest, largest);
    result.corners += static_cast<int>(found.corners.size());
  }
  result.rms = std::sqrt(sum / std::max(1, result.corners));
  return result;
}

// Thesis 2.3 and figure 2.4: 1/40 px at 45 dB.
TEST(Detect, SquaresToAFortiethOfAPixelAt45Db) {
  const Accuracy a = accuracy(parse_target("squares:7x5:20mm"), 45, 8);
  std::printf("squares at 45 dB: %d corners in %d images, RMS %.4f px, largest %.3f px\n", a.corners, a.images, a.rms,
              a.largest);
  EXPECT_EQ(a.images, 8);
  EXPECT_EQ(a.corners, 8 * 140);
  EXPECT_LE(a.rms / std::sqrt(2.0), 1.0 / 40);  // of a coordinate
}

// Without noise what is left is the method's own error: half sides of a bent line, and 8-bit grey levels.
TEST(Detect, SquaresWithoutNoise) {
  const Accuracy a = accuracy(parse_target("squares:7x5:20mm"), 0, 4);
  std::printf("squares without noise: RMS %.4f px\n", a.rms);
  EXPECT_EQ(a.images, 4);
  EXPECT_LE(a.rms, 0.02);
}

struct Case {
  const char* name;
  const char* target;
  int least_corners;  // of six images
  double rms;         // [px] measured 0.02 to 0.04; OpenCV's own accuracy
};
class OtherTargets : public ::testing::TestWithParam<Case> {};

TEST_P(OtherTargets, AreFoundWhereTheyAre) {
  const Accuracy a = accuracy(parse_target(GetParam().target), 45, 6);
  std::printf("%s: %d corners in %d images, RMS %.4f px, largest %.3f px\n", GetParam().target, a.corners, a.images,
              a.rms, a.largest);
  EXPECT_GE(a.corners, GetParam().least_corners);
  EXPECT_LE(a.rms, GetParam().rms);
}

INSTANTIATE_TEST_SUITE_P(All, OtherTargets,
                         ::testing::Values(Case{"chessboard", "chessboard:9x6:25mm", 6 * 54, 0.08},
                                           Case{"charuco", "charuco:10x7:30mm:22.5mm", 6 * 45, 0.1},
                                           Case{"aprilgrid", "aprilgrid:5x4:40mm:0.3", 6 * 60, 0.1}),
                         [](const auto& test) { return std::string(test.param.name); });

TEST(Detect, BlurIsMeasuredInTheWorseDirection) {
  const StereoCalibration rig = target_rig();
  const TargetRenderer renderer(rig.left);
  for (const char* text : {"squares:7x5:20mm", "chessboard:9x6:25mm"}) {
    const Target target = parse_target(text);
    const Pose pose = target_poses(target, rig, 1, 3)[0];
    const cv::Mat1b sharp = renderer.render(Sheet(target), pose, 45, 1);
    cv::Mat1b moved;
    cv::blur(sharp, moved, {9, 1});
    const double before = find_target(sharp, target).blur, after = find_target(moved, target).blur;
    EXPECT_GT(before, 0.9) << text;
    EXPECT_LT(before, 2.5) << text;
    // What is too blurred to be measured is not found: left out as well.
    EXPECT_TRUE(after == 0 || after > 2 * before) << text << ": " << after;
  }
}

TEST(Detect, WhatIsWrongIsSaid) {
  const StereoCalibration rig = target_rig();
  const TargetRenderer renderer(rig.left);
  const auto image = [&](const char* text) {
    const Target target = parse_target(text);
    return renderer.render(Sheet(target), target_poses(target, rig, 1, 3)[0], 45, 1);
  };
  // A wrong count.
  const cv::Mat1b squares = image("squares:7x5:20mm"), board = image("chessboard:9x6:25mm");
  EXPECT_TRUE(find_target(squares, parse_target("squares:8x5:20mm")).corners.empty());
  EXPECT_THAT(find_target(squares, parse_target("squares:8x5:20mm")).problem, HasSubstr("a grid of 7 x 5 squares"));
  EXPECT_TRUE(find_target(board, parse_target("chessboard:10x7:25mm")).corners.empty());
  EXPECT_THAT(explain_missing(board, parse_target("chessboard:10x7:25mm")), HasSubstr("9 x 6 inner corners"));
  // A hidden square.
  cv::Mat1b hidden = squares.clone();
  const Detection whole = find_target(squares, parse_target("squares:7x5:20mm"));
  const Eigen::Vector2d middle = (whole.corners.points[68] + whole.corners.points[70]) / 2;
  cv::circle(hidden, {cvRound(middle.x()), cvRound(middle.y())}, 14, {230}, cv::FILLED);
  EXPECT_TRUE(find_target(hidden, parse_target("squares:7x5:20mm")).corners.empty());
  EXPECT_THAT(find_target(hidden, parse_target("squares:7x5:20mm")).problem, HasSubstr("hidden"));
  // A mirrored image.
  const Target charuco = parse_target("charuco:10x7:30mm:22.5mm");
  cv::Mat1b mirrored;
  cv::flip(image("charuco:10x7:30mm:22.5mm"), mirrored, 1);
  EXPECT_TRUE(find_target(mirrored, charuco).corners.empty());
  EXPECT_THAT(explain_missing(mirrored, charuco), HasSubstr("mirrored"));
  // Nothing there.
  const cv::Mat1b empty(480, 640, uchar{120});
  for (const char* text :
       {"squares:7x5:20mm", "chessboard:9x6:25mm", "charuco:10x7:30mm:22.5mm", "aprilgrid:6x6:88mm:0.3"}) {
    EXPECT_TRUE(find_target(empty, parse_target(text)).corners.empty()) << text;
    EXPECT_EQ(explain_missing(empty, parse_target(text)), "") << text;
  }
}

TEST(Detect, RightImageIsNumberedLikeTheLeftOne) {
  const Target target = parse_target("chessboard:9x6:25mm");
  const StereoCalibration rig = target_rig();
  const auto view = iris::testing::target_views(target, rig, target_poses(target, rig, 1, 5), 0, 1)[0];
  Corners turned = view.right;
  std::reverse(turned.points.begin(), turned.points.end());
  match_orientation(target, view.left, turned);
  EXPECT_EQ(turned.ids, view.right.ids);
  for (size_t i = 0; i < turned.size(); ++i) EXPECT_EQ(turned.points[i], view.right.points[i]);
}

}  // namespace
}  // namespace iris::calibrate
