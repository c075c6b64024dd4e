#include "iris/workspace/workspace.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <list>
#include <mutex>
#include <sstream>
#include <unordered_map>

#include "database.h"
#include "iris/core/error.h"
#include "iris/workspace/view_files.h"

namespace iris::workspace {
namespace fs = std::filesystem;
namespace {

// Raised whenever the tables change: a workspace of another version is refused, not misread.
constexpr int kSchema = 4;

constexpr const char* kTables = R"(
CREATE TABLE IF NOT EXISTS about  (name TEXT PRIMARY KEY, text TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS value  (name TEXT PRIMARY KEY, text TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS stage  (name TEXT PRIMARY KEY, fingerprint TEXT NOT NULL, outputs TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS frame  (frame_idx INTEGER PRIMARY KEY, stamp_ns INTEGER NOT NULL, state INTEGER NOT NULL,
                                   message TEXT NOT NULL, too_near INTEGER NOT NULL);
CREATE TABLE IF NOT EXISTS pose   (frame_idx INTEGER PRIMARY KEY, submap INTEGER NOT NULL, submap_from_cam BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS motion (frame_idx INTEGER PRIMARY KEY, reference_frame INTEGER NOT NULL, status INTEGER NOT NULL,
                                   reference_from_frame BLOB NOT NULL, covariance BLOB NOT NULL, corners INTEGER NOT NULL,
                                   initial INTEGER NOT NULL, consistent INTEGER NOT NULL, used INTEGER NOT NULL,
                                   rms_px REAL NOT NULL);
CREATE TABLE IF NOT EXISTS view   (frame_idx INTEGER PRIMARY KEY, f REAL NOT NULL, cx REAL NOT NULL, cy REAL NOT NULL,
                                   baseline REAL NOT NULL, disparity_offset REAL NOT NULL,
                                   width INTEGER NOT NULL, height INTEGER NOT NULL, min_disparity REAL NOT NULL,
                                   max_disparity REAL NOT NULL, disparity_scale INTEGER NOT NULL);
CREATE TABLE IF NOT EXISTS refined(frame_idx INTEGER PRIMARY KEY, submap INTEGER NOT NULL, world_from_cam BLOB NOT NULL,
                                   covariance BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS world  (submap INTEGER PRIMARY KEY, floor_found INTEGER NOT NULL, alignment TEXT NOT NULL,
                                   up_guessed INTEGER NOT NULL);
CREATE TABLE IF NOT EXISTS sigma (odometry REAL NOT NULL, loop REAL NOT NULL);
CREATE TABLE IF NOT EXISTS camera (f REAL NOT NULL, cx REAL NOT NULL, cy REAL NOT NULL, baseline REAL NOT NULL,
                                   disparity_offset REAL NOT NULL, calibration TEXT NOT NULL,
                                   calibration_is_wrong INTEGER NOT NULL);
CREATE TABLE IF NOT EXISTS loop   (i INTEGER NOT NULL, j INTEGER NOT NULL, i_from_j BLOB NOT NULL, covariance BLOB NOT NULL,
                                   used INTEGER NOT NULL, consistent INTEGER NOT NULL, motion INTEGER NOT NULL,
                                   rms_px REAL NOT NULL, score REAL NOT NULL, source INTEGER NOT NULL,
                                   rescued INTEGER NOT NULL, spread REAL NOT NULL, agreement REAL NOT NULL,
                                   chi_square REAL NOT NULL, verdict INTEGER NOT NULL, error REAL NOT NULL,
                                   PRIMARY KEY (i, j)) WITHOUT ROWID;
)";

// With these the queries of poses read alike: frame_idx, submap, pose.
const char* table_of(Poses poses) {
  return poses == Poses::refined ? "(SELECT frame_idx, submap, world_from_cam AS pose, covariance FROM refined)"
                                 : "(SELECT frame_idx, submap, submap_from_cam AS pose, NULL AS covariance FROM pose)";
}

// An advisory lock for the life of the workspace; the system drops it however the process ends.
class FolderLock {
 public:
  explicit FolderLock(const fs::path& folder) {
    const fs::path path = folder / ".lock";
    fd_ = ::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
    if (fd_ < 0) {
      throw InputError(folder, "cannot be written", "check its permissions, or choose another folder with -o");
    }
    if (flock(fd_, LOCK_EX | LOCK_NB) != 0) {
      ::close(fd_);
      throw InputError(folder, "another iris is working in this folder",
                       "wait for it, or choose another folder with -o");
    }
  }
  ~FolderLock() { ::close(fd_); }
  FolderLock(const FolderLock&) = delete;
  FolderLock& operator=(const FolderLock&) = delete;

 private:
  int fd_;
};

Pose pose_of(const Eigen::Matrix<double, 3, 4>& matrix) {
  Pose pose = Pose::Identity();
  pose.affine() = matrix;
  return pose;
}

Eigen::Matrix<double, 3, 4> matrix_of(const Pose& pose) { return pose.affine(); }

// What a killed run left half written.
void remove_temporaries(const fs::path& folder) {
  std::error_code ignored;
  std::vector<fs::path> stale;
  for (const auto& entry : fs::recursive_directory_iterator(folder, ignored)) {
    if (entry.path().filename().string().starts_with(".tmp.")) stale.push_back(entry.path());
  }
  for (const fs::path& path : stale) fs::remove(path, ignored);
}

struct ViewRow {
  views::ViewSummary summary;
  int64_t stamp_ns = 0;
  int disparity_scale = 256;
};

// Views are read from their files when asked for; the most recently used stay in memory.
class CachedViewStore : public views::ViewStore {
 public:
  CachedViewStore(fs::path folder, std::vector<ViewRow> rows, size_t cache_bytes)
      : folder_(std::move(folder)), rows_(std::move(rows)), cache_bytes_(cache_bytes) {
    for (const ViewRow& row : rows_) summaries_.push_back(row.summary);
  }

  const std::vector<views::ViewSummary>& summaries() const override { return summaries_; }

  std::shared_ptr<const StereoView> load(int index) const override {
    {
      const std::lock_guard lock(mutex_);
      const auto found = cache_.find(index);
      if (found != cache_.end()) {
        recent_.splice(recent_.begin(), recent_, found->second.position);
        return found->second.view;
      }
    }
    const ViewRow& row = rows_.at(static_cast<size_t>(index));
    auto view = std::make_shared<StereoView>();
    view->frame_idx = row.summary.frame_idx;
    view->stamp_ns = row.stamp_ns;
    view->submap = row.summary.submap;
    view->camera = row.summary.camera;
    view->world_from_cam = row.summary.world_from_cam;
    read_view(folder_, row.disparity_scale, *view);

    const std::lock_guard lock(mutex_);
    if (!cache_.contains(index)) {
      recent_.push_front(index);
      cache_[index] = {view, recent_.begin()};
      bytes_ += bytes_of(*view);
      while (bytes_ > cache_bytes_ && recent_.size() > 1) {
        const auto oldest = cache_.find(recent_.back());
        bytes_ -= bytes_of(*oldest->second.view);
        cache_.erase(oldest);
        recent_.pop_back();
      }
    }
    return view;
  }

 private:
  struct Entry {
    std::shared_ptr<const StereoView> view;
    std::list<int>::iterator position;
  };
  static size_t bytes_of(const StereoView& view) {
    return view.image.total() * view.image.elemSize() + view.disparity.disparity.total() * 5;
  }

  fs::path folder_;
  std::vector<ViewRow> rows_;
  std::vector<views::ViewSummary> summaries_;
  size_t cache_bytes_;
  mutable std::mutex mutex_;
  mutable std::list<int> recent_;  // front = used last
  mutable std::unordered_map<int, Entry> cache_;
  mutable size_t bytes_ = 0;
};

constexpr const char* kSelectFrame =
    "SELECT frame.frame_idx, stamp_ns, state, message, submap, submap_from_cam, reference_frame, status, "
    "reference_from_frame, covariance, corners, initial, consistent, used, rms_px, too_near "
    "FROM frame LEFT JOIN pose USING (frame_idx) LEFT JOIN motion USING (frame_idx) ";

FrameRecord frame_of(const Statement& row) {
  FrameRecord record;
  record.frame_idx = static_cast<int>(row.integer(0));
  record.stamp_ns = row.integer(1);
  record.state = static_cast<FrameState>(row.integer(2));
  record.message = row.text(3);
  record.too_near = row.integer(15) != 0;
  if (record.state != FrameState::posed) return record;
  record.submap = static_cast<int>(row.integer(4));
  record.submap_from_cam = pose_of(row.matrix<Eigen::Matrix<double, 3, 4>>(5));
  record.reference_frame = static_cast<int>(row.integer(6));
  record.motion.status = static_cast<MotionStatus>(row.integer(7));
  record.motion.prev_from_cur = pose_of(row.matrix<Eigen::Matrix<double, 3, 4>>(8));
  record.motion.covariance = row.matrix<Matrix6d>(9);
  record.motion.corners = static_cast<int>(row.integer(10));
  record.motion.initial = static_cast<int>(row.integer(11));
  record.motion.consistent = static_cast<int>(row.integer(12));
  record.motion.used = static_cast<int>(row.integer(13));
  record.motion.rms_px = row.real(14);
  return record;
}

}  // namespace

struct Workspace::Impl {
  Impl(const fs::path& path, Database::Access access)
      : folder(path),
        lock(access == Database::Access::read_write ? std::make_unique<FolderLock>(path) : nullptr),
        database(path / "workspace.db", access) {
    if (access == Database::Access::read_only) return;
    database.run("PRAGMA journal_mode=WAL");
    database.run("PRAGMA synchronous=NORMAL");
    remove_temporaries(folder);
  }

  std::optional<std::string> text(const char* table, const std::string& name) const {
    Statement select(database, fmt::format("SELECT text FROM {} WHERE name = ?1", table));
    if (!select.bind(name).step()) return std::nullopt;
    return select.text(0);
  }
  void set_text(const char* table, const std::string& name, const std::string& text) const {
    Statement(database, fmt::format("INSERT OR REPLACE INTO {} VALUES (?1, ?2)", table)).bind(name, text).step();
  }

  // "<size> <file>" a line; a file that is not there has the size -1.
  std::string outputs_text(const std::vector<std::string>& files) const {
    std::string text;
    for (const std::string& file : files) {
      std::error_code missing;
      const auto size = fs::file_size(folder / file, missing);
      text += fmt::format("{} {}\n", missing ? -1 : static_cast<int64_t>(size), file);
    }
    return text;
  }
  std::string outputs_of(const std::string& stage) const {
    Statement select(database, "SELECT outputs FROM stage WHERE name = ?1");
    return select.bind(stage).step() ? select.text(0) : std::string();
  }

  fs::path views_folder() const { return folder / "views"; }

  fs::path folder;
  std::unique_ptr<FolderLock> lock;  // null when reading only
  Database database;
};

Workspace::Workspace(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Workspace::Workspace(Workspace&&) noexcept = default;
Workspace& Workspace::operator=(Workspace&&) noexcept = default;
Workspace::~Workspace() = default;

Workspace Workspace::create(const fs::path& folder, const std::string& session_folder,
                            const std::string& session_identity) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) {
    throw InputError(folder, "cannot be made (" + error.message() + ")", "check the path, or choose another with -o");
  }
  const bool there = fs::exists(folder / "workspace.db");
  if (!there) {
    for (const auto& entry : fs::directory_iterator(folder)) {
      if (entry.path().filename() == ".lock") continue;
      throw InputError(folder, "holds files that are no output of iris (" + entry.path().filename().string() + ")",
                       "choose an empty or new folder with -o");
    }
  }
  auto impl = std::make_unique<Impl>(folder, Database::Access::read_write);
  {
    Transaction transaction(impl->database);
    impl->database.run(kTables);
    const auto schema = impl->text("about", "schema");
    if (schema && *schema != std::to_string(kSchema)) {
      throw InputError(folder, "was written by another version of iris", "choose another folder with -o");
    }
    const auto owner = impl->text("about", "session_identity");
    if (owner && *owner != session_identity) {
      throw InputError(
          folder, "holds the output of another session (" + impl->text("about", "session_folder").value_or("?") + ")",
          "choose another folder with -o, or delete this one");
    }
    impl->set_text("about", "schema", std::to_string(kSchema));
    impl->set_text("about", "session_identity", session_identity);
    impl->set_text("about", "session_folder", session_folder);
    transaction.commit();
  }
  return Workspace(std::move(impl));
}

Workspace Workspace::open(const fs::path& folder, Access access) {
  if (!fs::exists(folder / "workspace.db")) {
    throw InputError(folder, "is no output folder of iris (it has no workspace.db)",
                     "give the folder that 'iris run SESSION -o OUT' wrote");
  }
  auto impl = std::make_unique<Impl>(
      folder, access == Access::read_only ? Database::Access::read_only : Database::Access::read_write);
  if (impl->text("about", "schema") != std::to_string(kSchema)) {
    throw InputError(folder, "was written by another version of iris", "run the session again into a new folder");
  }
  return Workspace(std::move(impl));
}

const fs::path& Workspace::folder() const { return impl_->folder; }
std::string Workspace::session_folder() const { return impl_->text("about", "session_folder").value_or(""); }
std::optional<std::string> Workspace::value(const std::string& name) const { return impl_->text("value", name); }
void Workspace::set_value(const std::string& name, const std::string& text) { impl_->set_text("value", name, text); }

std::optional<StageRecord> Workspace::stage(const std::string& stage) const {
  Statement select(impl_->database, "SELECT fingerprint, outputs FROM stage WHERE name = ?1");
  if (!select.bind(stage).step()) return std::nullopt;
  StageRecord record{.fingerprint = select.text(0), .outputs = {}};
  std::istringstream lines(select.text(1));
  for (std::string line; std::getline(lines, line);) record.outputs.push_back(line.substr(line.find(' ') + 1));
  return record;
}

bool Workspace::finished(const std::string& name, const std::string& fingerprint) const {
  const auto record = stage(name);
  return record && record->fingerprint == fingerprint &&
         impl_->outputs_text(record->outputs) == impl_->outputs_of(name);
}

void Workspace::finish(const std::string& name, const StageRecord& record) {
  const std::string outputs = impl_->outputs_text(record.outputs);
  Statement(impl_->database, "INSERT OR REPLACE INTO stage VALUES (?1, ?2, ?3)")
      .bind(name, record.fingerprint, outputs)
      .step();
}

void Workspace::forget(const std::string& name) {
  Statement(impl_->database, "DELETE FROM stage WHERE name = ?1").bind(name).step();
}

void Workspace::clear_frames() {
  {
    Transaction transaction(impl_->database);
    impl_->database.run(
        "DELETE FROM frame; DELETE FROM pose; DELETE FROM motion; DELETE FROM view; DELETE FROM value; "
        "DELETE FROM refined; DELETE FROM world; DELETE FROM camera; DELETE FROM loop; DELETE FROM sigma");
    transaction.commit();
  }
  std::error_code ignored;
  fs::remove_all(impl_->views_folder(), ignored);
}

void Workspace::add_frame(const FrameRecord& record, const StereoView* view) {
  const Database& db = impl_->database;
  views::ViewSummary summary;
  int scale = 256;
  if (view) {
    summary = views::summarise(*view);
    scale = disparity_scale(summary.max_disparity);
    write_view(impl_->views_folder(), *view, scale);
  }
  Transaction transaction(db);
  Statement(db, "INSERT INTO frame VALUES (?1, ?2, ?3, ?4, ?5)")
      .bind(record.frame_idx, record.stamp_ns, static_cast<int>(record.state), record.message,
            static_cast<int>(record.too_near))
      .step();
  if (record.state == FrameState::posed) {
    Statement(db, "INSERT INTO pose VALUES (?1, ?2, ?3)")
        .bind(record.frame_idx, record.submap, matrix_of(record.submap_from_cam))
        .step();
    const MotionEstimate& m = record.motion;
    Statement(db, "INSERT INTO motion VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10)")
        .bind(record.frame_idx, record.reference_frame, static_cast<int>(m.status), matrix_of(m.prev_from_cur),
              m.covariance, m.corners, m.initial, m.consistent, m.used, m.rms_px)
        .step();
  }
  if (view) {
    const RectifiedCamera& c = view->camera;
    Statement(db, "INSERT INTO view VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11)")
        .bind(view->frame_idx, c.f, c.cx, c.cy, c.baseline, c.disparity_offset, c.width, c.height,
              summary.min_disparity, summary.max_disparity, scale)
        .step();
  }
  transaction.commit();
}

int Workspace::frame_count() const {
  Statement count(impl_->database, "SELECT count(*) FROM frame");
  count.step();
  return static_cast<int>(count.integer(0));
}

int Workspace::view_count() const {
  Statement count(impl_->database, "SELECT count(*) FROM view");
  count.step();
  return static_cast<int>(count.integer(0));
}

int Workspace::submap_count() const {
  Statement count(impl_->database, "SELECT count(DISTINCT submap) FROM pose");
  count.step();
  return static_cast<int>(count.integer(0));
}

std::optional<FrameRecord> Workspace::frame(int frame_idx) const {
  Statement select(impl_->database, std::string(kSelectFrame) + "WHERE frame.frame_idx = ?1");
  if (!select.bind(frame_idx).step()) return std::nullopt;
  return frame_of(select);
}

std::vector<FrameRecord> Workspace::last_posed_frames(int count) const {
  Statement select(impl_->database,
                   std::string(kSelectFrame) + "WHERE state = 1 ORDER BY frame.frame_idx DESC LIMIT ?1");
  select.bind(count);
  std::vector<FrameRecord> records;
  while (select.step()) records.push_back(frame_of(select));
  std::reverse(records.begin(), records.end());
  return records;
}

void Workspace::for_each_frame(const std::function<void(const FrameRecord&)>& visit) const {
  Statement select(impl_->database, std::string(kSelectFrame) + "ORDER BY frame.frame_idx");
  while (select.step()) visit(frame_of(select));
}

std::optional<int> Workspace::last_view_frame() const {
  Statement select(impl_->database, "SELECT max(frame_idx) FROM view HAVING count(*) > 0");
  if (!select.step()) return std::nullopt;
  return static_cast<int>(select.integer(0));
}

void Workspace::set_refined(const RefinedPath& path) {
  const Database& db = impl_->database;
  Transaction transaction(db);
  db.run("DELETE FROM refined; DELETE FROM world; DELETE FROM camera; DELETE FROM loop; DELETE FROM sigma");
  Statement(db, "INSERT INTO sigma VALUES (?1, ?2)").bind(path.odometry_sigma, path.loop_sigma).step();
  const RectifiedCamera& c = path.camera;
  Statement(db, "INSERT INTO camera VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)")
      .bind(c.f, c.cx, c.cy, c.baseline, c.disparity_offset, path.calibration.text,
            static_cast<int>(path.calibration.is_wrong))
      .step();
  for (const PoseNode& node : path.nodes) {
    Statement(db, "INSERT INTO refined VALUES (?1, ?2, ?3, ?4)")
        .bind(node.frame_idx, node.submap, matrix_of(node.world_from_cam), node.covariance)
        .step();
  }
  for (const WorldRecord& world : path.worlds) {
    Statement(db, "INSERT INTO world VALUES (?1, ?2, ?3, ?4)")
        .bind(world.submap, world.floor_found, world.alignment, world.up_guessed)
        .step();
  }
  for (const LoopRecord& loop : path.loops) {
    const loop::LoopEdge& e = loop.edge;
    Statement(db, "INSERT INTO loop VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16)")
        .bind(e.i, e.j, matrix_of(e.i_from_j), e.covariance, e.used, e.consistent, static_cast<int>(e.motion), e.rms_px,
              e.score, static_cast<int>(e.source), e.rescued, e.spread, e.agreement, e.chi_square,
              static_cast<int>(e.verdict), loop.error)
        .step();
  }
  transaction.commit();
}

std::vector<LoopRecord> Workspace::loops() const {
  Statement select(impl_->database,
                   "SELECT i, j, i_from_j, covariance, used, consistent, motion, rms_px, score, source, rescued, "
                   "spread, agreement, chi_square, verdict, error FROM loop ORDER BY i, j");
  std::vector<LoopRecord> loops;
  while (select.step()) {
    LoopRecord loop;
    loop.edge.i = static_cast<int>(select.integer(0));
    loop.edge.j = static_cast<int>(select.integer(1));
    loop.edge.i_from_j = pose_of(select.matrix<Eigen::Matrix<double, 3, 4>>(2));
    loop.edge.covariance = select.matrix<Matrix6d>(3);
    loop.edge.used = static_cast<int>(select.integer(4));
    loop.edge.consistent = static_cast<int>(select.integer(5));
    loop.edge.motion = static_cast<MotionStatus>(select.integer(6));
    loop.edge.rms_px = select.real(7);
    loop.edge.score = select.real(8);
    loop.edge.source = static_cast<loop::Candidate::Source>(select.integer(9));
    loop.edge.rescued = select.integer(10) != 0;
    loop.edge.spread = select.real(11);
    loop.edge.agreement = select.real(12);
    loop.edge.chi_square = select.real(13);
    loop.edge.verdict = static_cast<loop::LoopVerdict>(select.integer(14));
    loop.error = select.real(15);
    loops.push_back(loop);
  }
  return loops;
}

std::string WorldRecord::guess_text() const {
  if (!up_guessed) return "";
  return fmt::format(
      "up of sub-map {} is a guess ({}): map, layers and heights hang on it. Where it is wrong, say what is up with "
      "--up first-camera|path|x,y,z",
      submap, alignment);
}

std::vector<WorldRecord> Workspace::worlds() const {
  Statement select(impl_->database, "SELECT submap, floor_found, alignment, up_guessed FROM world ORDER BY submap");
  std::vector<WorldRecord> worlds;
  while (select.step()) {
    worlds.push_back({.submap = static_cast<int>(select.integer(0)),
                      .floor_found = select.integer(1) != 0,
                      .alignment = select.text(2),
                      .up_guessed = select.integer(3) != 0});
  }
  return worlds;
}

CalibrationRecord Workspace::calibration() const {
  Statement select(impl_->database, "SELECT calibration, calibration_is_wrong FROM camera");
  if (!select.step()) return {};
  return {.text = select.text(0), .is_wrong = select.integer(1) != 0};
}

PoseGraph Workspace::pose_graph(Poses poses) const {
  PoseGraph graph;
  Statement select(impl_->database, fmt::format("SELECT frame_idx, stamp_ns, submap, pose, covariance FROM frame "
                                                "JOIN {} USING (frame_idx) ORDER BY frame_idx",
                                                table_of(poses)));
  while (select.step()) {
    PoseNode node{.frame_idx = static_cast<int>(select.integer(0)),
                  .stamp_ns = select.integer(1),
                  .world_from_cam = pose_of(select.matrix<Eigen::Matrix<double, 3, 4>>(3)),
                  .submap = static_cast<int>(select.integer(2))};
    if (poses == Poses::refined) node.covariance = select.matrix<Matrix6d>(4);
    graph.nodes.push_back(node);
  }
  double odometry_sigma = 1, loop_sigma = 1;
  if (poses == Poses::refined) {
    Statement sigma(impl_->database, "SELECT odometry, loop FROM sigma");
    if (sigma.step()) odometry_sigma = sigma.real(0), loop_sigma = sigma.real(1);
  }
  for_each_frame([&](const FrameRecord& record) {
    if (record.state != FrameState::posed || record.reference_frame < 0) return;
    graph.edges.push_back(
        {.i = record.reference_frame,
         .j = record.frame_idx,
         .i_from_j = record.motion.prev_from_cur,
         .information = record.motion.covariance.inverse() / (odometry_sigma * odometry_sigma),
         .kind = record.motion.status == MotionStatus::guessed ? PoseEdgeKind::guessed : PoseEdgeKind::odometry});
  });
  if (poses == Poses::odometry) return graph;
  for (const LoopRecord& loop : loops()) {
    if (loop.edge.verdict != loop::LoopVerdict::accepted) continue;
    graph.edges.push_back({.i = loop.edge.i,
                           .j = loop.edge.j,
                           .i_from_j = loop.edge.i_from_j,
                           .information = loop.edge.covariance.inverse() / (loop_sigma * loop_sigma),
                           .kind = PoseEdgeKind::loop});
  }
  return graph;
}

std::unique_ptr<views::ViewStore> Workspace::views(Poses poses, int submap, size_t cache_bytes) const {
  Statement select(impl_->database,
                   fmt::format("SELECT frame_idx, submap, f, cx, cy, baseline, disparity_offset, width, height, "
                               "min_disparity, max_disparity, disparity_scale, stamp_ns, pose FROM view "
                               "JOIN frame USING (frame_idx) JOIN {} USING (frame_idx) "
                               "WHERE ?1 < 0 OR submap = ?1 ORDER BY frame_idx",
                               table_of(poses)));
  select.bind(submap);
  Statement camera(impl_->database, "SELECT f, cx, cy, baseline, disparity_offset FROM camera");
  const bool refined = poses == Poses::refined && camera.step();
  std::vector<ViewRow> rows;
  while (select.step()) {
    ViewRow row;
    row.summary.frame_idx = static_cast<int>(select.integer(0));
    row.summary.submap = static_cast<int>(select.integer(1));
    row.summary.camera = {.f = select.real(2),
                          .cx = select.real(3),
                          .cy = select.real(4),
                          .baseline = select.real(5),
                          .disparity_offset = select.real(6),
                          .width = static_cast<int>(select.integer(7)),
                          .height = static_cast<int>(select.integer(8))};
    row.summary.min_disparity = select.real(9);
    row.summary.max_disparity = select.real(10);
    row.disparity_scale = static_cast<int>(select.integer(11));
    row.stamp_ns = select.integer(12);
    row.summary.world_from_cam = pose_of(select.matrix<Eigen::Matrix<double, 3, 4>>(13));
    if (refined) {
      row.summary.camera.f = camera.real(0);
      row.summary.camera.cx = camera.real(1);
      row.summary.camera.cy = camera.real(2);
      row.summary.camera.baseline = camera.real(3);
      row.summary.camera.disparity_offset = camera.real(4);
    }
    rows.push_back(row);
  }
  return std::make_unique<CachedViewStore>(impl_->views_folder(), std::move(rows), cache_bytes);
}

}  // namespace iris::workspace
