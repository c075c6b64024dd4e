#include "iris/geometry/stereo_calibration.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "iris/core/error.h"

namespace iris {
namespace {

using ::testing::HasSubstr;

StereoCalibration good() {
  StereoCalibration c;
  c.left.width = c.right.width = 640;
  c.left.height = c.right.height = 480;
  c.left.K << 500, 0, 320, 0, 500, 240, 0, 0, 1;
  c.right.K = c.left.K;
  c.right_from_left.translation() = Eigen::Vector3d(-0.1, 0, 0);
  return c;
}

std::string problem_of(const StereoCalibration& c) {
  try {
    validate(c, "rig.yaml");
  } catch (const InputError& error) {
    EXPECT_EQ(error.path(), "rig.yaml");
    return error.what();
  }
  return "";
}

TEST(StereoCalibration, GoodOnePasses) { EXPECT_EQ(problem_of(good()), ""); }

struct Damage {
  const char* name;
  std::function<void(StereoCalibration&)> apply;
  const char* message;
};
class Damages : public ::testing::TestWithParam<Damage> {};

TEST_P(Damages, AreNamed) {
  StereoCalibration c = good();
  GetParam().apply(c);
  EXPECT_THAT(problem_of(c), HasSubstr(GetParam().message));
}

INSTANTIATE_TEST_SUITE_P(
    All, Damages,
    ::testing::Values(
        Damage{"nan_focal_length", [](auto& c) { c.left.K(0, 0) = std::nan(""); },
               "the left camera has values that are no numbers"},
        Damage{"nan_coefficient",
               [](auto& c) {
                 c.right.coefficients = {0, 0, 0, std::nan("")};
               },
               "the right camera has values"},
        Damage{"nan_rotation", [](auto& c) { c.right_from_left.linear()(1, 2) = std::nan(""); },
               "transform between the cameras"},
        Damage{"negative_focal_length", [](auto& c) { c.right.K(1, 1) = -3; }, "focal lengths 500 and -3"},
        Damage{"transposed_matrix", [](auto& c) { c.left.K.transposeInPlace(); }, "not of the form"},
        Damage{"count_of_coefficients",
               [](auto& c) {
                 c.left.coefficients = {1, 2, 3};
               },
               "has 3 distortion coefficients"},
        Damage{"size", [](auto& c) { c.right.width = 0; }, "image size 0x480"},
        Damage{"no_size", [](auto& c) { c.left.width = c.left.height = 0; }, "image size 0x0"},
        Damage{"scaled_rotation", [](auto& c) { c.right_from_left.linear() *= 1.01; }, "is no rotation"},
        Damage{"reflection", [](auto& c) { c.right_from_left.linear()(2, 2) = -1; }, "is no rotation"},
        Damage{"looking_apart",
               [](auto& c) {
                 c.right_from_left.linear() = Eigen::AngleAxisd(1.5, Eigen::Vector3d::UnitY()).toRotationMatrix();
               },
               "look 86 degrees apart"},
        Damage{"zero_baseline", [](auto& c) { c.right_from_left.translation().setZero(); }, "the baseline is 0 m"},
        Damage{"swapped", [](auto& c) { c.right_from_left.translation().x() = 0.1; }, "left and right seem swapped"},
        Damage{"above_each_other", [](auto& c) { c.right_from_left.translation() = Eigen::Vector3d(-0.01, 0.1, 0); },
               "not beside it"}),
    [](const auto& test) { return test.param.name; });

TEST(StereoCalibration, SizeMayBeUnknownWhileReading) {
  StereoCalibration c = good();
  c.left.width = c.left.height = c.right.width = c.right.height = 0;
  EXPECT_NO_THROW(validate(c, "rig.yaml", true));
  c.left.width = 640;
  EXPECT_THROW(validate(c, "rig.yaml", true), InputError);
}

TEST(StereoCalibration, RectifiedIsToldByValues) {
  EXPECT_TRUE(is_rectified(good()));
  const std::function<void(StereoCalibration&)> changes[] = {
      [](auto& c) {
        c.left.coefficients = {0, 0, 0, 1e-5};
      },
      [](auto& c) { c.right.distortion = Distortion::equidistant; },
      [](auto& c) { c.right.K(0, 0) = 501; },
      [](auto& c) { c.right.K(1, 2) = 243; },
      [](auto& c) { c.right_from_left.translation().y() = 0.001; },
      [](auto& c) {
        c.right_from_left.linear() = Eigen::AngleAxisd(1e-3, Eigen::Vector3d::UnitX()).toRotationMatrix();
      }};
  for (const auto& change : changes) {
    StereoCalibration c = good();
    change(c);
    EXPECT_FALSE(is_rectified(c));
  }
  StereoCalibration shifted = good();
  shifted.right.K(0, 2) = 350;  // only an offset of the disparities
  EXPECT_TRUE(is_rectified(shifted));
}

// P_right = R P_left + T has the right camera's centre at -R' T.
TEST(StereoCalibration, CentreOfTheRightCamera) {
  StereoCalibration c = good();
  c.right_from_left.linear() << 0, 0, -1, 0, 1, 0, 1, 0, 0;
  c.right_from_left.translation() = Eigen::Vector3d(1, 2, 3);
  EXPECT_LT((c.right_centre_in_left() - Eigen::Vector3d(-3, -2, 1)).norm(), 1e-15);
}

TEST(StereoCalibration, TextChangesWithEveryValue) {
  const std::string text = to_text(good());
  const std::function<void(StereoCalibration&)> changes[] = {
      [](auto& c) { c.left.width += 1; },
      [](auto& c) { c.right.K(0, 2) += 1e-12 * 320; },
      [](auto& c) {
        c.left.coefficients = {0, 0};
      },
      [](auto& c) { c.right_from_left.translation().z() = 1e-17; },
      [](auto& c) { c.rectified = true; },
      [](auto& c) { c.disparity_offset = 0.1; },
      [](auto& c) { c.left.distortion = Distortion::equidistant; }};
  for (const auto& change : changes) {
    StereoCalibration c = good();
    change(c);
    EXPECT_NE(to_text(c), text);
  }
  StereoCalibration elsewhere = good();
  elsewhere.source = "/another/place.yaml";
  EXPECT_EQ(to_text(elsewhere), text);
}

}  // namespace
}  // namespace iris
