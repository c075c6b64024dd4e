// Flat calibration targets. The pattern is geometry: every border between black and white is exactly where it should
// be.
#include <utility>

#include "furniture.h"
#include "scenes.h"

namespace iris::simulate {

namespace {

// The first 35 markers of OpenCV's DICT_4X4_50: 4 x 4 bits, row by row from the upper left, 1 = white.
constexpr uint16_t kMarkers[] = {0xB532, 0x0F9A, 0x332D, 0x9946, 0x549E, 0x79CD, 0x9E2E, 0xC4F2, 0xFEDA,
                                 0xCF56, 0xF991, 0x11A7, 0x0EB7, 0x2A0F, 0x24B1, 0x263E, 0x4665, 0x6600,
                                 0x6C5E, 0x76AF, 0x868B, 0xB02B, 0xCCD5, 0xDD82, 0xFE47, 0x9471, 0xACE4,
                                 0xA554, 0x2123, 0x346F, 0x4415, 0x57B2, 0x9ECF, 0xF0CB, 0x08AE};

constexpr double kHeight = 1.4;  // [m] of the middle

// A sheet that faces -y in the plane y = 0: columns x rows of cells, all of one size, in a white margin.
class Sheet {
 public:
  Sheet(MeshBuilder& b, int columns, int rows, double cell, double margin)
      : b_(b), columns_(columns), rows_(rows), cell_(cell), margin_(margin) {
    const double w = width() / 2 + margin, h = height() / 2 + margin;
    // The margin: four strips that meet edge to edge.
    quad(white_, -margin, -margin, 2 * w, margin);
    quad(white_, -margin, height(), 2 * w, margin);
    quad(white_, -margin, 0, margin, height());
    quad(white_, width(), 0, margin, height());
    // What holds it stands behind.
    b_.group("holder");
    const Material wood_block = plain("holder", {96, 104, 110});
    b_.box(wood_block, {-w, 0.002, kHeight - h}, {w, 0.012, kHeight + h});
    b_.cylinder(wood_block, {0, 0.03, 0.002}, {0, 0.03, kHeight}, 0.017, 0.017, 12);
    b_.group("target");
  }
  double width() const { return columns_ * cell_; }
  double height() const { return rows_ * cell_; }

  // Metres from the upper-left corner of the cells.
  Vector3 point(double x, double y) const { return {x - width() / 2, 0, kHeight + height() / 2 - y}; }
  void quad(const Material& material, double x, double y, double w, double h) {
    b_.quad(material, point(x, y), {w, 0, 0}, {0, 0, -h});
  }
  void cell(int column, int row, bool dark) { quad(dark ? black_ : white_, column * cell_, row * cell_, cell_, cell_); }

  // A marker in the middle of a white cell.
  void marker(int column, int row, uint16_t bits, double edge) {
    const double x0 = column * cell_, y0 = row * cell_, gap = (cell_ - edge) / 2, bit = edge / 6;
    quad(white_, x0, y0, cell_, gap);
    quad(white_, x0, y0 + cell_ - gap, cell_, gap);
    quad(white_, x0, y0 + gap, gap, edge);
    quad(white_, x0 + cell_ - gap, y0 + gap, gap, edge);
    for (int y = 0; y < 6; ++y) {
      for (int x = 0; x < 6; ++x) {
        const bool inner = x > 0 && x < 5 && y > 0 && y < 5;
        const bool light = inner && (bits >> (15 - (4 * (y - 1) + x - 1)) & 1);
        quad(light ? white_ : black_, x0 + gap + x * bit, y0 + gap + y * bit, bit, bit);
      }
    }
  }

 private:
  MeshBuilder& b_;
  int columns_, rows_;
  double cell_, margin_;
  Material white_ = {.name = "paper", .texture = {}, .colour = {235, 236, 236}, .shaded = false};
  Material black_ = {.name = "ink", .texture = {}, .colour = {28, 27, 27}, .shaded = false};
};

}  // namespace

Scene calibration_target(TargetKind kind, uint32_t seed) {
  const uint32_t s = hash(seed, 6);
  Scene scene;
  MeshBuilder b;
  const Material wall = covering("wallpaper", s + 20, [](uint32_t seed, const Extent& extent) {
    return wallpaper(seed, {170, 186, 190}, {120, 150, 130}, extent);
  });
  const Material plaster_wall = covering("plaster", s + 21, [](uint32_t seed, const Extent& extent) {
    return plaster(seed, {176, 196, 204}, 0.08, extent);
  });
  const Material ceiling = covering("ceiling", s + 22, [](uint32_t seed, const Extent& extent) {
    return plaster(seed, {222, 226, 228}, 0.055, extent);
  });
  const Material floor = covering("parquet", s + 23, [](uint32_t seed, const Extent& extent) {
    return parquet(seed, {96, 138, 176}, extent);
  });
  const Room room{.name = "room",
                  .x0 = -2.2,
                  .y0 = -2.4,
                  .x1 = 2.2,
                  .y1 = 1.0,
                  .walls = {&plaster_wall, &plaster_wall, &wall, &plaster_wall},
                  .floor = &floor,
                  .ceiling = &ceiling};
  room.build(b);
  b.group("target");
  b.place(0, 0);
  if (kind == TargetKind::squares) {
    // 7 x 5 dark squares with gaps of their own size (thesis 2.3), on a sheet of A4.
    constexpr double kSquare = 0.02;
    Sheet sheet(b, 13, 9, kSquare, 0.015);
    for (int row = 0; row < 9; ++row) {
      for (int column = 0; column < 13; ++column) {
        const bool dark = row % 2 == 0 && column % 2 == 0;
        sheet.cell(column, row, dark);
        if (!dark) continue;
        for (const auto& [x, y] : {std::pair{0, 0}, {1, 0}, {1, 1}, {0, 1}}) {
          scene.target_corners.push_back(sheet.point((column + x) * kSquare, (row + y) * kSquare));
        }
      }
    }
  } else {
    // 10 x 7 squares of 25 mm (ChArUco: 30 mm, for the sake of its markers of 22.5 mm): 9 x 6 inner corners.
    const bool charuco = kind == TargetKind::charuco;
    const double square = charuco ? 0.03 : 0.025, marker = 0.75 * square;
    Sheet sheet(b, 10, 7, square, charuco ? 0.01 : square);
    int id = 0;
    for (int row = 0; row < 7; ++row) {
      for (int column = 0; column < 10; ++column) {
        const bool dark = (row + column) % 2 == 0;
        if (!dark && charuco) {
          sheet.marker(column, row, kMarkers[id++], marker);
        } else {
          sheet.cell(column, row, dark);
        }
        if (row > 0 && column > 0) scene.target_corners.push_back(sheet.point(column * square, row * square));
      }
    }
  }
  scene.objects = b.take();
  scene.places.look_at = {{0, 0, kHeight}};
  scene.places.look_at_distance = 0.5;
  scene.places.look_at_near = 0.36;
  scene.places.look_at_far = 0.85;
  scene.places.stand = {0, -0.5, kHeight};
  scene.places.stand_look_at = {0, 0, kHeight};
  scene.places.paths = {"around", "static"};
  return scene;
}

}  // namespace iris::simulate
