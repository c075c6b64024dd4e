// thesis_tables [stereo|motion|mapping|views …]: prints the tables of docs/thesis.md; without a word all of them.
#include <fmt/format.h>

#include <algorithm>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "thesis/tables.h"

int main(int argc, char** argv) {
  const std::vector<std::pair<std::string, std::function<void()>>> parts = {
      {"stereo", iris::thesis::print_stereo_tables},
      {"motion", iris::thesis::print_motion_tables},
      {"mapping", iris::thesis::print_mapping_tables},
      {"views", iris::thesis::print_view_tables},
  };
  const std::vector<std::string> wanted(argv + 1, argv + argc);
  for (const std::string& word : wanted) {
    if (std::none_of(parts.begin(), parts.end(), [&](const auto& part) { return part.first == word; })) {
      fmt::print(stderr, "usage: {} [stereo|motion|mapping|views …]\n", argv[0]);
      return 2;
    }
  }
  for (const auto& [name, print] : parts) {
    if (wanted.empty() || std::find(wanted.begin(), wanted.end(), name) != wanted.end()) print();
  }
}
