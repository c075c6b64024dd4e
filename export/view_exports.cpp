#include "export/view_exports.h"

#include <fmt/format.h>

#include <algorithm>
#include <deque>
#include <nlohmann/json.hpp>

#include "export/depth_file.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/pipeline/frames.h"
#include "iris/workspace/view_files.h"

namespace iris::exporters {
namespace fs = std::filesystem;
namespace {

using Eigen::Vector3d;
using nlohmann::json;

// What the points need of a view.
struct SeenView {
  int view_idx = 0;
  std::shared_ptr<const StereoView> view;
  cv::Mat1i at;  // [square] point seen there, -1 = none
};

cv::Vec3b colour_at(const cv::Mat& image, int y, int x) {
  if (image.channels() == 3) return image.at<cv::Vec3b>(y, x);
  const uint8_t grey = image.at<uint8_t>(y, x);
  return {grey, grey, grey};
}

std::string image_name(const views::ViewSummary& view) { return fmt::format("{:06}.png", view.frame_idx); }

// Pixel coordinates whose origin is the corner, not the centre, of the upper-left pixel.
constexpr double kCorner = 0.5;

void write_ply(const fs::path& path, const std::vector<ScenePoint>& points) {
  std::string text = fmt::format(
      "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
      "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n",
      points.size());
  for (const ScenePoint& point : points) {
    text += fmt::format("{} {} {} {} {} {}\n", static_cast<float>(point.position.x()),
                        static_cast<float>(point.position.y()), static_cast<float>(point.position.z()), point.colour[2],
                        point.colour[1], point.colour[0]);
  }
  write_file(path, text);
}

// Empties what an earlier call wrote.
void begin_folder(const fs::path& folder) {
  std::error_code ignored;
  fs::remove_all(folder, ignored);
}

std::vector<std::string> files_below(const fs::path& out, const char* folder) {
  std::vector<std::string> files;
  for (const auto& entry : fs::recursive_directory_iterator(out / folder)) {
    if (entry.is_regular_file()) files.push_back(fs::relative(entry.path(), out).string());
  }
  std::sort(files.begin(), files.end());
  return files;
}

}  // namespace

std::vector<ScenePoint> scene_points(const views::ViewStore& views, int step) {
  constexpr size_t kNeighbours = 12;
  std::vector<ScenePoint> points;
  std::deque<SeenView> recent;  // the last ones, ascending
  // A point becomes known to a view if the view measured it; true then.
  const auto observe = [&](SeenView& seen, int point_idx, double& difference) {
    ScenePoint& point = points[static_cast<size_t>(point_idx)];
    const StereoView& view = *seen.view;
    const Vector3d in_cam = view.world_from_cam.inverse() * point.position;
    if (in_cam.z() <= 0) return false;
    const Vector3d pixel = view.camera.project(in_cam);
    const double x = std::round(pixel.x()), y = std::round(pixel.y());
    if (!(x >= 0 && y >= 0 && x < view.camera.width && y < view.camera.height)) return false;
    const int column = static_cast<int>(x), row = static_cast<int>(y);
    const float there = view.disparity.at(row, column, DisparityOrigin::corrected);
    if (there <= 0 || std::abs(there - pixel.z()) > 1) return false;
    difference = std::abs(there - pixel.z());
    int& square = seen.at(row / step, column / step);
    if (square < 0) square = point_idx;
    point.observations.push_back({seen.view_idx, pixel.x(), pixel.y()});
    return true;
  };
  std::vector<double> differences;  // [point] sum over its observations
  for (int i = 0; i < static_cast<int>(views.summaries().size()); ++i) {
    SeenView current{i, views.load(i), {}};
    const StereoView& view = *current.view;
    current.at = cv::Mat1i((view.camera.height + step - 1) / step, (view.camera.width + step - 1) / step, -1);
    // Points of the last views first: what they have seen needs no new point.
    std::vector<int> known;
    for (const SeenView& seen : recent) {
      for (const int point : seen.at) {
        if (point >= 0) known.push_back(point);
      }
    }
    std::sort(known.begin(), known.end());
    known.erase(std::unique(known.begin(), known.end()), known.end());
    for (const int point : known) {
      double difference = 0;
      if (observe(current, point, difference)) differences[static_cast<size_t>(point)] += difference;
    }
    for (int square_y = 0; square_y < current.at.rows; ++square_y) {
      for (int square_x = 0; square_x < current.at.cols; ++square_x) {
        if (current.at(square_y, square_x) >= 0) continue;
        const int x = std::min(square_x * step + step / 2, view.camera.width - 1);
        const int y = std::min(square_y * step + step / 2, view.camera.height - 1);
        const float disparity = view.disparity.at(y, x, DisparityOrigin::corrected);
        if (disparity <= 0 || disparity + view.camera.disparity_offset <= 0) continue;
        const int index = static_cast<int>(points.size());
        points.push_back({.position = view.world_from_cam * view.camera.point(x, y, disparity),
                          .colour = colour_at(view.image, y, x),
                          .observations = {{i, static_cast<double>(x), static_cast<double>(y)}}});
        differences.push_back(0);
        current.at(square_y, square_x) = index;
        for (SeenView& seen : recent) {
          double difference = 0;
          if (observe(seen, index, difference)) differences.back() += difference;
        }
      }
    }
    recent.push_back(std::move(current));
    if (recent.size() > kNeighbours) recent.pop_front();
  }
  for (size_t p = 0; p < points.size(); ++p) {
    points[p].error = differences[p] / static_cast<double>(points[p].observations.size());
  }
  return points;
}

void write_colmap(const fs::path& folder, const views::ViewStore& views, const pipeline::RunControl& control) {
  begin_folder(folder);
  const std::vector<views::ViewSummary>& summaries = views.summaries();
  IRIS_CHECK(!summaries.empty());
  const RectifiedCamera& camera = summaries.front().camera;
  const std::vector<ScenePoint> points = scene_points(views);

  const fs::path model = folder / "sparse/0";
  write_file(model / "cameras.txt",
             fmt::format("# Camera list with one line of data per camera:\n"
                         "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
                         "# Number of cameras: 1\n"
                         "1 PINHOLE {} {} {} {} {} {}\n",
                         camera.width, camera.height, camera.f, camera.f, camera.cx + kCorner, camera.cy + kCorner));

  // Of each image: its observations, and of each point: where it stands in their list.
  std::vector<std::string> observed(summaries.size());
  std::vector<int> counts(summaries.size(), 0);
  size_t all = 0;
  std::string text =
      "# 3D point list with one line of data per point:\n"
      "#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n";
  std::string lines;
  for (size_t p = 0; p < points.size(); ++p) {
    const ScenePoint& point = points[p];
    lines += fmt::format("{} {} {} {} {} {} {} {}", p + 1, point.position.x(), point.position.y(), point.position.z(),
                         point.colour[2], point.colour[1], point.colour[0], point.error);
    for (const ScenePoint::Observation& observation : point.observations) {
      const auto v = static_cast<size_t>(observation.view_idx);
      lines += fmt::format(" {} {}", v + 1, counts[v]++);
      observed[v] += fmt::format("{}{:.4f} {:.4f} {}", observed[v].empty() ? "" : " ", observation.x + kCorner,
                                 observation.y + kCorner, p + 1);
      ++all;
    }
    lines += "\n";
  }
  const auto mean = [&](size_t count) {
    return count == 0 ? 0.0 : static_cast<double>(all) / static_cast<double>(count);
  };
  write_file(model / "points3D.txt",
             text + fmt::format("# Number of points: {}, mean track length: {}\n", points.size(), mean(points.size())) +
                 lines);

  lines.clear();
  Progress progress(control.progress, "colmap", static_cast<int64_t>(summaries.size()));
  for (size_t i = 0; i < summaries.size(); ++i) {
    if (control.stopped()) throw Interrupted();
    const Pose cam_from_world = summaries[i].world_from_cam.inverse();
    const Eigen::Quaterniond q(cam_from_world.linear());
    const Vector3d t = cam_from_world.translation();
    lines += fmt::format("{} {} {} {} {} {} {} {} 1 {}\n{}\n", i + 1, q.w(), q.x(), q.y(), q.z(), t.x(), t.y(), t.z(),
                         image_name(summaries[i]), observed[i]);
    write_file(folder / "images" / image_name(summaries[i]),
               workspace::encode_png(views.load(static_cast<int>(i))->image));
    progress.update(static_cast<int64_t>(i) + 1);
  }
  write_file(model / "images.txt", fmt::format("# Image list with two lines of data per image:\n"
                                               "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"
                                               "#   POINTS2D[] as (X, Y, POINT3D_ID)\n"
                                               "# Number of images: {}, mean observations per image: {}\n",
                                               summaries.size(), mean(summaries.size())) +
                                       lines);
}

void write_nerfstudio(const fs::path& folder, const views::ViewStore& views, const pipeline::RunControl& control) {
  begin_folder(folder);
  const std::vector<views::ViewSummary>& summaries = views.summaries();
  IRIS_CHECK(!summaries.empty());
  const RectifiedCamera& camera = summaries.front().camera;
  json frames = json::array();
  Progress progress(control.progress, "nerfstudio", static_cast<int64_t>(summaries.size()));
  for (size_t i = 0; i < summaries.size(); ++i) {
    if (control.stopped()) throw Interrupted();
    const auto view = views.load(static_cast<int>(i));
    const std::string name = image_name(summaries[i]);
    write_file(folder / "images" / name, workspace::encode_png(view->image));
    cv::Mat1f depth(view->disparity.disparity.size(), 0.0f);
    for (int y = 0; y < depth.rows; ++y) {
      for (int x = 0; x < depth.cols; ++x) {
        const double d = view->disparity.disparity(y, x) + camera.disparity_offset;
        if (view->disparity.disparity(y, x) > 0 && d > 0) {
          depth(y, x) = static_cast<float>(camera.f * camera.baseline / d);
        }
      }
    }
    write_file(folder / "depth" / name, encode_depth_png(depth));
    // y up and looking along -z.
    Eigen::Matrix4d matrix = summaries[i].world_from_cam.matrix();
    matrix.block<3, 2>(0, 1) *= -1;
    json rows = json::array();
    for (int row = 0; row < 4; ++row) {
      rows.push_back({matrix(row, 0), matrix(row, 1), matrix(row, 2), matrix(row, 3)});
    }
    frames.push_back(
        {{"file_path", "images/" + name}, {"depth_file_path", "depth/" + name}, {"transform_matrix", rows}});
    progress.update(static_cast<int64_t>(i) + 1);
  }
  write_ply(folder / "sparse_pc.ply", scene_points(views));
  const json content = {{"camera_model", "OPENCV"},
                        {"fl_x", camera.f},
                        {"fl_y", camera.f},
                        {"cx", camera.cx + kCorner},
                        {"cy", camera.cy + kCorner},
                        {"w", camera.width},
                        {"h", camera.height},
                        {"k1", 0},
                        {"k2", 0},
                        {"p1", 0},
                        {"p2", 0},
                        {"ply_file_path", "sparse_pc.ply"},
                        {"frames", frames}};
  write_file(folder / "transforms.json", content.dump(1) + "\n");
}

std::vector<pipeline::Stage> view_export_stages() {
  using pipeline::RunControl;
  using workspace::Poses;
  using workspace::Workspace;
  const auto stage = [](const char* name, void (*write)(const fs::path&, const views::ViewStore&, const RunControl&)) {
    return pipeline::Stage{.name = name,
                           .sections = {},
                           .after = {"loop"},
                           .inputs = {},
                           .run = [name, write](Workspace& w, const RunControl& control, const std::string&) {
                             const auto views = w.views(
                                 Poses::refined, pipeline::summarise_frames(w, Poses::refined).largest_submap, 0);
                             write(w.folder() / name, *views, control);
                             return files_below(w.folder(), name);
                           }};
  };
  return {stage("colmap", write_colmap), stage("nerfstudio", write_nerfstudio)};
}

}  // namespace iris::exporters
