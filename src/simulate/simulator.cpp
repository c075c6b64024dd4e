#include "iris/simulate/simulator.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <opencv2/imgproc.hpp>

#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "iris/rectify/rectifier.h"
#include "renderer.h"
#include "sensor.h"

namespace iris::simulate {
namespace {

constexpr int kRows = 16;               // of an image that are worked on together
constexpr float kJump = 1;              // [px] neighbours whose disparities differ by more belong to different surfaces
constexpr int kDiscontinuityReach = 3;  // [px] from a jump

int root_of(int rays) {
  const int root = static_cast<int>(std::lround(std::sqrt(static_cast<double>(rays))));
  if (rays < 1 || root * root != rays) {
    throw UsageError(fmt::format("simulate.rays is {}; it must be a square number: 1, 4, 9, 16, …", rays));
  }
  return root;
}

// Sessions start at different times, so that recordings of several of them can be told apart and put together.
int64_t start_of(const Scene& scene, const SimulatedPath& path, SimulateOptions options) {
  OptionSet set;
  options.declare(set);
  const std::string hash = fingerprint(scene.name + "\n" + path.name + "\n" + set.text_of({"simulate"}));
  constexpr int64_t kFirst = 1420070400;             // [s] 2015-01-01
  constexpr uint64_t kSpread = 11ull * 365 * 86400;  // [s] eleven years
  return (kFirst + static_cast<int64_t>(std::stoull(hash, nullptr, 16) % kSpread)) * 1'000'000'000;
}

// 255 where a rectified pixel lies within the recorded image.
template <class Source>
cv::Mat1b seen_mask(const RectifiedCamera& camera, const Source& source_of) {
  cv::Mat1b mask(camera.height, camera.width);
  parallel_chunks(0, camera.height, kRows, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < camera.width; ++x) {
        const Eigen::Vector2d at = source_of(Eigen::Vector2d(x, y));
        const bool inside = at.x() >= 0 && at.y() >= 0 && at.x() <= camera.width - 1 && at.y() <= camera.height - 1;
        mask(y, x) = inside ? 255 : 0;
      }
    }
  });
  return mask;
}

}  // namespace

struct Simulator::Impl {
  Impl(const Scene& scene, const SimulatedPath& path_, const SimulateOptions& options_)
      : options(options_),
        path(path_),
        root(root_of(options_.rays)),
        calibration(simulated_rig(options_)),
        rectifier(calibration),
        left_lens(calibration.left),
        right_lens(calibration.right),
        renderer(scene, options_.colour),
        sensor(options_),
        start_ns(start_of(scene, path_, options_)) {
    for (const SceneObject& object : scene.objects) textured.push_back(object.textured);
    left_seen = seen_mask(rectifier.camera(), [&](const Eigen::Vector2d& at) { return rectifier.left_source(at); });
    right_seen = seen_mask(rectifier.camera(), [&](const Eigen::Vector2d& at) { return rectifier.right_source(at); });
  }

  double middle(int frame_idx) const { return frame_idx / options.rate; }

  // At the end of its way the camera stays. Before the first frame and after the end, where an exposure may reach, the
  // way is continued point-symmetrically.
  Pose on_the_way(double at, double offset) const {
    const double t = at + offset, end = t < 0 ? 0 : path.seconds;
    if (t >= 0 && t <= path.seconds) return path.world_from_cam(t);
    const double mirrored = std::clamp(2 * end - t, 0.0, path.seconds);
    const Pose turning = path.world_from_cam(end);
    return turning * path.world_from_cam(mirrored).inverse() * turning;
  }

  // During an exposure the camera moves evenly: the mean pose of an exposure, which is what its image shows, is that of
  // its middle, which the truth tells. A hand that shakes makes 0.004 degrees of difference otherwise.
  Pose world_from_left(int frame_idx, double offset) const {
    const double at = std::min(middle(frame_idx), path.seconds);
    const Pose world_from_cam = on_the_way(at, 0);
    if (offset == 0) return world_from_cam;
    const Pose moved = on_the_way(at, -offset).inverse() * on_the_way(at, offset);
    const Eigen::AngleAxisd turn(Eigen::Matrix3d(moved.linear()));
    Pose half = Pose::Identity();
    half.linear() = Eigen::AngleAxisd(turn.angle() / 2, turn.axis()).toRotationMatrix();
    // So that half * half = moved.
    half.translation() = (Eigen::Matrix3d::Identity() + half.linear()).partialPivLu().solve(moved.translation());
    return world_from_cam * half;
  }

