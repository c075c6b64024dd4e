#include "src/stereo/plane_fill.h"

#include <gmock/gmock.h>

#include <cmath>
#include <functional>

#include "iris/stereo/mwmf.h"
#include "src/stereo/interpolation.h"
#include "support/stereo_pairs.h"

namespace iris::stereo {
namespace {

constexpr float kSmallest = 0.0625f;
constexpr int kWidth = 200, kHeight = 150;
const cv::Rect kHole(60, 40, 80, 60), kObject(140, 20, 40, 110);

double wall(double x, double y) { return 8 + 0.06 * x - 0.03 * y; }

// A surface without disparities in kHole, at whose right end an object stands before it.
cv::Mat1f with_hole(const std::function<double(double, double)>& surface) {
  cv::Mat1f d(kHeight, kWidth);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      d(y, x) = kHole.contains({x, y}) ? 0.0f : kObject.contains({x, y}) ? 30.0f : static_cast<float>(surface(x, y));
    }
  }
  return d;
}

struct Filled {
  DisparityImage parallel, plane;
};

Filled fill(const cv::Mat1f& d, const PlaneFillParameters& parameters = {}) {
  const Segments segments = find_segments(d, 1);
  cv::Mat1i source;
  Filled out;
  out.parallel = interpolate(d, {}, segments, {}, &source);
  out.plane = {out.parallel.disparity.clone(), out.parallel.origin.clone()};
  fill_planes(d, segments, source, kSmallest, parameters, out.plane);
  return out;
}

double largest_error(const cv::Mat1f& d, const std::function<double(double, double)>& truth) {
  double largest = 0;
  for (int y = kHole.y; y < kHole.br().y; ++y) {
    for (int x = kHole.x; x < kHole.br().x; ++x) largest = std::max(largest, std::abs(d(y, x) - truth(x, y)));
  }
  return largest;
}

bool equal(const DisparityImage& a, const DisparityImage& b) {
  return cv::countNonZero(a.disparity != b.disparity) == 0 && cv::countNonZero(a.origin != b.origin) == 0;
}

TEST(PlaneFill, ContinuesASlantingWallExactly) {
  const Filled filled = fill(with_hole(wall));
  EXPECT_GT(largest_error(filled.parallel.disparity, wall), 1.5);
  EXPECT_LT(largest_error(filled.plane.disparity, wall), 1e-3);
  EXPECT_EQ(cv::countNonZero(filled.plane.origin != filled.parallel.origin), 0);
}

TEST(PlaneFill, ForgivesNoiseAndWrongDisparitiesBesideTheGap) {
  cv::Mat1f d = with_hole(wall);
  cv::RNG random(3);
  for (float& v : d) v += v > 0 ? static_cast<float>(random.gaussian(0.1)) : 0.0f;
  // A quarter of the band at the left is too near, within what a segment holds together.
  for (int y = kHole.y; y < kHole.y + kHole.height / 2; ++y) {
    for (int k = 1; k <= 8; ++k) d(y, kHole.x - k) += 0.9f;
  }
  const Filled filled = fill(d);
  EXPECT_GT(largest_error(filled.parallel.disparity, wall), 1.5);
  EXPECT_LT(largest_error(filled.plane.disparity, wall), 0.15);
}

TEST(PlaneFill, LeavesAloneWhatIsNoPlaneOrTooSmallOrTooSteep) {
  const auto curved = [](double x, double y) { return 8 + 0.002 * std::pow(x - 100, 2) + 0.001 * std::pow(y - 70, 2); };
  const Filled dome = fill(with_hole(curved));
  EXPECT_TRUE(equal(dome.plane, dome.parallel));
  const Filled small = fill(with_hole(wall), {.min_area = kHole.area() + 1});
  EXPECT_TRUE(equal(small.plane, small.parallel));
  const Filled steep = fill(with_hole(wall), {.max_slope = 0.05});
  EXPECT_TRUE(equal(steep.plane, steep.parallel));
  const Filled few = fill(with_hole(wall), {.min_samples = 10000});
  EXPECT_TRUE(equal(few.plane, few.parallel));
}

