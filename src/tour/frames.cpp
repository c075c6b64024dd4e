#include "iris/tour/frames.h"

#include <algorithm>
#include <cmath>
#include <condition_variable>
#include <cstdio>
#include <deque>
#include <exception>
#include <limits>
#include <list>
#include <mutex>
#include <numeric>
#include <thread>

#include "iris/core/error.h"
#include "iris/render/draw.h"
#include "iris/render/source_selection.h"

namespace iris::tour {
namespace {

const cv::Vec3b kPathColour(40, 200, 255), kCameraColour(60, 60, 255);  // BGR: yellow, red

// Hands pictures to the sink on a thread of its own, in order; at most `capacity` of them wait.
class SinkThread {
 public:
  SinkThread(size_t capacity, std::function<void(int, const NovelView&)> sink)
      : capacity_(capacity), sink_(std::move(sink)), thread_([this] { run(); }) {}
  ~SinkThread() { end(); }

  void put(int frame_idx, NovelView view) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return waiting_.size() < capacity_ || failure_; });
    if (failure_) std::rethrow_exception(failure_);
    waiting_.emplace_back(frame_idx, std::move(view));
    changed_.notify_all();
  }

  // Waits for the last picture; passes on what the sink threw.
  void finish() {
    end();
    if (failure_) std::rethrow_exception(failure_);
  }

 private:
  void end() {
    {
      const std::lock_guard lock(mutex_);
      ended_ = true;
      changed_.notify_all();
    }
    if (thread_.joinable()) thread_.join();
  }

  void run() {
    for (;;) {
      std::pair<int, NovelView> next;
      {
        std::unique_lock lock(mutex_);
        changed_.wait(lock, [&] { return !waiting_.empty() || ended_; });
        if (waiting_.empty()) return;
        next = std::move(waiting_.front());
        waiting_.pop_front();
        changed_.notify_all();
      }
      try {
        sink_(next.first, next.second);
      } catch (...) {
        const std::lock_guard lock(mutex_);
        failure_ = std::current_exception();
        waiting_.clear();
        changed_.notify_all();
        return;
      }
    }
  }

  size_t capacity_;
  std::function<void(int, const NovelView&)> sink_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<std::pair<int, NovelView>> waiting_;
  std::exception_ptr failure_;
  bool ended_ = false;
  std::thread thread_;  // last: it uses all of the above
};

// The most recently used sources.
class SourceCache {
 public:
  SourceCache(const views::ViewStore& store, const render::DsnvOptions& options, size_t capacity)
      : store_(store), options_(options), capacity_(capacity) {}

  std::shared_ptr<const render::PreparedSource> get(int index) {
    const auto found =
        std::find_if(recent_.begin(), recent_.end(), [&](const auto& entry) { return entry.first == index; });
    if (found != recent_.end()) {
      recent_.splice(recent_.begin(), recent_, found);
    } else {
      recent_.emplace_front(index, std::make_shared<render::PreparedSource>(store_.load(index), options_));
      if (recent_.size() > capacity_) recent_.pop_back();
    }
    return recent_.front().second;
  }

 private:
  const views::ViewStore& store_;
  const render::DsnvOptions& options_;
  size_t capacity_;
  std::list<std::pair<int, std::shared_ptr<const render::PreparedSource>>> recent_;
};

}  // namespace

int frame_count(const CameraPath& path, const TourOptions& options) {
  return path.keyframes.empty() ? 0 : static_cast<int>(std::floor(duration(path) * options.fps + 1e-6)) + 1;
}

