// The map as a sheet for a report: true to a round scale on paper, with title block, legend, scale bar and metre grid.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "iris/core/options.h"
#include "iris/mapping/flog.h"
#include "iris/types/pose_graph.h"

namespace iris::exporters {

struct SheetOptions {
  std::string paper = "a4";          // a4, a3 or letter
  std::string orientation = "auto";  // auto, landscape or portrait; auto: the larger scale, then the shape of the map
  int scale = 0;                     // 1 : scale; 0 = the largest round one at which the map fits
  std::string cells = "grey";        // grey or heights: how cells are coloured
  bool grid = true;                  // metre grid
  bool path = true;                  // camera path
  bool loops = true;                 // and its loops
  std::string title;                 // empty = the session's name
  std::string note;                  // a line of one's own in the title block

  void declare(OptionSet& set);
};

// What the title block says besides scale and sheet: names and values in the order of printing.
struct SheetFacts {
  std::string title;  // unless the options give one
  std::string date;   // of the recording, as 2003-07-01T12:00:00Z
  std::vector<std::pair<std::string, std::string>> lines;
};

// By how much the path misses itself before loops are closed, as surveyors give it: of the loop with the longest way
// between its ends, how far apart the chained motions and the loop see its end.
struct ClosingError {
  int i = 0, j = 0;  // frames of the loop
  double error = 0;  // [m]
  double sigma = 0;  // [m] standard deviation of the place of j as the loop sees it, as its covariance states it
  double way = 0;    // [m] along the path between the frames
  int loops = 0;     // of the sub-map that come back
};
// Nothing if no loop of the refined graph lies within one sub-map of the chained one and comes back: to less than half
// of its way from where it began.
std::optional<ClosingError> closing_error(const PoseGraph& odometry, const PoseGraph& refined, int submap);

// Writes sheet.pdf, sheet.svg and sheet.png (200 dpi) into `folder`, the same drawing in each; the same input gives the
// same bytes. `submap`: which poses of `graph` belong to the map. Throws InputError if a file cannot be written, or if
// the map does not fit at the scale that was asked for.
void write_sheet(const std::filesystem::path& folder, const mapping::MapRaster& raster, const PoseGraph& graph,
                 int submap, const SheetFacts& facts, const SheetOptions& options);

}  // namespace iris::exporters
