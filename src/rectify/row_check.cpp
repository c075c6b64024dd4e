#include "iris/rectify/row_check.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <opencv2/imgproc.hpp>

#include "iris/core/error.h"
#include "iris/core/median.h"
#include "iris/rectify/rectifier.h"

namespace iris::rectify {
namespace {

constexpr int kHalf = 7;  // of the comparison window

// Vertex of the parabola through three values at -1, 0, 1.
double vertex(double a, double b, double c) {
  const double curvature = a - 2 * b + c;
  return curvature < 0 ? std::clamp(0.5 * (a - c) / curvature, -0.5, 0.5) : 0;
}

// The point of `to` inside `area` (of window centres) that looks most like the one of `from`; false if it is ambiguous,
// or lies at the border of the area.
bool find(const cv::Mat1b& from, const cv::Point& p, const cv::Mat1b& to, cv::Rect area, double least,
          Eigen::Vector2d& found) {
  area &= cv::Rect(kHalf, kHalf, to.cols - 2 * kHalf, to.rows - 2 * kHalf);
  const cv::Rect window(p.x - kHalf, p.y - kHalf, 2 * kHalf + 1, 2 * kHalf + 1);
  if (area.width < 3 || area.height < 3 || (window & cv::Rect(0, 0, from.cols, from.rows)) != window) return false;
  cv::Mat1f score;
  cv::matchTemplate(to(cv::Rect(area.x - kHalf, area.y - kHalf, area.width + 2 * kHalf, area.height + 2 * kHalf)),
                    from(window), score, cv::TM_CCOEFF_NORMED);
  double best = 0;
  cv::Point at;
  cv::minMaxLoc(score, nullptr, &best, nullptr, &at);
  if (!(best >= least) || at.x == 0 || at.y == 0 || at.x == score.cols - 1 || at.y == score.rows - 1) return false;
  // A second place that fits nearly as well.
  constexpr int kPeak = 4;
  constexpr double kAmbiguous = 0.5;  // of what is missing to 1
  cv::Mat1f others = score.clone();
  others(cv::Rect(at.x - kPeak, at.y - kPeak, 2 * kPeak + 1, 2 * kPeak + 1) & cv::Rect(0, 0, score.cols, score.rows)) =
      -1;
  double second = 0;
  cv::minMaxLoc(others, nullptr, &second);
  if (1 - second < (1 - best) / kAmbiguous) return false;
  found = {area.x + at.x + vertex(score(at.y, at.x - 1), score(at), score(at.y, at.x + 1)),
           area.y + at.y + vertex(score(at.y - 1, at.x), score(at), score(at.y + 1, at.x))};
  return true;
}

}  // namespace

void RowCheckOptions::declare(OptionSet& set) {
  set.section("rectify");
  set.add("frames", frames, "frames", 1, 100000, "--check looks at so many frames, spread over the recording");
  set.add("corners", corners, "corners", 10, 10000, "--check matches at most so many corners of a frame");
  set.add("rows", rows, "px", 2, 100, "--check searches partners so far above and below the row");
  set.add("least_match", least_match, {}, 0, 1,
          "normalised cross-correlation from which on two windows count as a match");
  set.add("tolerance", tolerance, "px", 0, 100, "systematic vertical error (RMS) up to which a calibration fits");
}

std::vector<RowMatch> match_rows(const StereoPair& pair, const RowCheckOptions& options) {
  std::vector<cv::Point2f> corners;
  cv::goodFeaturesToTrack(pair.left, corners, options.corners, 0.01, 8);
  const int range = pair.left.cols / 4, rows = options.rows;
  constexpr int kBehind = 8;  // [px] negative disparities, of a calibration that is off
  std::vector<RowMatch> matches;
  for (const cv::Point2f& corner : corners) {
    const cv::Point p(cvRound(corner.x), cvRound(corner.y));
    Eigen::Vector2d right, back;
    if (!find(pair.left, p, pair.right, {p.x - range, p.y - rows, range + kBehind + 1, 2 * rows + 1},
              options.least_match, right)) {
      continue;
    }
    const cv::Point q(cvRound(right.x()), cvRound(right.y()));
    if (!find(pair.right, q, pair.left, {q.x - kBehind, q.y - rows, range + kBehind + 1, 2 * rows + 1},
              options.least_match, back)) {
      continue;
    }
    // The way back starts at the nearest whole pixel.
    const Eigen::Vector2d returned = back + right - Eigen::Vector2d(q.x, q.y);
    constexpr double kReturned = 0.7;
    if ((returned - Eigen::Vector2d(p.x, p.y)).norm() > kReturned) continue;
    matches.push_back({{static_cast<double>(p.x), static_cast<double>(p.y)}, right});
  }
  return matches;
}

RowCheck check_rows(const std::vector<RowMatch>& matches, int width, int height, const RowCheckOptions& options) {
  RowCheck check;
  check.matches = static_cast<int>(matches.size());
  check.cells = cv::Mat1d(RowCheck::kRows, RowCheck::kColumns, std::numeric_limits<double>::quiet_NaN());
  if (matches.empty()) return check;
  std::vector<double> errors, absolute, departures;
  std::vector<std::vector<double>> by_cell(RowCheck::kRows * RowCheck::kColumns);
  for (const RowMatch& match : matches) {
    errors.push_back(match.error());
    absolute.push_back(std::abs(match.error()));
    const int x = std::clamp(static_cast<int>(match.left.x() * RowCheck::kColumns / width), 0, RowCheck::kColumns - 1);
    const int y = std::clamp(static_cast<int>(match.left.y() * RowCheck::kRows / height), 0, RowCheck::kRows - 1);
    by_cell[static_cast<size_t>(y * RowCheck::kColumns + x)].push_back(match.error());
  }
  check.median = median(errors);
  check.median_absolute = median(absolute);
  constexpr size_t kLeast = 10;
  double sum = 0;
  int cells = 0;
  for (size_t i = 0; i < by_cell.size(); ++i) {
    if (by_cell[i].size() < kLeast) continue;
    const double middle = median(by_cell[i]);
    check.cells(static_cast<int>(i) / RowCheck::kColumns, static_cast<int>(i) % RowCheck::kColumns) = middle;
    for (const double e : by_cell[i]) departures.push_back(std::abs(e - middle));
    sum += middle * middle;
    ++cells;
  }
  check.enough = 2 * cells >= RowCheck::kRows * RowCheck::kColumns;
  if (cells > 0) {
    check.systematic = std::sqrt(sum / cells);
    check.scatter = 1.4826 * median(departures);
  }
  check.fits = check.enough && check.systematic <= options.tolerance;
  return check;
}

RotationRefinement refine_rotation(const StereoCalibration& calibration, const std::vector<RowMatch>& matches) {
  const Rectifier rectifier(calibration);
  const RectifiedCamera& camera = rectifier.camera();
  // Rows of the left points stay; rays of the right points are turned. In the frame of the rectified right camera the
  // row of the ray v is f v_y / v_z; a small turn w of the right camera takes v to v - w x v.
  struct Observation {
    double left_row = 0;
    Eigen::Vector3d ray;
  };
  std::vector<Observation> observations;
  for (const RowMatch& match : matches) {
    observations.push_back(
        {match.left.y() - camera.cy,
         Eigen::Vector3d(match.right.x() - camera.cx - (rectifier.passes_through() ? camera.disparity_offset : 0),
                         match.right.y() - camera.cy, camera.f)
             .normalized()});
  }
  IRIS_CHECK(!observations.empty());
  // Matches of one recording share what is wrong with lenses and scene: more of them than these are no more certain.
  constexpr double kIndependent = 100;
  const double share = std::min(1.0, kIndependent / static_cast<double>(observations.size()));
  constexpr double kDegree = std::numbers::pi / 180;
  const Eigen::Vector3d prior(3 * kDegree, 0.1 * kDegree, 3 * kDegree);  // about x, y, z
  Eigen::Matrix3d turned = Eigen::Matrix3d::Identity();                  // rectified right frame, from old to new
  Eigen::Vector3d w = Eigen::Vector3d::Zero();
  Eigen::Matrix3d information;
  for (int iteration = 0; iteration < 20; ++iteration) {
    std::vector<double> residuals, absolute;
    for (const Observation& o : observations) {
      const Eigen::Vector3d v = turned * o.ray;
      residuals.push_back(camera.f * v.y() / v.z() - o.left_row);
    }
    const double middle = median(residuals);
    for (const double r : residuals) absolute.push_back(std::abs(r - middle));
    const double sigma = std::max(0.05, 1.4826 * median(absolute)), limit = 1.5 * sigma;
    information = prior.cwiseAbs2().cwiseInverse().asDiagonal();
    Eigen::Vector3d gradient = prior.cwiseAbs2().cwiseInverse().cwiseProduct(w);
    for (size_t i = 0; i < observations.size(); ++i) {
      const Eigen::Vector3d v = turned * observations[i].ray;
      // d(f v_y / v_z) with dv = dw x v.
      const Eigen::Vector3d by_v(0, camera.f / v.z(), -camera.f * v.y() / (v.z() * v.z()));
      const Eigen::Vector3d by_w = v.cross(by_v);
      const double weight = share / (sigma * sigma) * std::min(1.0, limit / std::max(1e-12, std::abs(residuals[i])));
      information += weight * by_w * by_w.transpose();
      gradient += weight * residuals[i] * by_w;
    }
    const Eigen::Vector3d step = -information.ldlt().solve(gradient);
    w += step;
    turned =
        w.norm() > 0 ? Eigen::AngleAxisd(w.norm(), w.normalized()).toRotationMatrix() : Eigen::Matrix3d::Identity();
    if (step.norm() < 1e-12) break;
  }
  RotationRefinement refinement;
  refinement.sigma = information.inverse().diagonal().cwiseSqrt();
  // rect_from_left R' new = turned rect_from_left R' old: the right camera turns, its centre stays.
  const Eigen::Matrix3d rect = rectifier.rect_from_left();
  const Eigen::Vector3d centre = calibration.right_centre_in_left();
  refinement.calibration = calibration;
  const Eigen::Matrix3d left_from_right =
      rect.transpose() * turned * rect * calibration.right_from_left.linear().transpose();
  refinement.calibration.right_from_left.linear() = nearest_rotation(left_from_right.transpose());
  refinement.calibration.right_from_left.translation() = -(refinement.calibration.right_from_left.linear() * centre);
  refinement.calibration.rectified = false;
  const Eigen::AngleAxisd turn(Eigen::Matrix3d(refinement.calibration.right_from_left.linear().transpose() *
                                               calibration.right_from_left.linear()));
  refinement.turn = turn.angle() * turn.axis();
  return refinement;
}

}  // namespace iris::rectify
