#include "squares.h"

#include <fmt/format.h>

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>

namespace iris::calibrate {
namespace {

using Vec = Eigen::Vector2d;

struct Quad {
  std::array<Vec, 4> corners;  // clockwise in the image
  Vec middle;
  double edge = 0;             // [px] mean
  double dark = 0, light = 0;  // grey levels inside and around
};

struct Line {
  Vec point, direction;
};

// --- dark quadrangles ----------------------------------------------------------------------------------------------

std::vector<Quad> dark_quads(const cv::Mat1b& image) {
  std::vector<Quad> quads;
  constexpr double kLeastEdge = 7;  // [px] shorter sides leave no half to fit a line to
  // Windows of several sizes: the threshold is the mean around, which must reach over a square and its surroundings.
  for (const int divisor : {24, 10, 4}) {
    const int block = std::max(11, std::min(image.rows, image.cols) / divisor) | 1;
    cv::Mat1b dark;
    cv::adaptiveThreshold(image, dark, 255, cv::ADAPTIVE_THRESH_MEAN_C, cv::THRESH_BINARY_INV, block, 5);
    std::vector<std::vector<cv::Point>> contours;
    cv::findContours(dark, contours, cv::RETR_LIST, cv::CHAIN_APPROX_NONE);
    for (const auto& contour : contours) {
      const double area = cv::contourArea(contour);
      if (area < kLeastEdge * kLeastEdge || area > 0.2 * static_cast<double>(image.total())) continue;
      std::vector<cv::Point> polygon;
      cv::approxPolyDP(contour, polygon, 0.06 * cv::arcLength(contour, true), true);
      if (polygon.size() != 4 || !cv::isContourConvex(polygon)) continue;
      if (std::abs(cv::contourArea(polygon) - area) > 0.25 * area) continue;
      Quad quad;
      quad.middle = Vec::Zero();
      for (size_t k = 0; k < 4; ++k) {
        quad.corners[k] = Vec(polygon[k].x, polygon[k].y);
        quad.middle += quad.corners[k] / 4;
      }
      const Vec a = quad.corners[1] - quad.corners[0], b = quad.corners[2] - quad.corners[1];
      if (a.x() * b.y() - a.y() * b.x() < 0) std::swap(quad.corners[1], quad.corners[3]);
      double shortest = 1e9, longest = 0;
      for (size_t k = 0; k < 4; ++k) {
        const double side = (quad.corners[(k + 1) % 4] - quad.corners[k]).norm();
        quad.edge += side / 4;
        shortest = std::min(shortest, side);
        longest = std::max(longest, side);
      }
      if (shortest < kLeastEdge || longest > 4 * shortest) continue;
      const bool known = std::any_of(quads.begin(), quads.end(), [&](const Quad& other) {
        return (other.middle - quad.middle).norm() < 0.3 * std::min(other.edge, quad.edge);
      });
      if (known) continue;
      // Dark inside, light outside of every side.
      bool good = inside(image, quad.middle, 2);
      for (size_t k = 0; k < 4 && good; ++k) {
        const Vec side = (quad.corners[k] + quad.corners[(k + 1) % 4]) / 2;
        const Vec in = quad.middle + 0.6 * (side - quad.middle), out = quad.middle + 1.5 * (side - quad.middle);
        constexpr double kContrast = 15;  // [grey levels]
        good = inside(image, out, 2) && grey_at(image, out) - grey_at(image, in) > kContrast;
        if (!good) break;
        quad.dark += grey_at(image, in) / 4;
        quad.light += grey_at(image, out) / 4;
      }
      // Measured exactly now: what follows steps from square to square. What cannot be measured is no square.
      std::vector<Vec> refined(quad.corners.begin(), quad.corners.end());
      good = good && refine_square(image, refined);
      if (good) {
        std::copy(refined.begin(), refined.end(), quad.corners.begin());
        quad.middle = (refined[0] + refined[1] + refined[2] + refined[3]) / 4;
      }
      if (good) quads.push_back(quad);
    }
  }
  return quads;
}

// --- the grid ------------------------------------------------------------------------------------------------------

using Cell = std::pair<int, int>;  // (column, row), from the seed

// Takes the sheet's plane, in edges of a square from the quad's upper left corner, to the image.
Eigen::Matrix3d plane_of(const Quad& quad) {
  const cv::Point2f from[] = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
  cv::Point2f to[4];
  for (size_t k = 0; k < 4; ++k) {
    to[k] = {static_cast<float>(quad.corners[k].x()), static_cast<float>(quad.corners[k].y())};
  }
  const cv::Mat1d h = cv::getPerspectiveTransform(from, to);
  Eigen::Matrix3d H;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) H(r, c) = h(r, c);
  }
  return H;
}

