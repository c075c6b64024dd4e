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

// Spread of a function of simulated measurements of points [f(measured points)], n draws of 0.1 px noise.
template <class Function>
Eigen::MatrixXd simulated_covariance(const std::vector<Eigen::Vector3d>& points, const Function& f, int draws) {
  std::mt19937_64 random(1);
  std::normal_distribution<double> noise(0, 0.1);
  std::vector<Eigen::Vector3d> measured = points;
  const Eigen::VectorXd truth = f(points);
  Eigen::VectorXd mean = Eigen::VectorXd::Zero(truth.size());
  Eigen::MatrixXd sum = Eigen::MatrixXd::Zero(truth.size(), truth.size());
  for (int i = 0; i < draws; ++i) {
    for (size_t k = 0; k < points.size(); ++k) {
      Eigen::Vector4d pixels = projected(points[k]);
      for (double& v : pixels) v += noise(random);
      measured[k] = reconstructed(pixels);
    }
    const Eigen::VectorXd e = f(measured) - truth;
    mean += e / draws;
    sum += e * e.transpose() / draws;
  }
  return sum - mean * mean.transpose();
}

// A standard deviation from n draws has a relative error of 1 / sqrt(2 n): 0.16 % of 200 000. The propagation is
// linear: 0.14 px of 6 or more px of disparity leave (0.14 / 6)^2 of it.
constexpr int kDraws = 200000;

TEST(PointCovariance, EqualsTheSpreadOfSimulatedMeasurements) {
  for (const Eigen::Vector3d& p : kPoints) {
    const Eigen::MatrixXd simulated = simulated_covariance(
        {p}, [](const auto& points) -> Eigen::VectorXd { return points[0]; }, kDraws);
    const Eigen::Matrix3d expected = point_covariance(kCamera, p, 0.1);
    EXPECT_LT((simulated - expected).norm(), 0.02 * expected.norm());
    for (int axis = 0; axis < 3; ++axis) {  // (4.21)
      EXPECT_NEAR(coordinate_errors(kCamera, p, 0.1)(axis) / std::sqrt(simulated(axis, axis)), 1, 0.02);
    }
  }
}

TEST(RangeError, EqualsTheSpreadOfSimulatedMeasurements) {  // (4.23), (4.24)
  for (const Eigen::Vector3d& p : kPoints) {
    const double simulated = std::sqrt(simulated_covariance(
        {p}, [](const auto& points) -> Eigen::VectorXd { return Eigen::VectorXd::Constant(1, points[0].norm()); },
        kDraws)(0, 0));
    EXPECT_NEAR(range_error(kCamera, p, 0.1) / simulated, 1, 0.02);
    EXPECT_NEAR(approximate_range_error(kCamera, p, 0.1) / simulated, 1, 0.02);
  }
}

TEST(LengthError, EqualsTheSpreadOfSimulatedMeasurements) {  // (4.26)
  for (size_t i = 0; i + 1 < kPoints.size(); ++i) {
    const Eigen::Vector3d &p = kPoints[i], &q = kPoints[i + 1];
    const double simulated = std::sqrt(simulated_covariance(
        {p, q},
        [](const auto& points) -> Eigen::VectorXd {
          return Eigen::VectorXd::Constant(1, (points[0] - points[1]).norm());
        },
        kDraws)(0, 0));
    EXPECT_NEAR(length_error(kCamera, p, q, 0.1) / simulated, 1, 0.02);
  }
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
