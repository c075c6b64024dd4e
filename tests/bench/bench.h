// Benchmarks in comparisons: IRIS and its peers do the same work on the same input in one run.
#pragma once

#include <benchmark/benchmark.h>

#include <filesystem>
#include <functional>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "iris/core/parallel.h"

namespace iris::bench {

// One that does the work. `run` prepares what is not timed, then calls measure().
struct Contender {
  std::string who;
  std::function<void(benchmark::State&)> run;
};

// Registers the benchmarks "stage/work/input/who", one a contender; the table compares the first with each of the
// others. No name contains a slash. Work of several threads or programs has no use for processor time and is left out
// when that is measured.
enum class Uses { one_thread, several };
void compare(const std::string& stage, const std::string& work, const std::string& input,
             const std::vector<Contender>& contenders, Uses uses = Uses::one_thread);

// Times body() on so many threads, those of IRIS and of OpenCV. It is called once before, untimed: the first call pays
// for memory and tables.
template <typename Body>
void measure(benchmark::State& state, int threads, Body&& body) {
  cv::setNumThreads(threads);
  with_threads(threads, [&] {
    body();
    for (auto _ : state) body();
  });
}

// `amount` of something a call, shown as `unit`, which ends with "/s".
inline void set_rate(benchmark::State& state, const char* unit, double amount) {
  state.counters[unit] = benchmark::Counter(amount, benchmark::Counter::kIsIterationInvariantRate);
}

// The benchmarks of one or two stages each. quick: whole runs of a few frames only.
void register_session();
void register_rectify();
void register_stereo();
void register_motion();
void register_mapping();
void register_render();
void register_views();
void register_run(bool quick);

// Does what is named `work` once, on the pair of 640x480 with 64 disparities, inside of iris::bench::counted(), where
// callgrind counts. Prints the number of pixels times disparities. False if there is no such work.
bool count_instructions(const std::string& work);

// Prints how good the disparities are, IRIS's and its peers'.
void print_quality();
// Prints how good maps are, IRIS's and OctoMap's, of the same views of a simulated recording with its truth.
void print_map_quality(const std::filesystem::path& apartment);
// Prints how good novel views are.
struct ViewQualityOptions {
  std::string only;       // part of a case's name; empty = all
  std::string apartment;  // folder of a simulated recording with its truth; empty = without it
  std::string pictures;   // folder for some of the pictures beside the truth; empty = none
};
void print_view_quality(const ViewQualityOptions& options);
// Builds the octree of a large site and prints what it takes.
void print_large_octree();

}  // namespace iris::bench
