#include "iris/session/image_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cstdint>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <string_view>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"

namespace iris::session {
namespace {

uint32_t big_endian(std::string_view bytes, size_t at, int count) {
  uint32_t value = 0;
  for (int i = 0; i < count; ++i) value = value << 8 | static_cast<unsigned char>(bytes[at + static_cast<size_t>(i)]);
  return value;
}

uint32_t little_endian(std::string_view bytes, size_t at) {
  uint32_t value = 0;
  for (int i = 3; i >= 0; --i) value = value << 8 | static_cast<unsigned char>(bytes[at + static_cast<size_t>(i)]);
  return value;
}

// Walks the chunks up to IEND.
bool complete_png(std::string_view bytes) {
  constexpr size_t kSignature = 8, kFrame = 12;  // a chunk is its length, name, data and checksum
  for (size_t at = kSignature; at + kFrame <= bytes.size();) {
    const size_t length = big_endian(bytes, at, 4);
    if (at + kFrame + length > bytes.size()) return false;
    if (bytes.substr(at + 4, 4) == "IEND") return true;
    at += kFrame + length;
  }
  return false;
}

// Skips the segments before the first scan (a thumbnail in them has an end marker of its own), then looks for the end
// marker, which cannot occur within the coded image. Bytes behind it are allowed.
bool complete_jpeg(std::string_view bytes) {
  size_t at = 2;
  while (at + 4 <= bytes.size() && bytes[at] == '\xff') {
    const auto marker = static_cast<unsigned char>(bytes[at + 1]);
    if (marker == 0xff) {  // padding
      ++at;
      continue;
    }
    at += 2 + big_endian(bytes, at + 2, 2);
    constexpr unsigned char kStartOfScan = 0xda;
    if (marker == kStartOfScan) return at < bytes.size() && bytes.find("\xff\xd9", at) != std::string_view::npos;
  }
  return false;
}

// Binary PGM and PPM: header of three numbers, then width * height * channels values.
bool complete_pnm(std::string_view bytes) {
  const size_t channels = bytes[1] == '6' ? 3 : 1;
  size_t at = 2, numbers[3] = {0, 0, 0};
  for (size_t& number : numbers) {
    while (at < bytes.size() && (std::isspace(static_cast<unsigned char>(bytes[at])) || bytes[at] == '#')) {
      if (bytes[at] == '#') at = std::min(bytes.find('\n', at), bytes.size());
      if (at < bytes.size()) ++at;
    }
    while (at < bytes.size() && std::isdigit(static_cast<unsigned char>(bytes[at])) && number < 1'000'000) {
      number = 10 * number + static_cast<size_t>(bytes[at++] - '0');
    }
  }
  return at + 1 + numbers[0] * numbers[1] * channels * (numbers[2] > 255 ? 2 : 1) <= bytes.size();
}

bool complete_bmp(std::string_view bytes) {
  constexpr size_t kHeader = 54, kFileSize = 2;
  return bytes.size() >= kHeader && little_endian(bytes, kFileSize) <= bytes.size();
}

// True unless the file is of a kind whose end can be told and is not there. (TIFF keeps its directory by position: a
// cut file fails in the decoder.)
bool complete(std::string_view bytes) {
  if (bytes.starts_with("\x89PNG\r\n\x1a\n")) return complete_png(bytes);
  if (bytes.starts_with("\xff\xd8")) return complete_jpeg(bytes);
  if (bytes.starts_with("P5") || bytes.starts_with("P6")) return complete_pnm(bytes);
  if (bytes.starts_with("BM")) return complete_bmp(bytes);
  return true;
}

}  // namespace

bool is_image_file(const std::filesystem::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  static constexpr std::string_view kExtensions[] = {".png", ".jpg", ".jpeg", ".pgm", ".ppm",
                                                     ".pnm", ".tif", ".tiff", ".bmp"};
  return !path.filename().string().starts_with('.') &&
         std::find(std::begin(kExtensions), std::end(kExtensions), extension) != std::end(kExtensions);
}

cv::Mat read_image(const std::filesystem::path& path) {
  const std::string bytes = read_file(path);
  const char* const kRemedy = "copy the file again from where it was recorded, or take it out of the recording";
  if (bytes.empty()) throw InputError(path, "the image file is empty", kRemedy);
  if (!complete(bytes)) {
    throw InputError(path, fmt::format("the image is cut off after {} bytes", bytes.size()), kRemedy);
  }
  cv::Mat image;
  try {
    const cv::Mat1b buffer(1, static_cast<int>(bytes.size()),
                           reinterpret_cast<uchar*>(const_cast<char*>(bytes.data())));  // only read
    image = cv::imdecode(buffer, cv::IMREAD_UNCHANGED);
  } catch (const cv::Exception&) {  // reported below
  }
  if (image.empty()) throw InputError(path, "the image is damaged or of an unknown kind", kRemedy);
  if (image.depth() != CV_8U && image.depth() != CV_16U) {
    throw InputError(path, "the image has neither 8 nor 16 bits a value",
                     "convert the recording to 8-bit or 16-bit images");
  }
  if (image.channels() == 4) cv::cvtColor(image, image, cv::COLOR_BGRA2BGR);
  if (image.channels() == 2) cv::extractChannel(image, image, 0);
  return image;
}

int used_bits(double largest_value) {
  int bits = 8;
  while (bits < 16 && largest_value >= (1 << bits)) bits += 2;
  return bits;
}

cv::Mat to_8_bit(const cv::Mat& image, int bits) {
  if (image.depth() == CV_8U) return image;
  cv::Mat result;
  image.convertTo(result, CV_8U, 1.0 / (1 << (bits - 8)));
  return result;
}

}  // namespace iris::session
