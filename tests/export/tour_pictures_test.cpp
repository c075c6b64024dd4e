// Depth files, frame folders, captions, fades and the layout side by side.
#include <gtest/gtest.h>

#include <cstdlib>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <random>

#include "export/depth_file.h"
#include "export/frame_folder.h"
#include "export/tour_picture.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "support/temporary_folder.h"

namespace iris::exporters {
namespace {

namespace fs = std::filesystem;
using testing::TemporaryFolder;

cv::Mat1f some_depth() {
  cv::Mat1f depth(37, 53);
  std::mt19937 random(1);
  for (float& d : depth) {
    const unsigned kind = random() % 5;
    d = kind == 0 ? 0.0f : static_cast<float>(random() % 1'000'000) / 20'000.0f + 0.0001f;
  }
  depth(0, 0) = 70.0f;
  depth(0, 1) = std::numeric_limits<float>::quiet_NaN();
  depth(0, 2) = 0.0002f;
  return depth;
}

CameraPath ten_seconds() {
  CameraPath path;
  path.keyframes = {{.t = 0}, {.t = 10}};
  return path;
}

TEST(DepthFile, PngHoldsMillimetres) {
  const cv::Mat1f depth = some_depth();
  const cv::Mat1w read = cv::imdecode(encode_depth_png(depth), cv::IMREAD_UNCHANGED);
  ASSERT_EQ(read.size(), depth.size());
  EXPECT_EQ(read(0, 0), 65535);
  EXPECT_EQ(read(0, 1), 0);
  EXPECT_EQ(read(0, 2), 1);  // known, therefore not 0
  for (int y = 1; y < depth.rows; ++y) {
    for (int x = 0; x < depth.cols; ++x) {
      if (depth(y, x) == 0) {
        EXPECT_EQ(read(y, x), 0);
      } else {
        EXPECT_NEAR(read(y, x), 1000 * depth(y, x), 0.501);
      }
    }
  }
}

TEST(DepthFile, ExrComesBackBitByBit) {
  setenv("OPENCV_IO_ENABLE_OPENEXR", "1", 1);  // OpenCV reads it on request only
  const cv::Mat1f depth = some_depth();
  const std::vector<unsigned char> bytes = encode_depth_exr(depth);
  cv::Mat read;
  try {
    read = cv::imdecode(bytes, cv::IMREAD_UNCHANGED);
  } catch (const cv::Exception&) {
  }
  if (read.empty()) {
    TemporaryFolder folder;
    write_file(folder.path() / "depth.exr", bytes);
    const std::string raw = (folder.path() / "depth.raw").string();
    if (std::system("ffmpeg -version >/dev/null 2>&1") != 0) GTEST_SKIP() << "skipped: no foreign reader of EXR here";
    ASSERT_EQ(std::system(("ffmpeg -v error -i '" + (folder.path() / "depth.exr").string() +
                           "' -f rawvideo -pix_fmt grayf32le '" + raw + "'")
                              .c_str()),
              0);
    const std::string values = read_file(raw);
    ASSERT_EQ(values.size(), depth.total() * 4);
    read = cv::Mat(depth.size(), CV_32F);
    std::memcpy(read.data, values.data(), values.size());
  }
  ASSERT_EQ(read.size(), depth.size());
  ASSERT_EQ(read.depth(), CV_32F);
  cv::Mat1f one = read;
  if (read.channels() > 1) cv::extractChannel(read, one, 0);
  for (int y = 0; y < depth.rows; ++y) {
    for (int x = 0; x < depth.cols; ++x) {
      if (depth(y, x) == depth(y, x)) {
        EXPECT_EQ(one(y, x), depth(y, x)) << x << " " << y;
      }
    }
  }
}

TEST(FrameFolder, KeepsItsOwnFramesAndNoOthers) {
  TemporaryFolder folder;
  const fs::path path = folder.path() / "a/frames";
  const cv::Mat3b image(8, 8, cv::Vec3b(1, 2, 3));
  const cv::Mat1f depth(8, 8, 1.5f);
  const FrameFormat format{.depth_png = true, .depth_exr = true};
  {
    const FrameFolder frames(path, {{"fingerprint", "one"}}, format);
    EXPECT_FALSE(frames.has(3));
    frames.write(3, image, depth);
    EXPECT_TRUE(frames.has(3));
    EXPECT_EQ(cv::norm(frames.read(3), image), 0);
    EXPECT_TRUE(fs::exists(path / "depth/000003.png") && fs::exists(path / "depth/000003.exr"));
    write_file(path / ".tmp.12345.000004.png", "half a picture");
  }
  {
    const FrameFolder same(path, {{"fingerprint", "one"}}, format);
    EXPECT_TRUE(same.has(3));
    EXPECT_FALSE(fs::exists(path / ".tmp.12345.000004.png"));
  }
  {
    write_file(path / "000003.png", "no picture");
    const FrameFolder same(path, {{"fingerprint", "one"}}, format);
    EXPECT_THROW(same.read(3), InputError);
    write_file(path / "notes.txt", "kept");
    const FrameFolder other(path, {{"fingerprint", "two"}}, {.jpeg = true});
    EXPECT_FALSE(fs::exists(path / "000003.png"));
    EXPECT_FALSE(fs::exists(path / "depth/000003.png"));
    other.write(0, image, depth);
    EXPECT_TRUE(fs::exists(path / "000000.jpg"));
    EXPECT_FALSE(fs::exists(path / "depth/000000.png"));
  }
  FrameFolder::remove(path);
  EXPECT_TRUE(fs::exists(path / "notes.txt"));  // not ours
  EXPECT_EQ(std::distance(fs::directory_iterator(path), {}), 1);
  EXPECT_THROW(FrameFolder(path, {{"fingerprint", "one"}}, format), InputError);
}

TEST(Captions, AreWhiteOnADarkBandAtTheLowerBorder) {
  const cv::Mat1b mask = text_mask("The hall: 3.20 m \u00b2", 20);
  EXPECT_GT(cv::countNonZero(mask > 128), 200);
  cv::Mat3b image(240, 320, cv::Vec3b(100, 120, 140));
  draw_caption(image, mask);
  EXPECT_EQ(image(100, 100), cv::Vec3b(100, 120, 140));
  EXPECT_EQ(image(239, 2), cv::Vec3b(45, 54, 63));
  double brightest = 0;
  cv::minMaxLoc(image.reshape(1), nullptr, &brightest);
  EXPECT_EQ(brightest, 255);
  // Narrow pictures cut it.
  cv::Mat3b narrow(240, 16, cv::Vec3b(100, 100, 100));
  draw_caption(narrow, mask);
}

TEST(Fade, IsBlackAtBothEnds) {
  EXPECT_EQ(fade_level(0, 10, 2), 0);
  EXPECT_EQ(fade_level(1, 10, 2), 0.5);
  EXPECT_EQ(fade_level(5, 10, 2), 1);
  EXPECT_EQ(fade_level(9.5, 10, 2), 0.25);
  EXPECT_EQ(fade_level(10, 10, 2), 0);
  EXPECT_EQ(fade_level(0, 10, 0), 1);
  EXPECT_EQ(fade_level(1, 2, 5), 1);
}

// A map with a free square of 4 x 3 m: the cameras must be drawn where they are, and open to where they look.
TEST(SideBySide, ShowsRecordedImageMapAndNovelView) {
  mapping::MapRaster raster{.cell = 0.05, .origin_x = -2, .origin_y = -1, .width = 80, .height = 60};
  raster.state = cv::Mat1b(60, 80, static_cast<uint8_t>(mapping::MapState::free));
  raster.known = cv::Mat1b(60, 80, static_cast<uint8_t>(1));
  raster.M = raster.U = cv::Mat1f(60, 80, 0.0f);
  raster.layer_bounds = {0.1, 1.9};
  raster.layer_M = raster.layer_U = {cv::Mat1f(60, 80, 0.0f)};
  raster.layer_state = {raster.state};
  PoseGraph graph;
  graph.nodes.push_back({.world_from_cam = tour::looking({-1, 0, 1.4}, {1, 0, 0})});
  const RectifiedCamera recording{.f = 100, .cx = 79.5, .cy = 59.5, .baseline = 0.1, .width = 160, .height = 120};
  tour::TourOptions options;
  options.layout = "side-by-side";
  options.width = 320;
  options.height = 240;
  options.fade = 1;
  const TourPicture picture(options, &raster, graph, 0, recording, {}, ten_seconds());
  const cv::Size size = picture.size();
  EXPECT_EQ(size.height, 240);
  EXPECT_EQ(size.width % 2, 0);
  EXPECT_EQ(size.width, 320 + 320 + 320 + 8);  // recorded 4:3, map 4:3, novel view, gaps

  tour::TourFrame frame{.seconds = 5};
  frame.world_from_recording = tour::looking({-1, 0, 1.4}, {1, 0, 0});
  frame.camera = {.width = 320,
                  .height = 240,
                  .f = 300,
                  .cx = 159.5,
                  .cy = 119.5,
                  .world_from_cam = tour::looking({1, 1, 1.4}, {0, -1, 0})};
  NovelView view{.image = cv::Mat3b(240, 320, cv::Vec3b(0, 255, 255)), .depth = {}, .source = {}};
  const cv::Mat1b recorded(120, 160, static_cast<uint8_t>(77));
  const cv::Mat3b image = picture.compose(frame, 5, view, recorded);
  ASSERT_EQ(image.size(), size);
  EXPECT_EQ(image(120, 100), cv::Vec3b(77, 77, 77));
  EXPECT_EQ(image(120, size.width - 100), cv::Vec3b(0, 255, 255));
  // The map fills 96 % of its panel: 76.8 px a metre, its middle (0, 0.5) in the middle of the panel.
  const auto map_pixel = [&](double x, double y) {
    return image(static_cast<int>(120 - (y - 0.5) * 76.8), static_cast<int>(324 + 160 + x * 76.8));
  };
  const auto red = [](const cv::Vec3b& c) { return c[2] > c[0] + 30; };
  const auto blue = [](const cv::Vec3b& c) { return c[0] > c[2] + 30; };
  EXPECT_TRUE(red(map_pixel(-1, 0)));
  EXPECT_TRUE(red(map_pixel(-0.75, 0)));   // in front of it
  EXPECT_FALSE(red(map_pixel(-1.25, 0)));  // behind it
  EXPECT_TRUE(blue(map_pixel(1, 1)));
  EXPECT_TRUE(blue(map_pixel(1, 0.75)));
  EXPECT_FALSE(blue(map_pixel(1, 1.25)));
  EXPECT_EQ(map_pixel(0.2, 1.5), cv::Vec3b(255, 255, 255));  // free

  // Half a second after the beginning it is half as bright.
  frame.seconds = 0.5;
  EXPECT_NEAR(picture.compose(frame, 0.5, view, recorded)(120, 100)[0], 38.5, 1);
}

TEST(Captions, StandFromTheirTimeToTheNextOne) {
  tour::TourOptions options;
  options.width = 160;
  options.height = 120;
  const TourPicture picture(options, nullptr, {}, 0, {}, {{2, "first"}, {4, ""}, {6, "second"}}, ten_seconds());
  NovelView view{.image = cv::Mat3b(120, 160, cv::Vec3b(0, 0, 200)), .depth = {}, .source = {}};
  const auto has_caption = [&](double t) { return picture.compose({}, t, view, {})(119, 1)[2] != 200; };
  EXPECT_FALSE(has_caption(1.9));
  EXPECT_TRUE(has_caption(2));
  EXPECT_TRUE(has_caption(3.9));
  EXPECT_FALSE(has_caption(4.1));
  EXPECT_TRUE(has_caption(9));
}

}  // namespace
}  // namespace iris::exporters
