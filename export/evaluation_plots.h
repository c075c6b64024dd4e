// Plots of the errors of a result: each as PNG and as SVG, `folder`/NAME.png and .svg.
#pragma once

#include <filesystem>
#include <string>

#include "iris/evaluate/disparities.h"
#include "iris/evaluate/map.h"
#include "iris/evaluate/trajectory.h"

namespace iris::exporters {

// trajectory_path, trajectory_translation_error, trajectory_rotation_error. `forward`: index of the axis that is drawn
// upwards (1 in a z-up world, 2 in a camera's). `has_time`: false if the stamps are numbers of frames.
void plot_trajectory(const std::filesystem::path& folder, const evaluate::TrajectoryErrors& errors,
                     const evaluate::Trajectory& truth, int forward, bool has_time);

// disparity_histogram, disparity_pixel_locking.
void plot_disparities(const std::filesystem::path& folder, const evaluate::DisparityScore& score);

// `name`: the disparity image in the colours of its errors.
void plot_error_picture(const std::filesystem::path& folder, const std::string& name, const cv::Mat1f& estimate,
                        const cv::Mat1f& truth, const evaluate::DisparityOptions& options);

// map_errors.
void plot_map(const std::filesystem::path& folder, const evaluate::GridMap& estimate, const evaluate::GridMap& truth,
              const Pose& truth_from_estimate, const evaluate::MapOptions& options);

}  // namespace iris::exporters
