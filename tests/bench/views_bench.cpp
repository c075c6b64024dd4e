#include <opencv2/imgcodecs.hpp>

#include "bench/bench.h"
#include "bench/inputs.h"
#include "iris/workspace/view_files.h"
#include "support/temporary_folder.h"

namespace iris::bench {
namespace {

using benchmark::State;
namespace fs = std::filesystem;

const fs::path& stored() {
  static const testing::TemporaryFolder folder;
  static const bool written = (workspace::write_view(folder.path(), *hand_held_views()[0], 256), true);
  (void)written;
  return folder.path();
}

std::vector<cv::Mat> images() {
  const StereoView& view = *hand_held_views()[0];
  cv::Mat code;
  view.disparity.disparity.convertTo(code, CV_16U, 256);
  return {view.image, code, view.disparity.origin};
}

}  // namespace

void register_views() {
  const std::string input = hand_held().name;
  compare("workspace", "store a view", input,
          {{"IRIS",
            [](State& state) {
              const testing::TemporaryFolder folder;
              const StereoView& view = *hand_held_views()[0];
              measure(state, 1, [&] { workspace::write_view(folder.path(), view, 256); });
              double bytes = 0;
              for (const auto& file : fs::directory_iterator(folder.path())) {
                bytes += static_cast<double>(file.file_size());
              }
              state.counters["kB"] = bytes / 1000;
            }},
           {"OpenCV imwrite",
            [](State& state) {
              const testing::TemporaryFolder folder;
              const std::vector<cv::Mat> list = images();
              measure(state, 1, [&] {
                for (size_t i = 0; i < list.size(); ++i) {
                  cv::imwrite((folder.path() / (std::to_string(i) + ".png")).string(), list[i]);
                }
              });
            }},
           {"OpenCV imwrite, PNG level 6", [](State& state) {
              const testing::TemporaryFolder folder;
              const std::vector<cv::Mat> list = images();
              measure(state, 1, [&] {
                for (size_t i = 0; i < list.size(); ++i) {
                  cv::imwrite((folder.path() / (std::to_string(i) + ".png")).string(), list[i],
                              {cv::IMWRITE_PNG_COMPRESSION, 6});
                }
              });
            }}});
  compare("workspace", "read a view", input,
          {{"IRIS",
            [](State& state) {
              stored();
              StereoView view{.frame_idx = hand_held_views()[0]->frame_idx};
              measure(state, 1, [&] { workspace::read_view(stored(), 256, view); });
            }},
           {"OpenCV imread", [](State& state) {
              std::vector<std::string> files;
              for (const auto& file : fs::directory_iterator(stored())) files.push_back(file.path().string());
              measure(state, 1, [&] {
                for (const std::string& file : files) {
                  benchmark::DoNotOptimize(cv::imread(file, cv::IMREAD_UNCHANGED));
                }
              });
            }}});
}

}  // namespace iris::bench
