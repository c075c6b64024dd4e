// The path of a recorded session as its motions chain it: example_02_camera_path SESSION > path.tum
#include <cstdio>
#include <exception>

#include "iris/motion/chain.h"
#include "iris/rectify/rectifier.h"
#include "iris/session/session.h"
#include "iris/stereo/mwmf.h"

int main(int argc, char** argv) try {
  if (argc != 2) {
    std::fprintf(stderr, "usage: %s SESSION > path.tum\n", argv[0]);
    return 2;
  }
  const auto session = iris::session::open_session(argv[1], {});
  const iris::rectify::Rectifier rectifier(session->calibration());
  iris::stereo::MwmfOptions stereo;
  stereo.disparities = 128;
  const iris::motion::ScsOptions motion;
  iris::motion::MotionChain chain(rectifier.camera(), motion);
  for (int frame = 0; frame < session->size(); ++frame) {
    const iris::StereoPair pair = rectifier.rectify(session->read(frame));
    const iris::DisparityImage disparity = iris::stereo::mwmf(pair.left, pair.right, stereo);
    const iris::motion::ChainStep step =
        chain.push(iris::motion::extract_features(pair.left, disparity, rectifier.camera(), motion, pair.right), frame);
    if (step.blind) continue;  // shows nothing: no pose
    if (step.new_submap) std::printf("# sub-map %d: its first camera is the origin\n", step.submap);
    const Eigen::Vector3d t = step.world_from_cam.translation();
    const Eigen::Quaterniond q(step.world_from_cam.linear());
    std::printf("%.9f %.6f %.6f %.6f %.7f %.7f %.7f %.7f\n", 1e-9 * static_cast<double>(pair.stamp_ns), t.x(), t.y(),
                t.z(), q.x(), q.y(), q.z(), q.w());
  }
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 3;
}
