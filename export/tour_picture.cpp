#include "export/tour_picture.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "iris/core/error.h"

namespace iris::exporters {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kGap = 4;                                                    // [px] between the panels
constexpr double kCaption = 0.045;                                         // [picture heights] font of captions
const cv::Scalar kRecordingColour(0, 0, 214), kVirtualColour(178, 90, 0);  // BGR: red as its pyramid, blue

int even(double value) { return std::max(2, 2 * static_cast<int>(std::lround(0.5 * value))); }

// What a camera sees, from above: its place and the horizontal limits of its field of view, as the thesis draws it.
void draw_wedge(cv::Mat3b& map, const MapPlace& place, const Pose& world_from_cam, const Vector3d& left,
                const Vector3d& right, const cv::Scalar& colour, double length) {
  constexpr int kShift = 4;
  const auto pixel = [&](const Vector2d& p) {
    return cv::Point(cv::saturate_cast<int>(p.x() * (1 << kShift)), cv::saturate_cast<int>(p.y() * (1 << kShift)));
  };
  const Vector3d at = world_from_cam.translation();
  const Vector2d apex = place.at(at.x(), at.y());
  std::vector<cv::Point> wedge = {pixel(apex)};
  for (const Vector3d& side : {left, right}) {
    const Vector3d sight = world_from_cam.linear() * side;
    const Vector2d flat(sight.x(), -sight.y());
    if (flat.norm() < 1e-9) return;
    wedge.push_back(pixel(apex + length * flat.normalized()));
  }
  cv::Mat3b filled = map.clone();
  cv::fillConvexPoly(filled, wedge, colour, cv::LINE_AA, kShift);
  cv::addWeighted(filled, 0.25, map, 0.75, 0, map);
  for (const size_t side : {1u, 2u}) cv::line(map, wedge[0], wedge[side], colour, 2, cv::LINE_AA, kShift);
  cv::circle(map, wedge[0], 4 << kShift, colour, cv::FILLED, cv::LINE_AA, kShift);
}

}  // namespace

cv::Mat1b text_mask(const std::string& text, double size) {
  const double width = size * (static_cast<double>(text.size()) + 2), height = 1.6 * size;
  const auto canvas = png_canvas(width, height, 1);
  canvas->text(0.5 * size, 1.15 * size, text, {.size = size, .colour = 0x000000});
  cv::Mat1b mask = 255 - cv::imdecode(canvas->bytes(), cv::IMREAD_GRAYSCALE);
  const cv::Rect box = cv::boundingRect(mask);
  return mask(cv::Rect(0, 0, std::min(mask.cols, box.x + box.width + static_cast<int>(0.5 * size)), mask.rows)).clone();
}

void draw_caption(cv::Mat3b& image, const cv::Mat1b& mask) {
  const int height = std::min(mask.rows, image.rows), width = std::min(mask.cols, image.cols);
  const int top = image.rows - height, left = (image.cols - width) / 2;
  cv::Mat3b band = image.rowRange(top, image.rows);
  band *= 0.45;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      cv::Vec3b& pixel = band(y, left + x);
      for (int c = 0; c < 3; ++c) pixel[c] = static_cast<uint8_t>(pixel[c] + (255 - pixel[c]) * mask(y, x) / 255);
    }
  }
}

double fade_level(double seconds, double length, double fade) {
  if (fade <= 0) return 1;
  const double ramp = std::min(fade, 0.5 * length);
  if (ramp <= 0) return 1;
  return std::clamp(std::min(seconds, length - seconds) / ramp, 0.0, 1.0);
}

