#include "iris/session/session.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <map>
#include <opencv2/core/utils/logger.hpp>
#include <optional>
#include <sstream>

#include "common.h"
#include "iris/calibrate/calibration_file.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/session/image_file.h"
#include "iris/session/pairing.h"

namespace iris::session {
namespace {

namespace fs = std::filesystem;

constexpr double kNominalRate = 10;  // [Hz] of recordings that do not say theirs

const char* const kLayouts =
    "understood are: EuRoC/ASL (mav0/cam0/data, mav0/cam1/data, sensor.yaml); KITTI odometry (image_0, image_1 or "
    "image_2, "
    "image_3, calib.txt); two image folders (left/right, cam0/cam1, image_left/image_right, image_l/image_r) with a "
    "calibration "
    "file; images named left…/right… with a calibration file; two videos (left.mp4, right.mp4) or one side-by-side or "
    "top-bottom "
    "video with a calibration file";

struct RecordedImage {
  fs::path file;
  int64_t key = 0;  // stamp [ns] or frame number
};

struct RecordedFrame {
  fs::path left, right;
  int64_t stamp_ns = 0;
};

// The images of both cameras before they are paired.
struct Layout {
  std::string kind;
  std::vector<RecordedImage> left, right;
  bool keys_are_stamps = false;
  fs::path left_folder;  // where times may lie
  calibrate::KittiPair kitti_pair = calibrate::KittiPair::any;
  bool kitti_pair_by_colour = false;  // take P2, P3 if the images turn out to be in colour
};

std::string lower(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return std::tolower(c); });
  return text;
}

// --- listing -------------------------------------------------------------------------------------------------------

// The folder of this name in any case, or the data folder in it; empty if there is none.
fs::path image_folder(const fs::path& base, const std::string& name) {
  if (!fs::is_directory(base)) return {};
  for (const fs::directory_entry& entry : fs::directory_iterator(base)) {
    if (entry.is_directory() && lower(entry.path().filename().string()) == name) {
      return fs::is_directory(entry.path() / "data") ? entry.path() / "data" : entry.path();
    }
  }
  return {};
}

std::vector<fs::path> files_in(const fs::path& folder, bool (*wanted)(const fs::path&)) {
  std::vector<fs::path> files;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder)) {
    if (wanted(entry.path()) && entry.is_regular_file()) files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  return files;
}

// ASL's data.csv beside the data folder: "stamp,file name" lines. Empty if there is none.
std::vector<RecordedImage> images_in_csv(const fs::path& data_folder, std::vector<std::string>& notes) {
  const fs::path csv = data_folder.parent_path() / "data.csv";
  std::vector<RecordedImage> images;
  if (!fs::exists(csv)) return images;
  std::istringstream lines(read_file(csv));
  int missing = 0, line_number = 0;
  std::string example;
  for (std::string line; std::getline(lines, line);) {
    ++line_number;
    while (!line.empty() && std::isspace(static_cast<unsigned char>(line.back()))) line.pop_back();
    if (line.empty() || line.starts_with('#')) continue;
    const size_t comma = line.find(',');
    const auto stamp = stamp_in_name(line.substr(0, comma));
    if (comma == std::string::npos || !stamp) {
      throw InputError(csv, fmt::format("line {} is not 'stamp,file name'", line_number),
                       "mend the line or take the file away");
    }
    const size_t name = line.find_first_not_of(' ', comma + 1);
    if (name == std::string::npos) {
      throw InputError(csv, fmt::format("line {} names no file", line_number), "mend the line or take the file away");
    }
    const fs::path file = data_folder / line.substr(name);
    if (fs::is_regular_file(file)) {
      images.push_back({file, *stamp});
    } else {
      ++missing;
      if (example.empty()) example = file.filename().string();
    }
  }
  if (missing > 0) {
    notes.push_back(
        fmt::format("{} names {} images that are not there (the first is {})", csv.string(), missing, example));
  }
  return images;
}

