// The ordered table of stages: run what is not finished, skip what is, resume what was interrupted.
#pragma once

#include <atomic>
#include <functional>
#include <string>
#include <vector>

#include "iris/core/options.h"
#include "iris/core/progress.h"
#include "iris/workspace/workspace.h"

namespace iris::pipeline {

// How a run talks to its user and hears of an interruption.
struct RunControl {
  ProgressStyle progress = ProgressStyle::quiet;
  const std::atomic<bool>* stop = nullptr;  // set by Ctrl-C; may be null

  bool stopped() const { return stop && stop->load(); }
};

// One row of the table. A stage is finished when its record carries the fingerprint of everything its result depends
// on: its inputs, its option sections, the stages before it and the program's version.
struct Stage {
  std::string name;
  std::vector<std::string> sections;  // options that change its result
  std::vector<std::string> after;     // stages whose results it uses
  std::string inputs;                 // text that identifies what it reads from outside the workspace
  // Does the work; returns the files it wrote, relative to the output folder. Gets its own fingerprint, so that a stage
  // which keeps partial results can tell whether they are still good.
  std::function<std::vector<std::string>(workspace::Workspace&, const RunControl&, const std::string& fingerprint)> run;
};

// Runs the unfinished ones of `stages` in order; stages they depend on stand before them or are finished. Throws
// Interrupted between stages (and stages throw it themselves). Returns the names of the stages that ran.
std::vector<std::string> run_stages(const std::vector<Stage>& stages, const OptionSet& options,
                                    workspace::Workspace& workspace, const RunControl& control);

}  // namespace iris::pipeline
