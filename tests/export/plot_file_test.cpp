#include "export/plot_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <opencv2/imgcodecs.hpp>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "support/temporary_folder.h"

namespace iris::exporters {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

Plot example() {
  PlotSeries line{.name = "estimate & <truth>", .colour = kVermillion};
  for (int i = 0; i <= 100; ++i)
    line.points.emplace_back(0.1 * i, i == 50 ? std::numeric_limits<double>::quiet_NaN() : 5);
  PlotSeries dashed{.name = "dashed", .points = {{0, 0}, {10, 10}}, .style = PlotSeries::Style::dashed};
  PlotSeries dots{.name = "dots", .points = {{2, 8}}, .colour = kGreen, .style = PlotSeries::Style::points};
  PlotSeries bars{.name = "bars", .points = {{7, 2}}, .style = PlotSeries::Style::bars, .bar_width = 1};
  return {.title = "A title", .x_label = "time [s]", .y_label = "error [mm]", .series = {bars, line, dashed, dots}};
}

// Pixels of nearly this colour (lines have soft edges).
int count(const cv::Mat3b& picture, const cv::Vec3b& colour) {
  cv::Mat1b mask;
  const cv::Scalar centre(colour), range = cv::Scalar::all(80);
  cv::inRange(picture, centre - range, centre + range, mask);
  return cv::countNonZero(mask);
}

TEST(PlotFile, PngShowsWhatIsDrawn) {
  const iris::testing::TemporaryFolder folder;
  write_plot(folder.path() / "a.png", example());
  const cv::Mat3b picture = cv::imread((folder.path() / "a.png").string());
  EXPECT_EQ(picture.size(), cv::Size(900, 600));
  EXPECT_GT(count(picture, {0, 94, 213}), 500);  // the line of 600 px, two wide
  EXPECT_GT(count(picture, {115, 158, 0}), 10);
  // The bar stands upon zero and is a tenth of the width and about a fifth of the height.
  const int bar = count(picture, {178, 114, 0});
  EXPECT_GT(bar, 3000);
  EXPECT_LT(bar, 12000);
  write_plot(folder.path() / "b.png", example());
  EXPECT_EQ(read_file(folder.path() / "a.png"), read_file(folder.path() / "b.png"));
}

TEST(PlotFile, SvgKeepsTextAsText) {
  const iris::testing::TemporaryFolder folder;
  write_plot(folder.path() / "a.svg", example());
  const std::string svg = read_file(folder.path() / "a.svg");
  EXPECT_THAT(svg, HasSubstr(">A title</text>"));
  EXPECT_THAT(svg, HasSubstr(">error [mm]</text>"));
  EXPECT_THAT(svg, HasSubstr("estimate &amp; &lt;truth>"));
  EXPECT_THAT(svg, HasSubstr("stroke-dasharray"));
  EXPECT_THAT(svg, Not(HasSubstr("nan")));
  EXPECT_TRUE(svg.ends_with("</svg>\n"));
}

TEST(PlotFile, AnImageKeepsItsPixelsAndItsProportions) {
  const iris::testing::TemporaryFolder folder;
  cv::Mat3b pixels(20, 40, cv::Vec3b(0, 0, 255));
  pixels(cv::Rect(0, 0, 20, 10)) = cv::Vec3b(0, 255, 0);
  const Plot plot{.title = "",
                  .x_label = "",
                  .y_label = "",
                  .image = PlotImage{.pixels = pixels, .left = 0, .right = 40, .bottom = 20, .top = 0},
                  .swatches = {{0xff0000, "red"}},
                  .equal_axes = true,
                  .width = 600,
                  .height = 500};
  write_plot(folder.path() / "a.png", plot);
  const cv::Mat3b picture = cv::imread((folder.path() / "a.png").string());
  const double green = count(picture, {0, 255, 0}), red = count(picture, {0, 0, 255});
  EXPECT_NEAR(red / green, 3, 0.1);
  cv::Mat1b mask;
  cv::inRange(picture, cv::Scalar(0, 255, 0), cv::Scalar(0, 255, 0), mask);
  cv::Mat points;
  cv::findNonZero(mask, points);
  double low_x, high_x;
  cv::Mat xy[2];
  cv::split(points, xy);
  cv::minMaxLoc(xy[0], &low_x, &high_x);
  const double width = high_x - low_x + 1;
  EXPECT_NEAR(green / (width * width), 0.5, 0.02);  // 20 x 10 px: twice as wide as high
  write_plot(folder.path() / "a.svg", plot);
  EXPECT_THAT(read_file(folder.path() / "a.svg"), HasSubstr("data:image/png;base64,iVBORw0KGgo"));
}

TEST(PlotFile, NothingToDrawIsAnEmptyPlot) {
  const iris::testing::TemporaryFolder folder;
  write_plot(folder.path() / "empty.png", {.title = "empty"});
  EXPECT_FALSE(cv::imread((folder.path() / "empty.png").string()).empty());
  PlotSeries one{.name = "one", .points = {{3, 3}}};
  write_plot(folder.path() / "one.svg", {.title = "one", .series = {one}});
  EXPECT_THROW(write_plot(folder.path() / "a.gif", example()), Bug);
  write_file(folder.path() / "file", std::string_view("x"));
  EXPECT_THROW(write_plot(folder.path() / "file" / "a.png", example()), InputError);
}

}  // namespace
}  // namespace iris::exporters
