#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spdlog/sinks/sink.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <cmath>

#include "apps/iris/command.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"

namespace iris::app {
namespace {

std::string value_type(const OptionSet::Option& option) {
  if (std::holds_alternative<bool*>(option.value)) return "true|false";
  if (!option.choices.empty()) return fmt::format("{}", fmt::join(option.choices, "|"));
  if (!option.unit.empty()) return option.unit;
  static constexpr const char* kTypes[] = {"", "N", "X", "TEXT"};
  return kTypes[option.value.index()];
}

}  // namespace

std::atomic<bool> stop_requested = false;

Arguments::Arguments(CLI::App& command, const std::vector<std::string>& sections) {
  options.declare(set);
  if (std::find(sections.begin(), sections.end(), "simulate") != sections.end()) simulate.declare(set);
  if (std::find(sections.begin(), sections.end(), "measure") != sections.end()) measure.declare(set);
  if (std::find(sections.begin(), sections.end(), "calibrate") != sections.end()) calibrate.declare(set);
  if (std::find(sections.begin(), sections.end(), "rectify") != sections.end()) rectify.declare(set);
  command.add_option("--config", config_, "TOML file with options (stereo.disparities = 64); the command line wins")
      ->type_name("FILE")
      ->group("General");
  command
      .add_option("--threads", threads_, "Threads to use; 0 = one for each processor. The result does not depend on it")
      ->type_name("N")
      ->check(CLI::Range(0, 1024))
      ->default_str("0")
      ->group("General");
  command.add_flag("--quiet", quiet_, "Warnings and errors only")->group("General");
  command.add_flag("--json-progress", json_progress_, "Progress as JSON lines on stderr, for other programs")
      ->group("General");
  for (const OptionSet::Option& option : set.options()) {
    const std::string section = option.name.substr(0, option.name.find('.'));
    if (std::find(sections.begin(), sections.end(), section) == sections.end()) continue;
    command
        .add_option_function<std::string>(
            "--" + option.name + (option.name == "loop.up" ? ",--up" : ""),
            [this, name = option.name](const std::string& text) { given_.emplace_back(name, text); }, option.help)
        ->type_name(value_type(option))
        ->default_str(option.default_text)
        ->group(section);
  }
}

void Arguments::resolve(const std::filesystem::path& saved) {
  if (!saved.empty()) {
    if (const std::vector<std::string> unknown = set.read_saved_toml(saved); !unknown.empty()) {
      spdlog::warn("{}: this version has no option {}; left out", saved.string(), fmt::join(unknown, ", "));
    }
  }
  if (!config_.empty()) set.read_toml(config_);
  set.set_all(given_);
  set.validate();
  if (options.library.tour.width % 2 != 0 || options.library.tour.height % 2 != 0) {
    throw UsageError("tour.width and tour.height must be even: the video format wants it");
  }
  // What would be found to be wrong only when its stage has come.
  loop::check(options.library.alignment);
  exporters::mesh_formats(options.mesh);
  // The console alone: the log file of a run keeps everything.
  if (quiet_) spdlog::default_logger()->sinks().front()->set_level(spdlog::level::warn);
}

int Arguments::threads() const { return threads_ > 0 ? threads_ : available_threads(); }

pipeline::RunControl Arguments::control() const {
  ProgressStyle style = isatty(STDERR_FILENO) ? ProgressStyle::bar : ProgressStyle::lines;
  if (json_progress_) style = ProgressStyle::json;
  if (quiet_) style = ProgressStyle::quiet;
  return {.progress = style, .stop = &stop_requested};
}

std::set<std::string> Arguments::given(const std::string& section) const {
  std::set<std::string> names;
  for (const auto& [name, text] : given_) {
    if (name.starts_with(section + ".")) names.insert(name.substr(section.size() + 1));
  }
  return names;
}

void write_options(const std::filesystem::path& out, const OptionSet& set) {
  write_file(
      out / "options.toml",
      "# The options of this result; 'iris run SESSION -o OUT --config options.toml' repeats it.\n" + set.to_toml());
}

}  // namespace iris::app
