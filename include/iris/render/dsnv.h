// DSNV: novel views straight from disparity images (thesis ch. 7). No mesh is built: the ray of each pixel of the novel
// camera is a straight line in the disparity space of a source view, and is walked pixel by pixel until it meets the
// disparity surface.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "iris/core/options.h"
#include "iris/types/novel_view.h"
#include "iris/types/stereo_view.h"

namespace iris::render {

struct DsnvOptions {
  int max_sources = 4;               // source views a picture is made from; >= 1
  int hole_sources = 6;              // so many further views at most show what is still missing; >= 0
  double max_disparity_step = 2;     // [px] neighbours in the disparity image that differ by more are different objects
                                     // (thesis 7.9); > 0
  int step = 1;                      // [px] trace every n-th pixel of the novel view, interpolate the rest; 1, 2 or 4
  std::string fusion = "agreement";  // "agreement": the surface that most sources support, blended; "nearest": the
                                     // smallest pseudo distance (7.10)
  std::string use_origin = "everywhere";  // disparities used: "measured", "within" segments, "everywhere"
  int fill_holes = 6;  // [px] widest hole of the picture that is filled from the background beside it; depth and source
                       // stay "hole"; >= 0
  // What is done to stored views before pictures are made from them (refine.h).
  int neighbours = 5;            // views that each view is compared with; 0 = views are used as they are stored
  bool free_space = false;       // corrects surfaces that lie in what neighbours see to be free, and fills holes
  bool even_brightness = false;  // takes out gain, bias and vignetting of the views
  void declare(OptionSet& set);
};

// A source view made ready: the accepted disparities and the bounds by which free space is skipped. Worth keeping while
// several novel views use it.
class PreparedSource {
 public:
  PreparedSource(std::shared_ptr<const StereoView> view, const DsnvOptions& options);

  const StereoView& view() const { return *view_; }
  const cv::Mat1f& disparity() const { return disparity_; }  // [px] 0 = none
  float min_disparity() const { return min_disparity_; }     // [px] of the valid ones; 0 if there is none
  float max_disparity() const { return max_disparity_; }
  // Largest disparity in a rectangle of pixels (all bounds included, inside the image), or a little more than that.
  float max_in(int x0, int y0, int x1, int y1) const;
  // Smallest valid disparity there, or a little less; larger than every disparity if none is valid.
  float min_in(int x0, int y0, int x1, int y1) const;

 private:
  static constexpr int kFirstBits = 2;  // the finest level has blocks of 4x4 pixels
  std::shared_ptr<const StereoView> view_;
  cv::Mat1f disparity_;
  float min_disparity_ = 0, max_disparity_ = 0;
  // Level k: largest and smallest disparity of each block of 2^(k+2) x 2^(k+2) pixels.
  std::vector<cv::Mat1f> max_levels_, min_levels_;
};

// Asked for one more source while holes remain; nullptr = enough. The picture so far has every options.step-th pixel of
// the camera.
using FurtherSource = std::function<std::shared_ptr<const PreparedSource>(const NovelView& so_far)>;

// The picture of the novel camera. `source` of the result holds indices into `sources`; what a further source shows has
// the indices after these. All views must be in one sub-map. Bit-identical for any number of threads.
NovelView render_novel_view(const NovelCamera& camera, const std::vector<std::shared_ptr<const StereoView>>& sources,
                            const DsnvOptions& options);
NovelView render_novel_view(const NovelCamera& camera,
                            const std::vector<std::shared_ptr<const PreparedSource>>& sources,
                            const DsnvOptions& options, const FurtherSource& further = nullptr);

// Where one ray meets the surface of one source view.
enum class Meeting { nothing, surface, back_side };
struct RayHit {
  Meeting meeting = Meeting::nothing;
  float x = 0, y = 0;   // [px] in the source image
  float disparity = 0;  // [px] as the disparity image holds it (without the camera's offset)
  float along = 0;      // s of P(s) = s Q + T (7.2)
};

// Walks the ray P(s) = s * direction + origin, s >= from, given in the camera frame of the source.
RayHit walk_ray(const PreparedSource& source, const Eigen::Vector3d& direction, const Eigen::Vector3d& origin,
                double from, double max_disparity_step);

// Direction of a pixel's ray in the novel camera frame. pinhole: z = 1, so that s is the depth V_nz; equirectangular: a
// unit vector, so that s is the range.
Eigen::Vector3d pixel_ray(const NovelCamera& camera, double x, double y);

}  // namespace iris::render
