#include "export/video_file.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cctype>
#include <cstdlib>  // says whether it is of glibc
#include <fstream>
#include <opencv2/videoio.hpp>
#include <string>
#include <vector>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"

#ifdef __GLIBC__
#include <malloc.h>
#endif

namespace iris::exporters {
namespace fs = std::filesystem;
namespace {

uint64_t big_endian(const char* bytes, int count) {
  uint64_t value = 0;
  for (int i = 0; i < count; ++i) value = value << 8 | static_cast<unsigned char>(bytes[i]);
  return value;
}

void set_big_endian(char* bytes, int count, uint64_t value) {
  for (int i = count; i-- > 0; value >>= 8) bytes[i] = static_cast<char>(value & 255);
}

// A box of the ISO base media format: 32-bit size, type; size 1: a 64-bit size follows; 0: to the end of the file.
struct Box {
  uint64_t begin = 0, size = 0;
  std::string type;
};

// Adds `shift` to the chunk offsets of all tracks. False: a 32-bit offset would not hold it.
bool shift_offsets(char* bytes, size_t size, uint64_t shift) {
  for (size_t at = 0; at + 8 <= size;) {
    const uint64_t length = big_endian(bytes + at, 4);
    if (length < 8 || at + length > size) return false;
    const std::string type(bytes + at + 4, 4);
    if (type == "trak" || type == "mdia" || type == "minf" || type == "stbl") {
      if (!shift_offsets(bytes + at + 8, length - 8, shift)) return false;
    } else if (type == "stco" || type == "co64") {
      const int width = type == "stco" ? 4 : 8;
      const uint64_t count = length >= 16 ? big_endian(bytes + at + 12, 4) : 0;
      if (16 + count * static_cast<uint64_t>(width) > length) return false;
      for (uint64_t i = 0; i < count; ++i) {
        char* entry = bytes + at + 16 + i * static_cast<uint64_t>(width);
        const uint64_t moved = big_endian(entry, width) + shift;
        if (width == 4 && moved > 0xffffffffu) return false;
        set_big_endian(entry, width, moved);
      }
    }
    at += length;
  }
  return true;
}

std::string lower_extension(const fs::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return extension;
}

// While it lives, allocated memory is zero (with glibc). x264 looks at memory that it has not written, and what an
// earlier user of it left there decides between equally good codings: the same pictures would not give the same file.
class CleanMemory {
 public:
#ifdef M_PERTURB
  // New memory is filled with the complement of the value.
  CleanMemory() {
    if (users_++ == 0) mallopt(M_PERTURB, 255);
  }
  ~CleanMemory() {
    if (--users_ == 0) mallopt(M_PERTURB, 0);
  }
#else
  CleanMemory() = default;
#endif
  CleanMemory(const CleanMemory&) = delete;
  CleanMemory& operator=(const CleanMemory&) = delete;

