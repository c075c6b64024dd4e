#include "iris/pipeline/frames.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <tbb/parallel_pipeline.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <map>
#include <memory>
#include <opencv2/imgcodecs.hpp>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/evaluate/formats.h"
#include "iris/motion/chain.h"
#include "iris/motion/motion_picture.h"
#include "iris/rectify/row_check.h"
#include "iris/stereo/search_range.h"

namespace iris::pipeline {
namespace {

constexpr const char* kFramesFingerprint = "frames.fingerprint";
constexpr const char* kDisparities = "stereo.disparities";
constexpr const char* kRows = "rectify.rows";

// Part of a frame's measured pixels at the end of the search range from which on something nearer was probably missed.
constexpr double kMaxAtLimit = 0.02;

// A frame on its way through the pipeline.
struct Item {
  int frame_idx = 0;
  int64_t stamp_ns = 0;
  StereoFrame frame;
  std::string unreadable;  // why, if it is
  StereoPair pair;
  DisparityImage disparity;
  motion::ViewFeatures features;
};

class FrameStream {
 public:
  FrameStream(const session::Session& session, const Options& options, int disparities, bool needs_features)
      : session_(session),
        options_(options),
        stereo_(options.stereo),
        needs_features_(needs_features),
        rectifier_(session.calibration()) {
    stereo_.disparities = disparities;
  }

  const RectifiedCamera& camera() const { return rectifier_.camera(); }
  const stereo::MwmfOptions& stereo_options() const { return stereo_; }

  // A damaged image costs its frame, not the run.
  void read(Item& item) const {
    try {
      item.frame = session_.read(item.frame_idx);
    } catch (const InputError& error) {
      item.unreadable = error.what();
    }
  }

  void compute(Item& item) const {
    item.pair = rectifier_.rectify(item.frame);
    item.frame = {};
    item.disparity = stereo::mwmf(item.pair.left, item.pair.right, stereo_);
    if (!needs_features_) return;
    item.features =
        motion::extract_features(item.pair.left, item.disparity, camera(), options_.motion, item.pair.right);
  }

 private:
  const session::Session& session_;
  const Options& options_;
  stereo::MwmfOptions stereo_;
  bool needs_features_;
  rectify::Rectifier rectifier_;
};

// Whether the rows of the images correspond, as everything after rectification takes for granted: empty if they do, or
// if too little is seen to tell.
std::string rows_text(const std::vector<StereoPair>& pairs) {
  const rectify::RowCheckOptions options;
  std::vector<std::vector<rectify::RowMatch>> found(pairs.size());
  parallel_chunks(0, static_cast<int>(pairs.size()), 1, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      found[static_cast<size_t>(i)] = rectify::match_rows(pairs[static_cast<size_t>(i)], options);
    }
  });
  std::vector<rectify::RowMatch> matches;
  for (const auto& of_pair : found) matches.insert(matches.end(), of_pair.begin(), of_pair.end());
  const rectify::RowCheck check =
      rectify::check_rows(matches, pairs.front().left.cols, pairs.front().left.rows, options);
  if (!check.enough || check.fits) return "";
  return fmt::format(
      "calibration does not fit this recording: rows that should correspond are {:.1f} px apart (RMS over the image, "
      "{:g} px are tolerable); see 'iris rectify SESSION --check'",
      check.systematic, options.tolerance);
}

// What is found out before the first frame.
struct Preparation {
  int disparities = 0;
  std::string rows_text;
};

