#include "iris/render/refine.h"

#include <algorithm>
#include <cmath>
#include <list>
#include <mutex>
#include <opencv2/imgproc.hpp>
#include <unordered_map>

#include "disparity_map.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/render/source_selection.h"

namespace iris::render {
namespace {

constexpr float kDisparityError = 0.5f;  // [px] largest usual error of a disparity (a matching error, poses together)
constexpr int kReach = 2;                // [px] within which a surface may be shifted
constexpr int kRows = 16;                // that are worked on together

// How much a disparity is worth beside a measured one.
float trust_of(uint8_t origin) {
  if (origin <= static_cast<uint8_t>(DisparityOrigin::corrected)) return 1;
  return origin == static_cast<uint8_t>(DisparityOrigin::within_segment) ? 0.7f : 0.3f;
}

// What one view says of a surface point.
enum class Verdict { nothing, support, free_space, hidden };

struct Neighbour {
  const StereoView* view;
  DisparityMap from_own, to_own;
  cv::Mat1f nearest;  // largest disparity within kReach: poses are not exact, and borders of objects not either
};

struct Statement {
  Verdict verdict = Verdict::nothing;
  float trust = 0;
  float disparity = 0;  // [px] in the own view, as the neighbour has measured the point
  float variance = 1;   // of that, relative to that of a disparity of the own view
};

// Is the point (x, y, disparity) of the own view on the neighbour's surface, in the free space before it, or behind it?
Statement ask(const Neighbour& neighbour, float x, float y, float disparity) {
  const DisparityMap::Image at = neighbour.from_own.apply(x, y, disparity);
  const cv::Mat1f& image = neighbour.view->disparity.disparity;
  if (!(at.x >= 0) || !(at.y >= 0) || at.x > static_cast<float>(image.cols - 1) ||
      at.y > static_cast<float>(image.rows - 1)) {
    return {};
  }
  const int x0 = std::min(static_cast<int>(at.x), image.cols - 2),
            y0 = std::min(static_cast<int>(at.y), image.rows - 2);
  const float fx = at.x - static_cast<float>(x0), fy = at.y - static_cast<float>(y0);
  const float *up = image[y0] + x0, *down = image[y0 + 1] + x0;
  const float low = std::min({up[0], up[1], down[0], down[1]}), high = std::max({up[0], up[1], down[0], down[1]});
  if (high <= 0) return {};
  const int nearest_x = fx < 0.5f ? x0 : x0 + 1, nearest_y = fy < 0.5f ? y0 : y0 + 1;
  float surface;
  const float tolerance = kDisparityError * (1 + at.per_disparity);
  if (low > 0 && high - low <= 2) {
    surface = (1 - fy) * (up[0] + fx * (up[1] - up[0])) + fy * (down[0] + fx * (down[1] - down[0]));
  } else {
    // At the border of an object the point may belong to either side.
    surface = image(nearest_y, nearest_x);
    if (surface <= 0) return {};
    if (at.disparity >= low - tolerance && at.disparity <= high + tolerance &&
        std::abs(surface - at.disparity) > tolerance) {
      return {};
    }
  }
  const float delta = at.disparity - surface;
  Statement statement;
  const cv::Mat1b& origin = neighbour.view->disparity.origin;
  statement.trust = origin.empty() ? 1.0f : trust_of(origin(nearest_y, nearest_x));
  if (delta > tolerance) {
    const bool beside = neighbour.nearest(nearest_y, nearest_x) >= at.disparity - tolerance;
    statement.verdict = beside ? Verdict::nothing : Verdict::free_space;
  } else if (delta < -tolerance) {
    statement.verdict = Verdict::hidden;
  } else {
    statement.verdict = Verdict::support;
    // A disparity of the neighbour is worth so much as it moves with the own one.
    const float gain = std::max(at.per_disparity, 1e-3f);
    statement.disparity = disparity - delta / gain;
    statement.variance = 1 / (gain * gain);
  }
  return statement;
}

// Each neighbour's surface seen from the own view: the nearest one at each pixel, 0 = none. A pixel covers 2x2 of them.
cv::Mat1f seen_from(const Neighbour& neighbour, cv::Size size) {
  cv::Mat1f seen(size, 0.0f);
  const cv::Mat1f& image = neighbour.view->disparity.disparity;
  for (int y = 0; y < image.rows; ++y) {
    const float* row = image[y];
    for (int x = 0; x < image.cols; ++x) {
      if (row[x] <= 0) continue;
      const DisparityMap::Image at = neighbour.to_own.apply(static_cast<float>(x), static_cast<float>(y), row[x]);
      if (!(at.disparity > 0) || !(at.x >= 0) || !(at.y >= 0) || at.x >= static_cast<float>(size.width - 1) ||
          at.y >= static_cast<float>(size.height - 1)) {
        continue;
      }
      const int u = static_cast<int>(at.x), v = static_cast<int>(at.y);
      for (float* pixel : {seen[v] + u, seen[v] + u + 1, seen[v + 1] + u, seen[v + 1] + u + 1}) {
        *pixel = std::max(*pixel, at.disparity);
      }
    }
  }
  return seen;
}

}  // namespace

std::vector<std::vector<int>> find_neighbours(const std::vector<views::ViewSummary>& views, int count) {
  std::vector<std::vector<int>> neighbours(views.size());
  DsnvOptions selection;
  selection.max_sources = count + 1;  // the view itself is the best of all
  parallel_chunks(0, static_cast<int>(views.size()), 4, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      const views::ViewSummary& view = views[static_cast<size_t>(i)];
      if (view.max_disparity <= 0 || count <= 0) continue;
      const NovelCamera camera{.projection = Projection::pinhole,
                               .width = view.camera.width,
                               .height = view.camera.height,
                               .f = view.camera.f,
                               .cx = view.camera.cx,
                               .cy = view.camera.cy,
                               .world_from_cam = view.world_from_cam};
      std::vector<int>& list = neighbours[static_cast<size_t>(i)];
      std::vector<views::ViewSummary> candidates;
      std::vector<int> indices;
      for (size_t k = 0; k < views.size(); ++k) {
        if (views[k].submap != view.submap) continue;
        candidates.push_back(views[k]);
        indices.push_back(static_cast<int>(k));
      }
      for (const int k : select_sources(camera, candidates, selection)) {
        const int index = indices[static_cast<size_t>(k)];
        if (index != i && static_cast<int>(list.size()) < count) list.push_back(index);
      }
    }
  });
  return neighbours;
}

