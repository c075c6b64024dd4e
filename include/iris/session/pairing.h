// Which left image belongs to which right image.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace iris::session {

// Time in a file name without extension: whole numbers of at least 16 digits are nanoseconds, "1403636584.763555"
// seconds.
std::optional<int64_t> stamp_in_name(const std::string& stem);

// Frame number in a file name without extension: its last group of digits (fewer than 16).
std::optional<int64_t> number_in_name(const std::string& stem);

// Indices of what belongs together, ascending; and of what has no partner.
struct Pairing {
  std::vector<std::pair<int, int>> pairs;  // (left, right)
  std::vector<int> unpaired_left, unpaired_right;
};

// Stamps ascending. Left and right are paired if each is the other's nearest and they are at most `max_difference`
// apart: every image is used once at most and the order of time is kept.
Pairing pair_by_stamp(const std::vector<int64_t>& left, const std::vector<int64_t>& right, int64_t max_difference);

// Numbers ascending; equal numbers belong together.
Pairing pair_by_number(const std::vector<int64_t>& left, const std::vector<int64_t>& right);

// Median of the differences of neighbours, the lower one of two (gaps only lengthen them); 0 if there are fewer than
// two.
int64_t median_period(const std::vector<int64_t>& ascending);

// One time a line, as seconds or as nanoseconds (whole numbers of at least 16 digits); "number time" in a line also
// gives the frame number (else the lines count from 0). '#' starts a comment. (number, time in ns) in the order of the
// file. Throws InputError if a line is something else or the times do not ascend.
std::vector<std::pair<int64_t, int64_t>> read_times(const std::filesystem::path& path);

}  // namespace iris::session
