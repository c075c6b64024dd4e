// What the motion of a frame was made of, for the eye (as thesis fig. 5.2 and 5.4).
#pragma once

#include <opencv2/core.hpp>

#include "iris/motion/chain.h"

namespace iris::motion {

// Four pictures in one: the corners of the current view, and the initial, the consistent and the used pairs, each as a
// line from the point in the current view to its place in the reference view. `current` is the view that was pushed for
// the step. CV_8UC3, twice the size of the view.
cv::Mat3b motion_picture(const ViewFeatures& current, const ChainStep& step, const RectifiedCamera& camera);

}  // namespace iris::motion
