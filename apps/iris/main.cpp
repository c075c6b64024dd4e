// iris: a table of subcommands.
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <filesystem>
#include <opencv2/core.hpp>
#include <opencv2/core/utils/logger.hpp>

#include "apps/iris/command.h"
#include "iris/core/error.h"
#include "iris/core/memory.h"

namespace iris::app {
namespace {

constexpr const char* kDescription =
    "IRIS turns a recorded stereo session into the camera's path, maps, a 3-D scene and a virtual tour.\n\n"
    "  iris run SESSION -o OUT      does everything; the same command again goes on after an interruption\n"
    "  iris info SESSION            says what was recorded\n\n"
    "Exit codes: 0 good, 1 bug, 2 wrong usage, 3 bad input, 4 finished but incomplete, 130 interrupted (run it again).";

void request_stop(int) {
  // A second Ctrl-C ends the program at once; the workspace stays good.
  if (stop_requested.exchange(true)) std::_Exit(kInterrupted);
}

// CLI11 says only that it does not know an option; say which one was probably meant.
int report_parse_error(const CLI::App& program, const CLI::ParseError& error) {
  if (error.get_exit_code() == static_cast<int>(CLI::ExitCodes::Success)) return program.exit(error);
  std::string message = error.what();
  if (program.get_subcommands().empty()) {
    std::vector<std::string> names;
    for (const CLI::App* command : program.get_subcommands({})) names.push_back(command->get_name());
    const std::vector<std::string> remaining = program.remaining();
    message = remaining.empty() ? "a command is missing" : fmt::format("'{}' is no command of iris", remaining.front());
    message += fmt::format("; choose from {}", fmt::join(names, ", "));
  }
  if (dynamic_cast<const CLI::ExtrasError*>(&error)) {
    exporters::RunOptions options;
    OptionSet set;
    options.declare(set);
    simulate::SimulateOptions simulated;
    simulated.declare(set);
    exporters::MeasureOptions measure;
    measure.declare(set);
    calibrate::CalibrateOptions calibrate;
    calibrate.declare(set);
    rectify::RowCheckOptions rectify;
    rectify.declare(set);
    for (const CLI::App* command : program.get_subcommands()) {
      for (const std::string& extra : command->remaining()) {
        if (!extra.starts_with("--")) continue;
        const std::string name = extra.substr(2, extra.find('=') - 2);
        const bool known = std::any_of(set.options().begin(), set.options().end(),
                                       [&](const OptionSet::Option& option) { return option.name == name; });
        if (known) {
          message = fmt::format("--{} is no option of 'iris {}'", name, command->get_name());
          continue;
        }
        try {
          set.set(name, "");
        } catch (const UsageError& unknown) {
          message = unknown.what();
        }
      }
    }
  }
  fmt::print(stderr, "iris: {}\nRun with --help for the commands and options.\n", message);
  return kUsage;
}

int run(int argc, char** argv) {
  auto console = spdlog::stderr_color_mt("iris");
  console->set_pattern("%^%v%$");
  spdlog::set_default_logger(console);
  cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  cv::setNumThreads(1);  // frames run in parallel, not the inside of OpenCV's functions
  std::signal(SIGINT, request_stop);
  std::signal(SIGTERM, request_stop);

  CLI::App program(kDescription, "iris");
  program.set_version_flag("--version", "iris " IRIS_VERSION);
  program.require_subcommand(1);
  const std::vector<std::pair<std::string, Command>> commands = {
      {"run", add_run(program)},           {"info", add_info(program)},
      {"rectify", add_rectify(program)},   {"stereo", add_stereo(program)},
      {"export", add_export(program)},     {"tour", add_tour(program)},
      {"simulate", add_simulate(program)}, {"evaluate", add_evaluate(program)},
      {"measure", add_measure(program)},   {"calibrate", add_calibrate(program)},
  };
  // CLI11 takes -0.5,1 for a value and -.5,1 for an option.
  std::vector<std::string> arguments(argv + 1, argv + argc);
  for (std::string& text : arguments) {
    if (text.size() > 2 && text.starts_with("-.") && text[2] >= '0' && text[2] <= '9') text.insert(1, "0");
  }
  std::reverse(arguments.begin(), arguments.end());  // as it wants them
  try {
    program.parse(arguments);
  } catch (const CLI::ParseError& error) {
    return report_parse_error(program, error);
  }
  try {
    for (const auto& [name, command] : commands) {
      if (!program.got_subcommand(name)) continue;
      const int code = command();
      if (std::fflush(stdout) != 0)
        throw InputError("standard output", "cannot be written", "see that its disk has space");
      return code;
    }
    throw Bug("no subcommand");
  } catch (const UsageError& error) {
    spdlog::error("iris: {}", error.what());
    return kUsage;
  } catch (const InputError& error) {
    spdlog::error("iris: {}", error.what());
    return kBadInput;
  } catch (const Interrupted&) {
    spdlog::warn("interrupted; give the same command again ('iris run' and 'iris simulate' go on where they stopped)");
    return kInterrupted;
  } catch (const std::filesystem::filesystem_error& error) {
    spdlog::error("iris: {}: {}; check the folder and its permissions", error.path1().string(), error.code().message());
    return kBadInput;
  } catch (const std::exception& error) {
    spdlog::error("iris: this is a bug, please report it: {}", error.what());
    return kBug;
  }
}

}  // namespace
}  // namespace iris::app

int main(int argc, char** argv) {
  iris::keep_freed_memory();
  return iris::app::run(argc, argv);
}
