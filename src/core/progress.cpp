#include "iris/core/progress.h"

#include <fmt/format.h>

#include <cmath>
#include <cstdio>

namespace iris {
namespace {

std::string duration_text(double seconds) {
  const int64_t s = std::llround(seconds);
  if (s < 60) return fmt::format("{} s", s);
  if (s < 3600) return fmt::format("{}:{:02} min", s / 60, s % 60);
  return fmt::format("{}:{:02} h", s / 3600, s / 60 % 60);
}

}  // namespace

Progress::Progress(ProgressStyle style, std::string task, int64_t total)
    : style_(style), task_(std::move(task)), total_(total), start_(Clock::now()), last_print_(start_) {}

Progress::~Progress() {
  if (style_ == ProgressStyle::bar && printed_) std::fputc('\n', stderr);
}

void Progress::update(int64_t done) {
  if (style_ == ProgressStyle::quiet) return;
  const auto now = Clock::now();
  if (first_done_ < 0) {
    first_done_ = done;
    start_ = now;
  }
  const double since = std::chrono::duration<double>(now - last_print_).count();
  const double every = style_ == ProgressStyle::lines ? 5.0 : style_ == ProgressStyle::json ? 0.5 : 0.1;
  if (done < total_ && since < every) return;
  print(done, now);
}

void Progress::print(int64_t done, Clock::time_point now) {
  const double elapsed = std::chrono::duration<double>(now - start_).count();
  const int64_t here = done - first_done_;
  const double rate = elapsed > 0 && here > 0 ? static_cast<double>(here) / elapsed : 0;
  const double left = rate > 0 ? static_cast<double>(total_ - done) / rate : 0;
  last_print_ = now;
  printed_ = true;
  if (style_ == ProgressStyle::json) {
    std::fputs(fmt::format("{{\"task\":\"{}\",\"done\":{},\"total\":{},\"rate\":{:.3f},\"seconds_left\":{:.1f}}}\n",
                           task_, done, total_, rate, left)
                   .c_str(),
               stderr);
    return;
  }
  std::string text = fmt::format("{:<10} {:>6}/{}", task_, done, total_);
  if (rate > 0) text += fmt::format("  {:6.1f}/s", rate);
  if (done < total_ && rate > 0) text += fmt::format("  {} left", duration_text(left));
  if (style_ == ProgressStyle::bar) {
    const int filled = total_ > 0 ? static_cast<int>(30 * done / total_) : 30;
    text = fmt::format("\r[{}{}] {:<60}", std::string(filled, '='), std::string(30 - filled, ' '), text);
  } else {
    text += '\n';
  }
  std::fputs(text.c_str(), stderr);
  std::fflush(stderr);
}

}  // namespace iris
