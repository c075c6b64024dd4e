#include "iris/motion/chain.h"

#include <algorithm>
#include <cmath>
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
  for (Restored& view : last_views) views_.push_back({std::move(view), std::nullopt});
}

const ViewFeatures* MotionChain::view(int frame_idx) const {
  const auto found =
      std::find_if(views_.begin(), views_.end(), [&](const View& v) { return v.frame_idx == frame_idx; });
  return found == views_.end() ? nullptr : &found->features;
}

bool MotionChain::find_motion(const ViewFeatures& features, ChainStep& step) {
  for (auto view = views_.rbegin(); view != views_.rend(); ++view) {
    TracedMotion motion = trace_motion(view->features, features, camera_, options_);
    const bool found = motion.estimate.status == MotionStatus::ok;
    // After a failure the estimate against the previous view tells best what happened.
    if (found || view == views_.rbegin()) take(step, std::move(motion));
    if (!found) continue;
    step.reference_frame = view->frame_idx;
    return true;
  }
  return false;
}

bool MotionChain::rescue(const ViewFeatures& features, ChainStep& step) {
  const RescueFeatures current = rescue_features(features, camera_, options_);
  if (current.count() < options_.min_used) return false;
  for (auto view = views_.rbegin(); view != views_.rend(); ++view) {
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
  // No more guesses in a row than views are remembered: then at least one of them is measured.
  if (std::all_of(views_.begin() + 1, views_.end(), [](const View& v) { return v.guessed; })) return false;
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

ChainStep MotionChain::push(ViewFeatures features, int frame_idx) {
  while (static_cast<int>(views_.size()) > kept_views()) views_.pop_front();
  ChainStep step;
  const bool found = find_motion(features, step) || (options_.rescue && !views_.empty() && rescue(features, step)) ||
                     (options_.guess && guess(frame_idx, step));
  if (found) {
    const auto reference =
        std::find_if(views_.begin(), views_.end(), [&](const View& v) { return v.frame_idx == step.reference_frame; });
    step.submap = reference->submap;
    step.world_from_cam = reference->world_from_cam * step.estimate.prev_from_cur;  // (5.5)
    step.world_from_cam.linear() = nearest_rotation(step.world_from_cam.linear());
  } else {
    step.new_submap = true;
    step.submap = submaps_++;
    if (views_.empty()) step.estimate.corners = static_cast<int>(features.corners.size());
  }
  views_.push_back({{.frame_idx = frame_idx,
                     .features = std::move(features),
                     .world_from_cam = step.world_from_cam,
                     .submap = step.submap,
                     .guessed = step.estimate.status == MotionStatus::guessed},
                    std::nullopt});
  return step;
}

}  // namespace iris::motion
