#include "export/tour_moments.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <map>
#include <mutex>

#include "iris/core/error.h"
#include "iris/rectify/rectifier.h"
#include "iris/session/session.h"
#include "iris/stereo/mwmf.h"

namespace iris::exporters {
namespace {

// The last node that is not later; the first one if all are.
size_t last_before(const std::vector<int64_t>& stamps, int64_t stamp_ns) {
  const auto next = std::upper_bound(stamps.begin(), stamps.end(), stamp_ns);
  return next == stamps.begin() ? 0 : static_cast<size_t>(next - stamps.begin()) - 1;
}

class RecordedMoments : public Moments {
 public:
  RecordedMoments(std::unique_ptr<session::Session> session, const stereo::MwmfOptions& stereo,
                  const RectifiedCamera& camera, const std::vector<PoseNode>& nodes)
      : session_(std::move(session)),
        rectifier_(session_->calibration()),
        stereo_(stereo),
        camera_(camera),
        nodes_(nodes) {
    for (const PoseNode& node : nodes_) stamps_.push_back(node.stamp_ns);
  }

  std::shared_ptr<const StereoView> view(int64_t stamp_ns) const override {
    const PoseNode& node = nodes_[last_before(stamps_, stamp_ns)];
    const std::lock_guard lock(mutex_);
    if (const auto found = recent_.find(node.frame_idx); found != recent_.end()) return found->second;
    StereoPair pair = rectifier_.rectify(session_->read(node.frame_idx));
    auto view = std::make_shared<StereoView>(
        StereoView{.frame_idx = node.frame_idx,
                   .stamp_ns = node.stamp_ns,
                   .submap = node.submap,
                   .camera = camera_,
                   .image = pair.left_colour.empty() ? cv::Mat(pair.left) : cv::Mat(pair.left_colour),
                   .disparity = stereo::mwmf(pair.left, pair.right, stereo_),
                   .world_from_cam = node.world_from_cam});
    // The pictures wait for their files a few frames behind the one that is rendered.
    constexpr size_t kKept = 12;
    if (recent_.size() >= kKept) recent_.erase(recent_.begin());
    recent_[node.frame_idx] = view;
    return view;
  }

 private:
  std::unique_ptr<session::Session> session_;
  rectify::Rectifier rectifier_;
  stereo::MwmfOptions stereo_;
  RectifiedCamera camera_;
  std::vector<PoseNode> nodes_;
  std::vector<int64_t> stamps_;
  mutable std::mutex mutex_;
  mutable std::map<int, std::shared_ptr<const StereoView>> recent_;
};

class StoredMoments : public Moments {
 public:
  StoredMoments(const views::ViewStore& stored, const std::vector<PoseNode>& nodes) : stored_(stored) {
    std::map<int, int64_t> stamps;
    for (const PoseNode& node : nodes) stamps[node.frame_idx] = node.stamp_ns;
    for (size_t i = 0; i < stored.summaries().size(); ++i) {
      const auto found = stamps.find(stored.summaries()[i].frame_idx);
      if (found == stamps.end()) continue;
      indices_.push_back(static_cast<int>(i));
      stamps_.push_back(found->second);
    }
    IRIS_CHECK(!indices_.empty());
  }
  std::shared_ptr<const StereoView> view(int64_t stamp_ns) const override {
    return stored_.load(indices_[last_before(stamps_, stamp_ns)]);
  }

 private:
  const views::ViewStore& stored_;
  std::vector<int> indices_;
  std::vector<int64_t> stamps_;
};

}  // namespace

std::unique_ptr<Moments> open_moments(const workspace::Workspace& workspace, const RunOptions& options,
                                      const std::vector<PoseNode>& nodes, const views::ViewStore& stored) {
  try {
    auto session = session::open_session(workspace.session_folder(), options.library.session);
    if (nodes.back().frame_idx >= session->size()) {
      throw InputError(workspace.session_folder(), "has fewer frames than the run saw", "");
    }
    stereo::MwmfOptions stereo = options.library.stereo;
    if (const auto found = workspace.value("stereo.disparities")) stereo.disparities = std::stoi(*found);
    return std::make_unique<RecordedMoments>(std::move(session), stereo, stored.summaries().front().camera, nodes);
  } catch (const InputError& error) {
    spdlog::warn("{}; the stored views are used instead, which follow the camera's motion, not that of the scene",
                 error.what());
    return stored_moments(nodes, stored);
  }
}

std::unique_ptr<Moments> stored_moments(const std::vector<PoseNode>& nodes, const views::ViewStore& stored) {
  return std::make_unique<StoredMoments>(stored, nodes);
}

}  // namespace iris::exporters
