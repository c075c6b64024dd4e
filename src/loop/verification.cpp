#include "iris/loop/verification.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numeric>

#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/motion/agreement.h"
#include "iris/motion/consistency.h"

namespace iris::loop {
namespace {

double chi_square(const Vector6d& twist, const Matrix6d& covariance) {
  const Eigen::LDLT<Matrix6d> solver(covariance);
  return twist.dot(solver.solve(twist));
}

// An edge's covariance as that of a twist in i, enlarged like odometry's.
Matrix6d enlarged(const LoopEdge& edge, const LoopOptions& options) {
  return options.sigma * options.sigma * twist_covariance(edge.i_from_j, edge.covariance);
}

// The edge read from j to i.
LoopEdge reversed(const LoopEdge& edge) {
  LoopEdge result = edge;
  std::swap(result.i, result.j);
  result.i_from_j = edge.i_from_j.inverse();
  const Matrix6d to_j = adjoint(result.i_from_j);
  result.covariance =
      motion_covariance(result.i_from_j, to_j * twist_covariance(edge.i_from_j, edge.covariance) * to_j.transpose());
  return result;
}

LoopEdge judged(const Candidate& candidate, const motion::TracedMotion& forward, const motion::TracedMotion& backward,
                const motion::ViewFeatures& i, const motion::ViewFeatures& j, const RectifiedCamera& camera,
                const LoopOptions& options) {
  // More correspondences than this lie so close together that their errors are not independent. Measured on a rendered
  // apartment: the normalised squared errors of loops with 600 to 1100 correspondences were ten times those of others.
  constexpr double kIndependent = 200;
  const MotionEstimate& motion = forward.estimate;
  LoopEdge edge{.i = candidate.i, .j = candidate.j, .score = candidate.score, .source = candidate.source};
  edge.consistent = motion.consistent;
  edge.motion = motion.status;
  edge.verdict = LoopVerdict::no_motion;
  if (motion.status != MotionStatus::ok) return edge;
  edge.i_from_j = motion.prev_from_cur;
  edge.covariance = motion.covariance * std::max(1.0, motion.used / kIndependent);
  edge.rms_px = motion.rms_px;
  edge.used = motion.used;
  edge.verdict = LoopVerdict::too_few_pairs;
  if (edge.used < options.min_used) return edge;

  std::vector<Eigen::Vector2d> in_i, in_j;
  for (const motion::Correspondence& c : forward.used) {
    in_i.emplace_back(camera.project(c.prev_point).head<2>());
    in_j.emplace_back(camera.project(c.cur_point).head<2>());
  }
  edge.spread = std::min(spread_of(in_i, camera), spread_of(in_j, camera));
  edge.verdict = LoopVerdict::poorly_spread;
  if (edge.spread < options.min_spread) return edge;

  edge.verdict = LoopVerdict::not_symmetric;
  if (backward.estimate.status != MotionStatus::ok) return edge;
  LoopEdge back;
  back.i_from_j = backward.estimate.prev_from_cur;
  back.covariance = backward.estimate.covariance;
  const Matrix6d in_both = enlarged(edge, options) + enlarged(reversed(back), options);
  if (chi_square(twist_of(edge.i_from_j * back.i_from_j), in_both) > options.max_chi_square) return edge;

  const motion::Agreement views = motion::agreement(i, j, edge.i_from_j, camera);
  edge.agreement = views.agreeing > 0 ? 1 - views.contradiction() : 0;
  edge.verdict = edge.agreement < options.min_agreement ? LoopVerdict::contradicted : LoopVerdict::accepted;
  return edge;
}

// The motion from j to i. Corners that fail to tell it from scratch, which few matches do by chance, are looked for
// where the inverse of the motion from i to j predicts them.
motion::TracedMotion backward_of(const motion::TracedMotion& forward, const motion::ViewFeatures& i,
                                 const motion::ViewFeatures& j, bool from_scratch, const RectifiedCamera& camera,
                                 const motion::ScsOptions& scs, const LoopOptions& options) {
  motion::TracedMotion backward;
  if (forward.estimate.status != MotionStatus::ok || forward.estimate.used < options.min_used) return backward;
  if (from_scratch) backward = motion::trace_motion(j, i, camera, scs);
  if (backward.estimate.status == MotionStatus::ok) return backward;
  backward.estimate = {.status = MotionStatus::too_few_consistent,
                       .prev_from_cur = forward.estimate.prev_from_cur.inverse()};
  return motion::with_predicted(backward, j, i, camera, scs);
}

// The largest set of mutually consistent edges of one pair of sub-maps; beyond kMost edges, of an even part of them, to
// which those of the rest are added that agree with the set's members nearest to them.
std::vector<int> consistent_edges(const std::vector<LoopEdge>& edges, const Odometry& odometry,
                                  const LoopOptions& options) {
  constexpr size_t kMost = 1500;
  constexpr int kAsked = 15;
  const auto agree = [&](int a, int b) {
    return chi_square_of(edges[a], edges[b], odometry, options) <= options.max_chi_square;
  };
  const size_t all = edges.size(), count = std::min(all, kMost);
  std::vector<int> part(count);
  for (size_t k = 0; k < count; ++k) part[k] = static_cast<int>(k * all / count);
  motion::BitMatrix matrix(static_cast<int>(count));
  // Rows in parallel, bits afterwards: two rows share words.
  std::vector<std::vector<int>> agreeing(count);
  parallel_chunks(0, static_cast<int>(count), 8, [&](int from, int to) {
    for (int a = from; a < to; ++a)
      for (int b = a + 1; b < static_cast<int>(count); ++b)
        if (agree(part[a], part[b])) agreeing[a].push_back(b);
  });
  for (int a = 0; a < static_cast<int>(count); ++a)
    for (const int b : agreeing[a]) matrix.set_pair(a, b);
  std::vector<int> chosen;
  for (const int k : motion::consistent_set(matrix)) chosen.push_back(part[k]);
  if (count == all) return chosen;

  std::vector<char> good(all, 0);
  for (const int k : chosen) good[k] = 2;
  for (const int k : part) good[k] = good[k] == 2 ? 2 : 1;  // 1: asked and refused
  std::vector<char> joins(all, 0);
  parallel_chunks(0, static_cast<int>(all), 16, [&](int from, int to) {
    for (int k = from; k < to; ++k) {
      if (good[k] != 0) continue;
      // Edges are ordered by i: the neighbours in that order are near in time at one end.
      const auto at = std::lower_bound(chosen.begin(), chosen.end(), k) - chosen.begin();
      const auto first = std::max<std::ptrdiff_t>(0, at - kAsked / 2 - 1);
      const auto last = std::min<std::ptrdiff_t>(static_cast<std::ptrdiff_t>(chosen.size()), first + kAsked);
      int yes = 0;
      for (auto c = first; c < last; ++c) yes += agree(k, chosen[c]);
      joins[k] = last > first && 10 * yes >= 9 * (last - first);
    }
  });
  for (size_t k = 0; k < all; ++k)
    if (joins[k]) chosen.push_back(static_cast<int>(k));
  std::sort(chosen.begin(), chosen.end());
  return chosen;
}

}  // namespace

const char* name_of(LoopVerdict verdict) {
  switch (verdict) {
    case LoopVerdict::accepted:
      return "accepted";
    case LoopVerdict::no_motion:
      return "no motion";
    case LoopVerdict::too_few_pairs:
      return "too few pairs";
    case LoopVerdict::poorly_spread:
      return "poorly spread";
    case LoopVerdict::not_symmetric:
      return "not symmetric";
    case LoopVerdict::contradicted:
      return "contradicted";
    case LoopVerdict::inconsistent:
      return "inconsistent";
    case LoopVerdict::unsupported:
      return "unsupported";
  }
  return "";
}

motion::ScsOptions loop_motion_options(const motion::ScsOptions& scs, const LoopOptions& options) {
  motion::ScsOptions result = scs;
  result.max_turn = options.max_turn;
  return result;
}

LoopEdge verify(const Candidate& candidate, const motion::ViewFeatures& i, const motion::ViewFeatures& j,
                const RectifiedCamera& camera, const motion::ScsOptions& scs, const LoopOptions& options) {
  const motion::TracedMotion forward = motion::trace_motion(i, j, camera, scs);
  const motion::TracedMotion backward = backward_of(forward, i, j, /*from_scratch=*/true, camera, scs, options);
  return judged(candidate, forward, backward, i, j, camera, options);
}

LoopEdge verify(const Candidate& candidate, const motion::RescueFeatures& i, const motion::RescueFeatures& j,
                const RectifiedCamera& camera, const motion::ScsOptions& scs, const LoopOptions& options) {
  const motion::TracedMotion forward = motion::rescue_motion(i, j, camera, scs);
  // Keypoints that are each other's nearest are so both ways: from scratch would find the same.
  const motion::TracedMotion backward =
      backward_of(forward, i.dense, j.dense, /*from_scratch=*/false, camera, scs, options);
  LoopEdge edge = judged(candidate, forward, backward, i.dense, j.dense, camera, options);
  edge.rescued = true;
  return edge;
}

double spread_of(const std::vector<Eigen::Vector2d>& points, const RectifiedCamera& camera) {
  constexpr int kColumns = 8, kRows = 6;
  std::array<bool, kColumns * kRows> occupied{};
  for (const Eigen::Vector2d& p : points) {
    const int column = std::clamp(static_cast<int>(p.x() * kColumns / camera.width), 0, kColumns - 1);
    const int row = std::clamp(static_cast<int>(p.y() * kRows / camera.height), 0, kRows - 1);
    occupied[static_cast<size_t>(row * kColumns + column)] = true;
  }
  return static_cast<double>(std::count(occupied.begin(), occupied.end(), true)) / (kColumns * kRows);
}

double chi_square_of(const LoopEdge& a, const LoopEdge& b, const Odometry& odometry, const LoopOptions& options) {
  const auto between_i = odometry.between(a.i, b.i), between_j = odometry.between(a.j, b.j);
  IRIS_CHECK(between_i && between_j);
  // Around: from a.i over a.j, b.j and b.i back to a.i, each part's twist taken to a.i.
  Pose at = a.i_from_j;
  Matrix6d covariance = enlarged(a, options);
  Matrix6d to = adjoint(at);
  covariance += to * between_j->covariance * to.transpose();
  at = at * between_j->i_from_j;
  const LoopEdge back = reversed(b);
  to = adjoint(at);
  covariance += to * enlarged(back, options) * to.transpose();
  at = at * back.i_from_j;
  // What is left is the inverse of the way a.i -> b.i, whose covariance is given in a.i.
  covariance += between_i->covariance;
  at = at * between_i->i_from_j.inverse();
  return chi_square(twist_of(at), covariance);
}

void judge_consistency(std::vector<LoopEdge>& edges, const Odometry& odometry, const LoopOptions& options) {
  constexpr double kAmbiguous = 0.5;  // a second set at least this part as large leaves it open how sub-maps lie
  std::map<std::pair<int, int>, std::vector<size_t>> groups;
  for (size_t k = 0; k < edges.size(); ++k) {
    LoopEdge& edge = edges[k];
    if (edge.verdict != LoopVerdict::accepted) continue;
    if (const auto relative = odometry.between(edge.i, edge.j)) {
      edge.chi_square = chi_square(twist_of(edge.i_from_j * relative->i_from_j.inverse()),
                                   enlarged(edge, options) + relative->covariance);
      if (edge.chi_square > options.max_chi_square) {
        edge.verdict = LoopVerdict::inconsistent;
        continue;
      }
    }
    const auto [a, b] = std::minmax(odometry.node(edge.i).submap, odometry.node(edge.j).submap);
    groups[{a, b}].push_back(k);
  }
  for (const auto& [submaps, members] : groups) {
    // All in the direction of the sub-maps' numbers, so that pairs of ends belong together.
    std::vector<LoopEdge> directed;
    for (const size_t k : members) {
      const bool turn = odometry.node(edges[k].i).submap != submaps.first;
      directed.push_back(turn ? reversed(edges[k]) : edges[k]);
    }
    const std::vector<int> chosen = consistent_edges(directed, odometry, options);
    std::vector<char> is_chosen(members.size(), 0);
    for (const int k : chosen) is_chosen[k] = 1;
    bool supported = true;
    if (submaps.first != submaps.second) {
      std::vector<LoopEdge> others;
      for (size_t k = 0; k < members.size(); ++k)
        if (!is_chosen[k]) others.push_back(directed[k]);
      const auto votes_of = [&](const std::vector<LoopEdge>& of, const std::vector<int>& set) {
        return std::accumulate(set.begin(), set.end(), 0.0,
                               [&](double sum, int k) { return sum + options.votes(of[k].used); });
      };
      const double first = votes_of(directed, chosen);
      supported = first >= options.min_joining_loops &&
                  votes_of(others, consistent_edges(others, odometry, options)) < kAmbiguous * first;
    }
    for (size_t k = 0; k < members.size(); ++k) {
      if (!is_chosen[k]) {
        edges[members[k]].verdict = LoopVerdict::inconsistent;
      } else if (!supported) {
        edges[members[k]].verdict = LoopVerdict::unsupported;
      }
    }
  }
}

}  // namespace iris::loop
