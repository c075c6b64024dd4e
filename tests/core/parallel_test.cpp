#include "iris/core/parallel.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <mutex>
#include <numeric>
#include <set>
#include <stdexcept>
#include <utility>
#include <vector>

#include "iris/core/error.h"

namespace iris {
namespace {

using Chunks = std::set<std::pair<int, int>>;

Chunks chunks_of(int begin, int end, int grain) {
  Chunks chunks;
  std::mutex mutex;
  parallel_chunks(begin, end, grain, [&](int from, int to) {
    const std::lock_guard lock(mutex);
    EXPECT_TRUE(chunks.emplace(from, to).second);
  });
  return chunks;
}

TEST(ParallelChunks, CoverTheRangeExactlyInPiecesOfTheGrain) {
  for (const auto& [begin, end, grain] : {std::array{0, 10, 3}, std::array{0, 9, 3}, std::array{5, 6, 100},
                                          std::array{-7, 8, 4}, std::array{0, 1000, 1}}) {
    int next = begin;
    for (const auto& [from, to] : chunks_of(begin, end, grain)) {
      EXPECT_EQ(from, next);
      EXPECT_EQ(to, std::min(from + grain, end));
      next = to;
    }
    EXPECT_EQ(next, end);
  }
  EXPECT_TRUE(chunks_of(3, 3, 2).empty());
  EXPECT_TRUE(chunks_of(4, 3, 2).empty());
  EXPECT_THROW(chunks_of(0, 3, 0), Bug);
}

TEST(ParallelChunks, DoNotDependOnTheNumberOfThreads) {
  Chunks one, four;
  with_threads(1, [&] { one = chunks_of(0, 100, 7); });
  with_threads(4, [&] { four = chunks_of(0, 100, 7); });
  EXPECT_EQ(one, four);
}

TEST(ParallelChunks, AReductionInTheOrderOfTheChunksIsBitEqual) {
  const int count = 10000, grain = 64;
  const auto sum = [&](int threads) {
    std::vector<double> partial((count + grain - 1) / grain);
    with_threads(threads, [&] {
      parallel_chunks(0, count, grain, [&](int from, int to) {
        for (int i = from; i < to; ++i) partial[from / grain] += 1.0 / (1 + i * 0.37);
      });
    });
    return std::accumulate(partial.begin(), partial.end(), 0.0);
  };
  EXPECT_EQ(sum(1), sum(2));
  EXPECT_EQ(sum(1), sum(5));
}

TEST(ParallelChunks, ExceptionsArePassedOn) {
  const auto body = [](int from, int) {
    if (from == 42) throw std::runtime_error("at 42");
  };
  EXPECT_THROW(parallel_chunks(0, 100, 1, body), std::runtime_error);
  EXPECT_THROW(with_threads(2, [&] { parallel_chunks(0, 100, 1, body); }), std::runtime_error);
}

TEST(WithThreads, NeverRunsMoreThanSoMany) {
  EXPECT_GE(available_threads(), 1);
  EXPECT_THROW(with_threads(0, [] {}), Bug);
  for (const int threads : {1, 2}) {
    std::atomic<int> running = 0, most = 0;
    with_threads(threads, [&] {
      parallel_chunks(0, 2000, 1, [&](int, int) {
        const int now = ++running;
        int seen = most;
        while (now > seen && !most.compare_exchange_weak(seen, now)) {
        }
        --running;
      });
    });
    EXPECT_LE(most, threads);
  }
}

}  // namespace
}  // namespace iris
