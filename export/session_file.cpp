#include "export/session_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "export/mesh_file.h"
#include "export/trajectory_file.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/simulate/floor_plan.h"
#include "iris/simulate/simulator.h"
#include "iris/workspace/view_files.h"

namespace iris::exporters {
namespace fs = std::filesystem;
namespace {

using simulate::Simulator;

std::string sensor_yaml(const CameraModel& camera, const Pose& body_from_camera, const std::string& name, double rate) {
  IRIS_CHECK(camera.distortion == Distortion::radial_tangential && camera.K(0, 1) == 0);
  const Eigen::Matrix4d m = body_from_camera.matrix();
  std::string pose;
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 4; ++column) {
      pose += fmt::format("{}{}", row + column == 0 ? "" : ", ", m(row, column));
    }
  }
  std::vector<double> distortion = camera.coefficients;
  distortion.resize(std::max<size_t>(4, distortion.size()), 0.0);
  return fmt::format(
      "sensor_type: camera\ncomment: {}, simulated\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{}]\nrate_hz: {}\n"
      "resolution: [{}, {}]\ncamera_model: pinhole\nintrinsics: [{}, {}, {}, {}]\n"
      "distortion_model: radial-tangential\ndistortion_coefficients: [{}]\n",
      name, pose, rate, camera.width, camera.height, camera.K(0, 0), camera.K(1, 1), camera.K(0, 2), camera.K(1, 2),
      fmt::join(distortion, ", "));
}

// Files of one frame; those that are there already are good, since each was written whole.
void write_frame(const fs::path& folder, const Simulator& simulator, int frame_idx) {
  const std::string image_name = fmt::format("{}.png", simulator.stamp_ns(frame_idx));
  const fs::path left = folder / "mav0/cam0/data" / image_name, right = folder / "mav0/cam1/data" / image_name;
  if (!fs::exists(left) || !fs::exists(right)) {
    const StereoFrame frame = simulator.frame(frame_idx);
    write_file(left, workspace::encode_png(frame.left));
    write_file(right, workspace::encode_png(frame.right));
  }
  const std::string name = fmt::format("{:06}.png", frame_idx);
  const fs::path truth_folder = folder / "truth";
  const std::vector<fs::path> names = {truth_folder / "disparity" / name, truth_folder / "occlusion" / name,
                                       truth_folder / "discontinuity" / name, truth_folder / "textured" / name};
  if (std::all_of(names.begin(), names.end(), [](const fs::path& path) { return fs::exists(path); })) return;
  const simulate::FrameTruth truth = simulator.truth(frame_idx);
  cv::Mat1w code;
  truth.disparity.convertTo(code, CV_16U, 256);  // saturates: what is nearer than 255.99 px is not told apart
  write_file(names[0], workspace::encode_png(code));
  write_file(names[1], workspace::encode_png(truth.occluded));
  write_file(names[2], workspace::encode_png(truth.discontinuity));
  write_file(names[3], workspace::encode_png(truth.textured));
}

void write_plan(const fs::path& folder, const simulate::FloorPlan& plan) {
  const auto write = [&](const std::string& name, const cv::Mat1b& cells, double low, double high) {
    write_file(folder / (name + ".png"), workspace::encode_png(cells));
    write_file(
        folder / (name + ".yaml"),
        fmt::format("# true map between z = {:.3f} m and {:.3f} m\nimage: {}.png\nmode: trinary\nresolution: {}\n"
                    "origin: [{}, {}, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n",
                    low, high, name, plan.cell, plan.origin_x, plan.origin_y));
  };
  for (size_t k = 0; k < plan.layers.size(); ++k) {
    write(fmt::format("plan_{}", k), plan.layers[k], plan.layer_bounds[k], plan.layer_bounds[k + 1]);
  }
  write("plan", plan.combined, plan.layer_bounds.front(), plan.layer_bounds.back());
}

void check_folder(const fs::path& folder, const std::string& options_text) {
  const fs::path record = folder / "truth/options.toml";
  if (!fs::exists(folder) || (fs::is_directory(folder) && fs::is_empty(folder))) {
    write_file(record, options_text);
    return;
  }
  if (fs::exists(record) && read_file(record) == options_text) return;
  if (!fs::is_directory(folder)) throw InputError(folder, "is no folder", "give a new folder with -o");
  throw InputError(
      folder,
      fs::exists(record) ? "holds a simulated session of other options" : "is not empty and is no simulated session",
      "give a new folder with -o, or delete this one");
}

}  // namespace

void write_session(const fs::path& folder, const simulate::Scene& scene, const simulate::SimulateOptions& options,
                   const mapping::FlogOptions& mapping, const std::string& options_text,
                   const pipeline::RunControl& control) {
  const Simulator simulator(scene, simulate::make_path(scene, options), options);
  const double cells = simulate::floor_plan_cells(scene, simulator, mapping.cell, mapping.layers);
  if (cells > simulate::kMostFloorPlanCells) {
    throw UsageError(
        fmt::format("the true map of '{}' would have {:.0f} million cells of {:g} m; choose larger ones with "
                    "--mapping.cell, or scale the model if its coordinates are not metres",
                    scene.name, cells / 1e6, mapping.cell));
  }
  check_folder(folder, options_text);

  const int frames = simulator.frames();
  {
    Progress progress(control.progress, "simulate", frames);
    constexpr int kBlock = 8;
    for (int begin = 0; begin < frames; begin += kBlock) {
      if (control.stopped()) throw Interrupted();
      const int end = std::min(begin + kBlock, frames);
      parallel_chunks(begin, end, 1, [&](int from, int to) {
        for (int i = from; i < to; ++i) write_frame(folder, simulator, i);
      });
      progress.update(end);
    }
  }

  const fs::path truth = folder / "truth";
  PoseGraph graph;
  std::string csv = "#timestamp [ns],filename\n";
  for (int i = 0; i < frames; ++i) {
    graph.nodes.push_back(
        {.frame_idx = i, .stamp_ns = simulator.stamp_ns(i), .world_from_cam = simulator.world_from_left(i)});
    csv += fmt::format("{0},{0}.png\n", simulator.stamp_ns(i));
  }
  write_tum(truth / "trajectory.tum", graph);

  std::vector<TriangleMesh> meshes;
  for (const simulate::SceneObject& object : scene.objects) {
    meshes.push_back(object.mesh);
    if (!object.world_from_object) continue;
    const Eigen::Isometry3f at_start = object.world_from_object(0).cast<float>();
    for (Eigen::Vector3f& vertex : meshes.back().vertices) vertex = at_start * vertex;
  }
  write_glb(truth / "scene.glb", meshes);

  if (control.stopped()) throw Interrupted();
  std::vector<double> bounds;
  for (int k = 0; k <= mapping.layers; ++k) bounds.push_back(mapping.bottom + mapping.height * k / mapping.layers);
  write_plan(truth, simulate::floor_plan(scene, simulator, mapping.cell, bounds, mapping.max_range));

  const StereoCalibration& rig = simulator.calibration();
  write_file(folder / "mav0/cam0/sensor.yaml", sensor_yaml(rig.left, Pose::Identity(), "left camera", options.rate));
  write_file(folder / "mav0/cam1/sensor.yaml",
             sensor_yaml(rig.right, rig.right_from_left.inverse(), "right camera", options.rate));
  write_file(folder / "mav0/cam0/data.csv", csv);
  write_file(folder / "mav0/cam1/data.csv", csv);
}

}  // namespace iris::exporters
