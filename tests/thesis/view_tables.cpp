// Chapter 7: a view of the boxes predicted from other views (fig. 7.7).
#include <fmt/format.h>

#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "iris/evaluate/images.h"
#include "iris/render/dsnv.h"
#include "thesis/sequence.h"
#include "thesis/tables.h"

namespace iris::thesis {
namespace {

std::shared_ptr<const StereoView> view_of(const Sequence& sequence, size_t index, const stereo::MwmfOptions& options) {
  auto view = std::make_shared<StereoView>();
  const StereoPair& pair = sequence.pairs[index];
  view->frame_idx = static_cast<int>(index);
  view->camera = sequence.camera;
  view->image = pair.left;
  view->disparity = stereo::mwmf(pair.left, pair.right, options);
  view->world_from_cam = sequence.truth[index];
  return view;
}

}  // namespace

void print_view_tables() {
  simulate::SimulateOptions options = thesis_camera();
  const Sequence sequence = simulate_sequence("boxes", options);
  // View 3 lies 34 degrees of the circle behind view 1 and before view 2.
  const size_t views = sequence.pairs.size(), between = views * 34 / 360;
  const size_t first = views / 4, third = first + between, second = third + between;

  stereo::MwmfOptions mwmf = thesis_stereo();
  mwmf.interpolation = "everywhere";
  stereo::MwmfOptions plain = plain_correlation();
  plain.disparities = mwmf.disparities;

  NovelCamera camera{.width = sequence.camera.width,
                     .height = sequence.camera.height,
                     .f = sequence.camera.f,
                     .cx = sequence.camera.cx,
                     .cy = sequence.camera.cy,
                     .world_from_cam = sequence.truth[third]};
  cv::Mat3b truth;
  cv::cvtColor(sequence.pairs[third].left, truth, cv::COLOR_GRAY2BGR);
  cv::Mat pictures = truth.clone();
  fmt::print("\n## Chapter 7: a view predicted from others 34° away (figure 7.7), true poses\n\n");
  print_heading({"figure", "from", "disparities", "fusion", "coverage", "PSNR of what is covered", "SSIM of it",
                 "PSNR with holes black"});
  const auto predict = [&](const char* figure, const char* from, const std::vector<size_t>& sources,
                           const stereo::MwmfOptions& stereo, const char* name, const char* fusion) {
    render::DsnvOptions dsnv;
    dsnv.fusion = fusion;
    dsnv.fill_holes = 0;
    std::vector<std::shared_ptr<const StereoView>> source_views;
    for (const size_t index : sources) source_views.push_back(view_of(sequence, index, stereo));
    const NovelView view = render::render_novel_view(camera, source_views, dsnv);
    const evaluate::ImageErrors errors = evaluate::compare_images(view.image, truth, view.source >= 0);
    print_row({figure, from, name, fusion, fmt::format("{:.1f} %", errors.coverage),
               fmt::format("{:.2f} dB", errors.psnr), fmt::format("{:.3f}", errors.ssim),
               fmt::format("{:.2f} dB", evaluate::compare_images(view.image, truth, {}).psnr)});
    cv::hconcat(pictures, view.image, pictures);
  };
  predict("7.7h", "view 1", {first}, mwmf, "MWMF", "nearest");
  predict("7.7i", "views 1 and 2", {first, second}, mwmf, "MWMF", "nearest");
  predict("7.7k", "view 1", {first}, plain, "LoG/SAD", "nearest");
  cv::imwrite("predicted_view.png", pictures);
  predict("-", "views 1 and 2", {first, second}, mwmf, "MWMF", "agreement");
}

}  // namespace iris::thesis
