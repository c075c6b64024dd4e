// How good novel views are: a table of docs/benchmarks.md. Stored views are held out and rendered from others.
#include <fmt/format.h>

#include <chrono>
#include <cmath>
#include <filesystem>
#include <functional>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <random>
#include <string>
#include <vector>

#include "bench/bench.h"
#include "bench/inputs.h"
#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "iris/evaluate/images.h"
#include "iris/rectify/rectifier.h"
#include "iris/render/refine.h"
#include "iris/render/source_selection.h"
#include "iris/simulate/simulator.h"
#include "iris/stereo/mwmf.h"
#include "iris/stereo/search_range.h"
#include "iris/views/selection.h"

namespace iris::bench {
namespace {
namespace fs = std::filesystem;

using Views = std::vector<std::shared_ptr<const StereoView>>;

// A camera and what it sees.
struct Target {
  NovelCamera camera;
  cv::Mat truth;
};

struct Case {
  std::string name;
  Views sources;
  std::vector<Target> targets;
  double least_distance = 0;  // [m] of a source from the novel camera
};

// One way of making the pictures.
struct Variant {
  std::string name;
  render::DsnvOptions render;
};

NovelCamera camera_of(const RectifiedCamera& camera, const Pose& world_from_cam) {
  return {.projection = Projection::pinhole,
          .width = camera.width,
          .height = camera.height,
          .f = camera.f,
          .cx = camera.cx,
          .cy = camera.cy,
          .world_from_cam = world_from_cam};
}

// As a run finds it.
int search_range(const Recording& recording, const stereo::MwmfOptions& options) {
  constexpr size_t kSamples = 12;
  std::vector<StereoPair> samples;
  for (size_t k = 0; k < kSamples; ++k) {
    samples.push_back(recording.pairs[recording.pairs.size() * (2 * k + 1) / (2 * kSamples)]);
  }
  return stereo::estimate_search_range(samples, options).disparities;
}

// Every n-th of the chosen frames is held out, the others are sources.
Case hold_out(const std::string& name, const Recording& recording, const std::vector<int>& frames, int every) {
  Case result{.name = name, .sources = {}, .targets = {}};
  std::vector<int> sources;
  for (size_t i = 0; i < frames.size(); ++i) {
    const auto frame = static_cast<size_t>(frames[i]);
    if (static_cast<int>(i) % every == every / 2) {
      result.targets.push_back(
          {camera_of(recording.camera, recording.world_from_cam[frame]), recording.pairs[frame].left});
    } else {
      sources.push_back(frames[i]);
    }
  }
  stereo::MwmfOptions stereo;
  stereo.disparities = search_range(recording, stereo);
  result.sources.resize(sources.size());
  parallel_chunks(0, static_cast<int>(sources.size()), 1, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      const auto frame = static_cast<size_t>(sources[static_cast<size_t>(i)]);
      const StereoPair& pair = recording.pairs[frame];
      result.sources[static_cast<size_t>(i)] =
          std::make_shared<StereoView>(StereoView{.frame_idx = static_cast<int>(frame),
                                                  .camera = recording.camera,
                                                  .image = pair.left,
                                                  .disparity = mwmf(pair.left, pair.right, stereo),
                                                  .world_from_cam = recording.world_from_cam[frame]});
    }
  });
  return result;
}

// The frames that are stored as views.
std::vector<int> stored_frames(const Recording& recording) {
  std::vector<int> frames;
  for (int i = 0; i < static_cast<int>(recording.pairs.size()); ++i) {
    const auto pose = [&](int frame) { return recording.world_from_cam[static_cast<size_t>(frame)]; };
    if (frames.empty() || views::is_new_view(pose(frames.back()), pose(i), recording.camera, {})) frames.push_back(i);
  }
  return frames;
}

std::vector<int> all_frames(const Recording& recording) {
  std::vector<int> frames(recording.pairs.size());
  for (size_t i = 0; i < frames.size(); ++i) frames[i] = static_cast<int>(i);
  return frames;
}

// Of a simulated session.
int seed_of(const fs::path& folder) {
  const std::string text = read_file(folder / "truth/options.toml"), name = "\nseed = ";
  const size_t at = text.find(name);
  IRIS_CHECK(at != std::string::npos);
  return std::stoi(text.substr(at + name.size()));
}

