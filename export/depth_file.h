// Depth images as files.
#pragma once

#include <filesystem>
#include <opencv2/core.hpp>
#include <vector>

namespace iris::exporters {

// depth [m], 0 = unknown, as 16-bit PNG in millimetres: rounded, 0 = unknown, at least 1 and at most 65535 (65.5 m)
// where known.
std::vector<unsigned char> encode_depth_png(const cv::Mat1f& depth);

// depth [m], 0 = unknown, as OpenEXR: one channel "Y" of 32-bit floats (what
// readers of grey pictures look for), not compressed.
std::vector<unsigned char> encode_depth_exr(const cv::Mat1f& depth);

}  // namespace iris::exporters
