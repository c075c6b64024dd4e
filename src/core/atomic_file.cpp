#include "iris/core/atomic_file.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <fstream>
#include <utility>

#include "iris/core/error.h"
#include "iris/core/large_file.h"
#include "write_failure.h"

namespace iris {
namespace fs = std::filesystem;
namespace {

// Also refuses to put a file in the place of a device or a folder: renaming would replace it.
void prepare_place_of(const fs::path& path) {
  std::error_code unknown;
  const fs::file_status status = fs::status(path, unknown);
  if (fs::exists(status) && !fs::is_regular_file(status)) {
    throw InputError(path, "is no file that could be replaced", "give another name");
  }
  if (!path.has_parent_path()) return;
  std::error_code error;
  fs::create_directories(path.parent_path(), error);
  if (error) throw_write_failure(path.parent_path(), error.value());
}

// A neighbour of `path` with the same extension: writers choose the format by it. Named after the process, so that
// two programs never share one; left-overs of a killed run start with a dot and are overwritten or swept by the
// workspace.
fs::path temporary_of(const fs::path& path) {
  return path.parent_path() / (".tmp." + std::to_string(getpid()) + "." + path.filename().string());
}

void flush_to_disk(const fs::path& path) {
  const int fd = open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (fd < 0) throw_write_failure(path, errno);
  const int result = fsync(fd), error = errno;
  close(fd);
  if (result != 0) throw_write_failure(path, error);
}

void rename_over(const fs::path& from, const fs::path& to) {
  if (std::rename(from.c_str(), to.c_str()) != 0) {
    const int error = errno;
    std::error_code ignored;
    fs::remove(from, ignored);
    throw_write_failure(to, error);
  }
}

void write_all(int fd, std::string_view bytes, const fs::path& path) {
  while (!bytes.empty()) {
    const ssize_t n = ::write(fd, bytes.data(), bytes.size());
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) throw_write_failure(path, errno);
    bytes.remove_prefix(static_cast<size_t>(n));
  }
}

}  // namespace

void write_file_in_parts(const fs::path& path,
                         const std::function<void(const std::function<void(std::string_view)>& put)>& write) {
  prepare_place_of(path);
  const fs::path temporary = temporary_of(path);
  int fd = open(temporary.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
  if (fd < 0) throw_write_failure(path, errno);
  try {
    write([&](std::string_view part) { write_all(fd, part, path); });
    if (fsync(fd) != 0) throw_write_failure(path, errno);
    if (close(std::exchange(fd, -1)) != 0) throw_write_failure(path, errno);
  } catch (...) {
    if (fd >= 0) close(fd);
    unlink(temporary.c_str());
    throw;
  }
  rename_over(temporary, path);
}

void write_file(const fs::path& path, std::string_view bytes) {
  write_file_in_parts(path, [&](const auto& put) { put(bytes); });
}

void write_file(const fs::path& path, const std::vector<unsigned char>& bytes) {
  write_file(path, std::string_view(reinterpret_cast<const char*>(bytes.data()), bytes.size()));
}

void write_file_with(const fs::path& path, const std::function<void(const fs::path& temporary)>& write) {
  prepare_place_of(path);
  const fs::path temporary = temporary_of(path);
  try {
    write(temporary);
    if (!fs::exists(temporary)) throw_write_failure(path, errno != 0 ? errno : EIO);
    flush_to_disk(temporary);
  } catch (...) {
    std::error_code ignored;
    fs::remove(temporary, ignored);
    throw;
  }
  rename_over(temporary, path);
}

std::string read_file(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::string text;
  std::vector<char> block(1 << 16);
  while (file.read(block.data(), static_cast<std::streamsize>(block.size())) || file.gcount() > 0) {
    text.append(block.data(), static_cast<size_t>(file.gcount()));
  }
  // The end of a file sets eof and fail; a folder or a failing disk sets bad; a file that cannot be opened fails
  // without eof.
  if (file.bad() || !file.eof()) {
    throw InputError(path, "cannot be read", fs::exists(path) ? "check its permissions" : "check the name");
  }
  return text;
}

}  // namespace iris