// The same sources; targets are rendered from where the recording camera never stood: up to 0.3 m beside its path, up
// to 20 degrees away from its direction.
Case free_poses(const Case& held_out, int seed) {
  constexpr int kPoses = 30;
  constexpr float kTooNear = 0.35f;  // [m] nothing may fill the picture
  simulate::SimulateOptions options;
  options.exposure = 0;
  options.snr = 0;
  options.rate = 1;
  options.seed = seed;
  const simulate::Scene scene = simulate::make_scene("apartment", options.seed);
  std::mt19937 random(1);
  std::uniform_real_distribution<double> unit(-1, 1);
  std::vector<Pose> poses;
  for (int i = 0; i < 3 * kPoses; ++i) {
    const size_t near = static_cast<size_t>(i) * held_out.sources.size() / (3 * kPoses);
    Pose change = Pose::Identity();
    const double yaw = 0.35 * unit(random), pitch = 0.15 * unit(random);
    change.translation() = 0.3 * Eigen::Vector3d(unit(random), 0.5 * unit(random), unit(random));
    change.linear() =
        (Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitY()) * Eigen::AngleAxisd(pitch, Eigen::Vector3d::UnitX()))
            .toRotationMatrix();
    poses.push_back(held_out.sources[near]->world_from_cam * change);
  }
  simulate::SimulatedPath path{
      .name = "free", .seconds = static_cast<double>(poses.size() - 1), .length = 0, .world_from_cam = {}};
  path.world_from_cam = [poses](double t) { return poses[static_cast<size_t>(std::lround(t))]; };
  const simulate::Simulator simulator(scene, path, options);
  const rectify::Rectifier rectifier(simulator.calibration());
  Pose left_from_rect = Pose::Identity();
  left_from_rect.linear() = rectifier.rect_from_left().transpose();
  Case result{.name = "apartment, free poses", .sources = held_out.sources, .targets = {}};
  const RectifiedCamera& camera = simulator.rectified_camera();
  for (int i = 0; i < simulator.frames() && static_cast<int>(result.targets.size()) < kPoses; i += 3) {
    for (int k = i; k < i + 3; ++k) {
      const cv::Mat1f disparity = simulator.truth(k).disparity;
      const auto too_near = static_cast<float>(camera.f * camera.baseline) / kTooNear;
      const bool blocked = cv::countNonZero(disparity > too_near) > 0.05 * static_cast<double>(disparity.total());
      if (blocked) continue;
      result.targets.push_back({camera_of(camera, simulator.world_from_left(k) * left_from_rect),
                                rectifier.rectify(simulator.frame(k)).left});
      break;
    }
  }
  return result;
}

// Each frame's gain drifts, both cameras alike, and its corners are darker; the truth keeps neither.
Case with_drift(const Case& bright) {
  constexpr double kGain = 0.15, kPeriod = 23;  // [views]
  constexpr double kVignetting = 0.15;
  Case result = bright;
  result.name += ", exposure drifting by 15 %, corners 15 % darker";
  for (size_t i = 0; i < result.sources.size(); ++i) {
    auto view = std::make_shared<StereoView>(*bright.sources[i]);
    const RectifiedCamera& camera = view->camera;
    const double gain = 1 + kGain * std::sin(2 * M_PI * static_cast<double>(i) / kPeriod);
    const double corner = camera.cx * camera.cx + camera.cy * camera.cy;
    view->image = view->image.clone();
    for (int y = 0; y < view->image.rows; ++y) {
      for (int x = 0; x < view->image.cols; ++x) {
        const double r2 = (std::pow(x - camera.cx, 2) + std::pow(y - camera.cy, 2)) / corner;
        uint8_t& grey = view->image.at<uint8_t>(y, x);
        grey = cv::saturate_cast<uint8_t>(grey * gain * (1 - kVignetting * r2));
      }
    }
    result.sources[i] = view;
  }
  return result;
}

struct Score {
  int count = 0;
  double coverage = 0, psnr = 0, ssim = 0;  // sums
  double seconds = 0;                       // of preparing a source
};

class SharedViews : public views::ViewStore {
 public:
  explicit SharedViews(const Views& views) : views_(views) {
    for (const auto& view : views_) summaries_.push_back(views::summarise(*view));
  }
  const std::vector<views::ViewSummary>& summaries() const override { return summaries_; }
  std::shared_ptr<const StereoView> load(int index) const override { return views_[static_cast<size_t>(index)]; }

 private:
  const Views& views_;
  std::vector<views::ViewSummary> summaries_;
};

