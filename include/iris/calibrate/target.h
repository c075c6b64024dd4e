// Flat calibration targets: which corners they have and where on the sheet these are (thesis 2.3, figure 2.3).
#pragma once

#include <Eigen/Core>
#include <string>
#include <utility>
#include <vector>

namespace iris::calibrate {

enum class TargetKind {
  squares,     // a grid of separate dark squares on white (thesis 2.3): the four corners of each
  chessboard,  // the inner corners
  charuco,     // a chessboard with ArUco markers in its white squares: the inner corners; may be seen in parts
  aprilgrid,  // a grid of AprilTags 36h11 with small black squares between them (Kalibr): four corners of each tag; may
              // be seen in parts
};

// The sheet's frame: x right, y down, z away from who looks at it; origin in corner 0 [m].
struct Target {
  TargetKind kind = TargetKind::chessboard;
  int columns = 0, rows = 0;  // squares, inner corners, squares, tags
  double size = 0;            // [m] edge of a square or tag
  double gap = 0;             // [m] squares, aprilgrid: between neighbours
  double marker = 0;          // [m] charuco: edge of a marker
  std::string dictionary;     // charuco: OpenCV's name without DICT_, 4X4_50 …
};

// Reads one of
//   squares:COLUMNSxROWS:SIZE[:GAP]                       gap: as wide as a square
//   chessboard:COLUMNSxROWS:SIZE                          inner corners
//   charuco:COLUMNSxROWS:SQUARE:MARKER[:DICTIONARY]       squares; 4X4_50
//   aprilgrid:COLUMNSxROWS:TAG:SPACING                    spacing as in Kalibr: gap / edge of a tag
// Lengths are metres, or have a unit: 25mm, 2.5cm. Throws UsageError that says which part is wrong.
Target parse_target(const std::string& text);

// For people: "chessboard with 9 x 6 inner corners, 25 mm".
std::string to_text(const Target& target);

// Corners by their number. Squares: four of each square, clockwise from the upper left one, squares row by row.
// Chessboard, ChArUco: row by row. Aprilgrid: four of each tag, clockwise from the upper left one; tag 0 is the lower
// left one, numbers grow to the right, then upwards.
std::vector<Eigen::Vector3d> target_points(const Target& target);

// Pairs of corners between which a straight border of black and white runs.
std::vector<std::pair<int, int>> target_edges(const Target& target);

// The ways in which the corners could be numbered if the sheet is turned in its plane and looks the same then: for
// each, the number that a corner gets. The first leaves them as they are. Sheets with markers have no other.
std::vector<std::vector<int>> target_symmetries(const Target& target);

}  // namespace iris::calibrate
