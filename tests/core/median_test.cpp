#include "iris/core/median.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "iris/core/error.h"

namespace iris {
namespace {

TEST(Median, IsTheMiddleOfTheSortedValues) {
  EXPECT_EQ(median({3}), 3);
  EXPECT_EQ(median({5, 1, 2}), 2);
  EXPECT_EQ(median({4, 1, 3, 2}), 3);
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  for (const size_t count : {10u, 101u}) {
    std::vector<double> values(count);
    for (double& value : values) value = normal(random);
    const double found = median(values);
    std::sort(values.begin(), values.end());
    EXPECT_EQ(found, values[count / 2]);
  }
  EXPECT_THROW(median({}), Bug);
}

}  // namespace
}  // namespace iris
