#include "iris/simulate/scene.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <functional>
#include <map>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <set>

#include "iris/core/error.h"
#include "iris/core/parallel.h"
#include "src/simulate/furniture.h"
#include "src/simulate/mesh_builder.h"
#include "src/simulate/scenes.h"

namespace iris::simulate {
namespace {

using ::testing::HasSubstr;

const Scene& scene_of(const std::string& name) {
  static std::map<std::string, Scene> scenes;
  const auto found = scenes.find(name);
  return found != scenes.end() ? found->second : scenes.emplace(name, make_scene(name, 1)).first->second;
}

Eigen::Vector3d corner(const TriangleMesh& mesh, const Eigen::Vector3i& triangle, int i) {
  return mesh.vertices[static_cast<size_t>(triangle[i])].cast<double>();
}

size_t triangle_count(const Scene& scene) {
  size_t count = 0;
  for (const SceneObject& object : scene.objects) count += object.mesh.triangles.size();
  return count;
}

// Shortest distance of `point` to what stands still.
double clearance(const Scene& scene, const Eigen::Vector3d& point) {
  double least = 1e9;
  for (const SceneObject& object : scene.objects) {
    if (object.world_from_object) continue;
    for (const Eigen::Vector3i& t : object.mesh.triangles) {
      const Eigen::Vector3d a = corner(object.mesh, t, 0);
      // The triangle's edges are at most 20 m long: those far away need no closer look.
      const double reach =
          std::max((corner(object.mesh, t, 1) - a).squaredNorm(), (corner(object.mesh, t, 2) - a).squaredNorm());
      if ((a - point).norm() - std::sqrt(reach) > std::sqrt(least)) continue;
      least = std::min(least, squared_distance(point, a, corner(object.mesh, t, 1), corner(object.mesh, t, 2)));
    }
  }
  return std::sqrt(least);
}

class EveryScene : public ::testing::TestWithParam<std::string> {};
INSTANTIATE_TEST_SUITE_P(Scenes, EveryScene, ::testing::ValuesIn(scene_names()), [](const auto& info) {
  std::string name = info.param;
  for (char& c : name) c = std::isalnum(static_cast<unsigned char>(c)) ? c : '_';
  return name;
});

TEST_P(EveryScene, IsMadeOfSoundMeshes) {
  const Scene& scene = scene_of(GetParam());
  EXPECT_EQ(scene.name, GetParam());
  EXPECT_GT(triangle_count(scene), 100u);
  EXPECT_LT(triangle_count(scene), 250'000u);
  std::set<std::string> names;
  std::set<const void*> images;
  double bytes = 0;
  for (const SceneObject& object : scene.objects) {
    const TriangleMesh& mesh = object.mesh;
    SCOPED_TRACE(mesh.name);
    EXPECT_TRUE(names.insert(mesh.name).second);
    EXPECT_EQ(object.textured, !mesh.texture.empty());
    EXPECT_EQ(mesh.texture_coordinates.size(), mesh.texture.empty() ? 0 : mesh.vertices.size());
    if (!mesh.texture.empty() && images.insert(mesh.texture.data).second)
      bytes += 3.0 * static_cast<double>(mesh.texture.total());
    std::set<int> used;
    for (const Eigen::Vector3i& t : mesh.triangles) {
      for (int i = 0; i < 3; ++i) {
        ASSERT_GE(t[i], 0);
        ASSERT_LT(t[i], static_cast<int>(mesh.vertices.size()));
        used.insert(t[i]);
      }
      const Eigen::Vector3d a = corner(mesh, t, 0), b = corner(mesh, t, 1), c = corner(mesh, t, 2);
      EXPECT_GT((b - a).cross(c - a).norm(), 1e-8) << "no area";
      if (mesh.texture.empty()) continue;
      // Texels are squares of one size (in metres) in the plane of a face: at most 8 mm, and 0.2 mm at least.
      const auto texel = [&](int i) {
        const Eigen::Vector2f& uv = mesh.texture_coordinates[static_cast<size_t>(t[i])];
        return Eigen::Vector2d(uv.x() * mesh.texture.cols, uv.y() * mesh.texture.rows);
      };
      const Eigen::Vector2d p = texel(1) - texel(0), q = texel(2) - texel(0);
      const double area = (b - a).cross(c - a).norm(), texels = std::abs(p.x() * q.y() - p.y() * q.x());
      if (area > 1e-3) {
        EXPECT_LT(std::sqrt(area / texels), 0.008);
        EXPECT_GT(std::sqrt(area / texels), 0.0002);
      }
    }
    EXPECT_EQ(used.size(), mesh.vertices.size());
  }
  EXPECT_LT(bytes, 320e6);  // each wall, floor and ceiling has a texture of its own: 480 kB a square metre
}

TEST_P(EveryScene, TexturedSurfacesHaveContrastAndOthersHaveNone) {
  // Windows into the distance, the sheet and labels are pictures too: every image varies.
  for (const SceneObject& object : scene_of(GetParam()).objects) {
    if (!object.textured) continue;
    cv::Mat grey;
    cv::cvtColor(object.mesh.texture, grey, cv::COLOR_BGR2GRAY);
    cv::GaussianBlur(grey, grey, {}, 1);
    cv::Scalar mean, deviation;
    cv::meanStdDev(grey, mean, deviation);
    EXPECT_GT(deviation[0], 4) << object.mesh.name;
  }
}

TEST_P(EveryScene, SameBytesForTheSameSeedAndOthersForAnother) {
  const Scene& scene = scene_of(GetParam());
  Scene again;
  with_threads(3, [&] { again = make_scene(GetParam(), 1); });
  ASSERT_EQ(again.objects.size(), scene.objects.size());
  for (size_t i = 0; i < scene.objects.size(); ++i) {
    const TriangleMesh &a = scene.objects[i].mesh, &b = again.objects[i].mesh;
    EXPECT_EQ(a.name, b.name);
    EXPECT_EQ(a.vertices, b.vertices);
    EXPECT_EQ(a.triangles, b.triangles);
    EXPECT_EQ(a.texture_coordinates, b.texture_coordinates);
    ASSERT_EQ(a.texture.size(), b.texture.size());
    EXPECT_TRUE(a.texture.empty() || cv::norm(a.texture, b.texture, cv::NORM_INF) == 0);
  }
  const Scene other = make_scene(GetParam(), 2);
  bool differs = other.objects.size() != scene.objects.size();
  for (size_t i = 0; !differs && i < scene.objects.size(); ++i) {
    const cv::Mat3b &a = scene.objects[i].mesh.texture, &b = other.objects[i].mesh.texture;
    differs = a.size() != b.size() || (!a.empty() && cv::norm(a, b, cv::NORM_INF) > 0);
  }
  EXPECT_TRUE(differs);
}

// Two faces in one place would flicker. Compared by their corners; only what could be seen counts.
TEST_P(EveryScene, NoTriangleTwice) {
  std::set<std::array<float, 9>> seen;
  for (const SceneObject& object : scene_of(GetParam()).objects) {
    if (object.world_from_object) continue;
    for (const Eigen::Vector3i& t : object.mesh.triangles) {
      std::array<std::array<float, 3>, 3> points;
      for (int i = 0; i < 3; ++i) {
        const Eigen::Vector3f& v = object.mesh.vertices[static_cast<size_t>(t[i])];
        points[static_cast<size_t>(i)] = {v.x(), v.y(), v.z()};
      }
      std::sort(points.begin(), points.end());
      std::array<float, 9> key;
      for (size_t i = 0; i < 9; ++i) key[i] = points[i / 3][i % 3];
      EXPECT_TRUE(seen.insert(key).second) << object.mesh.name;
    }
  }
}

// Where two surfaces lie in one place, rounding would decide which is seen; where there is none, the sky shows through.
// Random rays from the paths, traced by brute force.
TEST_P(EveryScene, RaysMeetOneSurfaceAtATimeAndNoHole) {
  const Scene& scene = scene_of(GetParam());
  struct Triangle {
    Eigen::Vector3f a, ab, ac;
  };
  std::vector<Triangle> triangles;
  std::vector<const SceneObject*> owners;
  for (const SceneObject& object : scene.objects) {
    for (const Eigen::Vector3i& t : object.mesh.triangles) {
      Eigen::Vector3f corners[3];
      for (int i = 0; i < 3; ++i) {
        const Eigen::Vector3d v = corner(object.mesh, t, i);
        corners[i] = (object.world_from_object ? object.world_from_object(0) * v : v).cast<float>();
      }
      triangles.push_back({corners[0], corners[1] - corners[0], corners[2] - corners[0]});
      owners.push_back(&object);
    }
  }
  const int rays = static_cast<int>(std::min<size_t>(4000, 60'000'000 / triangles.size()));
  const SimulatedPath path = make_path(scene, {});
  Random random(5);
  int holes = 0, doubles = 0;
  std::set<std::string> where;
  for (int k = 0; k < rays; ++k) {
    const Pose pose = path.world_from_cam(path.seconds * k / rays);
    const Eigen::Vector3d sight =
        pose.linear() * Eigen::Vector3d(random.uniform(-0.84, 0.84), random.uniform(-0.54, 0.54), 1);
    const Eigen::Vector3f from = pose.translation().cast<float>(), to = sight.cast<float>().normalized();
    float first = 1e9f, second = 1e9f;
    size_t first_owner = 0, second_owner = 0;
    for (size_t i = 0; i < triangles.size(); ++i) {
      // Moeller and Trumbore.
      const Triangle& t = triangles[i];
      const Eigen::Vector3f p = to.cross(t.ac);
      const float det = t.ab.dot(p);
      if (std::abs(det) < 1e-12f) continue;
      const Eigen::Vector3f s = from - t.a;
      const float u = s.dot(p) / det;
      if (u <= 0 || u >= 1) continue;
      const Eigen::Vector3f q = s.cross(t.ab);
      const float v = to.dot(q) / det;
      if (v <= 0 || u + v >= 1) continue;
      const float along = t.ac.dot(q) / det;
      if (along <= 0) continue;
      if (along < first) {
        second = first, second_owner = first_owner;
        first = along, first_owner = i;
      } else if (along < second) {
        second = along, second_owner = i;
      }
    }
    holes += first > 1e8f;
    // Two bodies meet at a line; a few rays come near one.
    if (second - first < 1e-4f && owners[first_owner]->mesh.name != owners[second_owner]->mesh.name) {
      ++doubles;
      where.insert(owners[first_owner]->mesh.name + " and " + owners[second_owner]->mesh.name);
    }
  }
  EXPECT_LE(doubles, rays / 500) << ::testing::PrintToString(where);
  if (GetParam() != "yard") {
    EXPECT_EQ(holes, 0);
  }
}

TEST_P(EveryScene, PathsKeepClearOfEverything) {
  const Scene& scene = scene_of(GetParam());
  for (const std::string& name : scene.places.paths) {
    SimulateOptions options;
    options.path = name;
    options.jitter = 0;
    const SimulatedPath path = make_path(scene, options);
    const int steps = name == "static" ? 1 : 120;
    double least = 1e9;
    double where = 0;
    for (int i = 0; i < steps; ++i) {
      const double t = path.seconds * i / steps;
      const double distance = clearance(scene, path.world_from_cam(t).translation());
      if (distance < least) least = distance, where = t;
    }
    const Eigen::Vector3d place = path.world_from_cam(where).translation();
    EXPECT_GT(least, 0.25) << name << " at " << where << " s: " << place.transpose();
  }
}

TEST(Scenes, AnUnknownNameIsAnErrorThatListsThem) {
  try {
    make_scene("castle", 1);
    FAIL();
  } catch (const UsageError& error) {
    EXPECT_THAT(error.what(), HasSubstr("castle"));
    for (const std::string& name : scene_names()) EXPECT_THAT(error.what(), HasSubstr(name));
  }
}

TEST(Scenes, TheApartmentHasRoomsWithOpenDoorsAndBareWalls) {
  const Scene& scene = scene_of("apartment");
  // Nothing crosses the middle of a doorway, from the floor up to 2 m and 0.86 m wide: (x, y) of the middle, wall along
  // x?
  struct Door {
    double x, y;
    bool along_x;
  };
  for (const Door& door : {Door{3.05, 3.85, true},
                           {6.45, 3.85, true},
                           {9.05, 3.85, true},
                           {1.95, 5.35, true},
                           {5.75, 5.35, true},
                           {9.25, 5.35, true},
                           {5.05, 2.8, false}}) {
    for (double z = 0.05; z < 2; z += 0.05) {
      for (double s = -0.43; s <= 0.43; s += 0.02) {
        const Eigen::Vector3d point(door.x + (door.along_x ? s : 0), door.y + (door.along_x ? 0 : s), z);
        ASSERT_GT(clearance(scene, point), 0.015) << point.transpose();
        if (z > 0.1 && s > -0.4) s += 0.2;  // the rest more coarsely
      }
    }
  }
  int plain = 0, textured = 0;
  bool repetitive = false;
  Eigen::AlignedBox3f box;
  for (const SceneObject& object : scene.objects) {
    object.textured ? ++textured : ++plain;
    repetitive |= object.mesh.name == "bedroom: striped wallpaper";
    for (const Eigen::Vector3f& v : object.mesh.vertices) box.extend(v);
  }
  EXPECT_GT(textured, 100);
  EXPECT_GT(plain, 5);
  EXPECT_TRUE(repetitive);
  EXPECT_GE(box.min().z(), 0);
  EXPECT_LE(box.max().z(), 2.6f);
  EXPECT_GE(box.min().x(), -0.13f);
  EXPECT_LE(box.max().x(), 11.13f);
  EXPECT_GE(box.min().y(), -0.13f);
  EXPECT_LE(box.max().y(), 9.13f);
}

// Corners of the target are where black and white meet, exactly.
TEST(Scenes, TargetCornersAreCornersOfTheGeometry) {
  for (const auto& [name, count, pitch] : {std::tuple{"calibration", 140u, 0.02},
                                           {"calibration:chessboard", 54u, 0.025},
                                           {"calibration:charuco", 54u, 0.03}}) {
    const Scene& scene = scene_of(name);
    ASSERT_EQ(scene.target_corners.size(), count);
    const auto ink = std::find_if(scene.objects.begin(), scene.objects.end(),
                                  [](const SceneObject& o) { return o.mesh.name == "target: ink"; });
    ASSERT_NE(ink, scene.objects.end());
    EXPECT_FALSE(ink->textured);
    for (const Eigen::Vector3d& target : scene.target_corners) {
      double nearest = 1e9;
      for (const Eigen::Vector3f& v : ink->mesh.vertices)
        nearest = std::min(nearest, (v.cast<double>() - target).norm());
      EXPECT_LT(nearest, 1e-6);
    }
    EXPECT_NEAR((scene.target_corners[1] - scene.target_corners[0]).norm(), pitch, 1e-12);
    // Seen from -y, row by row from the upper left: x grows, z falls.
    EXPECT_LT(scene.target_corners.front().x(), scene.target_corners.back().x());
    EXPECT_GT(scene.target_corners.front().z(), scene.target_corners.back().z());
  }
}

// The target looked at straight on, drawn from its geometry.
cv::Mat1b target_image(const Scene& scene, double pixel) {
  Eigen::AlignedBox3f box;
  for (const SceneObject& object : scene.objects) {
    if (object.mesh.name.starts_with("target: ")) {
      for (const Eigen::Vector3f& v : object.mesh.vertices) box.extend(v);
    }
  }
  cv::Mat1b image(static_cast<int>(box.sizes().z() / pixel), static_cast<int>(box.sizes().x() / pixel),
                  static_cast<uint8_t>(128));
  for (const SceneObject& object : scene.objects) {
    if (!object.mesh.name.starts_with("target: ")) continue;
    for (const Eigen::Vector3i& t : object.mesh.triangles) {
      Eigen::AlignedBox3d of;
      for (int i = 0; i < 3; ++i) of.extend(corner(object.mesh, t, i));
      // Both triangles of a rectangle span it: fill their common box.
      const auto x = [&](double v) { return static_cast<int>(std::lround((v - box.min().x()) / pixel)); };
      const auto y = [&](double v) { return static_cast<int>(std::lround((box.max().z() - v) / pixel)); };
      image(cv::Rect(cv::Point(x(of.min().x()), y(of.max().z())), cv::Point(x(of.max().x()), y(of.min().z()))) &
            cv::Rect({}, image.size()))
          .setTo(object.mesh.colour[0]);
    }
  }
  return image;
}

TEST(Scenes, TheTargetShowsItsSquares) {
  const cv::Mat1b squares = target_image(scene_of("calibration"), 0.001);
  cv::Mat labels;
  EXPECT_EQ(cv::connectedComponents(squares < 100, labels) - 1, 35);
  EXPECT_EQ(cv::countNonZero(squares == 128), 0);  // no hole
  EXPECT_EQ(cv::countNonZero(squares < 100), 35 * 20 * 20);
  const cv::Mat1b board = target_image(scene_of("calibration:chessboard"), 0.001);
  EXPECT_EQ(cv::countNonZero(board < 100), 35 * 25 * 25);
  // Markers: 20 of their 36 cells are the black border; not all the others are black too.
  const cv::Mat1b charuco = target_image(scene_of("calibration:charuco"), 0.0005);
  EXPECT_GT(cv::countNonZero(charuco < 100), 35 * 60 * 60 + 35 * 45 * 45 * 5 / 9);
  EXPECT_LT(cv::countNonZero(charuco < 100), 35 * 60 * 60 + 35 * 45 * 45);
}

// By OpenCV's detector as the foreign reader, to a tenth of a pixel (0.05 mm).
TEST(Scenes, TheChessboardIsFoundWhereItIs) {
  constexpr double kPixel = 0.0005;
  const Scene& scene = scene_of("calibration:chessboard");
  const cv::Mat1b image = target_image(scene, kPixel);
  std::vector<cv::Point2f> corners;
  ASSERT_TRUE(cv::findChessboardCorners(image, {9, 6}, corners));
  cv::cornerSubPix(image, corners, {9, 9}, {-1, -1}, {cv::TermCriteria::EPS | cv::TermCriteria::COUNT, 50, 1e-4});
  ASSERT_EQ(corners.size(), scene.target_corners.size());
  // The detector may begin at either end of the board.
  if (corners.front().x > corners.back().x) std::reverse(corners.begin(), corners.end());
  // The image's upper-left pixel has its centre half a pixel inside the sheet: margin of one square, 12 x 9 in all.
  const Eigen::Vector3d upper_left = scene.target_corners.front() + Eigen::Vector3d(-0.05, 0, 0.05);
  for (size_t i = 0; i < corners.size(); ++i) {
    const Eigen::Vector3d expected = (scene.target_corners[i] - upper_left) / kPixel;
    EXPECT_NEAR(corners[i].x, expected.x() - 0.5, 0.1);
    EXPECT_NEAR(corners[i].y, -expected.z() - 0.5, 0.1);
  }
}

TEST(Scenes, TheGraspedThingMovesWithTheHandAndComesBack) {
  const Scene& scene = scene_of("grasp");
  const SceneObject *mug = nullptr, *palm = nullptr;
  int moving = 0;
  for (const SceneObject& object : scene.objects) {
    moving += object.world_from_object != nullptr;
    if (object.mesh.name.starts_with("mug")) mug = &object;
    if (object.mesh.name.starts_with("palm")) palm = &object;
  }
  ASSERT_TRUE(mug && palm);
  EXPECT_GT(moving, 15);
  const auto mug_at = [&](double t) { return mug->world_from_object(t).translation(); };
  EXPECT_GT((mug_at(5) - mug_at(0)).norm(), 0.2);
  EXPECT_GT(mug_at(3.6).z(), mug_at(0).z() + 0.1);
  EXPECT_LT((mug_at(12) - mug_at(0)).norm(), 1e-9);
  EXPECT_LT((mug_at(11.99) - mug_at(0)).norm(), 1e-6);
  // Carried: mug and palm move alike.
  const Eigen::Vector3d offset = palm->world_from_object(3).translation() - mug_at(3);
  for (double t = 2.5; t < 4.8; t += 0.1)
    EXPECT_LT((palm->world_from_object(t).translation() - mug_at(t) - offset).norm(), 1e-9);
  // Nothing jumps: at most 2 m/s.
  for (double t = 0; t < 12; t += 0.01) {
    for (const SceneObject* object : {mug, palm}) {
      EXPECT_LT((object->world_from_object(t + 0.01).translation() - object->world_from_object(t).translation()).norm(),
                0.02)
          << t;
    }
  }
}

TEST(Scenes, DistanceToATriangle) {
  const Eigen::Vector3d a(0, 0, 0), b(2, 0, 0), c(0, 2, 0);
  EXPECT_DOUBLE_EQ(squared_distance({0.5, 0.5, 3}, a, b, c), 9);
  EXPECT_DOUBLE_EQ(squared_distance({1, -2, 0}, a, b, c), 4);
  EXPECT_DOUBLE_EQ(squared_distance({-3, -4, 0}, a, b, c), 25);
  EXPECT_DOUBLE_EQ(squared_distance({2, 2, 1}, a, b, c), 3);
}

TriangleMesh cube(double edge) {
  MeshBuilder b;
  b.box(plain("cube", {1, 2, 3}), Vector3::Constant(-edge / 2), Vector3::Constant(edge / 2));
  TriangleMesh mesh;
  for (const SceneObject& object : b.take()) {
    const int first = static_cast<int>(mesh.vertices.size());
    mesh.vertices.insert(mesh.vertices.end(), object.mesh.vertices.begin(), object.mesh.vertices.end());
    for (const Eigen::Vector3i& t : object.mesh.triangles)
      mesh.triangles.push_back(t + Eigen::Vector3i::Constant(first));
  }
  return mesh;
}

// What repeats is taken for the same place: a wall, floor or ceiling shows its texture once and no other shows it.
TEST(Scenes, NoTwoSurfacesOfARoomLookAlike) {
  const std::vector<std::function<Texture(uint32_t, const Extent&)>> covers = {
      [](uint32_t seed, const Extent& extent) {
        return plaster(seed, {186, 212, 222}, 0.075, extent);
      },
      [](uint32_t seed, const Extent& extent) {
        return wallpaper(seed, {196, 214, 218}, {128, 158, 142}, extent);
      },
      [](uint32_t seed, const Extent& extent) {
        return brick(seed, {82, 108, 168}, extent);
      },
      [](uint32_t seed, const Extent& extent) {
        return parquet(seed, {98, 142, 182}, extent);
      },
      [](uint32_t seed, const Extent& extent) {
        return carpet(seed, {140, 120, 104}, {172, 158, 138}, extent);
      }};
  for (size_t n = 0; n < covers.size(); ++n) {
    SCOPED_TRACE(n);
    const Material material = covering("cover", 7, covers[n]);
    MeshBuilder builder;
    const Room room{.name = "room",
                    .x0 = 0,
                    .y0 = 0,
                    .x1 = 4,
                    .y1 = 3,
                    .walls = {&material, &material, &material, &material},
                    .floor = &material,
                    .ceiling = &material};
    room.build(builder);
    const std::vector<SceneObject> objects = builder.take();
    ASSERT_EQ(objects.size(), 6u);
    for (size_t i = 0; i < objects.size(); ++i) {
      const TriangleMesh& mesh = objects[i].mesh;
      Eigen::Vector2f low = mesh.texture_coordinates.front(), high = low;
      for (const Eigen::Vector2f& uv : mesh.texture_coordinates) low = low.cwiseMin(uv), high = high.cwiseMax(uv);
      EXPECT_LE((high - low).maxCoeff(), 1 + 1e-5f) << mesh.name;
      for (size_t k = 0; k < i; ++k) {
        const cv::Mat3b& other = objects[k].mesh.texture;
        const cv::Rect both(0, 0, std::min(mesh.texture.cols, other.cols), std::min(mesh.texture.rows, other.rows));
        cv::Mat score;
        cv::matchTemplate(mesh.texture(both), other(both), score, cv::TM_CCOEFF_NORMED);
        // Bricks have their joints in common.
        EXPECT_LT(score.at<float>(0, 0), 0.6f) << mesh.name << " and " << objects[k].mesh.name;
      }
    }
  }
}

TEST(Scenes, ABoxIsClosedAndItsTrianglesAreSeenFromOutside) {
  const TriangleMesh mesh = cube(2);
  EXPECT_EQ(mesh.triangles.size(), 12u);
  double volume = 0;
  for (const Eigen::Vector3i& t : mesh.triangles) {
    const Eigen::Vector3d a = corner(mesh, t, 0), b = corner(mesh, t, 1), c = corner(mesh, t, 2);
    EXPECT_GT((b - a).cross(c - a).dot(a + b + c), 0);
    volume += a.dot(b.cross(c)) / 6;
  }
  EXPECT_NEAR(volume, 8, 1e-5);
}

TEST(Scenes, TubesAndBallsAreClosed) {
  MeshBuilder b;
  const Material material = plain("it", {1, 2, 3});
  const auto volume_of = [&] {
    double volume = 0;
    for (const SceneObject& object : b.take()) {
      for (const Eigen::Vector3i& t : object.mesh.triangles) {
        volume += corner(object.mesh, t, 0).dot(corner(object.mesh, t, 1).cross(corner(object.mesh, t, 2))) / 6;
      }
    }
    return volume;
  };
  constexpr int n = 64;
  b.cylinder(material, {1, 2, 0}, {1, 2, 3}, 0.5, 0.5, n);
  const double polygon = 0.5 * n * std::sin(2 * M_PI / n);  // area of the n-gon in the unit circle
  EXPECT_NEAR(volume_of(), polygon * 0.25 * 3, 1e-4);
  b.cylinder(material, {1, 2, 0}, {2, 2, 1}, 0.5, 0, n);
  EXPECT_NEAR(volume_of(), polygon * 0.25 * std::sqrt(2) / 3, 1e-4);
  b.ellipsoid(material, {1, 0, 0}, {1, 2, 3}, n);
  EXPECT_NEAR(volume_of(), 4.0 / 3 * M_PI * 6, 0.15);  // a little less, being inscribed
}

TEST(Scenes, AnyMeshIsAScene) {
  const Scene room = scene_from_meshes({cube(4)}, "room.obj");
  EXPECT_EQ(room.places.paths.front(), "circle");
  EXPECT_NEAR(room.places.circle_centre.norm(), 0, 1e-6);
  EXPECT_NEAR(room.places.circle_radius, 1, 1e-6);
  EXPECT_NO_THROW(make_path(room, {}));
  // A ball fills its middle when there is something inside.
  std::vector<TriangleMesh> meshes = {cube(2), cube(0.01)};
  const Scene object = scene_from_meshes(std::move(meshes), "thing.obj");
  ASSERT_EQ(object.places.look_at.size(), 1u);
  const SimulatedPath path = make_path(object, {});
  EXPECT_GT(path.world_from_cam(1).translation().head<2>().norm(), std::sqrt(3));
  EXPECT_THROW(scene_from_meshes({}, "empty"), InputError);
  // Millimetres taken for metres, a point, and what float can no longer tell apart.
  EXPECT_THROW(scene_from_meshes({cube(4000)}, "mm.obj"), InputError);
  EXPECT_THROW(scene_from_meshes({cube(1e-6)}, "point.obj"), InputError);
  EXPECT_THROW(scene_from_meshes({cube(1e20)}, "huge.obj"), InputError);
}

}  // namespace
}  // namespace iris::simulate