// Looks at frames spread over the session. Throws if none of them can be read: then it is the session that is wrong,
// not a frame.
Preparation prepare(const session::Session& session, const Options& options) {
  constexpr int kSamples = 12;
  const rectify::Rectifier rectifier(session.calibration());
  const int samples = std::min(kSamples, session.size());
  std::vector<std::unique_ptr<StereoPair>> pairs(static_cast<size_t>(samples));
  std::vector<std::string> errors(static_cast<size_t>(samples));
  const auto read_sample = [&](int i) {
    const int frame_idx = static_cast<int>((static_cast<int64_t>(session.size()) * (2 * i + 1)) / (2 * samples));
    try {
      pairs[i] = std::make_unique<StereoPair>(rectifier.rectify(session.read(frame_idx)));
    } catch (const InputError& error) {
      errors[i] = error.what();
    }
  };
  if (options.stereo.disparities > 0) {
    // A given range still wants one frame that can be used.
    for (int i = 0; i < samples && (i == 0 || !pairs[i - 1]); ++i) read_sample(i);
  } else if (session.random_access()) {
    parallel_chunks(0, samples, 1, [&](int begin, int end) {
      for (int i = begin; i < end; ++i) read_sample(i);
    });
  } else {
    for (int i = 0; i < samples; ++i) read_sample(i);
  }
  std::vector<StereoPair> readable;
  for (auto& pair : pairs) {
    if (pair) readable.push_back(std::move(*pair));
  }
  if (readable.empty()) {
    throw InputError(session.folder(), fmt::format("none of {} frames looked at can be used; {}", samples, errors[0]),
                     "check the images and the calibration");
  }
  Preparation preparation{.disparities = options.stereo.disparities, .rows_text = rows_text(readable)};
  if (!preparation.rows_text.empty()) spdlog::warn("the {}", preparation.rows_text);
  if (preparation.disparities > 0) return preparation;
  const stereo::SearchRange range = stereo::estimate_search_range(readable, options.stereo);
  spdlog::info("search range: {} disparities, found from {} frames; {:.1f} % of their matches are nearer than that",
               range.disparities, readable.size(), 100 * range.beyond);
  preparation.disparities = range.disparities;
  return preparation;
}

// The last frames and what their motions refer to, ascending.
std::vector<workspace::FrameRecord> remembered_frames(const workspace::Workspace& workspace, int count) {
  std::map<int, workspace::FrameRecord> records;
  for (const workspace::FrameRecord& record : workspace.last_posed_frames(count)) records[record.frame_idx] = record;
  for (const workspace::FrameRecord& record : workspace.last_posed_frames(count)) {
    if (record.reference_frame >= 0 && !records.contains(record.reference_frame)) {
      records[record.reference_frame] = *workspace.frame(record.reference_frame);
    }
  }
  std::vector<workspace::FrameRecord> result;
  for (const auto& [frame_idx, record] : records) result.push_back(record);
  return result;
}

// The chain's memory of the last frames, computed again as they were computed before the interruption.
std::vector<motion::MotionChain::Restored> restore_frames(const FrameStream& stream,
                                                          const std::vector<workspace::FrameRecord>& records,
                                                          const std::filesystem::path& session_folder,
                                                          bool random_access) {
  std::vector<motion::MotionChain::Restored> restored(records.size());
  const auto restore = [&](int i) {
    Item item{.frame_idx = records[i].frame_idx, .stamp_ns = records[i].stamp_ns};
    stream.read(item);
    if (!item.unreadable.empty()) {
      throw InputError(session_folder, "an image that was readable before no longer is: " + item.unreadable,
                       "restore it and run again");
    }
    stream.compute(item);
    restored[i] = {.frame_idx = item.frame_idx,
                   .features = std::move(item.features),
                   .world_from_cam = records[i].submap_from_cam,
                   .submap = records[i].submap,
                   .guessed = records[i].motion.status == MotionStatus::guessed,
                   .reference_frame = records[i].reference_frame,
                   .reference_from_cam = records[i].motion.prev_from_cur};
  };
  const int count = static_cast<int>(records.size());
  parallel_chunks(0, count, random_access ? 1 : std::max(1, count), [&](int begin, int end) {
    for (int i = begin; i < end; ++i) restore(i);
  });
  return restored;
}

void write_motion_picture(const std::filesystem::path& folder, const motion::ViewFeatures& current,
                          const motion::ChainStep& step, int frame_idx, const RectifiedCamera& camera) {
  std::vector<uint8_t> png;
  IRIS_CHECK(cv::imencode(".png", motion::motion_picture(current, step, camera), png));
  write_file(folder / fmt::format("{:06d}.png", frame_idx), png);
}

