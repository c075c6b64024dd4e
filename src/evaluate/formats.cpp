#include "iris/evaluate/formats.h"

#include <fmt/format.h>
#include <yaml-cpp/yaml.h>

#include <charconv>
#include <cmath>
#include <cstdio>

#include "iris/core/error.h"

namespace iris::evaluate {
namespace fs = std::filesystem;
namespace {

std::vector<std::string_view> words_of(std::string_view line) {
  std::vector<std::string_view> words;
  constexpr std::string_view kSeparators = " \t,;\r";
  for (size_t at = line.find_first_not_of(kSeparators); at != std::string_view::npos;) {
    const size_t end = std::min(line.find_first_of(kSeparators, at), line.size());
    words.push_back(line.substr(at, end - at));
    at = line.find_first_not_of(kSeparators, end);
  }
  return words;
}

// Calls visit(number of the line, its words) for each line with content.
template <class Visit>
void for_each_line(std::string_view text, const Visit& visit) {
  for (int line = 1; !text.empty(); ++line) {
    const std::string_view content = text.substr(0, text.find('\n'));
    text.remove_prefix(std::min(content.size() + 1, text.size()));
    const auto words = words_of(content);
    if (words.empty() || words.front().starts_with('#')) continue;
    if (!visit(line, words)) return;
  }
}

[[noreturn]] void fail(const fs::path& path, int line, const std::string& problem, const std::string& remedy) {
  throw InputError(path, fmt::format("line {}: {}", line, problem), remedy);
}

std::optional<double> number(std::string_view word) {
  double value = 0;
  if (word.starts_with('+')) word.remove_prefix(1);
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (error != std::errc() || end != word.data() + word.size()) return std::nullopt;
  return value;
}

double finite(std::string_view word, const fs::path& path, int line) {
  const auto value = number(word);
  if (!value) fail(path, line, fmt::format("'{}' is no number", word), "give a text file with numbers");
  if (!std::isfinite(*value))
    fail(path, line, fmt::format("'{}' is not finite", word), "remove poses that are unknown");
  return *value;
}

// Decimal seconds to nanoseconds without the rounding of a double; also plain nanoseconds.
int64_t stamp_ns(std::string_view word, const fs::path& path, int line) {
  const double value = finite(word, path, line);
  const bool negative = word.starts_with('-');
  const size_t point = word.find('.');
  const std::string_view whole =
      word.substr(negative, (point == std::string_view::npos ? word.size() : point) - negative);
  int64_t seconds = 0;
  const auto [end, error] = std::from_chars(whole.data(), whole.data() + whole.size(), seconds);
  if (error != std::errc() || end != whole.data() + whole.size() ||
      word.find_first_of("eE") != std::string_view::npos) {
    return static_cast<int64_t>(std::llround(value * 1e9));
  }
  constexpr int64_t kNanoseconds = 1'000'000'000'000'000;
  if (point == std::string_view::npos && seconds > kNanoseconds) return negative ? -seconds : seconds;
  if (seconds > kNanoseconds) fail(path, line, fmt::format("'{}' is no time in seconds", word), "give seconds");
  std::string fraction(point == std::string_view::npos ? "" : word.substr(point + 1, 9));
  fraction.resize(9, '0');
  const int64_t ns = seconds * 1'000'000'000 + std::stoll(fraction);
  return negative ? -ns : ns;
}

Pose pose_of(const std::vector<double>& v, const fs::path& path, int line) {
  Eigen::Quaterniond q(v[6], v[3], v[4], v[5]);
  if (std::abs(q.norm() - 1) > 0.01) {
    fail(path, line, fmt::format("the quaternion has length {:.3f}", q.norm()),
         "the columns must be: translation x y z, quaternion x y z w");
  }
  Pose pose = Pose::Identity();
  pose.linear() = q.normalized().toRotationMatrix();
  pose.translation() = Eigen::Vector3d(v[0], v[1], v[2]);
  return pose;
}

}  // namespace

Trajectory parse_tum(std::string_view text, const fs::path& path) {
  Trajectory trajectory;
  for_each_line(text, [&](int line, const std::vector<std::string_view>& words) {
    if (words.size() != 8) {
      fail(path, line, fmt::format("has {} columns instead of 8", words.size()),
           words.size() == 17 ? "EuRoC's state_groundtruth_estimate0 describes the body: write the poses of the left "
                                "camera (times T_BS) as 't tx ty tz qx qy qz qw'"
                              : "give a line 't tx ty tz qx qy qz qw' for each pose");
    }
    std::vector<double> values;
    for (size_t i = 1; i < words.size(); ++i) values.push_back(finite(words[i], path, line));
    const int64_t stamp = stamp_ns(words[0], path, line);
    if (!trajectory.empty() && stamp <= trajectory.back().stamp_ns) {
      fail(path, line, "the time is not later than that of the line before",
           "sort the lines by time, one for each time");
    }
    trajectory.push_back({stamp, pose_of(values, path, line)});
    return true;
  });
  if (trajectory.empty()) throw InputError(path, "holds no pose", "give a file with a line for each pose");
  return trajectory;
}

std::vector<std::optional<Pose>> parse_kitti(std::string_view text, const fs::path& path) {
  std::vector<std::optional<Pose>> poses;
  bool any = false;
  for_each_line(text, [&](int line, const std::vector<std::string_view>& words) {
    if (words.size() != 12) {
      fail(path, line, fmt::format("has {} columns instead of 12", words.size()),
           "give the 12 numbers of the 3x4 matrix for each frame");
    }
    if (std::all_of(words.begin(), words.end(), [](std::string_view word) { return word == "nan" || word == "NaN"; })) {
      poses.emplace_back();
      return true;
    }
    Pose pose = Pose::Identity();
    for (int i = 0; i < 12; ++i) pose(i / 4, i % 4) = finite(words[static_cast<size_t>(i)], path, line);
    const Eigen::Matrix3d rotation = nearest_rotation(pose.linear());
    if (!((rotation - pose.linear()).norm() < 0.01)) {
      fail(path, line, "the first three columns are no rotation", "give a row-major 3x4 matrix (R | t) for each frame");
    }
    pose.linear() = rotation;
    poses.emplace_back(pose);
    any = true;
    return true;
  });
  if (!any) throw InputError(path, "holds no pose", "give a file with a line for each frame");
  return poses;
}

bool is_kitti(std::string_view text) {
  bool kitti = false;
  for_each_line(text, [&](int, const std::vector<std::string_view>& words) {
    kitti = words.size() == 12;
    return false;
  });
  return kitti;
}

std::vector<GraphEdge> parse_g2o_edges(std::string_view text, const fs::path& path) {
  std::vector<GraphEdge> edges;
  for_each_line(text, [&](int line, const std::vector<std::string_view>& words) {
    if (words[0] != "EDGE_SE3:QUAT") return true;
    if (words.size() != 31) fail(path, line, "an edge needs 30 numbers", "write the file again");
    std::vector<double> v;
    for (size_t i = 1; i < words.size(); ++i) v.push_back(finite(words[i], path, line));
    constexpr double kMost = 2147483647;
    if (!(v[0] >= 0 && v[0] <= kMost && v[1] >= 0 && v[1] <= kMost)) {
      fail(path, line, "an edge must begin and end at frames", "write the file again");
    }
    GraphEdge edge{.i = static_cast<int>(v[0]), .j = static_cast<int>(v[1])};
    edge.i_from_j = pose_of({v.begin() + 2, v.begin() + 9}, path, line);
    auto value = v.begin() + 9;
    for (int row = 0; row < 6; ++row) {
      for (int column = row; column < 6; ++column, ++value) {
        edge.information(row, column) = edge.information(column, row) = *value;
      }
    }
    edges.push_back(edge);
    return true;
  });
  return edges;
}

RosMapHeader parse_ros_map(const std::string& text, const fs::path& path) {
  RosMapHeader header;
  try {
    const YAML::Node node = YAML::Load(text);
    header.image = node["image"].as<std::string>();
    header.resolution = node["resolution"].as<double>();
    const auto origin = node["origin"].as<std::vector<double>>();
    if (origin.size() < 2) throw InputError(path, "origin needs x, y and yaw", "give 'origin: [x, y, yaw]'");
    header.origin_x = origin[0];
    header.origin_y = origin[1];
    header.yaw = origin.size() > 2 ? origin[2] : 0;
    if (node["occupied_thresh"]) header.occupied_thresh = node["occupied_thresh"].as<double>();
    if (node["free_thresh"]) header.free_thresh = node["free_thresh"].as<double>();
    if (node["negate"])
      header.negate = node["negate"].as<std::string>() == "1" || node["negate"].as<std::string>() == "true";
  } catch (const YAML::Exception& error) {
    throw InputError(path, fmt::format("is no map of ROS ({})", error.what()),
                     "give a yaml file with image, resolution and origin");
  }
  if (!(header.resolution > 0) || !std::isfinite(header.resolution)) {
    throw InputError(path, "resolution must be above 0", "give the size of a cell in metres");
  }
  if (!std::isfinite(header.origin_x + header.origin_y + header.yaw)) {
    throw InputError(path, "origin is not finite", "give x, y [m] and yaw [rad]");
  }
  const std::string phrase = "between z = ";
  if (const size_t at = text.find(phrase); at != std::string::npos) {
    double bottom = 0, top = 0;
    if (std::sscanf(text.c_str() + at + phrase.size(), "%lf m and %lf m", &bottom, &top) == 2) {
      header.bottom = bottom;
      header.top = top;
    }
  }
  return header;
}

}  // namespace iris::evaluate
