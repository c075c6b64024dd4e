// A recorded session with a known path: a stereo camera in a made-up room, as a pair of image folders.
#pragma once

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <opencv2/imgcodecs.hpp>

#include "support/synthetic_views.h"

namespace iris::testing {

// Pose of the left camera in the first camera's frame (x right, y down, z forward): sideways, a little forward,
// turning.
inline Pose synthetic_pose(int frame_idx) {
  Pose pose = Pose::Identity();
  pose.linear() = (Eigen::AngleAxisd(0.015 * frame_idx, Eigen::Vector3d::UnitY()) *
                   Eigen::AngleAxisd(0.005 * frame_idx, Eigen::Vector3d::UnitX()))
                      .toRotationMatrix();
  pose.translation() = Eigen::Vector3d(-0.06, -0.01, 0.03) * frame_idx;
  return pose;
}

// Position of the left camera in the world of a run: x forward, y left, z up.
inline Eigen::Vector3d synthetic_position(int frame_idx) {
  const Eigen::Vector3d p = synthetic_pose(frame_idx).translation();
  return {p.z(), -p.x(), -p.y()};
}

inline RectifiedCamera synthetic_camera() {
  return {.f = 260, .cx = 159.5, .cy = 119.5, .baseline = 0.1, .width = 320, .height = 240};
}

inline void write_synthetic_session(const std::filesystem::path& folder, int frames) {
  std::filesystem::create_directories(folder / "left");
  std::filesystem::create_directories(folder / "right");
  const RectifiedCamera camera = synthetic_camera();
  const Room room;
  std::ofstream times(folder / "times.txt");
  for (int i = 0; i < frames; ++i) {
    const Pose left = synthetic_pose(i);
    Pose right = left;
    right.translation() = left * Eigen::Vector3d(camera.baseline, 0, 0);
    char name[16];
    std::snprintf(name, sizeof name, "%06d.png", i);
    cv::imwrite((folder / "left" / name).string(), render_room(room, camera, left).image);
    cv::imwrite((folder / "right" / name).string(), render_room(room, camera, right).image);
    times << i / 10 << '.' << i % 10 << '\n';
  }
  const std::string k =
      "\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 260., 0., 159.5, 0., 260., 119.5, 0., 0., 1. ]\n";
  const std::string d = "\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ 0., 0., 0., 0., 0. ]\n";
  std::ofstream(folder / "calibration.yaml")
      << "%YAML:1.0\n---\nimage_width: 320\nimage_height: 240\nM1: !!opencv-matrix" << k << "D1: !!opencv-matrix" << d
      << "M2: !!opencv-matrix" << k << "D2: !!opencv-matrix" << d
      << "R: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]\n"
      << "T: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: d\n   data: [ -0.1, 0., 0. ]\n";
}

}  // namespace iris::testing
