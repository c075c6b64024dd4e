// The three kinds of failure.
//   * a bug:            IRIS_CHECK throws Bug (exit code 1);
//   * bad input/usage:  InputError names the file, what is wrong and what to do (exit 3); UsageError (exit 2);
//   * expected failure of a method (too few correspondences, say): a status in its result, never an exception.
#pragma once

#include <filesystem>
#include <stdexcept>
#include <string>

namespace iris {

// A broken promise inside the program.
class Bug : public std::logic_error {
 public:
  using std::logic_error::logic_error;
};

// The program was called in a way it does not understand: unknown option, value out of range.
class UsageError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

// Something on disk that cannot be used. what() reads "<path>: <problem>; <remedy>".
class InputError : public std::runtime_error {
 public:
  InputError(const std::filesystem::path& path, const std::string& problem, const std::string& remedy)
      : std::runtime_error(path.string() + ": " + problem + (remedy.empty() ? "" : "; " + remedy)), path_(path) {}
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

// The user asked to stop (Ctrl-C); what is finished is kept (exit 130).
class Interrupted : public std::runtime_error {
 public:
  Interrupted() : std::runtime_error("interrupted") {}
};

[[noreturn]] inline void throw_bug(const char* condition, const char* file, int line) {
  throw Bug(std::string("check failed: ") + condition + " at " + file + ":" + std::to_string(line));
}

}  // namespace iris

#define IRIS_CHECK(condition) ((condition) ? void(0) : ::iris::throw_bug(#condition, __FILE__, __LINE__))
