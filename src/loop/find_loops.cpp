#include "iris/loop/find_loops.h"

#include <algorithm>
#include <list>
#include <map>
#include <memory>
#include <opencv2/imgproc.hpp>
#include <unordered_map>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

namespace iris::loop {
namespace {

using ViewAccess = std::function<StereoView(int frame_idx)>;

motion::ViewFeatures features_of(const StereoView& view, const RectifiedCamera& camera, const motion::ScsOptions& scs) {
  cv::Mat1b grey;
  if (view.image.channels() == 3) {
    cv::cvtColor(view.image, grey, cv::COLOR_BGR2GRAY);
  } else {
    grey = view.image;
  }
  return motion::extract_features(grey, view.disparity, camera, scs);
}

// Features of the views used last. Only require() changes what is kept; it is called from one thread.
class FeatureCache {
 public:
  FeatureCache(const ViewAccess& view, const RectifiedCamera& camera, const motion::ScsOptions& scs, size_t bytes)
      : view_(view), camera_(camera), scs_(scs), bytes_(bytes) {}

  // Makes the features of these views available (with SIFT: also those), dropping others, least recently used first.
  void require(const std::vector<int>& frames, bool sift) {
    ++now_;
    std::vector<int> missing;
    for (const int frame : frames) {
      Entry& entry = entries_[frame];
      entry.used = now_;
      if (!entry.features || (sift && !entry.rescue)) missing.push_back(frame);
    }
    std::vector<Entry*> made;
    for (const int frame : missing) made.push_back(&entries_.at(frame));
    parallel_chunks(0, static_cast<int>(missing.size()), 1, [&](int k, int) {
      Entry& entry = *made[k];
      if (!entry.features) {
        entry.features = std::make_unique<motion::ViewFeatures>(features_of(view_(missing[k]), camera_, scs_));
      }
      if (sift) {
        entry.rescue =
            std::make_unique<motion::RescueFeatures>(motion::rescue_features(*entry.features, camera_, scs_));
      }
    });
    size_t held = 0;
    for (const auto& [frame, entry] : entries_) held += bytes_of(entry);
    while (held > bytes_) {
      auto oldest = entries_.end();
      for (auto e = entries_.begin(); e != entries_.end(); ++e)
        if (e->second.used < now_ && (oldest == entries_.end() || e->second.used < oldest->second.used)) oldest = e;
      if (oldest == entries_.end()) break;
      held -= bytes_of(oldest->second);
      entries_.erase(oldest);
    }
  }

  const motion::ViewFeatures& features(int frame) const { return *entries_.at(frame).features; }
  const motion::RescueFeatures& rescue(int frame) const { return *entries_.at(frame).rescue; }

 private:
  struct Entry {
    std::unique_ptr<motion::ViewFeatures> features;
    std::unique_ptr<motion::RescueFeatures> rescue;  // shares the pictures
    int64_t used = 0;
  };
  static size_t bytes_of(const Entry& entry) {
    size_t bytes = 0;
    const auto add = [&](const motion::ViewFeatures& f) {
      bytes += f.corners.size() * (sizeof(motion::Corner) + sizeof(motion::RankPatch));
    };
    if (entry.features) {
      add(*entry.features);
      bytes += entry.features->image.total() * (1 + 4 + 1);
    }
    if (entry.rescue) {
      add(entry.rescue->dense);
      bytes += entry.rescue->keypoints.size() * (sizeof(motion::Corner) + 2 * sizeof(double)) +
               entry.rescue->descriptors.total() * sizeof(float);
    }
    return bytes;
  }