// The step of the path that known poses give; the sub-map's frame is the first camera of them.
motion::ChainStep known_step(const KnownPoses& known, int frame_idx, int previous) {
  constexpr double kError = 1e-4;  // [m], [rad] what is given counts as exact
  motion::ChainStep step;
  const auto pose_of = [&](int frame) -> const std::optional<Pose>& { return known[static_cast<size_t>(frame)]; };
  if (!pose_of(frame_idx)) {
    step.blind = true;
    return step;
  }
  const auto first = std::find_if(known.begin(), known.end(), [](const auto& pose) { return pose.has_value(); });
  step.world_from_cam = (*first)->inverse() * *pose_of(frame_idx);
  if (previous < 0) {
    step.new_submap = true;
    return step;
  }
  step.reference_frame = previous;
  step.estimate.status = MotionStatus::ok;
  step.estimate.prev_from_cur = pose_of(previous)->inverse() * *pose_of(frame_idx);
  step.estimate.covariance = Matrix6d::Identity() * kError * kError;
  return step;
}

std::vector<std::string> run_frames(const session::Session& session, const Options& options, const KnownPoses& known,
                                    workspace::Workspace& workspace, const RunControl& control,
                                    const std::string& fingerprint) {
  if (workspace.value(kFramesFingerprint) != fingerprint) {
    workspace.clear_frames();
    const Preparation preparation = prepare(session, options);
    workspace.set_value(kRows, preparation.rows_text);
    workspace.set_value(kDisparities, std::to_string(preparation.disparities));
    workspace.set_value(kFramesFingerprint, fingerprint);
  }
  const FrameStream stream(session, options, std::stoi(*workspace.value(kDisparities)), known.empty());

  motion::MotionChain chain(stream.camera(), options.motion);
  const int first = workspace.frame_count();
  Pose last_view_pose = Pose::Identity();
  int last_view_submap = -1;
  if (first > 0) {
    spdlog::info("frames: going on behind frame {} of {}", first, session.size());
    if (known.empty()) {
      chain.restore(restore_frames(stream, remembered_frames(workspace, chain.kept_views()), session.folder(),
                                   session.random_access()),
                    workspace.submap_count());
    }
    if (const auto view = workspace.last_view_frame()) {
      const auto record = workspace.frame(*view);
      last_view_pose = record->submap_from_cam;
      last_view_submap = record->submap;
    }
  }

  int last_posed = -1;
  for (const workspace::FrameRecord& record : workspace.last_posed_frames(1)) last_posed = record.frame_idx;

  Progress progress(control.progress, "frames", session.size());
  progress.update(first);
  int next = first;
  const bool read_in_order = !session.random_access();

  const auto source = [&](tbb::flow_control& flow) -> std::shared_ptr<Item> {
    if (next >= session.size() || control.stopped()) {
      flow.stop();
      return nullptr;
    }
    auto item = std::make_shared<Item>();
    item->frame_idx = next++;
    item->stamp_ns = session.stamp_ns(item->frame_idx);
    if (read_in_order) stream.read(*item);
    return item;
  };
  const auto compute = [&](std::shared_ptr<Item> item) {
    if (!read_in_order) stream.read(*item);
    if (item->unreadable.empty()) stream.compute(*item);
    return item;
  };
  const auto register_frame = [&](std::shared_ptr<Item> item) {
    workspace::FrameRecord record{.frame_idx = item->frame_idx, .stamp_ns = item->stamp_ns};
    if (!item->unreadable.empty()) {
      spdlog::warn("frame {} is skipped: {}", item->frame_idx, item->unreadable);
      record.state = workspace::FrameState::unreadable;
      record.message = item->unreadable;
      workspace.add_frame(record, nullptr);
      progress.update(item->frame_idx + 1);
      return;
    }
    const motion::ChainStep step = known.empty() ? chain.push(std::move(item->features), item->frame_idx)
                                                 : known_step(known, item->frame_idx, last_posed);
    if (step.blind) {
      record.state = workspace::FrameState::blind;
      if (known.empty()) {
        record.message =
            fmt::format("{} usable corners, {} are needed", step.estimate.corners, options.motion.min_used);
        spdlog::info("frame {} shows too little to be placed: {}", item->frame_idx, record.message);
      } else {
        record.message = "its pose is not among the known ones";
      }
      workspace.add_frame(record, nullptr);
      progress.update(item->frame_idx + 1);
      return;
    }
    last_posed = item->frame_idx;
    record.submap = step.submap;
    record.submap_from_cam = step.world_from_cam;
    record.reference_frame = step.reference_frame;
    record.motion = step.estimate;
    if (step.new_submap && step.submap > 0) {
      spdlog::warn(
          "frame {}: no motion against the last {} views ({}: {} usable corners, {} consistent); sub-map {} begins",
          item->frame_idx, chain.kept_views(), name_of(step.estimate.status), step.estimate.corners,
          step.estimate.consistent, step.submap);
    } else if (step.rescued) {
      spdlog::info("frame {}: motion found against frame {} by SIFT and weak corners ({} pairs)", item->frame_idx,
                   step.reference_frame, step.estimate.used);
    } else if (step.estimate.status == MotionStatus::guessed) {
      spdlog::warn("frame {}: no motion against the last {} views; the motion before it is continued as a guess",
                   item->frame_idx, chain.kept_views());
    }
    if (!options.motion_pictures.empty() && known.empty()) {
      write_motion_picture(options.motion_pictures, *chain.view(item->frame_idx), step, item->frame_idx,
                           stream.camera());
    }
    if (stereo::fraction_at_limit(item->disparity, stream.stereo_options()) > kMaxAtLimit) record.too_near = true;

    const bool stored = step.submap != last_view_submap ||
                        views::is_new_view(last_view_pose, step.world_from_cam, stream.camera(), options.views);
    if (stored) {
      const StereoView view{
          .frame_idx = item->frame_idx,
          .stamp_ns = item->stamp_ns,
          .submap = step.submap,
          .camera = stream.camera(),
          .image = item->pair.left_colour.empty() ? cv::Mat(item->pair.left) : cv::Mat(item->pair.left_colour),
          .disparity = std::move(item->disparity),
          .world_from_cam = step.world_from_cam};
      workspace.add_frame(record, &view);
      last_view_pose = step.world_from_cam;
      last_view_submap = step.submap;
    } else {
      workspace.add_frame(record, nullptr);
    }
    progress.update(item->frame_idx + 1);
  };

  // Enough frames in flight to keep all threads busy while one registers; memory is bounded by them.
  const size_t in_flight = static_cast<size_t>(tbb::this_task_arena::max_concurrency()) + 2;
  tbb::parallel_pipeline(
      in_flight,
      tbb::make_filter<void, std::shared_ptr<Item>>(tbb::filter_mode::serial_in_order, source) &
          tbb::make_filter<std::shared_ptr<Item>, std::shared_ptr<Item>>(tbb::filter_mode::parallel, compute) &
          tbb::make_filter<std::shared_ptr<Item>, void>(tbb::filter_mode::serial_in_order, register_frame));
  if (next < session.size()) throw Interrupted();

  const FramesSummary summary = summarise_frames(workspace, workspace::Poses::odometry);
  if (summary.too_near > 0) spdlog::warn(summary.too_near_text());
  if (summary.posed == 0) {
    throw InputError(
        session.folder(),
        fmt::format("none of its {} frames has a pose: {} cannot be read, {} show too little (dark, covered or bare)",
                    summary.frames, summary.unreadable, summary.blind),
        "look at its pictures and at the log, which says why for each; if they are good, left and right are exchanged "
        "or the calibration is that of another camera");
  }
  return {};
}

}  // namespace

