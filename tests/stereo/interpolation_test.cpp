#include "src/stereo/interpolation.h"

#include <gmock/gmock.h>

#include <algorithm>
#include <optional>
#include <vector>

#include "iris/core/parallel.h"

namespace iris::stereo {
namespace {

constexpr uchar kMeasured = 1, kWithin = 3, kBetween = 4;

DisparityImage run(const cv::Mat1f& disparity, Interpolation mode) {
  return interpolate(disparity, {}, find_segments(disparity, 1.0), {.mode = mode});
}

TEST(Interpolation, OffKeepsHoles) {
  const cv::Mat1f d = (cv::Mat1f(1, 3) << 5, 0, 5);
  const DisparityImage out = run(d, Interpolation::off);
  EXPECT_EQ(cv::countNonZero(out.disparity != d), 0);
  EXPECT_THAT(std::vector<int>(out.origin.begin(), out.origin.end()), ::testing::ElementsAre(1, 0, 1));
}

TEST(Interpolation, WithinASegmentTheMeanOfRowAndColumn) {
  // A ring: left 4, right 6 (through 5), above 5, below 5.5.
  const cv::Mat1f d = (cv::Mat1f(3, 3) << 4.5f, 5, 5.5f,  //
                       4, 0, 6,                           //
                       4.75f, 5.5f, 6);
  for (const Interpolation mode : {Interpolation::within, Interpolation::everywhere}) {
    const DisparityImage out = run(d, mode);
    EXPECT_FLOAT_EQ(out.disparity(1, 1), (5.0f + 5.25f) / 2);
    EXPECT_EQ(out.origin(1, 1), kWithin);
    EXPECT_EQ(out.origin(0, 0), kMeasured);
  }
}

TEST(Interpolation, BetweenSegmentsTheSecondSmallestNeighbour) {
  const cv::Mat1f d = (cv::Mat1f(3, 3) << 0, 3, 0,  //
                       20, 0, 9,                    //
                       0, 5, 0);
  EXPECT_EQ(run(d, Interpolation::within).disparity(1, 1), 0);
  const DisparityImage out = run(d, Interpolation::everywhere);
  EXPECT_FLOAT_EQ(out.disparity(1, 1), 5);
  EXPECT_EQ(out.origin(1, 1), kBetween);
}

TEST(Interpolation, RowAndColumnThatLeadToOneSegmentAreAveraged) {
  // Row: the background (2 … 3, lower right) against an object (20): background. Column: background above and below.
  const cv::Mat1f d = (cv::Mat1f(3, 3) << 20, 2, 2,  //
                       20, 0, 2.5f,                  //
                       20, 3, 3);
  const DisparityImage out = run(d, Interpolation::everywhere);
  EXPECT_FLOAT_EQ(out.disparity(1, 1), (2.5f + 2.5f) / 2);
  EXPECT_EQ(out.origin(1, 1), kBetween);
}

TEST(Interpolation, TheStripThatOnlyTheLeftCameraSeesContinuesItsRightNeighbour) {
  const cv::Mat1f d = (cv::Mat1f(3, 4) << 2, 2, 2, 2,  //
                       0, 0, 30, 30,                   //
                       2, 2, 2, 2);
  const DisparityImage out = run(d, Interpolation::everywhere);
  EXPECT_FLOAT_EQ(out.disparity(1, 0), 30);
  EXPECT_FLOAT_EQ(out.disparity(1, 1), 30);
}

TEST(Interpolation, AStripHiddenByAnObjectContinuesTheBackgroundAtItsLeft) {
  // The object (9) hides 5 columns of the background (4) from the right camera; further rows are of the object.
  const cv::Mat1f d = (cv::Mat1f(3, 9) << 4, 4, 9, 9, 9, 9, 9, 9, 9,  //
                       4, 4, 0, 0, 0, 0, 0, 9, 9,                     //
                       4, 4, 9, 9, 9, 9, 9, 9, 9);
  for (int x = 2; x < 7; ++x) {
    EXPECT_FLOAT_EQ(run(d, Interpolation::everywhere).disparity(1, x), 4);
    const DisparityImage without = interpolate(d, {}, find_segments(d, 1.0), {.hidden_strips = false});
    EXPECT_FLOAT_EQ(without.disparity(1, x), 9);
  }
}

// The object and the background are one segment, because the floor on which the object stands connects them.
TEST(Interpolation, AStripHiddenByAnObjectOfTheSameSegmentContinuesTheBackground) {
  constexpr int kRows = 12;
  cv::Mat1f d(kRows, 14, 4.0f);
  for (int y = 0; y < kRows; ++y) {
    for (int x = 0; x < 14; ++x) {
      if (y == kRows - 1) d(y, x) = 4 + 0.5f * static_cast<float>(x);  // the floor rises towards the object
      if (y < kRows - 1 && x >= 8) d(y, x) = 9;
      if (y < kRows - 1 && x >= 3 && x < 8) d(y, x) = 0;
    }
  }
  const Segments segments = find_segments(d, 1.0);
  ASSERT_EQ(segments.label(0, 0), segments.label(0, 13));
  const DisparityImage out = interpolate(d, {}, segments, {});
  for (int x = 3; x < 8; ++x) EXPECT_FLOAT_EQ(out.disparity(3, x), 4);
  // A surface that slants less than by half a pixel a pixel is no step.
  const cv::Mat1f slope = (cv::Mat1f(3, 9) << 4, 4.4f, 4.8f, 5.2f, 5.6f, 6, 6.4f, 6.8f, 7.2f,  //
                           4, 4.4f, 0, 0, 0, 0, 0, 6.8f, 7.2f,                                 //
                           4, 4.4f, 4.8f, 5.2f, 5.6f, 6, 6.4f, 6.8f, 7.2f);
  const DisparityImage plane = interpolate(slope, {}, find_segments(slope, 1.0), {});
  for (int x = 2; x < 7; ++x) EXPECT_NEAR(plane.disparity(1, x), slope(0, x), 1e-5);
}

TEST(Interpolation, SaysWhatWasCorrected) {
  const cv::Mat1f d = (cv::Mat1f(1, 3) << 5, 5, 0);
  const cv::Mat1b corrected = (cv::Mat1b(1, 3) << 0, 255, 255);
  const DisparityImage out = interpolate(d, corrected, find_segments(d, 1.0), {.mode = Interpolation::off});
  EXPECT_THAT(std::vector<int>(out.origin.begin(), out.origin.end()), ::testing::ElementsAre(1, 2, 0));
}

TEST(Interpolation, AnEmptyImageStaysEmptyAndOnePixelFillsItsCross) {
  cv::Mat1f d(5, 5, 0.0f);
  EXPECT_EQ(cv::countNonZero(run(d, Interpolation::everywhere).disparity), 0);
  d(2, 2) = 7;
  const DisparityImage out = run(d, Interpolation::everywhere);
  EXPECT_EQ(cv::countNonZero(out.disparity == 7), 9);
  EXPECT_EQ(cv::countNonZero(out.origin == kBetween), 8);
}

// (3.5) - (3.7) with the changes that interpolation.h states, pixel by pixel.
float reference(const cv::Mat1f& d, const cv::Mat1i& label, int y, int x, const InterpolationParameters& p,
                uchar& origin) {
  struct Hit {
    float d;
    int segment, distance;
  };
  const auto look = [&](int dy, int dx) -> std::optional<Hit> {
    for (int k = 1;; ++k) {
      const int v = y + k * dy, u = x + k * dx;
      if (v < 0 || u < 0 || v >= d.rows || u >= d.cols) return std::nullopt;
      if (label(v, u) >= 0) return Hit{d(v, u), label(v, u), k};
    }
  };
  const std::optional<Hit> hits[4] = {look(0, -1), look(0, 1), look(-1, 0), look(1, 0)};
  origin = 0;
  const auto line = [](const std::optional<Hit>& a, const std::optional<Hit>& b) -> std::optional<Hit> {
    if (!a || !b) return a ? a : b;
    if (a->segment != b->segment) return a->d <= b->d ? a : b;
    const double total = a->distance + b->distance;
    return Hit{static_cast<float>((a->d * b->distance + b->d * a->distance) / total), a->segment, 0};
  };
  const auto row = line(hits[0], hits[1]), column = line(hits[2], hits[3]);
  if (!row && !column) return 0;
  bool within = true;
  for (const auto& hit : hits) within &= hit && hits[0] && hit->segment == hits[0]->segment;
  if (!within && p.mode != Interpolation::everywhere) return 0;
  origin = within ? kWithin : kBetween;
  if (!row) return column->d;
  if (!column || (p.left_from_right && !hits[0])) return row->d;
  if (p.hidden_strips && hits[0] && hits[1]) {
    const double gap = hits[0]->distance + hits[1]->distance - 1, step = hits[1]->d - hits[0]->d;
    const bool one = hits[0]->segment == hits[1]->segment;
    if (step > (one ? 2 : 0) && gap <= step + 6 && (!one || gap <= 2 * step)) return hits[0]->d;
  }
  if (row->segment == column->segment) return (row->d + column->d) / 2;
  std::vector<float> values;
  for (const auto& hit : hits) {
    if (hit) values.push_back(hit->d);
  }
  std::sort(values.begin(), values.end());
  return values[std::min<size_t>(p.second_smallest ? 1 : 0, values.size() - 1)];
}

TEST(Interpolation, EqualsTheDefinitionOnRandomImagesWithAnyNumberOfThreads) {
  cv::RNG random(2);
  for (int round = 0; round < 40; ++round) {
    cv::Mat1f d(random.uniform(1, 50), random.uniform(1, 150));
    for (float& v : d) v = random.uniform(0, 3) == 0 ? random.uniform(1.0f, 6.0f) : 0.0f;
    const Segments segments = find_segments(d, 2.0);
    for (int variant = 0; variant < 9; ++variant) {
      const InterpolationParameters p{.mode = variant == 8 ? Interpolation::within : Interpolation::everywhere,
                                      .second_smallest = (variant & 1) != 0,
                                      .left_from_right = (variant & 2) != 0,
                                      .hidden_strips = (variant & 4) != 0};
      DisparityImage out, many;
      with_threads(1, [&] { out = interpolate(d, {}, segments, p); });
      with_threads(4, [&] { many = interpolate(d, {}, segments, p); });
      ASSERT_EQ(cv::countNonZero(out.disparity != many.disparity), 0);
      ASSERT_EQ(cv::countNonZero(out.origin != many.origin), 0);
      for (int y = 0; y < d.rows; ++y) {
        for (int x = 0; x < d.cols; ++x) {
          if (d(y, x) > 0) {
            ASSERT_EQ(out.disparity(y, x), d(y, x));
            ASSERT_EQ(out.origin(y, x), kMeasured);
            continue;
          }
          uchar origin;
          const float expected = reference(d, segments.label, y, x, p, origin);
          ASSERT_NEAR(out.disparity(y, x), expected, 1e-4) << y << " " << x;
          ASSERT_EQ(out.origin(y, x), origin) << y << " " << x;
        }
      }
    }
  }
}

}  // namespace
}  // namespace iris::stereo