TourFrame tour_frame(const CameraPath& path, const std::vector<PoseNode>& nodes, const TourOptions& options,
                     int frame_idx) {
  IRIS_CHECK(!nodes.empty() && !path.keyframes.empty());
  const double length = duration(path);
  const double since = std::min(frame_idx / options.fps, length);
  const double recorded_ns = static_cast<double>(nodes.back().stamp_ns - nodes.front().stamp_ns);
  const double part = length > 0 ? since / length : 0;
  TourFrame frame{.frame_idx = frame_idx,
                  .seconds = since,
                  .camera = novel_camera(sample(path, eased_time(path, since)), options),
                  .stamp_ns = nodes.front().stamp_ns + std::llround(part * recorded_ns)};
  frame.world_from_recording = recorded_pose(nodes, frame.stamp_ns);
  return frame;
}

Pose recording_from_robot(const TourOptions& options) {
  Eigen::Vector3d camera_in_robot;
  int used = 0;
  const std::string& text = options.robot_camera;
  if (std::sscanf(text.c_str(), "%lf,%lf,%lf%n", &camera_in_robot.x(), &camera_in_robot.y(), &camera_in_robot.z(),
                  &used) != 3 ||
      used != static_cast<int>(text.size()) || !camera_in_robot.allFinite()) {
    throw UsageError("tour.robot_camera = " + text + ": three numbers x,y,z are wanted [m]");
  }
  return z_up_from_camera().inverse() * Eigen::Translation3d(-camera_in_robot);
}

void render_tour(const CameraPath& path, const std::vector<PoseNode>& nodes, const views::ViewStore& store,
                 const TourOptions& options, const render::DsnvOptions& dsnv,
                 const std::function<void(int frame_idx, int frames, const NovelView& view)>& sink,
                 const TourExtras& extras) {
  IRIS_CHECK(!nodes.empty() && !path.keyframes.empty());
  const int frames = frame_count(path, options);
  std::vector<int> wanted = extras.frames;
  if (wanted.empty()) {
    wanted.resize(static_cast<size_t>(frames));
    std::iota(wanted.begin(), wanted.end(), 0);
  }
  const int submap = nodes.front().submap;
  std::vector<views::ViewSummary> summaries;
  std::vector<int> indices;  // of the store
  for (size_t i = 0; i < store.summaries().size(); ++i) {
    if (store.summaries()[i].submap != submap) continue;
    summaries.push_back(store.summaries()[i]);
    indices.push_back(static_cast<int>(i));
  }
  std::vector<Eigen::Vector3d> recorded_path;
  for (const PoseNode& node : nodes) recorded_path.push_back(node.world_from_cam.translation());
  const Pose recording_from_model = recording_from_robot(options);

  SourceCache cache(store, dsnv, 3 * static_cast<size_t>(dsnv.max_sources + dsnv.hole_sources));
  SinkThread output(4, [&](int frame_idx, const NovelView& view) { sink(frame_idx, frames, view); });
  for (const int frame_idx : wanted) {
    const TourFrame frame = tour_frame(path, nodes, options, frame_idx);
    NovelView view;
    if (extras.moment) {
      std::vector<std::shared_ptr<const StereoView>> sources;
      if (auto moment = extras.moment(frame.stamp_ns)) sources.push_back(std::move(moment));
      view = render::render_novel_view(frame.camera, sources, dsnv);
    } else {
      const auto prepare = [&](int index) { return cache.get(indices[static_cast<size_t>(index)]); };
      view = render::render_from_views(frame.camera, summaries, prepare, dsnv);
    }

    if (options.draw_path) render::draw_path(view, frame.camera, recorded_path, kPathColour, 2);
    if (options.draw_camera && !summaries.empty()) {
      const double distance =
          (frame.world_from_recording.translation() - frame.camera.world_from_cam.translation()).norm();
      render::draw_camera_pyramid(view, frame.camera, summaries.front().camera, frame.world_from_recording,
                                  kCameraColour, 0.12 * distance);
    }
    if (!extras.robot.empty()) {
      render::draw_meshes(view, frame.camera, extras.robot, frame.world_from_recording * recording_from_model);
    }
    output.put(frame_idx, std::move(view));
  }
  output.finish();
}

}  // namespace iris::tour
