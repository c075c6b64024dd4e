#pragma once

#include <vector>

namespace iris {

// The value in the middle when they are sorted; of an even number of them the larger one of the two. Not of nothing.
double median(std::vector<double> values);

}  // namespace iris
