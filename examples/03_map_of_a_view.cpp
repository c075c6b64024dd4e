// What one stereo view says about the space before it, as a map from above (black: occupied, white: free, grey:
// unknown): example_03_map_of_a_view SESSION FRAME MAP.png
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <opencv2/imgcodecs.hpp>

#include "iris/mapping/flog.h"
#include "iris/rectify/rectifier.h"
#include "iris/session/session.h"
#include "iris/stereo/mwmf.h"

int main(int argc, char** argv) try {
  if (argc != 4) {
    std::fprintf(stderr, "usage: %s SESSION FRAME MAP.png\n", argv[0]);
    return 2;
  }
  const auto session = iris::session::open_session(argv[1], {});
  const int frame = std::atoi(argv[2]);
  if (frame < 0 || frame >= session->size()) {
    std::fprintf(stderr, "the session's frames are 0 to %d\n", session->size() - 1);
    return 2;
  }
  const iris::rectify::Rectifier rectifier(session->calibration());
  const iris::StereoPair pair = rectifier.rectify(session->read(frame));
  iris::stereo::MwmfOptions stereo;
  stereo.disparities = 128;
  stereo.interpolation = "within";  // what lies between surfaces is not measured
  iris::mapping::FlogOptions mapping;
  mapping.bottom = -0.9;  // the camera is held level, 1 m above the floor
  iris::mapping::FlogBuilder builder(mapping, rectifier.camera());
  builder.add({.frame_idx = frame,
               .camera = rectifier.camera(),
               .image = pair.left,
               .disparity = iris::stereo::mwmf(pair.left, pair.right, stereo),
               .world_from_cam = iris::z_up_from_camera()});
  const iris::mapping::MapRaster raster = iris::mapping::rasterise(builder.map(), mapping);
  cv::Mat1b picture(raster.state.size(), 205);
  picture.setTo(255, raster.state == static_cast<int>(iris::mapping::MapState::free));
  picture.setTo(0, raster.state == static_cast<int>(iris::mapping::MapState::occupied));
  cv::imwrite(argv[3], picture);
  std::printf("%d x %d cells of %.2f m, lower-left corner at (%.2f, %.2f) m\n", raster.width, raster.height,
              raster.cell, raster.origin_x, raster.origin_y);
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 3;
}
