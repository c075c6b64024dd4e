#include "iris/session/session.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "support/temporary_folder.h"
#include "support/test_data.h"

namespace iris::session {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

// Left images are 10 + number, right ones 110 + number: what comes back tells which file was read.
class SessionTest : public ::testing::Test {
 protected:
  fs::path at(const std::string& name) const { return folder_.path() / name; }

  void image(const std::string& name, double grey, int type = CV_8UC1, cv::Size size = {64, 48}) {
    fs::create_directories(at(name).parent_path());
    ASSERT_TRUE(cv::imwrite(at(name).string(), cv::Mat(size, type, cv::Scalar::all(grey))));
  }
  void folders(const std::string& left, const std::string& right, int count) {
    for (int i = 0; i < count; ++i) {
      image(fmt::format("{}/{:06}.png", left, i), 10 + i);
      image(fmt::format("{}/{:06}.png", right, i), 110 + i);
    }
  }
  void opencv_calibration(const std::string& name, int width = 64, int height = 48,
                          const std::string& T = "-0.1, 0, 0") {
    const std::string K = " [50, 0, 32, 0, 50, 24, 0, 0, 1]\n";
    write_file(at(name),
               fmt::format("image_width: {}\nimage_height: {}\nM1:{}M2:{}R: [1, 0, 0, 0, 1, 0, 0, 0, 1]\nT: [{}]\n",
                           width, height, K, K, T));
  }
  std::unique_ptr<Session> open(const SessionOptions& options = {}) { return open_session(folder_.path(), options); }
  std::string error_of(const SessionOptions& options = {}) {
    try {
      open(options);
    } catch (const InputError& error) {
      return error.what();
    }
    return "";
  }
  static int grey(const cv::Mat& image) { return static_cast<int>(cv::mean(image)[0] + 0.5); }
  static void expect_frames(const Session& session, const std::vector<int>& numbers) {
    ASSERT_EQ(session.size(), static_cast<int>(numbers.size()));
    for (int i = 0; i < session.size(); ++i) {
      const StereoFrame frame = session.read(i);
      EXPECT_EQ(frame.frame_idx, i);
      EXPECT_EQ(frame.stamp_ns, session.stamp_ns(i));
      EXPECT_EQ(grey(frame.left), 10 + numbers[static_cast<size_t>(i)]);
      EXPECT_EQ(grey(frame.right), 110 + numbers[static_cast<size_t>(i)]);
    }
  }

