#include "iris/pipeline/calibration_images.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <map>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/core/progress.h"
#include "iris/session/image_file.h"
#include "iris/session/pairing.h"

namespace iris::pipeline {
namespace {

namespace fs = std::filesystem;
using calibrate::Detection;
using calibrate::Target;
using calibrate::TargetView;

cv::Mat1b grey_of(const cv::Mat& image) {
  cv::Mat eight = session::to_8_bit(image, 16), grey = eight;
  if (eight.channels() == 3) cv::cvtColor(eight, grey, cv::COLOR_BGR2GRAY);
  return grey;
}

// Image files named one by one: those of the left camera and those of the right one, paired by the numbers in their
// names.
std::vector<std::pair<fs::path, fs::path>> pair_files(const std::vector<fs::path>& files) {
  std::vector<std::pair<int64_t, fs::path>> left, right;
  for (const fs::path& file : files) {
    std::string name = file.filename().string(), folder = file.parent_path().filename().string();
    for (std::string* text : {&name, &folder}) {
      std::transform(text->begin(), text->end(), text->begin(), [](unsigned char c) { return std::tolower(c); });
    }
    const auto side_of = [](const std::string& text) {
      const bool l = text.find("left") != std::string::npos || text.find("cam0") != std::string::npos;
      const bool r = text.find("right") != std::string::npos || text.find("cam1") != std::string::npos;
      return l == r ? 0 : l ? -1 : 1;
    };
    const int side = side_of(name) != 0 ? side_of(name) : side_of(folder);
    const auto stamp = session::stamp_in_name(file.stem().string());
    const auto number = stamp ? stamp : session::number_in_name(file.stem().string());
    if (side == 0 || !number) {
      throw InputError(file,
                       side == 0 ? "neither its name nor its folder's says left or right" : "has no number in its name",
                       "name the images left01.png, right01.png …, or give the folder that holds them");
    }
    (side < 0 ? left : right).emplace_back(*number, file);
  }
  std::vector<std::pair<fs::path, fs::path>> pairs;
  std::sort(left.begin(), left.end());
  std::sort(right.begin(), right.end());
  const std::map<int64_t, fs::path> by_number(right.begin(), right.end());
  for (const auto& [number, file] : left) {
    const auto partner = by_number.find(number);
    if (partner == by_number.end()) {
      throw InputError(file, "has no right image of the same number", "give the images of both cameras");
    }
    pairs.emplace_back(file, partner->second);
  }
  if (left.size() != right.size() || by_number.size() != right.size()) {
    throw InputError(files.front(),
                     fmt::format("and the others are {} left and {} right images", left.size(), right.size()),
                     "each number must appear once for each camera");
  }
  return pairs;
}

// One pair of images, or why there is none.
struct ImagePair {
  std::string name;
  cv::Mat1b left, right;
  std::string problem;
};

// True if the file that an error names is a whole image: then the error is another one than damage (its size).
bool is_whole_image(const fs::path& file) {
  if (!session::is_image_file(file)) return false;  // a video
  try {
    session::read_image(file);
    return true;
  } catch (const InputError&) {
    return false;
  }
}

class Reader {
 public:
  Reader(const Target& target, const RunControl& control) : target_(target), control_(control) {}

  void check_size(const fs::path& file, const cv::Size& size) {
    if (images_.width == 0) {
      images_.width = size.width;
      images_.height = size.height;
      first_ = file;
    }
    if (size.width == images_.width && size.height == images_.height) return;
    throw InputError(file,
                     fmt::format("the image is {}x{} px, those of {} are {}x{}", size.width, size.height,
                                 first_.string(), images_.width, images_.height),
                     "a calibration holds for one resolution: give images of one size");
  }

  // `several`: the names of views tell their recordings apart.
  void read_session(const fs::path& path, session::SessionOptions options, bool several) {
    options.needs_calibration = false;
    if (options.rate <= 0) options.rate = 10;  // times do not matter here
    const auto session = session::open_session(path, options);
    for (const std::string& note : session->notes()) {
      // Numbers that are left out between images mean nothing here; damaged images are told when they are skipped.
      const bool told = note.find("gaps between frames") != std::string::npos ||
                        note.find("is the first that can be read") != std::string::npos;
      if (!told) images_.notes.push_back(note);
    }
    const CameraModel& camera = session->calibration().left;
    check_size(session->folder(), {camera.width, camera.height});
    const fs::path folder = path.filename().empty() ? path.parent_path() : path;
    const std::string prefix = several ? folder.filename().string() + "/" : "";
    search(session->size(), session->random_access() ? 32 : 1, [&](int i) {
      ImagePair pair{.name = prefix + session->frame_name(i)};
      try {
        const StereoFrame frame = session->read(i);
        pair.left = grey_of(frame.left);
        pair.right = grey_of(frame.right);
      } catch (const InputError& error) {
        if (is_whole_image(error.path())) throw;
        pair.problem = error.what();
      }
      return pair;
    });
  }

