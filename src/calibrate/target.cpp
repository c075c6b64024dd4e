#include "iris/calibrate/target.h"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <cstdlib>
#include <string_view>

#include "iris/core/error.h"

namespace iris::calibrate {
namespace {

constexpr const char* kForms =
    "squares:7x5:20mm[:GAP], chessboard:9x6:25mm (inner corners), charuco:10x7:30mm:22.5mm[:4X4_50] (squares), "
    "aprilgrid:6x6:88mm:0.3 (spacing = gap / tag)";

[[noreturn]] void fail(const std::string& text, const std::string& problem) {
  throw UsageError(fmt::format("--target {}: {}; understood are {}", text, problem, kForms));
}

std::vector<std::string> split(const std::string& text, char separator) {
  std::vector<std::string> parts(1);
  for (const char c : text) {
    if (c == separator) {
      parts.emplace_back();
    } else {
      parts.back() += c;
    }
  }
  return parts;
}

double number(const std::string& part, std::string& rest) {
  char* end = nullptr;
  const double value = std::strtod(part.c_str(), &end);
  rest = end;
  return end == part.c_str() ? std::nan("") : value;
}

double length(const std::string& text, const std::string& part, const char* what) {
  std::string unit;
  double value = number(part, unit);
  if (unit == "mm") {
    value /= 1000;
  } else if (unit == "cm") {
    value /= 100;
  } else if (!unit.empty() && unit != "m") {
    fail(text, fmt::format("'{}' is no length ({})", part, what));
  }
  if (!(value > 0) || value > 10)
    fail(text, fmt::format("{} of '{}' cannot be; lengths are metres unless they say mm or cm", what, part));
  return value;
}

int count(const std::string& text, const std::string& part, int least) {
  std::string rest;
  const double value = number(part, rest);
  if (!rest.empty() || !(value >= least) || value > 100 || value != std::floor(value)) {
    fail(text, fmt::format("'{}' is no number of columns or rows ({} to 100)", part, least));
  }
  return static_cast<int>(value);
}

}  // namespace

Target parse_target(const std::string& text) {
  const std::vector<std::string> parts = split(text, ':');
  Target target;
  size_t least = 3, most = 3;
  int least_count = 2;
  if (parts[0] == "squares") {
    target.kind = TargetKind::squares;
    most = 4;
  } else if (parts[0] == "chessboard") {
    target.kind = TargetKind::chessboard;
    least_count = 3;
  } else if (parts[0] == "charuco") {
    target.kind = TargetKind::charuco;
    least = 4;
    most = 5;
    least_count = 3;
  } else if (parts[0] == "aprilgrid") {
    target.kind = TargetKind::aprilgrid;
    least = most = 4;
  } else {
    fail(text, fmt::format("'{}' is no kind of target", parts[0]));
  }
  if (parts.size() < least || parts.size() > most) fail(text, "has the wrong number of parts");
  const std::vector<std::string> counts = split(parts[1], 'x');
  if (counts.size() != 2) fail(text, fmt::format("'{}' is not COLUMNSxROWS", parts[1]));
  target.columns = count(text, counts[0], least_count);
  target.rows = count(text, counts[1], least_count);
  target.size = length(text, parts[2], "the size");
  switch (target.kind) {
    case TargetKind::squares:
      target.gap = parts.size() == 4 ? length(text, parts[3], "the gap") : target.size;
      break;
    case TargetKind::chessboard:
      break;
    case TargetKind::charuco:
      target.marker = length(text, parts[3], "the marker's size");
      if (target.marker >= target.size) fail(text, "the markers are not smaller than the squares");
      target.dictionary = parts.size() == 5 ? parts[4] : "4X4_50";
      break;
    case TargetKind::aprilgrid: {
      std::string rest;
      const double spacing = number(parts[3], rest);
      if (!rest.empty() || !(spacing > 0 && spacing < 5)) {
        fail(text, fmt::format("'{}' is no spacing (gap / edge of a tag, without unit)", parts[3]));
      }
      target.gap = spacing * target.size;
      break;
    }
  }
  return target;
}

std::string to_text(const Target& target) {
  const std::string grid = fmt::format("{} x {}", target.columns, target.rows);
  const double mm = 1000 * target.size;
  switch (target.kind) {
    case TargetKind::squares:
      return fmt::format("grid of {} squares of {:g} mm, {:g} mm apart", grid, mm, 1000 * target.gap);
    case TargetKind::chessboard:
      return fmt::format("chessboard with {} inner corners, {:g} mm", grid, mm);
    case TargetKind::charuco:
      return fmt::format("ChArUco board of {} squares of {:g} mm, markers {} of {:g} mm", grid, mm, target.dictionary,
                         1000 * target.marker);
    case TargetKind::aprilgrid:
      return fmt::format("aprilgrid of {} tags of {:g} mm, {:g} mm apart", grid, mm, 1000 * target.gap);
  }
  return {};
}

std::vector<Eigen::Vector3d> target_points(const Target& target) {
  std::vector<Eigen::Vector3d> points;
  if (target.kind == TargetKind::chessboard || target.kind == TargetKind::charuco) {
    const int inner = target.kind == TargetKind::charuco ? 1 : 0;
    for (int row = 0; row < target.rows - inner; ++row) {
      for (int column = 0; column < target.columns - inner; ++column) {
        points.emplace_back(column * target.size, row * target.size, 0);
      }
    }
    return points;
  }
  const double step = target.size + target.gap, edge = target.size;
  for (int row = 0; row < target.rows; ++row) {
    const double y = step * (target.kind == TargetKind::aprilgrid ? target.rows - 1 - row : row);
    for (int column = 0; column < target.columns; ++column) {
      const double x = step * column;
      points.emplace_back(x, y, 0);
      points.emplace_back(x + edge, y, 0);
      points.emplace_back(x + edge, y + edge, 0);
      points.emplace_back(x, y + edge, 0);
    }
  }
  return points;
}

std::vector<std::pair<int, int>> target_edges(const Target& target) {
  std::vector<std::pair<int, int>> edges;
  if (target.kind == TargetKind::chessboard || target.kind == TargetKind::charuco) {
    const int inner = target.kind == TargetKind::charuco ? 1 : 0;
    const int columns = target.columns - inner, rows = target.rows - inner;
    for (int row = 0; row < rows; ++row) {
      for (int column = 0; column < columns; ++column) {
        const int id = row * columns + column;
        if (column + 1 < columns) edges.emplace_back(id, id + 1);
        if (row + 1 < rows) edges.emplace_back(id, id + columns);
      }
    }
    return edges;
  }
  for (int first = 0; first < 4 * target.columns * target.rows; first += 4) {
    for (int k = 0; k < 4; ++k) edges.emplace_back(first + k, first + (k + 1) % 4);
  }
  return edges;
}

std::vector<std::vector<int>> target_symmetries(const Target& target) {
  const std::vector<Eigen::Vector3d> points = target_points(target);
  std::vector<std::vector<int>> symmetries(1);
  for (size_t i = 0; i < points.size(); ++i) symmetries[0].push_back(static_cast<int>(i));
  if (target.kind == TargetKind::charuco || target.kind == TargetKind::aprilgrid) return symmetries;
  // Turned about its middle by 90, 180 and 270 degrees, where that brings every corner onto a corner.
  const Eigen::Vector3d middle =
      (points.front() + (target.kind == TargetKind::squares ? points[points.size() - 2] : points.back())) / 2;
  for (int quarters = 1; quarters < 4; ++quarters) {
    std::vector<int> numbers;
    for (const Eigen::Vector3d& point : points) {
      Eigen::Vector3d p = point - middle;
      for (int q = 0; q < quarters; ++q) p = Eigen::Vector3d(-p.y(), p.x(), 0);
      p += middle;
      for (size_t i = 0; i < points.size(); ++i) {
        if ((points[i] - p).norm() < 1e-6 * target.size) numbers.push_back(static_cast<int>(i));
      }
    }
    if (numbers.size() == points.size()) symmetries.push_back(std::move(numbers));
  }
  return symmetries;
}

}  // namespace iris::calibrate
