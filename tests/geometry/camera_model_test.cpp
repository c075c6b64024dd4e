#include "iris/geometry/camera_model.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <opencv2/calib3d.hpp>
#include <random>

namespace iris {
namespace {

CameraModel camera(Distortion distortion, std::vector<double> coefficients) {
  CameraModel model;
  model.width = 640;
  model.height = 480;
  model.K << 500, 0, 320, 0, 510, 235, 0, 0, 1;
  model.distortion = distortion;
  model.coefficients = std::move(coefficients);
  return model;
}

// Worked out on paper: x = 0.2, y = -0.1, r^2 = 0.05; 1 + 0.1 * 0.05 - 0.02 * 0.0025 = 1.00495.
TEST(CameraModel, RadialTangentialMatchesPaper) {
  const CameraModel model = camera(Distortion::radial_tangential, {0.1, -0.02, 0.001, 0.002});
  // x' = 0.2 * 1.00495 + 2 * 0.001 * 0.2 * -0.1 + 0.002 * (0.05 + 0.08) = 0.20099 - 0.00004 + 0.00026 = 0.20121
  // y' = -0.1 * 1.00495 + 0.001 * (0.05 + 0.02) + 2 * 0.002 * 0.2 * -0.1 = -0.100495 + 0.00007 - 0.00008 = -0.100505
  const Eigen::Vector2d pixel = model.project({0.4, -0.2, 2});
  EXPECT_NEAR(pixel.x(), 500 * 0.20121 + 320, 1e-10);
  EXPECT_NEAR(pixel.y(), 510 * -0.100505 + 235, 1e-10);
}

// A point at 45 degrees: theta = pi/4, r' = theta + k1 theta^3.
TEST(CameraModel, EquidistantMatchesPaper) {
  const CameraModel model = camera(Distortion::equidistant, {0.1, 0, 0, 0});
  const double theta = std::numbers::pi / 4, r = theta + 0.1 * theta * theta * theta;
  const Eigen::Vector2d pixel = model.project({3, 0, 3});
  EXPECT_NEAR(pixel.x(), 500 * r + 320, 1e-10);
  EXPECT_NEAR(pixel.y(), 235, 1e-10);
  // Beyond a right angle such a lens still sees.
  const Eigen::Vector2d behind = model.project({0, 1, -0.1});
  EXPECT_GT(behind.y(), 235 + 510 * std::numbers::pi / 2);
}

struct Lens {
  const char* name;
  Distortion distortion;
  std::vector<double> coefficients;
};
class Lenses : public ::testing::TestWithParam<Lens> {};

TEST_P(Lenses, ProjectAgreesWithOpenCvAndUnprojectInverts) {
  const CameraModel model = camera(GetParam().distortion, GetParam().coefficients);
  const cv::Matx33d K(500, 0, 320, 0, 510, 235, 0, 0, 1);
  std::mt19937 random(3);
  std::uniform_real_distribution<double> unit(-1, 1);
  for (int i = 0; i < 300; ++i) {
    const double z = 1 + 4 * std::abs(unit(random));
    const Eigen::Vector3d point(0.8 * z * unit(random), 0.6 * z * unit(random), z);
    const std::vector<cv::Point3d> object{{point.x(), point.y(), point.z()}};
    std::vector<cv::Point2d> expected;
    if (model.distortion == Distortion::equidistant) {
      cv::fisheye::projectPoints(object, expected, cv::Vec3d(), cv::Vec3d(), K, model.coefficients);
    } else {
      cv::projectPoints(object, cv::Vec3d(), cv::Vec3d(), K, model.coefficients, expected);
    }
    const Eigen::Vector2d pixel = model.project(point);
    EXPECT_NEAR(pixel.x(), expected[0].x, 1e-9);
    EXPECT_NEAR(pixel.y(), expected[0].y, 1e-9);
    EXPECT_LT((model.unproject(pixel) - point.normalized()).norm(), 1e-9) << point.transpose();
  }
}

INSTANTIATE_TEST_SUITE_P(
    All, Lenses,
    ::testing::Values(Lens{"none", Distortion::radial_tangential, {}},
                      Lens{"four", Distortion::radial_tangential, {-0.28, 0.07, 0.0002, 0.00002}},
                      Lens{"five", Distortion::radial_tangential, {-0.26, -0.03, 0.0018, -0.0003, 0.23}},
                      Lens{"eight", Distortion::radial_tangential, {0.3, 0.05, 0.001, -0.002, 0.01, 0.5, 0.1, 0.02}},
                      Lens{"equidistant", Distortion::equidistant, {0.01, -0.005, 0.002, -0.0004}}),
    [](const auto& test) { return test.param.name; });

TEST(CameraModel, SkewIsInverted) {
  CameraModel model = camera(Distortion::radial_tangential, {-0.1, 0.01});
  model.K(0, 1) = 3;
  const Eigen::Vector3d point = Eigen::Vector3d(0.2, -0.3, 1).normalized();
  EXPECT_NEAR(model.project({0, 0.5, 1}).x() - 320, 3 * (model.project({0, 0.5, 1}).y() - 235) / 510, 1e-12);
  EXPECT_LT((model.unproject(model.project(point)) - point).norm(), 1e-9);
}

TEST(CameraModel, BehindTheCameraIsNowhere) {
  const CameraModel model = camera(Distortion::radial_tangential, {});
  EXPECT_TRUE(std::isnan(model.project({0.1, 0.1, -1}).x()));
  EXPECT_TRUE(std::isnan(model.project({0.1, 0.1, 0}).x()));
}

// r (1 - 0.5 r^2) has its largest value 0.5443 at r = sqrt(2/3).
TEST(CameraModel, FoldOfThePolynomialIsFound) {
  const CameraModel model = camera(Distortion::radial_tangential, {-0.5, 0});
  EXPECT_NEAR(model.max_angle(), std::atan(std::sqrt(2.0 / 3)), 1e-3);
  EXPECT_TRUE(model.unproject({320 + 500 * 0.5, 235}).allFinite());
  EXPECT_FALSE(model.unproject({320 + 500 * 0.56, 235}).allFinite());
  EXPECT_NEAR(camera(Distortion::radial_tangential, {}).max_angle(), std::numbers::pi / 2, 1e-3);
  // theta - theta^3 / 3 turns at theta = 1.
  EXPECT_NEAR(camera(Distortion::equidistant, {-1.0 / 3, 0, 0, 0}).max_angle(), 1, 2e-3);
}

}  // namespace
}  // namespace iris
