// The seminar room: tables in a U, a board, a row of windows.
#include "furniture.h"
#include "scenes.h"

namespace iris::simulate {

Scene seminar_room(uint32_t seed) {
  const uint32_t s = hash(seed, 2);
  Scene scene{.name = "seminar-room"};
  MeshBuilder b;
  const Materials m(s);
  const Material wall = covering("plaster", s + 20, [](uint32_t seed, const Extent& extent) {
    return plaster(seed, {190, 206, 210}, 0.07, extent);
  });
  const Material side_wall = covering("side plaster", s + 21, [](uint32_t seed, const Extent& extent) {
    return plaster(seed, {172, 198, 206}, 0.075, extent);
  });
  const Material brick_wall = covering("brick", s + 22, [](uint32_t seed, const Extent& extent) {
    return brick(seed, {96, 124, 176}, extent);
  });
  const Material ceiling = covering("ceiling", s + 23, [](uint32_t seed, const Extent& extent) {
    return tiles(seed, {220, 224, 226}, {214, 220, 224}, 0.6, 256, extent);
  });
  const Material floor = covering("carpet", s + 24, [](uint32_t seed, const Extent& extent) {
    return carpet(seed, {110, 96, 84}, {140, 128, 120}, extent);
  });
  const Room room{.name = "seminar room",
                  .x0 = -4,
                  .y0 = -3,
                  .x1 = 4,
                  .y1 = 3,
                  .height = 3,
                  .walls = {&wall, &side_wall, &wall, &brick_wall},
                  .floor = &floor,
                  .ceiling = &ceiling,
                  .skirting = &m.oak,
                  .openings = {{{{-3.4, -1.4, 0.95, 2.5}, {-1.0, 1.0, 0.95, 2.5}, {1.4, 3.4, 0.95, 2.5}}, {}, {}, {}}}};
  room.build(b);
  b.group("windows");
  uint32_t outside = s + 30;
  for (const Opening& opening : room.openings[south]) {
    ++outside;
    window(b, room, south, opening, m.painted,
           with_texture("outside " + std::to_string(outside - s), view_outside(outside, 2, 1.55), false));
    room.place_at(b, south, (opening.from + opening.to) / 2);
    radiator(b, m.white, 1.4);
  }
  curtains(b, room, south, {-3.4, 3.4, 0.95, 2.5}, m, m.curtain);

  b.group("board");
  const Material board = with_texture("board", chalk_board(s + 40, 3, 1.2), false);
  room.place_at(b, east, 0.3);
  framed_picture(b, board, m.oak, 1.55);
  b.box(m.oak, {-1.5, -0.1, 0.88}, {1.5, -0.006, 0.905});
  room.place_at(b, east, -2.2);
  poster(b, with_texture("notice", printed_page(s + 41, 0.84, 1.19), false), 1.6);

  b.group("door");  // closed, in the north wall
  room.place_at(b, north, 3.1);
  b.box(m.painted, {-0.51, -0.02, 0.002}, {-0.45, -0.004, 2.11});
  b.box(m.painted, {0.45, -0.02, 0.002}, {0.51, -0.004, 2.11});
  b.box(m.painted, {-0.5, -0.022, 2.05}, {0.5, -0.004, 2.113});
  b.box(m.oak, {-0.451, -0.014, 0.004}, {0.451, -0.003, 2.051});
  b.cylinder(m.steel, {0.36, -0.06, 1.05}, {0.24, -0.06, 1.05}, 0.01, 0.01, 8);
  b.cylinder(m.steel, {0.36, -0.06, 1.05}, {0.36, -0.01, 1.05}, 0.01, 0.01, 8);

  b.group("pictures");
  for (int i = 0; i < 3; ++i) {
    room.place_at(b, north, -2.8 + 1.6 * i);
    const uint32_t number = s + 50 + static_cast<uint32_t>(i);
    const Material picture =
        with_texture("picture " + std::to_string(i),
                     i == 1 ? abstract_painting(number, 1.0, 0.8) : landscape(number, 1.0, 0.7), false);
    framed_picture(b, picture, i % 2 ? m.oak : m.walnut, 1.7);
  }

  // A U that opens to the board.
  b.group("tables");
  struct Seat {
    double x, y, yaw;
  };
  std::vector<Seat> tables, chairs;
  for (const double x : {-1.3, 0.1, 1.5}) {
    for (const double side : {-1.0, 1.0}) tables.push_back({x, side * 1.75, 0});
    for (const double dx : {-0.33, 0.33}) {
      chairs.push_back({x + dx, 2.2, dx * 20});
      chairs.push_back({x + dx, -2.2, 180 - dx * 30});
    }
  }
  for (const double y : {-0.72, 0.72}) {
    tables.push_back({-2.4, y, 90});
    for (const double dy : {-0.33, 0.33}) chairs.push_back({-2.85, y + dy, 90 + dy * 20});
  }
  const Material paper = with_texture("paper", printed_page(s + 60, 0.21, 0.297), false);
  const Material other_paper = with_texture("other paper", printed_page(s + 61, 0.21, 0.297), false);
  Random random(s + 62);
  for (const Seat& at : tables) {
    b.place(at.x, at.y, 0, at.yaw);
    table(b, m.oak, 1.36, 0.7, 0.74);
    const double turn = random.uniform(-0.06, 0.06), x = random.uniform(-0.5, 0.1);
    b.picture(random.below(2) ? paper : other_paper, {x, 0.15, 0.742}, {0.21, turn, 0}, {turn * 1.4, -0.297, 0});
    b.place(at.x, at.y, 0.741, at.yaw);
    if (random.below(3)) things(b, m, 1.1, 0.25, 3, s + 63 + static_cast<uint32_t>(&at - tables.data()));
  }
  for (const Seat& at : chairs) {
    b.place(at.x, at.y, 0, at.yaw);
    chair(b, m.walnut, m.blue_cloth);
  }
  b.group("room");
  b.place(3.2, -1.0);
  table(b, m.walnut, 0.7, 0.5, 0.95);  // lectern
  b.place(3.2, -1.0, 0.951);
  b.picture(paper, {-0.15, 0.1, 0.001}, {0.21, 0.03, 0}, {0.04, -0.297, 0});
  room.place_at(b, west, 1.7);
  shelf(b, m, m.walnut, 2.0, 2.1, 0.3, s + 80);
  room.place_at(b, west, -2.0);
  cupboard(b, m, m.oak, 1.2, 1.9, 0.42, 2);
  b.place(3.5, 2.4);
  potted_plant(b, m, 1.4, s + 81);
  for (const double x : {-1.5, 1.5}) {
    b.place(x, 0);
    b.box(m.glow, {-0.6, -0.15, 2.9}, {0.6, 0.15, 2.95});
    for (const double dx : {-0.5, 0.5}) b.cylinder(m.steel, {dx, 0, 2.94}, {dx, 0, 2.998}, 0.006, 0.006, 6);
  }
  scene.objects = b.take();

  scene.places.circle_centre = {0.1, 0, 1.3};
  scene.places.circle_radius = 0.9;
  scene.places.round = {{-1.4, -0.8, 1.3}, {1.2, -0.9, 1.3}, {2.6, -0.4, 1.3},
                        {2.6, 0.8, 1.3},   {1.2, 0.9, 1.3},  {-1.4, 0.8, 1.3}};
  scene.places.stand = {3.2, 2.2, 1.5};
  scene.places.stand_look_at = {-1.5, -0.6, 0.8};
  scene.places.paths = {"circle", "roam", "round", "static"};
  return scene;
}

}  // namespace iris::simulate
