// What the subcommands share: one entry of main's table, the options that every command takes, set-up of log and
// threads.
#pragma once

#include <CLI/CLI.hpp>
#include <atomic>
#include <filesystem>
#include <functional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "export/measurement.h"
#include "export/products.h"
#include "iris/calibrate/options.h"
#include "iris/core/options.h"
#include "iris/core/progress.h"
#include "iris/pipeline/pipeline.h"
#include "iris/rectify/row_check.h"
#include "iris/simulate/options.h"

namespace iris::app {

enum ExitCode { kGood = 0, kBug = 1, kUsage = 2, kBadInput = 3, kIncomplete = 4, kInterrupted = 130 };

// Set by Ctrl-C.
extern std::atomic<bool> stop_requested;

// The options of a command: those of the stages it runs, and --config, --threads, --quiet, --json-progress.
class Arguments {
 public:
  // Adds options whose section is in `sections` to the command's help; all others stay at their defaults.
  Arguments(CLI::App& command, const std::vector<std::string>& sections);
  Arguments(const Arguments&) = delete;
  Arguments& operator=(const Arguments&) = delete;

  // After parsing: the command line over --config over `saved` (the options of an earlier run; may be empty) over the
  // defaults; checks all ranges. Sets the console's log level.
  void resolve(const std::filesystem::path& saved = {});

  exporters::RunOptions options;
  simulate::SimulateOptions simulate;     // declared if "simulate" is among the sections: no part of a run
  calibrate::CalibrateOptions calibrate;  // declared if "calibrate" is
  rectify::RowCheckOptions rectify;       // declared if "rectify" is
  exporters::MeasureOptions measure;      // declared if "measure" is: likewise
  OptionSet set;                          // refers to the options above

  int threads() const;
  pipeline::RunControl control() const;
  // The names of the options of a section that stand on the command line itself.
  std::set<std::string> given(const std::string& section) const;

 private:
  std::string config_;
  int threads_ = 0;
  bool quiet_ = false;
  bool json_progress_ = false;
  std::vector<std::pair<std::string, std::string>> given_;
};

// Saves the effective options beside the result.
void write_options(const std::filesystem::path& out, const OptionSet& set);

// For -o: an empty name would mean the current folder.
inline const CLI::Validator kNotEmpty([](std::string& text) { return text.empty() ? "the name is empty" : ""; }, "");

// A subcommand: adds itself to the program and returns what runs it (the exit code is its result).
using Command = std::function<int()>;
Command add_run(CLI::App& program);
Command add_info(CLI::App& program);
Command add_calibrate(CLI::App& program);
Command add_rectify(CLI::App& program);
Command add_simulate(CLI::App& program);
Command add_stereo(CLI::App& program);
Command add_export(CLI::App& program);
Command add_tour(CLI::App& program);
Command add_measure(CLI::App& program);
Command add_evaluate(CLI::App& program);

}  // namespace iris::app