  iris::testing::TemporaryFolder folder_;
};

// --- layouts

const char* const kKitti =
    "P0: 50 0 32 0 0 50 24 0 0 0 1 0\nP1: 50 0 32 -5 0 50 24 0 0 0 1 0\n"
    "P2: 60 0 32 0 0 60 24 0 0 0 1 0\nP3: 60 0 32 -12 0 60 24 0 0 0 1 0\n";

TEST_F(SessionTest, KittiGrey) {
  folders("image_0", "image_1", 4);
  write_file(at("calib.txt"), kKitti);
  write_file(at("poses.txt"), "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 1\n");
  write_file(at("times.txt"), "0\n0.1\n0.21\n0.3\n");
  const auto session = open();
  EXPECT_EQ(session->kind(), "KITTI odometry");
  EXPECT_THAT(session->notes(), IsEmpty());
  EXPECT_TRUE(session->random_access());
  expect_frames(*session, {0, 1, 2, 3});
  EXPECT_EQ(session->stamp_ns(2), 210000000);
  EXPECT_EQ(session->frame_name(2), "000002.png");
  EXPECT_EQ(session->calibration().left.K(0, 0), 50);
  EXPECT_EQ(session->calibration().left.width, 64);  // from the images: KITTI does not store it
  EXPECT_TRUE(session->calibration().rectified);
  EXPECT_EQ(session->folder(), folder_.path());
}

TEST_F(SessionTest, KittiColourGoesFirstAndNominalRateIsNoted) {
  folders("image_0", "image_1", 2);
  for (int i = 0; i < 2; ++i) {
    image(fmt::format("image_2/{:06}.png", i), 30 + i, CV_8UC3);
    image(fmt::format("image_3/{:06}.png", i), 130 + i, CV_8UC3);
  }
  write_file(at("calib.txt"), kKitti);
  const auto colour = open();
  EXPECT_EQ(colour->calibration().left.K(0, 0), 60);
  EXPECT_EQ(colour->read(1).left.type(), CV_8UC3);
  EXPECT_EQ(grey(colour->read(1).right), 131);
  EXPECT_EQ(colour->stamp_ns(1), 100000000);
  EXPECT_THAT(colour->notes(), Contains(HasSubstr("10 frames a second are assumed")));
  EXPECT_THAT(colour->notes(), Contains(HasSubstr("colour pair is used")));
  SessionOptions options;
  options.pair = "grey";
  options.rate = 4;
  const auto grey_pair = open(options);
  EXPECT_EQ(grey_pair->calibration().left.K(0, 0), 50);
  EXPECT_EQ(grey_pair->stamp_ns(1), 250000000);
  EXPECT_THAT(grey_pair->notes(), IsEmpty());
}

TEST_F(SessionTest, KittiCutOutOfALongerRecordingTakesTimesByNumber) {
  for (int i = 5; i < 8; ++i) {
    image(fmt::format("image_0/{:06}.png", i), 10 + i);
    image(fmt::format("image_1/{:06}.png", i), 110 + i);
  }
  write_file(at("calib.txt"), kKitti);
  write_file(at("times.txt"), "0\n1\n2\n3\n4\n5.5\n6.5\n7.5\n8.5\n");
  EXPECT_EQ(open()->stamp_ns(0), 5500000000);
  write_file(at("times.txt"), "0\n1\n2\n3\n4\n5\n");
  EXPECT_THAT(error_of(), HasSubstr("6 times for 3 left images and none for frame 6"));
}

TEST_F(SessionTest, SnippetWithKittiCalibrationAndColourImages) {
  for (int i = 0; i < 2; ++i) {
    image(fmt::format("image_l/{:06}.png", i), 10 + i, CV_8UC3);
    image(fmt::format("image_r/{:06}.png", i), 110 + i, CV_8UC3);
  }
  write_file(at("calib.txt"), kKitti);
  write_file(at("poses.txt"), "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 1\n");
  const auto session = open();
  EXPECT_EQ(session->kind(), "image folders");
  expect_frames(*session, {0, 1});
  EXPECT_EQ(session->calibration().left.K(0, 0), 60);  // P2, P3 belong to colour images
}

void write_sensor(const fs::path& file, double x_in_body) {
  write_file(file,
             fmt::format("T_BS:\n  cols: 4\n  rows: 4\n  data: [1, 0, 0, {}, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n"
                         "resolution: [64, 48]\ncamera_model: pinhole\nintrinsics: [50, 50, 32, 24]\n"
                         "distortion_model: radial-tangential\ndistortion_coefficients: [0.1, 0, 0, 0]\n",
                         x_in_body));
}

TEST_F(SessionTest, EurocWithAndWithoutMav0) {
  for (const std::string base : {"mav0/", ""}) {
    for (int i = 0; i < 3; ++i) {
      image(fmt::format("{}cam0/data/{}.png", base, 1403636584763555584 + i * 50000000LL), 10 + i);
      image(fmt::format("{}cam1/data/{}.png", base, 1403636584763555584 + i * 50000000LL), 110 + i);
    }
    write_sensor(at(base + "cam0/sensor.yaml"), 0.05);
    write_sensor(at(base + "cam1/sensor.yaml"), 0.15);
    const auto session = open();
    EXPECT_EQ(session->kind(), "EuRoC/ASL");
    EXPECT_THAT(session->notes(), IsEmpty());
    expect_frames(*session, {0, 1, 2});
    EXPECT_EQ(session->stamp_ns(1), 1403636584813555584);
    EXPECT_NEAR(session->calibration().right_centre_in_left().x(), 0.1, 1e-15);
    if (base.empty()) continue;
    EXPECT_EQ(open_session(at("mav0"), {})->size(), 3);
    fs::remove_all(at("mav0"));
  }
}

// Stamps in data.csv count, whatever the files are called.
TEST_F(SessionTest, EurocWithCsv) {
  for (int i = 0; i < 3; ++i) {
    image(fmt::format("cam0/data/l{}.png", i), 10 + i);
    image(fmt::format("cam1/data/r{}.png", i), 110 + i);
  }
  write_sensor(at("cam0/sensor.yaml"), 0);
  write_sensor(at("cam1/sensor.yaml"), 0.1);
  write_file(at("cam0/data.csv"),
             "#timestamp [ns],filename\r\n1000000000000000000,l0.png\r\n1000000000050000000,l1.png\r\n"
             "1000000000100000000,l2.png\r\n1000000000150000000,l3.png\r\n");
  write_file(at("cam1/data.csv"),
             "#timestamp [ns],filename\n1000000000002000000, r0.png\n1000000000052000000, r1.png\n"
             "1000000000102000000, r2.png\n");
  const auto session = open();
  expect_frames(*session, {0, 1, 2});
  EXPECT_EQ(session->stamp_ns(2), 1000000000100000000);
  EXPECT_THAT(session->notes(), Contains(AllOf(HasSubstr("names 1 images that are not there"), HasSubstr("l3.png"))));
  EXPECT_THAT(session->notes(), Contains(HasSubstr("2.0 ms apart")));
}

class FolderNames : public SessionTest, public ::testing::WithParamInterface<std::pair<const char*, const char*>> {};
TEST_P(FolderNames, AreUnderstood) {
  folders(GetParam().first, GetParam().second, 2);
  opencv_calibration("calibration.yaml");
  image(std::string(GetParam().first) + "/.hidden7.png", 0);
  const auto session = open();
  EXPECT_EQ(session->kind(), "image folders");
  expect_frames(*session, {0, 1});
}
INSTANTIATE_TEST_SUITE_P(All, FolderNames,
                         ::testing::Values(std::pair("left", "right"), std::pair("Left", "Right"),
                                           std::pair("cam0", "cam1"), std::pair("image_l", "image_r"),
                                           std::pair("image_left", "image_right"), std::pair("left/data", "right/data"),
                                           std::pair("infra1", "infra2")));

TEST_F(SessionTest, FilesInOneFolder) {
  for (int i = 1; i < 4; ++i) {
    image(fmt::format("left{:02}.jpg", i), 10 + i);
    image(fmt::format("right{:02}.jpg", i), 110 + i);
  }
  image("overview.png", 0);
  opencv_calibration("intrinsics.yaml");
  const auto session = open();
  EXPECT_EQ(session->kind(), "image files");
  expect_frames(*session, {1, 2, 3});
  EXPECT_EQ(session->stamp_ns(0), 0);
}

TEST_F(SessionTest, ForCalibratingNoCalibrationIsNeeded) {
  folders("left", "right", 2);
  SessionOptions options;
  options.needs_calibration = false;
  const auto session = open(options);
  expect_frames(*session, {0, 1});
  EXPECT_EQ(session->calibration().right.width, 64);
}

// --- pairing, selection

TEST_F(SessionTest, WhatHasNoPartnerIsDroppedAndSaid) {
  folders("left", "right", 8);
  fs::remove(at("left/000002.png"));
  fs::remove(at("right/000005.png"));
  fs::remove(at("right/000006.png"));
  opencv_calibration("calibration.yaml");
  const auto session = open();
  expect_frames(*session, {0, 1, 3, 4, 7});
  EXPECT_EQ(session->stamp_ns(4), 700000000);
  EXPECT_THAT(session->notes(),
              Contains("2 of 7 left images have no partner and are not used: 000005.png, 000006.png"));
  EXPECT_THAT(session->notes(), Contains("1 of 6 right images have no partner and are not used: 000002.png"));
  EXPECT_THAT(session->notes(), Contains(AllOf(HasSubstr("2 gaps"), HasSubstr("0.300 s before 000007.png"))));
}

TEST_F(SessionTest, NearestStampsWithinHalfAPeriod) {
  const long long start = 1500000000000000000;
  for (int i = 0; i < 5; ++i) {
    image(fmt::format("left/{}.png", start + i * 100000000LL), 10 + i);
    // The right camera is 20 ms late and its third image 50 ms more.
    image(fmt::format("right/{}.png", start + i * 100000000LL + (i == 2 ? 70000000 : 20000000)), 110 + i);
  }
  opencv_calibration("calibration.yaml");
  expect_frames(*open(), {0, 1, 3, 4});
  SessionOptions wide;
  wide.max_stamp_difference = 0.09;
  const auto session = open(wide);
  EXPECT_EQ(session->size(), 4);  // the late image is nearer to the next left one, which has a better partner
  SessionOptions narrow;
  narrow.max_stamp_difference = 0.01;
  EXPECT_THAT(error_of(narrow),
              HasSubstr("none of the 5 left images belongs to one of the 5 right images by its time stamp"));
}

TEST_F(SessionTest, FirstStrideAndCount) {
  folders("left", "right", 10);
  opencv_calibration("calibration.yaml");
  SessionOptions options;
  options.first = 1;
  options.stride = 3;
  expect_frames(*open(options), {1, 4, 7});
  options.max_frames = 2;
  expect_frames(*open(options), {1, 4});
  EXPECT_EQ(open(options)->stamp_ns(1), 400000000);
  options.first = 10;
  EXPECT_THAT(error_of(options), HasSubstr("has 10 frames, of which session.first = 10 leaves none"));
}

TEST_F(SessionTest, OptionsAreDeclaredWithRanges) {
  SessionOptions options;
  OptionSet set;
  options.declare(set);
  set.set("session.stride", "4");
  set.set("session.calibration", "rig.yaml");
  EXPECT_NO_THROW(set.validate());
  EXPECT_EQ(options.stride, 4);
  set.set("session.stride", "0");
  set.set("session.pair", "infrared");
  EXPECT_THROW(set.validate(), UsageError);
}

// --- images

TEST_F(SessionTest, TwelveBitImagesAreScaledByOneFactor) {
  for (int i = 0; i < 3; ++i) {
    image(fmt::format("left/{}.png", i), i == 2 ? 4000 : 160 + 16 * i, CV_16UC1);
    image(fmt::format("right/{}.png", i), 800, CV_16UC1);
  }
  opencv_calibration("calibration.yaml");
  const auto session = open();
  EXPECT_EQ(session->read(0).left.type(), CV_8UC1);
  EXPECT_EQ(grey(session->read(0).left), 10);
  EXPECT_EQ(grey(session->read(1).left), 11);
  EXPECT_EQ(grey(session->read(2).left), 250);
  EXPECT_EQ(grey(session->read(2).right), 50);
  EXPECT_THAT(session->notes(), Contains(HasSubstr("12 bits are used: divided by 16")));
}

TEST_F(SessionTest, ReadingFromManyThreads) {
  folders("left", "right", 40);
  opencv_calibration("calibration.yaml");
  const auto session = open();
  std::vector<int> greys(40);
  parallel_chunks(0, 40, 1,
                  [&](int begin, int) { greys[static_cast<size_t>(begin)] = grey(session->read(begin).left); });
  for (int i = 0; i < 40; ++i) EXPECT_EQ(greys[static_cast<size_t>(i)], 10 + i);
}

TEST_F(SessionTest, CutImageIsNamedWhenRead) {
  folders("left", "right", 3);
  opencv_calibration("calibration.yaml");
  const auto session = open();
  fs::resize_file(at("right/000001.png"), fs::file_size(at("right/000001.png")) - 20);
  EXPECT_NO_THROW(session->read(0));
  try {
    session->read(1);
    FAIL();
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(),
                AllOf(HasSubstr("right/000001.png"), HasSubstr("cut off"), HasSubstr("copy the file again")));
  }
  image("left/000002.png", 3, CV_8UC1, {32, 48});
  EXPECT_THROW(session->read(2), InputError);
}

