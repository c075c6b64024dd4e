#include "iris/tour/path_file.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"

namespace iris::tour {
namespace {

using nlohmann::json;

[[noreturn]] void fail(const std::filesystem::path& file, const std::string& problem) {
  throw InputError(file, problem, "'iris tour --help' shows what a camera path looks like");
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

constexpr double kDegrees = std::numbers::pi / 180;

Eigen::Vector3d vector_of(const std::filesystem::path& file, const json& entry, const std::string& key,
                          const std::string& where) {
  const json& value = entry[key];
  Eigen::Vector3d vector;
  if (!value.is_array() || value.size() != 3) fail(file, where + ": \"" + key + "\" is not [x, y, z]");
  for (int i = 0; i < 3; ++i) {
    if (!value[i].is_number()) fail(file, where + ": \"" + key + "\" holds something that is not a number");
    vector[i] = value[i].get<double>();
  }
  return vector;
}

Pose keyframe_pose(const std::filesystem::path& file, const json& entry, const std::string& where) {
  if (!entry.contains("position")) fail(file, where + " has no \"position\"");
  const Eigen::Vector3d position = vector_of(file, entry, "position", where);
  const bool angles = entry.contains("yaw") || entry.contains("pitch") || entry.contains("roll");
  if (entry.contains("look_at") + entry.contains("quaternion") + angles > 1) {
    fail(file, where + " has more than one of \"look_at\", \"quaternion\" and angles");
  }
  if (entry.contains("look_at")) {
    const Eigen::Vector3d direction = vector_of(file, entry, "look_at", where) - position;
    if (direction.norm() < 1e-9) fail(file, where + " looks at its own position");
    return looking(position, direction);
  }
  if (entry.contains("quaternion")) {
    const json& value = entry["quaternion"];
    if (!value.is_array() || value.size() != 4) fail(file, where + ": \"quaternion\" is not [x, y, z, w]");
    double q[4];
    for (int i = 0; i < 4; ++i) {
      if (!value[i].is_number()) fail(file, where + ": \"quaternion\" holds something that is not a number");
      q[i] = value[i].get<double>();
    }
    Eigen::Quaterniond rotation(q[3], q[0], q[1], q[2]);
    if (std::abs(rotation.norm() - 1) > 1e-2) fail(file, where + ": \"quaternion\" has not the length 1");
    Pose pose = Pose::Identity();
    pose.linear() = rotation.normalized().toRotationMatrix();
    pose.translation() = position;
    return pose;
  }
  const auto angle = [&](const char* key) {
    return entry.contains(key) ? number(file, entry, key, where) * kDegrees : 0.0;
  };
  const double yaw = angle("yaw"), pitch = angle("pitch");
  if (std::abs(pitch) > 89.9 * kDegrees) fail(file, where + ": \"pitch\" is not within -89.9 to 89.9");
  Pose pose = looking(position, {std::cos(pitch) * std::cos(yaw), std::cos(pitch) * std::sin(yaw), std::sin(pitch)});
  pose.linear() = pose.linear() * Eigen::AngleAxisd(angle("roll"), Eigen::Vector3d::UnitZ()).toRotationMatrix();
  return pose;
}

// Misspelt keys must not be ignored silently.
void check_keys(const std::filesystem::path& file, const json& object, const std::string& where,
                const std::vector<std::string>& known) {
  for (const auto& [key, value] : object.items()) {
    if (std::find(known.begin(), known.end(), key) == known.end()) {
      fail(file, fmt::format("{} has an unknown key \"{}\"; known are {}", where, key, fmt::join(known, ", ")));
    }
  }
}

// Sizes and durations that no video has would only fail later, and less clearly.
void check_range(const std::filesystem::path& file, const json& content, const char* key, double low, double high) {
  if (!content.contains(key)) return;
  const double value = positive(file, content, key, "file");
  if (value < low || value > high) fail(file, fmt::format("\"{}\" is {}, not within {} to {}", key, value, low, high));
}

CameraPathFile read_keyframes(const std::filesystem::path& file, const json& content, const TourOptions& options) {
  check_keys(file, content, "file",
             {"width", "height", "fps", "fov", "seconds", "interpolation", "ease", "keyframes", "comment"});
  check_range(file, content, "width", 16, 16384);
  check_range(file, content, "height", 16, 16384);
  check_range(file, content, "fps", 0.1, 240);
  check_range(file, content, "seconds", 0.01, 86400);
  check_range(file, content, "fov", 1, 170);
  CameraPathFile result;
  if (content.contains("width") != content.contains("height")) fail(file, "has only one of \"width\" and \"height\"");
  if (content.contains("width")) {
    result.width = static_cast<int>(number(file, content, "width", "file"));
    result.height = static_cast<int>(number(file, content, "height", "file"));
  }
  if (content.contains("fps")) result.fps = number(file, content, "fps", "file");
  const double fov = content.contains("fov") ? number(file, content, "fov", "file") : options.fov;
  result.path.ease = content.contains("ease") ? number(file, content, "ease", "file") : options.ease;
  if (result.path.ease < 0) fail(file, "\"ease\" is negative");
  result.path.interpolation = CameraPath::Interpolation::spline;
  if (content.contains("interpolation")) {
    if (content["interpolation"] == "linear") {
      result.path.interpolation = CameraPath::Interpolation::linear;
    } else if (content["interpolation"] != "spline") {
      fail(file, "\"interpolation\" is neither spline nor linear");
    }
  }
  const json& entries = content["keyframes"];
  if (!entries.is_array() || entries.empty()) fail(file, "has no entries in \"keyframes\"");
  size_t timed = 0;
  std::vector<CameraKeyframe>& keys = result.path.keyframes;
  std::vector<std::pair<size_t, std::string>> captions;
  for (size_t i = 0; i < entries.size(); ++i) {
    const json& entry = entries[i];
    const std::string where = fmt::format("keyframes[{}]", i);
    if (!entry.is_object()) fail(file, where + " is not an object");
    check_keys(file, entry, where,
               {"t", "position", "look_at", "yaw", "pitch", "roll", "quaternion", "fov", "caption"});
    CameraKeyframe key{.world_from_cam = keyframe_pose(file, entry, where)};
    key.fov = (entry.contains("fov") ? number(file, entry, "fov", where) : fov) * kDegrees;
    if (key.fov < kDegrees || key.fov > 170 * kDegrees) fail(file, where + ": \"fov\" is not within 1 to 170");
    if (entry.contains("t")) {
      key.t = number(file, entry, "t", where);
      ++timed;
    } else if (i > 0) {
      const Pose& last = keys.back().world_from_cam;
      key.t = keys.back().t +
              std::max({(key.world_from_cam.translation() - last.translation()).norm() / options.walk_speed,
                        rotation_angle(Eigen::Matrix3d(last.linear().transpose() * key.world_from_cam.linear())) /
                            (options.turn_rate * kDegrees),
                        1e-3});
    }
    if (timed > 0 && timed != i + 1) fail(file, "some keyframes have \"t\", others not");
    if (timed > 0 && i > 0 && key.t <= keys.back().t) fail(file, where + ": \"t\" does not ascend");
    if (entry.contains("caption")) {
      if (!entry["caption"].is_string()) fail(file, where + ": \"caption\" is not a text");
      captions.emplace_back(i, entry["caption"].get<std::string>());
    }
    keys.push_back(key);
  }
  const double length = keys.back().t - keys.front().t;
  double wanted = options.seconds;
  if (wanted <= 0 && timed == 0 && content.contains("seconds")) wanted = number(file, content, "seconds", "file");
  if (keys.size() > 1 && wanted > 0) {
    for (size_t i = keys.size(); i-- > 0;) keys[i].t = (keys[i].t - keys[0].t) / length * wanted;
  }
  if (keys.size() == 1 && wanted > 0) {
    // One look, held.
    keys.push_back(keys[0]);
    keys[1].t = keys[0].t + wanted;
  }
  for (const auto& [i, text] : captions) result.captions.push_back({keys[i].t, text});
  return result;
}

}  // namespace

CameraPathFile read_camera_path_file(const std::filesystem::path& file, const TourOptions& options) {
  const json content = json::parse(read_file(file), nullptr, false);
  if (content.is_discarded() || !content.is_object()) fail(file, "is not a JSON object");
  if (content.contains("keyframes") && !content.contains("camera_path")) return read_keyframes(file, content, options);
  if (!content.contains("camera_path") || !content["camera_path"].is_array() || content["camera_path"].empty()) {
    fail(file, "has no entries in \"keyframes\" or \"camera_path\"");
  }
  const json& entries = content["camera_path"];
  check_range(file, content, "render_width", 16, 16384);
  check_range(file, content, "render_height", 16, 16384);
  check_range(file, content, "fps", 0.1, 240);
  check_range(file, content, "seconds", 0.01, 86400);
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
  double seconds = options.seconds;
  if (seconds > 0) {
    // Given on the command line.
  } else if (content.contains("seconds")) {
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
