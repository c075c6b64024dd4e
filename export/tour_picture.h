// What a tour's picture shows besides the novel view: the recorded image and the map beside it (thesis fig. 8.4),
// captions, fades.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "export/map_drawing.h"
#include "iris/tour/frames.h"
#include "iris/tour/path_file.h"

namespace iris::exporters {

// Letters as they cover the pixels: 0 = not, 255 = wholly; as large as the text, `size` [px] of the font.
cv::Mat1b text_mask(const std::string& text, double size);

// The same caption size and place in every picture: white on a dark band at the lower border.
void draw_caption(cv::Mat3b& image, const cv::Mat1b& mask);

// Brightness of a picture `seconds` after the beginning of a tour of that length: 0 = black to 1.
double fade_level(double seconds, double length, double fade);

// Composes the pictures of one tour.
class TourPicture {
 public:
  // raster: for the layout side-by-side, may be null for plain; the map shows what is known, the path of `submap` in
  // graph, and that of the virtual camera.
  TourPicture(const tour::TourOptions& options, const mapping::MapRaster* raster, const PoseGraph& graph, int submap,
              const RectifiedCamera& recording, const std::vector<tour::Caption>& captions, const CameraPath& path);

  // Even sides.
  cv::Size size() const;

  // `path_time` [s]: on the path, for captions. `recorded`: what the recording camera saw last (grey or BGR); empty
  // for plain.
  cv::Mat3b compose(const tour::TourFrame& frame, double path_time, const NovelView& view,
                    const cv::Mat& recorded) const;

 private:
  tour::TourOptions options_;
  RectifiedCamera recording_;
  double length_;
  int recorded_width_ = 0, map_width_ = 0;  // [px] of the panels
  cv::Mat3b map_;                           // the map's panel, before the cameras are drawn
  MapPlace place_;                          // of the world on it [px]
  std::vector<std::pair<double, cv::Mat1b>> captions_;
};

}  // namespace iris::exporters
