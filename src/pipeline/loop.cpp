#include "iris/pipeline/loop.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <map>
#include <optional>

#include "iris/core/error.h"
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
          .kind = PoseEdgeKind::loop};
}

std::vector<loop::LoopEdge> search(const PoseGraph& graph, const views::ViewStore& views, const Options& options,
                                   const RunControl& control) {
  std::vector<int> frames;
  std::map<int, int> index_of_frame;
  for (const views::ViewSummary& view : views.summaries()) {
    index_of_frame[view.frame_idx] = static_cast<int>(frames.size());
    frames.push_back(view.frame_idx);
  }
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
      graph, frames, [&](int frame_idx) { return *views.load(index_of_frame.at(frame_idx)); },
      views.summaries().front().camera, options.loop, options.motion, find_control);
}

std::vector<std::string> run_loop(const Options& options, workspace::Workspace& workspace, const RunControl& control) {
  const auto views = workspace.views(Poses::odometry, -1, 0);
  IRIS_CHECK(!views->summaries().empty());
  PoseGraph graph = workspace.pose_graph(Poses::odometry);
  workspace::RefinedPath path;
  if (options.loop.enabled) {
    for (loop::LoopEdge& edge : search(graph, *views, options, control)) path.loops.push_back({std::move(edge)});
  }
  std::vector<size_t> record_of_edge;  // behind the odometry
  const size_t odometry_edges = graph.edges.size();
  for (size_t i = 0; i < path.loops.size(); ++i) {
    if (path.loops[i].edge.verdict != loop::LoopVerdict::accepted) continue;
    graph.edges.push_back(edge_of(path.loops[i].edge));
    record_of_edge.push_back(i);
  }

  loop::RefinedGraph refined = loop::refine(graph, options.pose_graph);
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
  const Pose world_from_graph = z_up_from_camera();
  Matrix6d turn = Matrix6d::Zero();
  turn.topLeftCorner<3, 3>() = turn.bottomRightCorner<3, 3>() = world_from_graph.linear();
  path.nodes = std::move(refined.graph.nodes);
  for (size_t i = 0; i < path.nodes.size(); ++i) {
    path.nodes[i].world_from_cam = world_from_graph * path.nodes[i].world_from_cam;
    path.nodes[i].covariance = turn * refined.covariance[i] * turn.transpose();
  }
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