StereoView check_free_space(const StereoView& view, const std::vector<std::shared_ptr<const StereoView>>& others) {
  StereoView checked = view;
  checked.disparity.disparity = view.disparity.disparity.clone();
  if (view.disparity.origin.empty()) {
    checked.disparity.origin =
        cv::Mat1b(view.disparity.disparity.size(), static_cast<uint8_t>(DisparityOrigin::measured));
  } else {
    checked.disparity.origin = view.disparity.origin.clone();
  }
  const cv::Size size = view.disparity.disparity.size();
  std::vector<Neighbour> neighbours;
  for (const auto& other : others) {
    if (other->disparity.disparity.rows < 2 || other->disparity.disparity.cols < 2) continue;
    Neighbour neighbour{other.get(), DisparityMap(*other, view), DisparityMap(view, *other), {}};
    cv::dilate(other->disparity.disparity, neighbour.nearest, cv::Mat::ones(2 * kReach + 1, 2 * kReach + 1, CV_8U));
    neighbours.push_back(std::move(neighbour));
  }
  if (neighbours.empty()) return checked;
  std::vector<cv::Mat1f> seen(neighbours.size());
  parallel_chunks(0, static_cast<int>(neighbours.size()), 1, [&](int begin, int end) {
    for (int i = begin; i < end; ++i)
      seen[static_cast<size_t>(i)] = seen_from(neighbours[static_cast<size_t>(i)], size);
  });

  parallel_chunks(0, size.height, kRows, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < size.width; ++x) {
        float& disparity = checked.disparity.disparity(y, x);
        uint8_t& origin = checked.disparity.origin(y, x);
        const float own_trust = trust_of(origin);
        const auto fx = static_cast<float>(x), fy = static_cast<float>(y);
        float against = 0, sum = disparity, weights = 1, support = 0;
        if (disparity > 0) {
          for (const Neighbour& neighbour : neighbours) {
            const Statement s = ask(neighbour, fx, fy, disparity);
            if (s.verdict == Verdict::free_space) against += s.trust;
            if (s.verdict != Verdict::support) continue;
            support += s.trust;
            const float weight = s.trust / (own_trust * s.variance);
            sum += weight * s.disparity;
            weights += weight;
          }
          if (against <= support + own_trust) {
            disparity = sum / weights;
            continue;
          }
        }
        // The own surface does not stand: whichever of the neighbours' surfaces has most support.
        const float refuted = disparity;
        float most = 0, replacement = 0;
        int supporters = 0;
        for (const cv::Mat1f& candidates : seen) {
          const float candidate = candidates(y, x);
          if (candidate <= 0 || (refuted > 0 && std::abs(candidate - refuted) < kDisparityError)) continue;
          float votes = 0, mean = 0, total = 0;
          int agreeing = 0;
          for (const Neighbour& neighbour : neighbours) {
            const Statement s = ask(neighbour, fx, fy, candidate);
            if (s.verdict == Verdict::free_space) votes -= s.trust;
            if (s.verdict != Verdict::support) continue;
            votes += s.trust;
            ++agreeing;
            mean += s.trust / s.variance * s.disparity;
            total += s.trust / s.variance;
          }
          if (votes <= most + 1e-4f || total <= 0) continue;
          most = votes, supporters = agreeing;
          replacement = mean / total;
        }
        // What nothing else explains is kept, but hardly counts any more.
        if (replacement > 0) disparity = replacement;
        origin = static_cast<uint8_t>(disparity <= 0    ? DisparityOrigin::none
                                      : supporters >= 2 ? DisparityOrigin::within_segment
                                                        : DisparityOrigin::between_segments);
      }
    }
  });
  return checked;
}