// Sets stamps or frame numbers from the names. False if a name has none or two names have the same.
template <class FromName>
bool set_keys(std::vector<RecordedImage>& images, const FromName& key_in_name) {
  for (RecordedImage& image : images) {
    const auto key = key_in_name(image.file.stem().string());
    if (!key) return false;
    image.key = *key;
  }
  std::stable_sort(images.begin(), images.end(), [](const auto& a, const auto& b) { return a.key < b.key; });
  return std::adjacent_find(images.begin(), images.end(),
                            [](const auto& a, const auto& b) { return a.key == b.key; }) == images.end();
}

// Keys of both sides, of the first kind that all names have: stamps, frame numbers, the order of the names.
void set_keys(Layout& layout, const fs::path& folder) {
  layout.keys_are_stamps = set_keys(layout.left, stamp_in_name) && set_keys(layout.right, stamp_in_name);
  if (layout.keys_are_stamps) return;
  if (set_keys(layout.left, number_in_name) && set_keys(layout.right, number_in_name)) return;
  if (layout.left.size() != layout.right.size()) {
    throw InputError(folder,
                     fmt::format("{} left and {} right images whose names have neither time stamps nor frame numbers",
                                 layout.left.size(), layout.right.size()),
                     "number the images; equal numbers belong together");
  }
  for (std::vector<RecordedImage>* images : {&layout.left, &layout.right}) {
    std::sort(images->begin(), images->end(), [](const auto& a, const auto& b) { return a.file < b.file; });
    for (size_t i = 0; i < images->size(); ++i) (*images)[i].key = static_cast<int64_t>(i);
  }
}

std::vector<RecordedImage> images_in(const fs::path& folder) {
  std::vector<RecordedImage> images;
  for (fs::path& file : files_in(folder, is_image_file)) images.push_back({std::move(file), 0});
  return images;
}

Layout folder_layout(const std::string& kind, const fs::path& folder, const fs::path& left, const fs::path& right,
                     std::vector<std::string>& notes) {
  Layout layout;
  layout.kind = kind;
  layout.left_folder = left;
  layout.left = images_in_csv(left, notes);
  layout.right = images_in_csv(right, notes);
  if (!layout.left.empty() && !layout.right.empty()) {
    const auto by_key = [](const auto& a, const auto& b) { return a.key < b.key; };
    std::stable_sort(layout.left.begin(), layout.left.end(), by_key);
    std::stable_sort(layout.right.begin(), layout.right.end(), by_key);
    layout.keys_are_stamps = true;
    return layout;
  }
  layout.left = images_in(left);
  layout.right = images_in(right);
  for (const auto& [images, path] : {std::pair(&layout.left, left), std::pair(&layout.right, right)}) {
    if (images->empty())
      throw InputError(path, "has no images (PNG, JPEG, PGM, TIFF, BMP)", "check that the recording is complete");
  }
  set_keys(layout, folder);
  return layout;
}

// Images or videos with left and right in their names, all in one folder; pairs have the same name otherwise.
void split_sides(const std::vector<fs::path>& files, std::vector<RecordedImage>& left,
                 std::vector<RecordedImage>& right) {
  for (const fs::path& file : files) {
    const std::string name = lower(file.stem().string());
    const bool is_left = name.find("left") != std::string::npos, is_right = name.find("right") != std::string::npos;
    if (is_left != is_right) (is_left ? left : right).push_back({file, 0});
  }
}

