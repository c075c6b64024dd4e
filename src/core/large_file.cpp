#include "iris/core/large_file.h"

#include <fcntl.h>
#include <unistd.h>

#include "iris/core/error.h"
#include "write_failure.h"

namespace iris {
namespace fs = std::filesystem;

SpoolFile::SpoolFile(const fs::path& folder) : folder_(folder) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) throw_write_failure(folder, error.value());
  // Named only for the moment between the two calls; not every file system knows O_TMPFILE.
  std::string name = (folder / ".tmp.spool.XXXXXX").string();
  file_ = mkostemp(name.data(), O_CLOEXEC);
  if (file_ < 0) throw_write_failure(folder, errno);
  unlink(name.c_str());
}

SpoolFile::~SpoolFile() { close(file_); }

uint64_t SpoolFile::append(std::string_view bytes) {
  const uint64_t begin = size_;
  while (!bytes.empty()) {
    const ssize_t n = pwrite(file_, bytes.data(), bytes.size(), static_cast<off_t>(size_));
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) throw_write_failure(folder_, errno);
    bytes.remove_prefix(static_cast<size_t>(n));
    size_ += static_cast<uint64_t>(n);
  }
  return begin;
}

void SpoolFile::read(uint64_t offset, char* bytes, size_t size) const {
  IRIS_CHECK(offset <= size_ && size <= size_ - offset);
  while (size > 0) {
    const ssize_t n = pread(file_, bytes, size, static_cast<off_t>(offset));
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) throw InputError(folder_, "has a temporary file that cannot be read back", "check the disk");
    bytes += n;
    size -= static_cast<size_t>(n);
    offset += static_cast<uint64_t>(n);
  }
}

}  // namespace iris
