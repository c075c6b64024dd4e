// The figures of an evaluation, and how they are shown: as text for a terminal and as JSON.
#pragma once

#include <string>
#include <variant>
#include <vector>

namespace iris::exporters {

// One measured value; NaN = nothing to measure it on. `name` is its key in JSON; lengths are in metres there whatever
// the text shows.
struct Figure {
  std::string name, label;
  double value = 0;
  std::string unit;  // "m", "deg", "deg/m", "%", "px", "dB", "s", "grey" (of 255), "1" (a ratio) or empty (a count)
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

  // The most important figures of all sections in one line; empty if there are none.
  std::string summary() const;
  // For a terminal, the summary first; lines of at most 120 characters (but for longer file names).
  std::string text() const;
  // {"estimate", "truth", section: {"notes": […], figure: value, table: [{column: value}]}}; not finite = null.
  std::string json() const;
};

}  // namespace iris::exporters