std::optional<Layout> find_layout(const fs::path& folder, const SessionOptions& options,
                                  std::vector<std::string>& notes) {
  for (const fs::path& base : {folder / "mav0", folder}) {
    const fs::path left = image_folder(base, "cam0"), right = image_folder(base, "cam1");
    if (!left.empty() && !right.empty() && left.filename() == "data" && right.filename() == "data") {
      return folder_layout("EuRoC/ASL", folder, left, right, notes);
    }
  }
  const fs::path grey_left = image_folder(folder, "image_0"), grey_right = image_folder(folder, "image_1");
  const fs::path colour_left = image_folder(folder, "image_2"), colour_right = image_folder(folder, "image_3");
  const bool grey = !grey_left.empty() && !grey_right.empty(), colour = !colour_left.empty() && !colour_right.empty();
  if (grey || colour) {
    if ((options.pair == "grey" && !grey) || (options.pair == "colour" && !colour)) {
      throw InputError(folder, fmt::format("has no {} pair of image folders", options.pair),
                       "leave session.pair at auto");
    }
    const bool use_colour = colour && options.pair != "grey";
    if (grey && colour && options.pair == "auto") {
      notes.push_back("the recording has a grey and a colour pair; the colour pair is used (session.pair)");
    }
    Layout layout = folder_layout("KITTI odometry", folder, use_colour ? colour_left : grey_left,
                                  use_colour ? colour_right : grey_right, notes);
    layout.kitti_pair = use_colour ? calibrate::KittiPair::colour : calibrate::KittiPair::grey;
    return layout;
  }
  static const std::pair<const char*, const char*> kPairs[] = {{"left", "right"},
                                                               {"cam0", "cam1"},
                                                               {"image_left", "image_right"},
                                                               {"image_l", "image_r"},
                                                               {"image_00", "image_01"},
                                                               {"image_02", "image_03"},
                                                               {"img_left", "img_right"},
                                                               {"left_images", "right_images"},
                                                               {"infra1", "infra2"},
                                                               {"l", "r"}};
  for (const auto& [left_name, right_name] : kPairs) {
    const fs::path left = image_folder(folder, left_name), right = image_folder(folder, right_name);
    if (left.empty() && right.empty()) continue;
    if (left.empty() || right.empty()) {
      throw InputError(folder,
                       fmt::format("has a folder {} but no folder {}", left.empty() ? right_name : left_name,
                                   left.empty() ? left_name : right_name),
                       "both cameras need their folder of images");
    }
    Layout layout = folder_layout("image folders", folder, left, right, notes);
    layout.kitti_pair_by_colour = true;
    return layout;
  }
  Layout layout;
  layout.kind = "image files";
  layout.left_folder = folder;
  split_sides(files_in(folder, is_image_file), layout.left, layout.right);
  if (layout.left.empty() || layout.right.empty()) return std::nullopt;
  set_keys(layout, folder);
  layout.kitti_pair_by_colour = true;
  return layout;
}

// --- pairing and times ---------------------------------------------------------------------------------------------

std::vector<int64_t> keys_of(const std::vector<RecordedImage>& images) {
  std::vector<int64_t> keys;
  for (const RecordedImage& image : images) keys.push_back(image.key);
  return keys;
}

void note_unpaired(const char* side, const std::vector<int>& unpaired, const std::vector<RecordedImage>& images,
                   std::vector<std::string>& notes) {
  if (unpaired.empty()) return;
  std::vector<std::string> examples;
  for (size_t i = 0; i < unpaired.size() && i < 3; ++i) {
    examples.push_back(images[static_cast<size_t>(unpaired[i])].file.filename().string());
  }
  notes.push_back(fmt::format("{} of {} {} images have no partner and are not used: {}{}", unpaired.size(),
                              images.size(), side, fmt::join(examples, ", "),
                              unpaired.size() > examples.size() ? ", …" : ""));
}

