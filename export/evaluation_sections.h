// Errors of a result -> the figures and tables that are reported of them.
#pragma once

#include "export/evaluation_report.h"
#include "iris/evaluate/cloud.h"
#include "iris/evaluate/disparities.h"
#include "iris/evaluate/images.h"
#include "iris/evaluate/map.h"
#include "iris/evaluate/trajectory.h"

namespace iris::exporters {

// `has_time`: false if the poses were compared by line.
FigureSection trajectory_section(const evaluate::TrajectoryErrors& errors, const evaluate::TrajectoryOptions& options,
                                 bool has_time);

// Adds how well the stated covariances agree with the errors.
void add_consistency(FigureSection& section, const evaluate::Consistency& motions, const evaluate::Consistency& loops,
                     const evaluate::Consistency& poses);

FigureSection disparity_section(const evaluate::DisparityScore& score, const evaluate::DisparityOptions& options);

FigureSection cloud_section(const evaluate::CloudErrors& errors, const evaluate::CloudOptions& options);

// `cell` [m] of the plan.
FigureSection map_section(const evaluate::MapErrors& errors, double cell, const evaluate::MapOptions& options);

// `size` [px] of the pictures.
FigureSection image_section(const evaluate::ImageErrors& errors, cv::Size size, bool colour);

}  // namespace iris::exporters
