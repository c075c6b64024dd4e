#include "export/trajectory_file.h"

#include <fmt/format.h>

#include <charconv>
#include <iterator>
#include <limits>
#include <map>
#include <string>
#include <vector>

#include "export/plot_file.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"

namespace iris::exporters {
namespace fs = std::filesystem;
namespace {

// Nodes of each sub-map in the order of their frames.
std::map<int, std::vector<const PoseNode*>> nodes_of_submaps(const PoseGraph& graph) {
  std::map<int, std::vector<const PoseNode*>> submaps;
  for (const PoseNode& node : graph.nodes) submaps[node.submap].push_back(&node);
  return submaps;
}

// -1 if there are no poses.
int main_submap(const std::map<int, std::vector<const PoseNode*>>& submaps) {
  int main = -1;
  size_t most = 0;
  for (const auto& [submap, nodes] : submaps) {
    if (nodes.size() <= most) continue;
    most = nodes.size();
    main = submap;
  }
  return main;
}

// Adding 0 turns -0 into 0.
void append_number(std::string& text, double value) { fmt::format_to(std::back_inserter(text), "{}", value + 0.0); }

void append_translation_and_quaternion(std::string& text, const Pose& pose) {
  Eigen::Quaterniond q(pose.linear());
  q.normalize();
  if (q.w() < 0) q.coeffs() = -q.coeffs();
  const Eigen::Vector3d& t = pose.translation();
  for (const double value : {t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w()}) {
    text += ' ';
    append_number(text, value);
  }
}

// Seconds with all nine decimals, without the rounding of a double.
std::string seconds_text(int64_t stamp_ns) {
  const uint64_t ns = stamp_ns < 0 ? uint64_t{0} - static_cast<uint64_t>(stamp_ns) : static_cast<uint64_t>(stamp_ns);
  return fmt::format("{}{}.{:09}", stamp_ns < 0 ? "-" : "", ns / 1000000000, ns % 1000000000);
}

fs::path submap_path(const fs::path& path, int submap) {
  return path.parent_path() / fmt::format("{}_submap{}{}", path.stem().string(), submap, path.extension().string());
}

// Is `file` a submap_path of `path`?
bool is_submap_path(const fs::path& path, const fs::path& file) {
  const std::string start = path.stem().string() + "_submap", stem = file.stem().string();
  if (file.extension() != path.extension() || !stem.starts_with(start)) return false;
  int submap = 0;
  const auto [end, error] = std::from_chars(stem.data() + start.size(), stem.data() + stem.size(), submap);
  return error == std::errc() && end == stem.data() + stem.size();
}

}  // namespace

void write_tum(const fs::path& path, const PoseGraph& graph) {
  const auto submaps = nodes_of_submaps(graph);
  const int main = main_submap(submaps);
  const fs::path folder = path.has_parent_path() ? path.parent_path() : fs::path(".");
  if (submaps.empty()) write_file(path, std::string_view());
  for (const auto& [submap, nodes] : submaps) {
    std::string text;
    for (const PoseNode* node : nodes) {
      text += seconds_text(node->stamp_ns);
      append_translation_and_quaternion(text, node->world_from_cam);
      text += '\n';
    }
    write_file(submap == main ? path : submap_path(path, submap), text);
  }
  std::vector<fs::path> stale;
  for (const auto& entry : fs::directory_iterator(folder)) {
    if (!is_submap_path(path, entry.path())) continue;
    bool current = false;
    for (const auto& [submap, nodes] : submaps) {
      current |= submap != main && entry.path().filename() == submap_path(path, submap).filename();
    }
    if (!current) stale.push_back(entry.path());
  }
  for (const fs::path& file : stale) fs::remove(file);
}

void write_kitti(const fs::path& path, const PoseGraph& graph, int frames_in_session) {
  const auto submaps = nodes_of_submaps(graph);
  const int main = main_submap(submaps);
  std::vector<const PoseNode*> node_of_frame(static_cast<size_t>(frames_in_session));
  for (const PoseNode& node : graph.nodes) {
    IRIS_CHECK(node.frame_idx >= 0 && node.frame_idx < frames_in_session);
    if (node.submap == main) node_of_frame[static_cast<size_t>(node.frame_idx)] = &node;
  }
  Pose first_from_world = Pose::Identity();
  int first_frame = -1;
  if (!submaps.empty()) {
    const PoseNode& first = *submaps.at(main).front();
    first_from_world = first.world_from_cam.inverse();
    first_frame = first.frame_idx;
  }
  std::string text;
  for (const PoseNode* node : node_of_frame) {
    if (!node) {
      text += "nan nan nan nan nan nan nan nan nan nan nan nan\n";
      continue;
    }
    // The identity of the first frame without rounding errors.
    const Pose first_from_cam =
        node->frame_idx == first_frame ? Pose::Identity() : Pose(first_from_world * node->world_from_cam);
    for (int row = 0; row < 3; ++row) {
      for (int column = 0; column < 4; ++column) {
        append_number(text, first_from_cam(row, column));
        text += row == 2 && column == 3 ? '\n' : ' ';
      }
    }
  }
  write_file(path, text);
}

Matrix6d g2o_information(const PoseEdge& edge) {
  Matrix6d j = Matrix6d::Zero();
  j.topLeftCorner<3, 3>() = edge.i_from_j.linear();
  j.bottomRightCorner<3, 3>() = 2 * edge.i_from_j.linear();
  const Matrix6d information = j.transpose() * edge.information * j;
  return 0.5 * (information + information.transpose());
}

void write_g2o(const fs::path& path, const PoseGraph& graph, const std::vector<workspace::LoopRecord>& loops) {
  std::string text;
  std::map<int, int> first_frame;
  for (const PoseNode& node : graph.nodes) {
    text += fmt::format("VERTEX_SE3:QUAT {}", node.frame_idx);
    append_translation_and_quaternion(text, node.world_from_cam);
    text += '\n';
    first_frame.emplace(node.submap, node.frame_idx);
  }
  for (const auto& [submap, frame_idx] : first_frame) text += fmt::format("FIX {}\n", frame_idx);
  for (const workspace::LoopRecord& loop : loops) {
    text += fmt::format("# loop {} {}: {}", loop.edge.i, loop.edge.j, name_of(loop.edge.verdict));
    if (loop.edge.used > 0) text += fmt::format(", {} pairs", loop.edge.used);
    if (loop.edge.verdict == loop::LoopVerdict::accepted) {
      text += fmt::format(", {:.2f} standard deviations left", loop.error);
    }
    text += '\n';
  }
  for (const PoseEdge& edge : graph.edges) {
    text += fmt::format("EDGE_SE3:QUAT {} {}", edge.i, edge.j);
    append_translation_and_quaternion(text, edge.i_from_j);
    const Matrix6d information = g2o_information(edge);
    for (int row = 0; row < 6; ++row) {
      for (int column = row; column < 6; ++column) {
        text += ' ';
        append_number(text, information(row, column));
      }
    }
    text += '\n';
  }
  write_file(path, text);
}

void write_path_picture(const fs::path& path, const PoseGraph& odometry, const PoseGraph& refined) {
  IRIS_CHECK(odometry.nodes.size() == refined.nodes.size());
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const Eigen::Vector2d gap(nan, nan);
  PlotSeries before{.name = "chained", .colour = kGrey, .style = PlotSeries::Style::dashed},
      after{.name = "refined", .colour = kBlue}, loops{.name = "loops", .colour = kOrange},
      ends{.name = "start, end", .colour = kVermillion, .style = PlotSeries::Style::points};
  std::map<int, Eigen::Vector2d> position_of_frame;
  Pose refined_from_odometry = Pose::Identity();
  for (size_t i = 0; i < refined.nodes.size(); ++i) {
    const PoseNode &was = odometry.nodes[i], &is = refined.nodes[i];
    IRIS_CHECK(was.frame_idx == is.frame_idx);
    const bool begins = i == 0 || was.submap != odometry.nodes[i - 1].submap;
    if (begins) {
      refined_from_odometry = is.world_from_cam * was.world_from_cam.inverse();
      before.points.push_back(gap);
    }
    if (i == 0 || is.submap != refined.nodes[i - 1].submap) after.points.push_back(gap);
    before.points.push_back((refined_from_odometry * was.world_from_cam).translation().head<2>());
    after.points.push_back(is.world_from_cam.translation().head<2>());
    position_of_frame[is.frame_idx] = after.points.back();
  }
  for (const PoseEdge& edge : refined.edges) {
    if (edge.kind != PoseEdgeKind::loop) continue;
    loops.points.insert(loops.points.end(), {position_of_frame.at(edge.i), position_of_frame.at(edge.j), gap});
  }
  if (loops.points.empty()) loops.name.clear();
  if (!refined.nodes.empty()) {
    ends.points = {position_of_frame.at(refined.nodes.front().frame_idx),
                   position_of_frame.at(refined.nodes.back().frame_idx)};
  }
  write_plot(path, {.title = "Path from above",
                    .x_label = "x [m]",
                    .y_label = "y [m]",
                    .series = {before, after, loops, ends},
                    .equal_axes = true,
                    .height = 900});
}

}  // namespace iris::exporters
