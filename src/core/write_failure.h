// What a failed write is reported as.
#pragma once

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <string>

#include "iris/core/error.h"

namespace iris {

// `error`: errno of the call that failed.
[[noreturn]] inline void throw_write_failure(const std::filesystem::path& path, int error) {
  const bool full = error == ENOSPC || error == EDQUOT || error == EFBIG;
  throw InputError(path, std::string("cannot be written (") + std::strerror(error) + ")",
                   full ? "free some space and run the same command again, it goes on where it stopped"
                        : "check the folder and its permissions, or choose another with -o");
}

}  // namespace iris
