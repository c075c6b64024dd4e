#include "export/video_file.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <opencv2/imgproc.hpp>
#include <opencv2/videoio.hpp>

#include "iris/core/error.h"

namespace iris::exporters {
namespace {
namespace fs = std::filesystem;

class VideoFile : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::temp_directory_path() / ("iris_video_" + std::to_string(getpid()));
    fs::remove_all(folder_);
    fs::create_directories(folder_);
  }
  void TearDown() override { fs::remove_all(folder_); }
  size_t files() const { return static_cast<size_t>(std::distance(fs::directory_iterator(folder_), {})); }

  fs::path folder_;
};

cv::Mat3b frame(int i) { return cv::Mat3b(96, 160, cv::Vec3b(static_cast<uint8_t>(20 + 8 * i), 100, 180)); }

TEST_F(VideoFile, ComesBackFrameByFrame) {
  const fs::path path = folder_ / "new" / "tour.mp4";
  VideoWriter writer(path, 160, 96, 10);
  constexpr int kFrames = 23;
  for (int i = 0; i < kFrames; ++i) writer.add(frame(i));
  EXPECT_FALSE(fs::exists(path));
  writer.close();
  cv::VideoCapture video(path.string(), cv::CAP_FFMPEG);
  ASSERT_TRUE(video.isOpened());
  EXPECT_EQ(static_cast<int>(video.get(cv::CAP_PROP_FRAME_WIDTH)), 160);
  EXPECT_EQ(static_cast<int>(video.get(cv::CAP_PROP_FRAME_HEIGHT)), 96);
  EXPECT_NEAR(video.get(cv::CAP_PROP_FPS), 10, 1e-6);
  int frames = 0;
  for (cv::Mat image; video.read(image); ++frames) {
    const cv::Scalar mean = cv::mean(image);
    // 8-bit YCbCr with limited range and half the colour resolution: a few grey levels.
    EXPECT_NEAR(mean[0], 20 + 8 * frames, 6);
    EXPECT_NEAR(mean[1], 100, 4);
    EXPECT_NEAR(mean[2], 180, 6);
  }
  EXPECT_EQ(frames, kFrames);
  EXPECT_EQ(std::distance(fs::directory_iterator(path.parent_path()), {}), 1);
}

// The index stands before the pictures, and its offsets lead to them: the file was read back above.
TEST_F(VideoFile, BeginsToPlayWhileItLoads) {
  const fs::path path = folder_ / "tour.mp4";
  VideoWriter writer(path, 160, 96, 10);
  for (int i = 0; i < 9; ++i) writer.add(frame(i));
  writer.close();
  std::ifstream file(path, std::ios::binary);
  const std::string bytes(std::istreambuf_iterator<char>(file), {});
  std::vector<std::string> boxes;
  for (size_t at = 0; at + 8 <= bytes.size();) {
    const auto byte = [&](size_t i) { return static_cast<uint32_t>(static_cast<unsigned char>(bytes[at + i])); };
    const uint32_t size = byte(0) << 24 | byte(1) << 16 | byte(2) << 8 | byte(3);
    boxes.push_back(bytes.substr(at + 4, 4));
    ASSERT_GE(size, 8u);
    at += size;
  }
  const auto moov = std::find(boxes.begin(), boxes.end(), "moov"), mdat = std::find(boxes.begin(), boxes.end(), "mdat");
  ASSERT_NE(moov, boxes.end());
  ASSERT_NE(mdat, boxes.end());
  EXPECT_LT(moov - boxes.begin(), mdat - boxes.begin());
  EXPECT_EQ(boxes.front(), "ftyp");
  EXPECT_EQ(files(), 1u);
  // Nothing is left to do for a file that is in order, or is none.
  EXPECT_FALSE(write_fast_start(path, folder_ / "again.mp4"));
  std::ofstream(folder_ / "text.mp4") << "no video at all";
  EXPECT_FALSE(write_fast_start(folder_ / "text.mp4", folder_ / "again.mp4"));
  EXPECT_FALSE(fs::exists(folder_ / "again.mp4"));
}

