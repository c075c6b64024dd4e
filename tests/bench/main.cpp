// iris_bench [--quick] [--processor-time] [options of Google Benchmark]: IRIS beside its peers; prints a table in
// Markdown. --processor-time: of one thread, instead of elapsed time; for a machine that others use as well.
// iris_bench --quality: errors of the disparities instead of times.
// iris_bench --apartment=FOLDER --maps: errors of maps, beside OctoMap's.
// iris_bench [--apartment=FOLDER] [--case=PART OF NAME] [--pictures=FOLDER] --views: how good novel views are; FOLDER
// is what `iris simulate apartment` made. iris_bench --count=WORK: does WORK once, for a tool that counts instructions.
#include <fmt/chrono.h>
#include <fmt/format.h>
#include <hwy/highway.h>
#include <spdlog/spdlog.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <map>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "bench/bench.h"
#include "iris/core/memory.h"
#include "iris/core/parallel.h"

namespace iris::bench {
namespace {

// Comparisons in the order of the table; the contenders' names.
struct Comparison {
  std::string stage, work, input;
  std::vector<std::string> contenders;
};
std::vector<Comparison>& comparisons() {
  static std::vector<Comparison> list;
  return list;
}

bool processor_time_only = false;

std::string benchmark_name(const Comparison& comparison, const std::string& who) {
  return fmt::format("{}/{}/{}/{}", comparison.stage, comparison.work, comparison.input, who);
}

std::string cpu_model() {
  std::ifstream lines("/proc/cpuinfo");
  for (std::string line; std::getline(lines, line);) {
    if (line.starts_with("model name")) return line.substr(line.find(':') + 2);
  }
  return "unknown processor";
}

// Processor time [s]: of everything on this machine, and of this program with its children.
struct ProcessorTime {
  double all = 0, own = 0;
};
ProcessorTime processor_time() {
  ProcessorTime time;
  std::ifstream file("/proc/stat");
  std::string cpu;
  double user = 0, nice = 0, system = 0;
  file >> cpu >> user >> nice >> system;
  time.all = (user + nice + system) / static_cast<double>(sysconf(_SC_CLK_TCK));
  for (const int who : {RUSAGE_SELF, RUSAGE_CHILDREN}) {
    rusage used{};
    getrusage(who, &used);
    time.own += static_cast<double>(used.ru_utime.tv_sec + used.ru_stime.tv_sec) +
                1e-6 * static_cast<double>(used.ru_utime.tv_usec + used.ru_stime.tv_usec);
  }
  return time;
}

// Keeps the repetitions of each benchmark; prints the table at the end.
class RatioTable : public benchmark::BenchmarkReporter {
 public:
  bool ReportContext(const Context&) override {
    const std::time_t now = std::time(nullptr);
    fmt::print("{:%Y-%m-%d}: {}, {} processors, {}; OpenCV {}, GCC {}.{}.\n\n", *std::localtime(&now), cpu_model(),
               available_threads(), hwy::TargetName(hwy::SupportedAndGeneratedTargets().front()), CV_VERSION, __GNUC__,
               __GNUC_MINOR__);
    std::fflush(stdout);
    return true;
  }

  void ReportRuns(const std::vector<Run>& runs) override {
    Measured measured;
    for (const Run& run : runs) {
      if (run.run_type != Run::RT_Iteration) continue;
      if (run.error_occurred) {
        fmt::print(stderr, "{}: {}\n", run.run_name.function_name, run.error_message);
        failed_ = true;
        return;
      }
      const double seconds = (processor_time_only ? run.cpu_accumulated_time : run.real_accumulated_time) /
                             static_cast<double>(run.iterations);
      if (measured.seconds.empty() || seconds < *std::min_element(measured.seconds.begin(), measured.seconds.end())) {
        measured.counters = run.counters;
      }
      measured.seconds.push_back(seconds);
    }
    if (measured.seconds.empty()) return;
    std::sort(measured.seconds.begin(), measured.seconds.end());
    fmt::print(stderr, "{:10.3f} ms  {}\n", 1e3 * measured.seconds.front(), runs.front().run_name.function_name);
    measured_[runs.front().run_name.function_name] = measured;
  }

  void Finalize() override {
    fmt::print("| stage | work | input | IRIS [ms] | | peer | peer [ms] | ratio |\n|-|-|-|-:|-|-|-:|-:|\n");
    for (const Comparison& comparison : comparisons()) {
      const auto ours = measured_.find(benchmark_name(comparison, comparison.contenders.front()));
      if (ours == measured_.end()) continue;
      const std::string row = fmt::format("| {} | {} | {} | {} | {} |", comparison.stage, comparison.work,
                                          comparison.input, milliseconds(ours->second), rates(ours->second));
      bool compared = false;
      for (size_t i = 1; i < comparison.contenders.size(); ++i) {
        const auto peer = measured_.find(benchmark_name(comparison, comparison.contenders[i]));
        if (peer == measured_.end()) continue;
        fmt::print("{} {} | {} | {:.2f} |\n", row, comparison.contenders[i], milliseconds(peer->second),
                   ours->second.seconds.front() / peer->second.seconds.front());
        compared = true;
      }
      if (!compared) fmt::print("{} | | |\n", row);
    }
    std::vector<double> spread;
    for (const auto& [name, measured] : measured_) {
      if (measured.seconds.size() > 1) {
        spread.push_back(measured.seconds[measured.seconds.size() / 2] / measured.seconds.front() - 1);
      }
    }
    if (!spread.empty()) {
      std::sort(spread.begin(), spread.end());
      fmt::print(
          "\n{} are minima over the repetitions. Their medians lie {:.0f} % above them (median of all rows; at most "
          "{:.0f} %).",
          processor_time_only ? "Processor times" : "Times", 100 * spread[spread.size() / 2], 100 * spread.back());
    }
    const ProcessorTime end = processor_time();
    const double elapsed = std::chrono::duration<double>(std::chrono::steady_clock::now() - start_time_).count();
    const double others = (end.all - start_.all) - (end.own - start_.own);
    fmt::print("\nOther programs kept {:.2f} of {} processors busy during the run{}.\n",
               std::max(0.0, others / elapsed), available_threads(),
               !processor_time_only && others > 0.1 * elapsed ? ": measure again when the machine is quiet" : "");
  }

