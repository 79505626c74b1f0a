// What kernels are given: views of memory that somebody else keeps.
#pragma once

#include <cstddef>

namespace hoid {

// An image without gaps between its rows.
template <typename T>
struct Image
{
  const T* data;
  int width, height;

  const T* row(int y) const { return data + static_cast<std::ptrdiff_t>(y) * width; }
};

// Boxes (x1, y1, x2, y2), finite.
struct Boxes
{
  const double* data;
  int count;

  const double* operator[](int n) const { return data + 4 * static_cast<std::ptrdiff_t>(n); }
};

}  // namespace hoid
