// Compares the output of a run, or single files, with the truth: reads both, collects all figures, draws plots.
#pragma once

#include <filesystem>
#include <string>
#include <variant>
#include <vector>

#include "iris/evaluate/disparities.h"
#include "iris/evaluate/map.h"
#include "iris/evaluate/trajectory.h"

namespace iris::exporters {

// One measured value. `name` is its key in JSON; lengths are in metres there whatever the text shows.
struct Figure {
  std::string name, label;
  double value = 0;
  std::string unit;  // "m", "deg", "deg/m", "%", "px", "dB", "s" or empty (a count or ratio)
};

struct FigureTable {
  struct Column {
    std::string name, label;
    int digits = 2;  // behind the point
  };
  std::string name, title;
  std::vector<Column> columns;
  std::vector<std::vector<std::variant<std::string, double>>> rows;
};

// "trajectory", "disparities", "map" or "image".
struct FigureSection {
  std::string name, title;
  std::vector<std::string> notes;  // what was compared, and how
  std::vector<Figure> figures;
  std::vector<FigureTable> tables;
};

struct Evaluation {
  std::string estimate, truth;
  std::vector<FigureSection> sections;

  std::string text() const;  // for a terminal, lines of at most 120 characters
  std::string json()
      const;  // {"estimate", "truth", section: {figure: value, table: [{column: value}]}}; not finite = null
};

struct EvaluationRequest {
  std::filesystem::path estimate;  // output folder of a run, or a file
  std::filesystem::path truth;     // a session with truth/, its truth folder, or a file
  std::string kind = "auto";       // of files: auto | trajectory | disparity | map | image
  std::string mask;                // images: file (255 = compare), or "black": black pixels of the estimate are holes
  double truth_scale = 0;          // disparities: grey levels a pixel; 0 = 256 for 16-bit images, else must be given
  evaluate::TrajectoryOptions trajectory;
  evaluate::DisparityOptions disparity;
  evaluate::MapOptions map;
  std::vector<int> views;       // error pictures of these frames; empty = first, middle and last
  std::filesystem::path plots;  // folder for PNG and SVG; empty = none
};

// Of an output folder everything that the truth knows about is evaluated. Throws InputError (no common time, other
// image sizes, nothing to compare, damaged files).
Evaluation evaluate_files(const EvaluationRequest& request);

}  // namespace iris::exporters
