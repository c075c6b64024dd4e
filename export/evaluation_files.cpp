#include "export/evaluation_files.h"

#include <fmt/format.h>

#include <cmath>
#include <cstdio>
#include <cstring>
#include <opencv2/imgcodecs.hpp>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/session/image_file.h"

namespace iris::exporters {
namespace fs = std::filesystem;
namespace {

using evaluate::Trajectory;

// Portable float map with one channel; rows from the bottom up. The sign of its scale is the byte order, its value has
// no meaning for disparities.
cv::Mat1f read_pfm(const fs::path& path) {
  const std::string bytes = read_file(path);
  int width = 0, height = 0, header = 0;
  double scale = 0;
  if (std::sscanf(bytes.c_str(), "Pf %d %d %lf%n", &width, &height, &scale, &header) != 3 || width < 1 || height < 1 ||
      width > 100000 || height > 100000 || scale == 0) {
    throw InputError(path, "is no PFM file with one channel", "give a PFM file that begins with 'Pf'");
  }
  const size_t start = static_cast<size_t>(header) + 1, row_bytes = static_cast<size_t>(width) * sizeof(float);
  if (bytes.size() < start + row_bytes * static_cast<size_t>(height)) {
    throw InputError(path, "is cut off", "copy the file again");
  }
  cv::Mat1f image(height, width);
  for (int y = 0; y < height; ++y) {
    float* row = image[height - 1 - y];
    std::memcpy(row, bytes.data() + start + static_cast<size_t>(y) * row_bytes, row_bytes);
    if (scale > 0) {
      for (int x = 0; x < width; ++x) {
        uint32_t bits = 0;
        std::memcpy(&bits, row + x, sizeof bits);
        bits = __builtin_bswap32(bits);
        std::memcpy(row + x, &bits, sizeof bits);
      }
    }
  }
  return image;
}

// Disparities [px], 0 = unknown. `scale`: grey levels a pixel, 0 = 256 for 16-bit images. `remedy`: for 8-bit images
// that nothing is said of.
cv::Mat1f read_pixels(const fs::path& path, double scale, const std::string& remedy) {
  require_file(path);
  cv::Mat1f disparity;
  if (path.extension() == ".pfm" || path.extension() == ".PFM") {
    disparity = read_pfm(path);
  } else {
    const cv::Mat image = session::read_image(path);
    if (image.channels() != 1) {
      throw InputError(path, "is a colour image",
                       "give disparities as grey values: 16-bit PNG (x 256), 8-bit PGM or PFM");
    }
    if (scale == 0 && image.depth() == CV_8U) {
      throw InputError(path, "has 8 bits a pixel, and nothing says how many grey levels are a pixel of disparity",
                       remedy);
    }
    image.convertTo(disparity, CV_32F, 1 / (scale > 0 ? scale : 256));
  }
  for (float& d : disparity) {
    if (!std::isfinite(d) || d < 0) d = 0;
  }
  return disparity;
}

std::string range_text(const Trajectory& trajectory) {
  return fmt::format("{:.3f} … {:.3f} s", static_cast<double>(trajectory.front().stamp_ns) * 1e-9,
                     static_cast<double>(trajectory.back().stamp_ns) * 1e-9);
}

}  // namespace

void require_file(const fs::path& path) {
  if (!fs::exists(path)) throw InputError(path, "there is no such file", "check the name");
}

std::string size_text(cv::Size size) { return fmt::format("{} x {} px", size.width, size.height); }

void require_size(const fs::path& path, cv::Size size, cv::Size expected, const std::string& other) {
  if (size == expected) return;
  throw InputError(path, fmt::format("is {}, but {} is {}", size_text(size), other, size_text(expected)),
                   "give truth and result of the same images");
}

DisparityImage read_disparity(const fs::path& path) {
  DisparityImage image;
  image.disparity = read_pixels(path, 0, "give 256 grey levels a pixel in a 16-bit PNG, or a PFM file");
  const std::string name = path.filename().string(), ending = ".disparity.png";
  if (name.ends_with(ending)) {
    const std::string stem = name.substr(0, name.size() - ending.size());
    image.origin = read_mask(path.parent_path() / (stem + ".origin.png"), image.disparity.size(), path.string());
  }
  return image;
}

DisparityTruth read_disparity_truth(const fs::path& path, double scale) {
  DisparityTruth truth;
  truth.disparity = read_pixels(path, scale, "give --truth-scale (Middlebury: 16 for Tsukuba, 4 for Cones and Teddy)");
  const fs::path folder = path.parent_path();
  if (folder.filename() != "disparity") return truth;
  const auto mask = [&](const char* name) {
    return read_mask(folder.parent_path() / name / path.filename(), truth.disparity.size(), path.string());
  };
  truth.occluded = mask("occlusion");
  truth.discontinuity = mask("discontinuity");
  return truth;
}

cv::Mat1b read_mask(const fs::path& path, cv::Size expected, const std::string& other) {
  if (!fs::exists(path)) return {};
  cv::Mat image = session::read_image(path);
  require_size(path, image.size(), expected, other);
  if (image.channels() != 1 || image.depth() != CV_8U) {
    throw InputError(path, "is no mask", "give an 8-bit grey image with 255 where it is set");
  }
  return image;
}

std::pair<double, double> map_heights(const fs::path& path) {
  const evaluate::RosMapHeader header = evaluate::parse_ros_map(read_file(path), path);
  return {header.bottom, header.top};
}

evaluate::GridMap read_map(const fs::path& path, bool plan) {
  require_file(path);
  evaluate::RosMapHeader header = evaluate::parse_ros_map(read_file(path), path);
  const fs::path image_path = path.parent_path() / header.image;
  require_file(image_path);
  cv::Mat image = cv::imread(image_path.string(), cv::IMREAD_UNCHANGED);
  if (image.type() == CV_8UC4) {
    // Scale mode: what is transparent is unknown, what is not occupied is more or less free.
    const double occupied = header.occupied_thresh;
    cv::Mat1b trinary(image.size());
    for (int y = 0; y < image.rows; ++y) {
      for (int x = 0; x < image.cols; ++x) {
        const cv::Vec4b& pixel = image.at<cv::Vec4b>(y, x);
        const double shade = (pixel[0] + pixel[1] + pixel[2]) / (3 * 255.0);
        trinary(y, x) = pixel[3] < 255 ? 205 : (header.negate ? shade : 1 - shade) > occupied ? 0 : 254;
      }
    }
    header.negate = false, header.occupied_thresh = 0.65, header.free_thresh = 0.196;
    return evaluate::grid_map(trinary, header, plan);
  }
  image = session::read_image(image_path);
  if (image.channels() != 1 || image.depth() != CV_8U) {
    throw InputError(image_path, "is no 8-bit grey image", "give a map in ROS's trinary or scale mode");
  }
  return evaluate::grid_map(image, header, plan);
}

void require_common_time(const fs::path& estimate_path, const Trajectory& estimate, const fs::path& truth_path,
                         const Trajectory& truth) {
  const size_t pairs = evaluate::associate(estimate, truth).size();
  if (pairs >= 2) return;
  throw InputError(truth_path,
                   fmt::format("has the true pose of {} of the {} poses only: it covers {}, the poses of {} cover {}",
                               pairs, estimate.size(), range_text(truth), estimate_path.string(), range_text(estimate)),
                   "give the truth of the session that was reconstructed");
}

}  // namespace iris::exporters
