#include "iris/calibrate/calibration_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <opencv2/core.hpp>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "support/temporary_folder.h"
#include "support/test_data.h"

namespace iris::calibrate {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

// One rig, written in every format by hand. Left: f = 500, centre (320, 240); right: f = 400, centre (310, 250);
// right_from_left = [R T], R = [0.8 0 -0.6; 0 1 0; 0.6 0 0.8], T = (-0.3, 0.02, -0.2).
// The left-frame point (0.5, 0.2, 2) is (0.4 - 1.2 - 0.3, 0.2 + 0.02, 0.3 + 1.6 - 0.2) = (-1.1, 0.22, 1.7) in the right
// frame.
const Eigen::Vector3d kPoint(0.5, 0.2, 2);
const Eigen::Vector2d kLeftPixel(320 + 500 * 0.25, 240 + 500 * 0.1);
const Eigen::Vector2d kRightPixel(310 - 400 * 1.1 / 1.7, 250 + 400 * 0.22 / 1.7);

void expect_projections(const StereoCalibration& c, const Eigen::Vector3d& point, const Eigen::Vector2d& left,
                        const Eigen::Vector2d& right) {
  EXPECT_LT((c.left.project(point) - left).norm(), 1e-9) << c.left.project(point).transpose();
  const Eigen::Vector2d seen = c.right.project(c.right_from_left * point);
  EXPECT_LT((seen - right).norm(), 1e-9) << seen.transpose() << " instead of " << right.transpose();
}

std::string opencv_matrix(int rows, int cols, const std::string& data) {
  return " !!opencv-matrix\n   rows: " + std::to_string(rows) + "\n   cols: " + std::to_string(cols) +
         "\n   dt: d\n   data: [ " + data + " ]\n";
}
const std::string kIntrinsics = "M1:" + opencv_matrix(3, 3, "500., 0., 320., 0., 500., 240., 0., 0., 1.") +
                                "D1:" + opencv_matrix(1, 5, "0., 0., 0., 0., 0.") +
                                "M2:" + opencv_matrix(3, 3, "400., 0., 310., 0.,\n       400., 250., 0., 0., 1.") +
                                "D2:" + opencv_matrix(1, 5, "0., 0., 0., 0., 0.");
const std::string kRotation = "0.8, 0., -0.6, 0., 1., 0., 0.6, 0., 0.8";
const std::string kExtrinsics =
    "R:" + opencv_matrix(3, 3, kRotation) + "T:" + opencv_matrix(3, 1, "-0.3, 0.02, -2.e-01");
const std::string kOpenCvHead = "%YAML:1.0\n---\n";

class CalibrationFile : public ::testing::Test {
 protected:
  fs::path write(const std::string& name, const std::string& text) {
    write_file(folder_.path() / name, text);
    return folder_.path() / name;
  }
  std::string error_of(const fs::path& path, KittiPair pair = KittiPair::any) {
    try {
      read_calibration(path, pair);
    } catch (const InputError& error) {
      return error.what();
    }
    return "";
  }
  iris::testing::TemporaryFolder folder_;
};

TEST_F(CalibrationFile, OpenCvYaml) {
  const auto c = read_calibration(
      write("rig.yaml", kOpenCvHead + "image_width: 640\nimage_height: 480\n" + kIntrinsics + kExtrinsics));
  expect_projections(c, kPoint, kLeftPixel, kRightPixel);
  EXPECT_EQ(c.left.width, 640);
  EXPECT_EQ(c.right.height, 480);
  EXPECT_FALSE(c.rectified);
  EXPECT_EQ(c.source, (folder_.path() / "rig.yaml").string());
}

// The same values written by OpenCV itself, as XML and as YAML, with other key names and five real coefficients.
TEST_F(CalibrationFile, OpenCvWritesWhatIsRead) {
  for (const char* name : {"rig.xml", "rig.yml"}) {
    {
      cv::FileStorage file((folder_.path() / name).string(), cv::FileStorage::WRITE);
      file << "cameraMatrix1" << cv::Mat(cv::Matx33d(500, 0, 320, 0, 500, 240, 0, 0, 1));
      file << "distCoeffs1" << cv::Mat(cv::Matx<double, 1, 5>(0.1, -0.02, 0.001, 0.002, 0));
      file << "cameraMatrix2" << cv::Mat(cv::Matx33d(400, 0, 310, 0, 400, 250, 0, 0, 1));
      file << "distCoeffs2" << cv::Mat(cv::Matx<double, 1, 5>(0, 0, 0, 0, 0));
      file << "R" << cv::Mat(cv::Matx33d(0.8, 0, -0.6, 0, 1, 0, 0.6, 0, 0.8));
      file << "T" << cv::Mat(cv::Vec3d(-0.3, 0.02, -0.2));
      file << "imageSize" << cv::Size(640, 480);
    }
    const StereoCalibration c = read_calibration(folder_.path() / name);
    // Left: x = 0.25, y = 0.1, r2 = 0.0725; s = 1 + 0.1 r2 - 0.02 r2^2;
    // x' = 0.25 s + 2 p1 x y + p2 (r2 + 2 x^2), y' = 0.1 s + p1 (r2 + 2 y^2) + 2 p2 x y
    const double s = 1 + 0.00725 - 0.02 * 0.0725 * 0.0725;
    const double x = 0.25 * s + 2 * 0.001 * 0.025 + 0.002 * (0.0725 + 0.125);
    const double y = 0.1 * s + 0.001 * (0.0725 + 0.02) + 2 * 0.002 * 0.025;
    expect_projections(c, kPoint, {320 + 500 * x, 240 + 500 * y}, kRightPixel);
    EXPECT_EQ(c.left.width, 640);
    EXPECT_EQ(c.left.height, 480);
    fs::remove(folder_.path() / name);
  }
}

TEST_F(CalibrationFile, OpenCvInTwoFiles) {
  const fs::path intrinsics = write("intrinsics.yml", kOpenCvHead + kIntrinsics);
  const fs::path extrinsics = write("extrinsics.yml", kOpenCvHead + kExtrinsics);
  for (const fs::path& path : {intrinsics, extrinsics, folder_.path()}) {
    const StereoCalibration c = read_calibration(path);
    expect_projections(c, kPoint, kLeftPixel, kRightPixel);
    EXPECT_EQ(c.left.width, 0);  // the file does not say it
  }
  fs::remove(extrinsics);
  EXPECT_THAT(error_of(intrinsics), HasSubstr("not R and T"));
}

TEST_F(CalibrationFile, OpenCvFisheyeAndManyCoefficients) {
  std::string text = kOpenCvHead + "distortion_model: fisheye\n" + kIntrinsics + kExtrinsics;
  for (size_t at; (at = text.find("cols: 5")) != std::string::npos;) text.replace(at, 7, "cols: 4");
  for (size_t at; (at = text.find("0., 0., 0., 0., 0. ]")) != std::string::npos;)
    text.replace(at, 20, "0.1, 0., 0., 0. ]");
  const StereoCalibration c = read_calibration(write("rig.yaml", text));
  EXPECT_EQ(c.left.distortion, Distortion::equidistant);
  // (3, 0, 3): theta = pi / 4, r' = theta + 0.1 theta^3 = 0.785398 + 0.0484473
  EXPECT_NEAR(c.left.project({3, 0, 3}).x(), 320 + 500 * (0.78539816339745 + 0.04844730731), 1e-6);

  std::string fourteen = kOpenCvHead + kIntrinsics + kExtrinsics;
  const std::string zeros = "0., 0., 0., 0., 0. ]";
  fourteen.replace(fourteen.find(zeros), zeros.size(), "0.1, 0, 0, 0, 0, 0, 0, 0.2, 0, 0, 0, 0, 0, 0 ]");
  EXPECT_EQ(read_calibration(write("rig.yaml", fourteen)).left.coefficients.size(), 8u);
  fourteen.replace(fourteen.find("0.2, 0,"), 7, "0.2, 1,");
  EXPECT_THAT(error_of(write("rig.yaml", fourteen)), HasSubstr("thin-prism"));
}

TEST_F(CalibrationFile, KalibrCamchain) {
  const std::string cameras =
      "cam0:\n  camera_model: pinhole\n  intrinsics: [500, 500, 320, 240]\n  distortion_model: radtan\n"
      "  distortion_coeffs: [0, 0, 0, 0]\n  resolution: [640, 480]\n";
  const std::string cam1 =
      "cam1:\n  camera_model: pinhole\n  intrinsics: [400, 400, 310, 250]\n  distortion_model: radtan\n"
      "  distortion_coeffs: [0, 0, 0, 0]\n  resolution: [640, 480]\n";
  const auto c =
      read_calibration(write("camchain.yaml", cameras + cam1 +
                                                  "  T_cn_cnm1:\n  - [0.8, 0, -0.6, -0.3]\n  - [0, 1, 0, 0.02]\n"
                                                  "  - [0.6, 0, 0.8, -0.2]\n  - [0, 0, 0, 1]\n"));
  expect_projections(c, kPoint, kLeftPixel, kRightPixel);
  EXPECT_EQ(c.right.width, 640);

  // With an IMU instead: cam0 = [0 1 0; -1 0 0; 0 0 1] imu + (-2, 1, -3); cam1 = R cam0 + T.
  const auto with_imu = read_calibration(
      write("camchain.yaml",
            cameras + "  T_cam_imu: [[0, 1, 0, -2], [-1, 0, 0, 1], [0, 0, 1, -3], [0, 0, 0, 1]]\n" + cam1 +
                "  T_cam_imu: [[0, 0.8, -0.6, -0.1], [-1, 0, 0, 1.02], [0, 0.6, 0.8, -3.8], [0, 0, 0, 1]]\n"));
  expect_projections(with_imu, kPoint, kLeftPixel, kRightPixel);

  EXPECT_THAT(error_of(write("camchain.yaml", cameras)), HasSubstr("one camera"));
  EXPECT_THAT(error_of(write("camchain.yaml", cameras + cam1)), HasSubstr("cam1.T_cn_cnm1 is missing"));
  std::string omni = cameras + cam1;
  omni.replace(omni.find("pinhole"), 7, "omni");
  EXPECT_THAT(error_of(write("camchain.yaml", omni)), HasSubstr("camera model 'omni' is not supported"));
}

// T_BS takes a camera's points to the body. Left: body = (-y, x, z) + (1, 2, 3). Right: the same after left = R' right
// + c with c = -R'T = (0.36, -0.02, -0.02).
TEST_F(CalibrationFile, EurocSensors) {
  const auto sensor = [](const std::string& data, const std::string& intrinsics) {
    return "sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [" + data +
           ", 0, 0, 0, 1]\nresolution: [640, 480]\ncamera_model: pinhole\nintrinsics: " + intrinsics +
           " #fu, fv\ndistortion_model: radial-tangential\ndistortion_coefficients: [0, 0, 0, 0]\n";
  };
  const auto left =
      write("mav0/cam0/sensor.yaml", sensor("0, -1, 0, 1,\n  1, 0, 0, 2,\n  0, 0, 1, 3", "[500, 500, 320, 240]"));
  const auto right = write("mav0/cam1/sensor.yaml",
                           sensor("0, -1, 0, 1.02, 0.8, 0, 0.6, 2.36, -0.6, 0, 0.8, 2.98", "[400, 400, 310, 250]"));
  for (const fs::path& path : {folder_.path(), folder_.path() / "mav0", left, right}) {
    expect_projections(read_calibration(path), kPoint, kLeftPixel, kRightPixel);
  }
  fs::remove(right);
  EXPECT_THAT(error_of(left), HasSubstr("other camera's file is not beside it"));
}

// The right camera stands 0.36 m along the left one's x axis: T = -R (0.36, 0, 0) = (-0.288, 0, -0.216), the point is
// at (0.4 - 1.2 - 0.288, 0.2, 0.3 + 1.6 - 0.216) = (-1.088, 0.2, 1.684). The rectified axes are the left camera's,
// turned about x by [1 0 0; 0 0.8 -0.6; 0 0.6 0.8].
TEST_F(CalibrationFile, RosCameraInfoPair) {
  const auto info = [](const std::string& name, const std::string& K, const std::string& R, const std::string& P) {
    const auto matrix = [](int rows, int cols, const std::string& data) {
      return "\n  rows: " + std::to_string(rows) + "\n  cols: " + std::to_string(cols) + "\n  data: [" + data + "]\n";
    };
    return "image_width: 640\nimage_height: 480\ncamera_name: " + name + "\ncamera_matrix:" + matrix(3, 3, K) +
           "distortion_model: plumb_bob\ndistortion_coefficients:" + matrix(1, 5, "0, 0, 0, 0, 0") +
           "rectification_matrix:" + matrix(3, 3, R) + "projection_matrix:" + matrix(3, 4, P);
  };
  const fs::path left =
      write("left.yaml", info("left", "500, 0, 320, 0, 500, 240, 0, 0, 1", "1, 0, 0, 0, 0.8, -0.6, 0, 0.6, 0.8",
                              "450, 0, 300, 0, 0, 450, 200, 0, 0, 0, 1, 0"));
  const std::string right_text =
      info("right", "400, 0, 310, 0, 400, 250, 0, 0, 1", "0.8, 0, 0.6, 0.36, 0.8, -0.48, -0.48, 0.6, 0.64",
           "450, 0, 300, -162, 0, 450, 200, 0, 0, 0, 1, 0");
  const fs::path right = write("right.yaml", right_text);
  for (const fs::path& path : {left, right, folder_.path()}) {
    expect_projections(read_calibration(path), kPoint, kLeftPixel,
                       {310 - 400 * 1.088 / 1.684, 250 + 400 * 0.2 / 1.684});
  }
  std::string swapped = right_text;
  swapped.replace(swapped.find("-162"), 4, "162");
  write("right.yaml", swapped);
  EXPECT_THAT(error_of(left), HasSubstr("negative baseline"));
  fs::remove(right);
  EXPECT_THAT(error_of(left), HasSubstr("not beside it"));
  EXPECT_THAT(error_of(folder_.path()), HasSubstr("left.yaml (one camera only)"));
}

// Projection matrices worked out by hand: cameras 2 and 3 stand at t2 = (0.06, 0.001, 0) and t3 = (-0.47, 0.003, 0.002)
// (X_i = X_0 + t_i); fourth columns K t with f = 700, centre (600, 180).
TEST_F(CalibrationFile, Kitti) {
  const std::string p0 = "7.070912e+02 0 601.8873 0 0 707.0912 183.1104 0 0 0 1 0\n";
  const std::string p1 = "7.070912e+02 0 601.8873 -379.8145 0 707.0912 183.1104 0 0 0 1 0\n";
  const std::string p2 = "700 0 600 42 0 700 180 0.7 0 0 1 0\n";
  const std::string p3 = "700 0 600 -327.8 0 700 180 2.46 0 0 1 0.002\n";
  const Eigen::Vector3d point(1, 0.5, 10);
  const Eigen::Vector2d left(70.70912 + 601.8873, 35.35456 + 183.1104);
  const Eigen::Vector2d colour_left(670, 215), colour_right(600 + 700 * 0.47 / 10.002, 180 + 700 * 0.502 / 10.002);

  for (const std::string& text :
       {"P0: " + p0 + "P1: " + p1 + "P2: " + p2 + "P3: " + p3 + "Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n", p0 + p1 + p2 + p3}) {
    const fs::path file = write("calib.txt", text);
    const StereoCalibration grey = read_calibration(file);
    expect_projections(grey, point, left, left - Eigen::Vector2d(37.98145, 0));
    EXPECT_TRUE(grey.rectified);
    EXPECT_NEAR(grey.right_centre_in_left().x(), 379.8145 / 707.0912, 1e-12);
    expect_projections(read_calibration(file, KittiPair::colour), point, colour_left, colour_right);
    expect_projections(read_calibration(file, KittiPair::rather_colour), point, colour_left, colour_right);
  }
  const fs::path grey_only = write("calib.txt", "P0: " + p0 + "P1: " + p1);
  EXPECT_THAT(error_of(grey_only, KittiPair::colour), HasSubstr("has no P2 and P3"));
  expect_projections(read_calibration(grey_only, KittiPair::rather_colour), point, left,
                     left - Eigen::Vector2d(37.98145, 0));
  const fs::path colour_only = write("calib.txt", "P2: " + p2 + "P3: " + p3);
  expect_projections(read_calibration(colour_only), point, colour_left, colour_right);
  // Two lines without names: just the pair.
  expect_projections(read_calibration(write("calib.txt", p2 + p3), KittiPair::colour), point, colour_left,
                     colour_right);
  EXPECT_THAT(error_of(write("calib.txt", p1 + p0)), HasSubstr("left and right seem swapped"));
}

// Motorcycle's numbers: d = f b / z - doffs.
TEST_F(CalibrationFile, Middlebury) {
  const StereoCalibration c =
      read_calibration(write("calib.txt",
                             "cam0=[994.978 0 311.193; 0 994.978 254.877; 0 0 1]\n"
                             "cam1=[994.978 0 342.279; 0 994.978 254.877; 0 0 1]\n"
                             "doffs=31.086\nbaseline=193.001\nwidth=741\nheight=497\nndisp=70\n"));
  EXPECT_EQ(c.left.width, 741);
  EXPECT_TRUE(c.rectified);
  const Eigen::Vector3d point(0.2, 0.1, 2.5);
  const double disparity = c.left.project(point).x() - c.right.project(c.right_from_left * point).x();
  EXPECT_NEAR(disparity, 994.978 * 0.193001 / 2.5 - 31.086, 1e-9);
}

TEST_F(CalibrationFile, FolderWithSeveralIsAmbiguousUnlessOneIsNamedCalibration) {
  const std::string text = kOpenCvHead + kIntrinsics + kExtrinsics;
  write("a.yaml", text);
  write("b.yml", text);
  write("options.yaml", "stereo:\n  disparities: 64\n");
  write("poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0.5 0 1 0 0 0 0 1 1.5\n");
  write("times.txt", "0\n0.1\n");
  EXPECT_THAT(error_of(folder_.path()),
              AllOf(HasSubstr("2 calibrations: a.yaml, b.yml"), HasSubstr("calibration.yaml")));
  write("calibration.xml", "<?xml version=\"1.0\"?>\n<opencv_storage>\n<nothing>1</nothing>\n</opencv_storage>\n");
  EXPECT_EQ(find_calibrations(folder_.path()).size(), 2u);
  write("calibration.yaml", text);
  EXPECT_THAT(find_calibrations(folder_.path()), ElementsAre(folder_.path() / "calibration.yaml"));
  EXPECT_EQ(error_of(folder_.path()), "");
}

TEST_F(CalibrationFile, ProblemsAreNamed) {
  EXPECT_THAT(error_of(folder_.path() / "none.yaml"), HasSubstr("no such calibration"));
  EXPECT_THAT(error_of(folder_.path()), AllOf(HasSubstr("has no calibration"), HasSubstr("Kalibr")));
  EXPECT_THAT(error_of(write("list.xml",
                             "<?xml version=\"1.0\"?>\n<opencv_storage>\n<imagelist>\n\"left01.jpg\"\n</imagelist>\n"
                             "</opencv_storage>\n")),
              HasSubstr("is no stereo calibration"));
  EXPECT_THAT(error_of(write("rig.yaml", "")), HasSubstr("rig.yaml"));
  EXPECT_THAT(error_of(write("rig.yaml", kOpenCvHead + "M1: [1, 2\nfoo: }")), HasSubstr("line "));
  EXPECT_THAT(error_of(folder_.path()), HasSubstr("no readable calibration"));

  const std::string text = kOpenCvHead + kIntrinsics + kExtrinsics;
  const auto with = [&](const std::string& from, const std::string& to) {
    std::string changed = text;
    const size_t at = changed.rfind(from);
    EXPECT_NE(at, std::string::npos);
    return write("rig.yaml", changed.replace(at, from.size(), to));
  };
  EXPECT_THAT(error_of(with("-0.3, 0.02", ".Nan, 0.02")), HasSubstr("NaN"));
  EXPECT_THAT(error_of(with("-0.3, 0.02", "x, 0.02")), HasSubstr("T holds 'x', which is no number"));
  EXPECT_THAT(error_of(with("-0.3, 0.02, -2.e-01", "0, 0, 0")), HasSubstr("the baseline is 0 m"));
  EXPECT_THAT(error_of(with("-0.3, 0.02, -2.e-01", "0.3, -0.02, 0.2")), HasSubstr("left and right seem swapped"));
  EXPECT_THAT(error_of(with("-0.3, 0.02, -2.e-01", "-0.3, 0.02")), HasSubstr("T has 2 values instead of 3x1"));
  EXPECT_THAT(error_of(with(kRotation, "0.8, 0., -0.6, 0., 1., 0., 0.6, 0., 0.9")), HasSubstr("is no rotation"));
  EXPECT_THAT(error_of(with("0., 0., 0., 0., 0.", "0., 0., 0.")),
              HasSubstr("the right camera has 3 distortion coefficients"));
}

// Whatever byte is damaged: the file is read or is an InputError, nothing else.
TEST_F(CalibrationFile, DamagedBytesNeverDoWorse) {
  const std::string kalibr =
      "cam0:\n  camera_model: pinhole\n  intrinsics: [500, 500, 320, 240]\n  distortion_coeffs: [0, 0, 0, 0]\n"
      "cam1:\n  intrinsics: [400, 400, 310, 250]\n  resolution: [640, 480]\n"
      "  T_cn_cnm1: [[1, 0, 0, -0.3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n";
  cv::FileStorage xml("x.xml", cv::FileStorage::WRITE | cv::FileStorage::MEMORY);
  xml << "M1" << cv::Mat(cv::Matx33d(500, 0, 320, 0, 500, 240, 0, 0, 1)) << "M2"
      << cv::Mat(cv::Matx33d(500, 0, 320, 0, 500, 240, 0, 0, 1)) << "R" << cv::Mat(cv::Matx33d::eye()) << "T"
      << cv::Mat(cv::Vec3d(-0.3, 0, 0));
  const std::string kitti = "P0: 50 0 32 0 0 50 24 0 0 0 1 0\nP1: 50 0 32 -5 0 50 24 0 0 0 1 0\n";
  const fs::path file = folder_.path() / "rig.yaml";
  int readable = 0, errors = 0;
  for (const std::string& text : {kOpenCvHead + kIntrinsics + kExtrinsics, kalibr, xml.releaseAndGetString(), kitti}) {
    for (size_t i = 0; i < text.size(); ++i) {
      constexpr char kBytes[] = {' ', '\n', '[', ':', '9', '\0', '<'};
      for (const size_t k : {i, i + 3}) {
        std::string damaged = text;
        damaged[i] = kBytes[k % sizeof kBytes];
        std::ofstream(file, std::ios::binary) << damaged;
        try {
          read_calibration(file);
          ++readable;
        } catch (const InputError&) {
          ++errors;
        }
      }
    }
  }
  EXPECT_GT(readable, 300);
  EXPECT_GT(errors, 300);
}

// A rotation with rounded values becomes exact.
TEST_F(CalibrationFile, RoundedRotationsAreMadeExact) {
  std::string text = kOpenCvHead + kIntrinsics + kExtrinsics;
  text.replace(text.find(kRotation), kRotation.size(), "0.99995, 0., -0.01, 0., 1., 0., 0.01, 0., 0.99995");
  const Eigen::Matrix3d R = read_calibration(write("rig.yaml", text)).right_from_left.linear();
  EXPECT_LT((R * R.transpose() - Eigen::Matrix3d::Identity()).norm(), 1e-14);
  EXPECT_NEAR(R(2, 0), 0.01, 1e-6);
}

TEST(CalibrationFiles, OfRealRecordings) {
  IRIS_NEEDS_TEST_DATA("euroc_mh01");
  // README of the recordings: baselines 0.110 m and 0.537 m.
  EXPECT_NEAR(read_calibration(iris::testing::test_data("euroc_mh01")).right_centre_in_left().norm(), 0.110, 5e-4);
  EXPECT_NEAR(read_calibration(iris::testing::test_data("kitti_street")).right_centre_in_left().x(), 0.537, 5e-4);
  const StereoCalibration rover = read_calibration(iris::testing::test_data("rover_sandbox_b"));
  EXPECT_NEAR(rover.right_centre_in_left().x(), 0.07, 1e-12);
  EXPECT_FALSE(rover.rectified);
}

}  // namespace
}  // namespace iris::calibrate
