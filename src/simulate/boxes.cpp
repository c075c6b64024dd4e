// Two boxes on a table, seen from all sides (thesis fig. 6.4).
#include "furniture.h"
#include "scenes.h"

namespace iris::simulate {

Scene boxes(uint32_t seed) {
  const uint32_t s = hash(seed, 4);
  Scene scene{.name = "boxes"};
  MeshBuilder b;
  const Materials m(s);
  const Material wall = covering("plaster", s + 20, [](uint32_t seed, const Extent& extent) {
    return plaster(seed, {186, 206, 212}, 0.08, extent);
  });
  const Material papered = covering("wallpaper", s + 21, [](uint32_t seed, const Extent& extent) {
    return wallpaper(seed, {200, 208, 214}, {150, 140, 110}, extent);
  });
  const Material brick_wall = covering("brick", s + 22, [](uint32_t seed, const Extent& extent) {
    return brick(seed, {92, 120, 176}, extent);
  });
  const Material ceiling = covering("ceiling", s + 23, [](uint32_t seed, const Extent& extent) {
    return plaster(seed, {222, 226, 228}, 0.055, extent);
  });
  const Material floor = covering("parquet", s + 24, [](uint32_t seed, const Extent& extent) {
    return parquet(seed, {96, 138, 176}, extent);
  });
  const Room room{.name = "room",
                  .x0 = -3.2,
                  .y0 = -3,
                  .x1 = 3.2,
                  .y1 = 3,
                  .walls = {&wall, &papered, &brick_wall, &papered},
                  .floor = &floor,
                  .ceiling = &ceiling,
                  .skirting = &m.oak};
  room.build(b);
  b.group("room");
  room.place_at(b, north, 1.6);
  shelf(b, m, m.walnut, 1.4, 2.0, 0.3, s + 30);
  room.place_at(b, west, 1.5);
  cupboard(b, m, m.pine, 1.2, 1.0, 0.42, 2);
  room.place_at(b, east, -1.5);
  framed_picture(b, with_texture("landscape", landscape(s + 31, 1.2, 0.8), false), m.oak, 1.5);
  room.place_at(b, south, 0.3);
  framed_picture(b, with_texture("painting", abstract_painting(s + 32, 1.1, 0.8), false), m.walnut, 1.5);
  room.place_at(b, west, -1.2);
  poster(b, with_texture("poster", printed_page(s + 33, 0.84, 1.19), false), 1.5);
  b.place(2.7, 2.5);
  potted_plant(b, m, 1.4, s + 34);
  b.place(-2.7, -2.5);
  floor_lamp(b, m);

  b.group("table");
  b.place(0, 0);
  round_table(b, m.oak, 0.5, 0.75);
  b.group("big box");
  const Material carton = with_texture("carton", granite(s + 40, {110, 150, 185}), true);
  b.place(0, 0, 0.752);
  b.box(carton, {-0.2, -0.14, 0}, {0.2, 0.14, 0.34});
  const Material label = with_texture("label", printed_page(s + 41, 0.28, 0.2), false);
  const Material print = with_texture("print", abstract_painting(s + 42, 0.3, 0.24), false);
  b.picture(label, {-0.14, -0.1405, 0.28}, {0.28, 0, 0}, {0, 0, -0.2});
  b.picture(print, {0.15, 0.1405, 0.3}, {-0.3, 0, 0}, {0, 0, -0.24});
  b.group("small box");
  b.place(0.13, 0.28, 0.752);
  b.box(m.red_cloth, {-0.08, -0.06, 0}, {0.08, 0.06, 0.18});
  b.picture(label, {0.07, 0.0605, 0.15}, {-0.14, 0, 0}, {0, 0, -0.1});
  scene.objects = b.take();

  scene.places.look_at = {{0, 0, 0.92}};
  scene.places.look_at_distance = 1.1;
  scene.places.look_at_near = 1.6;
  scene.places.look_at_far = 2.0;
  scene.places.circle_centre = {1.9, -1.0, 1.4};
  scene.places.circle_radius = 0.8;
  scene.places.stand = {1.0, -1.1, 1.35};
  scene.places.stand_look_at = {0, 0, 0.9};
  scene.places.paths = {"circle", "circle-far", "roam", "static"};
  return scene;
}

}  // namespace iris::simulate
