#include "export/sheet_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdio>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <tuple>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "support/temporary_folder.h"

namespace iris::exporters {
namespace {

using iris::testing::TemporaryFolder;
using ::testing::HasSubstr;

// A room of `width` x `height` m with walls one cell thick, its lower left corner at (-1, 2).
mapping::MapRaster room(double width, double height, double cell = 0.05) {
  mapping::MapRaster raster;
  raster.cell = cell;
  raster.origin_x = -1, raster.origin_y = 2;
  raster.width = static_cast<int>(std::lround(width / cell));
  raster.height = static_cast<int>(std::lround(height / cell));
  raster.layer_bounds = {0, 1, 2};
  raster.U = cv::Mat1f::zeros(raster.height, raster.width);
  cv::rectangle(raster.U, {0, 0, raster.width, raster.height}, 1);
  raster.layer_U = {raster.U.clone(), cv::Mat1f::zeros(raster.height, raster.width)};
  raster.known = cv::Mat1b::ones(raster.height, raster.width);
  raster.state = cv::Mat1b(raster.height, raster.width, static_cast<uint8_t>(mapping::MapState::free));
  raster.state.setTo(static_cast<uint8_t>(mapping::MapState::occupied), raster.U > 0);
  return raster;
}

PoseGraph path() {
  PoseGraph graph;
  for (int i = 0; i < 5; ++i) {
    PoseNode node{.frame_idx = i};
    node.world_from_cam.translation() << 0.5 * i, 3, 1;
    graph.nodes.push_back(node);
  }
  graph.edges.push_back({.i = 0, .j = 4, .kind = PoseEdgeKind::loop});
  return graph;
}

const SheetFacts kFacts{
    .title = "Hall <7> & yard", .date = "2003-07-01T12:00:00Z", .lines = {{"Camera", "640 x 480 px"}, {"Path", "2 m"}}};

std::string output_of(const std::string& command) {
  std::string text;
  FILE* pipe = popen(command.c_str(), "r");
  std::array<char, 4096> buffer;
  while (const size_t n = fread(buffer.data(), 1, buffer.size(), pipe)) text.append(buffer.data(), n);
  EXPECT_EQ(pclose(pipe), 0) << command;
  return text;
}

int count(const cv::Mat3b& picture, const cv::Rect& where, const cv::Vec3b& colour) {
  cv::Mat1b mask;
  const cv::Scalar centre(colour), range = cv::Scalar::all(40);
  cv::inRange(picture(where), centre - range, centre + range, mask);
  return cv::countNonZero(mask);
}

// The outline of the room on the sheet: extent [px] of nearly black pixels above the title block, without the frame.
cv::Rect dark_room(const cv::Mat3b& sheet, double pixels_per_mm, double width_mm, double height_mm) {
  cv::Mat1b dark;
  cv::inRange(sheet, cv::Scalar::all(0), cv::Scalar::all(10), dark);  // cells are black, ink is not quite
  const cv::Rect inside(static_cast<int>(19 * pixels_per_mm), static_cast<int>(9 * pixels_per_mm),
                        static_cast<int>((width_mm - 28) * pixels_per_mm),
                        static_cast<int>((height_mm - 81) * pixels_per_mm));
  cv::Rect room = cv::boundingRect(dark(inside));
  return room + inside.tl();
}

TEST(SheetFile, IsTrueToItsScale) {
  const TemporaryFolder folder;
  // 8 m x 6 m on A4: 80 mm x 60 mm at 1 : 100; it would not fit at 1 : 25, and 1 : 50 takes 160 mm x 120 mm.
  write_sheet(folder.path(), room(8, 6), {}, 0, kFacts, {});
  const cv::Mat3b png = cv::imread((folder.path() / "sheet.png").string());
  const double scale = 200 / 25.4;
  ASSERT_NEAR(png.cols, 297 * scale, 1);  // landscape: the room is wide
  ASSERT_NEAR(png.rows, 210 * scale, 1);
  const cv::Rect found = dark_room(png, scale, 297, 210);
  EXPECT_NEAR(found.width, 160 * scale, 0.005 * 160 * scale);
  EXPECT_NEAR(found.height, 120 * scale, 0.005 * 120 * scale);

  // The PDF, by another program.
  output_of("pdftoppm -r 200 -png " + (folder.path() / "sheet.pdf").string() + " " + (folder.path() / "page").string());
  const cv::Mat3b page = cv::imread((folder.path() / "page-1.png").string());
  ASSERT_FALSE(page.empty());
  const cv::Rect on_page = dark_room(page, scale, 297, 210);
  EXPECT_NEAR(on_page.width, 160 * scale, 0.005 * 160 * scale);
  EXPECT_NEAR(on_page.height, 120 * scale, 0.005 * 120 * scale);
}

// The bar has ink in its first and third quarter and along its edges: its length is the extent of ink in a row through
// the middle of the bar.
double bar_length(const cv::Mat3b& page, double pixels_per_mm, double width_mm, double height_mm) {
  // Title block: 50 mm high, 8 mm from the border; bar: 11 mm + 1.5 text heights below its top, a third of it deeper.
  const int row = static_cast<int>((height_mm - 8 - 50 + 11 + 1.5 * 2.6 + 0.35 * 2.6) * pixels_per_mm);
  const int from = static_cast<int>((width_mm - 8 - 44 + 2) * pixels_per_mm),
            to = static_cast<int>((width_mm - 8 - 1) * pixels_per_mm);
  int first = -1, last = -1;
  for (int x = from; x < to; ++x) {
    if (page(row, x)[0] > 128) continue;
    if (first < 0) first = x;
    last = x;
  }
  return (last - first + 1) / pixels_per_mm - 0.2;  // [mm] without the width of the line
}

TEST(SheetFile, TheScaleBarIsAsLongAsItSays) {
  const TemporaryFolder folder;
  write_sheet(folder.path(), room(8, 6), {}, 0, kFacts, {});
  EXPECT_THAT(read_file(folder.path() / "sheet.svg"), HasSubstr(">1 : 50</text>"));
  EXPECT_THAT(read_file(folder.path() / "sheet.svg"), HasSubstr(">1 m</text>"));
  // 1 m at 1 : 50. A pixel of the PNG is 0.13 mm.
  const cv::Mat3b png = cv::imread((folder.path() / "sheet.png").string());
  EXPECT_NEAR(bar_length(png, 200 / 25.4, 297, 210), 20, 0.1 + 0.005 * 20);
  // Right to 0.5 % on every paper, by another program that has pixels fine enough.
  for (const auto& [paper, width, height] : {std::tuple("a4", 297, 210.0), std::tuple("a3", 420, 297.0)}) {
    write_sheet(folder.path(), room(8, 6), {}, 0, kFacts, {.paper = paper, .scale = 50});
    output_of("pdftoppm -r 400 -gray " + (folder.path() / "sheet.pdf").string() + " " +
              (folder.path() / "page").string());
    const cv::Mat3b page = cv::imread((folder.path() / "page-1.pgm").string());
    ASSERT_FALSE(page.empty());
    EXPECT_NEAR(bar_length(page, 400 / 25.4, width, height), 20, 0.005 * 20) << paper;
  }
}

TEST(SheetFile, PapersHaveTheirSize) {
  const TemporaryFolder folder;
  for (const auto& [paper, size] :
       {std::pair("a4", "841.89 x 595.276 pts (A4)"), std::pair("a3", "1190.55 x 841.89 pts (A3)"),
        std::pair("letter", "792 x 612 pts (letter)")}) {
    write_sheet(folder.path(), room(8, 6), {}, 0, kFacts, {.paper = paper, .orientation = "landscape"});
    EXPECT_THAT(output_of("pdfinfo " + (folder.path() / "sheet.pdf").string()), HasSubstr(size));
  }
  write_sheet(folder.path(), room(8, 6), {}, 0, kFacts, {.paper = "letter", .orientation = "portrait"});
  EXPECT_THAT(output_of("pdfinfo " + (folder.path() / "sheet.pdf").string()), HasSubstr("612 x 792 pts (letter)"));
}

// Every line of the title block can be found, however many there are and however long, and none reaches into the
// legend.
TEST(SheetFile, LongTitleBlocksFit) {
  const TemporaryFolder folder;
  SheetFacts facts = kFacts;
  for (int i = 0; i < 6; ++i) facts.title += " and the hall of " + std::to_string(1990 + i);
  facts.lines.clear();
  for (int i = 0; i < 14; ++i) facts.lines.emplace_back("Name " + std::to_string(i), "value " + std::to_string(i));
  facts.lines.emplace_back("Session", facts.title + facts.title);
  mapping::MapRaster many_layers = room(8, 6);
  for (int k = 0; k < 12; ++k)
    many_layers.layer_U.push_back(many_layers.layer_U.back()), many_layers.layer_bounds.push_back(3 + k);
  write_sheet(folder.path(), many_layers, path(), 0, facts,
              {.orientation = "portrait", .cells = "heights", .note = "drawn by M"});
  const std::string text = output_of("pdftotext -layout " + (folder.path() / "sheet.pdf").string() + " -");
  EXPECT_THAT(text, HasSubstr(facts.title));
  EXPECT_THAT(text, HasSubstr(facts.lines.back().second));
  EXPECT_THAT(text, HasSubstr("drawn by M"));
  EXPECT_THAT(text, HasSubstr("z 13.00 to 14.00 m"));
  EXPECT_THAT(text, HasSubstr("closed loops (1)"));
  for (int i = 0; i < 14; ++i) EXPECT_THAT(text, HasSubstr("value " + std::to_string(i)));
  // Ink within the block's frame only: below it the margin is white, and the line between facts and legend is not
  // crossed (2 mm beside it stay white).
  const cv::Mat3b png = cv::imread((folder.path() / "sheet.png").string());
  const double scale = 200 / 25.4;
  const cv::Mat3b below = png.rowRange(static_cast<int>((297 - 7.5) * scale), png.rows);
  EXPECT_EQ(cv::countNonZero(below.reshape(1) < 250), 0);
  const cv::Rect beside(static_cast<int>((210 - 8 - 88 + 0.5) * scale), static_cast<int>((297 - 57) * scale),
                        static_cast<int>(1.5 * scale), static_cast<int>(48 * scale));
  EXPECT_EQ(cv::countNonZero(png(beside).clone().reshape(1) < 250), 0);
}

// A square of 10 m whose chain turns a little too far: the loop between first and last frame sees the way that the
// chain misses.
TEST(SheetFile, ClosingErrorIsThatOfTheLongestLoop) {
  PoseGraph odometry;
  Pose pose = Pose::Identity();
  for (int k = 0; k <= 40; ++k) {
    odometry.nodes.push_back({.frame_idx = 2 * k, .world_from_cam = pose});
    if (k > 0 && k % 10 == 0) pose.rotate(Eigen::AngleAxisd(M_PI / 2, Eigen::Vector3d::UnitZ()));
    pose.translate(Eigen::Vector3d(k < 10 ? 1.003 : 1, 0, 0));  // the first side is 3 cm too long
  }
  PoseGraph refined = odometry;
  EXPECT_FALSE(closing_error(odometry, refined, 0));
  // Around once: the true motion is a turn by 3/4 of a circle (the last one lies behind frame 80), no shift.
  Pose truth = Pose::Identity();
  truth.rotate(Eigen::AngleAxisd(3 * M_PI / 2, Eigen::Vector3d::UnitZ()));
  Matrix6d information = Matrix6d::Identity();
  information.diagonal().head<3>() << 1e4, 2.5e3, 1e4;  // 1, 2 and 1 cm
  refined.edges.push_back({.i = 0, .j = 80, .i_from_j = truth, .information = information, .kind = PoseEdgeKind::loop});
  refined.edges.push_back({.i = 20, .j = 40, .kind = PoseEdgeKind::loop});
  refined.edges.push_back({.i = 2, .j = 4, .kind = PoseEdgeKind::odometry});
  const auto error = closing_error(odometry, refined, 0);
  ASSERT_TRUE(error);
  EXPECT_EQ(error->i, 0);
  EXPECT_EQ(error->j, 80);
  EXPECT_EQ(error->loops, 2);
  EXPECT_NEAR(error->error, 0.03, 1e-9);
  EXPECT_NEAR(error->sigma, 0.01 * std::sqrt(6), 1e-9);
  EXPECT_NEAR(error->way, 40.03, 1e-9);
  // Views that see the same things from along a straight side do not close anything.
  PoseGraph straight = odometry;
  straight.edges.push_back({.i = 0, .j = 18, .kind = PoseEdgeKind::loop});
  straight.edges[0].i_from_j.translation().x() = 9;
  EXPECT_FALSE(closing_error(odometry, straight, 0));
  // Chains that only a loop joined have no closing error.
  for (size_t k = 5; k < odometry.nodes.size(); ++k) odometry.nodes[k].submap = 1;
  refined.edges.erase(refined.edges.begin() + 1);
  EXPECT_FALSE(closing_error(odometry, refined, 0));
}

TEST(SheetFile, TextCanBeSearchedInPdfAndSvg) {
  const TemporaryFolder folder;
  write_sheet(folder.path(), room(8, 6), path(), 0, kFacts, {});
  const std::string text = output_of("pdftotext -layout " + (folder.path() / "sheet.pdf").string() + " -");
  for (const char* part : {"Hall <7> & yard", "640 x 480 px", "1 : 50", "camera path", "closed loops (1)", "unknown"}) {
    EXPECT_THAT(text, HasSubstr(part));
  }
  const std::string info = output_of("pdfinfo " + (folder.path() / "sheet.pdf").string());
  EXPECT_THAT(info, HasSubstr("A4"));
  EXPECT_THAT(info, HasSubstr("Hall <7> & yard"));
  const std::string svg = read_file(folder.path() / "sheet.svg");
  EXPECT_THAT(svg, HasSubstr("width=\"297mm\" height=\"210mm\" viewBox=\"0 0 297 210\""));
  EXPECT_THAT(svg, HasSubstr(">Hall &lt;7> &amp; yard</text>"));
  EXPECT_THAT(svg, HasSubstr(">640 x 480 px</text>"));
}

TEST(SheetFile, PaperOrientationScaleAndContentsFollowTheOptions) {
  const TemporaryFolder folder;
  write_sheet(folder.path(), room(8, 6), path(), 0, kFacts,
              {.paper = "a3", .orientation = "portrait", .scale = 200, .grid = false, .path = false, .title = "Plan"});
  const std::string svg = read_file(folder.path() / "sheet.svg");
  EXPECT_THAT(svg, HasSubstr("width=\"297mm\" height=\"420mm\""));
  EXPECT_THAT(svg, HasSubstr(">1 : 200</text>"));
  EXPECT_THAT(svg, HasSubstr(">Plan</text>"));
  EXPECT_THAT(svg, ::testing::Not(HasSubstr("camera path")));
  const cv::Mat3b png = cv::imread((folder.path() / "sheet.png").string());
  EXPECT_EQ(count(png, {0, 0, png.cols, png.rows}, {0, 94, 213}), 0);  // vermillion
  const std::string info = output_of("pdfinfo " + (folder.path() / "sheet.pdf").string());
  EXPECT_THAT(info, HasSubstr("A3"));
  // The path without its loops.
  write_sheet(folder.path(), room(8, 6), path(), 0, kFacts, {.loops = false});
  EXPECT_THAT(read_file(folder.path() / "sheet.svg"),
              ::testing::AllOf(HasSubstr("camera path"), ::testing::Not(HasSubstr("closed loops"))));
  // Letter, heights: the lower layer's dark blue stands for the walls.
  write_sheet(folder.path(), room(8, 6), path(), 0, kFacts, {.paper = "letter", .cells = "heights"});
  EXPECT_THAT(read_file(folder.path() / "sheet.svg"), HasSubstr(">z 0.00 to 1.00 m</text>"));
  const cv::Mat3b letter = cv::imread((folder.path() / "sheet.png").string());
  EXPECT_GT(count(letter, {0, 0, letter.cols, letter.rows}, {107, 42, 27}), 1000);
}

TEST(SheetFile, UnknownSurroundingsDoNotShrinkTheMap) {
  const TemporaryFolder folder;
  mapping::MapRaster raster = room(40, 40, 0.1);
  // Known is only a room of 8 m x 6 m in its middle.
  raster.known = 0;
  raster.state = 0;
  raster.known(cv::Rect(160, 170, 80, 60)) = 1;
  write_sheet(folder.path(), raster, {}, 0, kFacts, {});
  EXPECT_THAT(read_file(folder.path() / "sheet.svg"), HasSubstr(">1 : 50</text>"));
}

TEST(SheetFile, AScaleThatIsTooLargeIsRefusedWithOneThatFits) {
  const TemporaryFolder folder;
  try {
    write_sheet(folder.path(), room(40, 30), {}, 0, kFacts, {.scale = 50});
    FAIL() << "40 m at 1 : 50 are 80 cm";
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), HasSubstr("--sheet.scale 250"));
  }
  EXPECT_FALSE(std::filesystem::exists(folder.path() / "sheet.pdf"));
}

TEST(SheetFile, TheSameInputGivesTheSameBytes) {
  const TemporaryFolder folder;
  for (const char* name : {"a", "b"}) write_sheet(folder.path() / name, room(8, 6), path(), 0, kFacts, {});
  for (const char* file : {"sheet.pdf", "sheet.svg", "sheet.png"}) {
    EXPECT_EQ(read_file(folder.path() / "a" / file), read_file(folder.path() / "b" / file)) << file;
  }
}

}  // namespace
}  // namespace iris::exporters