TourPicture::TourPicture(const tour::TourOptions& options, const mapping::MapRaster* raster, const PoseGraph& graph,
                         int submap, const RectifiedCamera& recording, const std::vector<tour::Caption>& captions,
                         const CameraPath& path)
    : options_(options), recording_(recording), length_(tour::duration(path)) {
  for (const tour::Caption& caption : captions) {
    captions_.emplace_back(caption.t, caption.text.empty()
                                          ? cv::Mat1b()
                                          : text_mask(caption.text, std::max(10.0, kCaption * options.height)));
  }
  if (options_.layout == "plain") return;
  IRIS_CHECK(raster);
  const double height = options_.height;
  recorded_width_ = even(height * recording.width / recording.height);
  MapExtent extent = extent_of(*raster, graph, submap);
  for (const CameraKeyframe& key : path.keyframes) {
    const Vector3d at = key.world_from_cam.translation();
    extent.x0 = std::min(extent.x0, at.x()), extent.x1 = std::max(extent.x1, at.x());
    extent.y0 = std::min(extent.y0, at.y()), extent.y1 = std::max(extent.y1, at.y());
  }
  map_width_ = even(height * std::clamp(extent.width() / extent.height(), 0.6, 1.6));
  const double scale = 0.96 * std::min(map_width_ / extent.width(), height / extent.height());
  place_ = {.left = 0.5 * (map_width_ - scale * extent.width()),
            .bottom = 0.5 * (height + scale * extent.height()),
            .x = extent.x0,
            .y = extent.y0,
            .units_per_metre = scale};
  const auto canvas = png_canvas(map_width_, height, 1);
  canvas->box(0, 0, map_width_, height, kUnknownCell);
  draw_cells(*canvas, place_, *raster, grey_cells(*raster));
  std::vector<Vector2d> recorded;
  for (const PoseNode& node : graph.nodes) {
    if (node.submap != submap) continue;
    recorded.push_back(place_.at(node.world_from_cam.translation().x(), node.world_from_cam.translation().y()));
  }
  if (options_.draw_path) canvas->line(recorded, kOrange, std::max(1.0, 0.003 * height));
  map_ = cv::imdecode(canvas->bytes(), cv::IMREAD_COLOR);
}

cv::Size TourPicture::size() const {
  if (options_.layout == "plain") return {options_.width, options_.height};
  return {recorded_width_ + map_width_ + options_.width + 2 * kGap, options_.height};
}

cv::Mat3b TourPicture::compose(const tour::TourFrame& frame, double path_time, const NovelView& view,
                               const cv::Mat& recorded) const {
  cv::Mat3b picture;
  if (options_.layout == "plain") {
    picture = view.image.clone();
  } else {
    picture = cv::Mat3b(size(), cv::Vec3b(0, 0, 0));
    cv::Mat left;
    if (!recorded.empty()) {
      cv::resize(recorded, left, {recorded_width_, options_.height}, 0, 0,
                 recorded.rows > options_.height ? cv::INTER_AREA : cv::INTER_LINEAR);
      if (left.channels() == 1) cv::cvtColor(left, left, cv::COLOR_GRAY2BGR);
      left.copyTo(picture.colRange(0, recorded_width_));
    }
    cv::Mat3b map = map_.clone();
    const double length = 0.11 * std::min(map.cols, map.rows) + 6;
    const auto sides = [](double cx, double width, double f) {
      return std::pair(Vector3d((-0.5 - cx) / f, 0, 1), Vector3d((width - 0.5 - cx) / f, 0, 1));
    };
    const auto [recording_left, recording_right] = sides(recording_.cx, recording_.width, recording_.f);
    draw_wedge(map, place_, frame.world_from_recording, recording_left, recording_right, kRecordingColour, length);
    const auto [virtual_left, virtual_right] = sides(frame.camera.cx, frame.camera.width, frame.camera.f);
    draw_wedge(map, place_, frame.camera.world_from_cam, virtual_left, virtual_right, kVirtualColour, length);
    map.copyTo(picture.colRange(recorded_width_ + kGap, recorded_width_ + kGap + map_width_));
    view.image.copyTo(picture.colRange(picture.cols - options_.width, picture.cols));
  }
  const cv::Mat1b* caption = nullptr;
  for (const auto& [t, mask] : captions_) {
    if (t <= path_time + 1e-9) caption = &mask;
  }
  if (caption && !caption->empty()) draw_caption(picture, *caption);
  const double level = fade_level(frame.seconds, length_, options_.fade);
  if (level < 1) picture *= level;
  return picture;
}

}  // namespace iris::exporters
