#include "export/scene_surfaces.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <unordered_map>

#include "export/view_surface.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"

namespace iris::exporters {
namespace {

constexpr int kBatch = 8;

// Cubes of space that a view sees, with the distance from which it does. 21 bits an axis.
using Place = uint64_t;
Place place_of(const Eigen::Vector3d& point, double edge) {
  Place place = 0;
  for (int i = 0; i < 3; ++i) {
    place = place << 21 | (static_cast<uint64_t>(static_cast<int64_t>(std::floor(point[i] / edge))) & 0x1fffff);
  }
  return place;
}

struct Seen {
  Place place;
  float range;  // [m]
};

// Each place once, with the least range; ascending.
std::vector<Seen> places_of(const StereoView& view, const reconstruct::FusionOptions& options, double edge) {
  constexpr int kStep = 8;  // [px]
  std::vector<Seen> seen;
  for (int y = kStep / 2; y < view.disparity.disparity.rows; y += kStep) {
    for (int x = kStep / 2; x < view.disparity.disparity.cols; x += kStep) {
      const float d = view.disparity.at(y, x, DisparityOrigin::within_segment);
      if (d <= 0 || d + view.camera.disparity_offset < options.min_disparity) continue;
      const Eigen::Vector3d point = view.camera.point(x, y, d);
      if (point.norm() > options.max_range) continue;
      seen.push_back({place_of(view.world_from_cam * point, edge), static_cast<float>(point.norm())});
    }
  }
  std::sort(seen.begin(), seen.end(),
            [](const Seen& a, const Seen& b) { return a.place != b.place ? a.place < b.place : a.range < b.range; });
  seen.erase(std::unique(seen.begin(), seen.end(), [](const Seen& a, const Seen& b) { return a.place == b.place; }),
             seen.end());
  return seen;
}

struct Choice {
  std::vector<int> views;                // in the order of what they add
  std::unordered_map<Place, int> owner;  // the chosen view that sees a place from nearest
  double edge = 0;                       // [m] of the places
};

// Greedy cover: the view that adds most places, until none adds min_gain of them.
Choice choose_views(const views::ViewStore& views, const SceneOptions& options, const CloudOptions& cloud_options,
                    const pipeline::RunControl& control) {
  constexpr double kPlace = 10;  // [edges of the cloud's cubes]
  Choice choice{.views = {}, .owner = {}, .edge = kPlace * cloud_options.voxel};
  const int count = static_cast<int>(views.summaries().size());
  std::vector<std::vector<Seen>> seen(static_cast<size_t>(count));
  for (int begin = 0; begin < count; begin += kBatch) {
    if (control.stopped()) throw Interrupted();
    parallel_chunks(begin, std::min(begin + kBatch, count), 1, [&](int i, int) {
      seen[static_cast<size_t>(i)] = places_of(*views.load(i), cloud_options.fusion, choice.edge);
    });
  }
  std::unordered_map<Place, bool> covered;
  for (const auto& some : seen) {
    for (const Seen& s : some) covered.emplace(s.place, false);
  }
  const double least = std::max(1.0, options.min_gain / 100 * static_cast<double>(covered.size()));
  // What a view adds never grows: it is counted again only for the one that stands first.
  std::vector<std::pair<int, int>> queue;  // gain, -view
  for (int i = 0; i < count; ++i) queue.emplace_back(static_cast<int>(seen[static_cast<size_t>(i)].size()), -i);
  std::make_heap(queue.begin(), queue.end());
  while (!queue.empty()) {
    std::pop_heap(queue.begin(), queue.end());
    auto [gain, view] = queue.back();
    queue.pop_back();
    const std::vector<Seen>& places = seen[static_cast<size_t>(-view)];
    const auto now = static_cast<int>(
        std::count_if(places.begin(), places.end(), [&](const Seen& s) { return !covered.at(s.place); }));
    if (now < gain) {
      queue.emplace_back(now, view);
      std::push_heap(queue.begin(), queue.end());
      continue;
    }
    if (now < least) break;
    choice.views.push_back(-view);
    for (const Seen& s : places) covered.at(s.place) = true;
  }
  std::unordered_map<Place, float> nearest;
  for (const int view : choice.views) {
    for (const Seen& s : seen[static_cast<size_t>(view)]) {
      const auto [found, added] = nearest.try_emplace(s.place, s.range);
      if (!added && s.range >= found->second) continue;
      found->second = s.range;
      choice.owner[s.place] = view;
    }
  }
  return choice;
}

struct Detail {
  double tolerance;  // [standard deviations]
  double texture;    // side of the textures, of that of the images
};

SceneSurface make_surface(const ViewFusion::Fused& one, int index, const Choice& choice, const SceneOptions& options,
                          const CloudOptions& cloud_options, const Detail& detail) {
  const StereoView& view = *one.view;
  SceneSurface surface{.view = index, .mesh = {}, .jpeg = {}};
  surface.mesh = view_surface(
      view, one.fused, cloud_options.fusion.step, detail.tolerance, [&](const reconstruct::FusedPixel& pixel) {
        const Eigen::Vector3d point = view.world_from_cam * view.camera.point(pixel.x, pixel.y, pixel.disparity);
        const auto owner = choice.owner.find(place_of(point, choice.edge));
        return owner == choice.owner.end() || owner->second == index;
      });
  if (surface.mesh.triangles.empty()) return surface;
  cv::Mat image = view.image;
  if (detail.texture < 1) cv::resize(view.image, image, cv::Size(), detail.texture, detail.texture, cv::INTER_AREA);
  IRIS_CHECK(cv::imencode(".jpg", image, surface.jpeg, {cv::IMWRITE_JPEG_QUALITY, options.jpeg_quality}));
  return surface;
}

}  // namespace

std::vector<SceneSurface> scene_surfaces(const views::ViewStore& views, const SceneOptions& options,
                                         const CloudOptions& cloud_options, size_t budget,
                                         const pipeline::RunControl& control) {
  const Choice choice = choose_views(views, options, cloud_options, control);
  const int count = static_cast<int>(choice.views.size());
  if (count == 0) return {};
  const ViewFusion fusion(views, cloud_options);
  constexpr double kLeastTexture = 1.0 / 8;
  for (Detail detail{options.surface_error, 1};; detail = {detail.tolerance * 2, detail.texture / std::sqrt(2.0)}) {
    std::vector<SceneSurface> surfaces;
    size_t bytes = 0;
    bool fits = true;
    for (int begin = 0; begin < count && fits; begin += kBatch) {
      if (control.stopped()) throw Interrupted();
      const int end = std::min(begin + kBatch, count);
      std::vector<SceneSurface> batch(static_cast<size_t>(end - begin));
      parallel_chunks(begin, end, 1, [&](int i, int) {
        const int index = choice.views[static_cast<size_t>(i)];
        batch[static_cast<size_t>(i - begin)] =
            make_surface(fusion.fuse(index), index, choice, options, cloud_options, detail);
      });
      for (SceneSurface& surface : batch) {
        if (surface.mesh.triangles.empty()) continue;
        fits = fits && bytes + surface.bytes() <= budget;
        if (!fits) break;
        bytes += surface.bytes();
        surfaces.push_back(std::move(surface));
      }
    }
    if (fits || detail.texture / std::sqrt(2.0) < kLeastTexture) {
      spdlog::info("scene: surfaces of {} of {} views, textures of {:.0f} % of the images' size", surfaces.size(),
                   views.summaries().size(), 100 * detail.texture);
      return surfaces;
    }
  }
}

}  // namespace iris::exporters