  bool failed() const { return failed_; }

 private:
  struct Measured {
    std::vector<double> seconds;  // ascending, one a repetition
    benchmark::UserCounters counters;
  };

  static std::string milliseconds(const Measured& measured) {
    const double ms = 1e3 * measured.seconds.front();
    return ms >= 100 ? fmt::format("{:.0f}", ms) : ms >= 10 ? fmt::format("{:.1f}", ms) : fmt::format("{:.3f}", ms);
  }

  static std::string rates(const Measured& measured) {
    std::string text;
    for (const auto& [unit, counter] : measured.counters) {
      const double value = counter.value;
      text += text.empty() ? "" : ", ";
      text += value >= 100 ? fmt::format("{:.0f} {}", value, unit) : fmt::format("{:.3g} {}", value, unit);
    }
    return text;
  }

  const ProcessorTime start_ = processor_time();
  const std::chrono::steady_clock::time_point start_time_ = std::chrono::steady_clock::now();
  std::map<std::string, Measured> measured_;
  bool failed_ = false;
};

}  // namespace

void compare(const std::string& stage, const std::string& work, const std::string& input,
             const std::vector<Contender>& contenders, Uses uses) {
  if (processor_time_only && uses == Uses::several) return;
  Comparison comparison{.stage = stage, .work = work, .input = input};
  for (const Contender& contender : contenders) {
    comparison.contenders.push_back(contender.who);
    auto* registered = benchmark::RegisterBenchmark(benchmark_name(comparison, contender.who).c_str(), contender.run);
    registered->MeasureProcessCPUTime()->Unit(benchmark::kMillisecond);
    if (!processor_time_only) registered->UseRealTime();
  }
  comparisons().push_back(comparison);
}

}  // namespace iris::bench

int main(int argc, char** argv) {
  iris::keep_freed_memory();  // as the program does; the peers gain as well
  spdlog::set_level(spdlog::level::err);
  bool quick = false;
  iris::bench::ViewQualityOptions view_quality;
  std::vector<std::string> arguments = {argv[0], "--benchmark_enable_random_interleaving=true"};
  for (int i = 1; i < argc; ++i) {
    const std::string argument = argv[i];
    if (argument.starts_with("--count=")) {
      if (iris::bench::count_instructions(argument.substr(8))) return 0;
      fmt::print(stderr, "iris_bench: cannot count {}\n", argument.substr(8));
      return 2;
    }
    if (argument == "--quality") {
      iris::bench::print_quality();
      return 0;
    }
    if (argument == "--maps") {
      if (view_quality.apartment.empty()) {
        fmt::print(stderr, "iris_bench: --maps needs --apartment=FOLDER before it\n");
        return 2;
      }
      iris::bench::print_map_quality(view_quality.apartment);
      return 0;
    }
    if (argument.starts_with("--apartment=")) {
      view_quality.apartment = argument.substr(12);
      continue;
    }
    if (argument.starts_with("--case=")) {
      view_quality.only = argument.substr(7);
      continue;
    }
    if (argument.starts_with("--pictures=")) {
      view_quality.pictures = argument.substr(11);
      continue;
    }
    if (argument == "--views") {
      iris::bench::print_view_quality(view_quality);
      return 0;
    }
    if (argument == "--octree") {
      iris::bench::print_large_octree();
      return 0;
    }
    if (argument == "--quick") {
      quick = true;
    } else if (argument == "--processor-time") {
      iris::bench::processor_time_only = true;
    } else {
      arguments.push_back(argument);
    }
  }
  // Before what was given, so that this prevails.
  arguments.insert(arguments.begin() + 1, {quick ? "--benchmark_repetitions=1" : "--benchmark_repetitions=7",
                                           quick ? "--benchmark_min_time=0.02" : "--benchmark_min_time=0.2"});
  std::vector<char*> pointers;
  for (std::string& argument : arguments) pointers.push_back(argument.data());
  int count = static_cast<int>(pointers.size());
  benchmark::Initialize(&count, pointers.data());
  if (benchmark::ReportUnrecognizedArguments(count, pointers.data())) return 2;

  iris::bench::register_session();
  iris::bench::register_rectify();
  iris::bench::register_stereo();
  iris::bench::register_motion();
  iris::bench::register_views();
  iris::bench::register_mapping();
  iris::bench::register_render();
  iris::bench::register_run(quick);
  iris::bench::RatioTable table;
  benchmark::RunSpecifiedBenchmarks(&table);
  benchmark::Shutdown();
  return table.failed() ? 1 : 0;
}
