#include "iris/tour/path_file.h"

#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"

namespace iris::tour {
namespace {

using nlohmann::json;

[[noreturn]] void fail(const std::filesystem::path& file, const std::string& problem) {
  throw InputError(file, problem, "write the path with nerfstudio's viewer, or see its camera_path.json for the keys");
}

double number(const std::filesystem::path& file, const json& from, const std::string& key, const std::string& where) {
  if (!from.contains(key)) fail(file, where + " has no \"" + key + "\"");
  const json& value = from[key];
  if (!value.is_number() || !std::isfinite(value.get<double>()))
    fail(file, where + ": \"" + key + "\" is not a number");
  return value.get<double>();
}

double positive(const std::filesystem::path& file, const json& from, const std::string& key, const std::string& where) {
  const double value = number(file, from, key, where);
  if (value <= 0) fail(file, where + ": \"" + key + "\" is not positive");
  return value;
}

Pose pose_of(const std::filesystem::path& file, const json& entry, const std::string& where) {
  if (!entry.is_object() || !entry.contains("camera_to_world")) fail(file, where + " has no \"camera_to_world\"");
  std::vector<double> values;  // 16 numbers, or four rows of four
  const auto take = [&](const json& value) {
    if (!value.is_number()) fail(file, where + ": camera_to_world holds something that is not a number");
    values.push_back(value.get<double>());
  };
  if (!entry["camera_to_world"].is_array()) fail(file, where + ": camera_to_world is not a list");
  for (const json& item : entry["camera_to_world"]) {
    if (item.is_array()) {
      for (const json& value : item) take(value);
    } else {
      take(item);
    }
  }
  if (values.size() != 16) {
    fail(file, where + ": camera_to_world has " + std::to_string(values.size()) + " numbers instead of 16");
  }
  const Eigen::Matrix4d matrix = Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(values.data());
  const Eigen::Matrix3d rotation = matrix.topLeftCorner<3, 3>();
  const bool rigid = matrix.allFinite() && (rotation * rotation.transpose()).isIdentity(1e-2) &&
                     rotation.determinant() > 0 && matrix.row(3).isApprox(Eigen::RowVector4d(0, 0, 0, 1), 1e-6);
  if (!rigid) fail(file, where + ": camera_to_world is not a rotation and a translation");
  Pose world_from_cam = Pose::Identity();
  world_from_cam.linear() = nearest_rotation(rotation) * Eigen::Vector3d(1, -1, -1).asDiagonal();
  world_from_cam.translation() = matrix.topRightCorner<3, 1>();
  return world_from_cam;
}

}  // namespace

CameraPathFile read_camera_path_file(const std::filesystem::path& file) {
  const json content = json::parse(read_file(file), nullptr, false);
  if (content.is_discarded() || !content.is_object()) fail(file, "is not a JSON object");
  if (!content.contains("camera_path") || !content["camera_path"].is_array() || content["camera_path"].empty()) {
    fail(file, "has no entries in \"camera_path\"");
  }
  const json& entries = content["camera_path"];
  // Sizes and durations that no video has would only fail later, and less clearly.
  const auto check_range = [&](const char* key, double low, double high) {
    if (!content.contains(key)) return;
    const double value = positive(file, content, key, "file");
    if (value < low || value > high)
      fail(file, fmt::format("\"{}\" is {}, not within {} to {}", key, value, low, high));
  };
  check_range("render_width", 16, 16384);
  check_range("render_height", 16, 16384);
  check_range("fps", 0.1, 240);
  check_range("seconds", 0.01, 86400);
  CameraPathFile result;
  if (content.contains("render_width"))
    result.width = static_cast<int>(positive(file, content, "render_width", "file"));
  if (content.contains("render_height"))
    result.height = static_cast<int>(positive(file, content, "render_height", "file"));
  if (content.contains("fps")) result.fps = positive(file, content, "fps", "file");
  if (content.contains("camera_type")) {
    if (content["camera_type"] == "equirectangular") {
      result.projection = Projection::equirectangular;
    } else if (content["camera_type"] != "perspective") {
      fail(file, "\"camera_type\" is neither perspective nor equirectangular");
    }
  }
  const double count = static_cast<double>(entries.size());
  double seconds = 0;
  if (content.contains("seconds")) {
    seconds = positive(file, content, "seconds", "file");
  } else if (result.fps > 0) {
    seconds = count / result.fps;
  } else {
    fail(file, "has neither \"seconds\" nor \"fps\"");
  }
  for (size_t i = 0; i < entries.size(); ++i) {
    const std::string where = "camera_path[" + std::to_string(i) + "]";
    CameraKeyframe keyframe{.t = static_cast<double>(i) * seconds / count,
                            .world_from_cam = pose_of(file, entries[i], where)};
    if (result.projection == Projection::pinhole) {
      const double fov = positive(file, entries[i], "fov", where);
      if (fov >= 180) fail(file, where + ": \"fov\" is not below 180 degrees");
      keyframe.fov = fov * std::numbers::pi / 180;
    }
    result.path.keyframes.push_back(keyframe);
  }
  return result;
}

}  // namespace iris::tour