// All quads that continue the grid of the seed, step by step. Neighbours get corners in the same order as the seed.
std::map<Cell, Quad> grow(std::vector<Quad> quads, size_t seed, double step) {
  std::map<Cell, Quad> grid = {{{0, 0}, quads[seed]}};
  std::vector<bool> used(quads.size());
  used[seed] = true;
  std::vector<Cell> front = {{0, 0}};
  while (!front.empty()) {
    const Cell cell = front.back();
    front.pop_back();
    const Quad quad = grid.at(cell);
    const Eigen::Matrix3d H = plane_of(quad);
    const auto seen = [&](double x, double y) { return Vec((H * Eigen::Vector3d(x, y, 1)).hnormalized()); };
    for (const Cell& to : {Cell{1, 0}, Cell{-1, 0}, Cell{0, 1}, Cell{0, -1}}) {
      const Cell next = {cell.first + to.first, cell.second + to.second};
      if (grid.contains(next)) continue;
      const double x = step * to.first, y = step * to.second;
      const Vec expected = seen(x + 0.5, y + 0.5);
      for (size_t i = 0; i < quads.size(); ++i) {
        Quad& found = quads[i];
        const double contrast = quad.light - quad.dark;
        const bool alike = found.edge > 0.6 * quad.edge && found.edge < 1.7 * quad.edge &&
                           std::abs(found.dark - quad.dark) < 0.3 * contrast &&
                           std::abs(found.light - quad.light) < 0.4 * contrast;
        if (used[i] || !alike || (found.middle - expected).norm() > 0.35 * quad.edge) continue;
        // Its sides run like those of its neighbour.
        const Vec along = (quad.corners[1] - quad.corners[0]).normalized();
        size_t first = 0;
        double most = -2;
        for (size_t k = 0; k < 4; ++k) {
          const double value = along.dot((found.corners[(k + 1) % 4] - found.corners[k]).normalized());
          if (value > most) {
            most = value;
            first = k;
          }
        }
        std::rotate(found.corners.begin(), found.corners.begin() + static_cast<std::ptrdiff_t>(first),
                    found.corners.end());
        used[i] = true;
        grid[next] = found;
        front.push_back(next);
        break;
      }
    }
  }
  return grid;
}

// --- sub-pixel edges -----------------------------------------------------------------------------------------------

// Grey values across an edge, from dark to light: `reach` pixels to both sides.
constexpr int kPerPixel = 2;
std::optional<std::vector<double>> profile(const cv::Mat1b& image, const Vec& p, const Vec& across, int reach) {
  if (!inside(image, p - (reach + 1) * across, 1) || !inside(image, p + (reach + 1) * across, 1)) return std::nullopt;
  std::vector<double> values;
  for (int i = 0; i < 2 * reach * kPerPixel; ++i) {
    values.push_back(grey_at(image, p + ((i + 0.5) / kPerPixel - reach) * across));
  }
  return values;
}

