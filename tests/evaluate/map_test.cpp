#include "iris/evaluate/map.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "iris/simulate/floor_plan.h"

namespace iris::evaluate {
namespace {

// One character a cell: '#' occupied, '.' free, '?' unknown, 'u' occupied, but seen by no camera.
GridMap drawn(const std::vector<std::string>& rows, double resolution = 0.1) {
  cv::Mat1b grey(static_cast<int>(rows.size()), static_cast<int>(rows[0].size()));
  for (int y = 0; y < grey.rows; ++y) {
    for (int x = 0; x < grey.cols; ++x) {
      const char c = rows[static_cast<size_t>(y)][static_cast<size_t>(x)];
      grey(y, x) = c == '#'   ? simulate::kPlanOccupied
                   : c == 'u' ? simulate::kPlanOccupiedUnseen
                   : c == '.' ? simulate::kPlanFree
                              : simulate::kPlanUnknown;
    }
  }
  return grid_map(grey, {.image = "", .resolution = resolution, .origin_x = -0.3, .origin_y = 0.2}, true);
}

TEST(Map, AMapIsItself) {
  const GridMap map = drawn({"#####", "#...#", "#...#", "##u##"});
  const MapErrors e = evaluate_map(map, map, Pose::Identity(), {.tolerance = 0});
  EXPECT_EQ(e.true_occupied, 13);
  EXPECT_EQ(e.occupied_precision(), 100);
  EXPECT_EQ(e.occupied_recall(), 100);
  EXPECT_EQ(e.free_precision(), 100);
  EXPECT_EQ(e.free_recall(), 100);
  EXPECT_EQ(e.distance_rms, 0);
}

TEST(Map, DrawnCellsByHand) {
  const GridMap truth = drawn({"?????????",  //
                               "?#######?",  //
                               "?.......?",  //
                               "?.......?",  //
                               "?.......?",  //
                               "?.......?",  //
                               "?uuuu???#"});
  GridMap map = drawn({"?????????",    //
                       "?###..##?",    // two cells of the wall are missing, but next to found ones
                       "?.......?",    //
                       "?.......?",    //
                       "?..#....?",    // false
                       "?.......?",    //
                       "?#.?????#"});  // on a surface that no camera saw: not judged
  MapErrors e = evaluate_map(map, truth, Pose::Identity(), {.tolerance = 1});
  EXPECT_EQ(e.occupied, 8);
  EXPECT_EQ(e.occupied_not_judged, 1);
  EXPECT_EQ(e.occupied_right, 6);
  EXPECT_NEAR(e.occupied_precision(), 100.0 * 6 / 7, 1e-9);
  EXPECT_EQ(e.true_occupied, 8);
  EXPECT_EQ(e.found, 8);
  EXPECT_EQ(e.free_wrong, 0);
  // 5 right ones at no distance, the one in the corner as well, the false one 2 cells from the unseen wall.
  EXPECT_NEAR(e.distance_mean, 0.2 / 7, 1e-6);

  // Exactly: the missing cells are missing, and the free ones there are holes in the wall.
  e = evaluate_map(map, truth, Pose::Identity(), {.tolerance = 0});
  EXPECT_EQ(e.found, 6);
  EXPECT_EQ(e.free_wrong, 2);
  EXPECT_EQ(e.true_free, 28);
  EXPECT_EQ(e.found_free, 27);

  // Cells outside of the plan are wrong.
  map.origin_x += 0.3;
  e = evaluate_map(map, truth, Pose::Identity(), {.tolerance = 0});
  EXPECT_EQ(e.occupied_outside, 3);  // columns 6, 7 and 8 of 9 are moved by three
}

// A face, the other side of its thin wall, a thick wall of which both faces are seen, and what is drawn twice.
TEST(Map, ThicknessOfWallsIsCountedAcrossTheirFaces) {
  const GridMap truth = drawn({"..........",  //
                               "#?..#.#?#.",  //
                               "#?..#.#?#.",  //
                               "#?..#.#?#."});
  // The first row's free cells are beside faces as well: 4 of them above, of whose walls the map has those below.
  const auto thickness = [&](const std::vector<std::string>& rows) {
    return evaluate_map(drawn(rows), truth, Pose::Identity(), {});
  };
  MapErrors e = evaluate_map(truth, truth, Pose::Identity(), {});
  EXPECT_EQ(e.faces.faces, 4 + 12);  // from above; x = 4 on both sides, x = 6 and 8 on one
  EXPECT_EQ(e.faces.mean, 1);
  EXPECT_EQ(e.faces.median, 1);
  EXPECT_EQ(e.faces.most, 1);
  EXPECT_EQ(e.walls.faces, 0);  // too short
  e = thickness({"..........",  //
                 "#?.##.###.",  //
                 "#?.##.###.",  //
                 "#?.##.###."});
  EXPECT_EQ(e.faces.faces, 16);
  // Twice: the left faces of x = 4, as well as those of 6 and 8, by what is in the wall between them.
  EXPECT_NEAR(e.faces.mean, (16 + 9) / 16.0, 1e-12);
  EXPECT_EQ(e.faces.most, 2);
  // What stands before a face counts without the face.
  EXPECT_EQ(thickness({"#.........", "??????????", "??????????", "??????????"}).faces.faces, 1);
}

// Ten cells of a wall behind six free rows, one with a chair before it.
TEST(Map, ThicknessOfBareWallsLeavesOutWhatStandsBeforeThem) {
  std::vector<std::string> rows(7, "..............");
  rows.push_back("##############");
  rows.push_back("??????????????");
  const auto walls = [&](const std::vector<std::string>& map) {
    return evaluate_map(drawn(map), drawn(rows), Pose::Identity(), {}).walls;
  };
  std::vector<std::string> map = rows;
  map[8] = "##############";  // the wall is drawn twice
  EXPECT_EQ(walls(map).faces, 14 - 2 * MapErrors::kBeside);
  EXPECT_EQ(walls(map).mean, 2);
  map[6] = ".....#........";
  EXPECT_EQ(walls(map).median, 2);
  EXPECT_EQ(walls(map).most, 3);
  // The inside of a wall is full, whatever the map says of it.
  rows.push_back("##############");
  map.push_back("##############");
  EXPECT_EQ(walls(map).median, 1);
  EXPECT_EQ(walls(map).most, 2);
  rows.pop_back();
  map.pop_back();
  // A bed.
  std::vector<std::string> bed(7, "..............");
  bed.insert(bed.end(), 3, "##############");
  EXPECT_EQ(evaluate_map(drawn(bed), drawn(bed), Pose::Identity(), {}).walls.faces, 14 - 2 * MapErrors::kBeside);
  bed.push_back("##############");
  EXPECT_EQ(evaluate_map(drawn(bed), drawn(bed), Pose::Identity(), {}).walls.faces, 0);
  // If it stands there in truth, the faces beside it are not bare any more: 5 columns to the right are too short.
  rows[2] = "....#.........";
  EXPECT_EQ(walls(map).faces, 14 - 5 - 2 * MapErrors::kBeside);
  rows[2] = ".....#........";
  EXPECT_EQ(walls(map).faces, 0);
}

TEST(Map, FreeCellsThatNoCameraSawAreWrong) {
  const GridMap truth = drawn({"...#???", "...#???", "...#???"}), map = drawn({"...#...", "...#...", "...#..."});
  const MapErrors e = evaluate_map(map, truth, Pose::Identity(), {.tolerance = 1});
  EXPECT_EQ(e.free, 18);
  EXPECT_EQ(e.free_wrong, 0);
  EXPECT_EQ(e.free_unseen, 9);
  EXPECT_EQ(e.free_precision(), 50);
}

TEST(Map, TheTransformLaysTheMapOnThePlan) {
  std::vector<std::string> rows(40, std::string(60, '.'));
  rows[0] = rows[39] = std::string(60, '#');
  for (std::string& row : rows) row.front() = row[41] = '#';
  const GridMap truth = drawn(rows);
  // The same cells in a world that is turned and shifted: the yaw of the map file undoes it.
  Pose truth_from_estimate = Pose::Identity();
  truth_from_estimate.linear() = Eigen::AngleAxisd(0.7, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  truth_from_estimate.translation() = Eigen::Vector3d(3, -2, 9);
  GridMap map = truth;
  const Eigen::Vector3d origin = truth_from_estimate.inverse() * Eigen::Vector3d(truth.origin_x, truth.origin_y, 9);
  map.origin_x = origin.x();
  map.origin_y = origin.y();
  map.yaw = -0.7;
  const MapErrors e = evaluate_map(map, truth, truth_from_estimate, {.tolerance = 0});
  EXPECT_EQ(e.occupied_precision(), 100);
  EXPECT_EQ(e.occupied_recall(), 100);
  // Two cells aside: found with a tolerance of two only.
  truth_from_estimate.translation().x() += 0.2;
  EXPECT_LT(evaluate_map(map, truth, truth_from_estimate, {.tolerance = 1}).occupied_precision(), 80);
  EXPECT_EQ(evaluate_map(map, truth, truth_from_estimate, {.tolerance = 2}).occupied_recall(), 100);
  EXPECT_LT(evaluate_map(map, truth, Pose::Identity(), {.tolerance = 1}).occupied_precision(), 50);
}

TEST(Map, CellsAndWorldAgree) {
  GridMap map = drawn({"...", ".#.", "...", "..."});
  map.yaw = 0.4;
  for (int y = 0; y < 4; ++y) {
    for (int x = 0; x < 3; ++x) {
      const Eigen::Vector2d p = map.centre_of({x, y});
      EXPECT_EQ(map.cell_of(p.x(), p.y()), cv::Point(x, y));
    }
  }
  map.yaw = 0;
  EXPECT_EQ(map.at(map.cell_of(-0.3 + 0.15, 0.2 + 0.25)), Cell::occupied);  // third row from below
  EXPECT_EQ(map.at({-1, 0}), Cell::unknown);
}

TEST(Map, ThresholdsAreThoseOfRos) {
  const cv::Mat1b grey = (cv::Mat1b(1, 6) << 0, 32, 64, 205, 206, 254);
  const RosMapHeader header{.image = "", .resolution = 1};
  const GridMap map = grid_map(grey, header, false);
  // 205 is 0.19608: not below 0.196.
  const std::vector<Cell> expected = {Cell::occupied, Cell::occupied, Cell::occupied,
                                      Cell::unknown,  Cell::free,     Cell::free};
  for (int x = 0; x < 6; ++x) EXPECT_EQ(map.at({x, 0}), expected[static_cast<size_t>(x)]) << x;
  EXPECT_EQ(grid_map(grey, header, true).at({1, 0}), Cell::occupied_uncertain);
  RosMapHeader negated = header;
  negated.negate = true;
  EXPECT_EQ(grid_map(grey, negated, false).at({0, 0}), Cell::free);
}

TEST(Map, HeaderOfTheMapFile) {
  const RosMapHeader header = parse_ros_map(
      "image: map.pgm\nmode: trinary\nresolution: 0.05\norigin: [-0.25, -13.9, 0.5]\nnegate: 0\noccupied_thresh: 0.7\n"
      "free_thresh: 0.2\n",
      "map.yaml");
  EXPECT_EQ(header.image, "map.pgm");
  EXPECT_EQ(header.resolution, 0.05);
  EXPECT_EQ(header.origin_y, -13.9);
  EXPECT_EQ(header.yaw, 0.5);
  EXPECT_EQ(header.occupied_thresh, 0.7);
  EXPECT_FALSE(header.negate);
  EXPECT_EQ(header.bottom, header.top);
  const std::string map =
      "image: a.pgm\nresolution: 1\norigin: [0, 0, 0]\n# what stands between z = -0.1 m and 1.9 m\n";
  EXPECT_EQ(parse_ros_map(map, "map.yaml").bottom, -0.1);
  EXPECT_EQ(parse_ros_map(map, "map.yaml").top, 1.9);
}

TEST(Map, PictureShowsFoundMissingAndFalse) {
  const GridMap truth = drawn({"#....", ".....", "....#"}), map = drawn({"#....", "..#..", "....."});
  const cv::Mat3b p = map_picture(map, truth, Pose::Identity(), {.tolerance = 0});
  EXPECT_EQ(p(0, 0), cv::Vec3b(60, 120, 0));
  EXPECT_EQ(p(1, 2), cv::Vec3b(40, 30, 210));
  EXPECT_EQ(p(2, 4), cv::Vec3b(0, 150, 240));
  EXPECT_EQ(p(1, 0), cv::Vec3b(255, 255, 255));
}

}  // namespace
}  // namespace iris::evaluate
