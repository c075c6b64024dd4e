// Tours through a finished run: the camera path that was asked for becomes a video, a folder of pictures or a tour of
// panoramas.
#pragma once

#include <filesystem>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "export/products.h"

namespace iris::exporters {

struct TourRequest {
  // along: the recorded path; orbit; walk; panorama: turning on the spot; follow, fixed: seen from beside the recording
  // camera; else a file (tour/path_file.h).
  std::string path = "along";
  std::filesystem::path output;           // .mp4, .webm, or a folder of pictures
  std::vector<Eigen::Vector2d> stops;     // [m] walk: from, via, to
  std::optional<Eigen::Vector3d> centre;  // [m] orbit: what is looked at; none = what most views look at
  std::vector<Eigen::Vector2d> at;        // [m] panorama: where; none = chosen
  int first_frame = 0, end_frame = -1;    // only these frames, the end not included; -1 = to the end
  bool preview = false;                   // a quarter of the width and height
  bool dynamic = false;                   // each frame from the pair of its moment only (8.3.3)
  std::filesystem::path robot;            // model to draw at the recording camera; empty = none
  std::filesystem::path frames;           // folder of a video's pictures while it is made; empty = <output>.frames
  bool keep_frames = false;               // leave them there
  // Names of tour options, without the section, that win over what a camera path file says: width, height, fps,
  // seconds, fov, ease. Where the others are concerned, the file wins over the options.
  std::set<std::string> given;
};

struct TourResult {
  int frames = 0;    // in the result
  int rendered = 0;  // by this call: the others were there
};

// Renders the tour. An interrupted one goes on behind the last picture when it is called again with the same request
// and the same options; the result is the same. Throws UsageError for points that are not free, and frames that are not
// there.
TourResult write_tour(const workspace::Workspace& workspace, const RunOptions& options, const TourRequest& request,
                      const pipeline::RunControl& control);

// Its camera path: behind and above the recording camera. `nodes`: the poses of one sub-map, `views`: those of it.
CameraPath recorded_tour(const std::vector<PoseNode>& nodes, const views::ViewStore& views,
                         const tour::TourOptions& options);

// The tour of a run: OUT/tour/tour.mp4 along the recorded path, and its pictures in OUT/tour/frames.
void write_run_tour(const workspace::Workspace& workspace, const RunOptions& options,
                    const pipeline::RunControl& control);

// The map that tours are planned on: of the views, with the options of the run.
mapping::MapRaster tour_map(const workspace::Workspace& workspace, const RunOptions& options,
                            const views::ViewStore& views, const pipeline::RunControl& control);

// Median height of the recording camera, or options.eye [m].
double eye_height(const std::vector<PoseNode>& nodes, const tour::TourOptions& options);

}  // namespace iris::exporters
