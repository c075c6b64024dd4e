#include "src/stereo/filters.h"

#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <queue>
#include <vector>

#include "support/stereo_pairs.h"

namespace iris::stereo {
namespace {

constexpr uint16_t kNone = Correlation::kNone;

TEST(ErrorFilter, RejectsSmallMarginsOnly) {
  Correlation c;
  c.cost = (cv::Mat1w(1, 5) << 100, 100, 100, 100, 100);
  c.second = (cv::Mat1w(1, 5) << 100, 114, 115, 300, kNone);  // without a rival nothing is sure
  cv::Mat1w winner = (cv::Mat1w(1, 5) << 1, 2, 3, 4, 5);
  reject_ambiguous(c, 15, winner);
  EXPECT_THAT(std::vector<int>(winner.begin(), winner.end()), ::testing::ElementsAre(kNone, kNone, 3, 4, kNone));
}

TEST(LeftRightCheck, ComparesWithTheCorrespondingPixel) {
  // Left pixel x with index d corresponds to right pixel x - min_disparity - d.
  const cv::Mat1w right = (cv::Mat1w(1, 6) << 2, 3, 0, kNone, 1, 1);
  const cv::Mat1w left = (cv::Mat1w(1, 6) << kNone, 1, 2, 2, 2, 3);  // partners -, 0, 0, 1, 2, 2
  cv::Mat1w winner = left.clone();
  reject_one_sided(right, 0, 1, winner);
  EXPECT_THAT(std::vector<int>(winner.begin(), winner.end()), ::testing::ElementsAre(kNone, 1, 2, 2, kNone, kNone));
  winner = left.clone();
  reject_one_sided(right, 0, 0, winner);
  EXPECT_THAT(std::vector<int>(winner.begin(), winner.end()),
              ::testing::ElementsAre(kNone, kNone, 2, kNone, kNone, kNone));
  winner = (cv::Mat1w(1, 6) << 0, 3, 3, 2, 4, kNone);  // with range from -2: partners 2, 0, 1, 3, 2
  reject_one_sided(right, -2, 1, winner);
  EXPECT_THAT(std::vector<int>(winner.begin(), winner.end()), ::testing::ElementsAre(0, 3, 3, kNone, kNone, kNone));
}

cv::Mat1f refined(const Correlation& c, const cv::Mat1w& winner, int min_disparity, SubPixel fit, float smallest) {
  cv::Mat1f disparity(winner.size());
  refine(c, winner, min_disparity, fit, smallest, disparity);
  return disparity;
}

TEST(Refine, FitsAV) {
  Correlation c;
  // |d - 10.25| * 40 + 100 at 9, 10, 11: 150, 110, 130: the V's minimum is at 10.25.
  c.cost = (cv::Mat1w(1, 5) << 110, 110, 50, 70, 100);
  c.before = (cv::Mat1w(1, 5) << 150, kNone, 50, 130, 140);
  c.after = (cv::Mat1w(1, 5) << 130, 130, 50, 110, 120);
  const cv::Mat1w winner = (cv::Mat1w(1, 5) << 10, 10, 10, kNone, 0);
  const cv::Mat1f d = refined(c, winner, 0, SubPixel::v, 0.0625f);
  EXPECT_FLOAT_EQ(d(0, 0), 10.25f);
  EXPECT_FLOAT_EQ(d(0, 1), 10.0f);  // at the end of the range
  EXPECT_FLOAT_EQ(d(0, 2), 10.0f);  // all equal
  EXPECT_FLOAT_EQ(d(0, 3), 0.0f);   // invalid
  EXPECT_FLOAT_EQ(d(0, 4), 0.25f);
  EXPECT_FLOAT_EQ(refined(c, winner, -7, SubPixel::v, 0.0625f)(0, 0), 3.25f);
  EXPECT_FLOAT_EQ(refined(c, winner, -20, SubPixel::v, 0.0625f)(0, 0), 0.0625f);  // beyond infinity
}

TEST(Refine, FitsAParabolaOrNothing) {
  Correlation c;
  // 20 (d - 10.25)^2 + 100 at 9, 10, 11, times 4: 525, 405, 445.
  c.cost = (cv::Mat1w(1, 3) << 405, 110, 50);
  c.before = (cv::Mat1w(1, 3) << 525, kNone, 50);
  c.after = (cv::Mat1w(1, 3) << 445, 130, 50);
  const cv::Mat1w winner = (cv::Mat1w(1, 3) << 10, 10, 10);
  const cv::Mat1f d = refined(c, winner, 0, SubPixel::parabola, 0.0625f);
  EXPECT_FLOAT_EQ(d(0, 0), 10.25f);
  EXPECT_FLOAT_EQ(d(0, 1), 10.0f);
  EXPECT_FLOAT_EQ(d(0, 2), 10.0f);
  EXPECT_FLOAT_EQ(refined(c, winner, 0, SubPixel::off, 0.0625f)(0, 0), 10.0f);
}

// Disparities of a known pull, over several levels of evenly spread phases.
TEST(Equalise, TakesOutAPullOfAnyStrength) {
  for (const double pull : {0.12, 0.05, -0.04}) {
    cv::Mat1w winner(40, 1000);
    cv::Mat1f disparity(40, 1000), truth(40, 1000);
    for (int y = 0; y < 40; ++y) {
      for (int x = 0; x < 1000; ++x) {
        truth(y, x) = 3.5f + 0.012f * static_cast<float>(x) + 0.0003f * static_cast<float>(y);
        winner(y, x) = static_cast<uint16_t>(std::lround(truth(y, x)));
        disparity(y, x) = truth(y, x) - static_cast<float>(pull * std::sin(2 * CV_PI * truth(y, x)));
      }
    }
    equalise(winner, 0, disparity);
    // The estimate is of first order: 7 % too small for the strongest pull, 0.12.
    EXPECT_LT(cv::norm(disparity, truth, cv::NORM_INF), 0.015) << pull;
  }
}

TEST(Equalise, FrontalPlanesStayWhereTheyAre) {
  cv::Mat1w winner(60, 100);
  cv::Mat1f disparity(60, 100);
  const float planes[6] = {4.1f, 7.6f, 9.3f, 12.45f, 15.0f, 21.7f};
  for (int y = 0; y < 60; ++y) {
    disparity.row(y) = planes[y / 10];
    winner.row(y) = static_cast<double>(std::lround(planes[y / 10]));
  }
  const cv::Mat1f before = disparity.clone();
  equalise(winner, 0, disparity);
  EXPECT_LT(cv::norm(disparity, before, cv::NORM_INF), 0.03);
  disparity = 8.1f;  // a single one
  winner = uint16_t{8};
  equalise(winner, 0, disparity);
  EXPECT_EQ(cv::countNonZero(disparity != 8.1f), 0);
}

TEST(Outermost, PartnersInTheLastColumnsAreRejectedUnlessTheyAreTheLastInBoth) {
  cv::Mat1w winner = (cv::Mat1w(1, 5) << 0, 1, 1, 3, kNone);  // partners 0, 0, 1, 0, -
  reject_outermost(0, winner);
  EXPECT_THAT(std::vector<int>(winner.begin(), winner.end()), ::testing::ElementsAre(0, kNone, 1, kNone, kNone));
  winner = (cv::Mat1w(1, 5) << 0, 1, 1, 2, 3);  // partners 3, 3, 4, 4, 4
  reject_outermost(-3, winner);
  EXPECT_THAT(std::vector<int>(winner.begin(), winner.end()), ::testing::ElementsAre(0, 1, kNone, kNone, 3));
}

// Labels by flood fill.
cv::Mat1i flood_fill(const cv::Mat1f& disparity, float tolerance, std::vector<int>& sizes) {
  cv::Mat1i label(disparity.size(), -1);
  for (int y = 0; y < disparity.rows; ++y) {
    for (int x = 0; x < disparity.cols; ++x) {
      if (disparity(y, x) <= 0 || label(y, x) >= 0) continue;
      const int name = static_cast<int>(sizes.size());
      sizes.push_back(0);
      std::queue<cv::Point> open({cv::Point(x, y)});
      label(y, x) = name;
      while (!open.empty()) {
        const cv::Point p = open.front();
        open.pop();
        ++sizes[name];
        for (const cv::Point q : {p + cv::Point(1, 0), p - cv::Point(1, 0), p + cv::Point(0, 1), p - cv::Point(0, 1)}) {
          if (q.x < 0 || q.y < 0 || q.x >= disparity.cols || q.y >= disparity.rows) continue;
          if (label(q) >= 0 || disparity(q) <= 0 || std::abs(disparity(q) - disparity(p)) > tolerance) continue;
          label(q) = name;
          open.push(q);
        }
      }
    }
  }
  return label;
}

TEST(Segments, EqualFloodFillOnRandomImages) {
  cv::RNG random(8);
  for (int round = 0; round < 60; ++round) {
    cv::Mat1f disparity(random.uniform(1, 140), random.uniform(1, 60));  // several chunks of rows
    for (float& d : disparity) d = static_cast<float>(std::max(0, random.uniform(-1, 5))) * 0.75f;
    std::vector<int> sizes;
    const cv::Mat1i expected = flood_fill(disparity, 1.0f, sizes);
    Segments segments = find_segments(disparity, 1.0);
    ASSERT_EQ(cv::countNonZero(segments.label != expected), 0);
    ASSERT_EQ(segments.sizes, sizes);

    cv::Mat1f filtered = disparity.clone();
    reject_small(5, filtered, segments);
    for (int y = 0; y < disparity.rows; ++y) {
      for (int x = 0; x < disparity.cols; ++x) {
        const bool keep = expected(y, x) >= 0 && sizes[expected(y, x)] >= 5;
        ASSERT_EQ(filtered(y, x), keep ? disparity(y, x) : 0.0f);
        ASSERT_EQ(segments.label(y, x), keep ? expected(y, x) : -1);
      }
    }
  }
}

TEST(Segments, DiagonalNeighboursAndStepsSeparate) {
  const cv::Mat1f disparity = (cv::Mat1f(3, 4) << 5, 0, 9, 9,  //
                               0, 5, 8, 9,                     //
                               6, 6, 7, 9);
  const Segments segments = find_segments(disparity, 1.0);
  const cv::Mat1i expected = (cv::Mat1i(3, 4) << 0, -1, 1, 1,  //
                              -1, 1, 1, 1,                     // 5 - 6 - 7 - 8 - 9 is a slope
                              1, 1, 1, 1);
  EXPECT_EQ(cv::countNonZero(segments.label != expected), 0);
  EXPECT_THAT(segments.sizes, ::testing::ElementsAre(1, 9));
}

}  // namespace
}  // namespace iris::stereo