TEST_F(SessionTest, DamagedFirstImagesCostTheirFramesOnly) {
  for (int i = 0; i < 4; ++i) {
    image(fmt::format("left/{}.png", i), 160 + 16 * i, CV_16UC1);
    image(fmt::format("right/{}.png", i), 4000, CV_16UC1);
  }
  opencv_calibration("calibration.yaml", 0, 0);
  write_file(at("left/0.png"), "");
  fs::resize_file(at("right/1.png"), 50);
  const auto session = open();
  EXPECT_EQ(session->size(), 4);
  EXPECT_THAT(session->notes(),
              Contains(AllOf(HasSubstr("left/0.png"), HasSubstr("frame 2 is the first that can be read"))));
  EXPECT_EQ(session->calibration().left.width, 64);
  EXPECT_THROW(session->read(0), InputError);
  EXPECT_THROW(session->read(1), InputError);
  EXPECT_EQ(grey(session->read(2).left), 12);  // 12 bits are used
  for (int i = 0; i < 4; ++i) write_file(at(fmt::format("left/{}.png", i)), "");
  EXPECT_THAT(error_of(), AllOf(HasSubstr("none of its 4 frames can be read"), HasSubstr("left/0.png")));
}

TEST_F(SessionTest, CalibrationOfOtherImagesIsSuspected) {
  folders("image_0", "image_1", 2);
  write_file(at("calib.txt"), "P0: 50 0 60 0 0 50 24 0 0 0 1 0\nP1: 50 0 60 -5 0 50 24 0 0 0 1 0\n");
  EXPECT_THAT(open()->notes(),
              Contains(AllOf(HasSubstr("calib.txt: the principal point (60, 24) lies far from the middle"),
                             HasSubstr("64x48 px"))));
}

