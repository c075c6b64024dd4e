#include <opencv2/imgcodecs.hpp>

#include "bench/bench.h"
#include "bench/inputs.h"
#include "iris/session/session.h"

namespace iris::bench {
namespace {

using benchmark::State;

void read_session(State& state) {
  const auto session = session::open_session(recorded_session(), {});
  int frame = 0;
  measure(state, 1, [&] {
    benchmark::DoNotOptimize(session->read(frame));
    frame = (frame + 1) % session->size();
  });
  set_rate(state, "frames/s", 1);
}

void read_images(State& state) {
  const bool euroc = std::filesystem::exists(recorded_session() / "mav0");
  const auto folder = [&](int camera) {
    if (euroc) return recorded_session() / "mav0" / (camera == 0 ? "cam0" : "cam1") / "data";
    return recorded_session() / (camera == 0 ? "left" : "right");
  };
  std::vector<cv::String> files[2];
  for (const int camera : {0, 1}) cv::glob((folder(camera) / "*.png").string(), files[camera]);
  size_t frame = 0;
  measure(state, 1, [&] {
    for (const int camera : {0, 1}) benchmark::DoNotOptimize(cv::imread(files[camera][frame], cv::IMREAD_UNCHANGED));
    frame = (frame + 1) % std::min(files[0].size(), files[1].size());
  });
}

}  // namespace

void register_session() {
  compare("session", "read a pair (PNG)", recorded_session_name(),
          {{"IRIS", read_session}, {"OpenCV imread", read_images}});
}

}  // namespace iris::bench
