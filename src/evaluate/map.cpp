#include "iris/evaluate/map.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "iris/core/error.h"
#include "iris/simulate/floor_plan.h"

namespace iris::evaluate {
namespace {

// 255 where a cell is of one of the kinds.
cv::Mat1b mask_of(const GridMap& map, Cell kind) { return cv::Mat1b(map.cells == static_cast<uint8_t>(kind)); }

// Cells within `tolerance` cells of a set one, also beyond the border of the map.
class Near {
 public:
  Near(const cv::Mat1b& mask, int tolerance) : margin_(tolerance) {
    cv::copyMakeBorder(mask, wide_, margin_, margin_, margin_, margin_, cv::BORDER_CONSTANT, cv::Scalar::all(0));
    if (tolerance == 0) return;
    const int size = 2 * tolerance + 1;
    cv::dilate(wide_, wide_, cv::getStructuringElement(cv::MORPH_RECT, {size, size}), cv::Point(-1, -1), 1,
               cv::BORDER_CONSTANT, cv::Scalar::all(0));
  }
  bool operator()(cv::Point cell) const {
    const cv::Point there = cell + cv::Point(margin_, margin_);
    return cv::Rect(0, 0, wide_.cols, wide_.rows).contains(there) && wide_(there) != 0;
  }

 private:
  int margin_;
  cv::Mat1b wide_;
};

// Rigid motion in the plane.
struct PlaneMotion {
  Eigen::Rotation2Dd turn;
  Eigen::Vector2d shift;
  explicit PlaneMotion(const Pose& pose)
      // The turn about z that is nearest to the rotation.
      : turn(std::atan2(pose.linear()(1, 0) - pose.linear()(0, 1), pose.linear()(0, 0) + pose.linear()(1, 1))),
        shift(pose.translation().head<2>()) {}
  Eigen::Vector2d operator()(const Eigen::Vector2d& p) const { return turn * p + shift; }
  Eigen::Vector2d inverse(const Eigen::Vector2d& p) const { return turn.inverse() * (p - shift); }
};

template <class Visit>
void for_each_cell(const GridMap& map, Cell kind, const Visit& visit) {
  for (int y = 0; y < map.cells.rows; ++y) {
    for (int x = 0; x < map.cells.cols; ++x) {
      if (map.cells(y, x) == static_cast<uint8_t>(kind)) visit(cv::Point(x, y));
    }
  }
}

// The true cell of an estimated one and back.
struct Registered {
  Registered(const GridMap& estimate_map, const GridMap& truth_map, const Pose& truth_from_estimate)
      : estimate(estimate_map), truth(truth_map), motion(truth_from_estimate) {}
  cv::Point to_truth(cv::Point cell) const {
    const Eigen::Vector2d p = motion(estimate.centre_of(cell));
    return truth.cell_of(p.x(), p.y());
  }
  cv::Point to_estimate(cv::Point cell) const {
    const Eigen::Vector2d p = motion.inverse(truth.centre_of(cell));
    return estimate.cell_of(p.x(), p.y());
  }
  // Cells of the estimate that the tolerance covers.
  int estimate_tolerance(int tolerance) const {
    return static_cast<int>(std::lround(tolerance * truth.resolution / estimate.resolution));
  }
  const GridMap &estimate, &truth;
  PlaneMotion motion;
};

double percent(int64_t part, int64_t whole) {
  return whole > 0 ? 100.0 * static_cast<double>(part) / static_cast<double>(whole)
                   : std::numeric_limits<double>::quiet_NaN();
}

MapErrors::Thickness thickness_of(std::vector<int> cells) {
  MapErrors::Thickness result{.faces = static_cast<int64_t>(cells.size())};
  if (cells.empty()) return result;
  std::sort(cells.begin(), cells.end());
  const auto count = static_cast<double>(cells.size());
  const auto at = [&](double share) { return cells[static_cast<size_t>(std::ceil(share * count)) - 1]; };
  result.mean = std::accumulate(cells.begin(), cells.end(), 0.0) / count;
  result.median = at(0.5);
  result.most = at(0.95);
  return result;
}

// Whether the face of a cell belongs to a straight wall before which nothing stands.
bool is_bare_wall(const GridMap& truth, cv::Point cell, cv::Point out) {
  int deep = 1;
  while (deep <= MapErrors::kThin && truth.at(cell - deep * out) == Cell::occupied) ++deep;
  if (deep > MapErrors::kThin) return false;
  const cv::Point along(out.y, out.x);
  for (int k = -MapErrors::kBeside; k <= MapErrors::kBeside; ++k) {
    if (truth.at(cell + k * along) != Cell::occupied) return false;
    for (int before = 1; before <= MapErrors::kAcross; ++before) {
      if (truth.at(cell + k * along + before * out) != Cell::free) return false;
    }
  }
  return true;
}

}  // namespace

cv::Point GridMap::cell_of(double x, double y) const {
  const Eigen::Vector2d p = Eigen::Rotation2Dd(-yaw) * Eigen::Vector2d(x - origin_x, y - origin_y) / resolution;
  // Far outside stays outside without overflow.
  const auto index = [](double v) { return static_cast<int>(std::floor(std::clamp(v, -1e8, 1e8))); };
  return {index(p.x()), cells.rows - 1 - index(p.y())};
}

Eigen::Vector2d GridMap::centre_of(cv::Point cell) const {
  const Eigen::Vector2d p((cell.x + 0.5) * resolution, (cells.rows - cell.y - 0.5) * resolution);
  return Eigen::Rotation2Dd(yaw) * p + Eigen::Vector2d(origin_x, origin_y);
}

Cell GridMap::at(cv::Point cell) const {
  const bool inside = cv::Rect(0, 0, cells.cols, cells.rows).contains(cell);
  return inside ? static_cast<Cell>(cells(cell)) : Cell::unknown;
}

GridMap grid_map(const cv::Mat1b& grey, const RosMapHeader& header, bool plan) {
  GridMap map{.cells = cv::Mat1b(grey.size(), static_cast<uint8_t>(Cell::unknown)),
              .resolution = header.resolution,
              .origin_x = header.origin_x,
              .origin_y = header.origin_y,
              .yaw = header.yaw};
  for (int y = 0; y < grey.rows; ++y) {
    for (int x = 0; x < grey.cols; ++x) {
      const uint8_t value = grey(y, x);
      const double occupied = (header.negate ? value : 255 - value) / 255.0;
      Cell cell = Cell::unknown;
      if (occupied > header.occupied_thresh) cell = Cell::occupied;
      if (occupied < header.free_thresh) cell = Cell::free;
      if (plan && (value == simulate::kPlanOccupiedPlain || value == simulate::kPlanOccupiedUnseen)) {
        cell = Cell::occupied_uncertain;
      }
      map.cells(y, x) = static_cast<uint8_t>(cell);
    }
  }
  return map;
}

double MapErrors::occupied_precision() const { return percent(occupied_right, occupied - occupied_not_judged); }
double MapErrors::occupied_recall() const { return percent(found, true_occupied); }
double MapErrors::free_precision() const { return percent(free - free_wrong - free_unseen, free); }
double MapErrors::free_recall() const { return percent(found_free, true_free); }

MapErrors evaluate_map(const GridMap& estimate, const GridMap& truth, const Pose& truth_from_estimate,
                       const MapOptions& options) {
  IRIS_CHECK(options.tolerance >= 0 && !truth.cells.empty() && !estimate.cells.empty());
  const Registered registered(estimate, truth, truth_from_estimate);
  const cv::Mat1b true_occupied = mask_of(truth, Cell::occupied), uncertain = mask_of(truth, Cell::occupied_uncertain);
  const Near near_occupied(true_occupied, options.tolerance), near_uncertain(uncertain, options.tolerance),
      near_true_free(mask_of(truth, Cell::free), options.tolerance);
  const int tolerance = registered.estimate_tolerance(options.tolerance);
  const Near near_estimate(mask_of(estimate, Cell::occupied), tolerance);
  const Near near_free(mask_of(estimate, Cell::free), tolerance);
  cv::Mat1f distance;
  cv::distanceTransform(~(true_occupied | uncertain), distance, cv::DIST_L2, cv::DIST_MASK_PRECISE);
  const bool any_true = cv::countNonZero(true_occupied) + cv::countNonZero(uncertain) > 0;

  MapErrors errors;
  std::vector<double> distances;
  for_each_cell(estimate, Cell::occupied, [&](cv::Point cell) {
    const cv::Point there = registered.to_truth(cell);
    const bool inside = cv::Rect(0, 0, truth.cells.cols, truth.cells.rows).contains(there);
    const bool right = near_occupied(there);
    const bool not_judged = !right && near_uncertain(there);
    ++errors.occupied;
    errors.occupied_right += right;
    errors.occupied_not_judged += not_judged;
    errors.occupied_outside += !inside;
    if (inside && any_true && !not_judged) distances.push_back(distance(there) * truth.resolution);
  });
  for_each_cell(estimate, Cell::free, [&](cv::Point cell) {
    const cv::Point there = registered.to_truth(cell);
    const bool hole = truth.at(there) == Cell::occupied && !near_estimate(cell);
    ++errors.free;
    errors.free_wrong += hole;
    errors.free_unseen += truth.at(there) == Cell::unknown && !near_true_free(there);
  });
  for_each_cell(truth, Cell::occupied, [&](cv::Point cell) {
    ++errors.true_occupied;
    errors.found += near_estimate(registered.to_estimate(cell));
  });
  for_each_cell(truth, Cell::free, [&](cv::Point cell) {
    ++errors.true_free;
    errors.found_free += near_free(registered.to_estimate(cell));
  });
  std::vector<int> thicknesses, wall_thicknesses;
  for_each_cell(truth, Cell::occupied, [&](cv::Point cell) {
    for (const cv::Point out : {cv::Point(1, 0), cv::Point(-1, 0), cv::Point(0, 1), cv::Point(0, -1)}) {
      if (truth.at(cell + out) != Cell::free) continue;
      const auto is_occupied = [&](cv::Point at) { return estimate.at(registered.to_estimate(at)) == Cell::occupied; };
      // Occupied cells of the map along the line through cells of one kind; `end`: where it ends.
      const auto count_towards = [&](cv::Point step, Cell through, cv::Point& end) {
        int count = 0;
        end = cell + step;
        for (int k = 1; k <= MapErrors::kAcross && truth.at(end) == through; ++k, end += step) {
          count += is_occupied(end);
        }
        return count;
      };
      cv::Point before_end, behind_end;
      const int before = is_occupied(cell) + count_towards(out, Cell::free, before_end);
      const int behind = count_towards(-out, Cell::unknown, behind_end);
      if (before + behind > 0) thicknesses.push_back(before + behind);
      if (!is_bare_wall(truth, cell, out)) continue;
      const Cell other = truth.at(behind_end);
      const bool is_inside = other == Cell::occupied || other == Cell::occupied_uncertain;
      const int thickness = before + (is_inside ? 0 : behind);
      if (thickness > 0) wall_thicknesses.push_back(thickness);
    }
  });
  errors.faces = thickness_of(std::move(thicknesses));
  errors.walls = thickness_of(std::move(wall_thicknesses));
  if (distances.empty()) return errors;
  const Spread spread = spread_of(std::move(distances));
  errors.distance_mean = spread.mean;
  errors.distance_median = spread.median;
  errors.distance_rms = spread.rmse;
  return errors;
}

cv::Mat3b map_picture(const GridMap& estimate, const GridMap& truth, const Pose& truth_from_estimate,
                      const MapOptions& options) {
  const Registered registered(estimate, truth, truth_from_estimate);
  const Near near_occupied(mask_of(truth, Cell::occupied), options.tolerance);
  const Near near_uncertain(mask_of(truth, Cell::occupied_uncertain), options.tolerance);
  const Near near_estimate(mask_of(estimate, Cell::occupied), registered.estimate_tolerance(options.tolerance));
  const cv::Vec3b found(60, 120, 0), wrong(40, 30, 210), missing(0, 150, 240), unsure(150, 150, 150);  // BGR
  const cv::Vec3b free(255, 255, 255), free_in_truth(225, 225, 225), unknown(200, 190, 180);
  cv::Mat3b picture(truth.cells.size());
  for (int y = 0; y < truth.cells.rows; ++y) {
    for (int x = 0; x < truth.cells.cols; ++x) {
      const cv::Point cell(x, y), there = registered.to_estimate(cell);
      const Cell is = truth.at(cell), says = estimate.at(there);
      cv::Vec3b colour = unknown;
      if (is == Cell::free) colour = free_in_truth;
      if (says == Cell::free) colour = free;
      if (is == Cell::occupied_uncertain) colour = unsure;
      if (is == Cell::occupied) colour = near_estimate(there) ? found : missing;
      if (is != Cell::occupied && says == Cell::occupied) {
        colour = near_occupied(cell) ? found : near_uncertain(cell) ? unsure : wrong;
      }
      picture(cell) = colour;
    }
  }
  return picture;
}

}  // namespace iris::evaluate