// --- errors

TEST_F(SessionTest, NoRecording) {
  try {
    open_session(at("missing"), {});
    FAIL();
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), HasSubstr("missing: there is no such recording"));
  }
  EXPECT_THAT(error_of(),
              AllOf(HasSubstr("is empty"), HasSubstr("KITTI"), HasSubstr("EuRoC"), HasSubstr("side-by-side")));
  write_file(at("readme.md"), "nothing here");
  EXPECT_THAT(error_of(), HasSubstr("holds no recording that is understood"));
  EXPECT_THROW(open_session(at("readme.md"), {}), InputError);
  image("left/0.png", 1);
  EXPECT_THAT(error_of(), HasSubstr("has a folder left but no folder right"));
  fs::create_directories(at("right"));
  EXPECT_THAT(error_of(), HasSubstr("right: has no images"));
}

TEST_F(SessionTest, CalibrationProblems) {
  folders("left", "right", 2);
  EXPECT_THAT(error_of(), AllOf(HasSubstr("has no calibration"), HasSubstr("*.yaml"),
                                HasSubstr("--session.calibration"), HasSubstr("Kalibr")));
  opencv_calibration("a.yaml");
  opencv_calibration("b.yaml");
  EXPECT_THAT(error_of(), AllOf(HasSubstr("2 calibrations: a.yaml, b.yaml"), HasSubstr("--session.calibration")));
  SessionOptions options;
  options.calibration = "b.yaml";  // seen from the recording
  EXPECT_EQ(open(options)->calibration().source, at("b.yaml").string());
  options.calibration = at("a.yaml").string();
  EXPECT_EQ(open(options)->calibration().source, at("a.yaml").string());
  options.calibration = "c.yaml";
  EXPECT_THAT(error_of(options), HasSubstr("c.yaml: there is no such calibration"));

  fs::remove(at("b.yaml"));
  opencv_calibration("a.yaml", 1280, 960);
  EXPECT_THAT(error_of(), AllOf(HasSubstr("a.yaml: is for images of 1280x960 px"), HasSubstr("are 64x48")));
  opencv_calibration("a.yaml", 64, 48, "0, 0, 0");
  EXPECT_THAT(error_of(), HasSubstr("the baseline is 0 m"));
  opencv_calibration("a.yaml", 64, 48, "0.1, 0, 0");
  EXPECT_THAT(error_of(), HasSubstr("left and right seem swapped"));
  opencv_calibration("a.yaml", 64, 48, "-.nan, 0, 0");
  EXPECT_NE(error_of(), "");
  opencv_calibration("a.yaml", 64, 48, "-100, 0, 0");
  EXPECT_THAT(open()->notes(), Contains(HasSubstr("100 m apart")));
}