// Times of numbered images: from times.txt or timestamps.txt, otherwise at a rate that is given or (then they are no
// stamps) assumed.
std::vector<int64_t> stamps_of_numbers(const Layout& layout, const std::vector<int>& left_indices,
                                       const fs::path& folder, const SessionOptions& options,
                                       std::vector<std::string>& notes, bool& has_stamps) {
  std::vector<int64_t> stamps;
  const fs::path candidates[] = {folder / "times.txt", folder / "timestamps.txt", layout.left_folder / "times.txt",
                                 layout.left_folder / "timestamps.txt",
                                 layout.left_folder.parent_path() / "timestamps.txt"};
  const auto file =
      std::find_if(std::begin(candidates), std::end(candidates), [](const fs::path& p) { return fs::exists(p); });
  if (file != std::end(candidates) && options.rate <= 0) {
    const std::vector<std::pair<int64_t, int64_t>> times = read_times(*file);
    // As many times as images: in the same order. Otherwise the frame number tells the line.
    const bool by_order = times.size() == layout.left.size();
    const std::map<int64_t, int64_t> by_number(times.begin(), times.end());
    for (const int index : left_indices) {
      const int64_t number = layout.left[static_cast<size_t>(index)].key;
      if (!by_order && !by_number.contains(number)) {
        throw InputError(
            *file,
            fmt::format("has {} times for {} left images and none for frame {}", times.size(), layout.left.size(),
                        number),
            "give one time for each frame number (counted from 0), or take the file away or set session.rate");
      }
      stamps.push_back(by_order ? times[static_cast<size_t>(index)].second : by_number.at(number));
    }
    return stamps;
  }
  const double rate = options.rate > 0 ? options.rate : kNominalRate;
  if (options.rate <= 0) {
    has_stamps = false;
    notes.push_back(
        fmt::format("the recording has no time stamps; {} frames a second are assumed (session.rate)", rate));
  }
  const int64_t first = layout.left[static_cast<size_t>(left_indices.front())].key;
  for (const int index : left_indices) {
    stamps.push_back(
        std::llround(static_cast<double>(layout.left[static_cast<size_t>(index)].key - first) * 1e9 / rate));
  }
  return stamps;
}

void note_gaps(const std::vector<RecordedFrame>& frames, std::vector<std::string>& notes) {
  std::vector<int64_t> stamps;
  for (const RecordedFrame& frame : frames) stamps.push_back(frame.stamp_ns);
  const int64_t period = median_period(stamps);
  constexpr double kGap = 1.6;  // frame periods: less is jitter
  int gaps = 0;
  size_t longest = 0;
  for (size_t i = 1; i < stamps.size(); ++i) {
    if (static_cast<double>(stamps[i] - stamps[i - 1]) <= kGap * static_cast<double>(period)) continue;
    ++gaps;
    if (longest == 0 || stamps[i] - stamps[i - 1] > stamps[longest] - stamps[longest - 1]) longest = i;
  }
  if (gaps > 0) {
    notes.push_back(fmt::format(
        "{} gaps between frames (the usual distance is {:.3f} s), the longest of {:.3f} s before {}", gaps,
        static_cast<double>(period) * 1e-9, static_cast<double>(stamps[longest] - stamps[longest - 1]) * 1e-9,
        frames[longest].left.filename().string()));
  }
}