Score score(const Case& work, const Variant& variant, const fs::path& pictures) {
  const auto begin = std::chrono::steady_clock::now();
  const SharedViews stored(work.sources);
  const render::RefinedViewStore refined(stored, variant.render, 0);
  const std::vector<views::ViewSummary>& summaries = refined.summaries();
  Views sources(work.sources.size());
  parallel_chunks(0, static_cast<int>(sources.size()), 1, [&](int from, int to) {
    for (int i = from; i < to; ++i) sources[static_cast<size_t>(i)] = refined.load(i);
  });
  const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - begin;
  Score result{.count = static_cast<int>(work.targets.size())};
  result.seconds = seconds.count() / static_cast<double>(sources.size());
  std::vector<evaluate::ImageErrors> errors(work.targets.size());
  parallel_chunks(0, result.count, 1, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      const Target& target = work.targets[static_cast<size_t>(i)];
      std::vector<views::ViewSummary> allowed;
      std::vector<size_t> indices;
      for (size_t k = 0; k < summaries.size(); ++k) {
        const double distance =
            (summaries[k].world_from_cam.translation() - target.camera.world_from_cam.translation()).norm();
        if (distance < work.least_distance) continue;
        allowed.push_back(summaries[k]);
        indices.push_back(k);
      }
      const NovelView view = render::render_from_views(
          target.camera, allowed,
          [&](int k) {
            return std::make_shared<render::PreparedSource>(sources[indices[static_cast<size_t>(k)]], variant.render);
          },
          variant.render);
      cv::Mat image = view.image;
      if (target.truth.channels() == 1) cv::cvtColor(view.image, image, cv::COLOR_BGR2GRAY);
      errors[static_cast<size_t>(i)] = evaluate::compare_images(image, target.truth, view.source >= 0);
      if (pictures.empty() || i % 8 != 0) continue;
      cv::Mat both, difference;
      cv::absdiff(image, target.truth, difference);
      difference.setTo(255, view.source < 0);
      cv::hconcat(std::vector<cv::Mat>{image, target.truth, difference * 3}, both);
      cv::imwrite((pictures / fmt::format("{}-{:03}-{}.png", work.name, i, variant.name)).string(), both);
    }
  });
  for (const evaluate::ImageErrors& e : errors) {
    result.coverage += e.coverage, result.psnr += e.psnr, result.ssim += e.ssim;
  }
  return result;
}

std::vector<Variant> all_variants() {
  const render::DsnvOptions plain{.free_space = false, .even_brightness = false};
  const auto with = [&](auto... members) {
    render::DsnvOptions options = plain;
    ((options.*members = true), ...);
    return options;
  };
  using Options = render::DsnvOptions;
  render::DsnvOptions nearest = plain;
  nearest.fusion = "nearest";
  render::DsnvOptions alone = plain;
  alone.hole_sources = 0;
  return {
      {"smallest distance (7.10)", nearest},
      {"agreement", plain},
      {"agreement, no further sources", alone},
      {"agreement, free space", with(&Options::free_space)},
      {"agreement, even brightness", with(&Options::even_brightness)},
      {"all", with(&Options::free_space, &Options::even_brightness)},
      {"default", {}},
  };
}

}  // namespace

void print_view_quality(const ViewQualityOptions& options) {
  std::vector<std::function<std::vector<Case>()>> groups;
  const fs::path data = IRIS_TEST_DATA;
  // Of a recording whose cases have names that begin like this.
  const auto wanted = [&](const std::string& name) {
    return name.find(options.only) != std::string::npos || options.only.starts_with(name);
  };
  if (!options.apartment.empty() && wanted("apartment")) {
    groups.push_back([&] {
      const fs::path folder = options.apartment;
      const Recording recording = read_recording(folder, folder / "truth/trajectory.tum");
      const Case held_out = hold_out("apartment", recording, stored_frames(recording), 5);
      return std::vector<Case>{held_out, free_poses(held_out, seed_of(folder)), with_drift(held_out)};
    });
  }
  if (fs::exists(data / "euroc_mh01") && wanted("EuRoC")) {
    groups.push_back([&] {
      const fs::path folder = data / "euroc_mh01";
      const Recording recording = read_recording(folder, folder / "truth_left_camera.tum");
      Case near = hold_out("EuRoC", recording, all_frames(recording), 4);
      Case far = near;
      far.name = "EuRoC, sources 0.22 m away";
      far.least_distance = 0.22;
      return std::vector<Case>{near, far};
    });
  }
  if (fs::exists(data / "kitti_street") && wanted("KITTI")) {
    groups.push_back([&] {
      const fs::path folder = data / "kitti_street";
      const Recording recording = read_recording(folder, folder / "poses.txt");
      return std::vector<Case>{hold_out("KITTI", recording, all_frames(recording), 4)};
    });
  }
  fmt::print(
      "\n## Novel views\n\nViews held out and rendered from others, true poses: coverage, PSNR and "
      "SSIM of what is covered.\n\n| | | pictures | coverage % | PSNR dB | SSIM | s a source "
      "|\n|-|-|-:|-:|-:|-:|-:|\n");
  for (const auto& group : groups) {
    for (const Case& work : group()) {
      if (work.name.find(options.only) == std::string::npos) continue;
      for (const Variant& variant : all_variants()) {
        const Score s = score(work, variant, options.pictures);
        fmt::print("| {} | {} | {} | {:.1f} | {:.2f} | {:.3f} | {:.2f} |\n", work.name, variant.name, s.count,
                   s.coverage / s.count, s.psnr / s.count, s.ssim / s.count, s.seconds);
        std::fflush(stdout);
      }
    }
  }
}

}  // namespace iris::bench