// Total least squares, once more without what lies far off.
std::optional<Line> fit_line(std::vector<Vec> points) {
  Line line;
  for (int pass = 0; pass < 2; ++pass) {
    if (points.size() < 3) return std::nullopt;
    line.point = Vec::Zero();
    for (const Vec& p : points) line.point += p / static_cast<double>(points.size());
    Eigen::Matrix2d scatter = Eigen::Matrix2d::Zero();
    for (const Vec& p : points) scatter += (p - line.point) * (p - line.point).transpose();
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> solver(scatter);
    line.direction = solver.eigenvectors().col(1);
    const Vec normal = solver.eigenvectors().col(0);
    const double rms = std::sqrt(std::max(0.0, solver.eigenvalues()(0)) / static_cast<double>(points.size()));
    const double limit = std::max(2.5 * rms, 0.02);
    std::erase_if(points, [&](const Vec& p) { return std::abs(normal.dot(p - line.point)) > limit; });
  }
  return line;
}

std::optional<Vec> intersection(const Line& a, const Line& b) {
  Eigen::Matrix2d m;
  m << a.direction, -b.direction;
  if (std::abs(m.determinant()) < 0.2) return std::nullopt;
  const Vec s = m.inverse() * (b.point - a.point);
  return a.point + s(0) * a.direction;
}

// The half of the side from `corner` to `other` that lies at `corner`. `out` points out of the square.
std::optional<Line> half_side(const cv::Mat1b& image, const Vec& corner, const Vec& other, const Vec& middle) {
  const Vec side = other - corner;
  const double length = side.norm();
  const Vec along = side / length;
  Vec across(-along.y(), along.x());
  if (across.dot(middle - corner) > 0) across = -across;  // outwards: from dark to light
  const int reach = std::clamp(static_cast<int>(length / 5), 3, 5);
  // Near the corner the profile's ends, and the image's blur, reach around it.
  const double begin = std::min(2.0, 0.15 * length), end = length / 2;
  const int count = std::max(4, static_cast<int>(std::ceil(end - begin)));
  std::vector<Vec> places;
  std::vector<std::vector<double>> profiles;
  double dark = 0, light = 0;
  for (int i = 0; i < count; ++i) {
    const Vec p = corner + (begin + (end - begin) * i / (count - 1)) * along;
    auto values = profile(image, p, across, reach);
    if (!values) continue;
    for (size_t k = 0; k < kPerPixel; ++k) {
      dark += (*values)[k] / kPerPixel;
      light += (*values)[values->size() - 1 - k] / kPerPixel;
    }
    places.push_back(p);
    profiles.push_back(std::move(*values));
  }
  if (profiles.empty()) return std::nullopt;
  // The plateaus are those of the whole half side: less noise than those of single profiles.
  dark /= static_cast<double>(profiles.size());
  light /= static_cast<double>(profiles.size());
  constexpr double kLeastContrast = 12;
  if (light - dark < kLeastContrast) return std::nullopt;
  std::vector<Vec> points;
  for (size_t i = 0; i < profiles.size(); ++i) {
    // The sum of the profile says how much of it is dark, thus where the edge is.
    double sum = 0;
    for (const double value : profiles[i]) sum += light - value;
    const double offset = sum / (light - dark) / kPerPixel - reach;
    if (std::abs(offset) < reach - 1) points.push_back(places[i] + offset * across);
  }
  if (2 * points.size() < static_cast<size_t>(count)) return std::nullopt;
  return fit_line(std::move(points));
}

}  // namespace

bool inside(const cv::Mat1b& image, const Eigen::Vector2d& p, double border) {
  return p.x() >= border && p.y() >= border && p.x() <= image.cols - 1 - border && p.y() <= image.rows - 1 - border;
}

double grey_at(const cv::Mat1b& image, const Eigen::Vector2d& p) {
  const int x = static_cast<int>(p.x()), y = static_cast<int>(p.y());
  const double u = p.x() - x, v = p.y() - y;
  return (1 - v) * ((1 - u) * image(y, x) + u * image(y, x + 1)) +
         v * ((1 - u) * image(y + 1, x) + u * image(y + 1, x + 1));
}

