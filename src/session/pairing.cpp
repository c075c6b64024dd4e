#include "iris/session/pairing.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <sstream>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"

namespace iris::session {
namespace {

constexpr size_t kStampDigits = 16;

bool all_digits(const std::string& text) {
  return !text.empty() && std::all_of(text.begin(), text.end(), [](unsigned char c) { return std::isdigit(c); });
}

std::optional<int64_t> whole_number(const std::string& text) {
  int64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

// Time of a text in ns: whole numbers of many digits are nanoseconds already.
std::optional<int64_t> time_of(const std::string& text) {
  if (all_digits(text) && text.size() >= kStampDigits) return whole_number(text);
  char* end = nullptr;
  const long double seconds = std::strtold(text.c_str(), &end);
  constexpr long double kLargest = 9e9L;  // s: what 64 bits of nanoseconds hold
  if (text.empty() || *end != '\0' || !(std::abs(seconds) < kLargest)) return std::nullopt;
  return std::llround(seconds * 1e9L);
}

// Index of the value nearest to `value`; the earlier one of two.
int nearest(const std::vector<int64_t>& ascending, int64_t value) {
  const auto after = std::lower_bound(ascending.begin(), ascending.end(), value);
  if (after == ascending.begin()) return 0;
  if (after == ascending.end()) return static_cast<int>(ascending.size()) - 1;
  const auto before = after - 1;
  return static_cast<int>((value - *before <= *after - value ? before : after) - ascending.begin());
}

void add_unpaired(Pairing& pairing, size_t left_count, size_t right_count) {
  std::vector<char> left_used(left_count), right_used(right_count);
  for (const auto& [l, r] : pairing.pairs) left_used[static_cast<size_t>(l)] = right_used[static_cast<size_t>(r)] = 1;
  for (size_t i = 0; i < left_count; ++i) {
    if (!left_used[i]) pairing.unpaired_left.push_back(static_cast<int>(i));
  }
  for (size_t i = 0; i < right_count; ++i) {
    if (!right_used[i]) pairing.unpaired_right.push_back(static_cast<int>(i));
  }
}

}  // namespace

std::optional<int64_t> stamp_in_name(const std::string& stem) {
  if (all_digits(stem)) return stem.size() >= kStampDigits ? whole_number(stem) : std::nullopt;
  const size_t dot = stem.find('.');
  if (dot == std::string::npos || !all_digits(stem.substr(0, dot)) || !all_digits(stem.substr(dot + 1)))
    return std::nullopt;
  return time_of(stem);
}

std::optional<int64_t> number_in_name(const std::string& stem) {
  size_t end = stem.size();
  while (end > 0 && !std::isdigit(static_cast<unsigned char>(stem[end - 1]))) --end;
  size_t begin = end;
  while (begin > 0 && std::isdigit(static_cast<unsigned char>(stem[begin - 1]))) --begin;
  if (begin == end || end - begin >= kStampDigits) return std::nullopt;
  return whole_number(stem.substr(begin, end - begin));
}

Pairing pair_by_stamp(const std::vector<int64_t>& left, const std::vector<int64_t>& right, int64_t max_difference) {
  Pairing pairing;
  for (size_t l = 0; l < left.size() && !right.empty(); ++l) {
    const int r = nearest(right, left[l]);
    const int64_t stamp = right[static_cast<size_t>(r)];
    if (std::abs(stamp - left[l]) <= max_difference && nearest(left, stamp) == static_cast<int>(l)) {
      pairing.pairs.emplace_back(static_cast<int>(l), r);
    }
  }
  add_unpaired(pairing, left.size(), right.size());
  return pairing;
}

Pairing pair_by_number(const std::vector<int64_t>& left, const std::vector<int64_t>& right) {
  return pair_by_stamp(left, right, 0);
}

int64_t median_period(const std::vector<int64_t>& ascending) {
  if (ascending.size() < 2) return 0;
  std::vector<int64_t> differences;
  for (size_t i = 1; i < ascending.size(); ++i) differences.push_back(ascending[i] - ascending[i - 1]);
  const auto middle = differences.begin() + static_cast<std::ptrdiff_t>((differences.size() - 1) / 2);
  std::nth_element(differences.begin(), middle, differences.end());
  return *middle;
}

std::vector<std::pair<int64_t, int64_t>> read_times(const std::filesystem::path& path) {
  std::vector<std::pair<int64_t, int64_t>> times;
  std::istringstream lines(read_file(path));
  int line_number = 0;
  for (std::string line; std::getline(lines, line);) {
    ++line_number;
    line.resize(std::min(line.find('#'), line.size()));
    std::replace(line.begin(), line.end(), ',', ' ');
    std::istringstream words(line);
    std::vector<std::string> tokens;
    for (std::string token; words >> token;) tokens.push_back(token);
    if (tokens.empty()) continue;
    const auto number =
        tokens.size() == 2 ? whole_number(tokens[0]) : std::optional(static_cast<int64_t>(times.size()));
    const auto time = time_of(tokens.back());
    if (tokens.size() > 2 || !number || !time) {
      throw InputError(path, fmt::format("line {} is no time", line_number),
                       "write one time a line, in seconds, or take the file away");
    }
    if (!times.empty() && (*time <= times.back().second || *number <= times.back().first)) {
      throw InputError(path, fmt::format("line {}: the time does not come after the one before", line_number),
                       "times must ascend");
    }
    times.emplace_back(*number, *time);
  }
  return times;
}

}  // namespace iris::session
