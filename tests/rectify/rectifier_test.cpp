#include "iris/rectify/rectifier.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>
#include <random>

#include "iris/session/session.h"
#include "support/test_data.h"

namespace iris::rectify {
namespace {

// A rig as hands build it: different cameras, turned against each other, mounted a little obliquely.
StereoCalibration oblique_rig() {
  StereoCalibration c;
  c.left.width = c.right.width = 752;
  c.left.height = c.right.height = 480;
  c.left.K << 458.654, 0, 367.215, 0, 457.296, 248.375, 0, 0, 1;
  c.right.K << 447.5, 0, 379.999, 0, 449.1, 255.238, 0, 0, 1;
  c.left.coefficients = {-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05};
  c.right.coefficients = {-0.27368365, 0.07451284, -0.00010473, -3.555907e-05};
  c.right_from_left.linear() =
      (Eigen::AngleAxisd(0.03, Eigen::Vector3d::UnitY()) * Eigen::AngleAxisd(-0.02, Eigen::Vector3d::UnitX()) *
       Eigen::AngleAxisd(0.015, Eigen::Vector3d::UnitZ()))
          .toRotationMatrix();
  c.right_from_left.translation() = Eigen::Vector3d(-0.11, 0.004, -0.006);
  return c;
}

StereoCalibration fisheye_rig() {
  StereoCalibration c = oblique_rig();
  for (CameraModel* camera : {&c.left, &c.right}) {
    camera->distortion = Distortion::equidistant;
    camera->K(0, 0) = camera->K(1, 1) = 280;
    camera->coefficients = {0.01, -0.005, 0.002, -0.0004};
  }
  return c;
}

// Projections written out here, apart from the library's.
Eigen::Vector2d brown_by_hand(const CameraModel& m, const Eigen::Vector3d& p) {
  const double x = p.x() / p.z(), y = p.y() / p.z(), r2 = x * x + y * y;
  const auto& k = m.coefficients;
  const double s = 1 + k[0] * r2 + k[1] * r2 * r2;
  const double xd = x * s + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x);
  const double yd = y * s + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y;
  return {m.K(0, 0) * xd + m.K(0, 2), m.K(1, 1) * yd + m.K(1, 2)};
}
Eigen::Vector2d kannala_by_hand(const CameraModel& m, const Eigen::Vector3d& p) {
  const double r = std::hypot(p.x(), p.y()), a = std::atan2(r, p.z());
  const auto& k = m.coefficients;
  const double d = a + k[0] * std::pow(a, 3) + k[1] * std::pow(a, 5) + k[2] * std::pow(a, 7) + k[3] * std::pow(a, 9);
  return {m.K(0, 0) * d * p.x() / r + m.K(0, 2), m.K(1, 1) * d * p.y() / r + m.K(1, 2)};
}

class RectifierGeometry : public ::testing::TestWithParam<bool> {};

// A point's images, mapped through the rectification, lie in one row and f t / z apart.
TEST_P(RectifierGeometry, RowsAgreeAndDisparityIsFocalLengthTimesBaselineOverDepth) {
  const bool fisheye = GetParam();
  const StereoCalibration c = fisheye ? fisheye_rig() : oblique_rig();
  const Rectifier rectifier(c);
  const RectifiedCamera& camera = rectifier.camera();
  EXPECT_FALSE(rectifier.passes_through());
  EXPECT_DOUBLE_EQ(camera.f, (c.left.K(0, 0) + c.left.K(1, 1) + c.right.K(0, 0) + c.right.K(1, 1)) / 4);
  EXPECT_DOUBLE_EQ(camera.cx, 375.5);
  EXPECT_DOUBLE_EQ(camera.cy, 239.5);
  // The centre of the right camera is -R'T, its distance |T|.
  EXPECT_NEAR(camera.baseline, std::sqrt(0.11 * 0.11 + 0.004 * 0.004 + 0.006 * 0.006), 1e-15);

  std::mt19937 random(7);
  std::uniform_real_distribution<double> unit(-1, 1);
  for (int i = 0; i < 200; ++i) {
    const double z = std::exp(unit(random) * 1.5);
    const Eigen::Vector3d in_left(0.6 * z * unit(random), 0.4 * z * unit(random), z);
    const Eigen::Vector3d in_right = c.right_from_left.linear() * in_left + c.right_from_left.translation();
    const auto by_hand = fisheye ? kannala_by_hand : brown_by_hand;
    const Eigen::Vector2d left = by_hand(c.left, in_left), right = by_hand(c.right, in_right);

    // Forward: look-up positions of the rectified image points are the recorded image points.
    const Eigen::Vector3d in_rect = rectifier.rect_from_left() * in_left;
    const double d = camera.f * camera.baseline / in_rect.z();
    const Eigen::Vector2d left_rect(camera.f * in_rect.x() / in_rect.z() + camera.cx,
                                    camera.f * in_rect.y() / in_rect.z() + camera.cy);
    EXPECT_LT((rectifier.left_source(left_rect) - left).norm(), 1e-9);
    EXPECT_LT((rectifier.right_source(left_rect - Eigen::Vector2d(d, 0)) - right).norm(), 1e-9);

    // Backward: recorded points, undistorted and turned, give row and disparity.
    const Eigen::Vector3d left_ray = rectifier.rect_from_left() * c.left.unproject(left);
    const Eigen::Vector3d right_ray =
        rectifier.rect_from_left() * c.right_from_left.linear().transpose() * c.right.unproject(right);
    const Eigen::Vector2d from_left = camera.f * left_ray.head<2>() / left_ray.z();
    const Eigen::Vector2d from_right = camera.f * right_ray.head<2>() / right_ray.z();
    EXPECT_NEAR(from_left.y(), from_right.y(), 1e-6);
    EXPECT_NEAR(from_left.x() - from_right.x(), d, 1e-6);
  }
  EXPECT_LT((rectifier.rect_from_left() * rectifier.rect_from_left().transpose() - Eigen::Matrix3d::Identity()).norm(),
            1e-14);
  EXPECT_GT(rectifier.rect_from_left().determinant(), 0);
}

INSTANTIATE_TEST_SUITE_P(Lenses, RectifierGeometry, ::testing::Bool(),
                         [](const auto& test) { return test.param ? "equidistant" : "radial_tangential"; });

// Smooth texture on the plane z = depth of the left camera's frame.
double texture(double x, double y) { return 128 + 60 * std::sin(x * 37) + 50 * std::cos(y * 41 + x * 5); }

// What a camera sees of that plane: each pixel's ray through the lens, cut with the plane.
cv::Mat1b rendered(const CameraModel& camera, const Pose& cam_from_left, double depth) {
  cv::Mat1b image(camera.height, camera.width);
  const Pose left_from_cam = cam_from_left.inverse();
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      const Eigen::Vector3d direction = left_from_cam.linear() * camera.unproject(Eigen::Vector2d(x, y));
      const Eigen::Vector3d point =
          left_from_cam.translation() + direction * (depth - left_from_cam.translation().z()) / direction.z();
      image(y, x) = cv::saturate_cast<uchar>(texture(point.x(), point.y()));
    }
  }
  return image;
}

