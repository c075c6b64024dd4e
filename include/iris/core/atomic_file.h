// Files are written whole or not at all: into a temporary neighbour, flushed, then renamed.
#pragma once

#include <filesystem>
#include <functional>
#include <string_view>
#include <vector>

namespace iris {

// Writes `bytes` to `path` (folders are made). Throws InputError if the disk is full or the folder cannot be written.
void write_file(const std::filesystem::path& path, std::string_view bytes);
void write_file(const std::filesystem::path& path, const std::vector<unsigned char>& bytes);

// For writers that want a file name of their own: `write` gets a temporary path in the same folder with the same
// extension; when it returns, the file is flushed and renamed to `path`; when it throws, nothing is left behind.
void write_file_with(const std::filesystem::path& path,
                     const std::function<void(const std::filesystem::path& temporary)>& write);

// Whole content of a file. Throws InputError.
std::string read_file(const std::filesystem::path& path);

}  // namespace iris
