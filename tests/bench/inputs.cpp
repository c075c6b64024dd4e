#include "bench/inputs.h"

#include <fmt/format.h>

#include <cmath>
#include <fstream>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <sstream>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/evaluate/formats.h"
#include "iris/rectify/rectifier.h"
#include "iris/session/session.h"
#include "iris/stereo/mwmf.h"
#include "support/synthetic_session.h"
#include "support/synthetic_views.h"
#include "support/temporary_folder.h"

namespace iris::bench {
namespace fs = std::filesystem;
namespace {

const fs::path kData = IRIS_TEST_DATA;

// "t tx ty tz qx qy qz qw" a line: the pose at the nearest time.
class Truth {
 public:
  explicit Truth(const fs::path& file) {
    std::ifstream lines(file);
    for (std::string line; std::getline(lines, line);) {
      std::istringstream fields(line);
      double t, x, y, z, qx, qy, qz, qw;
      if (!(fields >> t >> x >> y >> z >> qx >> qy >> qz >> qw)) continue;
      Pose pose = Pose::Identity();
      pose.linear() = Eigen::Quaterniond(qw, qx, qy, qz).normalized().matrix();
      pose.translation() = Eigen::Vector3d(x, y, z);
      poses_[t] = pose;
    }
  }
  Pose at(double t) const {
    auto next = poses_.lower_bound(t);
    if (next == poses_.end() || (next != poses_.begin() && t - std::prev(next)->first < next->first - t)) --next;
    return next->second;
  }

