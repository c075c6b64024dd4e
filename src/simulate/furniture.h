// Rooms and what stands in them.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "mesh_builder.h"

namespace iris::simulate {

// What most things are made of.
struct Materials {
  explicit Materials(uint32_t seed);

  Material oak, pine, walnut, painted, red_cloth, blue_cloth, green_cloth, linen, curtain, worktop, leaf, earth, clay,
      steel, white, black, glow;
  BookBacks book_backs;
  Material books;
};

enum Side { south, east, north, west };  // of a room: -y, +x, +y, -x

// A rectangular room with its floor at z = 0.
struct Room {
  std::string name;
  double x0, y0, x1, y1, height = 2.6;
  std::array<const Material*, 4> walls{};  // by Side
  const Material* floor = nullptr;
  const Material* ceiling = nullptr;
  const Material* skirting = nullptr;
  std::array<std::vector<Opening>, 4> openings{};  // `from` and `to` in world coordinates (x or y)

  double length(Side side) const { return side == south || side == north ? x1 - x0 : y1 - y0; }
  // Metres along the wall, from the left as seen from inside, of a world coordinate.
  double along(Side side, double world) const;
  // Frame of a wall: x to the right, y into the wall (0 = its face), z up; its origin stands at `world` along the wall.
  void place_at(MeshBuilder& b, Side side, double world) const;
  void build(MeshBuilder& b) const;
};

// Lining of a door between two rooms: the wall fills [from, to] across, the opening is [low, high] along x or y.
void door_frame(MeshBuilder& b, const Material& material, bool wall_along_x, double from, double to, double low,
                double high, double top, const Material& threshold);
// Frame, sill and what is seen outside, for an opening of a room's wall.
void window(MeshBuilder& b, const Room& room, Side side, const Opening& opening, const Material& frame,
            const Material& outside);
void curtains(MeshBuilder& b, const Room& room, Side side, const Opening& opening, const Materials& m,
              const Material& cloth);

// On the wall (frame of Room::place_at): centre at (0, z).
void framed_picture(MeshBuilder& b, const Material& picture, const Material& frame, double z);
void poster(MeshBuilder& b, const Material& picture, double z);

// Against the wall (frame of Room::place_at): middle at x = 0, back at y = 0.
void shelf(MeshBuilder& b, const Materials& m, const Material& wood, double width, double height, double depth,
           uint32_t seed);
void cupboard(MeshBuilder& b, const Materials& m, const Material& body, double width, double height, double depth,
              int doors, double bottom = 0.002);
void kitchen_block(MeshBuilder& b, const Materials& m, const Material& front, double width);
void sofa(MeshBuilder& b, const Material& cloth, const Material& cushion, double width);
void bed(MeshBuilder& b, const Material& wood, const Material& cover, const Material& pillow, double width);
void desk(MeshBuilder& b, const Materials& m, const Material& wood, const Material& screen, const Material& paper,
          double width);
void radiator(MeshBuilder& b, const Material& material, double width);

// About the origin.
void table(MeshBuilder& b, const Material& wood, double width, double depth, double height);
void round_table(MeshBuilder& b, const Material& wood, double radius, double height);
void chair(MeshBuilder& b, const Material& wood, const Material& cloth);  // its back at +y
void floor_lamp(MeshBuilder& b, const Materials& m);
void hanging_lamp(MeshBuilder& b, const Materials& m, double ceiling, double length);
void potted_plant(MeshBuilder& b, const Materials& m, double height, uint32_t seed);
void clothes_rack(MeshBuilder& b, const Materials& m, double width);
void things(MeshBuilder& b, const Materials& m, double width, double depth, int count, uint32_t seed);  // cups, books …

}  // namespace iris::simulate