  const ViewAccess& view_;
  const RectifiedCamera& camera_;
  const motion::ScsOptions& scs_;
  size_t bytes_;
  int64_t now_ = 0;
  std::map<int, Entry> entries_;
};

void ask(const FindLoopsControl& control) {
  if (control.stopped && control.stopped()) throw Interrupted();
}

// Both kinds together; a pair that both propose is one by overlap. Ordered by (i, j).
std::vector<Candidate> joined(std::vector<Candidate> all, const std::vector<Candidate>& more) {
  all.insert(all.end(), more.begin(), more.end());
  const auto key = [](const Candidate& c) { return std::pair(c.i, c.j); };
  std::stable_sort(all.begin(), all.end(), [&](const Candidate& a, const Candidate& b) { return key(a) < key(b); });
  all.erase(
      std::unique(all.begin(), all.end(), [&](const Candidate& a, const Candidate& b) { return key(a) == key(b); }),
      all.end());
  return all;
}

// Which of the failed candidates are worth the time that SIFT takes: the best of each view (the best few between views
// that odometry does not join), unless both views have loops already. Where loops have put the path right, bundle
// adjustment finds what views have in common, without SIFT. Ascending.
std::vector<int> worth_rescue(const std::vector<Candidate>& candidates, const std::vector<LoopEdge>& edges,
                              const Odometry& odometry) {
  constexpr int kEnough = 2;                       // loops
  constexpr int kAttempts = 1, kJoinAttempts = 3;  // attempts of a view
  std::map<int, int> loops, attempts;
  std::vector<int> failed;
  for (size_t c = 0; c < edges.size(); ++c) {
    if (edges[c].verdict == LoopVerdict::accepted) ++loops[edges[c].i], ++loops[edges[c].j];
    if (edges[c].verdict == LoopVerdict::no_motion || edges[c].verdict == LoopVerdict::too_few_pairs) {
      failed.push_back(static_cast<int>(c));
    }
  }
  // What poses predict first, then what looks alike.
  std::stable_sort(failed.begin(), failed.end(), [&](int a, int b) {
    const Candidate &x = candidates[a], &y = candidates[b];
    return x.source != y.source ? x.source == Candidate::Source::overlap : x.score > y.score;
  });
  std::vector<int> chosen;
  for (const int c : failed) {
    const auto [i, j] = std::pair(candidates[c].i, candidates[c].j);
    if (loops[i] >= kEnough && loops[j] >= kEnough) continue;
    const int most = odometry.node(i).submap == odometry.node(j).submap ? kAttempts : kJoinAttempts;
    if (attempts[i] >= most || attempts[j] >= most) continue;
    ++attempts[i], ++attempts[j];
    chosen.push_back(c);
  }
  std::sort(chosen.begin(), chosen.end());
  return chosen;
}

}  // namespace

std::vector<LoopEdge> find_loops(const PoseGraph& graph, const std::vector<int>& view_frames, const ViewAccess& view,
                                 const RectifiedCamera& camera, const LoopOptions& options,
                                 const motion::ScsOptions& scs, const FindLoopsControl& control) {
  constexpr int kBlock = 32;                // views or candidates between two questions whether to stop
  constexpr int kAllDescriptors = 4000000;  // of all views
  const int views = static_cast<int>(view_frames.size());
  if (!options.enabled || views < 2) return {};
  const Odometry odometry(graph, options);
  const motion::ScsOptions loop_scs = loop_motion_options(scs, options);

  // What each view sees and looks like.
  const int descriptors_a_view = std::max(20, std::min(options.descriptors, kAllDescriptors / views));
  std::vector<ViewSketch> sketches(view_frames.size());
  std::vector<cv::Mat1b> descriptors(view_frames.size());
  for (int block = 0; block < views; block += kBlock) {
    ask(control);
    const int end = std::min(views, block + kBlock);
    parallel_chunks(block, end, 1, [&](int v, int) {
      const motion::ViewFeatures features = features_of(view(view_frames[v]), camera, loop_scs);
      sketches[v] = sketch(view_frames[v], features, camera);
      if (options.appearance_candidates > 0) descriptors[v] = describe(features.image, descriptors_a_view);
    });
    if (control.progress) control.progress(end, views);
  }
  std::vector<Candidate> candidates = overlap_candidates(sketches, odometry, camera, options);
  if (options.appearance_candidates > 0) {
    ViewIndex index;
    index.train(descriptors);
    for (cv::Mat1b& of_view : descriptors) {
      index.add(of_view);
      of_view.release();
    }
    index.finish();
    ask(control);
    candidates = joined(std::move(candidates), appearance_candidates(index, sketches, odometry, camera, options));
  }

  const int count = static_cast<int>(candidates.size());
  std::vector<LoopEdge> edges(candidates.size());
  FeatureCache cache(view, camera, loop_scs, static_cast<size_t>(options.cache_mb) << 20);
  // Candidates in their order: neighbours share their first view and mostly places.
  const auto verify_all = [&](const std::vector<int>& members, bool sift) {
    const int size = static_cast<int>(members.size());
    for (int block = 0; block < size; block += kBlock) {
      ask(control);
      const int end = std::min(size, block + kBlock);
      std::vector<int> frames;
      for (int m = block; m < end; ++m) {
        frames.insert(frames.end(), {candidates[members[m]].i, candidates[members[m]].j});
      }
      std::sort(frames.begin(), frames.end());
      frames.erase(std::unique(frames.begin(), frames.end()), frames.end());
      cache.require(frames, sift);
      parallel_chunks(block, end, 1, [&](int m, int) {
        const Candidate& c = candidates[members[m]];
        LoopEdge& edge = edges[members[m]];
        if (!sift) {
          edge = verify(c, cache.features(c.i), cache.features(c.j), camera, loop_scs, options);
          return;
        }
        const LoopEdge rescued = verify(c, cache.rescue(c.i), cache.rescue(c.j), camera, loop_scs, options);
        if (rescued.used >= edge.used) edge = rescued;
      });
      if (control.progress) control.progress(end, size);
    }
  };
  std::vector<int> all(candidates.size());
  for (int c = 0; c < count; ++c) all[c] = c;
  verify_all(all, /*sift=*/false);
  if (options.rescue) verify_all(worth_rescue(candidates, edges, odometry), /*sift=*/true);
  judge_consistency(edges, odometry, options);
  return edges;
}

}  // namespace iris::loop
