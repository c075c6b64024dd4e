// The files of a stored stereo view: FFFFFF.left.png, FFFFFF.disparity.png (16 bit), FFFFFF.origin.png.
#pragma once

#include <filesystem>
#include <vector>

#include "iris/types/stereo_view.h"

namespace iris::workspace {

// Disparities are stored as 16-bit integers in units of 1 / disparity_scale px: 256 as in KITTI's disparity images, or
// 128 if `max_disparity` [px] would not fit. 0 = none.
int disparity_scale(double max_disparity);

// Writes the three files of a view, each whole or not at all. Throws InputError.
void write_view(const std::filesystem::path& folder, const StereoView& view, int disparity_scale);

// Fills image and disparity of `view` (whose frame_idx names the files). Throws InputError naming the damaged file.
void read_view(const std::filesystem::path& folder, int disparity_scale, StereoView& view);

// Bytes of PNG files that open fast: low compression.
std::vector<unsigned char> encode_png(const cv::Mat& image);

}  // namespace iris::workspace
