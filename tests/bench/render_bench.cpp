#include <cmath>
#include <functional>

#include "bench/bench.h"
#include "bench/inputs.h"
#include "iris/render/source_selection.h"

namespace iris::bench {
namespace {

using benchmark::DoNotOptimize;
using benchmark::State;
using render::DsnvOptions;
using render::PreparedSource;

// Between the second and the third of the source views, a little above them.
NovelCamera novel_camera() {
  const StereoView& view = *hand_held_views()[2];
  NovelCamera camera{.width = view.camera.width,
                     .height = view.camera.height,
                     .f = view.camera.f,
                     .cx = view.camera.cx,
                     .cy = view.camera.cy,
                     .world_from_cam = view.world_from_cam};
  camera.world_from_cam.translation() =
      (view.world_from_cam.translation() + hand_held_views()[3]->world_from_cam.translation()) / 2 +
      Eigen::Vector3d(0, 0, 0.05);
  return camera;
}

std::vector<std::shared_ptr<const PreparedSource>> prepared(const DsnvOptions& options) {
  std::vector<std::shared_ptr<const PreparedSource>> sources;
  for (const size_t i : {0, 2, 3, 4})
    sources.push_back(std::make_shared<PreparedSource>(hand_held_views()[i], options));
  return sources;
}

using Views = std::vector<std::shared_ptr<const StereoView>>;

Contender picture(const std::string& who, const Views& (*views)(), int threads, const std::string& fusion) {
  return {who, [=](State& state) {
            DsnvOptions options;
            options.fusion = fusion;
            std::vector<std::shared_ptr<const PreparedSource>> sources;
            for (const auto& view : views()) sources.push_back(std::make_shared<PreparedSource>(view, options));
            NovelView picture;
            measure(state, threads, [&] { picture = render_novel_view(picture_sources().camera, sources, options); });
            state.counters["% seen"] =
                100.0 * cv::countNonZero(picture.depth) / static_cast<double>(picture.depth.total());
            set_rate(state, "pictures/s", 1);
          }};
}

const Views& near() { return picture_sources().near; }
const Views& far() { return picture_sources().far; }

// Views of a building of five floors: on each, rows of places with eight directions.
std::vector<views::ViewSummary> many_views(int count) {
  std::vector<views::ViewSummary> summaries;
  const StereoView& view = *hand_held_views()[0];
  views::ViewSummary summary = views::summarise(view);
  for (int i = 0; i < count; ++i) {
    const int place = i / 8, floor = place % 5, row = place / 5;
    summary.frame_idx = i;
    summary.world_from_cam = Eigen::AngleAxisd(i % 8 * M_PI / 4, Eigen::Vector3d::UnitZ()) * view.world_from_cam;
    summary.world_from_cam.translation() = Eigen::Vector3d(4.0 * (row % 12), 4.0 * (row / 12), 3.0 * floor);
    summaries.push_back(summary);
  }
  return summaries;
}

double seen(const cv::Mat1f& depth) {
  return static_cast<double>(cv::countNonZero(depth)) / static_cast<double>(depth.total());
}

// Sources are prepared once, as for the pictures of a tour.
Contender ours(const std::string& who, int step, int threads) {
  return {who, [=](State& state) {
            const DsnvOptions options{.step = step};
            const auto sources = prepared(options);
            const NovelCamera camera = novel_camera();
            NovelView view;
            measure(state, threads, [&] { view = render_novel_view(camera, sources, options); });
            state.counters["% seen"] = 100 * seen(view.depth);
            set_rate(state, "pictures/s", 1);
          }};
}

// Each pixel of a source covers 2x2 pixels of the picture; the nearest one is shown.
void splat(const StereoView& source, const NovelCamera& camera, cv::Mat1b& image, cv::Mat1f& depth) {
  const Eigen::Isometry3f novel_from_source = (camera.world_from_cam.inverse() * source.world_from_cam).cast<float>();
  const Eigen::Matrix3f r = novel_from_source.linear();
  const Eigen::Vector3f t = novel_from_source.translation();
  const auto f = static_cast<float>(source.camera.f), cx = static_cast<float>(source.camera.cx);
  const auto cy = static_cast<float>(source.camera.cy), b = static_cast<float>(source.camera.baseline);
  const auto nf = static_cast<float>(camera.f), ncx = static_cast<float>(camera.cx);
  const auto ncy = static_cast<float>(camera.cy);
  for (int y = 0; y < source.image.rows; ++y) {
    const float* disparity = source.disparity.disparity[y];
    const uint8_t* grey = source.image.ptr<uint8_t>(y);
    const Eigen::Vector3f row = r.col(1) * (static_cast<float>(y) - cy) + r.col(2) * f;
    for (int x = 0; x < source.image.cols; ++x) {
      if (disparity[x] <= 0) continue;
      const Eigen::Vector3f p = (r.col(0) * (static_cast<float>(x) - cx) + row) * (b / disparity[x]) + t;
      if (p.z() <= 0.01f) continue;
      const int u = static_cast<int>(std::floor(nf * p.x() / p.z() + ncx));
      const int v = static_cast<int>(std::floor(nf * p.y() / p.z() + ncy));
      if (u < 0 || v < 0 || u + 1 >= image.cols || v + 1 >= image.rows) continue;
      for (int j = v; j <= v + 1; ++j) {
        for (int i = u; i <= u + 1; ++i) {
          float& nearest = depth(j, i);
          if (nearest > 0 && nearest <= p.z()) continue;
          nearest = p.z();
          image(j, i) = grey[x];
        }
      }
    }
  }
}

Contender splatting(const std::function<NovelCamera()>& novel, const std::function<Views()>& views) {
  return {"forward splatting", [=](State& state) {
            const NovelCamera camera = novel();
            const Views sources = views();
            cv::Mat1b image;
            cv::Mat1f depth;
            measure(state, 1, [&] {
              image = cv::Mat1b(camera.height, camera.width, uint8_t{0});
              depth = cv::Mat1f(camera.height, camera.width, 0.0f);
              for (const auto& source : sources) splat(*source, camera, image, depth);
            });
            state.counters["% seen"] = 100 * seen(depth);
          }};
}

}  // namespace

void register_render() {
  const std::string input = hand_held().name + ", 4 sources";
  const Contender peer = splatting(novel_camera, [] {
    Views views;
    for (const size_t i : {0, 2, 3, 4}) views.push_back(hand_held_views()[i]);
    return views;
  });
  compare("render", "novel view, every pixel", input, {ours("IRIS", 1, 1), peer});
  compare("render", "novel view, step 2 (tours)", input, {ours("IRIS", 2, 1), peer});
  compare("render", "novel view, step 2, two threads", input, {ours("IRIS", 2, 2), ours("IRIS, one thread", 2, 1)},
          Uses::several);
  const std::string of = picture_sources().name + " 640x480";
  const auto row = [&](const std::string& work, const Views& (*views)()) {
    compare("render", work, of,
            {picture("IRIS", views, 1, "agreement"), splatting([] { return picture_sources().camera; }, views)});
    compare("render", work + ", two threads", of,
            {picture("IRIS", views, 2, "agreement"), picture("IRIS, one thread", views, 1, "agreement")},
            Uses::several);
  };
  row("novel view, 4 sources 1 to 3 cm away", near);
  row("novel view, 4 sources 0.22 m away", far);
  compare("render", "choose 4 sources of 5000", "building of five floors",
          {{"IRIS", [](State& state) {
              const auto views = many_views(5000);
              NovelCamera camera = novel_camera();
              camera.world_from_cam.translation() = Eigen::Vector3d(21, 17, 3);
              measure(state, 1, [&] { DoNotOptimize(render::select_sources(camera, views, {})); });
            }}});
  compare("render", "prepare a source", hand_held().name, {{"IRIS", [](State& state) {
                                                              const auto view = hand_held_views()[0];
                                                              measure(state, 1,
                                                                      [&] { DoNotOptimize(PreparedSource(view, {})); });
                                                            }}});
}

}  // namespace iris::bench
