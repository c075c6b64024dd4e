// Starts the iris program of this build as a user would.
#pragma once

#include <signal.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <string>
#include <thread>
#include <vector>

namespace iris::testing {

struct ProgramResult {
  int exit_code = -1;  // 128 + signal if it was killed
  std::string output;  // stdout and stderr
};

// fork and exec; both outputs go to `fd` (-1: nowhere).
inline pid_t start_program(const std::vector<std::string>& arguments, int fd, rlim_t largest_file = RLIM_INFINITY) {
  const pid_t child = fork();
  if (child != 0) return child;
  if (fd >= 0) {
    dup2(fd, 1);
    dup2(fd, 2);
  } else {
    if (!std::freopen("/dev/null", "w", stdout) || !std::freopen("/dev/null", "w", stderr)) _exit(126);
  }
  if (largest_file != RLIM_INFINITY) {
    signal(SIGXFSZ, SIG_IGN);  // so that writing fails instead of the process
    const rlimit limit{largest_file, largest_file};
    setrlimit(RLIMIT_FSIZE, &limit);
  }
  std::string program = IRIS_PROGRAM;
  std::vector<char*> argv = {program.data()};
  std::vector<std::string> copies = arguments;
  for (std::string& argument : copies) argv.push_back(argument.data());
  argv.push_back(nullptr);
  execv(program.c_str(), argv.data());
  _exit(127);
}

inline int exit_code_of(int status) { return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status); }

inline ProgramResult run_program(const std::vector<std::string>& arguments, rlim_t largest_file = RLIM_INFINITY) {
  int ends[2];
  if (pipe(ends) != 0) return {};
  const pid_t child = start_program(arguments, ends[1], largest_file);
  close(ends[1]);
  ProgramResult result;
  char buffer[4096];
  for (ssize_t n; (n = read(ends[0], buffer, sizeof buffer)) > 0;) result.output.append(buffer, static_cast<size_t>(n));
  close(ends[0]);
  int status = 0;
  waitpid(child, &status, 0);
  result.exit_code = exit_code_of(status);
  return result;
}

// Sends a signal after a while; the exit code.
inline int start_and_signal(const std::vector<std::string>& arguments, std::chrono::milliseconds after,
                            int signal_number) {
  const pid_t child = start_program(arguments, -1);
  std::this_thread::sleep_for(after);
  kill(child, signal_number);
  int status = 0;
  waitpid(child, &status, 0);
  return exit_code_of(status);
}

// True if it was still running when it was killed.
inline bool start_and_kill(const std::vector<std::string>& arguments, std::chrono::milliseconds after) {
  return start_and_signal(arguments, after, SIGKILL) == 128 + SIGKILL;
}

}  // namespace iris::testing
