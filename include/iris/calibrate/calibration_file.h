// Reads stereo calibrations of every format that is common, recognised by content.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "iris/geometry/stereo_calibration.h"

namespace iris::calibrate {

// Which cameras of a KITTI file: P0/P1 are the grey ones, P2/P3 the colour ones. any = grey, colour if there is no
// grey; rather_colour the other way round. A file of two lines without names holds just the pair that is wanted.
enum class KittiPair { any, rather_colour, grey, colour };

// Formats (the transform each stores, in the words of P_right = right_from_left * P_left):
//   * OpenCV YAML/XML of stereo_calib: M1 D1 M2 D2 R T (also K1, cameraMatrix1, distCoeffs1 …), P_right = R P_left + T,
//     optional image_width image_height and distortion_model (equidistant|fisheye). M1… and R T may stand in two files
//     of one folder (intrinsics.yml, extrinsics.yml).
//   * Kalibr camchain: cam1's T_cn_cnm1 takes points of cam0 to cam1.
//   * ROS camera_info, a left file and its right sibling: P_right[0][3] = -fx b, rectification matrices.
//   * KITTI calib.txt, "P0: 12 numbers" or lines of 12 numbers: P1[0][3] - P0[0][3] = -f b. Rectified.
//   * EuRoC/ASL: cam0/sensor.yaml and cam1/sensor.yaml with T_BS (sensor to body).
//   * Middlebury calib.txt: cam0 cam1 doffs baseline [mm]. Rectified.
// `file_or_folder`: a file, or a folder that holds exactly one calibration (calibration.* goes first) or an EuRoC
// recording (itself, or its mav0). Lengths are metres. The image size stays 0 where the file does not say it.
// Throws InputError: nothing recognised, more than one, or values that cannot be (iris::validate).
StereoCalibration read_calibration(const std::filesystem::path& file_or_folder, KittiPair pair = KittiPair::any);

// The calibration files of a folder (not below it), in order of name, one entry for a pair of files that belong
// together; only calibration.* if that can be read. `broken` gets lines about files that look like calibrations and
// cannot be read, if not null.
std::vector<std::filesystem::path> find_calibrations(const std::filesystem::path& folder,
                                                     std::vector<std::string>* broken = nullptr);

// What is looked for, for messages.
std::string understood_calibrations();

}  // namespace iris::calibrate