TEST_F(SessionTest, SidesOfDifferentSize) {
  image("left/0.png", 1);
  image("right/0.png", 1, CV_8UC1, {64, 40});
  opencv_calibration("calibration.yaml");
  EXPECT_THAT(error_of(), AllOf(HasSubstr("the left image is 64x48 px"), HasSubstr("the right one 64x40")));
}

// --- fingerprint

TEST_F(SessionTest, FingerprintFollowsTheContentAndNotThePlace) {
  folders("a/left", "a/right", 3);
  opencv_calibration("a/calibration.yaml");
  fs::copy(at("a"), at("b"), fs::copy_options::recursive);
  const std::string text = open_session(at("a"), {})->fingerprint_text();
  EXPECT_EQ(open_session(at("b"), {})->fingerprint_text(), text);
  SessionOptions options;
  options.stride = 2;
  EXPECT_NE(open_session(at("a"), options)->fingerprint_text(), text);
  options = {};
  options.rate = 5;
  EXPECT_NE(open_session(at("a"), options)->fingerprint_text(), text);
  opencv_calibration("b/calibration.yaml", 64, 48, "-0.11, 0, 0");
  EXPECT_NE(open_session(at("b"), {})->fingerprint_text(), text);
  std::ofstream(at("a/left/000001.png"), std::ios::app) << "more";
  EXPECT_NE(open_session(at("a"), {})->fingerprint_text(), text);
}