TEST_F(VideoFile, WebmIsVp9) {
  const fs::path path = folder_ / "tour.webm";
  VideoWriter writer(path, 160, 96, 10);
  constexpr int kFrames = 17;
  for (int i = 0; i < kFrames; ++i) writer.add(frame(i));
  writer.close();
  cv::VideoCapture video(path.string(), cv::CAP_FFMPEG);
  ASSERT_TRUE(video.isOpened());
  std::ifstream file(path, std::ios::binary);
  const std::string bytes(std::istreambuf_iterator<char>(file), {});
  EXPECT_NE(bytes.find("V_VP9"), std::string::npos);  // Matroska's name of the codec
  int frames = 0;
  for (cv::Mat image; video.read(image); ++frames) EXPECT_NEAR(cv::mean(image)[0], 20 + 8 * frames, 8);
  EXPECT_EQ(frames, kFrames);
  EXPECT_EQ(files(), 1u);
}

TEST_F(VideoFile, IsH264InYuv420) {
  const fs::path path = folder_ / "tour.mp4";
  VideoWriter writer(path, 160, 96, 10);
  for (int i = 0; i < 5; ++i) writer.add(frame(i));
  writer.close();
  cv::VideoCapture video(path.string(), cv::CAP_FFMPEG);
  const int code = static_cast<int>(video.get(cv::CAP_PROP_FOURCC));
  EXPECT_TRUE(code == cv::VideoWriter::fourcc('h', '2', '6', '4') ||
              code == cv::VideoWriter::fourcc('a', 'v', 'c', '1'));
  const int format = static_cast<int>(video.get(cv::CAP_PROP_CODEC_PIXEL_FORMAT));
  EXPECT_EQ(format, cv::VideoWriter::fourcc('I', '4', '2', '0'));
}

TEST_F(VideoFile, TheSameFramesGiveTheSameFile) {
  std::string bytes[2];
  for (std::string& content : bytes) {
    const fs::path path = folder_ / "tour.mp4";
    VideoWriter writer(path, 160, 96, 10);
    for (int i = 0; i < 12; ++i) writer.add(frame(i));
    writer.close();
    std::ifstream file(path, std::ios::binary);
    content.assign(std::istreambuf_iterator<char>(file), {});
  }
  EXPECT_FALSE(bytes[0].empty());
  EXPECT_EQ(bytes[0], bytes[1]);
}

// Whatever is in the memory that the encoder gets: x264 looks at some that it has not written.
TEST_F(VideoFile, WhatMemoryHeldBeforeDoesNotMatter) {
  std::vector<cv::Mat3b> pictures;
  cv::RNG random(3);
  cv::Mat3b noise(120, 160);
  random.fill(noise, cv::RNG::UNIFORM, 0, 256);
  cv::GaussianBlur(noise, noise, {0, 0}, 3);
  cv::normalize(noise, noise, 0, 255, cv::NORM_MINMAX);
  for (int i = 0; i < 11; ++i) {
    const cv::Matx23d moved(1 + 0.02 * i, 0.01 * i, -2.3 * i, -0.01 * i, 1 + 0.02 * i, 1.1 * i);
    cv::Mat3b picture;
    cv::warpAffine(noise, picture, moved, noise.size());
    pictures.push_back(picture);
  }
  std::string first;
  for (const int left : {0, 77, 165, 254}) {
    std::vector<std::vector<char>> blocks;
    for (int i = 0; i < 300; ++i)
      blocks.emplace_back(size_t{1000} * static_cast<size_t>(i + 1), static_cast<char>(left));
    blocks.clear();
    VideoWriter writer(folder_ / "tour.mp4", 160, 120, 10);
    for (const cv::Mat3b& picture : pictures) writer.add(picture);
    writer.close();
    std::ifstream file(folder_ / "tour.mp4", std::ios::binary);
    const std::string bytes(std::istreambuf_iterator<char>(file), {});
    if (first.empty()) first = bytes;
    EXPECT_TRUE(bytes == first) << left;
  }
}

TEST_F(VideoFile, WithoutCloseNothingIsLeft) {
  {
    VideoWriter writer(folder_ / "tour.mp4", 160, 96, 10);
    writer.add(frame(0));
  }
  EXPECT_EQ(files(), 0u);
}

TEST_F(VideoFile, BadTargetsAreNamed) {
  EXPECT_THROW(VideoWriter(folder_ / "tour.mp4", 161, 96, 10), UsageError);
  EXPECT_THROW(VideoWriter(folder_ / "tour.avi", 160, 96, 10), UsageError);
  std::ofstream(folder_ / "file") << "x";
  try {
    VideoWriter writer(folder_ / "file" / "tour.mp4", 160, 96, 10);
    FAIL();
  } catch (const InputError& error) {
    EXPECT_NE(std::string(error.what()).find("file"), std::string::npos);
  }
}

}  // namespace
}  // namespace iris::exporters