struct RefinedViewStore::Impl {
  Impl(const views::ViewStore& store_, const DsnvOptions& options_, size_t cache_bytes_)
      : store(store_), options(options_), cache_bytes(cache_bytes_) {}

  const views::ViewStore& store;
  DsnvOptions options;
  size_t cache_bytes;
  std::vector<std::vector<int>> neighbours;
  std::vector<Brightness> brightness;  // empty = as it is

  using Recent = std::list<std::pair<int, std::shared_ptr<const StereoView>>>;  // front = used last
  std::mutex mutex;
  Recent recent;
  std::unordered_map<int, Recent::iterator> cached;
  size_t bytes = 0;

  std::shared_ptr<const StereoView> make(int index) const {
    auto view = std::make_shared<StereoView>(*store.load(index));
    if (options.free_space) {
      std::vector<std::shared_ptr<const StereoView>> others;
      for (const int k : neighbours[static_cast<size_t>(index)]) others.push_back(store.load(k));
      *view = check_free_space(*view, others);
    }
    if (options.even_brightness) {
      view->image = even_image(view->image, view->camera, brightness[static_cast<size_t>(index)]);
    }
    return view;
  }

  static size_t bytes_of(const StereoView& view) {
    return view.image.total() * view.image.elemSize() + view.disparity.disparity.total() * 5;
  }
};

RefinedViewStore::RefinedViewStore(const views::ViewStore& store, const DsnvOptions& options, size_t cache_bytes)
    : impl_(std::make_unique<Impl>(store, options, cache_bytes)) {
  if (options.neighbours <= 0) {
    impl_->options.free_space = impl_->options.even_brightness = false;
    return;
  }
  if (!options.free_space && !options.even_brightness) return;
  impl_->neighbours = find_neighbours(store.summaries(), options.neighbours);
  if (options.even_brightness) impl_->brightness = find_brightness(store, impl_->neighbours);
}

RefinedViewStore::~RefinedViewStore() = default;

const std::vector<views::ViewSummary>& RefinedViewStore::summaries() const { return impl_->store.summaries(); }

std::shared_ptr<const StereoView> RefinedViewStore::load(int index) const {
  Impl& s = *impl_;
  if (s.neighbours.empty()) return s.store.load(index);  // nothing is asked for
  {
    const std::lock_guard lock(s.mutex);
    const auto found = s.cached.find(index);
    if (found != s.cached.end()) {
      s.recent.splice(s.recent.begin(), s.recent, found->second);
      return found->second->second;
    }
  }
  const auto view = s.make(index);
  const std::lock_guard lock(s.mutex);
  if (!s.cached.contains(index)) {
    s.recent.emplace_front(index, view);
    s.cached[index] = s.recent.begin();
    s.bytes += Impl::bytes_of(*view);
    while (s.bytes > s.cache_bytes && s.recent.size() > 1) {
      s.bytes -= Impl::bytes_of(*s.recent.back().second);
      s.cached.erase(s.recent.back().first);
      s.recent.pop_back();
    }
  }
  return view;
}

}  // namespace iris::render