bool refine_square(const cv::Mat1b& image, std::vector<Eigen::Vector2d>& corners) {
  // Twice: the second time the profiles lie across the lines of the first.
  for (int pass = 0; pass < 2; ++pass) {
    const Vec middle = (corners[0] + corners[1] + corners[2] + corners[3]) / 4;
    std::vector<Vec> refined(4);
    for (size_t k = 0; k < 4; ++k) {
      const auto a = half_side(image, corners[k], corners[(k + 1) % 4], middle);
      const auto b = half_side(image, corners[k], corners[(k + 3) % 4], middle);
      if (!a || !b) return false;
      const auto corner = intersection(*a, *b);
      constexpr double kLargestStep = 4;  // [px]
      if (!corner || (*corner - corners[k]).norm() > kLargestStep) return false;
      refined[k] = *corner;
    }
    corners = refined;
  }
  return true;
}

Detection find_squares(const cv::Mat1b& image, const Target& target) {
  Detection detection;
  const std::vector<Quad> quads = dark_quads(image);
  std::map<Cell, Quad> best;
  // Seeds until a grid of more than half of all quads is found: each quad belongs to one grid.
  const double step = 1 + target.gap / target.size;
  for (size_t seed = 0; seed < quads.size() && 2 * best.size() < quads.size(); ++seed) {
    std::map<Cell, Quad> grid = grow(quads, seed, step);
    if (grid.size() > best.size()) best = std::move(grid);
  }
  if (best.size() < 4) return detection;
  int left = 0, right = 0, top = 0, bottom = 0;
  for (const auto& [cell, quad] : best) {
    left = std::min(left, cell.first);
    right = std::max(right, cell.first);
    top = std::min(top, cell.second);
    bottom = std::max(bottom, cell.second);
  }
  const int columns = right - left + 1, rows = bottom - top + 1;
  const bool whole = best.size() == static_cast<size_t>(columns * rows);
  const bool lies = columns == target.columns && rows == target.rows;
  const bool stands = columns == target.rows && rows == target.columns;
  if (!whole || (!lies && !stands)) {
    detection.problem = whole
                            ? fmt::format("a grid of {} x {} squares", std::max(columns, rows), std::min(columns, rows))
                            : fmt::format("{} squares, of which some in the grid are hidden", best.size());
    return detection;
  }
  // Of the (two or four) ways to number it, the one whose columns run to the right in the image.
  const Vec to_right = best.at({right, top}).middle - best.at({left, top}).middle;
  const Vec to_bottom = best.at({left, bottom}).middle - best.at({left, top}).middle;
  int quarters = 0;
  double most = -2;
  for (int q = 0; q < 4; ++q) {
    if (q % 2 == 0 ? !lies : !stands) continue;
    const Vec way = q == 0 ? to_right : q == 1 ? to_bottom : q == 2 ? Vec(-to_right) : Vec(-to_bottom);
    if (way.normalized().x() > most) {
      most = way.normalized().x();
      quarters = q;
    }
  }
  Corners corners;
  for (int row = 0; row < target.rows; ++row) {
    for (int column = 0; column < target.columns; ++column) {
      Cell cell;
      switch (quarters) {
        case 0:
          cell = {left + column, top + row};
          break;
        case 1:
          cell = {right - row, top + column};
          break;
        case 2:
          cell = {right - column, bottom - row};
          break;
        default:
          cell = {left + row, bottom - column};
          break;
      }
      const Quad& quad = best.at(cell);
      for (size_t k = 0; k < 4; ++k) {
        corners.ids.push_back(4 * (row * target.columns + column) + static_cast<int>(k));
        corners.points.push_back(quad.corners[(k + static_cast<size_t>(quarters)) % 4]);
      }
    }
  }
  detection.corners = std::move(corners);
  return detection;
}

}  // namespace iris::calibrate
