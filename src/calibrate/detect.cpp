#include "iris/calibrate/detect.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numbers>
#include <opencv2/aruco.hpp>
#include <opencv2/aruco/charuco.hpp>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "iris/core/error.h"
#include "squares.h"

namespace iris::calibrate {
namespace {

using Vec = Eigen::Vector2d;
namespace aruco = cv::aruco;

// Saddle points, each in a window that stays well away from its neighbours and from the sheet's end, where squares are
// often cut: on the pairs that come with OpenCV half windows of 0.3 of the distance leave 0.20 px RMS, 0.4 leave 0.25,
// and the usual 11 px 0.44, since they pull six corners of one image 2 to 6 px onto the end of a row of half squares.
// On rendered boards larger windows gain less than a tenth.
void refine_saddles(const cv::Mat1b& image, std::vector<cv::Point2f>& points, double spacing) {
  const int half = std::clamp(static_cast<int>(0.3 * spacing), 2, 11);
  cv::cornerSubPix(image, points, {half, half}, {-1, -1}, {cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 50, 1e-4});
}

double least_distance(const std::vector<cv::Point2f>& points, int columns) {
  double least = 1e9;
  for (size_t i = 0; i < points.size(); ++i) {
    if ((i + 1) % static_cast<size_t>(columns) != 0 && i + 1 < points.size()) {
      least = std::min(least, cv::norm(points[i + 1] - points[i]));
    }
    if (i + static_cast<size_t>(columns) < points.size()) {
      least = std::min(least, cv::norm(points[i + static_cast<size_t>(columns)] - points[i]));
    }
  }
  return least;
}

// --- chessboards ---------------------------------------------------------------------------------------------------

// Four squares meet here, two dark and two light ones across from each other. `u`, `v`: to the neighbouring corners.
bool squares_meet(const cv::Mat1b& image, const Vec& p, const Vec& u, const Vec& v) {
  const double part = 0.3;
  std::array<double, 4> grey;
  for (size_t k = 0; k < 4; ++k) {
    const Vec q = p + part * ((k == 0 || k == 3 ? 1.0 : -1.0) * u + (k < 2 ? 1.0 : -1.0) * v);
    if (!inside(image, q, 1)) return false;
    grey[k] = grey_at(image, q);
  }
  const double contrast = std::abs(grey[0] + grey[2] - grey[1] - grey[3]) / 2;
  constexpr double kLeastContrast = 30;
  return contrast > kLeastContrast && std::abs(grey[0] - grey[2]) < 0.5 * contrast &&
         std::abs(grey[1] - grey[3]) < 0.5 * contrast;
}

// OpenCV also finds parts of larger boards. Then there are corners beyond the border, where the next row is expected.
bool goes_on(const cv::Mat1b& image, const Target& target, const Corners& corners) {
  const int columns = target.columns, rows = target.rows;
  const auto at = [&](int row, int column) { return corners.points[static_cast<size_t>(row * columns + column)]; };
  const auto side = [&](int count, auto border, auto inner) {
    int found = 0;
    for (int i = 0; i < count; ++i) {
      const Vec out = border(i) - inner(i);
      const Vec along = i + 1 < count ? border(i + 1) - border(i) : border(i) - border(i - 1);
      found += squares_meet(image, border(i) + out, out, along);
    }
    return 2 * found > count;
  };
  return side(
             rows, [&](int i) { return at(i, 0); }, [&](int i) { return at(i, 1); }) ||
         side(
             rows, [&](int i) { return at(i, columns - 1); }, [&](int i) { return at(i, columns - 2); }) ||
         side(
             columns, [&](int i) { return at(0, i); }, [&](int i) { return at(1, i); }) ||
         side(
             columns, [&](int i) { return at(rows - 1, i); }, [&](int i) { return at(rows - 2, i); });
}

Detection find_chessboard(const cv::Mat1b& image, const Target& target) {
  Detection detection;
  std::vector<cv::Point2f> points;
  constexpr int kFlags = cv::CALIB_CB_ADAPTIVE_THRESH | cv::CALIB_CB_NORMALIZE_IMAGE | cv::CALIB_CB_FAST_CHECK;
  if (!cv::findChessboardCorners(image, {target.columns, target.rows}, points, kFlags)) return detection;
  refine_saddles(image, points, least_distance(points, target.columns));
  const auto at = [&](int row, int column) -> cv::Point2f& {
    return points[static_cast<size_t>(row * target.columns + column)];
  };
  // Rows downwards when columns run to the right.
  const cv::Point2f u = at(0, target.columns - 1) - at(0, 0), v = at(target.rows - 1, 0) - at(0, 0);
  if (u.x * v.y - u.y * v.x < 0) {
    for (int row = 0; row < target.rows; ++row) {
      std::reverse(&at(row, 0), &at(row, target.columns - 1) + 1);
    }
  }
  for (size_t i = 0; i < points.size(); ++i) {
    detection.corners.ids.push_back(static_cast<int>(i));
    detection.corners.points.emplace_back(points[i].x, points[i].y);
  }
  if (goes_on(image, target, detection.corners)) {
    detection.corners = {};
    detection.problem = fmt::format("a chessboard with more than {} x {} inner corners", target.columns, target.rows);
  }
  return detection;
}

// --- markers -------------------------------------------------------------------------------------------------------

const std::map<std::string, int>& dictionaries() {
  static const std::map<std::string, int> names = {
      {"4X4_50", aruco::DICT_4X4_50},
      {"4X4_100", aruco::DICT_4X4_100},
      {"4X4_250", aruco::DICT_4X4_250},
      {"4X4_1000", aruco::DICT_4X4_1000},
      {"5X5_50", aruco::DICT_5X5_50},
      {"5X5_100", aruco::DICT_5X5_100},
      {"5X5_250", aruco::DICT_5X5_250},
      {"5X5_1000", aruco::DICT_5X5_1000},
      {"6X6_50", aruco::DICT_6X6_50},
      {"6X6_100", aruco::DICT_6X6_100},
      {"6X6_250", aruco::DICT_6X6_250},
      {"6X6_1000", aruco::DICT_6X6_1000},
      {"7X7_50", aruco::DICT_7X7_50},
      {"7X7_100", aruco::DICT_7X7_100},
      {"7X7_250", aruco::DICT_7X7_250},
      {"7X7_1000", aruco::DICT_7X7_1000},
      {"ARUCO_ORIGINAL", aruco::DICT_ARUCO_ORIGINAL},
      {"APRILTAG_36h11", aruco::DICT_APRILTAG_36h11},
  };
  return names;
}

struct Markers {
  std::vector<std::vector<cv::Point2f>> corners;
  std::vector<int> ids;
};

// `scale`: of the image against the recorded one.
Markers find_markers(const cv::Mat1b& image, const cv::Ptr<aruco::Dictionary>& dictionary, int border_bits,
                     int scale = 1) {
  const auto parameters = aruco::DetectorParameters::create();
  parameters->markerBorderBits = border_bits;
  parameters->adaptiveThreshWinSizeMin = (3 * scale) | 1;
  parameters->adaptiveThreshWinSizeMax = 53 * scale;
  parameters->adaptiveThreshWinSizeStep = 10 * scale;
  if (scale > 1) parameters->perspectiveRemovePixelPerCell = 8;
  parameters->minMarkerPerimeterRate = 0.02;
  Markers markers;
  aruco::detectMarkers(image, dictionary, markers.corners, markers.ids, parameters);
  return markers;
}

Detection find_charuco(const cv::Mat1b& image, const Target& target) {
  Detection detection;
  const auto dictionary = aruco::getPredefinedDictionary(dictionaries().at(target.dictionary));
  const Markers markers = find_markers(image, dictionary, 1);
  if (markers.ids.size() < 4) return detection;
  const auto board = aruco::CharucoBoard::create(target.columns, target.rows, static_cast<float>(target.size),
                                                 static_cast<float>(target.marker), dictionary);
  std::vector<cv::Point2f> points;
  std::vector<int> ids;
  aruco::interpolateCornersCharuco(markers.corners, markers.ids, image, board, points, ids);
  if (points.size() >= 6) {
    // In windows that end before the markers, which would pull.
    std::map<int, cv::Point2f> by_id;
    for (size_t i = 0; i < points.size(); ++i) by_id[ids[i]] = points[i];
    double spacing = 1e9;
    for (const auto& [from, to] : target_edges(target)) {
      if (by_id.contains(from) && by_id.contains(to)) spacing = std::min(spacing, cv::norm(by_id[from] - by_id[to]));
    }
    refine_saddles(image, points, spacing * (1 - target.marker / target.size) / 2 / 0.3);
  }
  for (size_t i = 0; i < points.size(); ++i) {
    detection.corners.ids.push_back(ids[i]);
    detection.corners.points.emplace_back(points[i].x, points[i].y);
  }
  if (points.size() < 6) {
    detection.corners = {};
    detection.problem = fmt::format("{} markers with numbers that do not lie as on this board", markers.ids.size());
  }
  return detection;
}

// The small squares of an aprilgrid touch the tags, so that their outlines run together: spreading the white by a third
// of a pixel in an image three times as large parts them.
Detection find_aprilgrid(const cv::Mat1b& image, const Target& target) {
  Detection detection;
  const auto dictionary = aruco::getPredefinedDictionary(aruco::DICT_APRILTAG_36h11);
  Markers markers;
  constexpr int kScale = 3;
  cv::Mat1b large, parted;
  cv::resize(image, large, {}, kScale, kScale, cv::INTER_CUBIC);
  cv::dilate(large, parted, cv::Mat1b(3, 3, uchar{1}));
  constexpr int kBorderBits = 2;  // of Kalibr's tags
  for (const cv::Mat1b* version : {&parted, &large}) {
    const Markers found = find_markers(*version, dictionary, kBorderBits, kScale);
    for (size_t i = 0; i < found.ids.size(); ++i) {
      if (std::find(markers.ids.begin(), markers.ids.end(), found.ids[i]) != markers.ids.end()) continue;
      markers.ids.push_back(found.ids[i]);
      markers.corners.push_back(found.corners[i]);
      for (cv::Point2f& p : markers.corners.back()) {
        p = (p + cv::Point2f(0.5f, 0.5f)) / kScale - cv::Point2f(0.5f, 0.5f);
      }
    }
    if (markers.ids.size() >= static_cast<size_t>(target.columns * target.rows)) break;
  }
  const std::vector<Eigen::Vector3d> sheet = target_points(target);
  std::map<int, size_t> by_id;
  for (size_t i = 0; i < markers.ids.size(); ++i) {
    if (markers.ids[i] < target.columns * target.rows) by_id[markers.ids[i]] = i;
  }
  if (by_id.size() < 4) return detection;
  // Which corner of a tag is which is told by where its neighbours are: libraries count them differently.
  std::vector<cv::Point2f> middles, seen;
  for (const auto& [id, i] : by_id) {
    const auto first = static_cast<size_t>(4 * id);
    const Eigen::Vector3d middle = (sheet[first] + sheet[first + 2]) / 2;
    middles.emplace_back(static_cast<float>(middle.x()), static_cast<float>(middle.y()));
    const auto& c = markers.corners[i];
    seen.push_back((c[0] + c[1] + c[2] + c[3]) / 4);
  }
  const cv::Mat1d H = cv::findHomography(middles, seen, cv::RANSAC, 10);
  if (H.empty()) return detection;
  std::vector<cv::Point2f> points;
  double spacing = 1e9;
  for (const auto& [id, i] : by_id) {
    std::vector<cv::Point2f> expected, corners;
    for (int k = 0; k < 4; ++k) {
      const Eigen::Vector3d& p = sheet[static_cast<size_t>(4 * id + k)];
      expected.emplace_back(static_cast<float>(p.x()), static_cast<float>(p.y()));
    }
    cv::perspectiveTransform(expected, expected, H);
    const double edge = cv::norm(markers.corners[i][0] - markers.corners[i][1]);
    for (const cv::Point2f& wanted : expected) {
      corners.push_back(*std::min_element(
          markers.corners[i].begin(), markers.corners[i].end(),
          [&](const cv::Point2f& a, const cv::Point2f& b) { return cv::norm(a - wanted) < cv::norm(b - wanted); }));
      if (cv::norm(corners.back() - wanted) > 0.4 * edge) corners.clear();
      if (corners.empty()) break;
    }
    if (corners.size() != 4 || corners[0] == corners[1] || corners[1] == corners[2] || corners[2] == corners[3])
      continue;
    spacing = std::min(spacing, edge * std::min(1.0, target.gap / target.size));
    for (int k = 0; k < 4; ++k) {
      detection.corners.ids.push_back(4 * id + k);
      points.push_back(corners[static_cast<size_t>(k)]);
    }
  }
  if (points.size() < 8) {
    detection.corners = {};
    detection.problem = fmt::format("{} tags with numbers that do not lie as on this grid", by_id.size());
    return detection;
  }
  refine_saddles(image, points, 1.8 * spacing);
  for (const cv::Point2f& p : points) detection.corners.points.emplace_back(p.x, p.y);
  return detection;
}

// --- blur ----------------------------------------------------------------------------------------------------------

// Over how many pixels borders rise from black to white: contrast divided by the steepest slope. Motion blurs one
// direction alone: the worse of the two directions of the sheet counts.
double blur_of(const cv::Mat1b& image, const Target& target, const Corners& corners) {
  std::map<int, Vec> position;
  for (size_t i = 0; i < corners.size(); ++i) position[corners.ids[i]] = corners.points[i];
  const std::vector<Eigen::Vector3d> sheet = target_points(target);
  std::array<std::vector<double>, 2> widths;
  for (const auto& [from, to] : target_edges(target)) {
    if (!position.contains(from) || !position.contains(to)) continue;
    const Vec a = position[from], b = position[to], along = (b - a).normalized(), across(-along.y(), along.x());
    const double reach = std::min(12.0, 0.4 * (b - a).norm());
    const bool vertical = sheet[static_cast<size_t>(from)].x() == sheet[static_cast<size_t>(to)].x();
    for (const double part : {0.4, 0.5, 0.6}) {
      const Vec p = a + part * (b - a);
      if (!inside(image, p + (reach + 1) * across, 1) || !inside(image, p - (reach + 1) * across, 1)) continue;
      double low = 255, high = 0, steepest = 0;
      for (double s = -reach; s <= reach; s += 0.5) {
        const double value = grey_at(image, p + s * across);
        low = std::min(low, value);
        high = std::max(high, value);
        if (s + 1 > reach) continue;
        steepest = std::max(steepest, std::abs(grey_at(image, p + (s + 1) * across) - value));
      }
      if (high - low > 10 && steepest > 0) widths[vertical ? 1 : 0].push_back((high - low) / steepest);
    }
  }
  double blur = 0;
  for (std::vector<double>& w : widths) {
    if (w.empty()) continue;
    const auto middle = w.begin() + static_cast<std::ptrdiff_t>(w.size() / 2);
    std::nth_element(w.begin(), middle, w.end());
    blur = std::max(blur, *middle);
  }
  return blur;
}

Detection detect(const cv::Mat1b& image, const Target& target) {
  switch (target.kind) {
    case TargetKind::squares:
      return find_squares(image, target);
    case TargetKind::chessboard:
      return find_chessboard(image, target);
    case TargetKind::charuco:
      return find_charuco(image, target);
    case TargetKind::aprilgrid:
      return find_aprilgrid(image, target);
  }
  throw Bug("no such target");
}

}  // namespace

void require_dictionary(const Target& target) {
  if (target.kind != TargetKind::charuco || dictionaries().contains(target.dictionary)) return;
  std::string names;
  for (const auto& [name, number] : dictionaries()) names += (names.empty() ? "" : ", ") + name;
  throw UsageError(fmt::format("--target: '{}' is no dictionary of markers; known are {}", target.dictionary, names));
}

Detection find_target(const cv::Mat1b& image, const Target& target) {
  require_dictionary(target);
  Detection detection = detect(image, target);
  IRIS_CHECK(detection.corners.ids.size() == detection.corners.points.size());
  if (!detection.corners.empty()) detection.blur = blur_of(image, target, detection.corners);
  return detection;
}

std::string explain_missing(const cv::Mat1b& image, const Target& target) {
  if (target.kind == TargetKind::charuco || target.kind == TargetKind::aprilgrid) {
    cv::Mat1b mirrored;
    cv::flip(image, mirrored, 1);
    if (!detect(mirrored, target).corners.empty()) {
      return "the target is mirrored: its markers can be read in the mirrored image only";
    }
    return {};
  }
  if (target.kind == TargetKind::squares) return {};  // find_target says it itself
  std::vector<cv::Point2f> points;
  cv::Mat1b meta;
  constexpr int kFlags = cv::CALIB_CB_LARGER | cv::CALIB_CB_EXHAUSTIVE | cv::CALIB_CB_NORMALIZE_IMAGE;
  if (!cv::findChessboardCornersSB(image, {3, 3}, points, kFlags, meta)) return {};
  const int columns = std::max(meta.cols, meta.rows), rows = std::min(meta.cols, meta.rows);
  if (columns * rows <= 12) return {};  // a part of it, or something else
  if (columns == std::max(target.columns, target.rows) && rows == std::min(target.columns, target.rows)) return {};
  return fmt::format("there is a chessboard with {} x {} inner corners", columns, rows);
}

void match_orientation(const Target& target, const Corners& left, Corners& right) {
  if (left.empty() || right.empty()) return;
  const auto centred = [](const Corners& corners) {
    Vec mean = Vec::Zero();
    for (const Vec& p : corners.points) mean += p / static_cast<double>(corners.size());
    std::map<int, Vec> by_id;
    for (size_t i = 0; i < corners.size(); ++i) by_id[corners.ids[i]] = corners.points[i] - mean;
    return by_id;
  };
  const std::map<int, Vec> l = centred(left), r = centred(right);
  const std::vector<std::vector<int>> symmetries = target_symmetries(target);
  double most = -1e300;
  const std::vector<int>* best = nullptr;
  for (const std::vector<int>& numbers : symmetries) {
    double sum = 0;
    for (const auto& [id, p] : r) {
      const auto partner = l.find(numbers[static_cast<size_t>(id)]);
      if (partner != l.end()) sum += partner->second.dot(p);
    }
    if (sum > most) {
      most = sum;
      best = &numbers;
    }
  }
  std::map<int, Vec> renumbered;
  for (size_t i = 0; i < right.size(); ++i) {
    renumbered[(*best)[static_cast<size_t>(right.ids[i])]] = right.points[i];
  }
  right = {};
  for (const auto& [id, p] : renumbered) {
    right.ids.push_back(id);
    right.points.push_back(p);
  }
}

}  // namespace iris::calibrate
