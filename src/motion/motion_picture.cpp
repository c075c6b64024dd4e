#include "iris/motion/motion_picture.h"

#include <fmt/format.h>

#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>

namespace iris::motion {
namespace {

constexpr int kFraction = 4;  // binary digits of a pixel in drawing coordinates

cv::Point drawn(const Eigen::Vector3d& pixel) {
  return {static_cast<int>(std::lround(pixel.x() * (1 << kFraction))),
          static_cast<int>(std::lround(pixel.y() * (1 << kFraction)))};
}

void write_line(cv::Mat3b& picture, const std::string& text, int line) {
  const cv::Point at(6, 16 + 18 * line);
  cv::putText(picture, text, at, cv::FONT_HERSHEY_SIMPLEX, 0.45, {0, 0, 0}, 3, cv::LINE_AA);
  cv::putText(picture, text, at, cv::FONT_HERSHEY_SIMPLEX, 0.45, {255, 255, 255}, 1, cv::LINE_AA);
}

void draw_pairs(cv::Mat3b& picture, const std::vector<Correspondence>& pairs, const cv::Scalar& colour,
                const RectifiedCamera& camera) {
  for (const Correspondence& c : pairs) {
    const cv::Point cur = drawn(camera.project(c.cur_point)), prev = drawn(camera.project(c.prev_point));
    cv::line(picture, cur, prev, colour, 1, cv::LINE_AA, kFraction);
    cv::circle(picture, cur, 2 << kFraction, colour, 1, cv::LINE_AA, kFraction);
  }
}

}  // namespace

cv::Mat3b motion_picture(const ViewFeatures& current, const ChainStep& step, const RectifiedCamera& camera) {
  const int width = current.image.cols, height = current.image.rows;
  cv::Mat dimmed, colour;
  current.image.convertTo(dimmed, CV_8U, 0.7, 40);
  cv::cvtColor(dimmed, colour, cv::COLOR_GRAY2BGR);
  cv::Mat3b picture;
  cv::repeat(colour, 2, 2, picture);
  cv::Mat3b corners = picture(cv::Rect(0, 0, width, height)), initial = picture(cv::Rect(width, 0, width, height)),
            consistent = picture(cv::Rect(0, height, width, height)),
            used = picture(cv::Rect(width, height, width, height));

  for (const Corner& corner : current.corners) {
    cv::drawMarker(corners, {static_cast<int>(std::lround(corner.x)), static_cast<int>(std::lround(corner.y))},
                   {0, 220, 255}, cv::MARKER_CROSS, 7);
  }
  draw_pairs(initial, step.initial, {80, 80, 255}, camera);
  draw_pairs(consistent, step.consistent, {255, 200, 0}, camera);
  draw_pairs(used, step.used, {80, 255, 80}, camera);

  const MotionEstimate& m = step.estimate;
  write_line(corners, fmt::format("{} corners", current.corners.size()), 0);
  write_line(initial, fmt::format("{} initial pairs{}", m.initial, step.rescued ? " with SIFT and weak corners" : ""),
             0);
  write_line(consistent, fmt::format("{} consistent", m.consistent), 0);
  write_line(used,
             step.reference_frame < 0 ? fmt::format("no motion: {}", name_of(m.status))
                                      : fmt::format("{} used, rms {:.3f} px, against frame {}, {}", m.used, m.rms_px,
                                                    step.reference_frame, name_of(m.status)),
             0);
  if (step.reference_frame >= 0) {
    const Eigen::Vector3d t = 1000 * m.prev_from_cur.translation();
    write_line(used,
               fmt::format("moved {:.1f} {:.1f} {:.1f} mm, turned {:.2f} deg", t.x(), t.y(), t.z(),
                           rotation_angle(m.prev_from_cur) * 180 / std::numbers::pi),
               1);
  }
  return picture;
}

}  // namespace iris::motion
