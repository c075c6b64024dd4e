#include "block_cholesky.h"

#include <Eigen/Cholesky>
#include <Eigen/OrderingMethods>
#include <Eigen/SparseCore>
#include <algorithm>

#include "iris/core/error.h"

namespace iris::loop {
namespace {

// Place of each row in an order of elimination that keeps the factor sparse (approximate minimum degree).
std::vector<int> elimination_order(int size, const std::vector<std::pair<int, int>>& pairs) {
  std::vector<Eigen::Triplet<double>> entries;
  for (int i = 0; i < size; ++i) entries.emplace_back(i, i, 1);
  for (const auto& [i, k] : pairs) {
    if (i < 0 || k < 0) continue;
    entries.emplace_back(i, k, 1);
    entries.emplace_back(k, i, 1);
  }
  Eigen::SparseMatrix<double> pattern(size, size);
  pattern.setFromTriplets(entries.begin(), entries.end());
  Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int> old_of_new;
  if (size > 0) Eigen::AMDOrdering<int>()(pattern, old_of_new);
  std::vector<int> new_of_old(static_cast<size_t>(size));
  for (int i = 0; i < size; ++i) new_of_old[old_of_new.indices()(i)] = i;
  return new_of_old;
}

}  // namespace

template <int N>
BlockCholesky<N>::BlockCholesky(int size, const std::vector<std::pair<int, int>>& pairs)
    : size_(size), new_of_old_(elimination_order(size, pairs)) {
  // The rows of each column of the factor: those of the matrix and those of the columns that are eliminated into it.
  std::vector<std::vector<int>> columns(static_cast<size_t>(size));
  for (const auto& [i, k] : pairs) {
    if (i < 0 || k < 0) continue;
    IRIS_CHECK(i < size && k < size && i != k);
    const auto [column, row] = std::minmax(new_of_old_[i], new_of_old_[k]);
    columns[column].push_back(row);
  }
  start_.push_back(0);
  for (int column = 0; column < size; ++column) {
    std::vector<int>& rows = columns[column];
    std::sort(rows.begin(), rows.end());
    rows.erase(std::unique(rows.begin(), rows.end()), rows.end());
    if (!rows.empty()) columns[rows.front()].insert(columns[rows.front()].end(), rows.begin() + 1, rows.end());
    rows_.insert(rows_.end(), rows.begin(), rows.end());
    start_.push_back(static_cast<int>(rows_.size()));
    std::vector<int>().swap(rows);
  }
  for (const auto& [i, k] : pairs) {
    Slot& slot = slots_.emplace_back();
    if (i < 0 || k < 0) continue;
    const auto [column, row] = std::minmax(new_of_old_[i], new_of_old_[k]);
    const auto first = rows_.begin() + start_[column], last = rows_.begin() + start_[column + 1];
    slot.place = static_cast<int>(std::lower_bound(first, last, row) - rows_.begin());
    slot.transposed = new_of_old_[i] < new_of_old_[k];
  }
  set_zero();
}

template <int N>
void BlockCholesky<N>::set_zero() {
  diagonal_.assign(static_cast<size_t>(size_), Block::Zero());
  below_.assign(rows_.size(), Block::Zero());
}

template <int N>
void BlockCholesky<N>::add_pair(int pair, const Block& block) {
  const Slot& slot = slots_[pair];
  if (slot.place < 0) return;
  if (slot.transposed) {
    below_[slot.place] += block.transpose();
  } else {
    below_[slot.place] += block;
  }
}

template <int N>
bool BlockCholesky<N>::factorise(double damping) {
  factor_ = below_;
  inverse_root_.resize(static_cast<size_t>(size_));
  // Columns in their order, each reduced by all earlier ones that reach its row: these are kept in a list a row.
  std::vector<int> first_of_row(static_cast<size_t>(size_), -1), next_of_column(static_cast<size_t>(size_), -1);
  std::vector<int> reached(start_.begin(), start_.end() - 1);  // of each column: the place of the row it waits at
  std::vector<int> place(static_cast<size_t>(size_), -1);      // of each row in the present column
  const auto wait = [&](int column) {
    if (reached[column] == start_[column + 1]) return;
    int& first = first_of_row[rows_[reached[column]]];
    next_of_column[column] = first;
    first = column;
  };
  for (int column = 0; column < size_; ++column) {
    for (int p = start_[column]; p < start_[column + 1]; ++p) place[rows_[p]] = p;
    Block pivot = diagonal_[column];
    pivot.diagonal() *= 1 + damping;
    for (int earlier = first_of_row[column]; earlier >= 0;) {
      const int after = next_of_column[earlier];
      const int at = reached[earlier]++;
      const Block turned = factor_[at].transpose();
      pivot.noalias() -= factor_[at] * turned;
      for (int p = at + 1; p < start_[earlier + 1]; ++p) {
        factor_[place[rows_[p]]].noalias() -= factor_[p] * turned;
      }
      wait(earlier);
      earlier = after;
    }
    const Eigen::LLT<Block> root(pivot);
    if (root.info() != Eigen::Success) return false;
    inverse_root_[column] = root.matrixL().solve(Block::Identity());
    const Block turned = inverse_root_[column].transpose();
    for (int p = start_[column]; p < start_[column + 1]; ++p) factor_[p] = factor_[p] * turned;
    wait(column);
  }
  return true;
}

template <int N>
void BlockCholesky<N>::factorise_nearly() {
  for (double damping = 0; !factorise(damping); damping = std::max(1e-12, damping * 100)) IRIS_CHECK(damping < 0.1);
}

template <int N>
Eigen::MatrixXd BlockCholesky<N>::solve(const Eigen::MatrixXd& right_side) const {
  IRIS_CHECK(right_side.rows() == N * size_);
  Eigen::MatrixXd x(right_side.rows(), right_side.cols());
  for (int i = 0; i < size_; ++i) {
    x.template middleRows<N>(N * new_of_old_[i]) = right_side.template middleRows<N>(N * i);
  }
  using Rows = Eigen::Matrix<double, N, Eigen::Dynamic>;
  for (int column = 0; column < size_; ++column) {
    const Rows y = inverse_root_[column] * x.template middleRows<N>(N * column);
    x.template middleRows<N>(N * column) = y;
    for (int p = start_[column]; p < start_[column + 1]; ++p) {
      x.template middleRows<N>(N * rows_[p]).noalias() -= factor_[p] * y;
    }
  }
  for (int column = size_ - 1; column >= 0; --column) {
    Rows y = x.template middleRows<N>(N * column);
    for (int p = start_[column]; p < start_[column + 1]; ++p) {
      y.noalias() -= factor_[p].transpose() * x.template middleRows<N>(N * rows_[p]);
    }
    x.template middleRows<N>(N * column) = inverse_root_[column].transpose() * y;
  }
  Eigen::MatrixXd result(x.rows(), x.cols());
  for (int i = 0; i < size_; ++i) {
    result.template middleRows<N>(N * i) = x.template middleRows<N>(N * new_of_old_[i]);
  }
  return result;
}

template <int N>
typename BlockCholesky<N>::Inverse BlockCholesky<N>::inverse() const {
  // Z L = L^-T gives, from the last column back, each column of Z on the pattern of L from later ones on that pattern.
  std::vector<Block> below(rows_.size()), diagonal(static_cast<size_t>(size_));
  std::vector<Block> ratios;
  for (int column = size_ - 1; column >= 0; --column) {
    const int begin = start_[column], end = start_[column + 1];
    ratios.clear();
    for (int p = begin; p < end; ++p) {
      ratios.push_back(factor_[p] * inverse_root_[column]);
      below[p].setZero();
    }
    for (int p = begin; p < end; ++p) {
      const int row = rows_[p];
      below[p].noalias() -= diagonal[row] * ratios[p - begin];
      int at = start_[row];  // all later rows of this column are rows of column `row` as well
      for (int q = p + 1; q < end; ++q) {
        while (rows_[at] != rows_[q]) ++at;
        below[q].noalias() -= below[at] * ratios[p - begin];
        below[p].noalias() -= below[at].transpose() * ratios[q - begin];
      }
    }
    Block z = inverse_root_[column].transpose() * inverse_root_[column];
    for (int p = begin; p < end; ++p) z.noalias() -= ratios[p - begin].transpose() * below[p];
    diagonal[column] = 0.5 * (z + z.transpose());
  }
  Inverse result;
  for (int i = 0; i < size_; ++i) result.diagonal.push_back(diagonal[new_of_old_[i]]);
  for (const Slot& slot : slots_) {
    Block& block = result.pairs.emplace_back(Block::Zero());
    if (slot.place < 0) continue;
    block = below[slot.place];
    if (slot.transposed) block.transposeInPlace();
  }
  return result;
}

template class BlockCholesky<3>;
template class BlockCholesky<6>;

}  // namespace iris::loop
