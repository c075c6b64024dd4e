#include "iris/motion/chain.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <utility>

namespace iris::motion {
namespace {

void take(ChainStep& step, TracedMotion&& motion) {
  step.estimate = motion.estimate;
  step.initial = std::move(motion.initial);
  step.consistent = std::move(motion.consistent);
  step.used = std::move(motion.used);
}

// The motion over `part` of its duration, at constant velocities.
Pose part_of(const Pose& motion, double part) {
  const Eigen::AngleAxisd turn(Eigen::Matrix3d(motion.linear()));
  Pose result = Pose::Identity();
  result.linear() = Eigen::AngleAxisd(part * turn.angle(), turn.axis()).toRotationMatrix();
  result.translation() = part * motion.translation();
  return result;
}

}  // namespace

void MotionChain::restore(std::vector<Restored> last_views, int submaps) {
  submaps_ = submaps;
  views_.clear();
  for (Restored& view : last_views) {
    views_.push_back({std::move(view)});
    settle(views_.back());
  }
}

const MotionChain::View* MotionChain::find(int frame_idx) const {
  const auto found =
      std::find_if(views_.begin(), views_.end(), [&](const View& v) { return v.frame_idx == frame_idx; });
  return found == views_.end() ? nullptr : &*found;
}

const ViewFeatures* MotionChain::view(int frame_idx) const {
  const View* found = find(frame_idx);
  return found == nullptr ? nullptr : &found->features;
}

// The reference view if the corners moved so little since then that a view rests.
int MotionChain::resting_place(const Restored& view) const {
  const View* reference = find(view.reference_frame);
  if (reference == nullptr || view.guessed || reference->features.corners.empty()) return -1;
  const Pose cam_from_reference = view.reference_from_cam.inverse();
  std::vector<double> moves;
  for (const Corner& corner : reference->features.corners) {
    const Eigen::Vector3d p = cam_from_reference * corner.point_in_cam;
    moves.push_back(p.z() > 0 ? (camera_.project(p).head<2>() - Eigen::Vector2d(corner.x, corner.y)).norm()
                              : std::numeric_limits<double>::infinity());
  }
  const auto middle = moves.begin() + static_cast<std::ptrdiff_t>(moves.size() / 2);
  std::nth_element(moves.begin(), middle, moves.end());
  return *middle < options_.rest ? reference->frame_idx : -1;
}

// What others rest at counts as a view of its own, even if it rested itself.
void MotionChain::settle(View& view) {
  view.rests_at = resting_place(view);
  for (View& place : views_) {
    if (place.frame_idx == view.rests_at) place.rests_at = -1;
  }
}

// All but the last kept_views() and what these rest at.
void MotionChain::forget() {
  const int old = static_cast<int>(views_.size()) - kept_views();
  std::deque<View> kept;
  for (int i = 0; i < static_cast<int>(views_.size()); ++i) {
    const auto rests_here = [&](const View& v) { return v.rests_at == views_[i].frame_idx; };
    if (i >= old || std::any_of(views_.begin() + std::max(old, 0), views_.end(), rests_here)) {
      kept.push_back(std::move(views_[i]));
    }
  }
  views_ = std::move(kept);
}

bool MotionChain::find_motion(const ViewFeatures& features, ChainStep& step) {
  std::vector<const View*> references;
  if (!views_.empty()) {
    if (const View* place = find(views_.back().rests_at)) references.push_back(place);
  }
  for (auto view = views_.rbegin(); view != views_.rend(); ++view) {
    if (static_cast<int>(references.size()) > options_.retry_views) break;
    if (references.empty() || &*view != references.front()) references.push_back(&*view);
  }
  for (const View* view : references) {
    TracedMotion motion = trace_motion(view->features, features, camera_, options_);
    const bool found = motion.estimate.status == MotionStatus::ok;
    // After a failure the estimate against the first view tells best what happened.
    if (found || view == references.front()) take(step, std::move(motion));
    if (!found) continue;
    step.reference_frame = view->frame_idx;
    measure_in_window(features, step);
    return true;
  }
  return false;
}

void MotionChain::measure_in_window(const ViewFeatures& features, ChainStep& step) const {
  const View& reference = *find(step.reference_frame);
  std::vector<WindowView> others;
  for (auto view = views_.rbegin(); view != views_.rend(); ++view) {
    if (static_cast<int>(others.size()) + 1 >= options_.window) break;
    if (&*view == &reference || view->rests_at >= 0 || view->guessed || view->submap != reference.submap) continue;
    others.push_back({&view->features, reference.world_from_cam.inverse() * view->world_from_cam});
  }
  if (others.empty()) return;
  TracedMotion motion{.estimate = step.estimate, .used = step.used};
  step.estimate = with_window(motion, others, features, camera_, options_).estimate;
}

bool MotionChain::rescue(const ViewFeatures& features, ChainStep& step) {
  const RescueFeatures current = rescue_features(features, camera_, options_);
  if (current.count() < options_.min_used) return false;
  for (auto view = views_.rbegin(); view != views_.rend(); ++view) {
    if (view - views_.rbegin() > options_.retry_views) break;
    if (!view->rescue) view->rescue = rescue_features(view->features, camera_, options_);
    TracedMotion motion = rescue_motion(*view->rescue, current, camera_, options_);
    if (motion.estimate.status != MotionStatus::ok) continue;
    take(step, std::move(motion));
    step.reference_frame = view->frame_idx;
    step.rescued = true;
    return true;
  }
  return false;
}

bool MotionChain::guess(int frame_idx, ChainStep& step) const {
  if (views_.size() < 2) return false;
  const View &last = views_.back(), &before = views_[views_.size() - 2];
  if (last.submap != before.submap) return false;
  // No more guesses in a row than views are retried: then at least one of them is measured.
  const auto retried = views_.end() - std::min<std::ptrdiff_t>(std::ssize(views_), options_.retry_views + 1);
  if (std::all_of(retried + 1, views_.end(), [](const View& v) { return v.guessed; })) return false;
  const double part =
      static_cast<double>(frame_idx - last.frame_idx) / static_cast<double>(last.frame_idx - before.frame_idx);
  const Pose motion = part_of(before.world_from_cam.inverse() * last.world_from_cam, part);
  step.estimate.status = MotionStatus::guessed;
  step.estimate.prev_from_cur = motion;
  // As uncertain as the motion is large, and at least by 5 cm and 2 degrees.
  const double metres = std::max(0.05, motion.translation().norm()), radians = std::max(0.035, rotation_angle(motion));
  step.estimate.covariance.setZero();
  step.estimate.covariance.diagonal().head<3>().setConstant(metres * metres);
  step.estimate.covariance.diagonal().tail<3>().setConstant(radians * radians);
  step.reference_frame = last.frame_idx;
  return true;
}

// Whether no view could be related to this one, not even with all corners that may help after a failure.
bool MotionChain::blind(const ViewFeatures& features) const {
  if (static_cast<int>(features.corners.size()) >= options_.min_used) return false;
  return !options_.rescue || rescue_features(features, camera_, options_).count() < options_.min_used;
}

ChainStep MotionChain::push(ViewFeatures features, int frame_idx) {
  forget();
  ChainStep step;
  const bool found = find_motion(features, step) || (options_.rescue && !views_.empty() && rescue(features, step)) ||
                     (options_.guess && guess(frame_idx, step));
  if (found) {
    const View* reference = find(step.reference_frame);
    step.submap = reference->submap;
    step.world_from_cam = reference->world_from_cam * step.estimate.prev_from_cur;  // (5.5)
    step.world_from_cam.linear() = nearest_rotation(step.world_from_cam.linear());
  } else {
    if (views_.empty()) step.estimate.corners = static_cast<int>(features.corners.size());
    step.blind = blind(features);
    if (step.blind) return step;
    step.new_submap = true;
    step.submap = submaps_++;
  }
  views_.push_back({{.frame_idx = frame_idx,
                     .features = std::move(features),
                     .world_from_cam = step.world_from_cam,
                     .submap = step.submap,
                     .guessed = step.estimate.status == MotionStatus::guessed,
                     .reference_frame = step.reference_frame,
                     .reference_from_cam = step.estimate.prev_from_cur}});
  settle(views_.back());
  return step;
}

}  // namespace iris::motion
