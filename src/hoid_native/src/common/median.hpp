#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace hoid {

// Return the median of one or more values, which are reordered; of an even number of values, the
// mean of the two middle ones.
template <typename T>
T median(std::vector<T>& values)
{
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  if (values.size() % 2 == 1) {
    return *middle;
  }
  return (*std::max_element(values.begin(), middle) + *middle) / 2;
}

}  // namespace hoid
