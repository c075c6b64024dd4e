#include "iris/render/refine.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iris/core/parallel.h"
#include "support/ray_scene.h"

namespace iris::render {
namespace {

using Eigen::Vector3d;
using testing::pose_at;
using testing::psnr;
using testing::room;
using testing::scene_camera;
using Views = std::vector<std::shared_ptr<const StereoView>>;

StereoView room_view(const Vector3d& position, const Vector3d& rotation = Vector3d::Zero(), int frame = 0) {
  return room().view(scene_camera(), pose_at(position, rotation), frame);
}

Views neighbours() {
  Views views;
  for (const Vector3d& at : {Vector3d(-0.25, 0, 0), Vector3d(0.25, 0.05, 0.1), Vector3d(0, -0.2, -0.1)}) {
    views.push_back(std::make_shared<const StereoView>(room_view(at)));
  }
  return views;
}

double share_off(const StereoView& view, const StereoView& truth, const cv::Rect& area, float tolerance) {
  int off = 0;
  for (int y = area.y; y < area.y + area.height; ++y) {
    for (int x = area.x; x < area.x + area.width; ++x) {
      off += std::abs(view.disparity.disparity(y, x) - truth.disparity.disparity(y, x)) > tolerance;
    }
  }
  return static_cast<double>(off) / area.area();
}

TEST(FreeSpace, ExactViewsStayAsTheyAre) {
  const StereoView truth = room_view({0, 0, 0});
  const StereoView checked = check_free_space(truth, neighbours());
  // Walls bend between pixels at the edges of the room and objects have borders; all else stays.
  EXPECT_LT(share_off(checked, truth, {0, 0, 320, 240}, 0.1f), 0.01);
  EXPECT_LT(share_off(checked, truth, {0, 0, 320, 240}, 0.5f), 0.002);
}

TEST(FreeSpace, AWronglyNearSurfaceGetsTheDisparitiesOfTheSurfaceBehind) {
  const StereoView truth = room_view({0, 0, 0});
  StereoView wrong = truth;
  const cv::Rect area(150, 60, 30, 20);
  wrong.disparity.disparity = truth.disparity.disparity.clone();
  wrong.disparity.disparity(area) = 40.0f;
  const StereoView checked = check_free_space(wrong, neighbours());
  EXPECT_EQ(share_off(wrong, truth, area, 1), 1);
  EXPECT_LT(share_off(checked, truth, area, 0.5f), 0.02);
  // Replaced disparities are no measurements.
  EXPECT_GE(checked.disparity.origin(70, 160), static_cast<uint8_t>(DisparityOrigin::within_segment));
}

TEST(FreeSpace, HolesGetTheNeighboursSurface) {
  const StereoView truth = room_view({0, 0, 0});
  StereoView holes = truth;
  const cv::Rect area(100, 100, 60, 40);
  holes.disparity.disparity = truth.disparity.disparity.clone();
  holes.disparity.origin = truth.disparity.origin.clone();
  holes.disparity.disparity(area) = 0.0f;
  holes.disparity.origin(area) = 0;
  EXPECT_LT(share_off(check_free_space(holes, neighbours()), truth, area, 0.5f), 0.05);
  EXPECT_EQ(share_off(check_free_space(holes, {}), truth, area, 0.5f), 1);
}

TEST(FreeSpace, AgreeingDisparitiesAreAveraged) {
  const StereoView truth = room_view({0, 0, 0});
  std::mt19937 random(4);
  std::normal_distribution<float> noise(0, 0.15f);
  const auto noisy = [&](StereoView view) {
    view.disparity.disparity = view.disparity.disparity.clone();
    for (float& d : view.disparity.disparity) d += d > 0 ? noise(random) : 0;
    return view;
  };
  Views others;
  for (const auto& view : neighbours()) others.push_back(std::make_shared<const StereoView>(noisy(*view)));
  const StereoView view = noisy(truth);
  const StereoView checked = check_free_space(view, others);
  const auto error = [&](const StereoView& of) {
    double sum = 0;
    int count = 0;
    for (int y = 20; y < 220; ++y) {
      for (int x = 40; x < 280; ++x) {
        const double e = of.disparity.disparity(y, x) - truth.disparity.disparity(y, x);
        if (std::abs(e) > 1) continue;
        sum += e * e;
        ++count;
      }
    }
    return std::sqrt(sum / count);
  };
  EXPECT_NEAR(error(view), 0.15, 0.01);
  // Four independent measurements halve the error; interpolation between the neighbours' pixels lowers theirs further.
  EXPECT_LT(error(checked), 0.09);
}

// Views along a short path.
std::vector<StereoView> path_views() {
  std::vector<StereoView> views;
  for (int i = 0; i < 10; ++i) {
    views.push_back(room_view({-0.5 + 0.1 * i, 0.02 * (i % 3), 0.03 * i}, {0, 0.02 * (i % 4), 0}, i));
  }
  return views;
}

TEST(Brightness, FindsGainBiasAndVignetting) {
  std::vector<StereoView> views = path_views();
  double log_gains = 0;
  std::vector<cv::Mat> light;
  constexpr double kVignetting = 0.25;
  for (size_t i = 0; i < views.size(); ++i) {
    StereoView& view = views[i];
    light.push_back(view.image);
    const double gain = 0.8 * (1 + 0.2 * std::sin(1.0 * static_cast<double>(i)));
    log_gains += std::log(gain);
    const RectifiedCamera& camera = view.camera;
    const double corner =
        std::pow(std::max(camera.cx, 319 - camera.cx), 2) + std::pow(std::max(camera.cy, 239 - camera.cy), 2);
    cv::Mat3b image(view.image.size());
    for (int y = 0; y < image.rows; ++y) {
      for (int x = 0; x < image.cols; ++x) {
        const double r2 = (std::pow(x - camera.cx, 2) + std::pow(y - camera.cy, 2)) / corner;
        for (int c = 0; c < 3; ++c) {
          image(y, x)[c] =
              cv::saturate_cast<uint8_t>(gain * view.image.at<cv::Vec3b>(y, x)[c] * (1 - kVignetting * r2));
        }
      }
    }
    view.image = image;
  }
  const views::MemoryViewStore store(views);
  const std::vector<Brightness> brightness = find_brightness(store, find_neighbours(store.summaries(), 4));
  double before = 0, after = 0;
  const double common = std::exp(log_gains / static_cast<double>(views.size()));  // it cannot be told from the light
  for (size_t i = 0; i < views.size(); ++i) {
    const cv::Mat even = even_image(views[i].image, views[i].camera, brightness[i]);
    before += cv::norm(views[i].image, common * light[i], cv::NORM_L1) / static_cast<double>(3 * even.total());
    after += cv::norm(even, common * light[i], cv::NORM_L1) / static_cast<double>(3 * even.total());
    EXPECT_NEAR(brightness[i].vignetting, kVignetting, 0.05);
  }
  std::cout << "grey error: " << before / 10 << " before, " << after / 10 << " after\n";
  EXPECT_GT(before / 10, 10);
  EXPECT_LT(after / 10, 2);
}

const DsnvOptions kAll{.free_space = true, .even_brightness = true};

TEST(RefinedViewStore, IsTheSameForAnyNumberOfThreadsAndKeepsFewViews) {
  const views::MemoryViewStore store(path_views());
  const auto run = [&](int threads, const std::vector<int>& order) {
    std::vector<std::shared_ptr<const StereoView>> views(store.summaries().size());
    with_threads(threads, [&] {
      const RefinedViewStore refined(store, kAll, 1);
      for (const int i : order) views[static_cast<size_t>(i)] = refined.load(i);
    });
    return views;
  };
  const auto one = run(1, {0, 1, 2, 3}), four = run(4, {3, 1, 0, 2});
  for (size_t i = 0; i < 4; ++i) {
    EXPECT_TRUE(one[i]->world_from_cam.isApprox(four[i]->world_from_cam, 0));
    EXPECT_EQ(cv::norm(one[i]->image, four[i]->image, cv::NORM_INF), 0);
    EXPECT_EQ(cv::norm(one[i]->disparity.disparity, four[i]->disparity.disparity, cv::NORM_INF), 0);
    EXPECT_EQ(cv::norm(one[i]->disparity.origin, four[i]->disparity.origin, cv::NORM_INF), 0);
  }
  const RefinedViewStore refined(store, kAll, 1);
  const std::weak_ptr<const StereoView> first = refined.load(0);
  EXPECT_FALSE(first.expired());
  refined.load(1);
  EXPECT_TRUE(first.expired());
}

TEST(RefinedViewStore, WithoutNeighboursNothingChanges) {
  const views::MemoryViewStore store(path_views());
  const RefinedViewStore refined(store, {.neighbours = 0}, 1 << 20);
  EXPECT_EQ(cv::norm(refined.load(2)->image, store.load(2)->image, cv::NORM_INF), 0);
  EXPECT_TRUE(refined.summaries()[2].world_from_cam.isApprox(store.summaries()[2].world_from_cam, 0));
}

}  // namespace
}  // namespace iris::render
