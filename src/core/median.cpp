#include "iris/core/median.h"

#include <algorithm>

#include "iris/core/error.h"

namespace iris {

double median(std::vector<double> values) {
  IRIS_CHECK(!values.empty());
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace iris
