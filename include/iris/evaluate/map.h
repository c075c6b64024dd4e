// Errors of a map from above against a true plan (thesis 6.4).
#pragma once

#include <cstdint>
#include <limits>
#include <opencv2/core.hpp>

#include "iris/evaluate/formats.h"
#include "iris/geometry/pose.h"

namespace iris::evaluate {

enum class Cell : uint8_t {
  unknown = 0,
  free = 1,
  occupied = 2,
  occupied_uncertain = 3,  // of true plans: a surface without texture or that no camera saw; need not be found
};

struct GridMap {
  cv::Mat1b cells;                             // Cell; row 0 = largest y
  double resolution = 0;                       // [m]
  double origin_x = 0, origin_y = 0, yaw = 0;  // [m], [rad] lower-left corner of the lower-left cell in the world

  // Cell that holds a point of the world (may lie outside).
  cv::Point cell_of(double x, double y) const;
  // Centre of a cell in the world.
  Eigen::Vector2d centre_of(cv::Point cell) const;
  // unknown outside.
  Cell at(cv::Point cell) const;
};

// Cells by the thresholds of the header, as ROS's trinary mode reads them. `plan`: grey values that
// simulate::PlanValue names as plain or unseen become occupied_uncertain.
GridMap grid_map(const cv::Mat1b& grey, const RosMapHeader& header, bool plan);

struct MapOptions {
  int tolerance = 1;  // [cells] of the true plan, in each direction (Chebyshev distance)
};

struct MapErrors {
  // Estimated occupied cells.
  int64_t occupied = 0;             // all
  int64_t occupied_right = 0;       // a true occupied cell is within the tolerance
  int64_t occupied_not_judged = 0;  // only an uncertain one is
  int64_t occupied_outside = 0;     // of the wrong ones: outside of the plan
  // True occupied cells (seen, textured).
  int64_t true_occupied = 0;
  int64_t found = 0;  // an estimated occupied cell is within the tolerance
  // Estimated free cells.
  int64_t free = 0;
  int64_t free_wrong = 0;   // truly occupied, and no estimated occupied cell is within the tolerance: a hole in a wall
  int64_t free_unseen = 0;  // others without a truly free cell within the tolerance: no camera saw that it is free
  int64_t true_free = 0;
  int64_t found_free = 0;  // an estimated free cell is within the tolerance
  // [m] from the estimated occupied cells that are judged to the nearest true occupied cell of any kind.
  // NaN if there is none.
  double distance_mean = std::numeric_limits<double>::quiet_NaN(), distance_median = distance_mean,
         distance_rms = distance_mean;
  // Thickness of walls in the map [cells of the plan], over the faces of true surfaces (seen, textured, beside a free
  // cell, in one of the four directions) at which the map has anything: occupied cells on the line across the face, at
  // it, before it, and behind it inside the wall, up to kAcross away or to the next true surface. A wall that is drawn
  // once is 1 to 2 cells thick, one that is drawn twice 2 and more. NaN if there is no such face.
  static constexpr int kAcross = 6;
  struct Thickness {
    int64_t faces = 0;
    double mean = std::numeric_limits<double>::quiet_NaN(), median = mean;
    double most = mean;  // of 95 % of them
  };
  Thickness faces;
  // Of them those of bare walls: straight for kBeside cells to both sides, with nothing but free space before it in
  // the truth, kAcross cells far. What the map has of furniture is not counted as a part of the wall here, nor is what
  // it has inside of a wall of which the other face is within kAcross as well: there, the wall is as thick as that.
  // Beds and tables are no walls: their surfaces are more than kThin cells deep.
  static constexpr int kBeside = 4, kThin = 3;
  Thickness walls;

  // [%]; NaN if there is nothing to judge.
  double occupied_precision() const;
  double occupied_recall() const;
  double free_precision() const;  // both kinds of wrong ones count
  double free_recall() const;
};

// `truth_from_estimate`: world of the truth from the world of the map; its translation and its turn about z are used.
MapErrors evaluate_map(const GridMap& estimate, const GridMap& truth, const Pose& truth_from_estimate,
                       const MapOptions& options);

// The truth's cells with the estimate on it (BGR): dark green found, red wrong, orange missing, grey uncertain, white
// free in the estimate, light grey free in the truth only.
cv::Mat3b map_picture(const GridMap& estimate, const GridMap& truth, const Pose& truth_from_estimate,
                      const MapOptions& options);

}  // namespace iris::evaluate
