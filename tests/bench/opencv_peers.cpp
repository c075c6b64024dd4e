#include "bench/opencv_peers.h"

#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

namespace iris::bench {

cv::Ptr<cv::StereoMatcher> block_matcher(int disparities) {
  const auto matcher = cv::StereoBM::create(disparities, 11);
  matcher->setSpeckleWindowSize(100);
  matcher->setSpeckleRange(1);
  matcher->setDisp12MaxDiff(1);
  return matcher;
}

cv::Ptr<cv::StereoMatcher> semi_global_matcher(int disparities, int mode) {
  return cv::StereoSGBM::create(0, disparities, 5, 8 * 25, 32 * 25, 1, 63, 10, 100, 1, mode);
}

int plain_motion(const cv::Mat1b& prev, const cv::Mat1f& prev_disparity, const cv::Mat1b& cur,
                 const RectifiedCamera& camera) {
  std::vector<cv::Point2f> corners, tracked;
  cv::goodFeaturesToTrack(prev, corners, 500, 0.01, 8, cv::noArray(), 3, true);
  if (corners.empty()) return 0;
  std::vector<uchar> found;
  std::vector<float> errors;
  cv::calcOpticalFlowPyrLK(prev, cur, corners, tracked, found, errors);
  std::vector<cv::Point3d> points;
  std::vector<cv::Point2d> pixels;
  for (size_t i = 0; i < corners.size(); ++i) {
    const float disparity = prev_disparity(cv::Point(corners[i]));
    if (!found[i] || disparity < 4) continue;
    const Eigen::Vector3d point = camera.point(corners[i].x, corners[i].y, disparity);
    points.emplace_back(point.x(), point.y(), point.z());
    pixels.emplace_back(tracked[i].x, tracked[i].y);
  }
  if (points.size() < 4) return 0;
  const cv::Matx33d k(camera.f, 0, camera.cx, 0, camera.f, camera.cy, 0, 0, 1);
  cv::Vec3d rotation, translation;
  std::vector<int> inliers;
  cv::solvePnPRansac(points, pixels, k, cv::noArray(), rotation, translation, false, 100, 1.0f, 0.99, inliers);
  return static_cast<int>(inliers.size());
}

}  // namespace iris::bench