// --- videos

class VideoSessionTest : public SessionTest {
 protected:
  // Motion JPEG: frame i has the left grey 10 + 10 i and the right grey 130 + 10 i.
  bool video(const std::string& name, int count, cv::Size size, int left_width, int left_height, double fps = 20) {
    cv::VideoWriter writer(at(name).string(), cv::VideoWriter::fourcc('M', 'J', 'P', 'G'), fps, size);
    if (!writer.isOpened()) return false;
    for (int i = 0; i < count; ++i) {
      cv::Mat frame(size, CV_8UC3, cv::Scalar::all(130 + 10 * i));
      frame(cv::Rect(0, 0, left_width, left_height)).setTo(cv::Scalar::all(10 + 10 * i));
      writer.write(frame);
    }
    return true;
  }
  static void expect_video(const Session& session, int count) {
    ASSERT_EQ(session.size(), count);
    EXPECT_FALSE(session.random_access());
    for (const int i : {0, 1, count - 1, 1, count - 1}) {  // also backwards
      const StereoFrame frame = session.read(i);
      EXPECT_EQ(frame.left.size(), cv::Size(64, 48));
      EXPECT_EQ(frame.right.size(), cv::Size(64, 48));
      EXPECT_EQ(frame.stamp_ns, i * 50000000LL);
      EXPECT_NEAR(grey(frame.left), 10 + 10 * i, 2);
      EXPECT_NEAR(grey(frame.right), 130 + 10 * i, 2);
    }
  }
};

#define IRIS_NEEDS_VIDEO(written) \
  if (!(written)) GTEST_SKIP() << "skipped: this OpenCV cannot write Motion JPEG"

TEST_F(VideoSessionTest, SideBySide) {
  IRIS_NEEDS_VIDEO(video("run.avi", 8, {128, 48}, 64, 48));
  opencv_calibration("calibration.yaml");
  const auto session = open();
  EXPECT_EQ(session->kind(), "side-by-side video");
  expect_video(*session, 8);
  EXPECT_EQ(open_session(at("run.avi"), {})->kind(), "side-by-side video");
  SessionOptions options;
  options.first = 2;
  options.stride = 3;
  const auto some = open(options);
  EXPECT_EQ(some->size(), 2);
  EXPECT_NEAR(grey(some->read(1).left), 60, 2);
  EXPECT_EQ(some->stamp_ns(1), 250000000);
  EXPECT_EQ(some->frame_name(1), "run.avi frame 5");
}

