// Six rooms on both sides of a hall, joined by open doors: rooms of a home, with what makes stereo hard in one.
//
//   y
//   9.0 +-----------+----------+-----------+
//       | bedroom   | study    | child     |
//   5.4 +----  -----+---  -----+----  -----+   walls are 0.1 m thick, doors 0.9 m wide
//       |              hall                |
//   3.9 +-------  --+---  -----+--  -------+
//       | living               | bath      |
//       | room        kitchen  |           |
//   0.0 +-----------+----------+-----------+
//       0          5.0        8.1         11.0  x
#include "furniture.h"
#include "scenes.h"

namespace iris::simulate {

Scene apartment(uint32_t seed) {
  const uint32_t s = hash(seed, 1);
  Scene scene{.name = "apartment"};
  MeshBuilder b;
  const Materials m(s);

  // Walls: each room has its own; one side of the hall and one of the bedroom are bare, one stripe of the bedroom
  // repeats exactly.
  const Material hall_wall = covering("hall plaster", s + 20, [](uint32_t seed, const Extent& extent) {
    return plaster(seed, {186, 212, 222}, 0.075, extent);
  });
  const Material living_wall = covering("living wallpaper", s + 21, [](uint32_t seed, const Extent& extent) {
    return wallpaper(seed, {196, 214, 218}, {128, 158, 142}, extent);
  });
  const Material kitchen_wall = covering("kitchen plaster", s + 22, [](uint32_t seed, const Extent& extent) {
    return plaster(seed, {160, 205, 214}, 0.08, extent);
  });
  const Material kitchen_tiles = covering("kitchen tiles", s + 23, [](uint32_t seed, const Extent& extent) {
    return tiles(seed, {205, 212, 208}, {196, 176, 150}, 0.15, 96, extent);
  });
  const Material bath_tiles = covering("bath tiles", s + 24, [](uint32_t seed, const Extent& extent) {
    return tiles(seed, {214, 200, 180}, {200, 178, 150}, 0.2, 96, extent);
  });
  const Material bedroom_wall = covering("bedroom wallpaper", s + 25, [](uint32_t seed, const Extent& extent) {
    return wallpaper(seed, {205, 205, 222}, {160, 130, 170}, extent);
  });
  const Material bedroom_stripes =
      with_texture("striped wallpaper", stripes({205, 214, 222}, {150, 120, 95}, 0.09), false);
  const Material study_wall = covering("study brick", s + 26, [](uint32_t seed, const Extent& extent) {
    return brick(seed, {82, 108, 168}, extent);
  });
  const Material study_plaster = covering("study plaster", s + 27, [](uint32_t seed, const Extent& extent) {
    return plaster(seed, {196, 204, 196}, 0.075, extent);
  });
  const Material child_wall = covering("child plaster", s + 28, [](uint32_t seed, const Extent& extent) {
    return plaster(seed, {208, 206, 176}, 0.08, extent);
  });
  Material bare_hall = plain("bare hall wall", {200, 214, 220}),
           bare_bedroom = plain("bare bedroom wall", {214, 216, 228});
  bare_hall.shaded = bare_bedroom.shaded = false;
  const Material ceiling = covering("ceiling", s + 29, [](uint32_t seed, const Extent& extent) {
    return plaster(seed, {222, 226, 228}, 0.055, extent);
  });
  const Material oak_floor = covering("oak parquet", s + 30, [](uint32_t seed, const Extent& extent) {
    return parquet(seed, {98, 142, 182}, extent);
  });
  const Material dark_floor = covering("walnut parquet", s + 31, [](uint32_t seed, const Extent& extent) {
    return parquet(seed, {74, 104, 140}, extent);
  });
  const Material kitchen_floor = covering("kitchen floor", s + 32, [](uint32_t seed, const Extent& extent) {
    return tiles(seed, {170, 184, 190}, {110, 118, 128}, 0.3, 128, extent);
  });
  const Material bath_floor = with_texture("bath floor", exact_tiles(s + 33, {190, 180, 170}, 0.2), false);
  const Material soft_floor = covering("carpet", s + 34, [](uint32_t seed, const Extent& extent) {
    return carpet(seed, {140, 120, 104}, {172, 158, 138}, extent);
  });

  constexpr double kDoor = 2.05;
  const Opening living_hall{2.6, 3.5, 0, kDoor}, kitchen_hall{6.0, 6.9, 0, kDoor}, bath_hall{8.6, 9.5, 0, kDoor},
      living_kitchen{2.35, 3.25, 0, kDoor}, bedroom_hall{1.5, 2.4, 0, kDoor}, study_hall{5.3, 6.2, 0, kDoor},
      child_hall{8.8, 9.7, 0, kDoor};
  const Opening living_window{1.0, 3.2, 0.95, 2.2}, living_west{0.5, 1.1, 0.95, 2.2},
      kitchen_window{6.0, 7.1, 1.15, 2.2}, bath_window{1.2, 2.0, 1.3, 2.1}, study_window{5.0, 6.6, 1.35, 2.25},
      child_window{5.9, 6.9, 0.95, 2.15}, bedroom_window{6.9, 8.3, 0.9, 2.2}, hall_window{4.2, 5.0, 1.0, 2.1};

  const Room hall{
      .name = "hall",
      .x0 = 0,
      .y0 = 3.9,
      .x1 = 11,
      .y1 = 5.3,
      .walls = {&hall_wall, &hall_wall, &hall_wall, &bare_hall},
      .floor = &dark_floor,
      .ceiling = &ceiling,
      .skirting = &m.walnut,
      .openings = {
          {{living_hall, kitchen_hall, bath_hall}, {hall_window}, {bedroom_hall, study_hall, child_hall}, {}}}};
  const Room living{.name = "living room",
                    .x0 = 0,
                    .y0 = 0,
                    .x1 = 5,
                    .y1 = 3.8,
                    .walls = {&living_wall, &living_wall, &living_wall, &living_wall},
                    .floor = &oak_floor,
                    .ceiling = &ceiling,
                    .skirting = &m.oak,
                    .openings = {{{living_window}, {living_kitchen}, {living_hall}, {living_west}}}};
  const Room kitchen{.name = "kitchen",
                     .x0 = 5.1,
                     .y0 = 0,
                     .x1 = 8,
                     .y1 = 3.8,
                     .walls = {&kitchen_tiles, &kitchen_wall, &kitchen_wall, &kitchen_wall},
                     .floor = &kitchen_floor,
                     .ceiling = &ceiling,
                     .skirting = nullptr,
                     .openings = {{{kitchen_window}, {}, {kitchen_hall}, {living_kitchen}}}};
  const Room bath{.name = "bath",
                  .x0 = 8.1,
                  .y0 = 0,
                  .x1 = 11,
                  .y1 = 3.8,
                  .walls = {&bath_tiles, &bath_tiles, &bath_tiles, &bath_tiles},
                  .floor = &bath_floor,
                  .ceiling = &ceiling,
                  .skirting = nullptr,
                  .openings = {{{}, {bath_window}, {bath_hall}, {}}}};
  const Room bedroom{.name = "bedroom",
                     .x0 = 0,
                     .y0 = 5.4,
                     .x1 = 4.2,
                     .y1 = 9,
                     .walls = {&bedroom_wall, &bare_bedroom, &bedroom_stripes, &bedroom_wall},
                     .floor = &soft_floor,
                     .ceiling = &ceiling,
                     .skirting = &m.painted,
                     .openings = {{{bedroom_hall}, {}, {}, {bedroom_window}}}};
  const Room study{.name = "study",
                   .x0 = 4.3,
                   .y0 = 5.4,
                   .x1 = 7.4,
                   .y1 = 9,
                   .walls = {&study_plaster, &study_wall, &study_plaster, &study_wall},
                   .floor = &oak_floor,
                   .ceiling = &ceiling,
                   .skirting = &m.oak,
                   .openings = {{{study_hall}, {}, {study_window}, {}}}};
  const Room child{.name = "child's room",
                   .x0 = 7.5,
                   .y0 = 5.4,
                   .x1 = 11,
                   .y1 = 9,
                   .walls = {&child_wall, &child_wall, &child_wall, &child_wall},
                   .floor = &dark_floor,
                   .ceiling = &ceiling,
                   .skirting = &m.painted,
                   .openings = {{{child_hall}, {child_window}, {}, {}}}};
  for (const Room* room : {&hall, &living, &kitchen, &bath, &bedroom, &study, &child}) room->build(b);

  b.group("doors");
  for (const Opening& door : {living_hall, kitchen_hall, bath_hall}) {
    door_frame(b, m.painted, true, 3.8, 3.9, door.from, door.to, kDoor, m.oak);
  }
  for (const Opening& door : {bedroom_hall, study_hall, child_hall}) {
    door_frame(b, m.painted, true, 5.3, 5.4, door.from, door.to, kDoor, m.oak);
  }
  door_frame(b, m.painted, false, 5.0, 5.1, living_kitchen.from, living_kitchen.to, kDoor, m.oak);

  b.group("windows");
  uint32_t outside = s + 40;
  const auto add_window = [&](const Room& room, Side side, const Opening& opening, const Material* cloth) {
    const Material view =
        with_texture("outside of " + room.name + std::to_string(side),
                     view_outside(++outside, opening.to - opening.from, opening.top - opening.bottom), false);
    window(b, room, side, opening, m.painted, view);
    if (cloth) curtains(b, room, side, opening, m, *cloth);
  };
  add_window(living, south, living_window, &m.curtain);
  add_window(living, west, living_west, nullptr);
  add_window(kitchen, south, kitchen_window, nullptr);
  add_window(bath, east, bath_window, nullptr);
  add_window(bedroom, west, bedroom_window, &m.linen);
  add_window(study, north, study_window, nullptr);
  add_window(child, east, child_window, &m.blue_cloth);
  add_window(hall, east, hall_window, nullptr);

  uint32_t painting = s + 60;
  const auto hang = [&](const Room& room, Side side, double at, double z, double width, double height, bool abstract) {
    ++painting;
    const Material picture =
        with_texture("painting " + std::to_string(painting - s),
                     abstract ? abstract_painting(painting, width, height) : landscape(painting, width, height), false);
    room.place_at(b, side, at);
    framed_picture(b, picture, painting % 2 ? m.walnut : m.oak, z);
  };
  const auto pin = [&](const Room& room, Side side, double at, double z, double width, double height) {
    ++painting;
    room.place_at(b, side, at);
    poster(b, with_texture("poster " + std::to_string(painting - s), printed_page(painting, width, height), false), z);
  };

  // --- living room
  b.group("living room");
  living.place_at(b, south, 1.7);
  sofa(b, m.green_cloth, m.red_cloth, 2.1);
  living.place_at(b, west, 2.3);
  shelf(b, m, m.walnut, 1.6, 2.0, 0.3, s + 101);
  const Material living_rug = with_texture("living rug", rug(s + 102, 2.0, 1.4), false);
  b.place(2.3, 2.15, 0.006);
  b.picture(living_rug, {-1.0, 0.7, 0}, {2.0, 0, 0}, {0, -1.4, 0});
  b.place(2.3, 2.15, 0.007);
  table(b, m.oak, 1.1, 0.65, 0.5);
  b.place(2.3, 2.15, 0.507);
  things(b, m, 0.9, 0.5, 4, s + 103);
  b.place(3.2, 0.4);
  floor_lamp(b, m);
  b.place(4.55, 3.5);
  potted_plant(b, m, 1.3, s + 104);
  living.place_at(b, east, 1.05);
  cupboard(b, m, m.walnut, 1.6, 0.55, 0.42, 3);
  const Material television = with_texture("television", landscape(s + 105, 1.0, 0.56), false);
  b.box(m.black, {-0.2, -0.3, 0.553}, {0.2, -0.14, 0.57});
  b.box(m.black, {-0.53, -0.235, 0.565}, {0.53, -0.2, 1.2});
  b.picture(television, {-0.5, -0.237, 1.17}, {1.0, 0, 0}, {0, 0, -0.56});
  b.place(2.3, 2.1);
  hanging_lamp(b, m, 2.6, 0.35);
  hang(living, north, 1.2, 1.55, 1.1, 0.7, false);
  hang(living, north, 4.2, 1.6, 0.5, 0.6, true);
  hang(living, west, 3.45, 1.6, 0.4, 0.5, true);
  hang(living, south, 4.1, 1.6, 0.6, 0.8, true);

  // --- kitchen
  b.group("kitchen");
  kitchen.place_at(b, south, 6.3);
  kitchen_block(b, m, m.pine, 2.1);
  kitchen.place_at(b, south, 5.5);
  cupboard(b, m, m.pine, 0.7, 0.7, 0.34, 2, 1.5);
  kitchen.place_at(b, south, 7.66);
  cupboard(b, m, m.white, 0.6, 1.85, 0.6, 1);  // refrigerator: nothing to match on it
  kitchen.place_at(b, south, 6.25);
  b.place(6.25, 0.13, 0.9);
  things(b, m, 0.5, 0.2, 3, s + 110);
  b.place(6.55, 2.0);
  table(b, m.pine, 0.9, 0.7, 0.75);
  b.place(6.55, 2.0, 0.751);
  things(b, m, 0.7, 0.5, 4, s + 111);
  b.place(6.5, 2.42);
  chair(b, m.pine, m.red_cloth);
  b.place(6.6, 1.62, 0, 180);
  chair(b, m.pine, m.red_cloth);
  b.place(6.55, 2.0);
  hanging_lamp(b, m, 2.6, 0.45);
  kitchen.place_at(b, east, 3.3);
  shelf(b, m, m.pine, 0.7, 1.0, 0.26, s + 112);
  hang(kitchen, east, 2.2, 1.6, 0.5, 0.5, true);
  pin(kitchen, east, 1.3, 1.6, 0.42, 0.6);
  hang(kitchen, west, 1.3, 1.6, 0.6, 0.4, false);
  hang(kitchen, north, 7.4, 1.65, 0.4, 0.5, false);

  // --- bath
  b.group("bath");
  bath.place_at(b, south, 9.05);
  b.box(m.white, {-0.85, -0.75, 0.002}, {0.85, -0.7, 0.58});
  b.box(m.white, {-0.85, -0.06, 0.002}, {0.85, -0.015, 0.58});
  b.box(m.white, {-0.85, -0.701, 0.003}, {-0.8, -0.059, 0.579});
  b.box(m.white, {0.8, -0.701, 0.003}, {0.85, -0.059, 0.579});
  b.box(m.white, {-0.801, -0.702, 0.004}, {0.801, -0.058, 0.15});
  b.cylinder(m.steel, {0.4, -0.02, 0.75}, {0.4, -0.17, 0.75}, 0.018, 0.018, 8);
  bath.place_at(b, south, 10.6);
  cupboard(b, m, m.white, 0.62, 0.85, 0.6, 1);
  b.cylinder(m.steel, {0, -0.601, 0.45}, {0, -0.625, 0.45}, 0.2, 0.19, 28);
  b.cylinder(m.black, {0, -0.62, 0.45}, {0, -0.63, 0.45}, 0.15, 0.14, 28);
  b.place(10.6, 0.3, 0.854);
  things(b, m, 0.5, 0.4, 4, s + 120);
  bath.place_at(b, east, 2.75);
  cupboard(b, m, m.painted, 0.7, 0.8, 0.42, 2);
  b.ellipsoid(m.white, {0, -0.22, 0.86}, {0.26, 0.18, 0.09}, 20);
  b.cylinder(m.steel, {0, -0.05, 0.8}, {0, -0.05, 1.0}, 0.014, 0.014, 8);
  b.cylinder(m.steel, {0, -0.05, 0.99}, {0, -0.17, 0.98}, 0.011, 0.011, 8);
  hang(bath, east, 2.75, 1.6, 0.5, 0.5, false);
  bath.place_at(b, west, 1.6);
  b.cylinder(m.white, {0, -0.33, 0.002}, {0, -0.33, 0.38}, 0.12, 0.19, 20);
  b.ellipsoid(m.white, {0, -0.34, 0.4}, {0.19, 0.22, 0.035}, 20);
  b.box(m.white, {-0.19, -0.17, 0.36}, {0.19, -0.015, 0.78});
  bath.place_at(b, west, 2.7);
  for (const double z : {0.7, 1.0, 1.3}) b.cylinder(m.steel, {-0.35, -0.06, z}, {0.35, -0.06, z}, 0.012, 0.012, 8);
  for (const double x : {-0.35, 0.35}) b.cylinder(m.steel, {x, -0.06, 0.5}, {x, -0.06, 1.5}, 0.014, 0.014, 8);
  b.box(m.red_cloth, {-0.3, -0.085, 0.75}, {0.0, -0.072, 1.315});
  b.box(m.blue_cloth, {0.05, -0.085, 0.62}, {0.3, -0.072, 1.015});
  const Material bath_rug = with_texture("bath mat", rug(s + 121, 0.9, 0.6), false);
  b.place(9.2, 1.2, 0.006);
  b.picture(bath_rug, {-0.45, 0.3, 0}, {0.9, 0, 0}, {0, -0.6, 0});
  hang(bath, north, 10.3, 1.6, 0.4, 0.5, true);

  // --- bedroom
  b.group("bedroom");
  bedroom.place_at(b, north, 2.3);
  bed(b, m.pine, m.blue_cloth, m.linen, 1.6);
  for (const double x : {1.2, 3.4}) {
    bedroom.place_at(b, north, x);
    cupboard(b, m, m.pine, 0.42, 0.48, 0.4, 1);
    b.cylinder(m.clay, {0, -0.2, 0.484}, {0, -0.2, 0.7}, 0.06, 0.03, 14);
    b.cylinder(m.linen, {0, -0.2, 0.69}, {0, -0.2, 0.87}, 0.12, 0.07, 18);
  }
  bedroom.place_at(b, south, 3.35);
  cupboard(b, m, m.pine, 1.5, 2.1, 0.58, 3);
  bedroom.place_at(b, north, 4.0);
  b.place(3.75, 7.4);
  clothes_rack(b, m, 0.7);
  hang(bedroom, west, 6.2, 1.6, 0.5, 0.7, false);
  hang(bedroom, east, 7.9, 1.6, 0.6, 0.45, true);
  hang(bedroom, south, 0.8, 1.6, 0.6, 0.45, false);
  const Material bedroom_rug = with_texture("bedroom rug", rug(s + 131, 0.8, 1.6), false);
  b.place(0.75, 7.4, 0.006);
  b.picture(bedroom_rug, {-0.4, 0.8, 0}, {0.8, 0, 0}, {0, -1.6, 0});
  b.place(2.3, 6.7);
  hanging_lamp(b, m, 2.6, 0.25);

  // --- study
  b.group("study");
  const Material screen = with_texture("screen", printed_page(s + 140, 0.54, 0.32), false);
  const Material paper = with_texture("paper", printed_page(s + 141, 0.21, 0.297), false);
  study.place_at(b, north, 5.75);
  desk(b, m, m.oak, screen, paper, 1.6);
  b.place(5.7, 8.1, 0, 180);
  chair(b, m.walnut, m.green_cloth);
  study.place_at(b, west, 7.3);
  shelf(b, m, m.oak, 1.8, 2.1, 0.28, s + 142);
  study.place_at(b, east, 7.0);
  shelf(b, m, m.oak, 2.0, 1.2, 0.28, s + 143);
  b.place(7.26, 7.0, 1.2);
  things(b, m, 0.2, 0.2, 1, s + 144);
  b.place(5.8, 6.6);
  round_table(b, m.walnut, 0.28, 0.55);
  b.place(5.8, 6.6, 0.551);
  b.ellipsoid(m.blue_cloth, {0, 0, 0.13}, {0.13, 0.13, 0.13}, 20);
  hang(study, east, 6.4, 1.75, 0.7, 0.5, false);
  hang(study, east, 7.5, 1.75, 0.4, 0.5, true);
  pin(study, south, 4.85, 1.5, 0.6, 0.84);
  pin(study, south, 6.85, 1.5, 0.6, 0.84);
  b.place(4.62, 8.6);
  potted_plant(b, m, 1.5, s + 145);

  // --- child's room
  b.group("child's room");
  child.place_at(b, north, 10.5);
  bed(b, m.painted, m.red_cloth, m.linen, 0.9);
  child.place_at(b, north, 8.5);
  shelf(b, m, m.pine, 1.4, 1.4, 0.3, s + 150);
  b.place(8.4, 8.84, 1.4);
  things(b, m, 0.8, 0.2, 3, s + 151);
  child.place_at(b, west, 7.6);
  desk(b, m, m.painted, with_texture("child's screen", abstract_painting(s + 152, 0.5, 0.3), false), paper, 1.1);
  b.place(10.35, 5.68);
  clothes_rack(b, m, 0.8);
  const Material child_rug = with_texture("child's rug", rug(s + 153, 1.6, 1.6), false);
  b.place(9.1, 7.3, 0.006);
  b.picture(child_rug, {-0.8, 0.8, 0}, {1.6, 0, 0}, {0, -1.6, 0});
  b.place(9.1, 7.3, 0.007);
  b.ellipsoid(m.red_cloth, {0.1, 0.2, 0.14}, {0.14, 0.14, 0.14}, 20);
  b.box(m.clay, {-0.25, -0.3, 0.001}, {-0.1, -0.15, 0.15});
  b.box(m.blue_cloth, {-0.22, -0.28, 0.151}, {-0.12, -0.18, 0.25});
  b.cylinder(m.pine, {0.2, -0.3, 0.001}, {0.2, -0.3, 0.2}, 0.07, 0.05, 16);
  hang(child, west, 6.3, 1.5, 0.6, 0.6, true);
  hang(child, north, 9.6, 1.7, 0.5, 0.4, false);
  pin(child, east, 8.1, 1.55, 0.6, 0.84);
  pin(child, south, 8.1, 1.5, 0.7, 0.5);
  b.place(9.1, 7.2);
  hanging_lamp(b, m, 2.6, 0.25);

  // --- hall
  b.group("hall");
  hall.place_at(b, north, 3.9);
  cupboard(b, m, m.walnut, 1.0, 0.8, 0.24, 3);
  b.place(3.9, 5.17, 0.803);
  things(b, m, 0.8, 0.1, 3, s + 160);
  hall.place_at(b, south, 4.7);
  b.box(m.walnut, {-0.5, -0.03, 1.7}, {0.5, -0.005, 1.8});
  const Material* coats[] = {&m.blue_cloth, &m.green_cloth, &m.red_cloth};
  for (int i = 0; i < 4; ++i) {
    const double x = -0.38 + 0.25 * i;
    b.cylinder(m.steel, {x, -0.028, 1.74}, {x, -0.1, 1.76}, 0.006, 0.006, 6);
    if (i == 2) continue;
    b.cylinder(*coats[i % 3], {x, -0.085, 1.0}, {x, -0.075, 1.72}, 0.1, 0.035, 12);
  }
  hang(hall, north, 0.75, 1.55, 0.6, 0.45, false);
  hang(hall, north, 7.3, 1.55, 0.9, 0.6, true);
  hang(hall, south, 1.3, 1.55, 0.9, 0.6, false);
  hang(hall, south, 7.7, 1.55, 0.5, 0.7, true);
  pin(hall, south, 10.3, 1.5, 0.6, 0.84);
  hang(hall, north, 10.3, 1.55, 0.5, 0.5, false);
  pin(hall, north, 8.2, 1.5, 0.42, 0.6);
  const Material runner = with_texture("runner", rug(s + 161, 3.2, 0.7), false);
  for (const double x : {2.4, 8.0}) {
    b.place(x, 4.6, 0.006);
    b.picture(runner, {-1.6, 0.35, 0}, {3.2, 0, 0}, {0, -0.7, 0});
  }
  b.place(10.75, 5.05);
  potted_plant(b, m, 1.1, s + 162);
  for (const double x : {2.2, 5.5, 8.8}) {
    b.place(x, 4.6);
    hanging_lamp(b, m, 2.6, 0.16);
  }

  scene.objects = b.take();

  constexpr double kEye = 1.4;
  const std::vector<Vector2> round = {
      {1.4, 4.42}, {1.95, 4.65}, {1.95, 5.35},  {1.95, 6.3},  {1.2, 6.45}, {0.55, 6.6},  {0.55, 7.9},
      {0.95, 7.9}, {0.95, 6.5},  {1.95, 6.25},  {1.95, 4.6},  // bedroom
      {3.05, 4.6}, {3.05, 3.85}, {3.05, 3.15},  {1.05, 3.1},  {1.05, 1.4}, {3.6, 1.35},  {4.15, 2.2},
      {4.2, 2.8},  // living
      {5.05, 2.8}, {5.65, 2.75}, {5.65, 1.2},   {7.45, 1.2},  {7.45, 2.6}, {6.45, 3.2},  {6.45, 3.85},
      {6.45, 4.6},  // kitchen
      {5.75, 4.6}, {5.75, 5.35}, {5.75, 5.8},   {6.5, 6.1},   {6.5, 7.3},  {5.75, 7.4},  {5.1, 7.2},
      {5.1, 6.1},  {5.75, 5.8},  {5.75, 4.6},  // study
      {9.25, 4.6}, {9.25, 5.35}, {9.25, 6.0},   {9.6, 6.6},   {9.55, 7.9}, {8.75, 7.95}, {8.65, 6.8},
      {9.25, 6.0}, {9.25, 4.6},  {9.05, 4.6},   {9.05, 3.85}, {9.05, 3.2}, {9.15, 1.45}, {9.95, 1.4},
      {9.95, 2.9}, {9.05, 3.3},  {9.05, 4.4},                                                            // bath
      {9.6, 4.45}, {10.15, 4.4}, {10.15, 4.75}, {9.0, 4.6},   {1.6, 4.75}, {0.75, 4.75}, {0.75, 4.42}};  // hall
  for (const Vector2& p : round) scene.places.round.emplace_back(p.x(), p.y(), kEye);
  scene.places.corridor = {{0.8, 4.6, kEye}, {10.0, 4.6, kEye}};
  scene.places.circle_centre = {2.3, 2.1, kEye};
  scene.places.circle_radius = 0.7;
  scene.places.stand = {4.3, 3.3, kEye};
  scene.places.stand_look_at = {1.0, 0.8, 1.0};
  scene.places.paths = {"round", "corridor", "circle", "roam", "static"};
  return scene;
}

}  // namespace iris::simulate