  void read_files(const std::vector<fs::path>& files) {
    std::vector<std::pair<fs::path, fs::path>> pairs;
    for (const auto& [left, right] : pair_files(files)) {
      cv::Size left_size, right_size;
      try {
        left_size = session::read_image(left).size();
        right_size = session::read_image(right).size();
      } catch (const InputError& error) {
        skip(error.what());
        continue;
      }
      check_size(left, left_size);
      check_size(right, right_size);
      pairs.emplace_back(left, right);
    }
    if (pairs.empty()) {
      throw InputError(files.front(), "and the other images: no pair can be read",
                       "take the images again, or copy them again from where they are whole");
    }
    search(static_cast<int>(pairs.size()), 32, [&](int i) {
      const auto& [left, right] = pairs[static_cast<size_t>(i)];
      return ImagePair{.name = left.filename().string(),
                       .left = grey_of(session::read_image(left)),
                       .right = grey_of(session::read_image(right))};
    });
  }

  // Too few found: what may be wrong with the images is looked for in some of them.
  CalibrationImages finish() {
    constexpr int kEnough = 3;
    int left = 0, right = 0;
    for (const TargetView& view : images_.views) {
      left += !view.left.empty();
      right += !view.right.empty();
    }
    if (left < kEnough || right < kEnough) {
      for (const cv::Mat1b& image : missing_) {
        const std::string problem = calibrate::explain_missing(image, target_);
        if (!problem.empty()) ++problems_[problem];
      }
    }
    for (const auto& [problem, count] : problems_) {
      images_.hints.push_back(fmt::format("{} (in {} images)", problem, count));
    }
    if (images_.unreadable > 0) images_.hints.push_back(fmt::format("{} pairs cannot be read", images_.unreadable));
    return std::move(images_);
  }

 private:
  void skip(const std::string& problem) {
    images_.notes.push_back("a pair is skipped: " + problem);
    ++images_.unreadable;
  }

  template <class Read>
  void search(int count, int block, const Read& read) {
    Progress progress(control_.progress, "find target", count);
    for (int begin = 0; begin < count; begin += block) {
      if (control_.stopped()) throw Interrupted();
      const int end = std::min(begin + block, count);
      std::vector<TargetView> views(static_cast<size_t>(end - begin));
      std::vector<std::string> unreadable(views.size());
      std::vector<std::vector<std::string>> problems(views.size());
      std::vector<std::vector<cv::Mat1b>> missing(views.size());
      parallel_chunks(begin, end, 1, [&](int from, int to) {
        for (int i = from; i < to; ++i) {
          const auto k = static_cast<size_t>(i - begin);
          const ImagePair pair = read(i);
          if (!pair.problem.empty()) {
            unreadable[k] = pair.problem;
            continue;
          }
          TargetView& view = views[k];
          view.name = pair.name;
          for (const bool is_left : {true, false}) {
            const cv::Mat1b& image = is_left ? pair.left : pair.right;
            Detection found = calibrate::find_target(image, target_);
            if (found.corners.empty()) {
              missing[k].push_back(image);
              if (!found.problem.empty()) problems[k].push_back("there is " + found.problem);
            }
            (is_left ? view.left : view.right) = std::move(found.corners);
            (is_left ? view.left_blur : view.right_blur) = found.blur;
          }
          calibrate::match_orientation(target_, view.left, view.right);
        }
      });
      for (size_t k = 0; k < views.size(); ++k) {
        if (!unreadable[k].empty()) {
          skip(unreadable[k]);
          continue;
        }
        images_.views.push_back(std::move(views[k]));
        for (const std::string& problem : problems[k]) ++problems_[problem];
        constexpr size_t kKept = 6;
        for (cv::Mat1b& image : missing[k]) {
          if (missing_.size() < kKept) missing_.push_back(std::move(image));
        }
      }
      progress.update(end);
    }
  }

  const Target& target_;
  const RunControl& control_;
  CalibrationImages images_;
  fs::path first_;
  std::map<std::string, int> problems_;
  std::vector<cv::Mat1b> missing_;
};

}  // namespace

CalibrationImages read_calibration_images(const std::vector<fs::path>& images, const session::SessionOptions& options,
                                          const Target& target, const RunControl& control) {
  calibrate::require_dictionary(target);
  Reader reader(target, control);
  std::vector<fs::path> files;
  for (const fs::path& path : images) {
    if (fs::is_regular_file(path) && session::is_image_file(path)) {
      files.push_back(path);
    } else {
      reader.read_session(path, options, images.size() > 1);
    }
  }
  if (!files.empty()) reader.read_files(files);
  return reader.finish();
}

}  // namespace iris::pipeline
