// The run on disk. Small records (frames, motions, poses, views, finished stages) live in OUT/workspace.db (SQLite,
// WAL); rasters are files beside it. A frame's files are complete before its record is committed, so that whatever the
// moment of an interruption, every record refers to whole files and the next run goes on behind the last record.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "iris/loop/verification.h"
#include "iris/types/motion_estimate.h"
#include "iris/types/pose_graph.h"
#include "iris/types/stereo_view.h"
#include "iris/views/view_store.h"

namespace iris::workspace {

// Whether a frame of the session has a pose, or why it has none: its images are damaged, or show too little (a covered
// lens, darkness, a bare wall). The numbers are stored.
enum class FrameState { unreadable = 0, posed = 1, blind = 2 };

// What became of one frame of the session.
struct FrameRecord {
  int frame_idx = 0;
  int64_t stamp_ns = 0;
  FrameState state = FrameState::posed;
  std::string message;    // why it has no pose
  bool too_near = false;  // surfaces are probably nearer than the disparities searched for reach

  // Of frames with a pose:
  int submap = 0;
  Pose submap_from_cam = Pose::Identity();  // the sub-map's frame is its first camera
  int reference_frame = -1;                 // the earlier frame that `motion` is measured against; -1: begins a sub-map
  MotionEstimate motion;                    // status is ok only with a reference frame
};

// A pair of views that the loop stage looked at.
struct LoopRecord {
  loop::LoopEdge edge;
  double error = 0;  // [standard deviations] what is left of the edge after refinement; 0 if it was not accepted
};

// How a sub-map of the refined path came to stand upright.
struct WorldRecord {
  int submap = 0;
  bool floor_found = false;  // z = 0 is the floor; else the height of the first camera
  std::string alignment;     // how up was found, for people
  bool up_guessed = false;   // … where no surface told it

  // What to do about an up that may be wrong, in a sentence; empty if it is not.
  std::string guess_text() const;
};

// What the recording told about its calibration.
struct CalibrationRecord {
  std::string text;       // for people; empty = nothing could be told
  bool is_wrong = false;  // and nothing could be done about it
};

// The path after loop closure and refinement.
struct RefinedPath {
  std::vector<PoseNode> nodes;      // of all frames with a pose, in their order; worlds are z up
  std::vector<WorldRecord> worlds;  // one a sub-map
  std::vector<LoopRecord> loops;
  // [times] by which errors of odometry and of loops are larger than their covariances say (loop::RefinedGraph).
  double odometry_sigma = 1, loop_sigma = 1;
  RectifiedCamera camera;  // of all views, with what the recording told about its calibration
  CalibrationRecord calibration;
};

// Which poses: those that motions chained give, in the frame of each sub-map's first camera, or those of the loop
// stage.
enum class Poses { odometry, refined };

// Record of a finished stage.
struct StageRecord {
  std::string fingerprint;           // of everything its result depends on
  std::vector<std::string> outputs;  // files relative to the output folder
};

class Workspace {
 public:
  // Opens or creates the workspace in `folder` for a session. Throws InputError if the folder holds something else, the
  // output of another session, is in use by another run, or cannot be written.
  static Workspace create(const std::filesystem::path& folder, const std::string& session_folder,
                          const std::string& session_identity);
  // Opens the finished or partial output of an earlier run. Reading only needs no write access and works while a run is
  // under way. Throws InputError if there is none.
  enum class Access { read_write, read_only };
  static Workspace open(const std::filesystem::path& folder, Access access = Access::read_write);

  Workspace(Workspace&&) noexcept;
  Workspace& operator=(Workspace&&) noexcept;
  ~Workspace();

  const std::filesystem::path& folder() const;
  std::string session_folder() const;

  // Small named values (the search range, …), stored until clear_frames().
  std::optional<std::string> value(const std::string& name) const;
  void set_value(const std::string& name, const std::string& text);

  // Stages. finished() is true if the record has this fingerprint and all its outputs are there with
  // the size that they had.
  bool finished(const std::string& stage, const std::string& fingerprint) const;
  std::optional<StageRecord> stage(const std::string& stage) const;
  void finish(const std::string& stage, const StageRecord& record);
  void forget(const std::string& stage);

  // Frames, in order. Removes everything that belongs to frames: records, values and view files.
  void clear_frames();
  // Commits one frame; `view` (may be null) is written to files first.
  void add_frame(const FrameRecord& record, const StereoView* view);
  int frame_count() const;
  std::optional<FrameRecord> frame(int frame_idx) const;
  std::vector<FrameRecord> last_posed_frames(int count) const;  // ascending
  void for_each_frame(const std::function<void(const FrameRecord&)>& visit) const;
  std::optional<int> last_view_frame() const;
  int view_count() const;
  int submap_count() const;

  // The loop stage's result; takes the place of an earlier one.
  void set_refined(const RefinedPath& path);
  std::vector<LoopRecord> loops() const;
  std::vector<WorldRecord> worlds() const;
  CalibrationRecord calibration() const;  // of the loop stage; empty before it

  // Poses of all frames that have one with their odometry edges and, of the refined path, its accepted loops; edges of
  // the refined path state the errors that the loop stage found them to have.
  PoseGraph pose_graph(Poses poses) const;

  // The stored views of one sub-map (or of all: submap < 0), read on demand through a cache of at most `cache_bytes`.
  // With refined poses they have the refined path's camera.
  std::unique_ptr<views::ViewStore> views(Poses poses, int submap, size_t cache_bytes) const;

 private:
  struct Impl;
  explicit Workspace(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace iris::workspace