 private:
  static inline std::atomic<int> users_ = 0;
};

}  // namespace

bool is_video_name(const fs::path& path) {
  const std::string extension = lower_extension(path);
  return extension == ".mp4" || extension == ".webm";
}

bool write_fast_start(const fs::path& from, const fs::path& to) {
  std::ifstream in(from, std::ios::binary);
  const uint64_t end = fs::file_size(from);
  std::vector<Box> boxes;
  for (uint64_t at = 0; at + 8 <= end;) {
    char head[16] = {};
    in.seekg(static_cast<std::streamoff>(at));
    in.read(head, static_cast<std::streamsize>(std::min<uint64_t>(16, end - at)));
    in.clear();
    uint64_t size = big_endian(head, 4);
    if (size == 1) size = big_endian(head + 8, 8);
    if (size == 0) size = end - at;
    if (size < 8 || at + size > end) return false;
    boxes.push_back({at, size, std::string(head + 4, 4)});
    at += size;
  }
  const auto find = [&](const char* type) {
    return std::find_if(boxes.begin(), boxes.end(), [&](const Box& box) { return box.type == type; });
  };
  const auto moov = find("moov"), mdat = find("mdat");
  if (moov == boxes.end() || mdat == boxes.end() || moov < mdat) return false;
  std::string index(moov->size, 0);
  in.seekg(static_cast<std::streamoff>(moov->begin));
  in.read(index.data(), static_cast<std::streamsize>(index.size()));
  if (!in || !shift_offsets(index.data() + 8, index.size() - 8, index.size())) return false;
  write_file_with(to, [&](const fs::path& target) {
    std::ofstream out(target, std::ios::binary);
    std::vector<char> buffer(size_t{1} << 20);
    for (const Box& box : boxes) {
      if (box.begin == mdat->begin) out.write(index.data(), static_cast<std::streamsize>(index.size()));
      if (box.begin == moov->begin) continue;
      in.seekg(static_cast<std::streamoff>(box.begin));
      for (uint64_t left = box.size; left > 0;) {
        const auto part = static_cast<std::streamsize>(std::min<uint64_t>(left, buffer.size()));
        in.read(buffer.data(), part);
        out.write(buffer.data(), part);
        left -= static_cast<uint64_t>(part);
      }
    }
    out.close();
    if (!in || !out) throw InputError(to, "could not be written completely", "check that the disk has space");
  });
  return true;
}

struct VideoWriter::State {
  CleanMemory clean_memory;  // first: it outlives the encoder
  fs::path path, temporary;
  int width = 0, height = 0;
  int frames = 0;
  cv::VideoWriter video;
};

VideoWriter::VideoWriter(const fs::path& path, int width, int height, double fps) : state_(std::make_unique<State>()) {
  IRIS_CHECK(width > 0 && height > 0 && fps > 0);
  if (width % 2 != 0 || height % 2 != 0) {
    throw UsageError("a video needs an even width and height, not " + std::to_string(width) + "x" +
                     std::to_string(height));
  }
  state_->path = path;
  state_->width = width;
  state_->height = height;
  if (path.has_parent_path()) {
    std::error_code error;
    fs::create_directories(path.parent_path(), error);
    if (error)
      throw InputError(path.parent_path(), "cannot be made (" + error.message() + ")", "choose another folder");
  }
  const std::string extension = lower_extension(path);
  if (!is_video_name(path)) throw UsageError(path.string() + ": the name of a video must end in .mp4 or .webm");
  const bool mp4 = extension == ".mp4";
  // The extension tells FFmpeg the container.
  state_->temporary =
      path.parent_path() / (".tmp." + std::to_string(getpid()) + ".video." + path.stem().string() + extension);
  if (!state_->video.open(
          state_->temporary.string(), cv::CAP_FFMPEG,
          mp4 ? cv::VideoWriter::fourcc('a', 'v', 'c', '1') : cv::VideoWriter::fourcc('V', 'P', '9', '0'), fps,
          cv::Size(width, height))) {
    std::error_code ignored;
    fs::remove(state_->temporary, ignored);
    throw InputError(path, mp4 ? "cannot be written as H.264 video" : "cannot be written as VP9 video",
                     fmt::format("check the folder and its permissions, and that OpenCV has FFmpeg with {}",
                                 mp4 ? "libx264" : "libvpx"));
  }
}

VideoWriter::~VideoWriter() {
  if (!state_) return;
  state_->video.release();
  std::error_code ignored;
  fs::remove(state_->temporary, ignored);
}

void VideoWriter::add(const cv::Mat3b& frame) {
  IRIS_CHECK(state_ && frame.cols == state_->width && frame.rows == state_->height);
  state_->video.write(frame);
  ++state_->frames;
}

void VideoWriter::close() {
  IRIS_CHECK(state_ && state_->frames > 0);
  state_->video.release();
  // OpenCV reports no failed write: the finished file is opened again and must hold every frame.
  // (WebM stores no count, FFmpeg works it out from the length.)
  cv::VideoCapture check(state_->temporary.string(), cv::CAP_FFMPEG);
  if (!check.isOpened() || static_cast<int>(check.get(cv::CAP_PROP_FRAME_COUNT) + 0.5) != state_->frames) {
    throw InputError(state_->path, "could not be written completely", "check that the disk has space");
  }
  check.release();
  if (write_fast_start(state_->temporary, state_->path)) {
    fs::remove(state_->temporary);
  } else {
    write_file_with(state_->path, [&](const fs::path& target) { fs::rename(state_->temporary, target); });
  }
  state_.reset();
}

}  // namespace iris::exporters
