// The largest set of correspondences that one rigid motion explains (thesis 5.3.3).
#pragma once

#include <cstdint>
#include <vector>

#include "iris/geometry/rectified_camera.h"
#include "iris/motion/correspondences.h"

namespace iris::motion {

// Symmetric matrix of bits, one row of 64-bit words a correspondence.
class BitMatrix {
 public:
  explicit BitMatrix(int size) : size_(size), words_((size + 63) / 64), bits_(static_cast<size_t>(size) * words_, 0) {}
  int size() const { return size_; }
  int words() const { return words_; }
  void set_pair(int i, int k) {
    row(i)[k / 64] |= uint64_t{1} << (k % 64);
    row(k)[i / 64] |= uint64_t{1} << (i % 64);
  }
  bool at(int i, int k) const { return row(i)[k / 64] >> (k % 64) & 1; }
  uint64_t* row(int i) { return bits_.data() + static_cast<size_t>(i) * words_; }
  const uint64_t* row(int i) const { return bits_.data() + static_cast<size_t>(i) * words_; }

 private:
  int size_, words_;
  std::vector<uint64_t> bits_;
};

// Whether two correspondences can belong to the same rigid motion: their points are equally far apart in both views
// within three standard deviations of that distance (5.2), and the line between them turned by at most `max_turn` [rad]
// (5.3) beyond a known roll [rad] of the current view about its optical axis, clockwise.
bool consistent(const RectifiedCamera& camera, const Correspondence& a, const Correspondence& b, double pixel_error,
                double max_turn, double roll = 0);

// consistent() of all pairs; the diagonal is 0.
BitMatrix consistency_matrix(const RectifiedCamera& camera, const std::vector<Correspondence>& correspondences,
                             double pixel_error, double max_turn, double roll = 0);

// Indices of a set of mutually consistent correspondences, ascending: the one with most consistencies, then again and
// again the one that is consistent with all chosen and keeps most candidates; the lowest index among equals.
std::vector<int> consistent_set(const BitMatrix& matrix);

}  // namespace iris::motion
