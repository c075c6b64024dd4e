// Writes stereo calibrations in the formats of other tools.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "iris/geometry/stereo_calibration.h"

namespace iris::calibrate {

enum class FileFormat {
  opencv,  // one yaml: M1 D1 M2 D2 R T, image_width image_height, and R1 R2 P1 P2 of this program's rectification
  kalibr,  // camchain yaml: cam0, cam1 with T_cn_cnm1
  ros,     // two camera_info yaml, …left… and …right…
  euroc,   // two sensor.yaml in folders cam0 and cam1; cam0 is the body
};

// opencv, kalibr, ros, euroc; or, if `name` is empty, as the file's name says: *camchain* kalibr, *camera_info* ros, a
// name of a folder or sensor.yaml euroc, otherwise opencv. Throws UsageError for other names.
FileFormat file_format(const std::string& name, const std::filesystem::path& path);

// Whether the format's own tools know k3 of the radial-tangential model.
bool holds_k3(FileFormat format);

// Writes the calibration, each file whole or not at all, with all digits; read_calibration of `path` gives the same
// values. `path`: ros: left and right are put before the ending unless the name says left; euroc: a folder (or a
// sensor.yaml in cam0). Returns the files written. Throws InputError if they cannot be written, UsageError if the
// format does not know the lens model. `comment`: a line for people, put where the format allows it.
std::vector<std::filesystem::path> write_calibration(const std::filesystem::path& path, FileFormat format,
                                                     const StereoCalibration& calibration,
                                                     const std::string& comment = {});

}  // namespace iris::calibrate
