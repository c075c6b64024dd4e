// Point clouds as other programs read them: PLY and PCD.
#pragma once

#include <filesystem>

#include "iris/types/point_cloud.h"

namespace iris::exporters {

// PLY: vertices with x y z nx ny nz (float), red green blue (uchar, sRGB), sigma range (float, m), views (ushort); the
// edge of the cubes in a comment. Binary little-endian, or ascii with as many digits as a float has.
// Throws InputError if the file cannot be written; never leaves half a file.
void write_ply(const std::filesystem::path& path, const PointCloud& cloud, bool ascii = false);

// PCD v0.7, binary: x y z normal_x normal_y normal_z (float), rgb (three bytes packed into a float, as PCL has it),
// sigma range (float), views (uint16).
void write_pcd(const std::filesystem::path& path, const PointCloud& cloud);

// A file of write_ply. Throws InputError that says what is wrong with any other.
PointCloud read_ply(const std::filesystem::path& path);

}  // namespace iris::exporters