std::vector<RecordedFrame> pair_up(const Layout& layout, const fs::path& folder, const SessionOptions& options,
                                   std::vector<std::string>& notes, bool& has_stamps) {
  const std::vector<int64_t> left = keys_of(layout.left), right = keys_of(layout.right);
  Pairing pairing;
  if (layout.keys_are_stamps) {
    const int64_t left_period = median_period(left), right_period = median_period(right);
    const int64_t period =
        left_period > 0 && right_period > 0 ? std::min(left_period, right_period) : std::max(left_period, right_period);
    pairing = pair_by_stamp(
        left, right, options.max_stamp_difference > 0 ? std::llround(options.max_stamp_difference * 1e9) : period / 2);
  } else {
    pairing = pair_by_number(left, right);
  }
  if (pairing.pairs.empty()) {
    throw InputError(
        folder,
        fmt::format("none of the {} left images belongs to one of the {} right images by its {}", layout.left.size(),
                    layout.right.size(), layout.keys_are_stamps ? "time stamp" : "number"),
        fmt::format("names are like {} and {}; equal numbers or near stamps belong together",
                    layout.left.front().file.filename().string(), layout.right.front().file.filename().string()));
  }
  note_unpaired("left", pairing.unpaired_left, layout.left, notes);
  note_unpaired("right", pairing.unpaired_right, layout.right, notes);
  std::vector<int> left_indices;
  for (const auto& [l, r] : pairing.pairs) left_indices.push_back(l);
  std::vector<int64_t> stamps;
  if (layout.keys_are_stamps) {
    std::vector<int64_t> differences;
    for (const auto& [l, r] : pairing.pairs) {
      stamps.push_back(left[static_cast<size_t>(l)]);
      differences.push_back(std::abs(left[static_cast<size_t>(l)] - right[static_cast<size_t>(r)]));
    }
    const int64_t largest = *std::max_element(differences.begin(), differences.end());
    constexpr int64_t kNoticeable = 1'000'000;  // ns: at 1 m/s 1 mm
    if (largest > kNoticeable) {
      notes.push_back(fmt::format("left and right images are taken up to {:.1f} ms apart: not synchronised",
                                  static_cast<double>(largest) * 1e-6));
    }
  } else {
    stamps = stamps_of_numbers(layout, left_indices, folder, options, notes, has_stamps);
  }
  std::vector<RecordedFrame> frames;
  for (size_t i = 0; i < pairing.pairs.size(); ++i) {
    frames.push_back({layout.left[static_cast<size_t>(pairing.pairs[i].first)].file,
                      layout.right[static_cast<size_t>(pairing.pairs[i].second)].file, stamps[i]});
  }
  note_gaps(frames, notes);
  return frames;
}

// --- calibration ---------------------------------------------------------------------------------------------------

StereoCalibration load_calibration(const fs::path& folder, const fs::path& video, const SessionOptions& options,
                                   calibrate::KittiPair pair) {
  if (!options.calibration.empty()) {
    const fs::path named = options.calibration;
    return calibrate::read_calibration(!fs::exists(named) && fs::exists(folder / named) ? folder / named : named, pair);
  }
  for (const fs::path& base : {folder / "mav0", folder}) {
    if (fs::exists(base / "cam0/sensor.yaml") && fs::exists(base / "cam1/sensor.yaml")) {
      return calibrate::read_calibration(base / "cam0/sensor.yaml", pair);
    }
  }
  std::vector<std::string> broken;
  std::vector<fs::path> found = calibrate::find_calibrations(folder, &broken);
  // Several videos of one folder may each have their own.
  const auto own = std::find_if(found.begin(), found.end(),
                                [&](const fs::path& p) { return !video.empty() && p.stem() == video.stem(); });
  if (own != found.end()) found = {*own};
  if (found.empty()) {
    throw InputError(folder,
                     fmt::format("has no calibration among its *.yaml, *.yml, *.xml and *.txt files{}{}",
                                 broken.empty() ? "" : "; not readable: ", fmt::join(broken, "; ")),
                     "put one there or name it with --session.calibration; " + calibrate::understood_calibrations());
  }
  if (found.size() > 1) {
    std::vector<std::string> names;
    for (const fs::path& path : found) names.push_back(path.filename().string());
    throw InputError(
        folder, fmt::format("has {} calibrations: {}", names.size(), fmt::join(names, ", ")),
        "name the right one with --session.calibration, or rename it to calibration" + found[0].extension().string());
  }
  return calibrate::read_calibration(found[0], pair);
}

// --- the session ---------------------------------------------------------------------------------------------------

