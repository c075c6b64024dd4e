#include "iris/calibrate/calibration_writer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <opencv2/core.hpp>

#include "iris/calibrate/calibration_file.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "support/target_images.h"
#include "support/temporary_folder.h"

namespace iris::calibrate {
namespace {

using ::testing::HasSubstr;

struct Case {
  const char* format;
  const char* file;
  const char* read;  // what is given to the reader
};
class Formats : public ::testing::TestWithParam<Case> {};

// What is read back rectifies alike: the same rays for every pixel, rows and disparities. The files hold all digits;
// what is left is the arithmetic of the transforms.
TEST_P(Formats, WhatIsWrittenReadsBackTheSame) {
  for (const Distortion distortion : {Distortion::radial_tangential, Distortion::equidistant}) {
    for (const size_t coefficients : {size_t{2}, size_t{4}, size_t{5}, size_t{8}}) {
      if (distortion == Distortion::equidistant && coefficients != 4) continue;
      StereoCalibration c = iris::testing::target_rig(distortion);
      for (CameraModel* camera : {&c.left, &c.right}) {
        camera->coefficients.resize(coefficients, 0.0);
        for (size_t i = 4; i < coefficients; ++i) camera->coefficients[i] = 0.01 * static_cast<double>(i);
      }
      const FileFormat format = file_format(GetParam().format, GetParam().file);
      iris::testing::TemporaryFolder folder;
      const auto path = folder.path() / GetParam().file;
      if (coefficients > 4 && !holds_k3(format)) {
        EXPECT_THROW(write_calibration(path, format, c), UsageError);
        continue;
      }
      for (const auto& file : write_calibration(path, format, c, "a comment: with a colon")) {
        EXPECT_TRUE(std::filesystem::exists(file)) << file;
      }
      const StereoCalibration back = read_calibration(folder.path() / GetParam().read);
      EXPECT_EQ(back.left.width, 640);
      EXPECT_EQ(back.right.height, 480);
      EXPECT_EQ(back.left.distortion, distortion);
      EXPECT_NEAR(rectified_focal_length(back), rectified_focal_length(c), 1e-12);
      EXPECT_TRUE(rect_from_left_rotation(back).isApprox(rect_from_left_rotation(c), 1e-12));
      EXPECT_TRUE(back.right_from_left.isApprox(c.right_from_left, 1e-12));
      for (const Eigen::Vector2d& p : {Eigen::Vector2d(3, 5), {320, 240}, {630, 20}, {100, 470}}) {
        EXPECT_LT((back.left.unproject(p) - c.left.unproject(p)).norm(), 1e-12);
        EXPECT_LT((back.right.unproject(p) - c.right.unproject(p)).norm(), 1e-12);
      }
    }
  }
}

INSTANTIATE_TEST_SUITE_P(All, Formats,
                         ::testing::Values(Case{"opencv", "calibration.yaml", "calibration.yaml"},
                                           Case{"kalibr", "camchain.yaml", "camchain.yaml"},
                                           Case{"ros", "camera_info.yaml", "camera_info_left.yaml"},
                                           Case{"ros", "left.yaml", "right.yaml"}, Case{"euroc", "mav0", "mav0"},
                                           Case{"euroc", "rig/cam0/sensor.yaml", "rig"}),
                         [](const auto& test) { return std::string(test.param.format) + std::to_string(test.index); });

// A foreign reader: OpenCV's own storage.
TEST(CalibrationWriter, OpenCvReadsItsFormat) {
  const StereoCalibration c = iris::testing::target_rig();
  iris::testing::TemporaryFolder folder;
  const auto path = folder.path() / "calibration.yaml";
  write_calibration(path, FileFormat::opencv, c, "made by a test");
  const cv::FileStorage file(path.string(), cv::FileStorage::READ);
  cv::Mat1d M1, D2, R, T, P2;
  file["M1"] >> M1;
  file["D2"] >> D2;
  file["R"] >> R;
  file["T"] >> T;
  file["P2"] >> P2;
  ASSERT_EQ(M1.size(), cv::Size(3, 3));
  EXPECT_EQ(M1(0, 0), c.left.K(0, 0));
  ASSERT_EQ(D2.size(), cv::Size(5, 1));
  EXPECT_EQ(D2(3), c.right.coefficients[3]);
  EXPECT_EQ(R(1, 2), c.right_from_left.linear()(1, 2));
  EXPECT_EQ(T(0), c.right_from_left.translation().x());
  EXPECT_NEAR(-P2(0, 3) / P2(0, 0), c.right_centre_in_left().norm(), 1e-15);
}

TEST(CalibrationWriter, FormatsByName) {
  EXPECT_EQ(file_format("", "calibration.yml"), FileFormat::opencv);
  EXPECT_EQ(file_format("", "x/rig-camchain.yaml"), FileFormat::kalibr);
  EXPECT_EQ(file_format("", "camera_info.yaml"), FileFormat::ros);
  EXPECT_EQ(file_format("", "out/mav0"), FileFormat::euroc);
  EXPECT_EQ(file_format("kalibr", "calibration.yaml"), FileFormat::kalibr);
  EXPECT_THROW(file_format("", "calibration.txt"), UsageError);
  EXPECT_THROW(file_format("matlab", "x.yaml"), UsageError);
}

}  // namespace
}  // namespace iris::calibrate
