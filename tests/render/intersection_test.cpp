// Where rays meet the surface of a disparity image, against intersections with planes in three dimensions.
#include <gtest/gtest.h>

#include <limits>
#include <random>

#include "iris/render/dsnv.h"
#include "support/ray_scene.h"

namespace iris::render {
namespace {

using Eigen::Vector3d;
using testing::scene_camera;

// A rectangle of pixels whose disparities are those of one plane d = d0 + gx x + gy y.
struct Patch {
  int left, top, right, bottom;  // [px] bounds, all included
  double d0, gx, gy;
  double at(double x, double y) const { return d0 + gx * x + gy * y; }
};

// Background with a slope, three objects before it and one hole in it through which a farther plane is seen: steps of
// both signs, along rows and along columns, far above 2 px.
std::vector<Patch> patches(const RectifiedCamera& camera) {
  return {{0, 0, camera.width - 1, camera.height - 1, 12, 0.004, -0.006},
          {40, 50, 120, 180, 30, 0.01, 0.004},
          {180, 20, 300, 90, 22, -0.015, 0.01},
          {200, 150, 260, 220, 45, 0.02, -0.03},
          {140, 110, 190, 140, 6, 0, 0.002}};
}

StereoView view_of(const RectifiedCamera& camera, const std::vector<Patch>& all) {
  StereoView view;
  view.camera = camera;
  view.image = cv::Mat1b(camera.height, camera.width, uint8_t(100));
  view.disparity = {cv::Mat1f(camera.height, camera.width), cv::Mat1b(camera.height, camera.width, uint8_t(1))};
  for (const Patch& patch : all) {
    for (int y = patch.top; y <= patch.bottom; ++y) {
      for (int x = patch.left; x <= patch.right; ++x) {
        view.disparity.disparity(y, x) = static_cast<float>(patch.at(x, y));
      }
    }
  }
  return view;
}

struct Truth {
  double along = std::numeric_limits<double>::infinity();
  Vector3d image;  // x, y, disparity [px]
  bool front = false;
  bool doubtful = false;  // the ray meets a plane within two pixels of its border, where its samples are not connected
};

// The plane of a patch in space: d = f b / Z - offset with x = f X/Z + cx, y = f Y/Z + cy, times Z, is linear in X, Y,
// Z.
Truth intersect(const RectifiedCamera& camera, const std::vector<Patch>& all, const Vector3d& q, const Vector3d& t) {
  constexpr double kBorder = 2.01;  // [px] the gap itself, and the ray's next sample
  Truth first;
  double doubt = std::numeric_limits<double>::infinity();
  for (size_t k = 0; k < all.size(); ++k) {
    const Patch& patch = all[k];
    const Vector3d normal(camera.f * patch.gx, camera.f * patch.gy,
                          patch.at(camera.cx, camera.cy) + camera.disparity_offset);
    const double slope = normal.dot(q);
    if (std::abs(slope) < 1e-12) continue;
    const double s = (camera.f * camera.baseline - normal.dot(t)) / slope;
    const Vector3d point = s * q + t;
    if (s < 0 || point.z() <= 0) continue;
    const Vector3d image = camera.project(point);
    const auto inside = [&](const Patch& p, double margin) {
      return image.x() >= p.left - margin && image.x() <= p.right + margin && image.y() >= p.top - margin &&
             image.y() <= p.bottom + margin;
    };
    if (!inside(patch, kBorder)) continue;
    bool beside = !inside(patch, -kBorder), covered = false;
    for (size_t other = k + 1; other < all.size(); ++other) {  // patches lie upon those before them
      covered = covered || inside(all[other], -kBorder);
      beside = beside || (inside(all[other], kBorder) && !inside(all[other], -kBorder));
    }
    if (covered) continue;
    if (beside || s < 1e-3) {
      doubt = std::min(doubt, s);
    } else if (s < first.along) {
      first.along = s;
      first.image = image;
      // delta = d_ray - d_image falls along the ray where it goes from the front to the back of the plane.
      first.front = slope > 0;
    }
  }
  first.doubtful = doubt < first.along;
  return first;
}

TEST(Intersection, HundredThousandRaysMeetThePlanesThatGeometrySays) {
  constexpr int kRays = 100000;
  std::mt19937 random(11);
  std::uniform_real_distribution<double> unit(-1, 1);
  int fronts = 0, backs = 0, nothings = 0, doubtful = 0, wrong = 0, off = 0;
  double largest_shift = 0, largest_depth = 0;
  for (const double offset : {0.0, 4.5}) {
    RectifiedCamera camera = scene_camera();
    camera.disparity_offset = offset;
    const std::vector<Patch> all = patches(camera);
    const PreparedSource source(std::make_shared<const StereoView>(view_of(camera, all)), {});
    const double ft = camera.f * camera.baseline;
    for (int i = 0; i < kRays / 2; ++i) {
      // Every third ray starts anywhere between behind the camera and behind the scene and goes anywhere; the others
      // aim at a point of the scene, from the front or from behind.
      Vector3d t(2.5 * unit(random), 2 * unit(random), 3 + 6 * unit(random)),
          q(unit(random), unit(random), unit(random));
      if (i % 3 != 0) {
        const double z = ft / (16 + 14 * unit(random));
        const Vector3d target(0.6 * z * unit(random), 0.45 * z * unit(random), z);
        q = (target - t).normalized();
      }
      const Truth truth = intersect(camera, all, q, t);
      if (truth.doubtful) {
        ++doubtful;
        continue;
      }
      const RayHit hit = walk_ray(source, q, t, 0, 2);
      const Meeting expected = !std::isfinite(truth.along) ? Meeting::nothing
                               : truth.front               ? Meeting::surface
                                                           : Meeting::back_side;
      if (hit.meeting != expected) {
        ADD_FAILURE() << "ray from " << t.transpose() << " along " << q.transpose() << ", offset " << offset << ": at "
                      << truth.along << " (" << truth.image.transpose() << "), front " << truth.front << "; found "
                      << static_cast<int>(hit.meeting) << " at " << hit.along << " (" << hit.x << ' ' << hit.y << ' '
                      << hit.disparity << ")";
        ++wrong;
        continue;
      }
      ++(expected == Meeting::surface ? fronts : expected == Meeting::back_side ? backs : nothings);
      if (expected == Meeting::nothing) continue;
      const double shift = std::max(std::abs(hit.x - truth.image.x()), std::abs(hit.y - truth.image.y()));
      const double depth =
          std::abs(hit.along * q.z() + t.z() - (truth.along * q.z() + t.z())) / (truth.along * q.z() + t.z());
      off += shift > 0.5 || depth > 1e-3;
      largest_shift = std::max(largest_shift, shift);
      largest_depth = std::max(largest_depth, depth);
    }
  }
  std::cout << fronts << " fronts, " << backs << " back sides, " << nothings << " nothing, " << doubtful
            << " at borders, " << wrong << " wrong, " << off << " off; at most " << largest_shift << " px, depth "
            << largest_depth << "\n";
  EXPECT_GT(fronts, kRays / 6);
  EXPECT_GT(backs, kRays / 20);
  EXPECT_GT(nothings, kRays / 20);
  EXPECT_LT(doubtful, kRays / 5);
  EXPECT_EQ(wrong, 0);
  EXPECT_EQ(off, 0);
}

}  // namespace
}  // namespace iris::render
