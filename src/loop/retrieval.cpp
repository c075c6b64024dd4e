#include "iris/loop/retrieval.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <opencv2/features2d.hpp>

#include "iris/core/error.h"
#include "iris/core/parallel.h"

namespace iris::loop {
namespace {

using Bits = std::array<uint64_t, kDescriptorBytes / 8>;

Bits bits_of(const uint8_t* descriptor) {
  Bits bits;
  std::memcpy(bits.data(), descriptor, kDescriptorBytes);
  return bits;
}

int distance(const Bits& a, const Bits& b) {
  int sum = 0;
  for (size_t w = 0; w < a.size(); ++w) sum += std::popcount(a[w] ^ b[w]);
  return sum;
}

// Index of the nearest centre, the first among equals.
int nearest(const Bits& bits, const std::vector<Bits>& centres) {
  int best = 0, least = distance(bits, centres[0]);
  for (size_t c = 1; c < centres.size(); ++c) {
    const int d = distance(bits, centres[c]);
    if (d < least) best = static_cast<int>(c), least = d;
  }
  return best;
}

// Divides descriptors [begin, end) of `order` into at most `count` groups; returns the centres and sorts `order` by
// group, stably. `ends` gets the end of each group.
std::vector<Bits> divide(const std::vector<Bits>& all, std::vector<int>& order, int begin, int end, int count,
                         std::vector<int>& ends) {
  constexpr int kRounds = 8, kGrain = 4096;
  // First centres: each time the descriptor farthest from all chosen ones, of an even sample.
  const int stride = std::max(1, (end - begin) / 500);
  std::vector<Bits> centres{all[order[begin]]};
  std::vector<int> gap;
  for (int k = begin; k < end; k += stride) gap.push_back(distance(all[order[k]], centres[0]));
  while (static_cast<int>(centres.size()) < count) {
    const auto far = std::max_element(gap.begin(), gap.end());
    if (*far == 0) break;  // no further different descriptors
    centres.push_back(all[order[begin + static_cast<int>(far - gap.begin()) * stride]]);
    for (size_t s = 0; s < gap.size(); ++s) {
      gap[s] = std::min(gap[s], distance(all[order[begin + static_cast<int>(s) * stride]], centres.back()));
    }
  }
  std::vector<int> group(static_cast<size_t>(end - begin));
  for (int round = 0; round < kRounds; ++round) {
    parallel_chunks(begin, end, kGrain, [&](int from, int to) {
      for (int k = from; k < to; ++k) group[k - begin] = nearest(all[order[k]], centres);
    });
    if (round + 1 == kRounds) break;
    std::vector<std::array<int, kDescriptorBytes * 8>> ones(centres.size());
    std::vector<int> members(centres.size(), 0);
    for (auto& counts : ones) counts.fill(0);
    for (int k = begin; k < end; ++k) {
      const Bits& bits = all[order[k]];
      auto& counts = ones[group[k - begin]];
      ++members[group[k - begin]];
      for (size_t b = 0; b < counts.size(); ++b) counts[b] += bits[b / 64] >> (b % 64) & 1;
    }
    bool changed = false;
    for (size_t c = 0; c < centres.size(); ++c) {
      if (members[c] == 0) continue;
      Bits majority{};
      for (size_t b = 0; b < ones[c].size(); ++b) {
        if (2 * ones[c][b] > members[c]) majority[b / 64] |= uint64_t{1} << (b % 64);
      }
      changed = changed || majority != centres[c];
      centres[c] = majority;
    }
    if (!changed) break;
  }
  std::vector<std::vector<int>> sorted(centres.size());
  for (int k = begin; k < end; ++k) sorted[group[k - begin]].push_back(order[k]);
  std::vector<Bits> kept;
  int at = begin;
  for (size_t c = 0; c < centres.size(); ++c) {
    if (sorted[c].empty()) continue;
    for (const int d : sorted[c]) order[at++] = d;
    kept.push_back(centres[c]);
    ends.push_back(at);
  }
  return kept;
}

}  // namespace

cv::Mat1b describe(const cv::Mat1b& image, int count) {
  const auto orb = cv::ORB::create(count, 1.2f, 8, 31, 0, 2, cv::ORB::HARRIS_SCORE, 31, /*fastThreshold=*/10);
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
  orb->detectAndCompute(image, cv::noArray(), keypoints, descriptors);
  IRIS_CHECK(descriptors.empty() || (descriptors.type() == CV_8UC1 && descriptors.cols == kDescriptorBytes));
  if (descriptors.empty()) return descriptors;  // a bare wall; OpenCV gives it no columns
  return descriptors.rowRange(0, std::min(descriptors.rows, count));
}

Vocabulary::Vocabulary(const std::vector<cv::Mat1b>& descriptors) {
  int64_t total = 0;
  for (const cv::Mat1b& view : descriptors) total += view.rows;
  if (total == 0) return;
  std::vector<Bits> all;
  int64_t at = 0;
  const int64_t stride = std::max<int64_t>(1, (total + kSample - 1) / kSample);
  for (const cv::Mat1b& view : descriptors) {
    IRIS_CHECK(view.rows == 0 || view.cols == kDescriptorBytes);
    for (int r = 0; r < view.rows; ++r)
      if (at++ % stride == 0) all.push_back(bits_of(view[r]));
  }
  std::vector<int> order(all.size());
  for (size_t k = 0; k < order.size(); ++k) order[k] = static_cast<int>(k);
  struct Part {
    int node, begin, end, depth;
  };
  std::vector<Part> parts{{0, 0, static_cast<int>(order.size()), 0}};
  for (size_t p = 0; p < parts.size(); ++p) {  // parts grows
    const Part part = parts[p];
    if (part.depth == kDepth || part.end - part.begin < kLeast) continue;
    std::vector<int> ends;
    const std::vector<Bits> centres = divide(all, order, part.begin, part.end, kBranches, ends);
    if (centres.size() < 2) continue;
    nodes_[part.node].first_child = static_cast<int>(nodes_.size());
    nodes_[part.node].children = static_cast<int>(centres.size());
    int begin = part.begin;
    for (size_t c = 0; c < centres.size(); ++c) {
      parts.push_back({static_cast<int>(nodes_.size()), begin, ends[c], part.depth + 1});
      nodes_.push_back({.centre = centres[c]});
      begin = ends[c];
    }
  }
  words_ = 0;
  for (Node& node : nodes_) node.word = node.children == 0 ? words_++ : -1;
}

int Vocabulary::word(const uint8_t* descriptor) const {
  const Bits bits = bits_of(descriptor);
  int at = 0;
  while (nodes_[at].children > 0) {
    const int first = nodes_[at].first_child;
    int best = first, least = distance(bits, nodes_[first].centre);
    for (int c = first + 1; c < first + nodes_[at].children; ++c) {
      const int d = distance(bits, nodes_[c].centre);
      if (d < least) best = c, least = d;
    }
    at = best;
  }
  return nodes_[at].word;
}

void ViewIndex::train(const std::vector<cv::Mat1b>& descriptors) {
  vocabulary_ = Vocabulary(descriptors);
  views_.clear();
  postings_.clear();
}

void ViewIndex::add(const cv::Mat1b& descriptors) {
  std::vector<int> words(static_cast<size_t>(descriptors.rows));
  for (int r = 0; r < descriptors.rows; ++r) words[r] = vocabulary_.word(descriptors[r]);
  std::sort(words.begin(), words.end());
  std::vector<Weighted> view;
  for (size_t k = 0; k < words.size();) {
    size_t end = k;
    while (end < words.size() && words[end] == words[k]) ++end;
    // The root keeps what repeats within a view (a tiled floor) from drowning the rest.
    view.push_back({words[k], static_cast<float>(std::sqrt(static_cast<double>(end - k)))});
    k = end;
  }
  views_.push_back(std::move(view));
}

void ViewIndex::finish() {
  std::vector<int> having(static_cast<size_t>(vocabulary_.words()), 0);
  for (const auto& view : views_)
    for (const Weighted& w : view) ++having[w.key];
  for (auto& view : views_) {
    double squares = 0;
    for (Weighted& w : view) {
      w.weight *= static_cast<float>(std::log(static_cast<double>(size() + 1) / having[w.key]));
      squares += static_cast<double>(w.weight) * w.weight;
    }
    for (Weighted& w : view) w.weight = squares > 0 ? static_cast<float>(w.weight / std::sqrt(squares)) : 0.0f;
  }
  postings_.assign(having.size(), {});
  for (size_t w = 0; w < having.size(); ++w) postings_[w].reserve(static_cast<size_t>(having[w]));
  for (int v = 0; v < size(); ++v)
    for (const Weighted& w : views_[v]) postings_[w.key].push_back({v, w.weight});
}

std::vector<ScoredView> ViewIndex::query(int index, int count) const {
  std::vector<float> scores(views_.size(), 0.0f);
  for (const Weighted& w : views_[index])
    for (const Weighted& view : postings_[w.key]) scores[view.key] += w.weight * view.weight;
  std::vector<ScoredView> found;
  for (int v = 0; v < size(); ++v)
    if (v != index && scores[v] > 0) found.push_back({v, scores[v]});
  const auto better = [](const ScoredView& a, const ScoredView& b) {
    return a.score != b.score ? a.score > b.score : a.index < b.index;
  };
  const auto end = found.begin() + std::min<std::ptrdiff_t>(count, static_cast<std::ptrdiff_t>(found.size()));
  std::partial_sort(found.begin(), end, found.end(), better);
  found.erase(end, found.end());
  return found;
}

double ViewIndex::score(int a, int b) const {
  double sum = 0;
  auto k = views_[a].begin();
  for (const Weighted& w : views_[b]) {
    while (k != views_[a].end() && k->key < w.key) ++k;
    if (k != views_[a].end() && k->key == w.key) sum += static_cast<double>(k->weight) * w.weight;
  }
  return sum;
}

}  // namespace iris::loop
