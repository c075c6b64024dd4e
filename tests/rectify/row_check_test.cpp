#include "iris/rectify/row_check.h"

#include <gtest/gtest.h>

#include <opencv2/imgproc.hpp>
#include <random>

#include "iris/rectify/rectifier.h"
#include "iris/session/session.h"
#include "support/test_data.h"

namespace iris::rectify {
namespace {

StereoCalibration rig() {
  StereoCalibration c;
  c.left.width = c.right.width = 640;
  c.left.height = c.right.height = 480;
  c.left.K << 500, 0, 325, 0, 498, 236, 0, 0, 1;
  c.right.K << 503, 0, 316, 0, 502, 243, 0, 0, 1;
  c.left.coefficients = {-0.2, 0.06, 0.0005, -0.0003};
  c.right.coefficients = {-0.21, 0.07, -0.0004, 0.0002};
  c.right_from_left.linear() = Eigen::AngleAxisd(0.02, Eigen::Vector3d(1, -2, 0.5).normalized()).toRotationMatrix();
  c.right_from_left.translation() = -(c.right_from_left.linear() * Eigen::Vector3d(0.11, 0.002, 0.001));
  return c;
}

// Points that `truth` sees, as they appear in images rectified by `calibration`.
std::vector<RowMatch> matches_of(const StereoCalibration& truth, const StereoCalibration& calibration, int count,
                                 double noise) {
  const Rectifier rectifier(calibration);
  const RectifiedCamera& camera = rectifier.camera();
  std::mt19937 random(3);
  std::uniform_real_distribution<double> uniform(-1, 1);
  std::normal_distribution<double> normal(0, 1);
  const Eigen::Matrix3d rect = rectifier.rect_from_left();
  const auto rectified = [&](const Eigen::Vector3d& ray) {
    return Eigen::Vector2d(camera.f * ray.x() / ray.z() + camera.cx, camera.f * ray.y() / ray.z() + camera.cy);
  };
  std::vector<RowMatch> matches;
  while (static_cast<int>(matches.size()) < count) {
    const double z = 2.2 + 1.8 * uniform(random);
    const Eigen::Vector3d p(0.6 * z * uniform(random), 0.45 * z * uniform(random), z);
    const Eigen::Vector2d l = truth.left.project(p), r = truth.right.project(truth.right_from_left * p);
    const auto seen = [](const Eigen::Vector2d& q) { return q.x() > 0 && q.y() > 0 && q.x() < 639 && q.y() < 479; };
    if (!seen(l) || !seen(r)) continue;
    RowMatch match{rectified(rect * calibration.left.unproject(l)),
                   rectified(rect * calibration.right_from_left.linear().transpose() * calibration.right.unproject(r))};
    match.right.y() += noise * normal(random);
    if (noise > 0 && matches.size() % 20 == 0) match.right.y() += 9 * uniform(random);  // wrong ones
    matches.push_back(match);
  }
  return matches;
}

TEST(RowCheck, RightCalibrationFitsAndATurnedCameraDoesNot) {
  const StereoCalibration truth = rig();
  const RowCheckOptions options;
  const RowCheck good = check_rows(matches_of(truth, truth, 2000, 0.2), 640, 480, options);
  EXPECT_TRUE(good.fits);
  EXPECT_LT(good.systematic, 0.1);
  EXPECT_NEAR(good.scatter, 0.2, 0.05);
  StereoCalibration off = truth;
  off.right_from_left.linear() =
      Eigen::AngleAxisd(3.0 / 502, Eigen::Vector3d::UnitX()) * truth.right_from_left.linear();
  off.right_from_left.translation() = -(off.right_from_left.linear() * truth.right_centre_in_left());
  const RowCheck bad = check_rows(matches_of(truth, off, 2000, 0.2), 640, 480, options);
  EXPECT_TRUE(bad.enough);
  EXPECT_FALSE(bad.fits);
  EXPECT_NEAR(std::abs(bad.median), 3, 0.3);  // 3 px in the middle, more towards the top and the bottom
  EXPECT_FALSE(check_rows({}, 640, 480, options).enough);
}

// The turn that is missing is found: about x and z exactly, about y as far as the rows show it.
TEST(RowCheck, RefinementFindsTheTurn) {
  const StereoCalibration truth = rig();
  for (const double noise : {0.0, 0.2}) {
    StereoCalibration off = truth;
    const Eigen::Vector3d turn(0.006, -0.0008, -0.004);
    off.right_from_left.linear() =
        Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix() * truth.right_from_left.linear();
    off.right_from_left.translation() = -(off.right_from_left.linear() * truth.right_centre_in_left());
    const RotationRefinement refined = refine_rotation(off, matches_of(truth, off, 3000, noise));
    const Eigen::AngleAxisd left_over(
        Eigen::Matrix3d(refined.calibration.right_from_left.linear() * truth.right_from_left.linear().transpose()));
    const Eigen::Vector3d error = left_over.angle() * left_over.axis();
    std::printf("noise %.1f px: left over %.2e %.2e %.2e rad, sigma %.2e %.2e %.2e\n", noise, error.x(), error.y(),
                error.z(), refined.sigma.x(), refined.sigma.y(), refined.sigma.z());
    for (int i = 0; i < 3; ++i) EXPECT_LT(std::abs(error(i)), 3 * refined.sigma(i)) << i;
    EXPECT_LT(std::abs(error.x()), 2e-4);  // 0.1 px
    EXPECT_LT(std::abs(error.z()), 4e-4);
    EXPECT_LT((refined.calibration.right_centre_in_left() - truth.right_centre_in_left()).norm(), 1e-12);
    const RowCheck check = check_rows(matches_of(truth, refined.calibration, 3000, noise), 640, 480, {});
    EXPECT_TRUE(check.fits);
    EXPECT_LT(check.systematic, 0.1);
  }
}

// A texture shifted by 17.4 px and 2.3 rows.
TEST(RowCheck, MatchesAreFoundToTenthsOfPixels) {
  cv::Mat1f noise(300, 500);
  cv::theRNG().state = 5;
  cv::randn(noise, 128, 90);
  cv::GaussianBlur(noise, noise, {0, 0}, 2);
  cv::normalize(noise, noise, 20, 235, cv::NORM_MINMAX);
  StereoPair pair;
  noise.convertTo(pair.left, CV_8U);
  cv::Mat moved;
  cv::warpAffine(noise, moved, cv::Matx23d(1, 0, -17.4, 0, 1, 2.3), noise.size(), cv::INTER_CUBIC, cv::BORDER_REFLECT);
  moved.convertTo(pair.right, CV_8U, 0.8, 20);  // another exposure
  const std::vector<RowMatch> matches = match_rows(pair, {});
  ASSERT_GT(matches.size(), 100u);
  double sum = 0;
  for (const RowMatch& match : matches) {
    EXPECT_NEAR(match.left.x() - match.right.x(), 17.4, 0.3);
    sum += match.error() / static_cast<double>(matches.size());
  }
  EXPECT_NEAR(sum, 2.3, 0.05);
}

std::vector<RowMatch> matches_in(const session::Session& session, const StereoCalibration& calibration) {
  const Rectifier rectifier(calibration);
  std::vector<RowMatch> matches;
  for (int k = 0; k < 20; ++k) {
    const auto more = match_rows(rectifier.rectify(session.read(k * session.size() / 20)), {});
    matches.insert(matches.end(), more.begin(), more.end());
  }
  return matches;
}

// The right image lies 3 px low. The assumed calibration says so; without that the check finds it and the refinement
// removes it.
TEST(RowCheck, TheRoversThreePixelsAreFoundAndRemoved) {
  IRIS_NEEDS_TEST_DATA("rover_sandbox_b");
  const auto session = session::open_session(iris::testing::test_data("rover_sandbox_b"), {});
  const int width = 512, height = 288;
  StereoCalibration off = session->calibration();
  off.right.K(1, 2) = off.left.K(1, 2);
  off.rectified = is_rectified(off);
  const RowCheck found = check_rows(matches_in(*session, off), width, height, {});
  const RotationRefinement refined = refine_rotation(off, matches_in(*session, off));
  const RowCheck removed = check_rows(matches_in(*session, refined.calibration), width, height, {});
  const RowCheck as_given = check_rows(matches_in(*session, session->calibration()), width, height, {});
  std::printf(
      "rover: %d matches; without the 3 px: median %+.2f px, systematic %.2f; refined: median %+.2f, systematic %.2f; "
      "as given: median %+.2f, systematic %.2f\n",
      found.matches, found.median, found.systematic, removed.median, removed.systematic, as_given.median,
      as_given.systematic);
  EXPECT_TRUE(found.enough);
  EXPECT_FALSE(found.fits);
  EXPECT_NEAR(found.median, 3, 0.5);
  EXPECT_TRUE(removed.fits);
  EXPECT_LT(std::abs(removed.median), 0.2);
  EXPECT_LT(removed.systematic, as_given.systematic + 0.05);
}

}  // namespace
}  // namespace iris::rectify
