#include "iris/reconstruct/error_propagation.h"

#include <gtest/gtest.h>

#include <random>

#include "iris/reconstruct/error_models.h"
#include "support/numeric.h"

namespace iris::reconstruct {
namespace {

const RectifiedCamera kCamera{.f = 436, .cx = 364, .cy = 257, .baseline = 0.11, .width = 752, .height = 480};

// The thesis's reconstruction from all four coordinates (ch. 4): y is the mean of both rows.
Eigen::Vector3d reconstructed(const Eigen::Vector4d& pixels) {
  const double s = kCamera.baseline / (pixels(0) - pixels(2));
  return {s * pixels(0), s * (pixels(1) + pixels(3)) / 2, s * kCamera.f};
}

Eigen::Vector4d projected(const Eigen::Vector3d& p) {
  const double s = kCamera.f / p.z();
  return {s * p.x(), s * p.y(), s * (p.x() - kCamera.baseline), s * p.y()};
}

const std::vector<Eigen::Vector3d> kPoints{{0, 0, 1}, {0.7, -0.4, 1.5}, {-1.3, 0.9, 2.5}, {2, 1, 6}, {-0.05, 0.3, 0.6}};

TEST(PointJacobian, EqualsTheNumericDerivative) {
  for (const Eigen::Vector3d& p : kPoints) {
    const Eigen::MatrixXd numeric = testing::numeric_jacobian(
        [](const Eigen::VectorXd& x) -> Eigen::VectorXd { return reconstructed(x); }, projected(p), 1e-4);
    EXPECT_LT((point_jacobian(kCamera, p) - numeric).norm(), 1e-7 * numeric.norm());
  }
}

TEST(PointCovariance, HasTheVariancesOfTheCoordinates) {  // (4.21)
  for (const Eigen::Vector3d& p : kPoints) {
    const Eigen::Vector3d expected = point_covariance(kCamera, p, 0.3).diagonal().cwiseSqrt();
    EXPECT_LT((coordinate_errors(kCamera, p, 0.3) - expected).norm(), 1e-12 * expected.norm());
  }
}

TEST(PointCovariance, EqualsTheSpreadOfSimulatedMeasurements) {
  std::mt19937_64 random(1);
  std::normal_distribution<double> noise(0, 0.1);
  const Eigen::Vector3d p(0.7, -0.4, 1.5);
  constexpr int kTrials = 20000;
  Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
  for (int i = 0; i < kTrials; ++i) {
    Eigen::Vector4d pixels = projected(p);
    for (double& v : pixels) v += noise(random);
    const Eigen::Vector3d e = reconstructed(pixels) - p;
    sum += e * e.transpose();
  }
  // A variance from n samples has a relative error of sqrt(2/n) = 1 %; four of those.
  const Eigen::Matrix3d expected = point_covariance(kCamera, p, 0.1);
  EXPECT_LT((sum / kTrials - expected).norm(), 0.04 * expected.norm());
}

TEST(RangeError, EqualsNumericPropagation) {  // (4.23)
  for (const Eigen::Vector3d& p : kPoints) {
    const Eigen::MatrixXd gradient = testing::numeric_jacobian(
        [](const Eigen::VectorXd& x) -> Eigen::VectorXd {
          return Eigen::VectorXd::Constant(1, reconstructed(x).norm());
        },
        projected(p), 1e-4);
    EXPECT_NEAR(range_error(kCamera, p, 0.1), 0.1 * gradient.norm(), 1e-7 * gradient.norm());
  }
}

TEST(ApproximateRangeError, IsCloseWherePointsAreFarComparedWithTheBaseline) {  // (4.24)
  for (const double x : {-0.8, -0.3, 0.0, 0.4, 0.8}) {
    for (const double y : {-0.5, 0.0, 0.5}) {
      const Eigen::Vector3d p = 4 * Eigen::Vector3d(x, y, 1);
      EXPECT_NEAR(approximate_range_error(kCamera, p, 0.1) / range_error(kCamera, p, 0.1), 1, 0.016);
    }
  }
}

TEST(LengthError, EqualsNumericPropagation) {  // (4.26)
  for (const Eigen::Vector3d& p : kPoints) {
    for (const Eigen::Vector3d& q : kPoints) {
      if (p == q) {
        EXPECT_EQ(length_error(kCamera, p, q, 0.1), 0);
        continue;
      }
      Eigen::VectorXd both(8);
      both << projected(p), projected(q);
      const Eigen::MatrixXd gradient = testing::numeric_jacobian(
          [](const Eigen::VectorXd& x) -> Eigen::VectorXd {
            return Eigen::VectorXd::Constant(1, (reconstructed(x.head<4>()) - reconstructed(x.tail<4>())).norm());
          },
          both, 1e-4);
      EXPECT_NEAR(length_error(kCamera, p, q, 0.1), 0.1 * gradient.norm(), 1e-6 * gradient.norm());
    }
  }
}

TEST(ImageJacobian, EqualsTheNumericDerivative) {
  for (const Eigen::Vector3d& p : kPoints) {
    const Eigen::MatrixXd numeric = testing::numeric_jacobian(
        [](const Eigen::VectorXd& x) -> Eigen::VectorXd { return image_coordinates(kCamera, x); }, p, 1e-5);
    EXPECT_LT((image_jacobian(kCamera, p) - numeric).norm(), 1e-8 * numeric.norm());
  }
}

Pose some_motion() {
  Pose motion = Pose::Identity();
  motion.linear() = Eigen::AngleAxisd(0.15, Eigen::Vector3d(0.3, 1, -0.2).normalized()).toRotationMatrix();
  motion.translation() = Eigen::Vector3d(0.1, -0.05, 0.2);
  return motion;
}

TEST(ImageError, IsTheLeastSumOverAllPoints) {
  const Pose p_from_q = some_motion();
  const Eigen::Vector3d q(0.4, -0.2, 1.8), p = p_from_q * q + Eigen::Vector3d(0.004, -0.003, 0.02);
  const ImageError error = image_error(kCamera, p, q, p_from_q, 1.0);
  const auto sum = [&](const Eigen::Vector3d& v) {
    return (projected(v) - projected(q)).squaredNorm() + (projected(p_from_q * v) - projected(p)).squaredNorm();
  };
  EXPECT_NEAR(error.square, sum(error.best), 1e-12 * error.square);
  for (int axis = 0; axis < 3; ++axis)
    for (const double step : {-1e-4, 1e-4})
      EXPECT_GT(sum(error.best + step * Eigen::Vector3d::Unit(axis)), error.square);
}

TEST(ErrorModels, AreZeroForEqualPoints) {
  const Pose p_from_q = some_motion();
  const Eigen::Vector3d q(0.4, -0.2, 1.8), p = p_from_q * q;
  EXPECT_NEAR(spherical_error(kCamera, p, q, p_from_q, 0.1), 0, 1e-20);
  EXPECT_NEAR(ellipsoid_error(kCamera, p, q, p_from_q, 0.1), 0, 1e-20);
  EXPECT_NEAR(drift_error(kCamera, p, q, p_from_q, 0.1), 0, 1e-20);
  EXPECT_NEAR(image_error(kCamera, p, q, p_from_q, 0.1).square, 0, 1e-20);
}

TEST(ErrorModels, HaveMeanThreeUnderTheAssumedNoise) {
  // Eight coordinates, of which y counts double in both views and three are spent on the point: 8 - 2 - 3 = 3.
  std::mt19937_64 random(2);
  std::normal_distribution<double> noise(0, 0.1);
  const Pose p_from_q = some_motion();
  double ellipsoid = 0, drift = 0, image = 0;
  constexpr int kTrials = 10000;
  for (int i = 0; i < kTrials; ++i) {
    const Eigen::Vector3d v(0.4, -0.2, 1.8);
    Eigen::Vector4d at_q = projected(v), at_p = projected(p_from_q * v);
    for (double& x : at_q) x += noise(random);
    for (double& x : at_p) x += noise(random);
    const Eigen::Vector3d q = reconstructed(at_q), p = reconstructed(at_p);
    ellipsoid += ellipsoid_error(kCamera, p, q, p_from_q, 0.1) / kTrials;
    drift += drift_error(kCamera, p, q, p_from_q, 0.1) / kTrials;
    image += image_error(kCamera, p, q, p_from_q, 0.1).square / kTrials;
  }
  // The mean of 10000 values of variance 6 is known to 0.025; four of those.
  EXPECT_NEAR(ellipsoid, 3, 0.1);
  EXPECT_NEAR(drift, 3, 0.1);
  EXPECT_NEAR(image, 3, 0.1);
}

TEST(DriftedCentre, LiesMidwayBetweenTheNearestAndFarthestPointOfTheContour) {  // (4.17 - 4.19)
  const Eigen::Vector3d p(0.4, -0.2, 3.0), b(kCamera.baseline / 2, 0, 0);
  const double error = 1.3;
  // Bisection for both scale factors along the line from the middle of the cameras at which the image error is `error`.
  const auto image_difference = [&](double s) { return (projected(s * (p - b) + b) - projected(p)).norm(); };
  double scale[2];
  for (int side = 0; side < 2; ++side) {
    double inside = 1, outside = side == 0 ? 0.2 : 5;
    for (int i = 0; i < 100; ++i) {
      const double middle = (inside + outside) / 2;
      (image_difference(middle) < error ? inside : outside) = middle;
    }
    scale[side] = inside;
  }
  const Eigen::Vector3d expected = (scale[0] + scale[1]) / 2 * (p - b) + b;
  EXPECT_LT((drifted_centre(kCamera, p, error) - expected).norm(), 1e-9);
}

}  // namespace
}  // namespace iris::reconstruct