class ImageSession : public Session {
 public:
  ImageSession(const fs::path& folder, const Layout& layout, std::vector<std::string> notes,
               const SessionOptions& options)
      : kind_(layout.kind) {
    folder_ = folder;
    notes_ = std::move(notes);
    const std::vector<RecordedFrame> all = pair_up(layout, folder, options, notes_, has_stamps_);
    const fs::path& first = all.front().left;
    identity_ = kind_ + " " + file_text(first);
    for (const int index : selected_frames(static_cast<int>(all.size()), options, folder)) {
      frames_.push_back(all[static_cast<size_t>(index)]);
    }
    const auto [begin, left, right] = first_readable();
    if (options.needs_calibration) {
      const bool by_colour = layout.kitti_pair_by_colour && left.channels() == 3;
      calibration_ =
          load_calibration(folder, {}, options, by_colour ? calibrate::KittiPair::rather_colour : layout.kitti_pair);
      note_unit(calibration_, notes_);
    }
    fit_to_images(calibration_, left.size(), right.size(), frames_[begin].right);
    if (options.needs_calibration) note_principal_point(calibration_, notes_);
    if (left.depth() == CV_16U || right.depth() == CV_16U) find_used_bits();
  }

  std::string kind() const override { return kind_; }
  int size() const override { return static_cast<int>(frames_.size()); }
  int64_t stamp_ns(int frame_idx) const override { return frames_.at(static_cast<size_t>(frame_idx)).stamp_ns; }
  bool random_access() const override { return true; }
  std::string frame_name(int frame_idx) const override {
    return frames_.at(static_cast<size_t>(frame_idx)).left.filename().string();
  }

  StereoFrame read(int frame_idx) const override {
    const RecordedFrame& recorded = frames_.at(static_cast<size_t>(frame_idx));
    StereoFrame frame;
    frame.frame_idx = frame_idx;
    frame.stamp_ns = recorded.stamp_ns;
    frame.left = to_8_bit(read_image(recorded.left), bits_);
    frame.right = to_8_bit(read_image(recorded.right), bits_);
    check_size(frame.left, calibration_.left, recorded.left);
    check_size(frame.right, calibration_.right, recorded.right);
    return frame;
  }

  std::string fingerprint_text() const override {
    std::string text;
    for (const RecordedFrame& frame : frames_) {
      text += fmt::format("{} {} {}\n", file_text(frame.left), file_text(frame.right), frame.stamp_ns);
    }
    return fingerprint_of(kind_, text, calibration_);
  }

 private:
  struct FirstFrame {
    size_t index = 0;
    cv::Mat left, right;
  };

  // The first frame whose images can be read: a damaged one costs itself, not the recording.
  FirstFrame first_readable() {
    std::string problem;
    for (size_t i = 0; i < frames_.size(); ++i) {
      try {
        FirstFrame frame{.index = i, .left = read_image(frames_[i].left), .right = read_image(frames_[i].right)};
        if (i > 0) {
          notes_.push_back(fmt::format("{}; frame {} is the first that can be read", problem, i));
        }
        return frame;
      } catch (const InputError& error) {
        if (problem.empty()) problem = error.what();
      }
    }
    throw InputError(folder_, fmt::format("none of its {} frames can be read: {}", frames_.size(), problem),
                     "record again, or copy it again from where it is whole");
  }

  // 12-bit cameras store 16-bit files: the brightest values of a sample of the recording tell.
  void find_used_bits() {
    constexpr size_t kSamples = 8;
    double largest = 0;
    for (size_t i = 0; i < std::min(kSamples, frames_.size()); ++i) {
      const RecordedFrame& frame =
          frames_[i * (frames_.size() - 1) / std::max<size_t>(1, std::min(kSamples, frames_.size()) - 1)];
      for (const fs::path& file : {frame.left, frame.right}) {
        try {
          const cv::Mat image = read_image(file);
          double most = 0;
          cv::minMaxLoc(image.reshape(1), nullptr, &most);
          if (image.depth() == CV_16U) largest = std::max(largest, most);
        } catch (const InputError&) {
          continue;  // damaged: reported when its turn comes
        }
      }
    }
    bits_ = used_bits(largest);
    notes_.push_back(
        fmt::format("16-bit images of which {} bits are used: divided by {} for 8 bits", bits_, 1 << (bits_ - 8)));
  }