// A plane that is known at one end only is not continued for long.
TEST(PlaneFill, StopsWhereThePlaneIsUncertain) {
  cv::Mat1f d(40, 400, 0.0f);
  for (int y = 0; y < 40; ++y) {
    for (int x = 300; x < 400; ++x) d(y, x) = static_cast<float>(wall(x, y));
  }
  const Filled filled = fill(d);  // the strip at the left continues its right neighbour
  EXPECT_NEAR(filled.plane.disparity(20, 290), wall(290, 20), 1e-3);
  EXPECT_EQ(filled.plane.disparity(20, 5), filled.parallel.disparity(20, 5));
}

TEST(PlaneFill, StaysBetweenInfinityAndWhatSurroundsTheGap) {
  // Seen from the border, the wall would pass infinity in the middle of the gap, or the object at its end.
  const auto falling = [](double x, double) { return 12 - 0.15 * x; };
  const Filled far = fill(with_hole(falling));
  double lowest = 1e9, highest = 0;
  cv::minMaxLoc(far.plane.disparity(kHole), &lowest, &highest);
  EXPECT_GE(lowest, kSmallest);
  const auto rising = [](double x, double) { return 10 + 0.3 * (x - 60); };
  cv::Mat1f d = with_hole(rising);
  d(kObject) = 15.0f;
  const Filled near = fill(d);
  for (int y = kHole.y; y < kHole.br().y; ++y) {
    for (int x = kHole.x; x < kHole.br().x; ++x) {
      const float around = std::max({d(y, kHole.x - 1), d(y, kHole.br().x), d(kHole.y - 1, x), d(kHole.br().y, x)});
      ASSERT_LE(near.plane.disparity(y, x), around);
    }
  }
}

// The whole chain on rendered images: a slanting wall with an untextured part, beside which an object stands.
TEST(PlaneFill, RenderedWallWithoutTexture) {
  const testing::Texture texture(1), object(2);
  const cv::Size size(280, 160);
  const double d0 = 8, slope = 0.05;
  const cv::Rect blank(80, 40, 100, 80), bar(170, 10, 40, 140);
  constexpr double kNear = 24;
  cv::Mat1b left(size), right(size);
  const auto wall_value = [&](double x, double y) {  // of the left image
    return blank.contains(cv::Point(cvFloor(x), cvFloor(y))) ? 128.0 : texture(x, y);
  };
  for (int y = 0; y < size.height; ++y) {
    for (int x = 0; x < size.width; ++x) {
      left(y, x) = cv::saturate_cast<uchar>(bar.contains({x, y}) ? object(x, y) : wall_value(x, y));
      const bool on_bar = bar.contains({cvRound(x + kNear), y});
      right(y, x) = cv::saturate_cast<uchar>(on_bar ? object(x + kNear, y) : wall_value((x + d0) / (1 - slope), y));
    }
  }
  double errors[2] = {};
  for (const bool plane : {false, true}) {
    MwmfOptions options;
    options.disparities = 48;
    options.extrapolation = plane ? "plane" : "parallel";
    const DisparityImage result = mwmf(left, right, options);
    int count = 0;
    for (int y = blank.y + 8; y < blank.br().y - 8; ++y) {
      for (int x = blank.x; x < bar.x - 20; ++x) {  // where the object begins is not the matter here
        if (result.origin(y, x) != static_cast<uchar>(DisparityOrigin::between_segments)) continue;
        errors[plane] += std::pow(result.disparity(y, x) - (d0 + slope * x), 2);
        ++count;
      }
    }
    EXPECT_GT(count, 3000);
    errors[plane] = std::sqrt(errors[plane] / count);
  }
  RecordProperty("parallel", std::to_string(errors[0]));
  RecordProperty("plane", std::to_string(errors[1]));
  EXPECT_GT(errors[0], 0.8);
  EXPECT_LT(errors[1], 0.15);
}

}  // namespace
}  // namespace iris::stereo