// Both rectified images show, at every pixel, the texture that the rectified camera sees there.
TEST(Rectifier, ImagesShowWhatTheRectifiedCameraSees) {
  const StereoCalibration c = oblique_rig();
  const Rectifier rectifier(c);
  const RectifiedCamera& camera = rectifier.camera();
  constexpr double kDepth = 2;
  StereoFrame frame{3, 77, rendered(c.left, Pose::Identity(), kDepth), rendered(c.right, c.right_from_left, kDepth)};
  const StereoPair pair = rectifier.rectify(frame);
  EXPECT_EQ(pair.frame_idx, 3);
  EXPECT_EQ(pair.stamp_ns, 77);
  EXPECT_TRUE(pair.left_colour.empty());
  double left_worst = 0, right_worst = 0;
  for (int y = 60; y < 420; y += 3) {
    for (int x = 90; x < 660; x += 3) {
      const Eigen::Vector3d ray = rectifier.rect_from_left().transpose() *
                                  Eigen::Vector3d((x - camera.cx) / camera.f, (y - camera.cy) / camera.f, 1);
      const Eigen::Vector3d seen_left = ray * kDepth / ray.z();
      left_worst = std::max(left_worst, std::abs(pair.left(y, x) - texture(seen_left.x(), seen_left.y())));
      const Eigen::Vector3d centre = rectifier.rect_from_left().transpose() * Eigen::Vector3d(camera.baseline, 0, 0);
      const Eigen::Vector3d seen_right = centre + ray * (kDepth - centre.z()) / ray.z();
      right_worst = std::max(right_worst, std::abs(pair.right(y, x) - texture(seen_right.x(), seen_right.y())));
    }
  }
  // Slope of the texture: at most 60 * 37 * 2 m / 450 px = 10 grey levels a pixel; 1/64 px of table rounding, bilinear
  // interpolation of a wave of 38 px (0.2 levels) and twice 0.5 from rounding to 8 bits stay below 1.5.
  EXPECT_LT(left_worst, 1.5);
  EXPECT_LT(right_worst, 1.5);
}

