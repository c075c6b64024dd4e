// What a camera would have seen that stood beside the recording one: example_04_novel_view SESSION FRAME METRES
// PICTURE.png
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <opencv2/imgcodecs.hpp>

#include "iris/rectify/rectifier.h"
#include "iris/render/dsnv.h"
#include "iris/session/session.h"
#include "iris/stereo/mwmf.h"

int main(int argc, char** argv) try {
  if (argc != 5) {
    std::fprintf(stderr, "usage: %s SESSION FRAME METRES_TO_THE_RIGHT PICTURE.png\n", argv[0]);
    return 2;
  }
  const auto session = iris::session::open_session(argv[1], {});
  const int frame = std::atoi(argv[2]);
  if (frame < 0 || frame >= session->size()) {
    std::fprintf(stderr, "the session's frames are 0 to %d\n", session->size() - 1);
    return 2;
  }
  const iris::rectify::Rectifier rectifier(session->calibration());
  const iris::RectifiedCamera& camera = rectifier.camera();
  const iris::StereoPair pair = rectifier.rectify(session->read(frame));
  iris::stereo::MwmfOptions stereo;
  stereo.disparities = 128;
  const auto view = std::make_shared<iris::StereoView>();
  view->frame_idx = frame;
  view->camera = camera;
  view->image = pair.left_colour.empty() ? cv::Mat(pair.left) : cv::Mat(pair.left_colour);
  view->disparity = iris::stereo::mwmf(pair.left, pair.right, stereo);

  iris::NovelCamera novel{
      .width = camera.width, .height = camera.height, .f = camera.f, .cx = camera.cx, .cy = camera.cy};
  novel.world_from_cam.translation().x() = std::atof(argv[3]);
  const iris::NovelView picture =
      iris::render::render_novel_view(novel, {std::shared_ptr<const iris::StereoView>(view)}, {});
  cv::imwrite(argv[4], picture.image);
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 3;
}
