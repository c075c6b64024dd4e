// The order of the stages, checked on the includes: data flows down, nothing points up.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "iris/core/atomic_file.h"

namespace iris {
namespace {

namespace fs = std::filesystem;
using ::testing::IsEmpty;
using ::testing::Not;

// A file may include its own stage and those before it.
const std::vector<std::string> kStages = {"core",   "geometry",    "types",    "calibrate", "session",   "rectify",
                                          "stereo", "reconstruct", "motion",   "loop",      "mapping",   "views",
                                          "render", "tour",        "simulate", "evaluate",  "workspace", "pipeline"};

// Libraries that export/ alone may include.
const std::vector<std::string> kExportOnly = {"pcl/", "octomap/", "assimp/", "tiny_gltf.h", "cairo"};

int rank(std::string_view stage) {
  const auto found = std::find(kStages.begin(), kStages.end(), stage);
  return found == kStages.end() ? -1 : static_cast<int>(found - kStages.begin());
}

struct Include {
  bool quoted = false;
  std::string path;
};

std::vector<Include> includes_of(std::string_view text) {
  std::vector<Include> includes;
  while (!text.empty()) {
    const std::string_view line = text.substr(0, text.find('\n'));
    text.remove_prefix(std::min(line.size() + 1, text.size()));
    constexpr std::string_view kStart = "#include ";
    if (!line.starts_with(kStart)) continue;
    const char open = line[kStart.size()];
    const size_t end = line.find(open == '<' ? '>' : '"', kStart.size() + 1);
    if ((open != '<' && open != '"') || end == std::string_view::npos) continue;  // #include HWY_TARGET_INCLUDE
    includes.push_back({open == '"', std::string(line.substr(kStart.size() + 1, end - kStart.size() - 1))});
  }
  return includes;
}

// The standard library's headers have neither folder nor extension.
bool is_standard(const Include& include) {
  return !include.quoted && include.path.find_first_of("/.") == std::string::npos;
}

// What is wrong with the includes of `file` (relative to the project, as in "src/stereo/mwmf.cpp"). `siblings`: the
// files of its own folder.
std::vector<std::string> problems_of(const fs::path& file, std::string_view text,
                                     const std::vector<std::string>& siblings) {
  std::vector<std::string> problems;
  const auto part = [&](int i) {
    auto it = file.begin();
    for (; i > 0 && it != file.end(); --i) ++it;
    return it == file.end() ? std::string() : it->string();
  };
  const bool is_public = part(0) == "include", is_export = part(0) == "export";
  const std::string stage = is_public ? part(2) : part(0) == "src" ? part(1) : "";
  if (!is_export && part(0) != "apps" && rank(stage) < 0) problems.push_back("'" + stage + "' is no stage");
  for (const Include& include : includes_of(text)) {
    const std::string& path = include.path;
    const auto complain = [&](const std::string& why) { problems.push_back(path + ": " + why); };
    if (path == "opencv2/opencv.hpp") complain("include the needed modules only");
    const bool export_only = !include.quoted && std::any_of(kExportOnly.begin(), kExportOnly.end(),
                                                            [&](const auto& start) { return path.starts_with(start); });
    if (export_only && !is_export) complain("only export/ may include it");
    if (is_export || stage.empty()) continue;
    if (include.quoted && path.starts_with("iris/")) {
      const std::string other = path.substr(5, path.find('/', 5) - 5);
      if (rank(other) < 0) complain("'" + other + "' is no stage");
      if (rank(other) > rank(stage)) complain(stage + " stands before " + other);
    } else if (include.quoted) {
      // A private header: of the same folder, named alone or with the folder's name.
      const std::string name = path.starts_with(stage + "/") ? path.substr(stage.size() + 1) : path;
      if (is_public || std::find(siblings.begin(), siblings.end(), name) == siblings.end()) {
        complain("neither a public header nor one of this stage");
      }
    } else if (is_public && !is_standard(include) && !path.starts_with("Eigen/") && path != "opencv2/core.hpp" &&
               !path.starts_with("opencv2/core/")) {
      complain("a public header shows Eigen, OpenCV's core and the standard library only");
    }
  }
  if (file.extension() == ".h" && text.find("\n#pragma once\n") == std::string_view::npos &&
      !text.starts_with("#pragma once\n")) {
    problems.push_back("no #pragma once");
  }
  return problems;
}

TEST(Layers, NothingPointsUp) {
  const fs::path root = IRIS_SOURCE_DIR;
  int files = 0;
  for (const char* top : {"include", "src", "export", "apps"}) {
    for (const auto& entry : fs::recursive_directory_iterator(root / top)) {
      if (!entry.is_regular_file()) continue;
      std::vector<std::string> siblings;
      for (const auto& sibling : fs::directory_iterator(entry.path().parent_path())) {
        siblings.push_back(sibling.path().filename());
      }
      const fs::path file = fs::relative(entry.path(), root);
      EXPECT_THAT(problems_of(file, read_file(entry.path()), siblings), IsEmpty()) << "in " << file;
      ++files;
    }
  }
  EXPECT_GT(files, 20);
}

TEST(Layers, TheCheckSeesEachKindOfMistake) {
  const std::vector<std::string> siblings = {"mwmf.cpp", "filters.h"};
  const auto problems = [&](const char* file, const std::string& text) {
    return problems_of(file, "#pragma once\n" + text, siblings);
  };
  // Allowed.
  EXPECT_THAT(problems("src/stereo/mwmf.cpp",
                       "#include \"iris/stereo/mwmf.h\"\n#include \"iris/core/error.h\"\n"
                       "#include \"filters.h\"\n#include \"stereo/filters.h\"\n"
                       "#include <vector>\n#include <hwy/highway.h>\n#include HWY_TARGET\n"),
              IsEmpty());
  EXPECT_THAT(
      problems("include/iris/types/a.h", "#include <opencv2/core.hpp>\n#include <Eigen/Core>\n#include <memory>\n"),
      IsEmpty());
  EXPECT_THAT(problems("export/a.cpp", "#include <octomap/OcTree.h>\n#include \"iris/tour/tour.h\"\n"), IsEmpty());
  EXPECT_THAT(problems("include/iris/session/a.h", "#include \"iris/calibrate/files.h\"\n"), IsEmpty());
  // Refused.
  EXPECT_THAT(problems("src/stereo/mwmf.cpp", "#include \"iris/motion/scs.h\"\n"), Not(IsEmpty()));
  EXPECT_THAT(problems("include/iris/core/a.h", "#include \"iris/types/a.h\"\n"), Not(IsEmpty()));
  EXPECT_THAT(problems("include/iris/session/a.h", "#include \"iris/rectify/a.h\"\n"), Not(IsEmpty()));
  EXPECT_THAT(problems("src/stereo/mwmf.cpp", "#include \"iris/vision/a.h\"\n"), Not(IsEmpty()));
  EXPECT_THAT(problems("src/vision/a.cpp", ""), Not(IsEmpty()));
  EXPECT_THAT(problems("src/stereo/mwmf.cpp", "#include \"motion/rank.h\"\n"), Not(IsEmpty()));
  EXPECT_THAT(problems("src/stereo/mwmf.cpp", "#include \"export/map_file.h\"\n"), Not(IsEmpty()));
  EXPECT_THAT(problems("src/stereo/mwmf.cpp", "#include <octomap/OcTree.h>\n"), Not(IsEmpty()));
  EXPECT_THAT(problems("apps/iris/main.cpp", "#include <tiny_gltf.h>\n"), Not(IsEmpty()));
  EXPECT_THAT(problems("src/stereo/mwmf.cpp", "#include <opencv2/opencv.hpp>\n"), Not(IsEmpty()));
  EXPECT_THAT(problems("include/iris/types/a.h", "#include <opencv2/imgproc.hpp>\n"), Not(IsEmpty()));
  EXPECT_THAT(problems("include/iris/types/a.h", "#include <fmt/format.h>\n"), Not(IsEmpty()));
  EXPECT_THAT(problems("include/iris/types/a.h", "#include \"filters.h\"\n"), Not(IsEmpty()));
  EXPECT_THAT(problems_of("include/iris/types/a.h", "#include <vector>\n", {}), Not(IsEmpty()));
}

}  // namespace
}  // namespace iris