  std::string kind_;
  std::vector<RecordedFrame> frames_;
  int bits_ = 16;
};

std::unique_ptr<Session> open_video_folder(const fs::path& folder, const SessionOptions& options) {
  const std::vector<fs::path> videos = files_in(folder, is_video_file);
  if (videos.empty()) return nullptr;
  fs::path left, right;
  const auto stem_is = [&](const std::string& stem) {
    const auto found =
        std::find_if(videos.begin(), videos.end(), [&](const fs::path& v) { return lower(v.stem().string()) == stem; });
    return found == videos.end() ? fs::path() : *found;
  };
  std::vector<RecordedImage> lefts, rights;
  split_sides(videos, lefts, rights);
  if (lefts.size() == 1 && rights.size() == 1) {
    left = lefts[0].file;
    right = rights[0].file;
  } else if (!stem_is("cam0").empty() && !stem_is("cam1").empty()) {
    left = stem_is("cam0");
    right = stem_is("cam1");
  } else if (videos.size() == 1) {
    left = videos[0];
  } else {
    std::vector<std::string> names;
    for (const fs::path& video : videos) names.push_back(video.filename().string());
    throw InputError(folder, fmt::format("has {} videos: {}", names.size(), fmt::join(names, ", ")),
                     "name the one to use, or call two of them left and right");
  }
  StereoCalibration calibration;
  if (options.needs_calibration) calibration = load_calibration(folder, left, options, calibrate::KittiPair::any);
  return open_videos(folder, left, right, calibration, options);
}

}  // namespace

