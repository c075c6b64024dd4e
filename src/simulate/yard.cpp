// Outdoors: uneven ground, a house, trees, hedges and a fence. Leaves are triangles of their own.
#include <cmath>
#include <tuple>

#include "furniture.h"
#include "scenes.h"

namespace iris::simulate {

namespace {

// [m] smooth and flat: hills of up to 0.12 m.
double ground(double x, double y) {
  return 0.05 * std::sin(0.55 * x + 0.3) * std::cos(0.47 * y) + 0.04 * std::sin(0.9 * y + 0.25 * x) +
         0.03 * std::cos(1.3 * x - 0.8 * y);
}

void leaf(MeshBuilder& b, const Material& material, Random& random, const Vector3& place, double size) {
  Vector3 a(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
  Vector3 c(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
  a = (a + Vector3(0, 0, 1e-3)).normalized() * size;
  c = a.cross(c + Vector3(1e-3, 0, 0)).normalized() * size * 0.6;
  const Vector2 uv(random.uniform(), random.uniform());
  b.triangle(material, place, place + a + 0.5 * c, place + a - 0.5 * c, uv, uv + Vector2(size, size * 0.3),
             uv + Vector2(size, -size * 0.3));
}

// Leaves near the surface of a lumpy ellipsoid.
void crown(MeshBuilder& b, const Material& material, Random& random, const Vector3& centre, const Vector3& radii,
           int count, double size) {
  const double p = random.uniform(0, 6), q = random.uniform(0, 6);
  for (int i = 0; i < count; ++i) {
    Vector3 d(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
    if (d.norm() < 0.05 || d.norm() > 1) continue;
    d.normalize();
    const double lumps =
        1 + 0.16 * std::sin(4 * d.x() + p) * std::sin(4 * d.y() + q) + 0.12 * std::sin(9 * d.z() + 5 * d.x() + q);
    const double depth = random.uniform();
    leaf(b, material, random, centre + (lumps * (1 - 0.35 * depth * depth)) * radii.cwiseProduct(d),
         size * random.uniform(0.7, 1.3));
  }
}

void tree(MeshBuilder& b, const Material& bark, const Material& leaves, double x, double y, double height,
          uint32_t seed) {
  Random random(seed);
  const Vector3 foot(x, y, ground(x, y) - 0.1),
      fork(x + random.uniform(-0.15, 0.15), y + random.uniform(-0.15, 0.15), height * 0.5);
  b.cylinder(bark, foot, fork, 0.17, 0.11, 14);
  const int branches = 6;
  for (int i = 0; i < branches; ++i) {
    const double angle = 2 * M_PI * (i + 0.5 * random.uniform()) / branches, out = height * random.uniform(0.16, 0.24);
    const Vector3 end =
        fork + Vector3(out * std::cos(angle), out * std::sin(angle), height * random.uniform(0.15, 0.4));
    b.cylinder(bark, fork - Vector3(0, 0, 0.05), end, 0.07, 0.025, 8);
    crown(b, leaves, random, end, Vector3(0.2, 0.2, 0.15) * height, 3600, 0.11);
  }
  crown(b, leaves, random, fork + Vector3(0, 0, height * 0.38), Vector3(0.22, 0.22, 0.18) * height, 4500, 0.11);
}

void hedge(MeshBuilder& b, const Material& inside, const Material& leaves, const Vector3& low, const Vector3& high,
           int count, uint32_t seed) {
  Random random(seed);
  const Vector3 gap(0.08, 0.08, 0.08);
  b.box(inside, low + gap, high - gap);
  const Vector3 size = high - low;
  const double areas[] = {size.y() * size.z(), size.x() * size.z(),
                          size.x() * size.y() / 2};  // a pair of sides; the top
  for (int i = 0; i < count; ++i) {
    Vector3 p(random.uniform(), random.uniform(), random.uniform());
    double pick = random.uniform() * (areas[0] + areas[1] + areas[2]);
    int axis = 0;
    while (axis < 2 && pick > areas[axis]) pick -= areas[axis++];
    p[axis] = axis == 2 || random.below(2) ? 1 : 0;
    Vector3 place = low + p.cwiseProduct(size);
    const double lump = 0.06 * std::sin(5 * place.x() + 3 * place.z()) * std::sin(5 * place.y() - 2 * place.z());
    place[axis] += lump + random.uniform(-0.07, 0.04);
    leaf(b, leaves, random, place, 0.08 * random.uniform(0.7, 1.3));
  }
}

}  // namespace

Scene yard(uint32_t seed) {
  const uint32_t s = hash(seed, 3);
  Scene scene{.name = "yard"};
  MeshBuilder b;
  const Materials m(s);
  const Material meadow = with_texture("grass", grass(s + 20, 3072, 9), false);
  const Material stones = with_texture("paving", paving(s + 21), false);
  const Material house = covering("house brick", s + 22, [](uint32_t seed, const Extent& extent) {
    return brick(seed, {86, 110, 170}, extent);
  });
  const Material render = covering("render", s + 23, [](uint32_t seed, const Extent& extent) {
    return plaster(seed, {190, 216, 226}, 0.08, extent);
  });
  const Material roof = covering("roof", s + 24, [](uint32_t seed, const Extent& extent) {
    return tiles(seed, {70, 82, 150}, {64, 74, 138}, 0.2, 64, extent);
  });
  const Material planks = with_texture("planks", parquet(s + 30, {88, 122, 158}));
  const Material trunk = with_texture("bark", bark(s + 25));
  const Material birch = with_texture("light leaves", granite(s + 26, {70, 150, 110}));
  const Material beech = with_texture("dark leaves", granite(s + 27, {48, 105, 62}));
  const Material copper = with_texture("red leaves", granite(s + 28, {60, 80, 140}));
  const Material shade = with_texture("inside of hedges", granite(s + 29, {30, 60, 36}));

  b.group("ground");
  b.height_field(meadow, {-26, -22}, {26, 26}, 104, 96, ground);
  // Slabs to the door of the house, each lying on the ground.
  for (int i = 0; i < 9; ++i) {
    for (const double x : {-0.42, 0.42}) {
      const double y = 7.4 - 0.85 * i, z = ground(x, y) + 0.03;
      b.box(stones, {x - 0.4, y - 0.4, z - 0.15}, {x + 0.4, y + 0.4, z});
    }
  }

  // The house: the front has a door and four windows.
  const Room front{.name = "house",
                   .x0 = -8,
                   .y0 = -10,
                   .x1 = 8,
                   .y1 = 8,
                   .height = 4.2,
                   .walls = {nullptr, nullptr, &house, nullptr},
                   .openings = {{{},
                                 {},
                                 {{-6.5, -4.7, 1.0, 2.4},
                                  {-3.4, -1.6, 1.0, 2.4},
                                  {-0.6, 0.6, 0.1, 2.2},
                                  {1.8, 3.6, 1.0, 2.4},
                                  {4.9, 6.7, 1.0, 2.4}},
                                 {}}}};
  b.group("house");
  b.place(-8, 8, -0.2);
  std::vector<Opening> cut;
  for (Opening o : front.openings[north]) cut.push_back({o.from + 8, o.to + 8, o.bottom + 0.2, o.top + 0.2});
  b.wall(b.surface(house, 16, 4.64), 16, 4.64, cut, nullptr);
  for (size_t i = 0; i < front.openings[north].size(); ++i) {
    const Opening& o = front.openings[north][i];
    if (i == 2) {
      front.place_at(b, north, 0);
      b.box(m.walnut, {-0.6 - 0.01, 0.05, 0.05}, {0.6 + 0.01, 0.1, 2.21});
      for (const double z : {0.25, 1.25}) {
        for (const double x : {-0.5, 0.05}) b.box(m.walnut, {x, 0.03, z}, {x + 0.45, 0.06, z + 0.75});
      }
      b.cylinder(m.steel, {0.5, 0.0, 1.1}, {0.5, 0.0, 1.3}, 0.015, 0.015, 8);
      continue;
    }
    window(b, front, north, o, m.painted,
           with_texture("pane " + std::to_string(i), view_outside(s + 40 + static_cast<uint32_t>(i), 1.8, 1.4), true));
  }
  b.place(0, 0);
  const double slope = std::hypot(3, 2.1);
  b.quad(b.surface(roof, 16.8, slope), {-8.4, 10.5, 6.2}, {16.8, 0, 0}, {0, -3, -2.1});
  b.quad(b.surface(render, 5, 4.63), {-8, 13, 4.43}, {0, -5, 0}, {0, 0, -4.63});
  b.quad(b.surface(render, 5, 4.63), {8, 8, 4.43}, {0, 5, 0}, {0, 0, -4.63});
  // Gables below the roof.
  for (const double x : {-8.0, 8.0}) {
    b.triangle(b.surface(render, 5, 1.75), {x, 13, 4.43}, {x, 8, 4.43}, {x, 10.5, 6.18}, {0, 0}, {5, 0}, {2.5, -1.75});
  }
  b.quad(b.surface(roof, 16.8, slope), {8.4, 10.5, 6.2}, {-16.8, 0, 0}, {0, 3, -2.1});

  // A shed at the east side and a wall of render at the west.
  b.group("shed");
  b.place(9.6, 3.5, ground(9.6, 3.5) - 0.05, 0);
  b.box(planks, {-1.3, -1.6, 0}, {1.3, 1.6, 2.1});
  b.box(m.walnut, {-1.33, -0.45, 0.1}, {-1.29, 0.45, 1.95});
  b.quad(b.surface(roof, 4, 3.25), {1.6, 2.0, 2.12}, {0, -4.0, 0}, {-3.2, 0, 0.5});
  b.group("garden wall");
  b.place(-11.5, -3.0, -0.2, 90);
  b.quad(b.surface(render, 8, 2), {0, 0, 2.0}, {8, 0, 0}, {0, 0, -2.0});
  b.box(m.clay, {-0.05, -0.06, 2.001}, {8.05, 0.3, 2.08});

  b.group("hedges");
  b.place(0, 0);
  hedge(b, shade, beech, {-11.4, -9.6, -0.1}, {-3.2, -8.6, 1.7}, 17000, s + 50);
  hedge(b, shade, beech, {3.2, -9.6, -0.1}, {11.4, -8.6, 1.7}, 17000, s + 51);
  hedge(b, shade, birch, {10.6, -8.4, -0.1}, {11.5, 0.8, 1.9}, 17000, s + 52);
  hedge(b, shade, birch, {-1.2, -0.8, -0.1}, {1.2, -0.1, 0.9}, 7000, s + 53);

  b.group("fence");
  for (int i = 0; i <= 32; ++i) {
    const double x = -3.1 + 6.2 * i / 32, z = ground(x, -9);
    b.box(m.pine, {x - 0.045, -9.02, z - 0.1}, {x + 0.045, -8.995, z + 1.1 + 0.04 * (i % 2)});
    if (i % 8 == 0) b.box(m.pine, {x - 0.05, -9.16, z - 0.1}, {x + 0.05, -9.06, z + 1.2});
  }
  for (const double z : {0.3, 0.85}) b.box(m.pine, {-3.15, -9.06, z}, {3.15, -9.021, z + 0.08});

  b.group("trees");
  tree(b, trunk, birch, -7.2, 2.5, 5.2, s + 60);
  tree(b, trunk, copper, 2.6, -2.2, 4.4, s + 61);
  tree(b, trunk, beech, -3.4, -2.4, 4.8, s + 62);
  tree(b, trunk, birch, 7.4, -5.6, 4.6, s + 63);
  b.group("bushes");
  Random random(s + 70);
  for (const auto& [x, y, r] : {std::tuple{-8.8, -6.4, 0.9},
                                {-5.4, 6.9, 0.7},
                                {4.2, 6.9, 0.75},
                                {7.6, 6.8, 0.8},
                                {1.4, 1.6, 0.6},
                                {-1.6, 1.9, 0.55}}) {
    crown(b, x > 0 ? beech : copper, random, {x, y, ground(x, y) + 0.7 * r}, {r, r, 0.85 * r}, 5000, 0.08);
  }
  // A wood around all of it: far away, so that lumps will do.
  b.group("wood");
  b.place(0, 0);
  const Material wood_leaves = with_texture("far leaves", granite(s + 31, {58, 112, 78}, 512));
  for (int i = 0; i < 54; ++i) {
    const double angle = 2 * M_PI * (i + 0.4 * random.uniform()) / 54, far = random.uniform(19, 23);
    const double wide = random.uniform(1.6, 2.6), tall = random.uniform(2.2, 4.2);
    b.ellipsoid(wood_leaves, {far * std::cos(angle), far * std::sin(angle), 0.6 * tall}, {wide, wide, tall}, 16);
  }
  b.group("bench");
  b.place(-0.1, 0.45, ground(0, 0.5));
  for (int i = 0; i < 4; ++i) b.box(m.oak, {-0.8, 0.1 + 0.11 * i, 0.42}, {0.8, 0.19 + 0.11 * i, 0.455});
  for (int i = 0; i < 3; ++i) b.box(m.oak, {-0.8, 0.06, 0.55 + 0.12 * i}, {0.8, 0.09, 0.64 + 0.12 * i});
  for (const double x : {-0.65, 0.65}) {
    b.box(m.steel, {x - 0.03, 0.03, -0.1}, {x + 0.03, 0.07, 0.9});
    b.box(m.steel, {x - 0.03, 0.06, 0.37}, {x + 0.03, 0.52, 0.42});
    b.box(m.steel, {x - 0.03, 0.46, -0.1}, {x + 0.03, 0.5, 0.38});
  }
  scene.objects = b.take();

  const auto eye = [](double x, double y) { return Vector3(x, y, ground(x, y) + 1.5); };
  for (const Vector2& p : std::vector<Vector2>{{-0.5, -4.6},
                                               {-5.6, -4.6},
                                               {-8.6, -3.2},
                                               {-9.2, 0.8},
                                               {-8.9, 4.4},
                                               {-6.2, 5.4},
                                               {-2.8, 5.0},
                                               {1.0, 4.6},
                                               {4.6, 4.8},
                                               {6.9, 4.2},
                                               {6.9, 1.0},
                                               {6.4, -1.6},
                                               {5.2, -4.6},
                                               {2.4, -5.4}}) {
    scene.places.round.push_back(eye(p.x(), p.y()));
  }
  scene.places.circle_centre = eye(4.6, 2.4);
  scene.places.circle_radius = 1.2;
  scene.places.stand = eye(-0.5, -6.6);
  scene.places.stand_look_at = {0, 3, 1.2};
  scene.places.paths = {"round", "circle", "roam", "static"};
  return scene;
}

}  // namespace iris::simulate
