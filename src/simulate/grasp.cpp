// A hand grasps a mug on a table and puts it elsewhere, seen by a rig that stands still (thesis 8.3.3).
#include <algorithm>
#include <cmath>
#include <memory>

#include "furniture.h"
#include "scenes.h"

namespace iris::simulate {

namespace {

constexpr double kPeriod = 12;   // [s] to the other place and back
constexpr double kTable = 0.75;  // [m]

struct Key {
  double t;  // [s]
  Vector3 hand;
  double grip;  // 0 = open, 1 = closed
};

double eased(double x) { return x * x * (3 - 2 * x); }

// Where the palm is and how far it is closed; the first place of the mug is `a`, the second `b`.
struct HandMotion {
  Vector3 a{-0.16, -0.02, kTable}, b{0.22, 0.1, kTable};
  Vector3 rest{0.5, -0.08, kTable + 0.42};
  Vector3 at = Vector3(0, 0, 0.062) - orientation() * Vector3(0.05, 0, -0.057);  // of the palm, from the mug's foot
  Vector3 above = at + Vector3(0.02, 0.02, 0.2);

  // Fingers (x) point left and a little down, away from the arm; the thumb's side (y) is up; the palm (-z) faces the
  // mug, which the camera sees before it.
  static Eigen::Matrix3d orientation() {
    Eigen::Matrix3d world_from_palm;
    const Vector3 x = Vector3(-0.86, -0.12, -0.36).normalized(), z = x.cross(Vector3::UnitZ()).normalized();
    world_from_palm << x, z.cross(x), z;
    return world_from_palm;
  }

  std::vector<Key> keys() const {
    return {{0, rest, 0},        {1.2, a + above, 0}, {1.9, a + at, 0},     {2.4, a + at, 1},    {3.1, a + above, 1},
            {4.1, b + above, 1}, {4.8, b + at, 1},    {5.3, b + at, 0},     {5.9, b + above, 0}, {6.8, rest, 0},
            {7.6, b + above, 0}, {8.2, b + at, 0},    {8.7, b + at, 1},     {9.2, b + above, 1}, {9.9, a + above, 1},
            {10.4, a + at, 1},   {10.8, a + at, 0},   {11.2, a + above, 0}, {kPeriod, rest, 0}};
  }

  Key at_time(double t) const {
    t -= kPeriod * std::floor(t / kPeriod);
    const std::vector<Key> all = keys();
    size_t i = 1;
    while (i + 1 < all.size() && all[i].t < t) ++i;
    const double s = eased(std::clamp((t - all[i - 1].t) / (all[i].t - all[i - 1].t), 0.0, 1.0));
    return {t, all[i - 1].hand + s * (all[i].hand - all[i - 1].hand),
            all[i - 1].grip + s * (all[i].grip - all[i - 1].grip)};
  }

  Pose world_from_palm(double t) const {
    Pose pose = Pose::Identity();
    pose.linear() = orientation();
    pose.translation() = at_time(t).hand;
    return pose;
  }

  Pose world_from_mug(double t) const {
    const Key now = at_time(t);
    Pose pose = Pose::Identity();
    const bool carried = (now.t > 2.4 && now.t < 4.8) || (now.t > 8.7 && now.t < 10.4);
    pose.translation() = carried ? Vector3(now.hand - at) : (now.t >= 4.8 && now.t <= 8.7 ? b : a);
    return pose;
  }

  // Joint `joint` (0 to 2) of a finger (0 to 3, 4 = thumb): x along the bone, which bends about y towards -z.
  Pose world_from_bone(double t, int finger, int joint) const {
    const double grip = at_time(t).grip;
    Pose pose = world_from_palm(t);
    const bool thumb = finger == 4;
    pose.translate(thumb ? Vector3(-0.01, 0.045, -0.02) : Vector3(0.045, 0.033 - 0.022 * finger, 0));
    if (thumb) pose.rotate(Eigen::AngleAxisd(0.45, Vector3::UnitX()) * Eigen::AngleAxisd(0.25, Vector3::UnitZ()));
    const double bends[] = {thumb ? 1.15 - 0.3 * grip : 0.1 + 0.42 * grip, thumb ? -0.35 : 0.15 + 0.45 * grip,
                            thumb ? -0.5 : 0.1 + 0.4 * grip};
    for (int i = 0; i <= joint; ++i) {
      if (i > 0) pose.translate(Vector3(length(finger, i - 1), 0, 0));
      pose.rotate(Eigen::AngleAxisd(bends[i], Vector3::UnitY()));
    }
    return pose;
  }

