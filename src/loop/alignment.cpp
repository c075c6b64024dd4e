#include "iris/loop/alignment.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <map>
#include <optional>
#include <random>

#include "iris/core/error.h"
#include "iris/core/median.h"
#include "iris/core/parallel.h"
#include "iris/reconstruct/error_propagation.h"

namespace iris::loop {

void AlignmentOptions::declare(OptionSet& set) {
  set.section("loop");
  set.add("up", up, {},
          "what tells which way is up: floor = floors and ceilings that the views measured, else as path; path = the "
          "plane the camera moved in, else as first-camera; first-camera = as it was held; or the direction x,y,z of "
          "up in the first camera's frame (x right, y down, z forward)");
}

namespace {

constexpr double kDegree = M_PI / 180;
constexpr int kMaxViews = 150;
constexpr double kMaxTilt = 40 * kDegree;         // of horizontal surfaces against what the poses let expect
constexpr double kMaxNormalError = 25 * kDegree;  // of a small piece of surface

// A small piece of a surface.
struct Piece {
  Eigen::Vector3d point, normal;  // graph's world [m]; the normal points to the camera that saw it
  Eigen::Matrix3d covariance;     // of the point [m^2]
  double spread = 0;              // trace of it
};

// Planes appear in the disparity image as d = a x + b y + c: fitted to small windows of measured disparities.
std::vector<Piece> pieces_of(const StereoView& view, const Pose& world_from_cam) {
  constexpr int kHalf = 5, kStep = 12, kLeast = 80;  // of 121 pixels
  constexpr double kMaxRms = 0.4, kLeastDisparity = 3, kPixelError = 0.2;
  const RectifiedCamera& camera = view.camera;
  std::vector<Piece> pieces;
  for (int y = kHalf; y + kHalf < camera.height; y += kStep) {
    for (int x = kHalf; x + kHalf < camera.width; x += kStep) {
      Eigen::Matrix3d moments = Eigen::Matrix3d::Zero();
      Eigen::Vector3d right = Eigen::Vector3d::Zero();
      double squares = 0;
      for (int v = -kHalf; v <= kHalf; ++v) {
        for (int u = -kHalf; u <= kHalf; ++u) {
          const double d = view.disparity.at(y + v, x + u, DisparityOrigin::measured);
          if (d <= 0) continue;
          const Eigen::Vector3d row(u, v, 1);
          moments += row * row.transpose();
          right += d * row;
          squares += d * d;
        }
      }
      const double count = moments(2, 2);
      if (count < kLeast) continue;
      const Eigen::Vector3d plane = moments.ldlt().solve(right);
      const double rms = std::sqrt(std::max(0.0, (squares - plane.dot(right)) / count));
      const double d = plane.z() + camera.disparity_offset;
      if (rms > kMaxRms || plane.z() < kLeastDisparity || d < kLeastDisparity) continue;
      const Eigen::Vector3d point = camera.point(x, y, plane.z());
      Eigen::Vector3d normal(plane.x() * camera.f, plane.y() * camera.f,
                             d - plane.x() * (x - camera.cx) - plane.y() * (y - camera.cy));
      normal.normalize();
      if (normal.dot(point) > 0) normal = -normal;
      const Eigen::Matrix3d covariance = reconstruct::point_covariance(camera, point, kPixelError);
      pieces.push_back({world_from_cam * point, world_from_cam.linear() * normal,
                        world_from_cam.linear() * covariance * world_from_cam.linear().transpose(),
                        covariance.trace()});
    }
  }
  return pieces;
}

struct Surfaces {
  std::vector<Piece> pieces;  // one a cell of space: each stands for about the same area
  double cell = 0;            // [m]
  int views = 0;
};

Surfaces surfaces_of(const std::vector<PoseNode>& nodes, const std::vector<int>& view_frames,
                     const std::function<StereoView(int)>& view) {
  std::map<int, Pose> pose_of;
  for (const PoseNode& node : nodes) pose_of[node.frame_idx] = node.world_from_cam;
  const int count = static_cast<int>(view_frames.size()), chosen = std::min(count, kMaxViews);
  std::vector<std::vector<Piece>> pieces(static_cast<size_t>(chosen));
  parallel_chunks(0, chosen, 1, [&](int begin, int end) {
    for (int k = begin; k < end; ++k) {
      const int frame_idx = view_frames[static_cast<int64_t>(k) * count / chosen];
      const auto pose = pose_of.find(frame_idx);
      IRIS_CHECK(pose != pose_of.end());
      pieces[k] = pieces_of(view(frame_idx), pose->second);
    }
  });
  Surfaces surfaces{.views = chosen};
  std::vector<double> spreads;
  for (const auto& list : pieces) {
    for (const Piece& piece : list) spreads.push_back(piece.spread);
  }
  if (spreads.empty()) return surfaces;
  // Half of the pieces are more certain than a cell is wide.
  surfaces.cell = std::clamp(2 * std::sqrt(median(spreads)), 0.05, 1.0);
  std::map<std::array<int64_t, 3>, Piece> best;
  for (const auto& list : pieces) {
    for (const Piece& piece : list) {
      std::array<int64_t, 3> key;
      for (int k = 0; k < 3; ++k) key[k] = static_cast<int64_t>(std::floor(piece.point(k) / surfaces.cell));
      const auto [place, is_new] = best.try_emplace(key, piece);
      if (!is_new && piece.spread < place->second.spread) place->second = piece;
    }
  }
  for (const auto& [key, piece] : best) surfaces.pieces.push_back(piece);
  return surfaces;
}

// Standard deviation of a piece's height, with what poses and uneven ground add.
double height_sigma(const Piece& piece, const Eigen::Vector3d& up) {
  return std::sqrt(up.dot(piece.covariance * up) + 0.01 * 0.01);
}

bool along(const Eigen::Vector3d& normal, const Eigen::Vector3d& direction, double max_angle) {
  return normal.dot(direction) > std::cos(max_angle);
}

// The direction near `prior` across which the plane with most pieces lies; of floors or of ceilings.
std::optional<Eigen::Vector3d> dominant_direction(const Surfaces& surfaces, const Eigen::Vector3d& prior) {
  constexpr int kTrials = 600;
  std::vector<const Piece*> candidates[2];  // facing up, facing down
  for (const Piece& piece : surfaces.pieces) {
    if (along(piece.normal, prior, kMaxTilt + kMaxNormalError)) candidates[0].push_back(&piece);
    if (along(piece.normal, -prior, kMaxTilt + kMaxNormalError)) candidates[1].push_back(&piece);
  }
  std::mt19937 random(1);
  std::optional<Eigen::Vector3d> best;
  int most = 0;
  for (const int facing : {0, 1}) {
    const auto& list = candidates[facing];
    if (list.size() < 30) continue;
    for (int trial = 0; trial < kTrials; ++trial) {
      const Piece& a = *list[random() % list.size()];
      const Piece& b = *list[random() % list.size()];
      const Piece& c = *list[random() % list.size()];
      const Eigen::Vector3d across = (b.point - a.point).cross(c.point - a.point);
      if (across.norm() < 20 * surfaces.cell * surfaces.cell) continue;
      Eigen::Vector3d up = across.normalized();
      if (up.dot(prior) < 0) up = -up;
      if (!along(up, prior, kMaxTilt)) continue;
      const Eigen::Vector3d normal = facing == 0 ? up : -up;
      int count = 0;
      for (const Piece* piece : list) {
        const double distance = std::abs(up.dot(piece->point - a.point));
        if (distance < 0.02 + 2 * height_sigma(*piece, up) && along(piece->normal, normal, kMaxNormalError)) ++count;
      }
      if (count > most) {
        most = count;
        best = up;
      }
    }
  }
  return best;
}

// Parallel planes across `up`.
struct Level {
  double height = 0;  // [m] up . point
  bool faces_up = true;
  double count = 0;  // pieces, hence area in cells
  double rms = 0;    // [m]
};

// The heights at which most pieces lie.
std::vector<Level> levels_of(const Surfaces& surfaces, const Eigen::Vector3d& up) {
  constexpr double kBin = 0.04;
  constexpr double kLeastPart = 0.2;  // of the largest one that faces the same way
  std::vector<Level> levels;
  for (const bool faces_up : {true, false}) {
    double most = 0;
    std::map<int, double> bins;  // triangular weights over three bins
    for (const Piece& piece : surfaces.pieces) {
      if (!along(piece.normal, faces_up ? up : -up, kMaxNormalError)) continue;
      const int bin = static_cast<int>(std::floor(up.dot(piece.point) / kBin));
      for (const int k : {-1, 0, 1}) bins[bin + k] += k == 0 ? 1 : 0.5;
    }
    for (const auto& [bin, count] : bins) {
      bool is_peak = true;
      for (const int k : {-3, -2, -1, 1, 2, 3}) {
        const auto other = bins.find(bin + k);
        if (other == bins.end()) continue;
        is_peak = is_peak && (other->second < count || (other->second == count && k > 0));
      }
      if (!is_peak) continue;
      levels.push_back({.height = (bin + 0.5) * kBin, .faces_up = faces_up, .count = count});
      most = std::max(most, count);
    }
    std::erase_if(levels,
                  [&](const Level& level) { return level.faces_up == faces_up && level.count < kLeastPart * most; });
  }
  return levels;
}

struct Horizontal {
  Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
  std::vector<Level> levels;
  double sigma = M_PI;  // [rad] of up
};

// Two directions across a unit vector.
Eigen::Matrix<double, 3, 2> tangents_of(const Eigen::Vector3d& up) {
  Eigen::Matrix<double, 3, 2> tangents;
  tangents.col(0) = up.unitOrthogonal();
  tangents.col(1) = up.cross(tangents.col(0));
  return tangents;
}

// The direction across all levels at once, each with its own height; errors are Gaussian near a level and anything
// beyond (Cauchy).
Horizontal refined(const Surfaces& surfaces, Eigen::Vector3d up) {
  Horizontal result;
  for (int iteration = 0; iteration < 12; ++iteration) {
    if (iteration % 4 == 0) result.levels = levels_of(surfaces, up);
    const int count = static_cast<int>(result.levels.size());
    if (count == 0) return result;
    const Eigen::Matrix<double, 3, 2> tangents = tangents_of(up);
    Eigen::MatrixXd hessian = Eigen::MatrixXd::Zero(count + 2, count + 2);
    Eigen::VectorXd gradient = Eigen::VectorXd::Zero(count + 2);
    double squares = 0;
    for (Level& level : result.levels) level.count = level.rms = 0;
    for (const Piece& piece : surfaces.pieces) {
      const double height = up.dot(piece.point);
      int nearest = -1;
      for (int k = 0; k < count; ++k) {
        if (!along(piece.normal, result.levels[k].faces_up ? up : -up, kMaxNormalError)) continue;
        if (nearest < 0 ||
            std::abs(height - result.levels[k].height) < std::abs(height - result.levels[nearest].height)) {
          nearest = k;
        }
      }
      if (nearest < 0) continue;
      Level& level = result.levels[nearest];
      const double residual = height - level.height, sigma = height_sigma(piece, up);
      if (std::abs(residual) > 0.04 + 3 * sigma) continue;
      const double weight = 1 / (sigma * sigma + residual * residual);
      Eigen::VectorXd row = Eigen::VectorXd::Zero(count + 2);
      row.head<2>() = tangents.transpose() * piece.point;
      row(2 + nearest) = -1;
      hessian += weight * row * row.transpose();
      gradient += weight * residual * row;
      squares += weight * residual * residual;
      level.count += 1;
      level.rms += residual * residual;
    }
    for (Level& level : result.levels) level.rms = std::sqrt(level.rms / std::max(1.0, level.count));
    const Eigen::LDLT<Eigen::MatrixXd> solver(hessian);
    if (solver.info() != Eigen::Success || !solver.isPositive()) return result;
    const Eigen::VectorXd step = solver.solve(-gradient);
    up = (up + tangents * step.head<2>()).normalized();
    for (int k = 0; k < count; ++k) result.levels[k].height += step(2 + k);
    const Eigen::MatrixXd inverse = solver.solve(Eigen::MatrixXd::Identity(count + 2, count + 2));
    // Errors of neighbouring pieces go together: as if only every tenth were independent.
    result.sigma = std::sqrt(10 * inverse.topLeftCorner<2, 2>().trace());
  }
  result.up = up;
  return result;
}

struct PathPlane {
  std::optional<Eigen::Vector3d> normal;
  double off = 0;       // [m] root mean square distance from it
  std::string problem;  // why there is none
};

// Across the path, and upwards: towards `prior`, the cameras' own upright, or, if they look down, against their viewing
// direction.
PathPlane path_plane(const std::vector<PoseNode>& nodes, const Eigen::Vector3d& prior, bool trust_prior) {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero(), mean_view = Eigen::Vector3d::Zero();
  for (const PoseNode& node : nodes) mean_view += node.world_from_cam.linear().col(2) / double(nodes.size());
  for (const PoseNode& node : nodes) mean += node.world_from_cam.translation() / static_cast<double>(nodes.size());
  Eigen::Matrix3d moments = Eigen::Matrix3d::Zero();
  for (const PoseNode& node : nodes) {
    const Eigen::Vector3d from_mean = node.world_from_cam.translation() - mean;
    moments += from_mean * from_mean.transpose() / static_cast<double>(nodes.size());
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> axes(moments);
  const Eigen::Vector3d extent = axes.eigenvalues().cwiseMax(0).cwiseSqrt();  // ascending
  PathPlane plane{.off = extent(0)};
  Eigen::Vector3d normal = axes.eigenvectors().col(0);
  const bool looks_along = std::abs(normal.dot(prior)) < 0.5 && std::abs(normal.dot(mean_view)) > 0.8;
  if ((looks_along ? -normal.dot(mean_view) : normal.dot(prior)) < 0) normal = -normal;
  if (extent(2) < 0.05 || extent(1) < 0.1 * extent(2)) {
    plane.problem = "the path is too straight to tell a plane";
  } else if (extent(0) > 0.15 * extent(1)) {
    plane.problem = "the path does not lie in a plane";
  } else if (trust_prior && !looks_along && !along(normal, prior, 30 * kDegree)) {
    plane.problem = "the plane of the path is not across the cameras' upright";
  } else {
    plane.normal = normal;
  }
  return plane;
}

// World with `up` as z; see Alignment.
Alignment upright(const PoseNode& first, const Eigen::Vector3d& up, std::string used) {
  const Pose& camera = first.world_from_cam;
  Eigen::Vector3d ahead = camera.linear().col(2) - up * up.dot(camera.linear().col(2));
  if (ahead.norm() < 0.1) {  // it looks straight up or down: what is the picture's upper edge is ahead
    const double sign = up.dot(camera.linear().col(2)) > 0 ? 1 : -1;
    ahead = sign * (camera.linear().col(1) - up * up.dot(camera.linear().col(1)));
  }
  ahead.normalize();
  Alignment alignment;
  alignment.world_from_graph.linear() << ahead.transpose(), up.cross(ahead).transpose(), up.transpose();
  alignment.world_from_graph.translation() = -(alignment.world_from_graph.linear() * camera.translation());
  alignment.tilt = std::acos(std::clamp(-up.dot(camera.linear().col(1)), -1.0, 1.0));
  alignment.used = std::move(used);
  return alignment;
}

std::optional<Eigen::Vector3d> direction_in(const std::string& text) {
  Eigen::Vector3d direction;
  const char* at = text.c_str();
  for (int k = 0; k < 3; ++k) {
    char* end = nullptr;
    direction(k) = std::strtod(at, &end);
    if (end == at || *end != (k < 2 ? ',' : '\0')) return std::nullopt;
    at = end + 1;
  }
  if (!direction.allFinite() || direction.norm() < 1e-6) return std::nullopt;
  return direction.normalized();
}

// Upright by the floor or a ceiling, or the reason why not.
std::optional<Alignment> by_surfaces(const std::vector<PoseNode>& nodes, const Surfaces& surfaces,
                                     const Eigen::Vector3d& prior, std::string& problem) {
  constexpr double kMaxSigma = 0.7 * kDegree;
  constexpr double kLeastPieces = 60, kLeastArea = 0.5;     // [m^2]
  constexpr double kLeastOther = 2.0, kMaxOtherRms = 0.04;  // [m^2], [m]
  const std::optional<Eigen::Vector3d> rough = dominant_direction(surfaces, prior);
  if (!rough) {
    problem = "no horizontal surface was seen";
    return std::nullopt;
  }
  const Horizontal horizontal = refined(surfaces, *rough);
  const Eigen::Vector3d& up = horizontal.up;
  const Level* largest = nullptr;
  double most_facing_up = 0;
  for (const Level& level : horizontal.levels) {
    if (!largest || level.count > largest->count) largest = &level;
    if (level.faces_up) most_facing_up = std::max(most_facing_up, level.count);
  }
  const double area_of_piece = surfaces.cell * surfaces.cell;
  const auto is_large = [&](const Level& level) {
    return level.count >= kLeastPieces && level.count * area_of_piece >= kLeastArea;
  };
  if (!largest || !is_large(*largest) || horizontal.sigma > kMaxSigma || !along(up, prior, kMaxTilt)) {
    problem = "the horizontal surfaces that were seen are too small";
    return std::nullopt;
  }
  // The floor: the lowest large level, below the cameras, with next to nothing underneath.
  const Level* floor = nullptr;
  for (const Level& level : horizontal.levels) {
    const bool candidate = level.faces_up && is_large(level) && level.count > 0.25 * most_facing_up;
    if (candidate && (!floor || level.height < floor->height)) floor = &level;
  }
  if (floor) {
    int above = 0, underneath = 0;
    for (const PoseNode& node : nodes) above += up.dot(node.world_from_cam.translation()) > floor->height + 0.02;
    for (const Piece& piece : surfaces.pieces) {
      const double height = up.dot(piece.point) - floor->height;
      underneath += height < -0.1 - 4 * height_sigma(piece, up);
    }
    if (above < 0.9 * static_cast<double>(nodes.size()) || underneath > 0.2 * floor->count) floor = nullptr;
  }
  // A single surface that need not be a floor might be anything that slants: it must be large and even.
  if (!floor && (largest->count * area_of_piece < kLeastOther || largest->rms > kMaxOtherRms)) {
    problem = "no floor was seen, and no other large horizontal surface";
    return std::nullopt;
  }
  const Level& level = floor ? *floor : *largest;
  Alignment alignment = upright(nodes.front(), up, "");
  alignment.used =
      fmt::format("{}: {:.3g} m2 seen in {} views, tilt of the first camera {:.1f} deg, residual {:.0f} mm",
                  floor ? "floor" : (level.faces_up ? "horizontal surface" : "ceiling"), level.count * area_of_piece,
                  surfaces.views, alignment.tilt / kDegree, 1000 * level.rms);
  if (floor) {
    alignment.floor_found = true;
    alignment.camera_height = up.dot(nodes.front().world_from_cam.translation()) - floor->height;
    alignment.world_from_graph.translation().z() += alignment.camera_height;
  } else {
    alignment.used += "; no floor was seen";
  }
  return alignment;
}

}  // namespace

void check(const AlignmentOptions& options) {
  if (options.up == "floor" || options.up == "path" || options.up == "first-camera" || direction_in(options.up)) return;
  throw UsageError("--up " + options.up +
                   ": must be floor, path, first-camera or a direction x,y,z in the first camera's frame");
}

Alignment align(const std::vector<PoseNode>& nodes, const std::vector<int>& view_frames,
                const std::function<StereoView(int)>& view, const AlignmentOptions& options) {
  IRIS_CHECK(!nodes.empty());
  check(options);
  const PoseNode& first = nodes.front();
  const auto describe = [&](const Eigen::Vector3d& up, const std::string& rule) {
    Alignment alignment = upright(first, up, "");
    alignment.used = fmt::format("{}, tilt of the first camera {:.1f} deg", rule, alignment.tilt / kDegree);
    alignment.guessed = options.up == "floor";
    return alignment;
  };
  const Eigen::Vector3d first_up = -first.world_from_cam.linear().col(1);
  if (options.up != "floor" && options.up != "path" && options.up != "first-camera") {
    return describe(first.world_from_cam.linear() * *direction_in(options.up), "given direction");
  }
  if (options.up == "first-camera") return describe(first_up, "first camera");

  // Cameras are held upright on average, unless they turn about their axis or look down.
  Eigen::Vector3d mean_up = Eigen::Vector3d::Zero();
  for (const PoseNode& node : nodes) mean_up -= node.world_from_cam.linear().col(1) / double(nodes.size());
  const bool upright_on_average = mean_up.norm() > 0.8;
  const Eigen::Vector3d prior = upright_on_average ? mean_up.normalized() : first_up;
  const PathPlane path = path_plane(nodes, prior, upright_on_average);
  std::string problem;
  if (options.up == "floor") {
    const Surfaces surfaces = surfaces_of(nodes, view_frames, view);
    if (auto found = by_surfaces(nodes, surfaces, prior, problem)) return *found;
    if (path.normal && !along(*path.normal, prior, kMaxTilt)) {
      if (auto found = by_surfaces(nodes, surfaces, *path.normal, problem)) return *found;
    }
    problem += "; ";
  }
  if (path.normal) {
    return describe(*path.normal,
                    fmt::format("{}plane of the path, left by {:.0f} mm on average", problem, 1000 * path.off));
  }
  return describe(first_up, fmt::format("{}{}; first camera", problem, path.problem));
}

}  // namespace iris::loop
