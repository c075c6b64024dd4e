#include "iris/views/selection.h"

#include <gtest/gtest.h>

#include "iris/views/view_store.h"

namespace iris::views {
namespace {

const RectifiedCamera kCamera{.f = 300, .cx = 319.5, .cy = 239.5, .baseline = 0.2, .width = 640, .height = 480};

Pose moved(double x, double turn) {
  Pose pose = Pose::Identity();
  pose.translation().x() = x;
  pose.linear() = Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitY()).matrix();
  return pose;
}

TEST(Selection, FieldOfViewOfACentredCamera) {
  EXPECT_NEAR(field_of_view(kCamera), 2 * std::atan(320.0 / 300.0), 1e-12);
}

TEST(Selection, MovingTwoBaselinesMakesANewView) {
  const ViewsOptions options;
  const Pose last = moved(3, 0.4);
  EXPECT_FALSE(is_new_view(last, last, kCamera, options));
  EXPECT_FALSE(is_new_view(last, last * moved(0.399, 0), kCamera, options));
  EXPECT_TRUE(is_new_view(last, last * moved(0.401, 0), kCamera, options));
}

TEST(Selection, TurningHalfTheFieldOfViewMakesANewView) {
  const ViewsOptions options;
  const double half = 0.5 * field_of_view(kCamera);
  EXPECT_FALSE(is_new_view(Pose::Identity(), moved(0, half - 1e-3), kCamera, options));
  EXPECT_TRUE(is_new_view(Pose::Identity(), moved(0, half + 1e-3), kCamera, options));
  EXPECT_TRUE(is_new_view(Pose::Identity(), moved(0, -half - 1e-3), kCamera, options));
}

TEST(Selection, ZeroStoresEveryFrame) {
  EXPECT_TRUE(is_new_view(Pose::Identity(), Pose::Identity(), kCamera, {.min_moved_baselines = 0}));
}

TEST(Selection, OptionsAreDeclared) {
  ViewsOptions options;
  OptionSet set;
  options.declare(set);
  set.set("views.min_moved_baselines", "3.5");
  EXPECT_EQ(options.min_moved_baselines, 3.5);
  set.validate();
}

TEST(ViewStore, SummaryHoldsTheDisparityRange) {
  StereoView view;
  view.frame_idx = 7;
  view.submap = 2;
  view.camera = kCamera;
  view.image = cv::Mat1b(4, 5, uint8_t(0));
  view.disparity = {cv::Mat1f(4, 5, 0.0f), cv::Mat1b(4, 5, uint8_t(0))};
  EXPECT_EQ(summarise(view).max_disparity, 0);
  view.disparity.disparity(1, 2) = 3.5f;
  view.disparity.disparity(3, 4) = 12.25f;
  const MemoryViewStore store({view});
  EXPECT_EQ(store.summaries()[0].min_disparity, 3.5);
  EXPECT_EQ(store.summaries()[0].max_disparity, 12.25);
  EXPECT_EQ(store.summaries()[0].submap, 2);
  EXPECT_EQ(store.load(0)->frame_idx, 7);
}

}  // namespace
}  // namespace iris::views