  static double length(int finger, int joint) {
    constexpr double kBones[] = {0.045, 0.028, 0.022};
    constexpr double kScale[] = {0.95, 1.05, 1.0, 0.8, 1.1};
    return kBones[joint] * kScale[finger];
  }
};

}  // namespace

Scene grasp(uint32_t seed) {
  const uint32_t s = hash(seed, 5);
  Scene scene{.name = "grasp"};
  MeshBuilder b;
  const Materials m(s);
  const Material wall = covering("plaster", s + 20, [](uint32_t seed, const Extent& extent) {
    return plaster(seed, {186, 206, 212}, 0.08, extent);
  });
  const Material brick_wall = covering("brick", s + 21, [](uint32_t seed, const Extent& extent) {
    return brick(seed, {96, 124, 176}, extent);
  });
  const Material ceiling = covering("ceiling", s + 22, [](uint32_t seed, const Extent& extent) {
    return plaster(seed, {222, 226, 228}, 0.055, extent);
  });
  const Material floor = covering("parquet", s + 23, [](uint32_t seed, const Extent& extent) {
    return parquet(seed, {96, 138, 176}, extent);
  });
  const Room room{.name = "room",
                  .x0 = -2,
                  .y0 = -2.2,
                  .x1 = 2,
                  .y1 = 1.6,
                  .walls = {&wall, &wall, &brick_wall, &wall},
                  .floor = &floor,
                  .ceiling = &ceiling,
                  .skirting = &m.oak};
  room.build(b);
  b.group("room");
  room.place_at(b, north, -0.9);
  shelf(b, m, m.oak, 1.4, 2.0, 0.3, s + 30);
  room.place_at(b, north, 0.9);
  framed_picture(b, with_texture("landscape", landscape(s + 31, 0.9, 0.6), false), m.walnut, 1.35);
  b.place(1.6, 1.1);
  potted_plant(b, m, 1.2, s + 32);
  b.group("table");
  b.place(0, 0.05);
  table(b, m.oak, 1.5, 0.9, kTable - 0.003);
  const Material cloth = with_texture("table cloth", rug(s + 33, 1.0, 0.6), false);
  b.place(0, 0.02, kTable - 0.002);
  b.picture(cloth, {-0.5, 0.3, 0}, {1.0, 0, 0}, {0, -0.6, 0});
  b.place(-0.45, 0.28, kTable + 0.001);
  things(b, m, 0.4, 0.2, 2, s + 34);
  b.place(0.5, 0.36, kTable + 0.001);
  b.box(m.books, {-0.12, -0.09, 0}, {0.12, 0.09, 0.05});
  b.box(m.red_cloth, {-0.1, -0.08, 0.051}, {0.11, 0.07, 0.09});
  scene.objects = b.take();

  const auto motion = std::make_shared<const HandMotion>();
  // What is built next moves; its faces have the light of where it is at the beginning.
  const auto begin = [&](const std::string& name, const std::function<Pose(double)>& pose) {
    b.group(name);
    Pose turned = pose(0);
    turned.translation().setZero();
    b.place(turned);
  };
  const auto add_moving = [&](const std::function<Pose(double)>& pose) {
    Pose turned = pose(0);
    turned.translation().setZero();
    for (SceneObject& object : b.take()) {
      object.world_from_object = [pose, turned](double t) { return Pose(pose(t) * turned.inverse()); };
      scene.objects.push_back(std::move(object));
    }
  };
  const auto mug = [motion](double t) { return motion->world_from_mug(t); };
  begin("mug", mug);
  const Material glaze = with_texture("glaze", tiles(s + 40, {70, 110, 200}, {150, 190, 220}, 0.02, 32, {0.16, 0.16}));
  b.cylinder(glaze, {0, 0, 0.001}, {0, 0, 0.11}, 0.036, 0.04, 28);
  b.cylinder(glaze, {0, -0.04, 0.085}, {0, -0.065, 0.08}, 0.006, 0.006, 8);
  b.cylinder(glaze, {0, -0.065, 0.082}, {0, -0.065, 0.032}, 0.006, 0.006, 8);
  b.cylinder(glaze, {0, -0.038, 0.03}, {0, -0.065, 0.034}, 0.006, 0.006, 8);
  add_moving(mug);

  const Material skin = with_texture("skin", plaster(s + 41, {128, 158, 208}, 0.09, {0.64, 0.64}));
  const auto palm = [motion](double t) { return motion->world_from_palm(t); };
  begin("palm", palm);
  b.box(skin, {-0.05, -0.044, -0.014}, {0.05, 0.044, 0.014});
  b.ellipsoid(skin, {0.045, 0, 0}, {0.016, 0.045, 0.0155}, 16);
  b.cylinder(skin, {-0.075, 0, 0}, {-0.045, 0, 0}, 0.03, 0.033, 16);
  b.group("sleeve");
  b.cylinder(m.blue_cloth, {-0.5, 0.05, 0.06}, {-0.07, 0, 0}, 0.055, 0.04, 20);
  add_moving(palm);
  for (int finger = 0; finger < 5; ++finger) {
    for (int joint = 0; joint < 3; ++joint) {
      const double radius = (finger == 4 ? 0.0115 : 0.0095) - 0.001 * joint;
      const auto bone = [motion, finger, joint](double t) { return motion->world_from_bone(t, finger, joint); };
      begin((finger == 4 ? "thumb " : "finger " + std::to_string(finger) + " ") + std::to_string(joint), bone);
      b.cylinder(skin, {0, 0, 0}, {HandMotion::length(finger, joint), 0, 0}, radius, radius - 0.001, 12);
      b.ellipsoid(skin, {0, 0, 0}, Vector3::Constant(radius * 1.01), 10);
      if (joint == 2)
        b.ellipsoid(skin, {HandMotion::length(finger, joint), 0, 0}, Vector3::Constant(radius - 0.0009), 10);
      add_moving(bone);
    }
  }

  scene.places.stand = {-0.05, -0.85, kTable + 0.32};
  scene.places.stand_look_at = {0.03, 0.1, kTable + 0.12};
  scene.places.circle_centre = {0, -1.1, 1.3};
  scene.places.circle_radius = 0.4;
  scene.places.paths = {"static", "circle", "roam"};
  return scene;
}

}  // namespace iris::simulate