void SessionOptions::declare(OptionSet& set) {
  set.section("session");
  set.add(
      "calibration", calibration, {},
      "calibration file or folder (OpenCV, Kalibr, ROS, KITTI, EuRoC); empty: the one that lies with the recording");
  set.add("pair", pair, {"auto", "grey", "colour"},
          "which cameras of a KITTI recording that has both pairs; auto takes colour, which models and tours show");
  set.add("max_stamp_difference", max_stamp_difference, "s", 0, 10,
          "left and right image of one frame may be taken so far apart; 0: half a frame period");
  set.add("rate", rate, "Hz", 0, 10000,
          "frames a second of a recording without time stamps; 0: what a video says, 10 for images");
  set.add("first", first, "frames", 0, 1'000'000'000, "frames left out at the beginning");
  set.add("stride", stride, "frames", 1, 1'000'000, "every n-th frame is used; motion needs overlapping views");
  set.add("max_frames", max_frames, "frames", 0, 1'000'000'000, "at most so many frames; 0: all");
}

std::vector<int> selected_frames(int count, const SessionOptions& options, const fs::path& folder) {
  std::vector<int> selected;
  for (int64_t i = options.first; i < count; i += options.stride) {
    if (options.max_frames > 0 && static_cast<int>(selected.size()) == options.max_frames) break;
    selected.push_back(static_cast<int>(i));
  }
  if (selected.empty()) {
    throw InputError(folder,
                     fmt::format("has {} frames, of which session.first = {} leaves none", count, options.first),
                     count == 0 ? "record again" : "choose a smaller session.first");
  }
  return selected;
}

void fit_to_images(StereoCalibration& calibration, const cv::Size& left, const cv::Size& right,
                   const fs::path& first_image) {
  if (left != right) {
    throw InputError(first_image,
                     fmt::format("the left image is {}x{} px, the right one {}x{}", left.width, left.height,
                                 right.width, right.height),
                     "both cameras must record at the same resolution");
  }
  for (CameraModel* camera : {&calibration.left, &calibration.right}) {
    if (camera->width == 0 && camera->height == 0) {
      camera->width = left.width;
      camera->height = left.height;
    }
    if (cv::Size(camera->width, camera->height) != left) {
      throw InputError(
          calibration.source,
          fmt::format("is for images of {}x{} px, but those of {} are {}x{}", camera->width, camera->height,
                      first_image.string(), left.width, left.height),
          "calibrate at the resolution of the recording, or name the right file with --session.calibration");
    }
  }
}

void check_size(const cv::Mat& image, const CameraModel& camera, const fs::path& file) {
  if (image.cols != camera.width || image.rows != camera.height) {
    throw InputError(file,
                     fmt::format("the image is {}x{} px, those before it {}x{}", image.cols, image.rows, camera.width,
                                 camera.height),
                     "all images of a recording must have the same size");
  }
}

void note_unit(const StereoCalibration& calibration, std::vector<std::string>& notes) {
  constexpr double kUnusual = 3;  // m
  const double baseline = calibration.right_centre_in_left().norm();
  if (baseline > kUnusual) {
    notes.push_back(
        fmt::format("the calibration says that the cameras are {:.4g} m apart: if that is in millimetres or in "
                    "squares of the target, every length of the result is, too",
                    baseline));
  }
}

void note_principal_point(const StereoCalibration& calibration, std::vector<std::string>& notes) {
  constexpr double kUsual = 0.25;  // [parts of the image] from the middle
  for (const CameraModel* camera : {&calibration.left, &calibration.right}) {
    const double x = camera->K(0, 2) / camera->width - 0.5, y = camera->K(1, 2) / camera->height - 0.5;
    if (std::max(std::abs(x), std::abs(y)) <= kUsual) continue;
    notes.push_back(
        fmt::format("{}: the principal point ({:.0f}, {:.0f}) lies far from the middle of images of {}x{} px; "
                    "see that the calibration is that of this recording",
                    calibration.source, camera->K(0, 2), camera->K(1, 2), camera->width, camera->height));
    return;
  }
}

std::string file_text(const fs::path& file) {
  constexpr uintmax_t kSample = 4096;  // [bytes]
  const uintmax_t size = fs::file_size(file);
  std::ifstream stream(file, std::ios::binary);
  std::string samples, bytes(kSample, '\0');
  for (const uintmax_t at : {uintmax_t{0}, size / 2, size > kSample ? size - kSample : uintmax_t{0}}) {
    stream.clear();
    stream.seekg(static_cast<std::streamoff>(at));
    stream.read(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    samples.append(bytes, 0, static_cast<size_t>(std::max<std::streamsize>(0, stream.gcount())));
  }
  return fmt::format("{} {} {}", file.filename().string(), size, fingerprint(samples));
}

std::string fingerprint_of(const std::string& kind, const std::string& frames, const StereoCalibration& calibration) {
  return kind + '\n' + frames + to_text(calibration);
}

std::unique_ptr<Session> open_session(const fs::path& folder_or_video, const SessionOptions& options) {
  if (!std::getenv("OPENCV_LOG_LEVEL")) cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  if (!fs::exists(folder_or_video)) throw InputError(folder_or_video, "there is no such recording", "check the name");
  if (!fs::is_directory(folder_or_video)) {
    if (!is_video_file(folder_or_video)) {
      throw InputError(folder_or_video, "is neither a folder nor a video", kLayouts);
    }
    StereoCalibration calibration;
    const fs::path folder = fs::absolute(folder_or_video).parent_path();
    if (options.needs_calibration) {
      calibration = load_calibration(folder, folder_or_video, options, calibrate::KittiPair::any);
    }
    return open_videos(folder_or_video, folder_or_video, {}, calibration, options);
  }
  std::vector<std::string> notes;
  if (const auto layout = find_layout(folder_or_video, options, notes)) {
    return std::make_unique<ImageSession>(folder_or_video, *layout, std::move(notes), options);
  }
  if (auto videos = open_video_folder(folder_or_video, options)) return videos;
  throw InputError(folder_or_video,
                   fs::is_empty(folder_or_video) ? "is empty" : "holds no recording that is understood", kLayouts);
}

}  // namespace iris::session
