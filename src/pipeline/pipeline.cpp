#include "iris/pipeline/pipeline.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <map>

#include "iris/core/error.h"

namespace iris::pipeline {

std::vector<std::string> run_stages(const std::vector<Stage>& stages, const OptionSet& options,
                                    workspace::Workspace& workspace, const RunControl& control) {
  std::map<std::string, std::string> fingerprints;
  std::vector<std::string> ran;
  for (const Stage& stage : stages) {
    std::string text =
        std::string(IRIS_VERSION) + "\n" + stage.name + "\n" + options.text_of(stage.sections) + stage.inputs;
    for (const std::string& earlier : stage.after) {
      const auto record = workspace.stage(earlier);
      IRIS_CHECK(fingerprints.contains(earlier) || record);
      text += "\n" + (fingerprints.contains(earlier) ? fingerprints[earlier] : record->fingerprint);
    }
    const std::string own = fingerprints[stage.name] = fingerprint(text);
    if (workspace.finished(stage.name, own)) {
      spdlog::info("{}: done before, kept", stage.name);
      continue;
    }
    if (control.stopped()) throw Interrupted();
    const auto before = workspace.stage(stage.name);
    workspace.forget(stage.name);
    const auto start = std::chrono::steady_clock::now();
    const std::vector<std::string> outputs = stage.run(workspace, control, own);
    workspace.finish(stage.name, {.fingerprint = own, .outputs = outputs});
    // Files of other options beside the new ones would be taken for theirs.
    for (const std::string& file : before ? before->outputs : std::vector<std::string>()) {
      std::error_code ignored;
      if (std::find(outputs.begin(), outputs.end(), file) == outputs.end()) {
        std::filesystem::remove(workspace.folder() / file, ignored);
      }
    }
    ran.push_back(stage.name);
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    spdlog::info("{}: done in {:.1f} s", stage.name, seconds);
  }
  return ran;
}

}  // namespace iris::pipeline
