#include "iris/render/dsnv.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>

#include "iris/core/parallel.h"
#include "support/ray_scene.h"

namespace iris::render {
namespace {

using Eigen::Vector3d;
using testing::coverage;
using testing::novel_of;
using testing::pose_at;
using testing::psnr;
using testing::room;
using testing::scene_camera;

std::shared_ptr<const StereoView> shared(StereoView view) {
  return std::make_shared<const StereoView>(std::move(view));
}

const auto kPinholeRay = [](const NovelCamera& camera) {
  return [camera](double x, double y) { return Vector3d((x - camera.cx) / camera.f, (y - camera.cy) / camera.f, 1); };
};

// A view whose disparities are those of one plane d = d0 + gx x + gy y.
StereoView plane_view(const RectifiedCamera& camera, double d0, double gx, double gy) {
  StereoView view;
  view.camera = camera;
  view.image = cv::Mat1b(camera.height, camera.width, uint8_t(100));
  view.disparity = {cv::Mat1f(camera.height, camera.width), cv::Mat1b(camera.height, camera.width, uint8_t(1))};
  for (int y = 0; y < camera.height; ++y) {
    for (int x = 0; x < camera.width; ++x) view.disparity.disparity(y, x) = static_cast<float>(d0 + gx * x + gy * y);
  }
  return view;
}

// The walk as the definition has it: fine steps along P(s), projected one by one. Independent of lines in disparity
// space. `spread` is the uncertainty of its answer.
double brute_force(const PreparedSource& source, const Vector3d& q, const Vector3d& t, double max_step) {
  const RectifiedCamera& camera = source.view().camera;
  const cv::Mat1f& disparity = source.disparity();
  double previous_delta = 0, previous_image = 0, previous_s = 0;
  // Equal steps in disparity are fine steps in the image: the depth runs evenly through 1/z.
  const double z_near = std::max(0.3, t.z()), z_far = 60;
  constexpr int kSteps = 20000;
  for (int i = 0; i <= kSteps; ++i) {
    const double s = (1 / (1 / z_near + (1 / z_far - 1 / z_near) * i / kSteps) - t.z()) / q.z();
    const Vector3d p = camera.project(s * q + t);
    double image = 0;
    if (p.x() >= 0 && p.y() >= 0 && p.x() < disparity.cols - 1 && p.y() < disparity.rows - 1) {
      const int x = static_cast<int>(p.x()), y = static_cast<int>(p.y());
      const double fx = p.x() - x, fy = p.y() - y;
      const double d00 = disparity(y, x), d01 = disparity(y, x + 1), d10 = disparity(y + 1, x),
                   d11 = disparity(y + 1, x + 1);
      const double low = std::min({d00, d01, d10, d11}), high = std::max({d00, d01, d10, d11});
      if (low > 0 && high - low <= max_step) {
        image = (1 - fx) * (1 - fy) * d00 + fx * (1 - fy) * d01 + (1 - fx) * fy * d10 + fx * fy * d11;
      }
    }
    const double delta = p.z() - image;
    if (previous_image > 0 && image > 0 && std::abs(previous_image - image) < 0.2) {
      if (previous_delta > 0 && delta <= 0) return 0.5 * (s + previous_s);
      if (previous_delta < 0 && delta > 0) return -1;  // a back side
    }
    previous_delta = delta, previous_image = image, previous_s = s;
  }
  return 0;
}

TEST(Walk, HitsLieOnTheRayAndOnTheSurface) {
  // (7.2) against the walk's point: both P(s) = s Q + T and the disparity plane must hold, for random poses, cameras
  // with an off-centre principal point, and a disparity offset.
  std::mt19937 random(3);
  std::uniform_real_distribution<double> unit(-1, 1);
  int surfaces = 0, backs = 0;
  for (int trial = 0; trial < 4000; ++trial) {
    RectifiedCamera camera = scene_camera();
    camera.disparity_offset = trial % 2 ? 5.5 : 0;
    const double gx = 0.02 * unit(random), gy = 0.02 * unit(random);
    const PreparedSource source(shared(plane_view(camera, 20 + 5 * unit(random), gx, gy)), {});
    const double d0 = source.disparity()(0, 0);
    const Vector3d q(unit(random), unit(random), unit(random)), t(unit(random), unit(random), 4 * unit(random));
    const RayHit hit = walk_ray(source, q, t, 0, 2);
    if (hit.meeting == Meeting::nothing) continue;
    ++(hit.meeting == Meeting::surface ? surfaces : backs);
    ASSERT_GE(hit.along, 0);
    const Vector3d on_ray = hit.along * q + t;
    const Vector3d image = camera.project(on_ray);
    // 24-bit floats through coordinates of a few hundred px: 1e-4 px is their rounding, with a factor for steep rays.
    EXPECT_NEAR(image.x(), hit.x, 2e-3);
    EXPECT_NEAR(image.y(), hit.y, 2e-3);
    EXPECT_NEAR(image.z(), d0 + gx * hit.x + gy * hit.y, 2e-3);
  }
  EXPECT_GT(surfaces, 200);
  EXPECT_GT(backs, 50);
}

TEST(Walk, RayThroughTheOpticalCentreIsAPoint) {
  // (7.6): from behind through the centre of the source, and from the centre itself.
  const RectifiedCamera camera = scene_camera();
  const PreparedSource source(shared(plane_view(camera, 20, 0, 0)), {});
  const double depth = camera.f * camera.baseline / 20;
  const Vector3d q(0.1, -0.05, 1);
  for (const double behind : {0.0, 1.0, 3.0}) {
    const RayHit hit = walk_ray(source, q, -behind * q, 0, 2);
    ASSERT_EQ(hit.meeting, Meeting::surface);
    EXPECT_NEAR(hit.along, depth + behind, 1e-5);
    EXPECT_NEAR(hit.x, camera.cx + 0.1 * camera.f, 1e-4);
    EXPECT_NEAR(hit.y, camera.cy - 0.05 * camera.f, 1e-4);
  }
  // From in front of the source back to its centre, standing behind the surface: the surface's back.
  EXPECT_EQ(walk_ray(source, -q, 2 * depth * q, 0, 2).meeting, Meeting::back_side);
  // Standing before the surface and looking away from it: nothing.
  EXPECT_EQ(walk_ray(source, -q, 0.5 * depth * q, 0, 2).meeting, Meeting::nothing);
}

TEST(Walk, EpipoleInFrontAndBehind) {
  // The walk begins at the epipole if the novel camera is in front of the source (Tz > 0) and is not bounded by it
  // else.
  const RectifiedCamera camera = scene_camera();
  const PreparedSource source(shared(plane_view(camera, 20, 0, 0)), {});
  const double depth = camera.f * camera.baseline / 20;
  for (const double z : {-2.0, -0.3, 0.0, 0.4, 1.5}) {
    const Vector3d t(0.15, -0.1, z), q(-0.05, 0.08, 1);
    const RayHit hit = walk_ray(source, q, t, 0, 2);
    ASSERT_EQ(hit.meeting, Meeting::surface) << z;
    EXPECT_NEAR(hit.along, depth - z, 1e-4);
    EXPECT_NEAR(hit.x, camera.f * (hit.along * q.x() + t.x()) / depth + camera.cx, 1e-3);
  }
  EXPECT_EQ(walk_ray(source, Vector3d(0, 0.1, 1), Vector3d(0.1, 0, depth + 0.5), 0, 2).meeting, Meeting::nothing);
}

TEST(Walk, StepsBetweenObjectsAreNoSurface) {
  // Two planes, 30 and 10 px, with a border at x = 160: a ray that passes behind the near one must not stop in the gap.
  RectifiedCamera camera = scene_camera();
  StereoView view = plane_view(camera, 10, 0, 0);
  view.disparity.disparity.colRange(0, 160) = 30.0f;
  const PreparedSource source(shared(view), {});
  const double near = camera.f * camera.baseline / 30, far = camera.f * camera.baseline / 10;
  const double border = (160 - camera.cx) / camera.f;  // x/z of the border
  // Starts left of the near plane's shadow line, behind the near plane, and goes right: crosses the border half-way.
  const double z = 0.5 * (near + far);
  const Vector3d t((border - 0.1) * near, 0, near * 1.1), target((border + 0.1) * far, 0, far);
  const RayHit hit = walk_ray(source, target - t, t, 0, 2);
  ASSERT_EQ(hit.meeting, Meeting::surface);
  EXPECT_NEAR(hit.disparity, 10, 1e-3);
  EXPECT_LT(z, far);
}

TEST(Walk, AgreesWithBruteForce) {
  const RectifiedCamera camera = scene_camera();
  const PreparedSource source(shared(room().view(camera, Pose::Identity())), {});
  std::mt19937 random(5);
  std::uniform_real_distribution<double> unit(-1, 1);
  int both = 0, differ = 0, only_one = 0;
  for (int trial = 0; trial < 600; ++trial) {
    const Vector3d q(0.5 * unit(random), 0.4 * unit(random), 1);
    const Vector3d t(0.8 * unit(random), 0.5 * unit(random), unit(random));
    const double truth = brute_force(source, q, t, 2);
    const RayHit hit = walk_ray(source, q, t, 0, 2);
    const double found = hit.meeting == Meeting::surface ? hit.along : hit.meeting == Meeting::back_side ? -1 : 0;
    if ((truth > 0) != (found > 0)) {
      ++only_one;
    } else if (truth > 0) {
      ++both;
      // The surface between pixels is bilinear for one and along the ray's crossings with rows or columns linear for
      // the other: a curved surface differs by far less than 1 %.
      if (std::abs(found - truth) > 0.01 * truth) ++differ;
    }
  }
  EXPECT_GT(both, 400);
  // At borders of objects the two interpolate over different neighbours: single rays decide otherwise.
  EXPECT_LE(differ, both / 50);
  EXPECT_LE(only_one, 12);
}

TEST(PreparedSource, UsesOnlyAcceptedOrigins) {
  StereoView view = plane_view(scene_camera(), 20, 0, 0);
  view.disparity.origin(5, 6) = static_cast<uint8_t>(DisparityOrigin::within_segment);
  view.disparity.origin(5, 7) = static_cast<uint8_t>(DisparityOrigin::between_segments);
  const auto stored = shared(view);
  EXPECT_EQ(PreparedSource(stored, {.use_origin = "measured"}).disparity()(5, 6), 0);
  EXPECT_EQ(PreparedSource(stored, {.use_origin = "within"}).disparity()(5, 6), 20);
  EXPECT_EQ(PreparedSource(stored, {.use_origin = "within"}).disparity()(5, 7), 0);
  EXPECT_EQ(PreparedSource(stored, {.use_origin = "everywhere"}).disparity()(5, 7), 20);
}

TEST(PreparedSource, BoundsHoldEveryDisparityAndAreNotLoose) {
  const PreparedSource source(shared(room().view(scene_camera(), Pose::Identity())), {});
  std::mt19937 random(1);
  for (int trial = 0; trial < 300; ++trial) {
    int x0 = static_cast<int>(random() % 320), x1 = static_cast<int>(random() % 320);
    int y0 = static_cast<int>(random() % 240), y1 = static_cast<int>(random() % 240);
    if (x0 > x1) std::swap(x0, x1);
    if (y0 > y1) std::swap(y0, y1);
    double exact = 0, whole = 0;
    cv::minMaxLoc(source.disparity()(cv::Range(y0, y1 + 1), cv::Range(x0, x1 + 1)), nullptr, &exact);
    cv::minMaxLoc(source.disparity(), nullptr, &whole);
    const float bound = source.max_in(x0, y0, x1, y1);
    EXPECT_GE(bound, exact);
    EXPECT_LE(bound, whole);
  }
  EXPECT_NEAR(source.max_in(100, 100, 100, 100), source.disparity()(100, 100), 0.5);
}

TEST(NovelView, WithoutMotionTheSourceComesBack) {
  const RectifiedCamera camera = scene_camera();
  const StereoView view = room().view(camera, pose_at({0.3, -0.2, 0.1}, {0.1, 0.2, -0.05}));
  for (const char* fusion : {"agreement", "nearest"}) {
    const NovelView shown =
        render_novel_view(novel_of(camera, view.world_from_cam), {shared(view)}, {.fusion = fusion});
    EXPECT_EQ(coverage(shown), 1);
    int different = 0;
    double largest = 0;
    for (int y = 0; y < camera.height; ++y) {
      for (int x = 0; x < camera.width; ++x) {
        different += shown.image(y, x) != view.image.at<cv::Vec3b>(y, x);
        const double depth = camera.f * camera.baseline / view.disparity.disparity(y, x);
        largest = std::max(largest, std::abs(shown.depth(y, x) - depth) / depth);
      }
    }
    EXPECT_EQ(different, 0) << fusion;
    // A ray that its neighbours settle may be 0.1 px of disparity off, 1 % of the 10 px of the far wall.
    EXPECT_LT(largest, 0.01) << fusion;
  }
}

struct Novel {
  const char* name;
  Pose pose;
};

class NovelPoses : public ::testing::TestWithParam<Novel> {};

TEST_P(NovelPoses, PictureAndDepthMatchTheRayCastTruth) {
  const RectifiedCamera camera = scene_camera();
  std::vector<std::shared_ptr<const StereoView>> sources;
  for (const double x : {-0.5, -0.15, 0.2, 0.5}) {
    sources.push_back(shared(room().view(camera, pose_at({x, 0.1 * x, 0.2 * x}, {0.05 * x, 0.1 * x, 0}))));
  }
  const NovelCamera novel = novel_of(camera, GetParam().pose);
  const NovelView truth = room().truth(novel, kPinholeRay(novel));
  const NovelView shown = render_novel_view(novel, sources, {});
  int wrong = 0, seen = 0;
  std::vector<double> errors;
  for (int y = 0; y < novel.height; ++y) {
    for (int x = 0; x < novel.width; ++x) {
      if (shown.source(y, x) < 0) continue;
      ++seen;
      const double error = std::abs(shown.depth(y, x) - truth.depth(y, x)) / truth.depth(y, x);
      wrong += error > 0.02;
      errors.push_back(error);
    }
  }
  std::nth_element(errors.begin(), errors.begin() + static_cast<ptrdiff_t>(errors.size() / 2), errors.end());
  RecordProperty("psnr", std::to_string(psnr(shown, truth)));
  std::cout << GetParam().name << ": coverage " << coverage(shown) << ", PSNR " << psnr(shown, truth)
            << " dB, median depth error " << errors[errors.size() / 2] << ", wrong " << double(wrong) / seen << "\n";
  // Bilinear colours of a texture sampled at 2 to 6 px per period lose a few grey levels; the rest are object borders.
  EXPECT_GT(psnr(shown, truth), 27);
  EXPECT_LT(errors[errors.size() / 2], 1e-3);
  EXPECT_LT(double(wrong) / seen, 0.02);
  EXPECT_GT(coverage(shown), 0.7);
}

INSTANTIATE_TEST_SUITE_P(Poses, NovelPoses,
                         ::testing::Values(Novel{"between", pose_at({0, 0, 0})},
                                           Novel{"behind_and_above", pose_at({0, -0.4, -1.2}, {-0.1, 0, 0})},
                                           Novel{"in_front", pose_at({0.1, 0.1, 0.8}, {0, 0.05, 0})},
                                           Novel{"turned", pose_at({-0.2, 0.2, -0.3}, {0.1, -0.2, 0.3})},
                                           Novel{"sideways", pose_at({0.9, -0.2, 0.2}, {0, -0.25, 0})}),
                         [](const auto& info) { return info.param.name; });

TEST(NovelView, SkippingSpaceAndSettlingByNeighboursKeepTheWalksResult) {
  const RectifiedCamera camera = scene_camera();
  const auto view = shared(room().view(camera, Pose::Identity()));
  const PreparedSource source(view, {});
  for (const Pose& pose : {pose_at({0.3, -0.5, -1}, {-0.1, 0.1, 0.2}), pose_at({0.2, 0.1, 1}, {0.1, 0.4, 0}),
                           pose_at({0.1, 0, 4}, {0, 3.0, 0}), pose_at({-1, 0.3, 0}, {0, 0.9, 0.4})}) {
    const NovelCamera novel = novel_of(camera, pose);
    const NovelView shown = render_novel_view(novel, {view}, {.fill_holes = 0});
    int different = 0, grossly = 0;
    for (int y = 0; y < novel.height; ++y) {
      for (int x = 0; x < novel.width; ++x) {
        const RayHit hit = walk_ray(source, pose.linear() * pixel_ray(novel, x, y), pose.translation(), 0, 2);
        const float depth = hit.meeting == Meeting::surface && hit.along > 0 ? hit.along : 0;
        different += std::abs(depth - shown.depth(y, x)) > 1e-4 * depth;
        grossly += std::abs(depth - shown.depth(y, x)) > 0.02 * depth;
      }
    }
    // Measured: up to 1.4 % of the pixels along the edges where walls meet (0.1 px of disparity), and single rays that
    // graze the border of an object, since a walk begun elsewhere passes other sub-pixel positions.
    EXPECT_LE(different, 320 * 240 / 50);
    EXPECT_LE(grossly, 320 * 240 / 500);
  }
}

TEST(NovelView, SourceIndexDepthAndHolesGoTogether) {
  const RectifiedCamera camera = scene_camera();
  const std::vector<std::shared_ptr<const StereoView>> sources = {shared(room().view(camera, Pose::Identity())),
                                                                  shared(room().view(camera, pose_at({0.6, 0, 0})))};
  const NovelView shown = render_novel_view(novel_of(camera, pose_at({0.3, 0, -0.5})), sources, {});
  for (int y = 0; y < camera.height; ++y) {
    for (int x = 0; x < camera.width; ++x) {
      ASSERT_GE(shown.source(y, x), -1);
      ASSERT_LT(shown.source(y, x), 2);
      ASSERT_EQ(shown.source(y, x) < 0, shown.depth(y, x) == 0);
    }
  }
  const NovelView nothing =
      render_novel_view(novel_of(camera, Pose::Identity()), std::vector<std::shared_ptr<const StereoView>>{}, {});
  EXPECT_EQ(coverage(nothing), 0);
}

TEST(NovelView, AgreementOverrulesAWrongNearSurface) {
  // One of three sources holds a wrong patch in the air: (7.10) shows it, agreement does not.
  const RectifiedCamera camera = scene_camera();
  std::vector<StereoView> views;
  for (const double x : {-0.2, 0.0, 0.2}) views.push_back(room().view(camera, pose_at({x, 0, 0})));
  views[1].disparity.disparity(cv::Rect(200, 30, 40, 30)) = 40.0f;
  std::vector<std::shared_ptr<const StereoView>> sources;
  for (const StereoView& view : views) sources.push_back(shared(view));
  const NovelCamera novel = novel_of(camera, pose_at({0.02, 0.02, 0}));
  const NovelView truth = room().truth(novel, kPinholeRay(novel));
  const NovelView agreed = render_novel_view(novel, sources, {.fusion = "agreement"});
  const NovelView nearest = render_novel_view(novel, sources, {.fusion = "nearest"});
  EXPECT_NEAR(agreed.depth(45, 218), truth.depth(45, 218), 0.02 * truth.depth(45, 218));
  EXPECT_NEAR(nearest.depth(45, 218), camera.f * camera.baseline / 40, 0.02);
  EXPECT_GT(psnr(agreed, truth), psnr(nearest, truth));
}

TEST(NovelView, BackSidesAreBlackWhereNothingElseIsSeen) {
  const RectifiedCamera camera = scene_camera();
  const auto view = shared(plane_view(camera, 20, 0, 0));
  const double depth = camera.f * camera.baseline / 20;
  const NovelCamera novel = novel_of(camera, pose_at({0, 0, 2 * depth}, {0, M_PI, 0}));
  for (const char* fusion : {"agreement", "nearest"}) {
    const NovelView shown = render_novel_view(novel, {view}, {.fusion = fusion});
    EXPECT_EQ(shown.source(120, 160), -1);
    EXPECT_EQ(shown.image(120, 160), cv::Vec3b(0, 0, 0));
  }
}

TEST(NovelView, ThreadsDoNotMatter) {
  const RectifiedCamera camera = scene_camera();
  std::vector<std::shared_ptr<const StereoView>> sources;
  for (const double x : {-0.3, 0.1, 0.4}) sources.push_back(shared(room().view(camera, pose_at({x, 0, 0}))));
  const NovelCamera novel = novel_of(camera, pose_at({0.1, -0.3, -0.8}, {-0.1, 0.05, 0}));
  NovelView one, two;
  with_threads(1, [&] { one = render_novel_view(novel, sources, {}); });
  with_threads(2, [&] { two = render_novel_view(novel, sources, {}); });
  EXPECT_EQ(std::memcmp(one.image.data, two.image.data, one.image.total() * 3), 0);
  EXPECT_EQ(std::memcmp(one.depth.data, two.depth.data, one.depth.total() * 4), 0);
  EXPECT_EQ(std::memcmp(one.source.data, two.source.data, one.source.total() * 2), 0);
}

class Steps : public ::testing::TestWithParam<int> {};

TEST_P(Steps, CoarseTracingStaysCloseToTheFullPicture) {
  const RectifiedCamera camera = scene_camera();
  const auto view = shared(room().view(camera, Pose::Identity()));
  const NovelCamera novel = novel_of(camera, pose_at({0.1, -0.1, -0.4}));
  const NovelView truth = room().truth(novel, kPinholeRay(novel));
  const NovelView full = render_novel_view(novel, {view}, {});
  const NovelView coarse = render_novel_view(novel, {view}, {.step = GetParam()});
  ASSERT_EQ(coarse.image.size(), full.image.size());
  EXPECT_NEAR(coverage(coarse), coverage(full), 0.02);
  // Interpolated depths of planes: linear interpolation of depth over n px errs by (n g)^2 z with the gradient g of
  // 1/z.
  std::vector<double> errors;
  for (int y = 0; y < novel.height; ++y) {
    for (int x = 0; x < novel.width; ++x) {
      if (coarse.source(y, x) >= 0) errors.push_back(std::abs(coarse.depth(y, x) / truth.depth(y, x) - 1));
    }
  }
  std::nth_element(errors.begin(), errors.begin() + static_cast<ptrdiff_t>(errors.size() * 9 / 10), errors.end());
  EXPECT_LT(errors[errors.size() * 9 / 10], 0.005);
}

INSTANTIATE_TEST_SUITE_P(EveryNth, Steps, ::testing::Values(2, 4));

TEST(NovelView, EquirectangularPanoramaMatchesTheTruth) {
  // Four views around the vertical axis.
  RectifiedCamera camera = scene_camera();
  camera.f = 150;  // 94 degrees
  std::vector<std::shared_ptr<const StereoView>> sources;
  for (int i = 0; i < 4; ++i)
    sources.push_back(shared(room().view(camera, pose_at({0, 0, 0.5}, {0, i * M_PI / 2 + 1e-9, 0}))));
  const NovelCamera novel{.projection = Projection::equirectangular,
                          .width = 400,
                          .height = 200,
                          .world_from_cam = pose_at({0.1, 0.05, 0.4})};
  const NovelView shown = render_novel_view(novel, sources, {});
  // Independent of pixel_ray: longitude and latitude of the pixel centres.
  const NovelView truth = room().truth(novel, [](double x, double y) {
    const double longitude = (x + 0.5 - 200) * M_PI / 200, latitude = (y + 0.5 - 100) * M_PI / 200;
    return Vector3d(std::sin(longitude) * std::cos(latitude), std::sin(latitude),
                    std::cos(longitude) * std::cos(latitude));
  });
  EXPECT_GT(coverage(shown), 0.28);  // four times 94 x 77 degrees of the sphere, less in the corners
  EXPECT_GT(psnr(shown, truth), 22);
  std::vector<double> errors;
  for (int y = 0; y < novel.height; ++y) {
    for (int x = 0; x < novel.width; ++x) {
      if (shown.source(y, x) >= 0) errors.push_back(std::abs(shown.depth(y, x) / truth.depth(y, x) - 1));
    }
  }
  std::nth_element(errors.begin(), errors.begin() + static_cast<ptrdiff_t>(errors.size() / 2), errors.end());
  EXPECT_LT(errors[errors.size() / 2], 2e-3);
}

TEST(NovelView, PanoramasAreRightAtThePolesAndWhereTheirEndsMeet) {
  // Six views to all sides, so that nothing is missing.
  RectifiedCamera camera = scene_camera();
  camera.f = 110;
  std::vector<std::shared_ptr<const StereoView>> sources;
  for (int i = 0; i < 4; ++i) {
    sources.push_back(shared(room().view(camera, pose_at({0, 0, 0.5}, {0, i * M_PI / 2 + 1e-9, 0}))));
  }
  for (const double turn : {M_PI / 2, -M_PI / 2}) {
    sources.push_back(shared(room().view(camera, pose_at({0, 0, 0.5}, {turn, 0, 0}))));
  }
  const NovelCamera novel{.projection = Projection::equirectangular,
                          .width = 400,
                          .height = 200,
                          .world_from_cam = pose_at({0.1, 0.05, 0.4}, {0, 1.2, 0})};
  const NovelView shown = render_novel_view(novel, sources, {.max_sources = 6});
  const NovelView truth = room().truth(novel, [](double x, double y) {
    const double longitude = (x + 0.5 - 200) * M_PI / 200, latitude = (y + 0.5 - 100) * M_PI / 200;
    return Vector3d(std::sin(longitude) * std::cos(latitude), std::sin(latitude),
                    std::cos(longitude) * std::cos(latitude));
  });
  EXPECT_GT(coverage(shown), 0.88);  // the room is open at its back
  const auto check = [&](const char* part, const cv::Rect& area, double least) {
    const NovelView of_shown{.image = shown.image(area), .depth = shown.depth(area), .source = shown.source(area)};
    const NovelView of_truth{.image = truth.image(area), .depth = truth.depth(area), .source = truth.source(area)};
    EXPECT_GT(coverage(of_shown), 0.95) << part;
    EXPECT_GT(psnr(of_shown, of_truth), least) << part;
    std::vector<double> errors;
    for (int y = 0; y < area.height; ++y) {
      for (int x = 0; x < area.width; ++x) {
        if (of_shown.source(y, x) >= 0) errors.push_back(std::abs(of_shown.depth(y, x) / of_truth.depth(y, x) - 1));
      }
    }
    std::nth_element(errors.begin(), errors.begin() + static_cast<ptrdiff_t>(errors.size() * 9 / 10), errors.end());
    EXPECT_LT(errors[errors.size() * 9 / 10], 5e-3) << part;
  };
  check("upper pole", {0, 0, 400, 12}, 24);
  check("lower pole", {0, 188, 400, 12}, 24);
  check("left end", {0, 60, 12, 80}, 22);
  check("right end", {388, 60, 12, 80}, 22);
}

TEST(NovelView, HolesBetweenObjectAndBackgroundGetTheBackground) {
  // A near board of 30 px before a far wall of 10 px, grey values 200 and 50, with a gap of 4 px between them.
  const RectifiedCamera camera = scene_camera();
  StereoView view = plane_view(camera, 10, 0, 0);
  view.image.setTo(50);
  view.image.colRange(100, 160).setTo(200);
  view.disparity.disparity.colRange(100, 160) = 30.0f;
  view.disparity.disparity(cv::Rect(160, 80, 4, 60)) = 0.0f;
  const NovelView shown = render_novel_view(novel_of(camera, Pose::Identity()), {shared(view)}, {});
  for (int x = 160; x < 164; ++x) {
    EXPECT_EQ(shown.image(110, x), cv::Vec3b(50, 50, 50)) << x;
    EXPECT_EQ(shown.source(110, x), -1);
  }
}

TEST(NovelView, SmallHolesAreFilledButStayMarked) {
  const RectifiedCamera camera = scene_camera();
  StereoView view = plane_view(camera, 20, 0, 0);
  view.disparity.disparity(cv::Rect(100, 100, 4, 4)) = 0.0f;
  view.disparity.disparity(cv::Rect(200, 100, 40, 40)) = 0.0f;
  const NovelView shown = render_novel_view(novel_of(camera, Pose::Identity()), {shared(view)}, {.fill_holes = 6});
  EXPECT_EQ(shown.image(102, 102), cv::Vec3b(100, 100, 100));
  EXPECT_EQ(shown.source(102, 102), -1);
  EXPECT_EQ(shown.depth(102, 102), 0);
  EXPECT_EQ(shown.image(120, 220), cv::Vec3b(0, 0, 0));
  const NovelView bare = render_novel_view(novel_of(camera, Pose::Identity()), {shared(view)}, {.fill_holes = 0});
  EXPECT_EQ(bare.image(102, 102), cv::Vec3b(0, 0, 0));
}

TEST(NovelView, ASourceWithoutDisparitiesIsHarmless) {
  const RectifiedCamera camera = scene_camera();
  StereoView empty = plane_view(camera, 0, 0, 0);
  const auto view = shared(room().view(camera, Pose::Identity()));
  const NovelView shown = render_novel_view(novel_of(camera, pose_at({0.1, 0, 0})), {shared(empty), view}, {});
  EXPECT_GT(coverage(shown), 0.9);
  for (const int16_t source : shown.source) EXPECT_NE(source, 0);
}

}  // namespace
}  // namespace iris::render
