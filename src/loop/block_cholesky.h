// Cholesky factorisation of a sparse symmetric matrix of small dense blocks: one block row a camera pose. Besides
// solving it gives blocks of the inverse (the covariances of poses and of motions between them) without ever forming
// it.
#pragma once

#include <Eigen/Core>
#include <utility>
#include <vector>

namespace iris::loop {

// N: rows of a block; 3 and 6 are there. Sums are in a fixed order: the same input gives the same bits.
template <int N>
class BlockCholesky {
 public:
  using Block = Eigen::Matrix<double, N, N>;

  // `size` block rows; `pairs` name the blocks beside the diagonal that may differ from 0, each either as (i, k) or as
  // (k, i), repeatedly if that is convenient. A pair with a negative index stands for something that is fixed: what is
  // added to it is ignored. The order of elimination is chosen here, once, to keep the factor sparse.
  BlockCholesky(int size, const std::vector<std::pair<int, int>>& pairs);

  int size() const { return size_; }
  size_t factor_blocks() const { return rows_.size(); }  // beside the diagonal

  void set_zero();
  // Adds to block (i, i).
  void add(int i, const Block& block) { diagonal_[new_of_old_[i]] += block; }
  // Adds to block (i, k) of the pair of that index, and its transpose to (k, i).
  void add_pair(int pair, const Block& block);

  // Factorises the matrix with its diagonal's entries times 1 + damping. False: it is not positive definite.
  bool factorise(double damping = 0);

  // Factorises the matrix, which is positive definite but for rounding: with the least damping that makes it so.
  void factorise_nearly();

  // After factorise(): the solution for each column.
  Eigen::MatrixXd solve(const Eigen::MatrixXd& right_side) const;

  // After factorise(): the blocks of the inverse on the diagonal and of the pairs, (i, k) as they were named (0 if one
  // is fixed), by Takahashi's recursion over the pattern of the factor (Takahashi, Fagan and Chin 1973), at about twice
  // the cost of the factorisation.
  struct Inverse {
    std::vector<Block> diagonal, pairs;
  };
  Inverse inverse() const;

 private:
  int size_ = 0;
  std::vector<int> new_of_old_;  // place in the order of elimination
  std::vector<int> start_;       // of each column in rows_, size + 1 entries
  std::vector<int> rows_;        // ascending in each column, all below the diagonal
  struct Slot {
    int place = -1;  // in rows_; -1: ignored
    bool transposed = false;
  };
  std::vector<Slot> slots_;                   // one a pair
  std::vector<Block> diagonal_, below_;       // the matrix
  std::vector<Block> inverse_root_, factor_;  // the inverses of the factor's diagonal blocks, and those below
};

extern template class BlockCholesky<3>;
extern template class BlockCholesky<6>;

}  // namespace iris::loop
