// A program on the installed library: links code of several stages and of OpenCV.
#include <cstdio>

#include "iris/core/options.h"
#include "iris/core/parallel.h"
#include "iris/views/view_store.h"

int main() {
  iris::StereoView view;
  view.disparity.disparity = cv::Mat1f(4, 4, 3.0f);
  view.disparity.origin = cv::Mat1b(4, 4, uchar{1});
  view.image = cv::Mat1b(4, 4, uchar{0});
  const iris::views::MemoryViewStore store({view});
  int chunks = 0;
  iris::with_threads(1, [&] { iris::parallel_chunks(0, 10, 4, [&](int, int) { ++chunks; }); });
  const bool good =
      store.summaries().at(0).max_disparity == 3 && chunks == 3 && iris::fingerprint("a") == "af63dc4c8601ec8c";
  std::puts(good ? "good" : "wrong");
  return good ? 0 : 1;
}