KnownPoses known_poses(std::string_view text, const std::filesystem::path& path, const session::Session& session,
                       const session::SessionOptions& options) {
  KnownPoses known(static_cast<size_t>(session.size()));
  Pose left_from_rect = Pose::Identity();
  left_from_rect.linear() = rectify::Rectifier(session.calibration()).rect_from_left().transpose();
  if (evaluate::is_kitti(text)) {
    const auto poses = evaluate::parse_kitti(text, path);
    for (size_t i = 0; i < known.size(); ++i) {
      const size_t line = static_cast<size_t>(options.first) + i * static_cast<size_t>(options.stride);
      if (line < poses.size() && poses[line]) known[i] = *poses[line] * left_from_rect;
    }
  } else {
    evaluate::Trajectory frames;
    std::map<int64_t, size_t> frame_at;
    for (int i = 0; i < session.size(); ++i) {
      frames.push_back({session.stamp_ns(i), Pose::Identity()});
      frame_at[session.stamp_ns(i)] = static_cast<size_t>(i);
    }
    for (const evaluate::PosePair& pair : evaluate::associate(frames, evaluate::parse_tum(text, path))) {
      known[frame_at.at(pair.stamp_ns)] = pair.truth * left_from_rect;
    }
  }
  const auto count = std::count_if(known.begin(), known.end(), [](const auto& pose) { return pose.has_value(); });
  if (count < 2) {
    throw InputError(path, fmt::format("knows the poses of {} of the recording's {} frames", count, known.size()),
                     "give the poses of this recording, with its time stamps (TUM) or one line a frame (KITTI)");
  }
  return known;
}