  SimulateOptions options;
  SimulatedPath path;
  int root;
  StereoCalibration calibration;
  rectify::Rectifier rectifier;
  LensTable left_lens, right_lens;
  Renderer renderer;
  Sensor sensor;
  int64_t start_ns;
  std::vector<bool> textured;       // one an object
  cv::Mat1b left_seen, right_seen;  // rectified pixels within the recorded images
};

Simulator::Simulator(const Scene& scene, const SimulatedPath& path, const SimulateOptions& options)
    : impl_(std::make_unique<Impl>(scene, path, options)) {}
Simulator::~Simulator() = default;

int Simulator::frames() const {
  if (impl_->options.frames > 0) return impl_->options.frames;
  return static_cast<int>(std::floor(impl_->path.seconds * impl_->options.rate + 1e-9)) + 1;
}
const StereoCalibration& Simulator::calibration() const { return impl_->calibration; }
const RectifiedCamera& Simulator::rectified_camera() const { return impl_->rectifier.camera(); }
int64_t Simulator::stamp_ns(int frame_idx) const {
  return impl_->start_ns + std::llround(impl_->middle(frame_idx) * 1e9);
}
Pose Simulator::world_from_left(int frame_idx) const { return impl_->world_from_left(frame_idx, 0); }

StereoFrame Simulator::frame(int frame_idx) const {
  IRIS_CHECK(frame_idx >= 0);
  const Impl& s = *impl_;
  const SimulateOptions& options = s.options;
  const int rays = options.rays, width = options.width, height = options.height, channels = s.renderer.channels();

  // The rays of a pixel share the exposure: each of them sees its own moment.
  struct Sample {
    Tracer::Moment moment;
    Renderer::View view[2];
  };
  std::vector<Sample> samples;
  const Pose left_from_right = s.calibration.right_from_left.inverse();
  const bool blurred = options.exposure > 0 && rays > 1;
  for (int k = 0; k < rays; ++k) {
    const double offset = blurred ? options.exposure * 1e-3 * ((k + 0.5) / rays - 0.5) : 0;
    const bool another_moment = samples.empty() || (blurred && !s.renderer.tracer().all_still());
    Sample sample{another_moment ? s.renderer.tracer().at(s.middle(frame_idx) + offset) : samples.back().moment, {}};
    // Times rise in steps of about the golden section from place to place: late rays lie neither right nor below.
    int step = std::max(1, static_cast<int>(std::lround(0.618 * rays)));
    while (std::gcd(step, rays) != 1) ++step;
    // The places of rays at opposite times are opposite as well. Otherwise the blur is skew, and moves fine texture by
    // some hundredths of a pixel.
    const int start = (step % 2 == 1 ? step - 1 : step - 1 + rays) / 2;
    const int place = static_cast<int>((static_cast<int64_t>(k) * step + start) % rays);
    // One ray in each square of a root x root grid, and of `rays` narrow rows and columns each has one, too: along the
    // rows and columns of the image, edges fall on `rays` different places of a pixel instead of on `root` of them.
    const int i = place % s.root, j = place / s.root;
    const double dx = (i + (j + 0.5) / s.root) / s.root;
    const double dy = (j + (s.root - i - 0.5) / s.root) / s.root;
    const Pose world_from_left = s.world_from_left(frame_idx, offset);
    for (int camera = 0; camera < 2; ++camera) {
      sample.view[camera] = {.lens = camera == 0 ? &s.left_lens : &s.right_lens,
                             .dx = dx,
                             .dy = dy,
                             .spacing = 1.0 / s.root,
                             .world_from_cam = camera == 0 ? world_from_left : world_from_left * left_from_right};
    }
    samples.push_back(std::move(sample));
  }

  StereoFrame frame{.frame_idx = frame_idx, .stamp_ns = stamp_ns(frame_idx)};
  frame.left = cv::Mat(height, width, CV_8UC(channels));
  frame.right = cv::Mat(height, width, CV_8UC(channels));
  const int strips = (height + kRows - 1) / kRows;
  parallel_chunks(0, 2 * strips, 1, [&](int strip, int) {
    const int camera = strip / strips;
    const int begin = strip % strips * kRows, end = std::min(begin + kRows, height);
    std::vector<float> sums(static_cast<size_t>(end - begin) * width * channels);
    for (const Sample& sample : samples)
      s.renderer.add_rows(sample.moment, sample.view[camera], begin, end, sums.data());
    cv::Mat& image = camera == 0 ? frame.left : frame.right;
    const double factor = s.sensor.gain(camera, s.middle(frame_idx)) / rays;
    for (int y = begin; y < end; ++y) {
      s.sensor.record_row(&sums[static_cast<size_t>(y - begin) * width * channels], factor, channels, frame_idx, camera,
                          y, image.ptr<uchar>(y));
    }
  });
  return frame;
}

