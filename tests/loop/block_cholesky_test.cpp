
#include "src/loop/block_cholesky.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <random>

#include "iris/core/error.h"

namespace iris::loop {
namespace {

// A random sparse matrix, both as blocks and dense: diagonally dominant, hence positive definite.
template <int N>
struct Example {
  std::vector<std::pair<int, int>> pairs;
  std::vector<Eigen::Matrix<double, N, N>> blocks, diagonal;
  Eigen::MatrixXd dense;

  Example(int size, int count, unsigned seed) : dense(Eigen::MatrixXd::Zero(N * size, N * size)) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> value(-1, 1);
    const auto block = [&] { return Eigen::Matrix<double, N, N>::NullaryExpr([&] { return value(random); }).eval(); };
    for (int i = 0; i < size; ++i) {
      Eigen::Matrix<double, N, N> b = block();
      diagonal.push_back(b * b.transpose() + 2 * N * count / size * Eigen::Matrix<double, N, N>::Identity());
      dense.template block<N, N>(N * i, N * i) = diagonal.back();
    }
    for (int n = 0; n < count; ++n) {
      const int i = static_cast<int>(random() % size), k = static_cast<int>(random() % size);
      if (i == k) continue;
      pairs.emplace_back(i, k);
      blocks.push_back(block());
      dense.template block<N, N>(N * i, N * k) += blocks.back();
      dense.template block<N, N>(N * k, N * i) += blocks.back().transpose();
    }
  }

  BlockCholesky<N> factor() const {
    BlockCholesky<N> result(static_cast<int>(diagonal.size()), pairs);
    for (size_t i = 0; i < diagonal.size(); ++i) result.add(static_cast<int>(i), diagonal[i]);
    for (size_t p = 0; p < pairs.size(); ++p) result.add_pair(static_cast<int>(p), blocks[p]);
    return result;
  }
};

template <int N>
void compare_with_dense(int size, int count, unsigned seed) {
  const Example<N> example(size, count, seed);
  BlockCholesky<N> factor = example.factor();
  for (const double damping : {0.0, 0.3}) {
    Eigen::MatrixXd dense = example.dense;
    dense.diagonal() *= 1 + damping;
    ASSERT_TRUE(factor.factorise(damping));
    const Eigen::MatrixXd right = Eigen::MatrixXd::Random(N * size, 3);
    EXPECT_LT((dense * factor.solve(right) - right).cwiseAbs().maxCoeff(), 1e-12);
    const Eigen::MatrixXd inverse = dense.inverse();
    const auto blocks = factor.inverse();
    for (int i = 0; i < size; ++i) {
      EXPECT_LT((blocks.diagonal[i] - inverse.block<N, N>(N * i, N * i)).norm(), 1e-12 * inverse.norm()) << i;
    }
    for (size_t p = 0; p < example.pairs.size(); ++p) {
      const auto& [i, k] = example.pairs[p];
      EXPECT_LT((blocks.pairs[p] - inverse.block<N, N>(N * i, N * k)).norm(), 1e-12 * inverse.norm()) << i << " " << k;
    }
  }
}

TEST(BlockCholesky, SolvesAndInvertsAsTheDenseMatrixDoes) {
  compare_with_dense<6>(1, 0, 1);
  compare_with_dense<6>(2, 3, 2);
  compare_with_dense<6>(40, 70, 3);
  compare_with_dense<6>(25, 300, 4);  // nearly full
  compare_with_dense<3>(60, 90, 5);
}

TEST(BlockCholesky, IgnoresWhatIsFixed) {
  BlockCholesky<3> factor(2, {{0, -1}, {1, 0}, {-1, -1}});
  for (const int i : {0, 1}) factor.add(i, 4 * Eigen::Matrix3d::Identity());
  factor.add_pair(0, 100 * Eigen::Matrix3d::Ones());
  factor.add_pair(1, Eigen::Matrix3d::Identity());
  ASSERT_TRUE(factor.factorise());
  // Inverse of (4 1; 1 4).
  EXPECT_LT((factor.inverse().diagonal[0] - Eigen::Matrix3d::Identity() * (4.0 / 15)).norm(), 1e-15);
}

TEST(BlockCholesky, SaysWhenTheMatrixIsNotPositiveDefinite) {
  BlockCholesky<3> factor(2, {{0, 1}});
  for (const int i : {0, 1}) factor.add(i, Eigen::Matrix3d::Identity());
  factor.add_pair(0, 2 * Eigen::Matrix3d::Identity());
  EXPECT_FALSE(factor.factorise());
  EXPECT_TRUE(factor.factorise(1.5));
  factor.add_pair(0, 2 * Eigen::Matrix3d::Identity());
  EXPECT_THROW(factor.factorise_nearly(), Bug);
  EXPECT_EQ(BlockCholesky<6>(0, {}).solve(Eigen::MatrixXd(0, 1)).rows(), 0);
}

// A chain of 10,000 poses with loops to a nearby stretch: the factor stays sparse.
TEST(BlockCholesky, KeepsChainsSparse) {
  std::vector<std::pair<int, int>> pairs;
  for (int i = 1; i < 10000; ++i) pairs.emplace_back(i - 1, i);
  EXPECT_EQ(BlockCholesky<6>(10000, pairs).factor_blocks(), 9999u);
  for (int i = 0; i < 5000; i += 10) pairs.emplace_back(i, 9999 - i);
  EXPECT_LT(BlockCholesky<6>(10000, pairs).factor_blocks(), 2 * pairs.size());
}

}  // namespace
}  // namespace iris::loop
