// Progress of long work: a bar with rate and time left on a terminal, plain lines otherwise, JSON lines for programs.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>

namespace iris {

enum class ProgressStyle { quiet, lines, bar, json };

// One task of `total` steps. Used from one thread.
class Progress {
 public:
  Progress(ProgressStyle style, std::string task, int64_t total);
  ~Progress();  // ends the bar's line
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  // `done` of the total steps are finished.
  void update(int64_t done);

 private:
  using Clock = std::chrono::steady_clock;
  void print(int64_t done, Clock::time_point now);

  ProgressStyle style_;
  std::string task_;
  int64_t total_;
  int64_t first_done_ = -1;  // a resumed task does not count earlier work into its rate
  Clock::time_point start_;
  Clock::time_point last_print_;
  bool printed_ = false;
};

}  // namespace iris
