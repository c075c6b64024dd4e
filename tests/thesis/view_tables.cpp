// Chapter 7: a view of the boxes predicted from other views (fig. 7.7).
#include <fmt/format.h>

#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

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

NovelCamera camera_at(const Sequence& sequence, size_t index) {
  return {.width = sequence.camera.width,
          .height = sequence.camera.height,
          .f = sequence.camera.f,
          .cx = sequence.camera.cx,
          .cy = sequence.camera.cy,
          .world_from_cam = sequence.truth[index]};
}

struct Disparities {
  const char* name;
  stereo::MwmfOptions options;
};

// Figures 7.7i and k once more, all around the boxes, each time from two views 34 degrees away on both sides. What few
// pixels a sparse method shows are the easy ones: the pixels that all methods show are compared as well.
void compare_disparities(const Sequence& sequence, const std::vector<Disparities>& methods) {
  constexpr size_t kPlaces = 8;
  const size_t views = sequence.pairs.size(), between = views * 34 / 360;
  struct Sum {
    double coverage = 0, whole = 0, psnr = 0, ssim = 0;
  };
  std::vector<Sum> sums(methods.size());
  for (size_t place = 0; place < kPlaces; ++place) {
    const size_t at = place * views / kPlaces;
    cv::Mat3b truth;
    cv::cvtColor(sequence.pairs[at].left, truth, cv::COLOR_GRAY2BGR);
    std::vector<NovelView> shown;
    cv::Mat1b by_all(truth.size(), uint8_t{255});
    for (const Disparities& method : methods) {
      shown.push_back(render::render_novel_view(camera_at(sequence, at),
                                                {view_of(sequence, (at + views - between) % views, method.options),
                                                 view_of(sequence, (at + between) % views, method.options)},
                                                {.fusion = "nearest", .fill_holes = 0}));
      by_all &= shown.back().source >= 0;
    }
    for (size_t k = 0; k < methods.size(); ++k) {
      const evaluate::ImageErrors errors = evaluate::compare_images(shown[k].image, truth, by_all);
      sums[k].coverage += evaluate::compare_images(shown[k].image, truth, shown[k].source >= 0).coverage / kPlaces;
      sums[k].whole += evaluate::compare_images(shown[k].image, truth, {}).psnr / kPlaces;
      sums[k].psnr += errors.psnr / kPlaces;
      sums[k].ssim += errors.ssim / kPlaces;
    }
  }
  fmt::print(
      "\n{} views around the boxes, each from two views 34° away (7.7i with both kinds of disparities), means\n\n",
      kPlaces);
  print_heading({"disparities", "coverage", "PSNR with holes black", "PSNR where all show something", "SSIM there"});
  for (size_t k = 0; k < methods.size(); ++k) {
    print_row({methods[k].name, fmt::format("{:.1f} %", sums[k].coverage), fmt::format("{:.2f} dB", sums[k].whole),
               fmt::format("{:.2f} dB", sums[k].psnr), fmt::format("{:.3f}", sums[k].ssim)});
  }
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

  const NovelCamera camera = camera_at(sequence, third);
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
  compare_disparities(sequence, {{"MWMF", mwmf}, {"LoG/SAD", plain}});
}

}  // namespace iris::thesis
