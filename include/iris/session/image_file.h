// Images of recordings, read so that damage is an error and never a half-grey picture.
#pragma once

#include <filesystem>
#include <opencv2/core.hpp>
#include <vector>

namespace iris::session {

// True for the extensions of PNG, JPEG, PGM/PPM, TIFF and BMP, in any case, if the file is not hidden.
bool is_image_file(const std::filesystem::path& path);

// The image as stored, without alpha: CV_8U or CV_16U with 1 or 3 (BGR) channels. Throws InputError if it is missing,
// cut off, damaged or has another depth. Decoders hand out half of a cut file without complaint, so the end of the file
// is checked.
cv::Mat read_image(const std::filesystem::path& path);

// Number of bits that 16-bit images really use: the smallest of 8, 10, 12, 14, 16 that holds the largest value.
int used_bits(double largest_value);

// 8-bit version: values are divided by 2^(bits - 8), rounded and saturated: one factor for a whole recording, so that
// equal light stays equal grey. 8-bit images are handed on.
cv::Mat to_8_bit(const cv::Mat& image, int bits);

}  // namespace iris::session
