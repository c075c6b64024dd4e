// Compares the output of a run, or single files, with the truth: reads both, collects all figures, draws plots.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "export/evaluation_report.h"
#include "iris/evaluate/disparities.h"
#include "iris/evaluate/map.h"
#include "iris/evaluate/trajectory.h"

namespace iris::exporters {

struct EvaluationRequest {
  std::filesystem::path estimate;  // output folder of a run, or a file
  std::filesystem::path truth;     // a session with truth/, its truth folder, or a file
  std::string kind = "auto";       // of files: auto | trajectory | disparity | map | image
  std::string mask;                // images: file (255 = compare), or "black": black pixels of the estimate are holes
  double truth_scale = 0;          // disparities: grey levels of the truth a pixel; 0 = 256 for 16-bit, others need it
  evaluate::TrajectoryOptions trajectory;
  evaluate::DisparityOptions disparity;
  evaluate::MapOptions map;
  std::vector<int> views;       // error pictures of these frames; empty = first, middle and last
  std::filesystem::path plots;  // folder for PNG and SVG; empty = none
};

// What is going to be compared: of an output folder trajectory, disparity and map, or, if the truth is a file,
// trajectory alone; of files their kind as in `kind`. Throws InputError as evaluate_files does.
std::vector<std::string> compared_kinds(const EvaluationRequest& request);

// Of an output folder everything that the truth knows about is evaluated. Throws InputError (no common time, other
// image sizes, nothing to compare, damaged files).
Evaluation evaluate_files(const EvaluationRequest& request);

}  // namespace iris::exporters
