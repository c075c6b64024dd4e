#include "iris/motion/corner_disparity.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <random>

#include "support/synthetic_views.h"

namespace iris::motion {
namespace {

const RectifiedCamera kCamera{.f = 270, .cx = 200, .cy = 150, .baseline = 0.12, .width = 400, .height = 300};

Pose turned_camera() {
  Pose pose = Pose::Identity();
  pose.linear() =
      (Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitY()) * Eigen::AngleAxisd(-0.03, Eigen::Vector3d::UnitX()))
          .toRotationMatrix();
  pose.translation() = Eigen::Vector3d(0.08, -0.02, 0.06);
  return pose;
}

TEST(PlaneWarp, IsTheProjectionOfThePlane) {
  Corner corner{.x = 251.3, .y = 120.7, .disparity = 12.4};
  corner.slope = Eigen::Vector2d(0.03, -0.05);
  corner.point_in_cam = kCamera.point(corner.x, corner.y, corner.disparity);
  const Pose other_from_cam = turned_camera().inverse();
  const Eigen::Matrix3d warp = plane_warp(kCamera, corner, other_from_cam);
  const Eigen::Vector2d middle = kCamera.project(other_from_cam * corner.point_in_cam).head<2>();
  for (const Eigen::Vector2d& offset : {Eigen::Vector2d(0, 0), Eigen::Vector2d(7, -7), Eigen::Vector2d(-6.5, 3.2)}) {
    const Eigen::Vector3d point =
        kCamera.point(corner.x + offset.x(), corner.y + offset.y(), corner.disparity + corner.slope.dot(offset));
    const Eigen::Vector2d seen = kCamera.project(other_from_cam * point).head<2>();
    EXPECT_LT(((warp * offset.homogeneous()).hnormalized() - (seen - middle)).norm(), 1e-9);
  }
}

// A square is followed to where its middle is, although perspective shows one half of it larger than the other: an
// affine map would be off by the second order, f'' u^2 / 2, here about 0.02 px.
TEST(PlaneWarp, LeavesNoBiasOfPerspective) {
  const Pose prev = Pose::Identity();
  const Pose cur = turned_camera();
  const testing::SyntheticView a = testing::render_room({}, kCamera, prev), b = testing::render_room({}, kCamera, cur);
  const ViewFeatures features = extract_features(a.image, a.disparity, kCamera, {});
  double with = 0, without = 0;
  int count = 0;
  for (const Corner& corner : features.corners) {
    if (!corner.alone) continue;
    const Eigen::Vector2d place = kCamera.project(cur.inverse() * (prev * corner.point_in_cam)).head<2>();
    const Eigen::Matrix3d warp = plane_warp(kCamera, corner, cur.inverse() * prev);
    const PatchTrack track = track_patch(a.image, {corner.x, corner.y}, b.image, place, warp);
    const PatchTrack affine =
        track_patch(a.image, {corner.x, corner.y}, b.image, place, Eigen::Matrix2d(warp.topLeftCorner<2, 2>()));
    if (!track.found || !affine.found) continue;
    if ((track.position - place).norm() > 0.3 || (affine.position - place).norm() > 0.3) continue;
    with += track.position.x() - place.x();
    without += affine.position.x() - place.x();
    ++count;
  }
  ASSERT_GT(count, 100);
  // Each is off by about 0.05 px: 0.005 px on average of a hundred.
  EXPECT_LT(std::abs(with / count), 0.006);
  EXPECT_GT(std::abs(without / count), 0.008);
}

TEST(MeasureDisparities, IsMorePreciseThanNoisyStereoAndKnowsItsErrors) {
  std::mt19937_64 random(3);
  std::normal_distribution<double> grey(0, 2), px(0, 0.15);
  const Pose pose = Pose::Identity();
  Pose right_pose = pose;
  right_pose.translation().x() += kCamera.baseline;
  testing::SyntheticView left = testing::render_room({}, kCamera, pose);
  testing::SyntheticView right = testing::render_room({}, kCamera, right_pose);
  for (cv::Mat1b* image : {&left.image, &right.image})
    for (uint8_t& v : *image) v = cv::saturate_cast<uint8_t>(v + grey(random));
  DisparityImage noisy{left.disparity.disparity.clone(), left.disparity.origin};
  for (float& d : noisy.disparity) d += static_cast<float>(px(random));
  const ViewFeatures before = extract_features(left.image, noisy, kCamera, {});
  const ViewFeatures after = extract_features(left.image, noisy, kCamera, {}, right.image);
  ASSERT_EQ(before.corners.size(), after.corners.size());
  double rms_before = 0, rms_after = 0, normalised = 0;
  int count = 0;
  for (size_t i = 0; i < after.corners.size(); ++i) {
    const Corner& corner = after.corners[i];
    if (!corner.alone || corner.disparity_error == 0) continue;
    const double truth = usable_disparity(left.disparity, corner.x, corner.y, kCamera, {});
    rms_before += std::pow(before.corners[i].disparity - truth, 2);
    rms_after += std::pow(corner.disparity - truth, 2);
    normalised += std::pow((corner.disparity - truth) / corner.disparity_error, 2);
    EXPECT_EQ(corner.point_in_cam, kCamera.point(corner.x, corner.y, corner.disparity));
    ++count;
  }
  ASSERT_GT(count, 80);
  EXPECT_LT(rms_after, 0.5 * rms_before);
  // The stated variance is that of one image's share, of two: the squared error is twice as large, within the factor of
  // two by which noise in the gradients is only roughly known.
  EXPECT_GT(normalised / count, 0.7);
  EXPECT_LT(normalised / count, 4);
}

TEST(MeasureDisparities, LeavesWhatItCannotMatch) {
  const testing::SyntheticView left = testing::render_room({}, kCamera, Pose::Identity());
  const cv::Mat1b empty(left.image.size(), uint8_t{90});
  const ViewFeatures features = extract_features(left.image, left.disparity, kCamera, {}, empty);
  ASSERT_GT(features.corners.size(), 100u);
  for (const Corner& corner : features.corners) {
    EXPECT_EQ(corner.disparity_error, 0);
    EXPECT_EQ(corner.disparity, usable_disparity(left.disparity, corner.x, corner.y, kCamera, {}));
  }
}

}  // namespace
}  // namespace iris::motion
