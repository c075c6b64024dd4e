#include "iris/calibrate/stereo.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <random>

#include "iris/calibrate/quality.h"
#include "support/target_images.h"
#include "support/test_data.h"

namespace iris::calibrate {
namespace {

using iris::testing::Sheet;
using iris::testing::target_poses;
using iris::testing::target_rig;
using iris::testing::target_views;
using iris::testing::TargetRenderer;
using ::testing::AllOf;
using ::testing::HasSubstr;
using Status = StereoCalibrationResult::Status;

const char* const kSquares = "squares:7x5:20mm";

StereoCalibrationResult calibrate(const std::vector<TargetView>& views, const Target& target,
                                  CalibrateOptions options = {}) {
  return calibrate_stereo(views, target, 640, 480, options);
}

// RMS [px] of the vertical errors of points that were not used, through the true cameras, after rectification by the
// calibration under test.
double vertical_error_of_unseen_points(const StereoCalibration& rig, const StereoCalibration& calibration) {
  std::mt19937 random(99);
  std::uniform_real_distribution<double> uniform(-1, 1);
  TargetView view;
  for (int i = 0; view.left.size() < 2000; ++i) {
    const double z = 1.5 + uniform(random);
    const Eigen::Vector3d p(0.7 * z * uniform(random), 0.5 * z * uniform(random), z);
    const Eigen::Vector2d l = rig.left.project(p), r = rig.right.project(rig.right_from_left * p);
    const auto seen = [](const Eigen::Vector2d& q) { return q.x() > 0 && q.y() > 0 && q.x() < 639 && q.y() < 479; };
    if (!seen(l) || !seen(r)) continue;
    view.left.ids.push_back(i);
    view.right.ids.push_back(i);
    view.left.points.push_back(l);
    view.right.points.push_back(r);
  }
  double sum = 0;
  const std::vector<double> errors = vertical_errors(calibration, view);
  for (const double e : errors) sum += e * e;
  return std::sqrt(sum / static_cast<double>(errors.size()));
}

struct Model {
  const char* name;
  Distortion distortion;
  size_t coefficients;
};
class Models : public ::testing::TestWithParam<Model> {
 protected:
  StereoCalibration rig() const {
    StereoCalibration rig = target_rig(GetParam().distortion);
    for (CameraModel* camera : {&rig.left, &rig.right}) {
      camera->coefficients.resize(GetParam().coefficients, 0.0);
    }
    return rig;
  }
};

// Next to no noise: the truth comes back, however far the start was from it.
TEST_P(Models, PerfectCornersGiveTheTruth) {
  const Target target = parse_target(kSquares);
  const StereoCalibration truth = rig();
  CalibrateOptions options;
  options.distortion = GetParam().name;
  options.robust = 0;
  const double noise = 1e-5;  // [px]
  const auto result =
      calibrate(target_views(target, truth, target_poses(target, truth, 12, 7), noise, 1), target, options);
  ASSERT_EQ(result.status, Status::ok) << result.problem;
  EXPECT_LT(result.rms, 3e-3);
  EXPECT_LT(vertical_error_of_unseen_points(truth, result.calibration), 1e-3);
  const Eigen::VectorXd expected = parameters_of(truth), found = parameters_of(result.calibration);
  for (Eigen::Index i = 0; i < expected.size(); ++i) {
    EXPECT_NEAR(found(i), expected(i), 5 * std::sqrt(result.covariance(i, i)) + 1e-9)
        << result.parameters[static_cast<size_t>(i)].name;
  }
}

INSTANTIATE_TEST_SUITE_P(All, Models,
                         ::testing::Values(Model{"radial", Distortion::radial_tangential, 2},
                                           Model{"radtan4", Distortion::radial_tangential, 4},
                                           Model{"radtan", Distortion::radial_tangential, 5},
                                           Model{"fisheye", Distortion::equidistant, 4}),
                         [](const auto& test) { return std::string(test.param.name); });

// The stated standard deviations are those of the errors: of 24 parameters in 50 calibrations 0.27 % lie beyond
// 3 sigma (3.2 of 1200; 12 would happen once in 30000 times, if they were independent), and the mean square of error /
// sigma is 1.
TEST(StereoCalibrate, ParametersComeBackWithinThreeSigmaOver50Seeds) {
  const Target target = parse_target(kSquares);
  const StereoCalibration rig = target_rig();
  const Eigen::VectorXd truth = parameters_of(rig);
  constexpr int kSeeds = 50;
  constexpr double kNoise = 0.025;  // [px] thesis figure 2.4
  int beyond = 0;
  double sum = 0, largest = 0, sigma = 0;
  Eigen::VectorXd mean = Eigen::VectorXd::Zero(truth.size());
  for (int seed = 0; seed < kSeeds; ++seed) {
    const auto seed_number = static_cast<unsigned>(seed);
    const auto result = calibrate(
        target_views(target, rig, target_poses(target, rig, 6, 100 + seed_number), kNoise, seed_number), target);
    ASSERT_EQ(result.status, Status::ok) << result.problem;
    ASSERT_EQ(result.covariance.rows(), truth.size());
    for (Eigen::Index i = 0; i < truth.size(); ++i) {
      const double error = (parameters_of(result.calibration)(i) - truth(i)) / std::sqrt(result.covariance(i, i));
      beyond += std::abs(error) > 3;
      largest = std::max(largest, std::abs(error));
      sum += error * error;
      mean(i) += error / kSeeds;
    }
    sigma += result.sigma / kSeeds;
  }
  const double count = kSeeds * static_cast<double>(truth.size());
  std::printf(
      "%d of %.0f parameters beyond 3 sigma, largest %.2f sigma, mean square %.3f, largest mean %.2f sigma, corner "
      "sigma %.4f px\n",
      beyond, count, largest, sum / count, mean.cwiseAbs().maxCoeff(), sigma);
  EXPECT_LE(beyond, 12);
  EXPECT_LT(largest, 4.5);
  EXPECT_NEAR(sum / count, 1, 0.15);  // parameters are correlated: about 10 independent ones in 50 calibrations
  EXPECT_LT(mean.cwiseAbs().maxCoeff(), 3.5 / std::sqrt(kSeeds));  // no bias
  EXPECT_NEAR(sigma, kNoise, 0.02 * kNoise);
}

// Thesis 2.5: images, five pairs, 45 dB, vertical error after rectification (thesis 0.10 to 0.16 px).
TEST(StereoCalibrate, FivePairsOfImagesRectifyToATenthOfAPixel) {
  const Target target = parse_target(kSquares);
  const StereoCalibration rig = target_rig();
  const TargetRenderer left(rig.left), right(rig.right);
  const Sheet sheet(target);
  for (const unsigned set : {11u, 12u}) {
    std::vector<TargetView> views;
    unsigned seed = 100 * set;
    for (const Pose& pose : target_poses(target, rig, 5, set)) {
      TargetView view;
      view.left = find_target(left.render(sheet, pose, 45, ++seed), target).corners;
      view.right = find_target(right.render(sheet, rig.right_from_left * pose, 45, ++seed), target).corners;
      match_orientation(target, view.left, view.right);
      views.push_back(std::move(view));
    }
    const auto result = calibrate(views, target);
    ASSERT_EQ(result.status, Status::ok) << result.problem;
    EXPECT_EQ(result.corners, 5 * 2 * 140);
    const double unseen = vertical_error_of_unseen_points(rig, result.calibration);
    const CrossValidation validation = cross_validate(views, target, result, {});
    const double baseline = result.calibration.right_centre_in_left().norm();
    std::printf(
        "5 pairs: RMS %.4f px, vertical error of unseen points %.4f px, cross-validated %.4f px, baseline off by "
        "%.3f mm\n",
        result.rms, unseen, validation.rms, 1000 * (baseline - rig.right_centre_in_left().norm()));
    EXPECT_LE(result.rms, 0.06);
    EXPECT_LE(unseen, 0.10);
    EXPECT_LE(validation.rms, 0.10);
    EXPECT_EQ(validation.pairs, 5);
    EXPECT_EQ(validation.corners, 5 * 140);
  }
}

// A board bent by 0.3 mm and printed 0.1 mm off: taken for perfect, it falsifies the rig by far more than the stated
// standard deviations; with its corners' places estimated the rig is right, and so are these.
TEST(StereoCalibrate, AnUnevenTargetIsFoundOutAndDoesNoHarm) {
  const Target target = parse_target("chessboard:9x6:25mm");
  const StereoCalibration rig = target_rig();
  const Eigen::VectorXd truth = parameters_of(rig);
  CalibrateOptions options, perfect;
  perfect.flatness = 0;
  constexpr int kSeeds = 10;
  double taken_for_perfect = 0, estimated = 0, shape = 0;
  for (unsigned seed = 0; seed < kSeeds; ++seed) {
    std::mt19937 random(seed);
    std::normal_distribution<double> normal(0, 1e-4);
    std::vector<Eigen::Vector3d> places = target_points(target);
    for (Eigen::Vector3d& p : places) {
      const double u = p.x() / 0.2 - 0.5, v = p.y() / 0.125 - 0.5;
      const double bend = 3e-4 * (4 * u * u - 2 * u * v);
      const double dx = normal(random), dy = normal(random);
      p += Eigen::Vector3d(dx, dy, bend);
    }
    const auto views = target_views(target, rig, target_poses(target, rig, 13, 20 + seed), 0.05, seed, places);
    const auto result = calibrate(views, target, options), plain = calibrate(views, target, perfect);
    ASSERT_EQ(result.status, Status::ok) << result.problem;
    const auto in_sigmas = [&](const StereoCalibrationResult& r) {
      const Eigen::VectorXd error = parameters_of(r.calibration) - truth;
      return error.cwiseQuotient(r.covariance.diagonal().cwiseSqrt()).squaredNorm() / static_cast<double>(error.size());
    };
    estimated += in_sigmas(result) / kSeeds;
    taken_for_perfect += in_sigmas(plain) / kSeeds;
    // The shape, apart from where its frame is: the same from both sets after a rigid alignment.
    Eigen::Matrix3Xd found(3, places.size()), made(3, places.size());
    for (size_t i = 0; i < places.size(); ++i) {
      found.col(static_cast<Eigen::Index>(i)) = result.sheet[i];
      made.col(static_cast<Eigen::Index>(i)) = places[i];
    }
    const Eigen::Matrix4d aligned = Eigen::umeyama(found, made, false);
    const Eigen::Matrix3Xd off =
        (aligned.topLeftCorner<3, 3>() * found).colwise() + aligned.topRightCorner<3, 1>() - made;
    shape += std::sqrt(off.squaredNorm() / static_cast<double>(places.size())) / kSeeds;
    EXPECT_GT(result.sheet_across, 5e-5);
    EXPECT_GT(result.sheet_along, 5e-5);
  }
  std::printf("uneven board: mean square error / sigma %.2f, taken for perfect %.1f; its shape to %.3f mm (RMS)\n",
              estimated, taken_for_perfect, 1000 * shape);
  EXPECT_NEAR(estimated, 1, 0.5);
  EXPECT_GT(taken_for_perfect, 5);
  EXPECT_LT(shape, 5e-5);
}

// A perfect board stays perfect: noise alone is never taken for a shape.
TEST(StereoCalibrate, APerfectTargetIsNotBent) {
  const Target target = parse_target("chessboard:9x6:25mm");
  const StereoCalibration rig = target_rig();
  for (unsigned seed = 0; seed < 10; ++seed) {
    const auto result =
        calibrate(target_views(target, rig, target_poses(target, rig, 8, 40 + seed), 0.1, seed), target);
    ASSERT_EQ(result.status, Status::ok) << result.problem;
    EXPECT_EQ(result.sheet_along, 0);
    EXPECT_EQ(result.sheet_across, 0);
  }
}

TEST(StereoCalibrate, ViewsOfOneCameraHelpItAlone) {
  const Target target = parse_target(kSquares);
  const StereoCalibration rig = target_rig();
  std::vector<TargetView> views = target_views(target, rig, target_poses(target, rig, 10, 4), 0.05, 4);
  const auto all = calibrate(views, target);
  for (size_t i = 5; i < 10; ++i) (i % 2 == 0 ? views[i].left : views[i].right) = {};
  const auto some = calibrate(views, target);
  views.resize(5);
  const auto pairs = calibrate(views, target);
  ASSERT_EQ(some.status, Status::ok) << some.problem;
  EXPECT_EQ(some.pairs, 5);
  EXPECT_EQ(some.left_views, 8);
  EXPECT_EQ(some.right_views, 7);
  EXPECT_LT(some.parameters[0].sigma, pairs.parameters[0].sigma);
  EXPECT_GT(some.parameters[0].sigma, all.parameters[0].sigma);
  EXPECT_NEAR(some.parameters[0].value, rig.left.K(0, 0), 4 * some.parameters[0].sigma);
}

TEST(StereoCalibrate, SingleWrongCornersDoNoHarm) {
  const Target target = parse_target(kSquares);
  const StereoCalibration rig = target_rig();
  std::vector<TargetView> views = target_views(target, rig, target_poses(target, rig, 8, 4), 0.03, 4);
  std::mt19937 random(5);
  for (TargetView& view : views) {
    for (int k = 0; k < 4; ++k) view.left.points[random() % 140] += Eigen::Vector2d(8, -5);
  }
  CalibrateOptions plain;
  plain.robust = 0;
  const double robust = vertical_error_of_unseen_points(rig, calibrate(views, target).calibration);
  const double squares = vertical_error_of_unseen_points(rig, calibrate(views, target, plain).calibration);
  std::printf("3 %% of the corners 9 px off: vertical error %.4f px, without robust loss %.4f px\n", robust, squares);
  EXPECT_LT(robust, 0.05);
  EXPECT_GT(squares, 3 * robust);
}

TEST(StereoCalibrate, ClearErrors) {
  const Target target = parse_target(kSquares);
  const StereoCalibration rig = target_rig();
  const std::vector<TargetView> good = target_views(target, rig, target_poses(target, rig, 8, 4), 0.03, 4);
  // One camera with too few views.
  std::vector<TargetView> views = good;
  for (size_t i = 2; i < views.size(); ++i) views[i].right = {};
  auto result = calibrate(views, target);
  EXPECT_EQ(result.status, Status::too_few_views);
  EXPECT_THAT(result.problem,
              AllOf(HasSubstr("the right camera sees the target in 2"), HasSubstr("the other one in 8")));
  // Enough views of each, too few of both.
  views = good;
  for (size_t i = 2; i < views.size(); ++i) (i % 2 ? views[i].left : views[i].right) = {};
  result = calibrate(views, target);
  EXPECT_EQ(result.status, Status::too_few_views);
  EXPECT_THAT(result.problem, HasSubstr("2 pairs only"));
  // All images mirrored: every corner found in a mirrored image is numbered as in an ordinary one.
  const auto mirror = [](Corners& corners) {
    std::vector<Eigen::Vector2d> points(corners.size());
    for (size_t i = 0; i < corners.size(); ++i) {
      const size_t square = i / 4, row = square / 7, column = square % 7, k = i % 4;
      const size_t other = 4 * (7 * row + 6 - column) + (k ^ 1);
      points[i] = {639 - corners.points[other].x(), corners.points[other].y()};
    }
    corners.points = points;
  };
  views = good;
  for (TargetView& view : views) {
    mirror(view.left);
    mirror(view.right);
  }
  result = calibrate(views, target);
  EXPECT_EQ(result.status, Status::mirrored);
  EXPECT_THAT(result.problem + result.remedy, AllOf(HasSubstr("98 mm left of the left one"), HasSubstr("mirrored")));
  // Those of one camera.
  views = good;
  for (TargetView& view : views) mirror(view.right);
  result = calibrate(views, target);
  EXPECT_NE(result.status, Status::ok);
  EXPECT_THAT(result.remedy, HasSubstr("mirrored"));
  // Left and right images that do not belong together.
  views = good;
  for (size_t i = 0; i < views.size(); ++i) views[i].right = good[(i + 1) % good.size()].right;
  result = calibrate(views, target);
  EXPECT_EQ(result.status, Status::inconsistent);
  EXPECT_THAT(result.remedy, HasSubstr("belong together"));
}

struct OpenCvResult {
  double rms = 0, baseline = 0;  // [px] [mm]
};

// The same corners through OpenCV's stereoCalibrate, all of it free.
OpenCvResult by_opencv(const std::vector<TargetView>& views, const Target& target) {
  const auto sheet = target_points(target);
  std::vector<std::vector<cv::Point3f>> objects;
  std::vector<std::vector<cv::Point2f>> lefts, rights;
  for (const TargetView& view : views) {
    objects.emplace_back();
    lefts.emplace_back();
    rights.emplace_back();
    for (size_t i = 0; i < sheet.size(); ++i) {
      const auto point = [](const Eigen::Vector2d& p) {
        return cv::Point2f(static_cast<float>(p.x()), static_cast<float>(p.y()));
      };
      objects.back().emplace_back(static_cast<float>(sheet[i].x()), static_cast<float>(sheet[i].y()), 0.0f);
      lefts.back().push_back(point(view.left.points[i]));
      rights.back().push_back(point(view.right.points[i]));
    }
  }
  cv::Mat K1, D1, K2, D2, R, T, E, F;
  std::vector<cv::Mat> rotations, translations;
  cv::calibrateCamera(objects, lefts, {640, 480}, K1, D1, rotations, translations);
  cv::calibrateCamera(objects, rights, {640, 480}, K2, D2, rotations, translations);
  OpenCvResult result;
  result.rms =
      cv::stereoCalibrate(objects, lefts, rights, K1, D1, K2, D2, {640, 480}, R, T, E, F, cv::CALIB_USE_INTRINSIC_GUESS,
                          {cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 300, 1e-10});
  result.baseline = 1000 * cv::norm(T);
  return result;
}

class RealPairs : public ::testing::Test {
 protected:
  // All 13 pairs; `half`: of the windows of cornerSubPix, 0 = this library's own.
  static std::vector<TargetView> views(const Target& target, int half) {
    std::vector<TargetView> views;
    for (int i = 1; i <= 14; ++i) {
      if (i == 10) continue;  // does not exist
      TargetView view;
      for (const bool left : {true, false}) {
        view.name = fmt::format("{}{:02}.jpg", left ? "left" : "right", i);
        const cv::Mat1b image =
            cv::imread((iris::testing::test_data("chessboard_pairs") / view.name).string(), cv::IMREAD_GRAYSCALE);
        Corners corners = find_target(image, target).corners;
        if (half > 0) {
          std::vector<cv::Point2f> points;
          cv::findChessboardCorners(image, {9, 6}, points);
          cv::cornerSubPix(image, points, {half, half}, {-1, -1}, {3, 30, 0.01});
          for (Eigen::Vector2d& p : corners.points) {  // in our order
            const auto nearest = std::min_element(points.begin(), points.end(), [&](const auto& a, const auto& b) {
              return std::hypot(a.x - p.x(), a.y - p.y()) < std::hypot(b.x - p.x(), b.y - p.y());
            });
            p = {nearest->x, nearest->y};
          }
        }
        (left ? view.left : view.right) = std::move(corners);
      }
      match_orientation(target, view.left, view.right);
      views.push_back(std::move(view));
    }
    return views;
  }
};

// The corners that OpenCV's examples take (windows of 23 px): 0.445 px and 83.5 mm there, six of them gross errors.
TEST_F(RealPairs, OnOpenCvsCornersTheFitIsAsGoodAndTheBaselineTheSame) {
  IRIS_NEEDS_TEST_DATA("chessboard_pairs");
  const Target target = parse_target("chessboard:9x6:25mm");
  const auto pairs = views(target, 11);
  const OpenCvResult opencv = by_opencv(pairs, target);
  CalibrateOptions squares;
  squares.distortion = "radtan";
  squares.robust = 0;  // (2.8) itself, as OpenCV
  squares.flatness = 0;
  const auto result = calibrate(pairs, target, squares);
  ASSERT_EQ(result.status, Status::ok) << result.problem;
  const double baseline = 1000 * result.calibration.right_centre_in_left().norm();
  std::printf("13 pairs, OpenCV's corners: RMS %.5f px (OpenCV %.5f, before %.3f), baseline %.2f mm (OpenCV %.2f)\n",
              result.rms, opencv.rms, result.start_rms, baseline, opencv.baseline);
  EXPECT_LE(result.rms, opencv.rms + 1e-6);
  EXPECT_NEAR(baseline, 83.6, 0.3);
}

// Windows that do not reach neighbouring corners halve the errors; the board's own unevenness, which both cameras see
// in all views, is a third of what is then left, and moves the baseline by 0.14 mm.
TEST_F(RealPairs, OwnCornersAndTheBoardsShapeFitThreeTimesAsWell) {
  IRIS_NEEDS_TEST_DATA("chessboard_pairs");
  const Target target = parse_target("chessboard:9x6:25mm");
  const auto pairs = views(target, 0);
  for (const TargetView& view : pairs) ASSERT_TRUE(view.is_pair()) << view.name;
  const OpenCvResult opencv = by_opencv(pairs, target);
  CalibrateOptions squares;
  squares.distortion = "radtan";
  squares.robust = squares.flatness = 0;
  const auto flat = calibrate(pairs, target, squares), result = calibrate(pairs, target);
  ASSERT_EQ(flat.status, Status::ok) << flat.problem;
  ASSERT_EQ(result.status, Status::ok) << result.problem;
  const double flat_baseline = 1000 * flat.calibration.right_centre_in_left().norm();
  const double baseline = 1000 * result.calibration.right_centre_in_left().norm();
  const CrossValidation flat_rows = cross_validate(pairs, target, flat, squares);
  const CrossValidation rows = cross_validate(pairs, target, result, {});
  std::printf(
      "13 pairs, own corners, perfect board: RMS %.5f px (OpenCV %.5f, before %.3f), baseline %.2f mm (OpenCV %.2f); "
      "uneven board: %.5f px, %.2f +- %.2f mm, %.3f mm along and %.3f mm across; rows of unseen pairs %.3f and %.3f "
      "px\n",
      flat.rms, opencv.rms, flat.start_rms, flat_baseline, opencv.baseline, result.rms, baseline,
      result.parameters[result.parameters.size() - 3].sigma, 1000 * result.sheet_along, 1000 * result.sheet_across,
      flat_rows.rms, rows.rms);
  EXPECT_LE(flat.rms, opencv.rms + 1e-6);
  EXPECT_NEAR(flat_baseline, opencv.baseline, 0.1);
  EXPECT_EQ(flat.sheet_along + flat.sheet_across, 0);
  EXPECT_LE(result.rms, 0.14);
  EXPECT_NEAR(baseline, 83.6, 0.3);
  EXPECT_LE(rows.rms, flat_rows.rms);  // measured 0.143 against 0.150: of pairs that told nothing of the board
}

// A part of the board is no board: OpenCV alone would take 8 x 6 of its 9 x 6 corners, not always the same ones.
TEST_F(RealPairs, AWrongCountIsFoundOut) {
  IRIS_NEEDS_TEST_DATA("chessboard_pairs");
  const cv::Mat1b image =
      cv::imread((iris::testing::test_data("chessboard_pairs") / "left01.jpg").string(), cv::IMREAD_GRAYSCALE);
  for (const char* text : {"chessboard:8x6:25mm", "chessboard:9x5:25mm", "chessboard:7x5:25mm"}) {
    const Detection found = find_target(image, parse_target(text));
    EXPECT_TRUE(found.corners.empty()) << text;
  }
  EXPECT_THAT(explain_missing(image, parse_target("chessboard:8x6:25mm")), HasSubstr("9 x 6"));
}

TEST(Selection, LeavesOutWhatHelpsNothing) {
  const Target target = parse_target(kSquares);
  const StereoCalibration rig = target_rig();
  std::vector<TargetView> views = target_views(target, rig, target_poses(target, rig, 10, 4), 0.03, 4);
  views[3].right_blur = 6;        // the others have 2
  views[5].left = views[2].left;  // nothing new
  views[5].right = views[2].right;
  for (Eigen::Vector2d& p : views[5].left.points) p.x() += 2;
  views[7].left = views[7].right = {};
  const ViewSelection selection = select_views(views, {});
  EXPECT_EQ(selection.blurred, 1);
  EXPECT_EQ(selection.duplicates, 1);
  EXPECT_EQ(selection.unseen, 1);
  EXPECT_EQ(selection.views.size(), 7u);
  CalibrateOptions few;
  few.max_pairs = 4;
  EXPECT_EQ(select_views(views, few).views.size(), 4u);
  EXPECT_EQ(select_views(views, few).surplus, 3);
  CalibrateOptions strict;
  strict.min_change = 0;
  EXPECT_EQ(select_views(views, strict).views.size(), 8u);
}

// The stated depth errors are those that calibrations with other noise make.
TEST(Quality, DepthErrorsAreThoseOfOtherSeeds) {
  const Target target = parse_target(kSquares);
  const StereoCalibration rig = target_rig();
  const auto poses = target_poses(target, rig, 8, 21);
  const auto result = calibrate(target_views(target, rig, poses, 0.05, 1), target);
  const std::vector<DepthError> stated = depth_errors(result);
  ASSERT_EQ(stated.size(), 10u);
  EXPECT_NEAR(stated[1].matching, 0.1 * std::sqrt(2.0) * 4 / (rectified_focal_length(rig) * 0.098), 2e-4);  // (4.21)
  EXPECT_NEAR(stated[1].total(), std::hypot(stated[1].calibration, stated[1].matching), 1e-12);
  // A point in the middle at 3 m: recorded by the true rig, measured by 40 calibrations.
  double sum = 0;
  constexpr int kSeeds = 40;
  CalibrateOptions perfect_target;
  perfect_target.flatness = 0;
  for (unsigned seed = 0; seed < kSeeds; ++seed) {
    const auto other = calibrate(target_views(target, rig, poses, 0.05, 200 + seed), target, perfect_target);
    double square = 0;
    int count = 0;
    for (const double x : {-0.35, 0.0, 0.35}) {
      for (const double y : {-0.35, 0.0, 0.35}) {
        const Eigen::Vector3d p =
            rect_from_left_rotation(rig).transpose() * Eigen::Vector3d(3 * x * 640 / 522.4, 3 * y * 480 / 522.4, 3);
        const StereoCalibration& c = other.calibration;
        const Eigen::Matrix3d rect = rect_from_left_rotation(c);
        const Eigen::Vector3d l = rect * c.left.unproject(rig.left.project(p));
        const Eigen::Vector3d r = rect * c.right_from_left.linear().transpose() *
                                  c.right.unproject(rig.right.project(rig.right_from_left * p));
        const double depth = c.right_centre_in_left().norm() / (l.x() / l.z() - r.x() / r.z());
        square += (depth - 3) * (depth - 3);
        ++count;
      }
    }
    sum += square / count;
  }
  const double measured = std::sqrt(sum / kSeeds);
  std::printf("depth error at 3 m from the calibration: stated %.4f m, of %d others %.4f m\n", stated[2].calibration,
              kSeeds, measured);
  EXPECT_NEAR(stated[2].calibration, measured, 0.3 * measured);  // 40 seeds: 11 %; few independent directions
}

TEST(Quality, WarningsNameWhatIsMissing) {
  const Target target = parse_target(kSquares);
  const StereoCalibration rig = target_rig();
  // Tilts to one side alone, from one distance, in the middle.
  std::vector<Pose> poses;
  for (const double tilt : {0.3, 0.35, 0.4, 0.5}) {
    Pose pose = Pose::Identity();
    pose.linear() = Eigen::AngleAxisd(tilt, Eigen::Vector3d(0.3 * tilt, 1, 0).normalized()).toRotationMatrix();
    pose.translation() = Eigen::Vector3d(0.05, 0, 0.6) - pose.linear() * Eigen::Vector3d(0.13, 0.09, 0);
    poses.push_back(pose);
  }
  const auto views = target_views(target, rig, poses, 0.05, 1);
  CalibrateOptions options;
  options.distortion = "radial";
  const auto result = calibrate(views, target, options);
  ASSERT_EQ(result.status, Status::ok) << result.problem;
  std::string all;
  for (const std::string& text : warnings(views, target, result, cross_validate(views, target, result, options)))
    all += text + "\n";
  EXPECT_THAT(all, HasSubstr("only 4 pairs"));
  EXPECT_THAT(all, HasSubstr("no views of the target tilted to the right, upwards, downwards"));
  EXPECT_THAT(all, HasSubstr("about the same distance"));
  EXPECT_THAT(all, HasSubstr("no corners in the upper left"));
  // Every ninth of the left image shows a corner; of 8 x 6 cells the three columns at the left show two, all others do.
  auto partly = views;
  for (TargetView& view : partly) view.left = {};
  for (int y = 0; y < 6; ++y) {
    for (int x = 0; x < 8; ++x) {
      if (x < 3 && (x != 1 || y % 2 == 1)) continue;
      partly[0].left.ids.push_back(x + 8 * y);
      partly[0].left.points.emplace_back(80 * x + 40, 80 * y + 40);
    }
  }
  all.clear();
  for (const std::string& text : warnings(partly, target, result, {})) all += text + "\n";
  EXPECT_THAT(all, HasSubstr("corners cover 69 % of the left image only, too little in the upper left, left side, "
                             "lower left: its lens distortion is a guess there"));
  // Many good views: no complaint.
  const auto many = target_views(target, rig, target_poses(target, rig, 25, 8), 0.05, 1);
  const auto good = calibrate(many, target);
  for (const std::string& text : warnings(many, target, good, cross_validate(many, target, good, {})))
    ADD_FAILURE() << text;
}

TEST(Quality, CoverageCountsCorners) {
  TargetView view;
  view.left.ids = {0, 1, 2};
  view.left.points = {{0, 0}, {639, 479}, {320, 240}};
  const cv::Mat1i counts = coverage({view}, true, 640, 480, 2, 2);
  EXPECT_EQ(counts(0, 0), 1);
  EXPECT_EQ(counts(1, 1), 2);
  EXPECT_EQ(counts(0, 1) + counts(1, 0), 0);
  EXPECT_EQ(cv::countNonZero(coverage({view}, false, 640, 480, 2, 2)), 0);
}

}  // namespace
}  // namespace iris::calibrate
