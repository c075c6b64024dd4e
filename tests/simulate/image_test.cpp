// Images against projection, against each other and against the mean of instants.
#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/imgproc.hpp>

#include "iris/core/parallel.h"
#include "iris/rectify/rectifier.h"
#include "iris/simulate/simulator.h"
#include "simulate/simple_scenes.h"

namespace iris::simulate {
namespace {

// Centre of what is brighter than `background` within 12 px of a place.
Eigen::Vector2d centroid(const cv::Mat1b& image, const Eigen::Vector2d& place, double background) {
  double sum = 0;
  Eigen::Vector2d weighted = Eigen::Vector2d::Zero();
  const int x0 = static_cast<int>(place.x()), y0 = static_cast<int>(place.y());
  for (int y = y0 - 12; y <= y0 + 12; ++y) {
    for (int x = x0 - 12; x <= x0 + 12; ++x) {
      const double bright = image(y, x) - background;
      sum += bright;
      weighted += bright * Eigen::Vector2d(x, y);
    }
  }
  return weighted / sum;
}

class MarksOnAPlane : public ::testing::TestWithParam<const char*> {};

TEST_P(MarksOnAPlane, AreWhereTheCameraModelsProjectThem) {
  SimulateOptions options;
  options.lens = GetParam();
  options.rays = 64;
  options.snr = 0;
  options.exposure = 0;
  // A dark plane, turned by 0.15 rad, with bright squares of 20 mm (about 12 px) just before it. They are turned
  // against the pixels: a pixel counts at its centre wherever the part of it is that the square covers, which moves the
  // centroid of a square along the pixels by up to 1/(8 * 12) px.
  Pose world_from_plane = shifted(0, 0, 0.75);
  world_from_plane.linear() = Eigen::AngleAxisd(0.15, Eigen::Vector3d(0.6, 0.8, 0)).toRotationMatrix();
  const auto on_plane = [&](const Eigen::Vector3d& origin, const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                            cv::Vec3b colour) {
    return rectangle(world_from_plane * origin, world_from_plane.linear() * a, world_from_plane.linear() * b, colour);
  };
  constexpr double kSide = 0.02;
  const Eigen::Vector3d a = kSide * Eigen::Vector3d(std::cos(0.4), std::sin(0.4), 0);
  const Eigen::Vector3d b = kSide * Eigen::Vector3d(-std::sin(0.4), std::cos(0.4), 0);
  std::vector<SceneObject> objects = {on_plane({-9, -9, 2e-5}, {18, 0, 0}, {0, 18, 0}, {40, 40, 40})};
  std::vector<Eigen::Vector3d> centres;
  for (int j = -6; j <= 6; ++j) {
    for (int i = -10; i <= 11; ++i) {
      const Eigen::Vector3d centre(0.0601 * i, 0.0607 * j, 0);
      centres.push_back(centre);
      objects.push_back(on_plane(centre - (a + b) / 2, a, b, {255, 255, 255}));
    }
  }
  // Centroid of the image of a square: its points, each with the area that it has in the image. (The image of its
  // centre is up to 0.02 px away where the lens is curved most.)
  const auto image_centroid = [&](const CameraModel& camera, const Pose& cam_from_world,
                                  const Eigen::Vector3d& centre) {
    const auto image_of = [&](double u, double v) {
      return camera.project(cam_from_world * (world_from_plane * Eigen::Vector3d(centre + u * a + v * b)));
    };
    constexpr int kSteps = 12;
    constexpr double kStep = 1e-4;
    double area = 0;
    Eigen::Vector2d sum = Eigen::Vector2d::Zero();
    for (int i = 0; i < kSteps * kSteps; ++i) {
      const double u = (i % kSteps + 0.5) / kSteps - 0.5, v = (i / kSteps + 0.5) / kSteps - 0.5;
      const Eigen::Vector2d du = image_of(u + kStep, v) - image_of(u - kStep, v);
      const Eigen::Vector2d dv = image_of(u, v + kStep) - image_of(u, v - kStep);
      const double weight = du.x() * dv.y() - du.y() * dv.x();
      area += weight;
      sum += weight * image_of(u, v);
    }
    return Eigen::Vector2d(sum / area);
  };

  const Simulator simulator(scene_of(objects), still_path(), options);
  const StereoFrame frame = simulator.frame(0);
  const StereoCalibration& rig = simulator.calibration();
  for (const bool is_left : {true, false}) {
    const cv::Mat1b image = is_left ? frame.left : frame.right;
    double background;
    cv::minMaxLoc(image, &background);
    int seen = 0;
    double worst = 0, squares = 0;
    for (const Eigen::Vector3d& centre : centres) {
      const Eigen::Vector2d expected = is_left ? image_centroid(rig.left, Pose::Identity(), centre)
                                               : image_centroid(rig.right, rig.right_from_left, centre);
      if (expected.x() < 15 || expected.y() < 15 || expected.x() > options.width - 16 ||
          expected.y() > options.height - 16) {
        continue;
      }
      ++seen;
      const double error = (centroid(image, expected, background) - expected).norm();
      worst = std::max(worst, error);
      squares += error * error;
    }
    EXPECT_GT(seen, 150);
    EXPECT_LT(worst, 0.02);
    EXPECT_LT(std::sqrt(squares / seen), 0.008);
    RecordProperty(is_left ? "left_rms" : "right_rms", std::to_string(std::sqrt(squares / seen)));
    RecordProperty(is_left ? "left_worst" : "right_worst", std::to_string(worst));
  }
}

INSTANTIATE_TEST_SUITE_P(Lenses, MarksOnAPlane, ::testing::Values("real", "ideal"),
                         [](const auto& test) { return std::string(test.param); });

// A wall with waves of about 20 px (in images 640 px wide) and a textured square before it.
const Scene& wavy_scene() {
  static const Scene scene =
      scene_of({with_texture(rectangle({-10, -10, 3}, {20, 0, 0}, {0, 20, 0}), wave_texture(1024, 64)),
                with_texture(rectangle({-0.4, -0.3, 1.5}, {0.7, 0, 0}, {0, 0.6, 0}), wave_texture(256, 4))});
  return scene;
}

TEST(Image, RealLensRectifiedIsWhatTheIdealLensSees) {
  SimulateOptions real = plain_options("real"), ideal = plain_options("ideal");
  real.rays = ideal.rays = 16;
  real.width = ideal.width = 640;
  real.height = ideal.height = 400;
  const Simulator through_lens(wavy_scene(), still_path(), real);
  const rectify::Rectifier rectifier(through_lens.calibration());
  Pose left_from_rect = Pose::Identity();
  left_from_rect.linear() = rectifier.rect_from_left().transpose();
  const Simulator straight(wavy_scene(), still_path(left_from_rect), ideal);
  ASSERT_NEAR(rectifier.camera().f, straight.rectified_camera().f, 1e-9);
  const StereoPair pair = rectifier.rectify(through_lens.frame(0));
  const StereoFrame expected = straight.frame(0);
  // Smooth places only: bilinear look-up smears edges. Waves of 20 px and amplitude 40 in both directions: linear
  // interpolation errs by 40 (2 pi / 20)^2 / 8 = 0.5 in each, the table of the rectifier by 1/64 px of 12 levels a px,
  // 8 bits by 0.5 twice: 2.2 at most, 0.6 on average.
  for (const bool is_left : {true, false}) {
    const cv::Mat1b image = is_left ? pair.left : pair.right, truth = is_left ? expected.left : expected.right;
    cv::Mat1b low, high;
    cv::erode(truth, low, cv::Mat1b::ones(5, 5));
    cv::dilate(truth, high, cv::Mat1b::ones(5, 5));
    int checked = 0, wrong = 0;
    double sum = 0;
    for (int y = 20; y < truth.rows - 20; ++y) {
      for (int x = 20; x < truth.cols - 20; ++x) {
        if (high(y, x) - low(y, x) > 75) continue;  // 4 px of the steepest waves have 71 levels
        const int difference = std::abs(image(y, x) - truth(y, x));
        ++checked;
        sum += difference;
        wrong += difference > 3;
      }
    }
    EXPECT_GT(checked, 150000);
    EXPECT_LT(sum / checked, 0.7);
    EXPECT_LT(wrong, checked / 200);  // what is left of the edges
  }
}

TEST(Image, MotionBlurIsTheMeanOfInstants) {
  // 2 m/s sideways and a turn: some 4 px within the exposure.
  const auto pose_at = [](double t) {
    Pose pose = shifted(2 * t, 0.3 * t, 0.1 * t);
    pose.linear() = Eigen::AngleAxisd(0.4 * t, Eigen::Vector3d(0.2, 0.5, 0.8).normalized()).toRotationMatrix();
    return pose;
  };
  SimulateOptions options = plain_options("real");
  options.rays = 16;
  options.frames = 2;
  options.rate = 10;
  const double exposure = 0.04;
  cv::Mat1d mean = cv::Mat1d::zeros(options.height, options.width);
  constexpr int kInstants = 16;
  for (int i = 0; i < kInstants; ++i) {
    const double offset = exposure * ((i + 0.5) / kInstants - 0.5);
    const Simulator instant(wavy_scene(), moving_path(1, [&](double t) { return pose_at(t + offset); }), options);
    cv::Mat1d image;
    instant.frame(1).right.convertTo(image, CV_64F, 1.0 / kInstants);
    mean += image;
  }
  const Simulator sharp(wavy_scene(), moving_path(1, pose_at), options);
  options.exposure = exposure * 1e3;
  options.rays = 64;
  const Simulator blurred(wavy_scene(), moving_path(1, pose_at), options);
  cv::Mat1d with_blur, without;
  blurred.frame(1).right.convertTo(with_blur, CV_64F);
  sharp.frame(1).right.convertTo(without, CV_64F);
  const double pixels = static_cast<double>(mean.total());
  // 8 bits: 0.25 on average; edges of the square: 64 rays instead of 256.
  EXPECT_LT(cv::norm(with_blur, mean, cv::NORM_L1) / pixels, 0.4);
  EXPECT_LT(cv::norm(with_blur, mean, cv::NORM_INF), 4);
  EXPECT_GT(cv::norm(without, mean, cv::NORM_L1) / pixels, 1.0);
}

TEST(Image, MovingObjectAppearsWhereItsPoseSays) {
  SceneObject mark = rectangle({-0.01, -0.01, 0}, {0.02, 0, 0}, {0, 0.02, 0}, {250, 250, 250});
  const auto pose_at = [](double t) {
    Pose pose = shifted(-0.3 + 0.5 * t, 0.2 * std::sin(3 * t), 1.2 - 0.2 * t);
    pose.linear() = Eigen::AngleAxisd(0.4 + 2 * t, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    return pose;
  };
  mark.world_from_object = pose_at;
  const SceneObject wall = rectangle({-20, -20, 2}, {40, 0, 0}, {0, 40, 0}, {30, 30, 30});
  SimulateOptions options = plain_options("real");
  options.width = 480;
  options.height = 300;
  options.rays = 36;
  options.rate = 4;
  options.exposure = 30;  // the mean of its places is that of the middle, but for its acceleration (0.02 px)
  const Simulator simulator(scene_of({mark, wall}), still_path(), options);
  const StereoCalibration& rig = simulator.calibration();
  for (const int frame_idx : {0, 3}) {
    const StereoFrame frame = simulator.frame(frame_idx);
    double background;
    cv::minMaxLoc(frame.left, &background);
    const Eigen::Vector3d centre = pose_at(frame_idx / 4.0).translation();
    const Eigen::Vector2d left = rig.left.project(centre), right = rig.right.project(rig.right_from_left * centre);
    EXPECT_LT((centroid(frame.left, left, background) - left).norm(), 0.05) << frame_idx;
    EXPECT_LT((centroid(frame.right, right, background) - right).norm(), 0.05) << frame_idx;
  }
}

TEST(Image, IsTheSameForAnyNumberOfThreadsAndAnyOrder) {
  Scene scene = wavy_scene();
  SceneObject mover = with_texture(rectangle({-0.2, -0.2, 1}, {0.3, 0, 0}, {0, 0.3, 0.1}), wave_texture(256, 5));
  mover.world_from_object = [](double t) { return shifted(0.3 * t, -0.2 * t, 0.1 * t); };
  scene.objects.push_back(mover);
  const SimulatedPath path = moving_path(2, [](double t) { return shifted(0.3 * t, 0.1 * t, 0); });
  SimulateOptions options = plain_options("real");
  options.width = 201;  // no multiple of a tile
  options.height = 123;
  options.snr = 40;
  options.exposure = 10;
  options.colour = true;
  options.frames = 6;
  const auto same = [](const cv::Mat& a, const cv::Mat& b) {
    return a.type() == b.type() && cv::norm(a, b, cv::NORM_INF) == 0;
  };
  const Simulator reference(scene, path, options);
  std::vector<StereoFrame> frames;
  std::vector<FrameTruth> truths;
  with_threads(1, [&] {
    for (int i = 0; i < options.frames; ++i) {
      frames.push_back(reference.frame(i));
      truths.push_back(reference.truth(i));
    }
  });
  EXPECT_EQ(frames[0].left.type(), CV_8UC3);
  for (const int threads : {2, 5}) {
    with_threads(threads, [&] {
      const Simulator simulator(scene, path, options);
      std::vector<int> wrong(static_cast<size_t>(options.frames));
      parallel_chunks(0, options.frames, 1, [&](int i, int) {
        const auto idx = static_cast<size_t>(options.frames - 1 - i);
        const StereoFrame frame = simulator.frame(static_cast<int>(idx));
        const FrameTruth truth = simulator.truth(static_cast<int>(idx));
        wrong[idx] = !same(frame.left, frames[idx].left) + !same(frame.right, frames[idx].right) +
                     !same(truth.disparity, truths[idx].disparity) + !same(truth.occluded, truths[idx].occluded) +
                     !same(truth.discontinuity, truths[idx].discontinuity) +
                     !same(truth.textured, truths[idx].textured) + (frame.stamp_ns != frames[idx].stamp_ns);
      });
      EXPECT_EQ(wrong, std::vector<int>(wrong.size()));
    });
  }
}

TEST(Image, TextureFinerThanAPixelIsSmoothedAway) {
  // A chessboard of 0.2 px: grey, without moire.
  cv::Mat3b chess(1024, 1024);
  for (int y = 0; y < chess.rows; ++y) {
    for (int x = 0; x < chess.cols; ++x) chess(y, x) = (x + y) % 2 ? cv::Vec3b(200, 200, 200) : cv::Vec3b(60, 60, 60);
  }
  SimulateOptions options = plain_options("ideal");
  const double pixel = 2 * std::tan(40 * CV_PI / 180) / options.width;
  const double side = 1024 * 0.2 * pixel * 2;  // at 2 m
  SceneObject wall = rectangle({-10, -10, 2}, {20, 0, 0}, {0, 20, 0});
  wall.mesh.texture = chess;
  for (Eigen::Vector2f& at : wall.mesh.texture_coordinates) at *= static_cast<float>(20 / side);
  const cv::Mat image = Simulator(scene_of({wall}), still_path(), options).frame(0).left;
  double low, high;
  cv::minMaxLoc(image, &low, &high);
  EXPECT_LE(high - low, 2);
}

TEST(Image, ColourAndGreyAgree) {
  cv::Mat3b texture = wave_texture(512, 4);
  for (cv::Vec3b& p : texture) p = {static_cast<uchar>(p[0] / 2), p[1], static_cast<uchar>(255 - p[2])};
  Scene scene = scene_of({with_texture(rectangle({-1, -1, 2}, {2, 0, 0}, {0, 2, 0}), texture)});
  scene.sky = {250, 100, 20};
  SimulateOptions options = plain_options("real");
  const cv::Mat1b grey = Simulator(scene, still_path(), options).frame(0).left;
  options.colour = true;
  const cv::Mat3b colour = Simulator(scene, still_path(), options).frame(0).left;
  EXPECT_EQ(colour(3, 3), cv::Vec3b(250, 100, 20));
  cv::Mat1b converted;
  cv::cvtColor(colour, converted, cv::COLOR_BGR2GRAY);
  EXPECT_LE(cv::norm(converted, grey, cv::NORM_INF), 2);  // both round twice
}

}  // namespace
}  // namespace iris::simulate