TEST(Rectifier, ColourIsKeptAndOutsideIsBlack) {
  StereoCalibration c = oblique_rig();
  c.right_from_left.linear() = Eigen::AngleAxisd(0.2, Eigen::Vector3d::UnitX()).toRotationMatrix();
  const Rectifier rectifier(c);
  const cv::Mat3b image(c.left.height, c.left.width, cv::Vec3b(10, 120, 200));
  const StereoPair pair = rectifier.rectify({0, 0, image, image});
  const uchar grey = cv::saturate_cast<uchar>(0.114 * 10 + 0.587 * 120 + 0.299 * 200);
  EXPECT_EQ(pair.left_colour(240, 376), cv::Vec3b(10, 120, 200));
  EXPECT_NEAR(pair.left(240, 376), grey, 1);
  EXPECT_NEAR(pair.right(240, 376), grey, 1);
  // The right camera is turned by 0.2 rad about x, up or down: one side of its rectified image lies outside.
  const int top = pair.right(2, 376), bottom = pair.right(477, 376);
  EXPECT_EQ(std::min(top, bottom), 0);
}

TEST(Rectifier, RectifiedRecordingsPassUntouched) {
  StereoCalibration c;
  c.left.width = c.right.width = 64;
  c.left.height = c.right.height = 48;
  c.left.K << 50, 0, 30, 0, 50, 20, 0, 0, 1;
  c.right.K << 50, 0, 37, 0, 50, 20, 0, 0, 1;
  c.right_from_left.translation() = Eigen::Vector3d(-0.2, 0, 0);
  c.disparity_offset = 0.5;
  c.rectified = true;
  const Rectifier rectifier(c);
  EXPECT_TRUE(rectifier.passes_through());
  cv::Mat1b left(48, 64), right(48, 64);
  cv::randu(left, 0, 256);
  cv::randu(right, 0, 256);
  const StereoPair pair = rectifier.rectify({0, 0, left, right});
  EXPECT_EQ(cv::norm(pair.left, left, cv::NORM_INF), 0);
  EXPECT_EQ(cv::norm(pair.right, right, cv::NORM_INF), 0);
  // (0.3, 0.1, 2): x_left = 50 * 0.15 + 30 = 37.5, x_right = 50 * 0.05 + 37 = 39.5; disparity -2, less 0.5 of the
  // offset.
  const Eigen::Vector3d projected = rectifier.camera().project({0.3, 0.1, 2});
  EXPECT_NEAR(projected.x(), 37.5, 1e-12);
  EXPECT_NEAR(projected.y(), 22.5, 1e-12);
  EXPECT_NEAR(projected.z(), -2.5, 1e-12);
}

