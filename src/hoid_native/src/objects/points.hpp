// Points and boxes of objects.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include "objects/objects.hpp"

namespace hoid::objects {

inline const double* point(const double* points, int64_t n)
{
  return points + 3 * n;
}

// Write the point in the other frame.
inline void transform(Transform T, const double* p, double* out)
{
  for (int r = 0; r < 3; ++r) {
    const double* row = T + static_cast<std::ptrdiff_t>(4) * r;
    out[r] = row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3];
  }
}

// Return whether a point of the map frame is inside a box, not on its border.
inline bool is_in_box(
  Transform T_box_map, const double* low, const double* high, const double* p)
{
  double local[3];
  transform(T_box_map, p, local);
  for (int axis = 0; axis < 3; ++axis) {
    if (!(local[axis] > low[axis] && local[axis] < high[axis])) {
      return false;
    }
  }
  return true;
}

// Return the median of values, which are reordered; the mean of the two middle ones of an even
// number. There must be one at least.
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

}  // namespace hoid::objects
