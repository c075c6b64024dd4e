#include "iris/simulate/simulator.h"

#include <gtest/gtest.h>

#include <cmath>
#include <set>

#include "iris/core/error.h"
#include "simulate/simple_scenes.h"

namespace iris::simulate {
namespace {

Scene wall() { return scene_of({rectangle({-20, -20, 2}, {40, 0, 0}, {0, 40, 0})}); }

TEST(Simulator, CountsFramesAndStampsThem) {
  SimulateOptions options = plain_options("ideal");
  options.frames = 0;
  options.rate = 10;
  const SimulatedPath path = moving_path(2.3, [](double t) { return shifted(t, 0, 0); });
  const Simulator simulator(wall(), path, options);
  EXPECT_EQ(simulator.frames(), 24);
  for (int i = 0; i < 24; ++i) {
    EXPECT_EQ(simulator.stamp_ns(i) - simulator.stamp_ns(0), i * int64_t{100'000'000});
    EXPECT_NEAR(simulator.world_from_left(i).translation().x(), i / 10.0, 1e-12);
  }
  EXPECT_EQ(simulator.frame(7).stamp_ns, simulator.stamp_ns(7));
  EXPECT_EQ(simulator.frame(7).frame_idx, 7);
  // The camera stays at the end.
  options.frames = 40;
  const Simulator longer(wall(), path, options);
  EXPECT_EQ(longer.frames(), 40);
  EXPECT_NEAR(longer.world_from_left(39).translation().x(), 2.3, 1e-12);
}

TEST(Simulator, SessionsDoNotOverlapInTime) {
  const SimulateOptions base = plain_options("ideal");
  std::set<int64_t> starts;
  const auto add = [&](const Scene& scene, const SimulatedPath& path, const SimulateOptions& options) {
    const int64_t start = Simulator(scene, path, options).stamp_ns(0);
    EXPECT_GT(start, 1388534400LL * 1'000'000'000);  // 2014-01-01
    EXPECT_EQ(start, Simulator(scene, path, options).stamp_ns(0));
    starts.insert(start);
  };
  add(wall(), still_path(), base);
  Scene other = wall();
  other.name = "other";
  add(other, still_path(), base);
  SimulatedPath path = still_path();
  path.name = "other";
  add(wall(), path, base);
  for (int seed = 2; seed < 12; ++seed) {
    SimulateOptions options = base;
    options.seed = seed;
    add(wall(), still_path(), options);
  }
  SimulateOptions options = base;
  options.snr = 30;
  add(wall(), still_path(), options);
  EXPECT_EQ(starts.size(), 14u);
  int64_t before = 0;
  for (const int64_t start : starts) {
    EXPECT_GT(start - before, 3600LL * 1'000'000'000);
    before = start;
  }
  EXPECT_GT(*starts.rbegin() - *starts.begin(), 365LL * 86400 * 1'000'000'000);
}

TEST(Simulator, RefusesRaysThatFillNoSquare) {
  SimulateOptions options = plain_options("ideal");
  options.rays = 6;
  EXPECT_THROW(Simulator(wall(), still_path(), options), UsageError);
}

TEST(Simulator, EmptySceneIsSky) {
  Scene empty;
  empty.sky = {90, 90, 90};
  const Simulator simulator(empty, still_path(), plain_options("real"));
  EXPECT_EQ(cv::norm(simulator.frame(0).right, cv::Mat1b(200, 320, uchar{90}), cv::NORM_INF), 0);
  EXPECT_EQ(cv::norm(simulator.truth(0).disparity, cv::NORM_INF), 0);
}

}  // namespace
}  // namespace iris::simulate
