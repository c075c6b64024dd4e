#include "iris/pipeline/loop.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <map>
#include <memory>
#include <optional>

#include "iris/core/error.h"
#include "iris/loop/bundle.h"
#include "iris/loop/find_loops.h"
#include "iris/loop/pose_graph.h"

namespace iris::pipeline {
namespace {

using workspace::Poses;

PoseEdge edge_of(const loop::LoopEdge& loop) {
  return {.i = loop.i,
          .j = loop.j,
          .i_from_j = loop.i_from_j,
          .information = loop.covariance.inverse(),
          .kind = PoseEdgeKind::loop,
          .used = loop.used};
}

// The stored views by their frames.
class StoredViews {
 public:
  explicit StoredViews(const workspace::Workspace& workspace) : store_(workspace.views(Poses::odometry, -1, 0)) {
    for (const views::ViewSummary& view : store_->summaries()) {
      index_of_frame_[view.frame_idx] = static_cast<int>(frames_.size());
      frames_.push_back(view.frame_idx);
    }
    IRIS_CHECK(!frames_.empty());
  }
  const std::vector<int>& frames() const { return frames_; }
  bool contains(int frame_idx) const { return index_of_frame_.contains(frame_idx); }
  const RectifiedCamera& camera() const { return store_->summaries().front().camera; }
  StereoView load(int frame_idx) const { return *store_->load(index_of_frame_.at(frame_idx)); }

 private:
  std::unique_ptr<views::ViewStore> store_;
  std::vector<int> frames_;
  std::map<int, int> index_of_frame_;
};

std::vector<loop::LoopEdge> search(const PoseGraph& graph, const StoredViews& views, const Options& options,
                                   const RunControl& control) {
  std::optional<Progress> progress;
  int total = -1;
  const loop::FindLoopsControl find_control{
      .progress =
          [&](int done, int of) {
            if (of != total) progress.emplace(control.progress, total < 0 ? "describe views" : "compare views", of);
            total = of;
            progress->update(done);
          },
      .stopped = [&] { return control.stopped(); }};
  return find_loops(
      graph, views.frames(), [&](int frame_idx) { return views.load(frame_idx); }, views.camera(), options.loop,
      options.motion, find_control);
}

// Gives each sub-map its z-up world.
void stand_upright(workspace::RefinedPath& path, const StoredViews& views, const loop::AlignmentOptions& options) {
  std::map<int, std::vector<PoseNode>> nodes_of_submap;
  for (const PoseNode& node : path.nodes) nodes_of_submap[node.submap].push_back(node);
  std::map<int, std::vector<int>> views_of_submap;
  for (const PoseNode& node : path.nodes) {
    if (views.contains(node.frame_idx)) views_of_submap[node.submap].push_back(node.frame_idx);
  }
  std::map<int, Pose> world_of_submap;
  for (const auto& [submap, nodes] : nodes_of_submap) {
    const loop::Alignment alignment = align(
        nodes, views_of_submap[submap], [&](int frame_idx) { return views.load(frame_idx); }, options);
    world_of_submap[submap] = alignment.world_from_graph;
    path.worlds.push_back({.submap = submap,
                           .floor_found = alignment.floor_found,
                           .alignment = alignment.used,
                           .up_guessed = alignment.guessed});
    if (alignment.guessed) {
      spdlog::warn(path.worlds.back().guess_text());
    } else if (submap == 0) {
      spdlog::info("up: {}", alignment.used);
    }
  }
  for (PoseNode& node : path.nodes) {
    const Pose& world = world_of_submap.at(node.submap);
    Matrix6d turn = Matrix6d::Zero();
    turn.topLeftCorner<3, 3>() = turn.bottomRightCorner<3, 3>() = world.linear();
    node.world_from_cam = world * node.world_from_cam;
    node.covariance = turn * node.covariance * turn.transpose();
  }
}

// Bundle adjustment of the refined path.
void adjust(workspace::RefinedPath& path, const loop::RefinedGraph& refined, const StoredViews& views,
            const Options& options, const RunControl& control) {
  const loop::BundleResult result = bundle(
      refined, views.frames(), [&](int frame_idx) { return views.load(frame_idx); }, views.camera(), options.bundle,
      options.motion, [&] { return control.stopped(); });
  if (!result.ok) {
    spdlog::info("bundle adjustment: left out, {}", result.problem);
    return;
  }
  spdlog::info("bundle adjustment: {} views, {} points, {:.3f} px before, {:.3f} px after", result.views, result.points,
               result.rms_before, result.rms_after);
  if (!result.calibration.words.empty()) {
    spdlog::log(result.calibration.is_wrong ? spdlog::level::warn : spdlog::level::info, "calibration: {}",
                result.calibration.words);
  }
  path.nodes = result.nodes;
  for (size_t i = 0; i < path.nodes.size(); ++i) path.nodes[i].covariance = result.covariance[i];
  path.camera = result.camera;
  path.calibration = {.text = result.calibration.words, .is_wrong = result.calibration.is_wrong};
}

std::vector<std::string> run_loop(const Options& options, workspace::Workspace& workspace, const RunControl& control) {
  const StoredViews views(workspace);
  PoseGraph graph = workspace.pose_graph(Poses::odometry);
  workspace::RefinedPath path;
  if (options.loop.enabled) {
    for (loop::LoopEdge& edge : search(graph, views, options, control)) path.loops.push_back({std::move(edge)});
  }
  std::vector<size_t> record_of_edge;  // behind the odometry
  const size_t odometry_edges = graph.edges.size();
  for (size_t i = 0; i < path.loops.size(); ++i) {
    if (path.loops[i].edge.verdict != loop::LoopVerdict::accepted) continue;
    graph.edges.push_back(edge_of(path.loops[i].edge));
    record_of_edge.push_back(i);
  }

  const loop::RefinedGraph refined = loop::refine(graph, options.loop, [&] { return control.stopped(); });
  if (!record_of_edge.empty()) {
    spdlog::info("errors: {:.1f} times what motions between neighbours state, {:.1f} times what loops state",
                 refined.odometry_sigma, refined.loop_sigma);
  }
  int accepted = 0;
  for (size_t i = 0; i < record_of_edge.size(); ++i) {
    workspace::LoopRecord& record = path.loops[record_of_edge[i]];
    record.error = refined.edge_error[odometry_edges + i];
    if (refined.edge_weight[odometry_edges + i] < loop::kRejectedWeight) {
      record.edge.verdict = loop::LoopVerdict::inconsistent;
    } else {
      ++accepted;
    }
  }
  if (options.loop.enabled) {
    spdlog::info("loops: {} of {} pairs of views that may show the same place are accepted", accepted,
                 path.loops.size());
  }
  path.odometry_sigma = refined.odometry_sigma;
  path.loop_sigma = refined.loop_sigma;
  path.nodes = refined.graph.nodes;
  for (size_t i = 0; i < path.nodes.size(); ++i) path.nodes[i].covariance = refined.covariance[i];
  path.camera = views.camera();
  if (options.loop.enabled && options.loop.bundle) adjust(path, refined, views, options, control);
  stand_upright(path, views, options.alignment);
  workspace.set_refined(path);
  return {};
}

}  // namespace

Stage loop_stage(const Options& options) {
  return {.name = "loop",
          .sections = {"loop", "motion"},
          .after = {"frames"},
          .inputs = {},
          .run = [&options](workspace::Workspace& workspace, const RunControl& control, const std::string&) {
            return run_loop(options, workspace, control);
          }};
}

}  // namespace iris::pipeline
