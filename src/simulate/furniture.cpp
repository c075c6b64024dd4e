#include "furniture.h"

#include <algorithm>
#include <cmath>

namespace iris::simulate {

namespace {

// A leaf: two triangles about its middle line, bent down to its tip.
void blade(MeshBuilder& b, const Material& material, const Vector3& root, const Vector3& along, const Vector3& across,
           double bend) {
  const Vector3 middle = root + 0.5 * along + Vector3(0, 0, 0.25 * bend), tip = root + along - Vector3(0, 0, bend);
  const double length = along.norm(), width = across.norm();
  b.triangle(material, root, middle + across, middle - across, {0, width}, {length / 2, 2 * width}, {length / 2, 0});
  b.triangle(material, middle - across, middle + across, tip, {length / 2, 0}, {length / 2, 2 * width},
             {length, width});
}

}  // namespace

Materials::Materials(uint32_t s)
    : oak(with_texture("oak", wood(s + 1, {95, 145, 190}))),
      pine(with_texture("pine", wood(s + 2, {125, 180, 215}))),
      walnut(with_texture("walnut", wood(s + 3, {62, 88, 122}))),
      painted(with_texture("paint", plaster(s + 4, {206, 212, 210}, 0.07, {1.28, 1.28}))),
      red_cloth(with_texture("red cloth", fabric(s + 5, {62, 58, 158}, {120, 150, 200}))),
      blue_cloth(with_texture("blue cloth", fabric(s + 6, {150, 100, 62}, {205, 190, 150}))),
      green_cloth(with_texture("green cloth", fabric(s + 7, {85, 125, 82}, {150, 190, 170}))),
      linen(with_texture("linen", fabric(s + 8, {200, 208, 212}, {160, 150, 190}))),
      curtain(with_texture("curtain", fabric(s + 9, {150, 185, 205}, {110, 120, 180}))),
      worktop(with_texture("worktop", granite(s + 10, {105, 110, 112}, 512))),
      leaf(with_texture("leaf", granite(s + 11, {55, 125, 70}))),
      earth(with_texture("earth", granite(s + 12, {45, 58, 72}, 64))),
      clay(with_texture("clay", granite(s + 13, {75, 110, 175}, 128))),
      steel(with_texture("steel", wood(s + 14, {150, 148, 146}, {0.64, 0.16}))),
      white(plain("white", {232, 234, 235})),
      black(plain("black", {42, 40, 40})),
      glow{.name = "glow", .texture = {}, .colour = {200, 240, 252}, .shaded = false},
      book_backs(simulate::book_backs(s + 15)),
      books(with_texture("books", book_backs.texture)) {}

double Room::along(Side side, double world) const {
  switch (side) {
    case south:
      return x1 - world;
    case east:
      return y1 - world;
    case north:
      return world - x0;
    default:
      return world - y0;
  }
}

void Room::place_at(MeshBuilder& b, Side side, double world) const {
  switch (side) {
    case south:
      return b.place(world, y0, 0, 180);
    case east:
      return b.place(x1, world, 0, -90);
    case north:
      return b.place(world, y1, 0, 0);
    default:
      return b.place(x0, world, 0, 90);
  }
}

void Room::build(MeshBuilder& b) const {
  b.group(name);
  for (const Side side : {south, east, north, west}) {
    const Material* material = walls[side];
    if (!material) continue;
    std::vector<Opening> local;
    for (const Opening& opening : openings[side]) {
      const double from = along(side, opening.from), to = along(side, opening.to);
      local.push_back({std::min(from, to), std::max(from, to), opening.bottom, opening.top});
    }
    place_at(b, side, side == south ? x1 : side == east ? y1 : side == north ? x0 : y0);
    b.wall(b.surface(*material, length(side), height), length(side), height, local, skirting);
  }
  b.place(0, 0);
  const Vector3 x(x1 - x0, 0, 0), y(0, y1 - y0, 0);
  if (floor) b.quad(b.surface(*floor, x.norm(), y.norm()), {x0, y1, 0}, x, -y);
  if (ceiling) b.quad(b.surface(*ceiling, x.norm(), y.norm()), {x0, y0, height}, x, y);
}

void door_frame(MeshBuilder& b, const Material& material, bool wall_along_x, double from, double to, double low,
                double high, double top, const Material& threshold) {
  // In a frame with x along the wall and y across it.
  if (wall_along_x) {
    b.place(0, 0);
  } else {
    Pose turned = Pose::Identity();
    turned.linear() << 0, -1, 0, 1, 0, 0, 0, 0, 1;  // x of the frame = y of the world
    b.place(turned);
    std::swap(from, to);
    from = -from, to = -to;
  }
  constexpr double kOut = 0.018, kWide = 0.06;
  b.box(material, {low - kWide, from - kOut, 0.001}, {low, to + kOut, top + kWide});
  b.box(material, {high, from - kOut, 0.001}, {high + kWide, to + kOut, top + kWide});
  b.box(material, {low - 0.02, from - kOut - 0.002, top}, {high + 0.02, to + kOut + 0.002, top + kWide + 0.002});
  b.quad(threshold, {low, to, 0}, {high - low, 0, 0}, {0, from - to, 0}, {3.7 * low, 2.3 * to});
}

void window(MeshBuilder& b, const Room& room, Side side, const Opening& opening, const Material& frame,
            const Material& outside) {
  room.place_at(b, side, (opening.from + opening.to) / 2);
  const double w = (opening.to - opening.from) / 2, low = opening.bottom, high = opening.top, deep = 0.12;
  const double tall = high - low;
  b.picture(outside, {-w, deep, high}, {2 * w, 0, 0}, {0, 0, -tall});
  b.quad(frame, {-w, 0, high}, {0, deep, 0}, {0, 0, -tall});
  b.quad(frame, {w, deep, high}, {0, -deep, 0}, {0, 0, -tall});
  b.quad(frame, {-w, 0, high}, {2 * w, 0, 0}, {0, deep, 0});
  b.quad(frame, {-w, deep, low}, {2 * w, 0, 0}, {0, -deep, 0});
  constexpr double kBar = 0.05, kGap = 0.001, kNear = 0.06, kFar = 0.11;
  b.box(frame, {-w + kGap, kNear, low + kGap}, {-w + kBar, kFar, high - kGap});
  b.box(frame, {w - kBar, kNear, low + kGap}, {w - kGap, kFar, high - kGap});
  b.box(frame, {-kBar / 2, kNear, low + kGap}, {kBar / 2, kFar, high - kGap});
  b.box(frame, {-w + kBar - kGap, kNear + 0.002, low + kGap}, {w - kBar + kGap, kFar - 0.002, low + kBar});
  b.box(frame, {-w + kBar - kGap, kNear + 0.002, high - kBar}, {w - kBar + kGap, kFar - 0.002, high - kGap});
  b.box(frame, {-w - 0.06, -0.14, low - 0.035}, {w + 0.06, 0.01, low - 0.003});
}

void curtains(MeshBuilder& b, const Room& room, Side side, const Opening& opening, const Materials& m,
              const Material& cloth) {
  room.place_at(b, side, (opening.from + opening.to) / 2);
  const double w = (opening.to - opening.from) / 2, top = opening.top + 0.12;
  b.cylinder(m.steel, {-w - 0.4, -0.17, top}, {w + 0.4, -0.17, top}, 0.012, 0.012, 8);
  constexpr int kFolds = 28;
  for (const double start : {-w - 0.33, w - 0.05}) {
    const auto at = [&](int i) {
      const double u = start + 0.38 * i / kFolds;
      return Vector3(u, -0.17 + 0.03 * std::sin(2 * M_PI * i / 7.0), top - 0.015);
    };
    for (int i = 0; i < kFolds; ++i) {
      const Vector3 a = at(i), next = at(i + 1);
      b.quad(cloth, a, next - a, {0, 0, 0.06 - a.z()}, {0.06 * i, 0});
    }
  }
}

void framed_picture(MeshBuilder& b, const Material& picture, const Material& frame, double z) {
  const double w = picture.texture.width / 2, h = picture.texture.height / 2;
  constexpr double kBar = 0.03;
  b.box(frame, {-w - kBar, -0.025, z - h - kBar}, {w + kBar, -0.004, z - h});
  b.box(frame, {-w - kBar, -0.025, z + h}, {w + kBar, -0.004, z + h + kBar});
  b.box(frame, {-w - kBar, -0.0245, z - h - 0.001}, {-w, -0.004, z + h + 0.001});
  b.box(frame, {w, -0.0245, z - h - 0.001}, {w + kBar, -0.004, z + h + 0.001});
  b.picture(picture, {-w - 0.002, -0.012, z + h + 0.002}, {2 * w + 0.004, 0, 0}, {0, 0, -2 * h - 0.004});
}

void poster(MeshBuilder& b, const Material& picture, double z) {
  const double w = picture.texture.width / 2, h = picture.texture.height / 2;
  b.picture(picture, {-w, -0.004, z + h}, {2 * w, 0, 0}, {0, 0, -2 * h});
}

void shelf(MeshBuilder& b, const Materials& m, const Material& wood, double width, double height, double depth,
           uint32_t seed) {
  const double w = width / 2, front = -depth, back = -0.02;
  constexpr double kThick = 0.022, kRise = 0.34;
  b.box(wood, {-w, front, 0.002}, {-w + kThick, back, height});
  b.box(wood, {w - kThick, front, 0.002}, {w, back, height});
  b.box(wood, {-w + kThick - 0.002, back - 0.008, 0.05}, {w - kThick + 0.002, back - 0.002, height - 0.002});
  Random random(seed);
  const std::vector<double>& starts = m.book_backs.starts;
  const int books = static_cast<int>(starts.size()) - 1;
  const int boards = std::max(2, static_cast<int>(height / kRise) + 1);
  for (int i = 0; i < boards; ++i) {
    const double z = i + 1 == boards ? height - kThick + 0.001 : 0.06 + (height - 0.08) * i / (boards - 1);
    b.box(wood, {-w + kThick - 0.002, front + 0.003, z}, {w - kThick + 0.002, back - 0.001, z + kThick});
    if (i + 1 == boards) break;
    const double room = (height - 0.08) / (boards - 1) - kThick - 0.03;
    int book = random.below(books);
    for (double x = -w + kThick + 0.004; x < w - kThick - 0.06;) {
      if (random.uniform() < 0.07) {  // a gap
        x += random.uniform(0.05, 0.25);
        continue;
      }
      book = (book + 1) % books;
      const double thick = starts[static_cast<size_t>(book) + 1] - starts[static_cast<size_t>(book)];
      if (x + thick > w - kThick - 0.004) break;
      const double tall = std::min(room, random.uniform(0.17, 0.27)), deep = front + random.uniform(0.02, 0.07);
      const double z0 = z + kThick + 0.001;
      b.box(m.linen, {x + 0.0005, deep + 0.001, z0}, {x + thick - 0.0005, back - 0.02, z0 + tall});
      b.quad(m.books, {x + 0.0005, deep, z0 + tall}, {thick - 0.001, 0, 0}, {0, 0, -tall},
             {starts[static_cast<size_t>(book)], 0});
      x += thick + 0.001;
    }
  }
}

void cupboard(MeshBuilder& b, const Materials& m, const Material& body, double width, double height, double depth,
              int doors, double bottom) {
  const double w = width / 2, top = bottom + height, front = -depth;
  b.box(body, {-w, front + 0.02, bottom}, {w, -0.015, top});
  for (int i = 0; i < doors; ++i) {
    const double from = -w + width * i / doors + 0.003, to = -w + width * (i + 1) / doors - 0.003;
    b.box(body, {from, front, bottom + 0.04}, {to, front + 0.018, top - 0.01});
    const double x = i % 2 == 0 ? to - 0.05 : from + 0.05;
    const double z = bottom > 1 ? bottom + 0.1 : std::min(top - 0.15, 1.1);
    b.cylinder(m.steel, {x, front - 0.02, z - 0.06}, {x, front - 0.02, z + 0.06}, 0.006, 0.006, 6);
    for (const double dz : {-0.05, 0.05})
      b.cylinder(m.steel, {x, front - 0.02, z + dz}, {x, front + 0.002, z + dz}, 0.004, 0.004, 6);
  }
}

void things(MeshBuilder& b, const Materials& m, double width, double depth, int count, uint32_t seed) {
  Random random(seed);
  const Material* colours[] = {&m.clay, &m.red_cloth, &m.steel, &m.worktop, &m.blue_cloth, &m.painted};
  for (int i = 0; i < count; ++i) {
    // One thing in each cell of a row, so that none stands in another.
    const double x = -width / 2 + width * (i + random.uniform(0.35, 0.65)) / count,
                 y = random.uniform(-depth / 2 + 0.07, depth / 2 - 0.07);
    const Material& material = *colours[random.below(6)];
    const double size = std::min(0.06, 0.3 * width / count);
    switch (random.below(4)) {
      case 0:
        b.cylinder(material, {x, y, 0.002}, {x, y, 0.002 + random.uniform(0.08, 0.12)}, size * 0.65, size * 0.75);
        break;
      case 1: {
        const double tall = random.uniform(0.18, 0.28);
        b.cylinder(material, {x, y, 0.002}, {x, y, tall * 0.7}, size * 0.6, size * 0.6);
        b.cylinder(material, {x, y, tall * 0.7 + 0.0005}, {x, y, tall}, size * 0.55, size * 0.2);
        break;
      }
      case 2:
        b.box(material, {x - size, y - size * 0.8, 0.002}, {x + size, y + size * 0.8, random.uniform(0.05, 0.16)});
        break;
      default:
        b.ellipsoid(material, {x, y, size * 0.8 + 0.002}, {size * 0.8, size * 0.8, size * 0.8}, 14);
    }
  }
}

void kitchen_block(MeshBuilder& b, const Materials& m, const Material& front, double width) {
  const double w = width / 2;
  cupboard(b, m, front, width, 0.86, 0.58, std::max(2, static_cast<int>(width / 0.5)));
  b.box(m.worktop, {-w - 0.005, -0.61, 0.863}, {w + 0.005, -0.012, 0.9});
  // Hob and sink lie on the worktop, a tap stands behind the sink.
  b.box(m.black, {-w + 0.25, -0.52, 0.901}, {-w + 0.8, -0.1, 0.908});
  for (const auto& [x, y] : {std::pair{0.38, -0.42}, {0.66, -0.42}, {0.38, -0.21}, {0.66, -0.21}}) {
    b.cylinder(m.steel, {-w + x, y, 0.907}, {-w + x, y, 0.911}, 0.085, 0.085, 20);
  }
  b.box(m.steel, {w - 0.8, -0.5, 0.901}, {w - 0.3, -0.12, 0.912});
  b.box(m.black, {w - 0.76, -0.46, 0.911}, {w - 0.34, -0.16, 0.914});
  b.cylinder(m.steel, {w - 0.55, -0.08, 0.901}, {w - 0.55, -0.08, 1.12}, 0.014, 0.014, 8);
  b.cylinder(m.steel, {w - 0.55, -0.08, 1.11}, {w - 0.55, -0.28, 1.09}, 0.012, 0.012, 8);
  // A pot on the hob.
  b.cylinder(m.clay, {-w + 0.38, -0.21, 0.912}, {-w + 0.38, -0.21, 1.04}, 0.1, 0.105, 18);
}

void sofa(MeshBuilder& b, const Material& cloth, const Material& cushion, double width) {
  const double w = width / 2;
  b.box(cloth, {-w, -0.82, 0.06}, {w, -0.03, 0.28});
  b.box(cloth, {-w + 0.16, -0.26, 0.27}, {w - 0.16, -0.035, 0.82});
  for (const double side : {-1.0, 1.0}) {
    const double x = side * (w - 0.085);
    b.box(cloth, {x - 0.085, -0.825, 0.055}, {x + 0.085, -0.032, 0.6});
    for (const double y : {-0.76, -0.1})
      b.cylinder(cushion, {side * (w - 0.1), y, 0.002}, {side * (w - 0.1), y, 0.07}, 0.03, 0.03, 8);
  }
  const double seat = (width - 0.36) / 2;
  for (const double x : {-seat, 0.0}) b.box(cloth, {x + 0.006, -0.84, 0.282}, {x + seat - 0.006, -0.27, 0.43});
  b.ellipsoid(cushion, {-seat + 0.25, -0.36, 0.6}, {0.2, 0.1, 0.18}, 16);
  b.ellipsoid(cushion, {seat - 0.22, -0.36, 0.6}, {0.19, 0.1, 0.17}, 16);
}

void bed(MeshBuilder& b, const Material& wood, const Material& cover, const Material& pillow, double width) {
  const double w = width / 2;
  b.box(wood, {-w, -0.07, 0.002}, {w, -0.02, 0.95});
  b.box(wood, {-w, -2.08, 0.1}, {w, -0.069, 0.32});
  for (const double x : {-w + 0.06, w - 0.06}) b.box(wood, {x - 0.04, -2.06, 0.002}, {x + 0.04, -1.98, 0.11});
  b.box(pillow, {-w + 0.03, -2.04, 0.321}, {w - 0.03, -0.075, 0.46});
  b.box(cover, {-w - 0.015, -2.085, 0.3}, {w + 0.015, -0.62, 0.52});
  const int pillows = width > 1.2 ? 2 : 1;
  for (int i = 0; i < pillows; ++i) {
    const double x = pillows == 1 ? 0 : (i == 0 ? -w / 2 : w / 2);
    b.ellipsoid(pillow, {x, -0.33, 0.52}, {0.33, 0.21, 0.09}, 18);
  }
}

void desk(MeshBuilder& b, const Materials& m, const Material& wood, const Material& screen, const Material& paper,
          double width) {
  const double w = width / 2;
  b.box(wood, {-w, -0.75, 0.71}, {w, -0.02, 0.74});
  for (const double x : {-w + 0.04, w - 0.04}) {
    for (const double y : {-0.71, -0.07}) b.box(m.steel, {x - 0.025, y - 0.025, 0.002}, {x + 0.025, y + 0.025, 0.715});
  }
  // Monitor, keyboard, papers.
  const double sw = screen.texture.width / 2, sh = screen.texture.height;
  b.box(m.black, {-0.12, -0.28, 0.742}, {0.12, -0.1, 0.755});
  b.box(m.black, {-0.02, -0.2, 0.75}, {0.02, -0.17, 0.95});
  b.box(m.black, {-sw - 0.015, -0.235, 0.88}, {sw + 0.015, -0.199, 0.91 + sh});
  b.picture(screen, {-sw, -0.237, 0.895 + sh}, {2 * sw, 0, 0}, {0, 0, -sh});
  b.box(m.worktop, {-0.22, -0.62, 0.742}, {0.22, -0.48, 0.76});
  b.picture(paper, {-w + 0.1, -0.35, 0.743}, {0.21, 0.05, 0}, {0.07, -0.29, 0});
  b.picture(paper, {w - 0.38, -0.4, 0.743}, {0.2, -0.06, 0}, {-0.08, -0.28, 0});
}

void radiator(MeshBuilder& b, const Material& material, double width) {
  const int ribs = static_cast<int>(width / 0.06);
  for (int i = 0; i < ribs; ++i) {
    const double x = -width / 2 + width * (i + 0.5) / ribs;
    b.box(material, {x - 0.02, -0.11, 0.14}, {x + 0.02, -0.03, 0.7});
  }
  for (const double z : {0.18, 0.63}) b.box(material, {-width / 2, -0.09, z}, {width / 2, -0.05, z + 0.03});
}

void table(MeshBuilder& b, const Material& wood, double width, double depth, double height) {
  const double w = width / 2, d = depth / 2;
  b.box(wood, {-w, -d, height - 0.03}, {w, d, height});
  b.box(wood, {-w + 0.07, -d + 0.07, height - 0.1}, {w - 0.07, d - 0.07, height - 0.025});
  for (const double x : {-w + 0.06, w - 0.06}) {
    for (const double y : {-d + 0.06, d - 0.06})
      b.box(wood, {x - 0.028, y - 0.028, 0.002}, {x + 0.028, y + 0.028, height - 0.02});
  }
}

void round_table(MeshBuilder& b, const Material& wood, double radius, double height) {
  b.cylinder(wood, {0, 0, height - 0.03}, {0, 0, height}, radius, radius, 36);
  b.cylinder(wood, {0, 0, 0.03}, {0, 0, height - 0.02}, 0.045, 0.035, 12);
  b.cylinder(wood, {0, 0, 0.002}, {0, 0, 0.04}, radius * 0.6, radius * 0.5, 24);
}

void chair(MeshBuilder& b, const Material& wood, const Material& cloth) {
  constexpr double kHalf = 0.21, kLeg = 0.016;
  b.box(wood, {-kHalf, -kHalf, 0.43}, {kHalf, kHalf, 0.45});
  b.box(cloth, {-kHalf + 0.012, -kHalf + 0.012, 0.451}, {kHalf - 0.012, kHalf - 0.04, 0.48});
  for (const double x : {-kHalf + kLeg, kHalf - kLeg}) {
    b.box(wood, {x - kLeg, -kHalf + 0.002, 0.002}, {x + kLeg, -kHalf + 0.002 + 2 * kLeg, 0.44});
    b.box(wood, {x - kLeg, kHalf - 2 * kLeg, 0.002}, {x + kLeg, kHalf - 0.001, 0.92});
    b.box(wood, {x - 0.01, -kHalf + 0.01, 0.2}, {x + 0.01, kHalf - 0.01, 0.225});
  }
  for (const double z : {0.58, 0.69, 0.8})
    b.box(wood, {-kHalf + kLeg, kHalf - 0.024, z}, {kHalf - kLeg, kHalf - 0.008, z + 0.035});
  for (const double x : {-0.1, 0.0, 0.1})
    b.cylinder(wood, {x, kHalf - 0.016, 0.449}, {x, kHalf - 0.016, 0.82}, 0.006, 0.006, 6);
}

void floor_lamp(MeshBuilder& b, const Materials& m) {
  b.cylinder(m.worktop, {0, 0, 0.002}, {0, 0, 0.03}, 0.14, 0.13, 24);
  b.cylinder(m.steel, {0, 0, 0.029}, {0, 0, 1.55}, 0.011, 0.011, 8);
  b.cylinder(m.linen, {0, 0, 1.45}, {0, 0, 1.72}, 0.2, 0.12, 24);
}

void hanging_lamp(MeshBuilder& b, const Materials& m, double ceiling, double length) {
  b.cylinder(m.black, {0, 0, ceiling - length}, {0, 0, ceiling - 0.002}, 0.005, 0.005, 6);
  b.cylinder(m.clay, {0, 0, ceiling - length - 0.14}, {0, 0, ceiling - length + 0.01}, 0.17, 0.05, 24);
  b.ellipsoid(m.glow, {0, 0, ceiling - length - 0.13}, {0.06, 0.06, 0.06}, 12);
}

void potted_plant(MeshBuilder& b, const Materials& m, double height, uint32_t seed) {
  b.cylinder(m.clay, {0, 0, 0.002}, {0, 0, 0.24}, 0.1, 0.15, 20);
  b.cylinder(m.earth, {0, 0, 0.2}, {0, 0, 0.243}, 0.12, 0.13, 20);
  Random random(seed);
  constexpr int kStems = 7;
  for (int i = 0; i < kStems; ++i) {
    const double angle = 2 * M_PI * (i + 0.4 * random.uniform()) / kStems, lean = random.uniform(0.05, 0.22);
    const Vector3 foot(0.04 * std::cos(angle), 0.04 * std::sin(angle), 0.23);
    const Vector3 top(lean * std::cos(angle), lean * std::sin(angle), height * random.uniform(0.75, 1.0));
    b.cylinder(m.leaf, foot, top, 0.006, 0.003, 5);
    const int leaves = static_cast<int>(10 * height);
    for (int k = 0; k < leaves; ++k) {
      const double t = 0.3 + 0.7 * (k + 0.5) / leaves, turn = 2.4 * k + angle;
      const Vector3 root = foot + t * (top - foot);
      const double length = random.uniform(0.1, 0.2);
      const Vector3 along(length * std::cos(turn), length * std::sin(turn), 0.3 * length);
      blade(b, m.leaf, root, along, 0.16 * length * Vector3(-std::sin(turn), std::cos(turn), 0.2), 0.35 * length);
    }
  }
}

void clothes_rack(MeshBuilder& b, const Materials& m, double width) {
  const double w = width / 2;
  for (const double x : {-w, w}) {
    b.cylinder(m.steel, {x, 0, 0.03}, {x, 0, 1.6}, 0.012, 0.012, 8);
    b.cylinder(m.steel, {x, -0.22, 0.02}, {x, 0.22, 0.02}, 0.014, 0.014, 8);
  }
  b.cylinder(m.steel, {-w, 0, 1.59}, {w, 0, 1.59}, 0.012, 0.012, 8);
  const Material* cloths[] = {&m.red_cloth, &m.linen, &m.blue_cloth, &m.green_cloth};
  const int count = static_cast<int>(width / 0.17);
  for (int i = 0; i < count; ++i) {
    const double x = -w + width * (i + 0.5) / count, bottom = 0.55 + 0.25 * ((i * 5) % 3) / 2.0;
    b.cylinder(m.black, {x, 0, 1.5}, {x, 0, 1.6}, 0.003, 0.003, 5);
    // Shoulders slope from the hook; the cloth hangs below, a little open.
    const Material& cloth = *cloths[i % 4];
    const Vector3 top(x, 0, 1.51), left(x, -0.2, 1.42), right(x, 0.2, 1.42);
    for (const double side : {-1.0, 1.0}) {
      const Vector3 out(side * 0.025, 0, 0), low_left(x + side * 0.035, -0.22, bottom),
          low_right(x + side * 0.03, 0.21, bottom + 0.02);
      const Vector3 a = left + 0.6 * out, c = right + 0.6 * out;
      b.triangle(cloth, top + 0.3 * out, a, c, {0.2, 0}, {0, 0.1}, {0.4, 0.1});
      b.triangle(cloth, a, low_left, low_right, {0, 0.1}, {0, 1.42 - bottom}, {0.42, 1.4 - bottom});
      b.triangle(cloth, a, low_right, c, {0, 0.1}, {0.42, 1.4 - bottom}, {0.4, 0.1});
    }
  }
}

}  // namespace iris::simulate
