// Files that are larger than what should be held in memory.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string_view>

namespace iris {

// As write_file() of atomic_file.h, in parts: `write` hands them to `put`, one after the other. If it throws, nothing
// is left behind. Throws InputError if the disk is full or the folder cannot be written.
void write_file_in_parts(const std::filesystem::path& path,
                         const std::function<void(const std::function<void(std::string_view)>& put)>& write);

// Bytes that are put aside on disk: a file that grows at its end and is read anywhere. It has no name: the system
// removes it when the program ends, however it ends.
class SpoolFile {
 public:
  // Lies on the disk of `folder`, which is made. Throws InputError, as all functions do, if the folder cannot be
  // written or the disk is full.
  explicit SpoolFile(const std::filesystem::path& folder);
  ~SpoolFile();
  SpoolFile(const SpoolFile&) = delete;
  SpoolFile& operator=(const SpoolFile&) = delete;

  // Returns where the bytes begin.
  uint64_t append(std::string_view bytes);
  // `size` bytes from `offset` on, all of which were appended before.
  void read(uint64_t offset, char* bytes, size_t size) const;

 private:
  std::filesystem::path folder_;
  int file_ = -1;
  uint64_t size_ = 0;
};

}  // namespace iris