FrameTruth Simulator::truth(int frame_idx) const {
  IRIS_CHECK(frame_idx >= 0);
  const Impl& s = *impl_;
  const RectifiedCamera& camera = s.rectifier.camera();
  const int width = camera.width, height = camera.height;
  const Tracer& tracer = s.renderer.tracer();
  const Tracer::Moment moment = tracer.at(s.middle(frame_idx));
  const Pose world_from_left = s.world_from_left(frame_idx, 0);
  const Eigen::Matrix3d world_from_rect = world_from_left.linear() * s.rectifier.rect_from_left().transpose();
  const Eigen::Vector3d left_centre = world_from_left.translation();
  const Eigen::Vector3d right_centre = left_centre + world_from_rect.col(0) * camera.baseline;

  FrameTruth truth;
  truth.disparity = cv::Mat1f::zeros(height, width);
  truth.occluded = cv::Mat1b::zeros(height, width);
  truth.discontinuity = cv::Mat1b::zeros(height, width);
  truth.textured = cv::Mat1b::zeros(height, width);
  parallel_chunks(0, height, kRows, [&](int begin, int end) {
    std::vector<Eigen::Vector3d> directions(static_cast<size_t>(width)), points(directions.size());
    std::vector<Tracer::Point> hits(directions.size());
    std::vector<uint8_t> hidden(directions.size());
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; ++x) {
        directions[static_cast<size_t>(x)] =
            world_from_rect * Eigen::Vector3d((x - camera.cx) / camera.f, (y - camera.cy) / camera.f, 1);
      }
      tracer.trace(moment, left_centre, directions, hits);
      for (size_t x = 0; x < hits.size(); ++x) points[x] = left_centre + directions[x] * hits[x].along;
      tracer.hidden(moment, right_centre, points, hidden);
      for (int x = 0; x < width; ++x) {
        const Tracer::Point& hit = hits[static_cast<size_t>(x)];
        if (hit.object_idx < 0) continue;
        // The direction has length 1 along the optical axis: `along` is the depth.
        const double disparity = camera.f * camera.baseline / hit.along - camera.disparity_offset;
        truth.disparity(y, x) = static_cast<float>(disparity);
        truth.textured(y, x) = s.textured[static_cast<size_t>(hit.object_idx)] ? 255 : 0;
        const double right = x - disparity;
        const int before = static_cast<int>(std::floor(right)), after = static_cast<int>(std::ceil(right));
        const bool inside = before >= 0 && after < width && s.right_seen(y, before) != 0 && s.right_seen(y, after) != 0;
        // A thin object may show one side to the left and the other to the right camera.
        const Eigen::Vector3d& point = points[static_cast<size_t>(x)];
        const bool same_side = (hit.normal.dot(left_centre - point) > 0) == (hit.normal.dot(right_centre - point) > 0);
        truth.occluded(y, x) = inside && same_side && hidden[static_cast<size_t>(x)] == 0 ? 0 : 255;
      }
    }
  });

  // Jumps count before pixels are removed that the recorded camera does not see: there the surfaces go on.
  const auto jump = [&](int y, int x, int other_y, int other_x) {
    if (std::abs(truth.disparity(y, x) - truth.disparity(other_y, other_x)) <= kJump) return;
    truth.discontinuity(y, x) = truth.discontinuity(other_y, other_x) = 255;
  };
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      if (x + 1 < width) jump(y, x, y, x + 1);
      if (y + 1 < height) jump(y, x, y + 1, x);
    }
  }
  constexpr int kSide = 2 * kDiscontinuityReach + 1;
  cv::dilate(truth.discontinuity, truth.discontinuity, cv::Mat1b::ones(kSide, kSide));
  const cv::Mat1b outside = s.left_seen == 0;
  truth.disparity.setTo(0, outside);
  truth.occluded.setTo(0, outside);
  truth.discontinuity.setTo(0, outside);
  truth.textured.setTo(0, outside);
  return truth;
}

}  // namespace iris::simulate
