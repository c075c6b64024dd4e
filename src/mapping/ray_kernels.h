// What is the same for every ray, as vectors: several rays at once.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

namespace iris::mapping {

// What rays say about a box.
struct BoxSum {
  uint64_t rays_and_lack = 0;  // kOneRay times their number, plus the sum of 1 - muE
  uint64_t occupied = 0;       // sum of muO
};
// Memberships of 1 are FlogCell::kOne < 2^16, so that the sums of 2^24 rays fit below it.
constexpr int kRayShift = 40;
constexpr uint64_t kOneRay = uint64_t{1} << kRayShift;
constexpr size_t kMostRays = (size_t{1} << 24) - 1;

// Where the sum of a box lies. Boxes are counted from the corner of a region of whole tiles; blocks of them are as wide
// as the powers of two say, and no wider than a tile. The number of a box, in bytes, is put together from those of its
// x, y and z, whose bits are apart: box in block (x, y, z from below), block (x, y, z).
struct BoxLayout {
  int block_shift[3] = {0, 0, 0};      // boxes of a block, as powers of two
  int blocks_shift[2] = {0, 0};        // blocks of the region along x and y, as powers of two
  int boxes[3] = {1, 1, 1};            // of the region
  static constexpr int kBoxShift = 4;  // sizeof(BoxSum)

  int in_block_shift() const { return kBoxShift + block_shift[0] + block_shift[1] + block_shift[2]; }
  size_t boxes_of_block() const { return size_t{1} << (in_block_shift() - kBoxShift); }
  int blocks_z() const { return (boxes[2] + (1 << block_shift[2]) - 1) >> block_shift[2]; }
  size_t blocks() const { return static_cast<size_t>(blocks_z()) << (blocks_shift[0] + blocks_shift[1]); }
};

// Sums of the blocks that rays crossed.
class BlockSums {
 public:
  explicit BlockSums(const BoxLayout& layout)
      : layout_(layout), spare_(layout.boxes_of_block()), table_(layout.blocks() + 1, nullptr) {
    table_.back() = spare_.data();
  }

  const BoxLayout& layout() const { return layout_; }
  BoxSum* const* table() const { return table_.data(); }  // of blocks(), nullptr where none is yet
  size_t spare() const { return table_.size() - 1; }      // a block for what belongs nowhere
  BoxSum* allocate(size_t block);
  const std::vector<uint32_t>& allocated() const { return allocated_; }  // in the order of their first use

 private:
  BoxLayout layout_;
  std::vector<BoxSum> spare_;
  std::vector<BoxSum*> table_;
  std::vector<std::unique_ptr<BoxSum[]>> chunks_;
  size_t left_in_chunk_ = 0;  // blocks
  std::vector<uint32_t> allocated_;
};

// What the rays of a row of pixels have in common, as SightRay has it.
struct SightRow {
  double first[3] = {},
         column_step[3] = {};  // to the point of the first pixel at depth 1, and from one to the next; world
  double f_t;                  // [px m]
  double disparity_offset, min_disparity;  // [px]
  double farthest_z;                       // [m] depth of min_disparity
  double error_scale;                      // [1/m] e of (6.1) by depth and length
  double min_error, max_range;             // [m]
};

// The rays of some rows of pixels, side by side. Row y begins at y * stride; all is 0 where no ray is, and `empty_to`
// far away.
struct RayBand {
  static constexpr int kLevels = 3;           // squares of 2, 4, 8 pixels
  static constexpr int kRows = 1 << kLevels;  // rows of a band
  static constexpr float kFarAway = 1e9f;     // [m]
  // Squares of pixels: the sums of their directions and their number of rays, and how far all of them say that it is
  // empty only [m]. Level 0 = pixels.
  struct Level {
    std::vector<float> direction[3], rays, empty_to;
    size_t stride;
  };
  explicit RayBand(size_t columns);

  size_t columns;
  std::vector<float> length, error, end;  // [m]
  std::vector<float> disparity;           // [px] of the pixels, 0 = none
  Level levels[kLevels + 1];
  // [m] corners of the box of all ends, from the optical centre, which is in it.
  float low[3], high[3];

  size_t stride() const { return levels[0].stride; }
  void clear();  // no rays in any row
};

// The disparities of a row become its rays, and extend the box of all ends.
void sight_row(const SightRow& row, int y, RayBand& band);

// The levels of squares from the first one.
void sum_squares(RayBand& band);

// The grid as the walk sees it.
struct WalkGrid {
  double box[3], inverse_box[3];  // [m], [1/m]
  double start[3];                // [boxes] optical centre, from the corner of the region
  bool clip_z = false;            // rays may leave the region through its bottom and its top
};

// Parts of rays, or of several that are followed together.
struct Ways {
  static constexpr size_t kMost = 8;
  alignas(64) float direction[3][kMost] = {};
  alignas(64) float from[kMost] = {}, end[kMost] = {};      // [m]
  alignas(64) float length[kMost] = {}, error[kMost] = {};  // [m] of (6.1); unused for empty ways
  alignas(64) uint64_t rays[kMost] = {};                    // 1 unless empty
  size_t count = 0;
};

// Adds what the ways say about the boxes that they cross: (6.1), or of all of them that they are empty.
void walk_rays(const WalkGrid& grid, Ways& ways, BlockSums& sums);
void walk_empty(const WalkGrid& grid, Ways& ways, BlockSums& sums);

}  // namespace iris::mapping