 private:
  std::map<double, Pose> poses_;
};

Sequence recorded_sequence(const fs::path& folder, const char* name, const std::vector<int>& frames) {
  const auto session = session::open_session(folder, {});
  const rectify::Rectifier rectifier(session->calibration());
  Sequence sequence{.camera = rectifier.camera()};
  sequence.name = fmt::format("{} {}x{}", name, sequence.camera.width, sequence.camera.height);
  for (const int frame : frames) sequence.pairs.push_back(rectifier.rectify(session->read(frame)));
  if (const fs::path file = folder / "truth_left_camera.tum"; fs::exists(file)) {
    const Truth truth(file);
    Pose rect_from_left = Pose::Identity();
    rect_from_left.linear() = rectifier.rect_from_left();
    for (const StereoPair& pair : sequence.pairs) {
      sequence.world_from_cam.push_back(truth.at(static_cast<double>(pair.stamp_ns) * 1e-9) * rect_from_left.inverse());
    }
    const Eigen::Vector3d origin = sequence.world_from_cam.front().translation();
    for (Pose& pose : sequence.world_from_cam) pose.translation() -= origin;
  }
  return sequence;
}

}  // namespace

Sequence render_sequence(const RectifiedCamera& camera, int frames) {
  Sequence sequence{.name = fmt::format("room {}x{}", camera.width, camera.height), .camera = camera};
  const testing::Room room;
  for (int i = 0; i < frames; ++i) {
    const Pose left = testing::synthetic_pose(i);
    Pose right = left;
    right.translation() = left * Eigen::Vector3d(camera.baseline, 0, 0);
    sequence.pairs.push_back({.frame_idx = i,
                              .left = testing::render_room(room, camera, left).image,
                              .right = testing::render_room(room, camera, right).image});
    sequence.world_from_cam.push_back(z_up_from_camera() * left);
  }
  return sequence;
}

const Sequence& hand_held() {
  static const Sequence sequence = [] {
    const fs::path folder = kData / "euroc_mh01";
    if (fs::exists(folder)) return recorded_sequence(folder, "EuRoC", {40, 41, 46, 52, 58});
    return render_sequence(
        {.f = 436, .cx = 366, .cy = 252, .baseline = 0.11, .disparity_offset = 0, .width = 752, .height = 480}, 5);
  }();
  return sequence;
}

const Sequence* street() {
  static const std::unique_ptr<Sequence> sequence = [] {
    const fs::path folder = kData / "kitti_street";
    return fs::exists(folder) ? std::make_unique<Sequence>(recorded_sequence(folder, "KITTI", {25, 26})) : nullptr;
  }();
  return sequence.get();
}

namespace {

std::shared_ptr<const StereoView> view_of(const Sequence& sequence, size_t i) {
  stereo::MwmfOptions options;
  options.disparities = 128;
  const StereoPair& pair = sequence.pairs[i];
  return std::make_shared<StereoView>(StereoView{.frame_idx = static_cast<int>(i),
                                                 .camera = sequence.camera,
                                                 .image = pair.left,
                                                 .disparity = mwmf(pair.left, pair.right, options),
                                                 .world_from_cam = sequence.world_from_cam[i]});
}

}  // namespace

const std::vector<std::shared_ptr<const StereoView>>& hand_held_views() {
  static const std::vector<std::shared_ptr<const StereoView>> views = [] {
    std::vector<std::shared_ptr<const StereoView>> list;
    for (size_t i = 0; i < hand_held().pairs.size(); ++i) list.push_back(view_of(hand_held(), i));
    return list;
  }();
  return views;
}

const PictureSources& picture_sources() {
  static const PictureSources sources = [] {
    const fs::path folder = kData / "euroc_mh01";
    const bool recorded = fs::exists(folder);
    const Sequence sequence =
        recorded ? recorded_sequence(folder, "EuRoC", {40, 33, 34, 39, 41, 26, 80, 113, 114})
                 : render_sequence({.f = 436, .cx = 366, .cy = 252, .baseline = 0.11, .width = 752, .height = 480}, 9);
    PictureSources result{.name = recorded ? "EuRoC" : "room", .camera = {}, .near = {}, .far = {}};
    constexpr int kWidth = 640, kHeight = 480;
    result.camera = {.width = kWidth,
                     .height = kHeight,
                     .f = sequence.camera.f,
                     .cx = sequence.camera.cx - 0.5 * (sequence.camera.width - kWidth),
                     .cy = sequence.camera.cy - 0.5 * (sequence.camera.height - kHeight),
                     .world_from_cam = sequence.world_from_cam[0]};
    for (size_t i = 1; i < sequence.pairs.size(); ++i) {
      (i <= 4 ? result.near : result.far).push_back(view_of(sequence, i));
    }
    return result;
  }();
  return sources;
}

StereoCalibration distorted_rig() {
  StereoCalibration rig;
  rig.left.width = rig.right.width = 752;
  rig.left.height = rig.right.height = 480;
  rig.left.K << 458.654, 0, 367.215, 0, 457.296, 248.375, 0, 0, 1;
  rig.right.K << 457.587, 0, 379.999, 0, 456.134, 255.238, 0, 0, 1;
  rig.left.coefficients = {-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05};
  rig.right.coefficients = {-0.28368365, 0.07451284, -0.00010473, -3.555907e-05};
  rig.right_from_left.linear() = Eigen::AngleAxisd(0.0142, Eigen::Vector3d(0.49, 0.16, 0.86).normalized()).matrix();
  rig.right_from_left.translation() = Eigen::Vector3d(-0.11007, 0.0004, -0.00085);
  return rig;
}

const fs::path& recorded_session() {
  static const testing::TemporaryFolder folder;
  static const fs::path path = [] {
    if (fs::exists(kData / "euroc_mh01")) return kData / "euroc_mh01";
    testing::write_synthetic_session(folder.path(), 40);
    return folder.path();
  }();
  return path;
}

std::string recorded_session_name() { return recorded_session().parent_path() == kData ? "EuRoC" : "room 320x240"; }

Recording read_recording(const fs::path& folder, const fs::path& truth_file) {
  const auto session = session::open_session(folder, {});
  const rectify::Rectifier rectifier(session->calibration());
  Recording recording{.pairs = std::vector<StereoPair>(static_cast<size_t>(session->size())),
                      .world_from_cam = {},
                      .camera = rectifier.camera()};
  parallel_chunks(0, session->size(), 1, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) recording.pairs[static_cast<size_t>(i)] = rectifier.rectify(session->read(i));
  });
  const std::string text = read_file(truth_file);
  if (evaluate::is_kitti(text)) {
    for (const auto& pose : evaluate::parse_kitti(text, truth_file)) recording.world_from_cam.push_back(pose.value());
  } else {
    evaluate::Trajectory frames;
    for (int i = 0; i < session->size(); ++i) frames.push_back({session->stamp_ns(i), Pose::Identity()});
    Pose left_from_rect = Pose::Identity();
    left_from_rect.linear() = rectifier.rect_from_left().transpose();
    for (const evaluate::PosePair& pair : evaluate::associate(frames, evaluate::parse_tum(text, truth_file))) {
      recording.world_from_cam.push_back(pair.truth * left_from_rect);
    }
  }
  IRIS_CHECK(recording.world_from_cam.size() >= recording.pairs.size());
  return recording;
}

}  // namespace iris::bench