Stage frames_stage(const session::Session& session, const Options& options, KnownPoses known) {
  std::string inputs = session.fingerprint_text();
  for (size_t i = 0; i < known.size(); ++i) {
    if (!known[i]) continue;
    inputs += fmt::format("pose {}:", i);
    for (const double value : known[i]->matrix().topRows<3>().reshaped()) inputs += fmt::format(" {}", value);
    inputs += '\n';
  }
  return {.name = "frames",
          .sections = {"session", "stereo", "motion", "views"},
          .after = {},
          .inputs = inputs,
          .run = [&session, &options, known = std::move(known)](
                     workspace::Workspace& workspace, const RunControl& control, const std::string& fingerprint) {
            return run_frames(session, options, known, workspace, control, fingerprint);
          }};
}

FramesSummary summarise_frames(const workspace::Workspace& workspace, workspace::Poses poses) {
  FramesSummary summary;
  std::map<int, int> poses_of_submap;
  std::map<int, Eigen::Vector3d> last_position;
  workspace.for_each_frame([&](const workspace::FrameRecord& record) {
    ++summary.frames;
    if (record.state == workspace::FrameState::unreadable) ++summary.unreadable;
    if (record.state == workspace::FrameState::blind) ++summary.blind;
    if (record.too_near) ++summary.too_near;
  });
  for (const PoseNode& node : workspace.pose_graph(poses).nodes) {
    ++summary.posed;
    const Eigen::Vector3d position = node.world_from_cam.translation();
    if (poses_of_submap[node.submap]++ > 0) summary.path_length += (position - last_position[node.submap]).norm();
    last_position[node.submap] = position;
  }
  summary.submaps = static_cast<int>(poses_of_submap.size());
  int most = 0;
  for (const auto& [submap, poses] : poses_of_submap) {
    if (poses > most) {
      most = poses;
      summary.largest_submap = submap;
    }
  }
  summary.views = workspace.view_count();
  if (const auto text = workspace.value(kDisparities)) summary.disparities = std::stoi(*text);
  summary.rows_text = workspace.value(kRows).value_or("");
  return summary;
}

std::string FramesSummary::too_near_text() const {
  if (too_near == 0) return "";
  return fmt::format(
      "{} of {} frames show surfaces nearer than the search range of {} disparities reaches; they are seen with "
      "--stereo.disparities {} (slower)",
      too_near, frames, disparities, (disparities + disparities / 2 + 15) / 16 * 16);
}

}  // namespace iris::pipeline
