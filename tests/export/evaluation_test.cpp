#include "export/evaluation.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <random>
#include <sstream>

#include "export/trajectory_file.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "support/temporary_folder.h"

namespace iris::exporters {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;

class EvaluationTest : public ::testing::Test {
 protected:
  fs::path file(const std::string& name, const std::string& text) {
    write_file(folder_.path() / name, text);
    return folder_.path() / name;
  }
  fs::path image(const std::string& name, const cv::Mat& pixels) {
    cv::imwrite((folder_.path() / name).string(), pixels);
    return folder_.path() / name;
  }
  static nlohmann::json figures(const EvaluationRequest& request) {
    return nlohmann::json::parse(evaluate_files(request).json());
  }
  static std::string problem(const EvaluationRequest& request) {
    try {
      evaluate_files(request);
    } catch (const InputError& error) {
      return error.what();
    }
    return "";
  }

  iris::testing::TemporaryFolder folder_;
};

// A circle of 1 m, 40 poses at 10 Hz, of `scale`, from `start` s.
std::string circle(double scale, double start = 100) {
  std::string text = "# a circle\n";
  for (int i = 0; i < 40; ++i) {
    const double a = 0.1 * i;
    text += fmt::format("{:.9f} {} {} 0 0 0 {} {}\n", start + 0.1 * i, scale * std::cos(a), scale * std::sin(a),
                        std::sin(a / 2), std::cos(a / 2));
  }
  return text;
}

TEST_F(EvaluationTest, TrajectoryFiles) {
  EvaluationRequest request{.estimate = file("estimate.txt", circle(1.02)), .truth = file("truth.tum", circle(1))};
  request.plots = folder_.path() / "plots";
  const auto json = figures(request);
  EXPECT_EQ(json["trajectory"]["poses"], 40);
  EXPECT_NEAR(json["trajectory"]["scale_error"].get<double>(), 2, 1e-6);
  EXPECT_GT(json["trajectory"]["ate_rmse"].get<double>(), 0.005);
  EXPECT_EQ(json["trajectory"]["errors"][0]["unit"], "mm");
  request.trajectory.with_scale = true;
  EXPECT_LT(figures(request)["trajectory"]["ate_rmse"].get<double>(), 1e-9);
  for (const char* name : {"trajectory_path", "trajectory_translation_error", "trajectory_rotation_error"}) {
    EXPECT_TRUE(fs::exists(request.plots / (std::string(name) + ".png"))) << name;
    EXPECT_TRUE(fs::exists(request.plots / (std::string(name) + ".svg"))) << name;
  }
  EXPECT_THAT(evaluate_files(request).text(),
              AllOf(HasSubstr("absolute error of the position (ATE), RMS"), HasSubstr("turn, shift and scale")));
}

TEST_F(EvaluationTest, BadTrajectoriesAreNamedWithTheRemedy) {
  const fs::path truth = file("truth.tum", circle(1));
  EXPECT_THAT(problem({.estimate = file("later.txt", circle(1, 500)), .truth = truth}),
              AllOf(HasSubstr("500.000 … 503.900 s"), HasSubstr("100.000 … 103.900 s"), HasSubstr("the session that")));
  EXPECT_THAT(problem({.estimate = file("empty.txt", ""), .truth = truth}), HasSubstr("holds no pose"));
  EXPECT_THAT(problem({.estimate = file("nan.txt", "100 nan 0 0 0 0 0 1\n"), .truth = truth}), HasSubstr("not finite"));
  EXPECT_THAT(problem({.estimate = folder_.path() / "none.txt", .truth = truth}), HasSubstr("no such file"));
  EXPECT_THAT(problem({.estimate = truth, .truth = folder_.path() / "none.txt"}), HasSubstr("no such file"));
  EXPECT_THAT(problem({.estimate = file("kitti.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n"), .truth = truth}),
              HasSubstr("the output folder"));
  EXPECT_THAT(problem({.estimate = file("a.docx", "x"), .truth = truth}), HasSubstr("--kind"));
  EXPECT_THAT(problem({.estimate = folder_.path(), .truth = truth}), HasSubstr("no output folder"));
}

// A covariance of the pipeline (left perturbations) that is written to a graph is the one that is judged.
TEST_F(EvaluationTest, TheInformationOfAGraphIsThatOfItsMotions) {
  std::mt19937 random(4);
  std::normal_distribution<double> normal;
  const Matrix6d mix = Matrix6d::Random(), covariance = 1e-6 * (mix * mix.transpose() + 0.1 * Matrix6d::Identity());
  const Matrix6d root = covariance.llt().matrixL();
  PoseEdge edge{.information = covariance.inverse()};
  edge.i_from_j.linear() = Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  edge.i_from_j.translation() = Eigen::Vector3d(0.3, -0.1, 1);
  std::vector<evaluate::MotionEdge> edges;
  std::map<int64_t, Pose> truth;
  for (int i = 0; i < 1000; ++i) {
    Vector6d noise;
    for (int k = 0; k < 6; ++k) noise(k) = normal(random);
    noise = root * noise;
    Pose x = edge.i_from_j;  // t' = t + dt, R' = exp(dw) R
    x.translation() += noise.head<3>();
    x.linear() = Eigen::AngleAxisd(noise.tail<3>().norm(), noise.tail<3>().normalized()) * x.linear();
    truth[2 * i] = Pose::Identity();
    truth[2 * i + 1] = x;
    edges.push_back({2 * i, 2 * i + 1, edge.i_from_j, g2o_information(edge)});
  }
  const evaluate::Consistency c = evaluate::evaluate_consistency(edges, truth);
  EXPECT_NEAR(c.mean, 6, 0.35);  // deviation sqrt(12 / 1000) = 0.11
  EXPECT_NEAR(c.median, 5.35, 0.4);
  EXPECT_NEAR(c.share_within, 0.95, 0.02);
}

TEST_F(EvaluationTest, DisparitiesOfAllKindsOfFiles) {
  // Half of the truth is unknown; the estimate is 0.75 px too large.
  const cv::Mat1w estimate(20, 30, uint16_t{10 * 256 + 192});
  cv::Mat1w truth16(20, 30, uint16_t{10 * 256});
  truth16.rowRange(0, 10) = uint16_t{0};
  cv::Mat1b truth8(20, 30, uint8_t{160});
  truth8.rowRange(0, 10) = uint8_t{0};
  const fs::path path = image("e.disparity.png", estimate);
  const auto expect_good = [&](EvaluationRequest request) {
    const auto json = figures(request)["disparities"];
    EXPECT_EQ(json["known"], 300) << request.truth;
    EXPECT_NEAR(json["subpixel_bias"].get<double>(), 0.75, 1e-6) << request.truth;
    EXPECT_EQ(json["regions"][0]["wrong_0.5px"], 100);
    EXPECT_EQ(json["regions"][0]["wrong_1px"], 0);
  };
  expect_good({.estimate = path, .truth = image("t16.png", truth16)});
  EvaluationRequest scaled{.estimate = path, .truth = image("t8.pgm", truth8)};
  EXPECT_THAT(problem(scaled), HasSubstr("--truth-scale"));
  scaled.truth_scale = 16;
  expect_good(scaled);
  // PFM: rows from the bottom up, unknown = infinite; both byte orders.
  for (const bool big_endian : {false, true}) {
    std::string pfm = fmt::format("Pf\n30 20\n{}\n", big_endian ? "0.5" : "-0.5");
    for (int i = 0; i < 600; ++i) {
      const float value = i < 300 ? 10.0f : std::numeric_limits<float>::infinity();
      char bytes[4];
      std::memcpy(bytes, &value, 4);
      if (big_endian) std::reverse(bytes, bytes + 4);
      pfm.append(bytes, 4);
    }
    expect_good({.estimate = path, .truth = file("t.pfm", pfm)});
    EXPECT_THAT(problem({.estimate = path, .truth = file("cut.pfm", pfm.substr(0, 500))}), HasSubstr("cut off"));
  }
  // Origins beside the estimate are used, masks beside a truth in a folder disparity/ as well.
  image("e.origin.png", cv::Mat1b(20, 30, uint8_t{3}));
  cv::Mat1b occluded(20, 30, uint8_t{0});
  occluded.col(0) = uint8_t{255};
  for (const char* name : {"disparity", "occlusion", "discontinuity"}) fs::create_directories(folder_.path() / name);
  image("disparity/000003.png", truth16);
  image("occlusion/000003.png", occluded);
  image("discontinuity/000003.png", occluded);
  EvaluationRequest masked{.estimate = path, .truth = folder_.path() / "disparity/000003.png"};
  masked.plots = folder_.path() / "plots";
  const auto json = figures(masked)["disparities"];
  EXPECT_EQ(json["subpixel"][1]["origin"], "within segments");
  EXPECT_EQ(json["regions"][1]["region"], "seen by both cameras");
  EXPECT_EQ(json["regions"][2]["known"], 10);
  EXPECT_EQ(json["regions"][3]["known"], 10);
  EXPECT_TRUE(fs::exists(masked.plots / "disparity_error.png"));
  EXPECT_TRUE(fs::exists(masked.plots / "disparity_histogram.svg"));
  EXPECT_THAT(problem({.estimate = path, .truth = image("small.png", cv::Mat1w(10, 30, uint16_t{1}))}),
              AllOf(HasSubstr("30 x 10 px"), HasSubstr("30 x 20 px")));
  EXPECT_THAT(problem({.estimate = path, .truth = image("zero.png", cv::Mat1w(20, 30, uint16_t{0}))}),
              HasSubstr("no known disparity"));
}

TEST_F(EvaluationTest, MapsOfRos) {
  cv::Mat1b plan(10, 20, uint8_t{254});
  plan.row(0) = uint8_t{0};
  plan.row(9) = uint8_t{32};
  image("plan.png", plan);
  cv::Mat1b map = plan.clone();
  map.row(9) = uint8_t{205};
  map(5, 5) = uint8_t{0};
  image("map.pgm", map);
  const std::string header =
      "resolution: 0.1\norigin: [1, 2, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n";
  EvaluationRequest request{.estimate = file("map.yaml", "image: map.pgm\n" + header),
                            .truth = file("plan.yaml", "image: plan.png\n" + header)};
  request.plots = folder_.path() / "plots";
  const auto json = figures(request)["map"];
  EXPECT_NEAR(json["occupied_precision"].get<double>(), 100.0 * 20 / 21, 1e-9);
  EXPECT_EQ(json["occupied_recall"], 100);
  EXPECT_EQ(json["free_precision"], 100);
  EXPECT_TRUE(fs::exists(request.plots / "map_errors.svg"));
  EXPECT_THAT(evaluate_files(request).text(), ::testing::Not(HasSubstr("warning")));
  request.estimate =
      file("map.yaml", "image: map.pgm\n" + header + "# what stands between z = 0.1 m and 1.9 m of it\n");
  request.truth = file("plan.yaml", "# true map between z = 0.100 m and 1.900 m\nimage: plan.png\n" + header);
  EXPECT_THAT(evaluate_files(request).text(), ::testing::Not(HasSubstr("warning")));
  request.truth = file("plan.yaml", "# true map between z = 0.100 m and 2.300 m\nimage: plan.png\n" + header);
  EXPECT_THAT(evaluate_files(request).text(), HasSubstr("the plan what does between"));
  request.truth = file("lost.yaml", "image: nothing.png\n" + header);
  EXPECT_THAT(problem(request), HasSubstr("nothing.png"));
}

TEST_F(EvaluationTest, PicturesWithHoles) {
  cv::Mat3b truth(40, 40, cv::Vec3b(100, 120, 140));
  cv::Mat3b estimate(40, 40, cv::Vec3b(104, 124, 144));
  estimate.rowRange(0, 10) = cv::Vec3b(0, 0, 0);
  EvaluationRequest request{.estimate = image("e.png", estimate), .truth = image("t.png", truth)};
  EXPECT_LT(figures(request)["image"]["psnr"].get<double>(), 20);
  request.mask = "black";
  const auto json = figures(request)["image"];
  EXPECT_NEAR(json["psnr"].get<double>(), 20 * std::log10(255.0 / 4), 1e-9);
  EXPECT_EQ(json["coverage"], 75);
  request.estimate = request.truth;
  EXPECT_TRUE(figures(request)["image"]["psnr"].is_null());  // infinite
  EXPECT_THAT(evaluate_files(request).text(), HasSubstr("infinite"));
}

TEST_F(EvaluationTest, TheTextBeginsWithTheMostImportantFiguresAndFitsATerminal) {
  EvaluationRequest request{.estimate = file("estimate.txt", circle(0.98)), .truth = file("truth.tum", circle(1))};
  const Evaluation evaluation = evaluate_files(request);
  EXPECT_THAT(evaluation.summary(), AllOf(HasSubstr("position error (ATE) "), HasSubstr(", drift ")));
  EXPECT_EQ(evaluation.text().substr(0, evaluation.summary().size()), evaluation.summary());
  cv::Mat1w disparity(20, 30, uint16_t{10 * 256});
  image("e.png", disparity);
  image("occlusion.png", disparity);
  const Evaluation pictures =
      evaluate_files({.estimate = folder_.path() / "e.png", .truth = folder_.path() / "occlusion.png"});
  for (const std::string& text : {evaluation.text(), pictures.text()}) {
    std::istringstream lines(text);
    for (std::string line; std::getline(lines, line);) EXPECT_LE(line.size(), 120u) << line;
  }
  Evaluation wordy;
  wordy.sections.push_back({.name = "map", .title = "Map", .notes = {std::string(200, 'x') + " y z"}});
  for (int i = 0; i < 100; ++i) wordy.sections[0].notes[0] += " word";
  std::istringstream lines(wordy.text());
  size_t longer = 0;
  for (std::string line; std::getline(lines, line);) longer += line.size() > 120;
  EXPECT_EQ(longer, 1u);  // a word is never broken
}

TEST_F(EvaluationTest, TheFirstLineSaysWhenStatedErrorsAreWrong) {
  const auto summary = [](double ratio) {
    Evaluation evaluation;
    evaluation.sections.push_back({.name = "trajectory", .figures = {{"error_ratio", "", ratio, "1"}}});
    return evaluation.summary();
  };
  EXPECT_EQ(summary(1.5), "");
  EXPECT_EQ(summary(0.7), "");
  EXPECT_EQ(summary(9), "the path's errors are 9 times the stated ones");
  EXPECT_EQ(summary(0.3), "the path's errors are 0.3 times the stated ones");
}

TEST_F(EvaluationTest, WhatWasNotComparedIsNoFigure) {
  // An estimate without a single valid pixel has no sub-pixel error; a map without occupied cells no precision.
  const fs::path truth = image("t.png", cv::Mat1w(20, 30, uint16_t{10 * 256}));
  const fs::path empty = image("e.png", cv::Mat1w(20, 30, uint16_t{0}));
  const auto disparities = figures({.estimate = empty, .truth = truth})["disparities"];
  EXPECT_EQ(disparities["density"], 0);
  EXPECT_TRUE(disparities["subpixel_rms"].is_null());
  EXPECT_EQ(disparities["wrong_or_missing_1px"], 100);
  image("free.png", cv::Mat1b(10, 20, uint8_t{254}));
  const fs::path map = file("map.yaml", "image: free.png\nresolution: 0.1\norigin: [0, 0, 0]\n");
  const auto json = figures({.estimate = map, .truth = map})["map"];
  EXPECT_TRUE(json["occupied_precision"].is_null());
  EXPECT_TRUE(json["distance_median"].is_null());
  EXPECT_EQ(json["free_precision"], 100);
  const fs::path coarse = file("coarse.yaml", "image: free.png\nresolution: 100\norigin: [0, 0, 0]\n");
  EXPECT_THAT(problem({.estimate = map, .truth = coarse}), HasSubstr("resolution in both files"));
  // 8 bits say nothing of the scale of an estimate, and --truth-scale is not about it.
  const fs::path small = image("small.pgm", cv::Mat1b(20, 30, uint8_t{10}));
  EXPECT_THAT(problem({.estimate = small, .truth = truth, .kind = "disparity", .truth_scale = 16}),
              HasSubstr("16-bit PNG, or a PFM"));
  // A camera that stands still has no scale.
  const fs::path still = file("still.txt", "1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n3 0 0 0 0 0 0 1\n");
  EXPECT_TRUE(figures({.estimate = still, .truth = still})["trajectory"]["scale_error"].is_null());
  EXPECT_TRUE(figures({.estimate = still, .truth = still})["trajectory"]["closing_translation_percent"].is_null());
}

}  // namespace
}  // namespace iris::exporters