TEST_F(VideoSessionTest, TopBottomAndWrongCalibration) {
  IRIS_NEEDS_VIDEO(video("run.avi", 4, {64, 96}, 64, 48));
  opencv_calibration("run.yaml");
  opencv_calibration("other_run.yaml", 100, 100);
  const auto session = open();  // the calibration that is called like the video
  EXPECT_EQ(session->kind(), "top-bottom video");
  expect_video(*session, 4);
  fs::remove(at("run.yaml"));
  EXPECT_THAT(error_of(), AllOf(HasSubstr("the video is 64x96 px"), HasSubstr("200x100"), HasSubstr("100x200")));
}

TEST_F(VideoSessionTest, ShapeDecidesWithoutASize) {
  IRIS_NEEDS_VIDEO(video("run.avi", 4, {128, 48}, 64, 48));
  write_file(at("calib.txt"), kKitti);
  EXPECT_EQ(open()->kind(), "side-by-side video");
  EXPECT_EQ(open()->calibration().left.width, 64);
  ASSERT_TRUE(video("run.avi", 4, {64, 48}, 32, 48));
  EXPECT_THAT(error_of(), HasSubstr("image_width"));
}

TEST_F(VideoSessionTest, TwoVideosOfUnequalLength) {
  IRIS_NEEDS_VIDEO(video("left.avi", 6, {64, 48}, 64, 48));
  ASSERT_TRUE(video("right.avi", 5, {64, 48}, 0, 0));
  opencv_calibration("calibration.yaml");
  const auto session = open();
  EXPECT_EQ(session->kind(), "two videos");
  expect_video(*session, 5);
  EXPECT_THAT(session->notes(), Contains(HasSubstr("left.avi has 6 frames, right.avi has 5")));
  ASSERT_TRUE(video("right.avi", 5, {64, 48}, 0, 0, 25));
  EXPECT_THAT(error_of(), HasSubstr("25 frames a second"));
}

TEST_F(VideoSessionTest, CutOrBrokenVideos) {
  IRIS_NEEDS_VIDEO(video("run.avi", 8, {128, 48}, 64, 48));
  opencv_calibration("calibration.yaml");
  fs::resize_file(at("run.avi"), fs::file_size(at("run.avi")) * 6 / 10);
  try {
    const auto session = open();
    EXPECT_LT(session->size(), 8);
    for (int i = 0; i < session->size(); ++i) EXPECT_NO_THROW(session->read(i));
    EXPECT_THAT(session->notes(), Contains(HasSubstr("cut off")));
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), HasSubstr("run.avi"));
  }
  write_file(at("run.avi"), "this is no video");
  EXPECT_THAT(error_of(), HasSubstr("cannot be opened as a video"));
}

// --- recordings

TEST(RealSessions, OpenWithoutOptions) {
  IRIS_NEEDS_TEST_DATA("euroc_mh01");
  const auto euroc = open_session(iris::testing::test_data("euroc_mh01"), {});
  EXPECT_EQ(euroc->kind(), "EuRoC/ASL");
  EXPECT_EQ(euroc->size(), 160);
  EXPECT_THAT(euroc->notes(), IsEmpty());
  EXPECT_EQ(euroc->stamp_ns(0), 1403636584763555584);

  const auto kitti = open_session(iris::testing::test_data("kitti_street"), {});
  EXPECT_EQ(kitti->kind(), "KITTI odometry");
  EXPECT_EQ(kitti->size(), 51);
  EXPECT_TRUE(kitti->calibration().rectified);
  EXPECT_EQ(kitti->read(50).right.size(), cv::Size(1226, 370));

  const auto rover = open_session(iris::testing::test_data("rover_sandbox_b"), {});
  EXPECT_EQ(rover->kind(), "image folders");
  EXPECT_EQ(rover->size(), 325);
  EXPECT_FALSE(rover->calibration().rectified);
  EXPECT_EQ(rover->read(324).left.type(), CV_8UC3);
}

}  // namespace
}  // namespace iris::session
