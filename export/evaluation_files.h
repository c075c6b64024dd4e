// Reads what is compared: trajectories, disparity images, masks, maps. All throw InputError with file and remedy.
#pragma once

#include <filesystem>
#include <string>
#include <utility>

#include "iris/evaluate/map.h"
#include "iris/evaluate/trajectory.h"
#include "iris/types/disparity_image.h"

namespace iris::exporters {

void require_file(const std::filesystem::path& path);

// "640 x 480 px".
std::string size_text(cv::Size size);

// `other`: what has the expected size, for the message.
void require_size(const std::filesystem::path& path, cv::Size size, cv::Size expected, const std::string& other);

// An estimate [px], 0 = unknown: PFM, or a 16-bit image of 256 grey levels a pixel. The origins are read from
// NAME.origin.png beside NAME.disparity.png if that is there.
DisparityImage read_disparity(const std::filesystem::path& path);

struct DisparityTruth {
  cv::Mat1f disparity;                // [px] 0 = unknown
  cv::Mat1b occluded, discontinuity;  // 255 = set; empty = not known
};
// PFM, or an image of `scale` grey levels a pixel (0 = 256 for 16-bit images, others need it). The masks are read from
// ../occlusion and ../discontinuity if the file lies in a folder disparity/.
DisparityTruth read_disparity_truth(const std::filesystem::path& path, double scale);

// 8-bit image of the expected size; empty if there is no such file.
cv::Mat1b read_mask(const std::filesystem::path& path, cv::Size expected, const std::string& other);

// Heights [m] of what a map of ROS shows, as its comment says; both 0 if it does not.
std::pair<double, double> map_heights(const std::filesystem::path& path);
// yaml and image of a ROS map; `plan`: as evaluate::grid_map has it.
evaluate::GridMap read_map(const std::filesystem::path& path, bool plan);

// At least two poses of the estimate have a true one.
void require_common_time(const std::filesystem::path& estimate_path, const evaluate::Trajectory& estimate,
                         const std::filesystem::path& truth_path, const evaluate::Trajectory& truth);

}  // namespace iris::exporters
