#include "export/evaluation.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <set>
#include <utility>

#include "export/cloud_file.h"
#include "export/evaluation_files.h"
#include "export/evaluation_plots.h"
#include "export/evaluation_sections.h"
#include "export/mesh_file.h"
#include "export/trajectory_file.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/evaluate/images.h"
#include "iris/loop/pose_graph.h"
#include "iris/pipeline/frames.h"
#include "iris/session/image_file.h"
#include "iris/workspace/workspace.h"

namespace iris::exporters {
namespace fs = std::filesystem;
namespace {

using evaluate::Trajectory;
using evaluate::TrajectoryErrors;

constexpr double kDegrees = 180 / std::numbers::pi;
constexpr const char* kGiveTruth = "give a session that holds truth/, its truth folder, or a file of truth";

// KITTI's poses carry no times: one line a second.
Trajectory by_line(const std::vector<std::optional<Pose>>& poses) {
  Trajectory trajectory;
  for (size_t i = 0; i < poses.size(); ++i) {
    if (poses[i]) trajectory.push_back({static_cast<int64_t>(i) * 1'000'000'000, *poses[i]});
  }
  return trajectory;
}

evaluate::DisparityScore score(const DisparityImage& estimate, const DisparityTruth& truth,
                               const evaluate::DisparityOptions& options) {
  return evaluate::score_disparities(estimate, truth.disparity, truth.occluded, truth.discontinuity, options);
}

FigureSection evaluate_maps(const EvaluationRequest& request, const fs::path& estimate_path, const fs::path& truth_path,
                            const Pose& truth_from_estimate) {
  constexpr double kLargestRatio = 50;  // of the sizes of cells
  const evaluate::GridMap estimate = read_map(estimate_path, false), truth = read_map(truth_path, true);
  const double ratio = truth.resolution / estimate.resolution;
  if (ratio > kLargestRatio || ratio < 1 / kLargestRatio) {
    throw InputError(
        truth_path,
        fmt::format("has cells of {:g} m, those of {} have {:g} m: nothing can be said of the one by the other",
                    truth.resolution, estimate_path.string(), estimate.resolution),
        "check the resolution in both files; it is in metres");
  }
  const evaluate::MapErrors errors = evaluate::evaluate_map(estimate, truth, truth_from_estimate, request.map);
  if (!request.plots.empty()) plot_map(request.plots, estimate, truth, truth_from_estimate, request.map);
  FigureSection section = map_section(errors, truth.resolution, request.map);
  const auto [bottom, top] = map_heights(estimate_path);
  const auto [true_bottom, true_top] = map_heights(truth_path);
  constexpr double kSame = 0.011;  // [m]
  const bool known = bottom < top && true_bottom < true_top;
  if (known && (std::abs(bottom - true_bottom) > kSame || std::abs(top - true_top) > kSame)) {
    section.notes.push_back(fmt::format(
        "warning: the map shows what stands between {:g} and {:g} m, the plan what does between {:g} and "
        "{:g} m: obstacles of other heights count as false or missing; map and simulate again with the same "
        "mapping.bottom and mapping.height",
        bottom, top, true_bottom, true_top));
  }
  return section;
}

// 255 where the pictures are compared; empty = everywhere.
cv::Mat1b image_mask(const EvaluationRequest& request, const cv::Mat& estimate) {
  if (request.mask.empty()) return {};
  if (request.mask != "black") {
    require_file(request.mask);
    return read_mask(request.mask, estimate.size(), request.estimate.string());
  }
  std::vector<cv::Mat1b> channels;
  cv::split(estimate, channels);
  cv::Mat1b mask = channels[0];
  for (const cv::Mat1b& channel : channels) mask = mask | channel;
  return mask;
}

FigureSection evaluate_images(const EvaluationRequest& request) {
  cv::Mat estimate = session::read_image(request.estimate), truth = session::read_image(request.truth);
  require_size(request.truth, truth.size(), estimate.size(), request.estimate.string());
  for (const auto& [path, image] : {std::pair(request.estimate, estimate), std::pair(request.truth, truth)}) {
    if (image.depth() != CV_8U) throw InputError(path, "has 16 bits a value", "convert it to an 8-bit image");
  }
  const cv::Mat1b mask = image_mask(request, estimate);
  if (estimate.channels() != truth.channels()) {
    if (estimate.channels() == 3) cv::cvtColor(estimate, estimate, cv::COLOR_BGR2GRAY);
    if (truth.channels() == 3) cv::cvtColor(truth, truth, cv::COLOR_BGR2GRAY);
  }
  const evaluate::ImageErrors errors = evaluate::compare_images(estimate, truth, mask);
  if (errors.pixels == 0) throw InputError(request.estimate, "the mask leaves no pixel", "give another --mask");
  return image_section(errors, truth.size(), truth.channels() == 3);
}

// The output of a run.
class OutputFolder {
 public:
  OutputFolder(const EvaluationRequest& request, Evaluation& evaluation)
      : request_(request),
        evaluation_(evaluation),
        workspace_(workspace::Workspace::open(request.estimate, workspace::Workspace::Access::read_only)) {
    workspace_.for_each_frame(
        [&](const workspace::FrameRecord& record) { stamps_[record.frame_idx] = record.stamp_ns; });
  }

  // False if no sub-map has two poses.
  bool evaluate_trajectories(const fs::path& truth_path) {
    const std::string text = read_file(truth_path);
    const bool kitti = evaluate::is_kitti(text);
    truth_ = kitti ? kitti_truth(truth_path, text) : evaluate::parse_tum(text, truth_path);
    const std::vector<SubMap> submaps = read_submaps();
    const SubMap& main = submaps.front();
    if (main.poses.size() < 2) {
      evaluation_.sections.push_back(
          {.name = "trajectory",
           .title = "Trajectory",
           .notes = {"no sub-map has two poses: neither path nor map can be compared; 'iris info OUT' says why"},
           .figures = {{"submap_count", "sub-maps", static_cast<double>(submaps.size()), ""}},
           .tables = {}});
      return false;
    }
    require_common_time(main.path, main.poses, truth_path, truth_);
    const TrajectoryErrors errors = evaluate::evaluate_trajectory(main.poses, truth_, request_.trajectory);
    bool ignored = false;
    truth_from_estimate_ = evaluate::align_worlds(errors.pairs, false, ignored).truth_from_estimate;
    // The truth may be of the camera as recorded, turned a little against the rectified one.
    Eigen::Matrix3d turns = Eigen::Matrix3d::Zero();
    for (const evaluate::PosePair& pair : errors.pairs) {
      turns += pair.truth.linear().transpose() * truth_from_estimate_.linear() * pair.estimate.linear();
      true_poses_[pair.stamp_ns] = pair.truth;
    }
    true_from_rectified_.linear() = nearest_rotation(turns / static_cast<double>(errors.pairs.size()));

    FigureSection section = trajectory_section(errors, request_.trajectory, true);
    section.notes.insert(section.notes.begin(), fmt::format("{} against {}", main.path.string(), truth_path.string()));
    add_odometry(section, pipeline::summarise_frames(workspace_, workspace::Poses::odometry).largest_submap);
    add_edges(section, submaps, errors);
    if (submaps.size() > 1) add_submaps(section, submaps);
    evaluation_.sections.push_back(std::move(section));
    if (!request_.plots.empty()) plot_trajectory(request_.plots, errors, truth_, kitti ? 2 : 1, true);
    return true;
  }

  void evaluate_disparities(const fs::path& folder) {
    const auto views = workspace_.views(workspace::Poses::refined, -1, 0);
    const std::vector<int> indices = views_with_truth(*views, folder);
    const std::vector<int> shown = views_to_draw(*views, indices);
    std::vector<evaluate::DisparityScore> scores(indices.size());
    parallel_chunks(0, static_cast<int>(indices.size()), 1, [&](int i, int) {
      const auto view = views->load(indices[static_cast<size_t>(i)]);
      scores[static_cast<size_t>(i)] = score(view->disparity, truth_of(*view, folder), request_.disparity);
    });
    evaluate::DisparityScore all;
    for (const evaluate::DisparityScore& one : scores) all.add(one);
    if (all.all.known == 0) throw InputError(folder, "has no known disparity in any image", "check the files");
    FigureSection section = disparity_section(all, request_.disparity);
    const int without = static_cast<int>(views->summaries().size() - indices.size());
    if (without > 0) section.notes.push_back(fmt::format("{} more stored views have no truth", without));
    evaluation_.sections.push_back(std::move(section));
    if (request_.plots.empty()) return;
    plot_disparities(request_.plots, all);
    for (const int index : shown) {
      const auto view = views->load(index);
      plot_error_picture(request_.plots, fmt::format("disparity_error_{:06}", view->frame_idx),
                         view->disparity.disparity, truth_of(*view, folder).disparity, request_.disparity);
    }
  }

  // `folder` holds scene.glb, disparity/ and perhaps textured/.
  void evaluate_cloud(const fs::path& folder) {
    const fs::path path = request_.estimate / "model" / "cloud.ply";
    if (!fs::exists(path)) return;
    constexpr int kStep = 8;  // [px] of the true points that are looked for
    const auto views = workspace_.views(
        workspace::Poses::refined, pipeline::summarise_frames(workspace_, workspace::Poses::refined).largest_submap, 0);
    const int count = static_cast<int>(views->summaries().size());
    std::vector<std::vector<Eigen::Vector3d>> seen(static_cast<size_t>(count));
    parallel_chunks(0, count, 1, [&](int i, int) {
      const views::ViewSummary& view = views->summaries()[static_cast<size_t>(i)];
      const auto pose = true_poses_.find(stamps_.at(view.frame_idx));
      const fs::path name = truth_file(folder / "disparity", view.frame_idx);
      if (pose == true_poses_.end() || !fs::exists(name)) return;
      const DisparityTruth truth = read_disparity_truth(name, request_.truth_scale);
      const cv::Mat1b textured = read_mask(truth_file(folder / "textured", view.frame_idx), truth.disparity.size(),
                                           request_.estimate.string());
      const Pose world_from_cam = pose->second * true_from_rectified_;
      for (int y = kStep / 2; y < truth.disparity.rows; y += kStep) {
        for (int x = kStep / 2; x < truth.disparity.cols; x += kStep) {
          if (truth.disparity(y, x) <= 0 || (!textured.empty() && textured(y, x) == 0)) continue;
          seen[static_cast<size_t>(i)].push_back(world_from_cam * view.camera.point(x, y, truth.disparity(y, x)));
        }
      }
    });
    std::vector<Eigen::Vector3d> all;
    for (const auto& some : seen) all.insert(all.end(), some.begin(), some.end());
    const evaluate::CloudOptions options;
    evaluation_.sections.push_back(cloud_section(
        evaluate::evaluate_cloud(read_ply(path), truth_from_estimate_, read_meshes(folder / "scene.glb"), all, options),
        options));
  }

  void evaluate_map(const fs::path& plan) {
    const fs::path map = request_.estimate / "map" / "map.yaml";
    if (!fs::exists(map)) {
      evaluation_.sections.back().notes.push_back(map.string() + " is missing: no map is compared");
      return;
    }
    evaluation_.sections.push_back(evaluate_maps(request_, map, plan, truth_from_estimate_));
  }

 private:
  struct SubMap {
    fs::path path;
    Trajectory poses;
  };

  static fs::path truth_file(const fs::path& folder, int frame_idx) {
    return folder / fmt::format("{:06}.png", frame_idx);
  }

  // Indices of the stored views.
  std::vector<int> views_with_truth(const views::ViewStore& views, const fs::path& folder) const {
    const auto n = static_cast<int>(views.summaries().size());
    std::vector<int> indices;
    for (int i = 0; i < n; ++i) {
      if (fs::exists(truth_file(folder, views.summaries()[static_cast<size_t>(i)].frame_idx))) indices.push_back(i);
    }
    if (indices.empty()) {
      throw InputError(
          folder, fmt::format("has no disparity image of any of the {} views of {}", n, request_.estimate.string()),
          "give the truth of the session that was reconstructed");
    }
    return indices;
  }

  // Of `indices` those whose frames are asked for, else the first, the middle and the last.
  std::vector<int> views_to_draw(const views::ViewStore& views, const std::vector<int>& indices) const {
    std::set<int> shown;
    if (request_.views.empty()) shown = {indices.front(), indices[indices.size() / 2], indices.back()};
    for (const int frame_idx : request_.views) {
      const auto found = std::find_if(indices.begin(), indices.end(), [&](int i) {
        return views.summaries()[static_cast<size_t>(i)].frame_idx == frame_idx;
      });
      if (found == indices.end()) {
        throw InputError(request_.estimate, fmt::format("frame {} has no stored view with truth", frame_idx),
                         "choose another --view; OUT/views names those that are stored");
      }
      shown.insert(*found);
    }
    return {shown.begin(), shown.end()};
  }

  DisparityTruth truth_of(const StereoView& view, const fs::path& folder) const {
    const fs::path path = truth_file(folder, view.frame_idx);
    DisparityTruth truth = read_disparity_truth(path, request_.truth_scale);
    require_size(path, truth.disparity.size(), view.disparity.disparity.size(),
                 fmt::format("view {:06} of {}", view.frame_idx, request_.estimate.string()));
    return truth;
  }

  // Line i of KITTI's poses is frame i of the run.
  Trajectory kitti_truth(const fs::path& path, const std::string& text) const {
    const std::vector<std::optional<Pose>> poses = evaluate::parse_kitti(text, path);
    if (!stamps_.empty() && poses.size() <= static_cast<size_t>(stamps_.rbegin()->first)) {
      throw InputError(path,
                       fmt::format("has {} lines, the session of {} has {} frames at least", poses.size(),
                                   request_.estimate.string(), stamps_.rbegin()->first + 1),
                       "give the truth of the session that was reconstructed: a line for each of its frames");
    }
    Trajectory truth;
    for (const auto& [frame_idx, stamp] : stamps_) {
      const auto i = static_cast<size_t>(frame_idx);
      if (i < poses.size() && poses[i]) truth.push_back({stamp, *poses[i]});
    }
    if (truth.empty()) {
      throw InputError(path,
                       fmt::format("has {} lines, but no pose of any of the {} frames of {}", poses.size(),
                                   stamps_.size(), request_.estimate.string()),
                       "give the truth of the session that was reconstructed");
    }
    return truth;
  }

  // The main one first, then by their numbers of poses.
  std::vector<SubMap> read_submaps() const {
    const fs::path folder = request_.estimate / "trajectory", main = folder / "tum.txt";
    if (!fs::exists(main)) {
      throw InputError(main, "there is no such file",
                       "finish the run: 'iris run SESSION -o OUT' goes on where it stopped");
    }
    const std::string text = read_file(main);
    if (text.empty()) return {{main, {}}};  // a run without any pose
    std::vector<SubMap> submaps = {{main, evaluate::parse_tum(text, main)}};
    std::vector<fs::path> others;
    for (const auto& entry : fs::directory_iterator(folder)) {
      if (entry.path().filename().string().starts_with("tum_submap")) others.push_back(entry.path());
    }
    std::sort(others.begin(), others.end());
    for (const fs::path& path : others) submaps.push_back({path, evaluate::parse_tum(read_file(path), path)});
    std::stable_sort(submaps.begin() + 1, submaps.end(),
                     [](const SubMap& a, const SubMap& b) { return a.poses.size() > b.poses.size(); });
    return submaps;
  }

  void add_edges(FigureSection& section, const std::vector<SubMap>& submaps, const TrajectoryErrors& errors) const {
    const fs::path path = request_.estimate / "trajectory" / "graph.g2o";
    if (!fs::exists(path)) {
      section.notes.push_back(path.string() + " is missing: the stated covariances are not judged");
      return;
    }
    std::map<int64_t, Pose> true_poses;
    for (const SubMap& submap : submaps) {
      for (const evaluate::PosePair& pair : evaluate::associate(submap.poses, truth_)) {
        Pose pose = pair.truth;
        pose.linear() = pair.truth.linear() * errors.estimate_from_truth_cam.transpose();
        true_poses[pair.stamp_ns] = pose;
      }
    }
    const PoseGraph graph = workspace_.pose_graph(workspace::Poses::refined);
    // The file does not tell measured motions from loops.
    std::set<std::pair<int, int>> odometry;
    for (const PoseEdge& edge : graph.edges) {
      if (edge.kind == PoseEdgeKind::odometry) odometry.emplace(edge.i, edge.j);
    }
    std::vector<evaluate::MotionEdge> motions, loops;
    for (const evaluate::GraphEdge& edge : evaluate::parse_g2o_edges(read_file(path), path)) {
      if (!stamps_.contains(edge.i) || !stamps_.contains(edge.j)) {
        throw InputError(path,
                         fmt::format("has an edge between frames {} and {} that the run does not have", edge.i, edge.j),
                         "'iris export OUT --only trajectory' writes it again");
      }
      (odometry.contains({edge.i, edge.j}) ? motions : loops)
          .push_back({stamps_.at(edge.i), stamps_.at(edge.j), edge.i_from_j, edge.information});
    }
    add_consistency(section, evaluate::evaluate_consistency(motions, true_poses),
                    evaluate::evaluate_consistency(loops, true_poses),
                    evaluate::evaluate_consistency(pose_edges(graph), true_poses));
    add_joint_consistency(section, graph, true_poses);
  }

  // What the errors of poses along a path have in common makes their NEES differ by chance: the squares of n poses have
  // the variance of so many independent ones as their joint covariance says. And motions over a part of the path, which
  // carry the truth's error at two of its poses, but not that of its first one along all of it.
  void add_joint_consistency(FigureSection& section, const PoseGraph& graph,
                             const std::map<int64_t, Pose>& true_poses) const {
    constexpr size_t kPoses = 40;  // of the largest sub-map
    std::vector<const PoseNode*> nodes, chosen;
    for (const PoseNode& node : graph.nodes) {
      if (node.submap == 0 && true_poses.contains(node.stamp_ns)) nodes.push_back(&node);
    }
    if (nodes.size() < 3) return;
    std::vector<int> frames;
    const size_t count = std::min(kPoses, nodes.size() - 1);
    for (size_t k = 1; k <= count; ++k) {
      chosen.push_back(nodes[k * (nodes.size() - 1) / count]);
      frames.push_back(chosen.back()->frame_idx);
    }
    const Eigen::MatrixXd joint = loop::joint_covariance(graph, frames);
    if (!joint.allFinite()) return;
    const auto block = [&](size_t k, size_t l) -> Matrix6d {
      return joint.block<6, 6>(static_cast<Eigen::Index>(6 * k), static_cast<Eigen::Index>(6 * l));
    };
    double common = 0, way = 0;
    std::vector<evaluate::MotionEdge> motions;
    for (size_t k = 0; k < count; ++k) {
      for (size_t l = 0; l < count; ++l) {
        common +=
            block(k, k).ldlt().solve(block(k, l)).cwiseProduct(block(l, l).ldlt().solve(block(l, k)).transpose()).sum();
      }
      if (k == 0) continue;
      const PoseNode &i = *chosen[k - 1], &j = *chosen[k];
      const Pose i_from_j = i.world_from_cam.inverse() * j.world_from_cam;
      const loop::EdgeJacobians by = loop::edge_jacobians(i.world_from_cam, j.world_from_cam, Vector6d::Zero());
      const Matrix6d cross = by.by_i * block(k - 1, k) * by.by_j.transpose();
      const Matrix6d covariance = by.by_i * block(k - 1, k - 1) * by.by_i.transpose() +
                                  by.by_j * block(k, k) * by.by_j.transpose() + cross + cross.transpose();
      const PoseEdge edge{
          .i = i.frame_idx, .j = j.frame_idx, .i_from_j = i_from_j, .information = covariance.inverse()};
      motions.push_back({i.stamp_ns, j.stamp_ns, i_from_j, g2o_information(edge)});
      way += i_from_j.translation().norm() / static_cast<double>(count - 1);
    }
    const double independent =
        std::clamp(6 * static_cast<double>(count * count) / common, 1.0, static_cast<double>(count));
    const int degrees = static_cast<int>(std::lround(6 * independent));
    auto& f = section.figures;
    f.push_back({"pose_nees_independent", "of so many independent poses, by their joint covariance", independent, "1"});
    f.push_back({"pose_nees_low", "95 % band of their mean: from",
                 6 * evaluate::chi_squared_quantile(0.025, degrees) / degrees, "1"});
    f.push_back({"pose_nees_high", "95 % band of their mean: to",
                 6 * evaluate::chi_squared_quantile(0.975, degrees) / degrees, "1"});
    const evaluate::Consistency between = evaluate::evaluate_consistency(motions, true_poses);
    if (between.edges == 0) return;
    f.push_back({"part_nees_mean",
                 fmt::format("NEES of motions between {} poses along the path, mean (6 expected)", count), between.mean,
                 "1"});
    f.push_back({"part_nees_median", "NEES of these motions, median (5.35 expected)", between.median, "1"});
    f.push_back({"part_length", "mean length of these motions", way, "m"});
    f.push_back({"error_ratio", "true errors / stated ones, of these motions (median)",
                 std::sqrt(between.median / evaluate::chi_squared_quantile(0.5, 6)), "1"});
  }

  // The poses as motions from the first camera of their sub-map: what their covariances are stated against.
  std::vector<evaluate::MotionEdge> pose_edges(const PoseGraph& graph) const {
    std::vector<evaluate::MotionEdge> edges;
    std::map<int, const PoseNode*> first;
    for (const PoseNode& node : graph.nodes) {
      const PoseNode& from = *first.try_emplace(node.submap, &node).first->second;
      // The first camera, and what moves rigidly with it.
      if (&from == &node || !(node.covariance.diagonal().minCoeff() > 0)) continue;
      Matrix6d turn = Matrix6d::Zero();  // of the perturbation, from the world into the first camera
      turn.topLeftCorner<3, 3>() = turn.bottomRightCorner<3, 3>() = from.world_from_cam.linear().transpose();
      const PoseEdge edge{.i = from.frame_idx,
                          .j = node.frame_idx,
                          .i_from_j = from.world_from_cam.inverse() * node.world_from_cam,
                          .information = (turn * node.covariance * turn.transpose()).inverse()};
      edges.push_back({from.stamp_ns, node.stamp_ns, edge.i_from_j, g2o_information(edge)});
    }
    return edges;
  }

  // The path before loops were closed: what the loop stage gains.
  void add_odometry(FigureSection& section, int submap) const {
    Trajectory odometry;
    for (const PoseNode& node : workspace_.pose_graph(workspace::Poses::odometry).nodes) {
      if (node.submap == submap) odometry.push_back({node.stamp_ns, node.world_from_cam});
    }
    if (evaluate::associate(odometry, truth_).size() < 2) return;
    const TrajectoryErrors errors = evaluate::evaluate_trajectory(odometry, truth_, request_.trajectory);
    section.figures.push_back(
        {"chained_ate_rmse", "ATE before loop closure and refinement, RMS", errors.absolute.translation.rmse, "m"});
  }

  void add_submaps(FigureSection& section, const std::vector<SubMap>& submaps) const {
    constexpr size_t kEnough = 3;
    FigureTable table{.name = "submaps",
                      .title = "Sub-maps, each aligned by itself",
                      .columns = {{"file", "file", 0},
                                  {"poses", "poses", 0},
                                  {"path_m", "path m", 3},
                                  {"ate_rmse_mm", "ATE mm", 2},
                                  {"ate_rotation_rmse_deg", "rotation deg", 3},
                                  {"drift_percent", "drift %", 3},
                                  {"closing_percent", "closing %", 3}}};
    const auto share = [](double part, double whole) { return whole > 0 ? 100 * part / whole : std::nan(""); };
    int small = 0;
    for (const SubMap& submap : submaps) {
      if (evaluate::associate(submap.poses, truth_).size() < kEnough) {
        ++small;
        continue;
      }
      const TrajectoryErrors e = evaluate::evaluate_trajectory(submap.poses, truth_, request_.trajectory);
      table.rows.push_back({submap.path.filename().string(), static_cast<double>(e.pairs.size()), e.true_path,
                            1000 * e.absolute.translation.rmse, kDegrees * e.absolute.rotation.rmse,
                            share(e.mean_drift.segments * e.mean_drift.translation, e.mean_drift.segments),
                            share(e.closing_translation, e.true_path)});
    }
    section.figures.push_back({"submap_count", "sub-maps", static_cast<double>(submaps.size()), ""});
    if (small > 0)
      section.notes.push_back(fmt::format("{} sub-maps have fewer than {} poses with truth", small, kEnough));
    section.tables.push_back(std::move(table));
  }

  const EvaluationRequest& request_;
  Evaluation& evaluation_;
  workspace::Workspace workspace_;
  std::map<int, int64_t> stamps_;
  Trajectory truth_;
  Pose truth_from_estimate_ = Pose::Identity();
  std::map<int64_t, Pose> true_poses_;           // by stamp, as the truth has them
  Pose true_from_rectified_ = Pose::Identity();  // a turn
};

// The folder of truth of a session, or itself.
fs::path truth_folder(const fs::path& path) { return fs::is_directory(path / "truth") ? path / "truth" : path; }

// The true path in a folder of truth; it need not be there.
fs::path true_path_in(const fs::path& folder) {
  const fs::path tum = folder / "trajectory.tum";
  return fs::exists(tum) ? tum : folder / "poses.txt";
}

void evaluate_output(const EvaluationRequest& request, Evaluation& evaluation) {
  OutputFolder output(request, evaluation);
  if (!fs::is_directory(request.truth)) {
    require_file(request.truth);
    const std::string extension = request.truth.extension().string();
    if (extension != ".tum" && extension != ".txt" && extension != ".csv") {
      throw InputError(request.truth, "is no path of a camera",
                       "for maps and disparities give the session or its truth folder");
    }
    output.evaluate_trajectories(request.truth);
    return;
  }
  const fs::path folder = truth_folder(request.truth), path = true_path_in(folder);
  const bool has_path = fs::exists(path);
  const bool is_aligned = has_path && output.evaluate_trajectories(path);
  if (fs::is_directory(folder / "disparity")) output.evaluate_disparities(folder / "disparity");
  if (fs::exists(folder / "plan.yaml")) {
    if (!has_path) {
      throw InputError(folder, "has plan.yaml, but no trajectory.tum",
                       "the map is laid on the plan by the path: add it");
    }
    if (is_aligned) output.evaluate_map(folder / "plan.yaml");
  }
  if (is_aligned && fs::exists(folder / "scene.glb") && fs::is_directory(folder / "disparity")) {
    output.evaluate_cloud(folder);
  }
  if (evaluation.sections.empty()) {
    throw InputError(folder, "holds neither trajectory.tum, poses.txt nor disparity/", kGiveTruth);
  }
}

void evaluate_trajectory_files(const EvaluationRequest& request, Evaluation& evaluation) {
  require_file(request.estimate);
  require_file(request.truth);
  const std::string estimate_text = read_file(request.estimate), truth_text = read_file(request.truth);
  const bool kitti = evaluate::is_kitti(estimate_text);
  if (kitti != evaluate::is_kitti(truth_text)) {
    throw InputError(request.truth, "one of the two files has KITTI poses, without times, the other has times",
                     "evaluate the output folder instead, which knows the time of each frame");
  }
  const auto parse = [&](const std::string& text, const fs::path& path) {
    return kitti ? by_line(evaluate::parse_kitti(text, path)) : evaluate::parse_tum(text, path);
  };
  const Trajectory estimate = parse(estimate_text, request.estimate), truth = parse(truth_text, request.truth);
  require_common_time(request.estimate, estimate, request.truth, truth);
  const TrajectoryErrors errors = evaluate::evaluate_trajectory(estimate, truth, request.trajectory);
  evaluation.sections.push_back(trajectory_section(errors, request.trajectory, !kitti));
  if (!request.plots.empty()) plot_trajectory(request.plots, errors, truth, kitti ? 2 : 1, !kitti);
}

void evaluate_disparity_files(const EvaluationRequest& request, Evaluation& evaluation) {
  const DisparityImage estimate = read_disparity(request.estimate);
  const DisparityTruth truth = read_disparity_truth(request.truth, request.truth_scale);
  require_size(request.truth, truth.disparity.size(), estimate.disparity.size(), request.estimate.string());
  const evaluate::DisparityScore errors = score(estimate, truth, request.disparity);
  if (errors.all.known == 0) {
    throw InputError(request.truth, "has no known disparity", "check --truth-scale and the file");
  }
  evaluation.sections.push_back(disparity_section(errors, request.disparity));
  if (request.plots.empty()) return;
  plot_disparities(request.plots, errors);
  plot_error_picture(request.plots, "disparity_error", estimate.disparity, truth.disparity, request.disparity);
}

std::string kind_of(const fs::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  if (extension == ".txt" || extension == ".tum" || extension == ".csv") return "trajectory";
  if (extension == ".yaml" || extension == ".yml") return "map";
  if (extension == ".pfm") return "disparity";
  if (!session::is_image_file(path)) {
    throw InputError(path, "of this kind nothing can be evaluated",
                     "give an output folder, a trajectory (.txt, .tum, .csv), a disparity image (16-bit .png, .pfm), a "
                     "map.yaml or an image, or say --kind");
  }
  return session::read_image(path).depth() == CV_16U ? "disparity" : "image";
}

}  // namespace

std::vector<std::string> compared_kinds(const EvaluationRequest& request) {
  if (!fs::exists(request.estimate)) {
    throw InputError(request.estimate, "there is no such file or folder", "check the name");
  }
  if (!fs::exists(request.truth)) throw InputError(request.truth, "there is no such file or folder", kGiveTruth);
  if (fs::is_directory(request.estimate)) {
    if (!fs::exists(request.estimate / "workspace.db")) {
      throw InputError(request.estimate, "is no output folder of a run",
                       "give OUT of 'iris run SESSION -o OUT', or a file");
    }
    if (fs::is_directory(request.truth)) return {"trajectory", "disparity", "map"};
    return {"trajectory"};
  }
  return {request.kind == "auto" ? kind_of(request.estimate) : request.kind};
}

Evaluation evaluate_files(const EvaluationRequest& asked) {
  EvaluationRequest request = asked;
  const std::string kind = compared_kinds(request).front();
  const bool folder = fs::is_directory(request.estimate);
  if (!folder && fs::is_directory(request.truth)) {
    // A session's truth has one path and one plan, but pictures and disparities of many frames.
    if (kind == "trajectory") request.truth = true_path_in(truth_folder(request.truth));
    if (kind == "map") request.truth = truth_folder(request.truth) / "plan.yaml";
    if (!fs::exists(request.truth)) {
      throw InputError(request.truth, "there is no such file", "give the file of truth that belongs to the result");
    }
    if (fs::is_directory(request.truth)) {
      throw InputError(request.truth, "is a folder, but a single file is evaluated",
                       "give the file of truth that belongs to it");
    }
  }
  Evaluation evaluation{.estimate = request.estimate.string(), .truth = request.truth.string(), .sections = {}};
  if (folder) {
    evaluate_output(request, evaluation);
    return evaluation;
  }
  if (kind == "trajectory") {
    evaluate_trajectory_files(request, evaluation);
  } else if (kind == "disparity") {
    evaluate_disparity_files(request, evaluation);
  } else if (kind == "map") {
    FigureSection section = evaluate_maps(request, request.estimate, request.truth, Pose::Identity());
    section.notes.push_back("both maps are taken to be in the same world; evaluate the output folder to align them");
    evaluation.sections.push_back(std::move(section));
  } else {
    evaluation.sections.push_back(evaluate_images(request));
  }
  return evaluation;
}

}  // namespace iris::exporters