// No distortion and no rotation, but rows of the right image 3 px lower: must be resampled.
TEST(Rectifier, ShiftedRowsAreRectified) {
  StereoCalibration c;
  c.left.width = c.right.width = 64;
  c.left.height = c.right.height = 48;
  c.left.K << 50, 0, 31.5, 0, 50, 23.5, 0, 0, 1;
  c.right.K << 50, 0, 31.5, 0, 50, 26.5, 0, 0, 1;
  c.left.coefficients = c.right.coefficients = {0, 0, 0, 0, 0};
  c.right_from_left.translation() = Eigen::Vector3d(-0.2, 0, 0);
  EXPECT_FALSE(is_rectified(c));
  const Rectifier rectifier(c);
  EXPECT_FALSE(rectifier.passes_through());
  cv::Mat1b left(48, 64), right(48, 64, uchar{0});
  cv::randu(left, 0, 256);
  left.rowRange(0, 45).copyTo(right.rowRange(3, 48));
  const StereoPair pair = rectifier.rectify({0, 0, left, right});
  EXPECT_EQ(cv::norm(pair.left, left, cv::NORM_INF), 0);
  EXPECT_EQ(cv::norm(pair.right.rowRange(0, 45), left.rowRange(0, 45), cv::NORM_INF), 0);
}

TEST(Rectifier, PictureHoldsBothImagesAndLines) {
  StereoPair pair;
  pair.left = cv::Mat1b(40, 30, uchar{50});
  pair.right = cv::Mat1b(40, 30, uchar{90});
  const cv::Mat picture = rectified_pair_picture(pair);
  EXPECT_EQ(picture.size(), cv::Size(60, 40));
  EXPECT_EQ(picture.type(), CV_8UC3);
  EXPECT_EQ(picture.at<cv::Vec3b>(0, 0), cv::Vec3b(50, 50, 50));
  EXPECT_EQ(picture.at<cv::Vec3b>(0, 59), cv::Vec3b(90, 90, 90));
  EXPECT_EQ(picture.at<cv::Vec3b>(4, 0), cv::Vec3b(0, 220, 0));
}

// Differences of the rows of features that are followed from the left into the right image and back.
std::vector<double> row_differences(const StereoPair& pair) {
  std::vector<cv::Point2f> left, right, back;
  cv::goodFeaturesToTrack(pair.left, left, 400, 0.01, 12);
  std::vector<uchar> found, found_back;
  std::vector<float> error;
  cv::calcOpticalFlowPyrLK(pair.left, pair.right, left, right, found, error, {21, 21}, 5);
  cv::calcOpticalFlowPyrLK(pair.right, pair.left, right, back, found_back, error, {21, 21}, 5);
  std::vector<double> differences;
  for (size_t i = 0; i < left.size(); ++i) {
    const bool forth_and_back = found[i] && found_back[i] && cv::norm(back[i] - left[i]) < 0.3;
    if (forth_and_back && left[i].x - right[i].x > 0.5) differences.push_back(right[i].y - left[i].y);
  }
  return differences;
}

double median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2), values.end());
  return values[values.size() / 2];
}

class RealRecordings : public ::testing::TestWithParam<const char*> {};

TEST_P(RealRecordings, RowsOfTrackedFeaturesAgree) {
  IRIS_NEEDS_TEST_DATA(GetParam());
  const auto session = session::open_session(iris::testing::test_data(GetParam()), {});
  const Rectifier rectifier(session->calibration());
  std::vector<double> signed_rows, rows;
  for (int i = 0; i < session->size(); i += session->size() / 5) {
    for (const double d : row_differences(rectifier.rectify(session->read(i)))) {
      signed_rows.push_back(d);
      rows.push_back(std::abs(d));
    }
  }
  ASSERT_GT(rows.size(), 100u);
  RecordProperty("features", static_cast<int>(rows.size()));
  RecordProperty("median_row_difference_px", std::to_string(median(rows)));
  std::printf("%s: %zu features, median |dy| %.3f px, median dy %.3f px\n", GetParam(), rows.size(), median(rows),
              median(signed_rows));
  EXPECT_LT(median(rows), 0.5);
}

INSTANTIATE_TEST_SUITE_P(All, RealRecordings, ::testing::Values("euroc_mh01", "kitti_street", "rover_sandbox_b"),
                         [](const auto& test) { return std::string(test.param); });

}  // namespace
}  // namespace iris::rectify
