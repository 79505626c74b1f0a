// Pointers with shapes to images and tables of the caller, which kernels read and write in place.
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/multiversion.hpp"

namespace hoid {

// A row-major image without padding between its rows.
template <typename T>
struct Image
{
  const T* data;
  int width, height;

  std::ptrdiff_t size() const { return static_cast<std::ptrdiff_t>(width) * height; }
  const T* row(int y) const { return data + static_cast<std::ptrdiff_t>(y) * width; }
};

// A table of `count` rows of kColumns numbers. [n] is a pointer to row n, or its number if a row
// has only one.
template <typename T, int kColumns = 1>
struct Rows
{
  const T* data;
  int count;

  decltype(auto) operator[](std::ptrdiff_t n) const
  {
    if constexpr (kColumns == 1) {
      return data[n];
    } else {
      return data + kColumns * n;
    }
  }
  const T* begin() const { return data; }
  const T* end() const { return data + static_cast<std::ptrdiff_t>(kColumns) * count; }
};

// Finite boxes (x1, y1, x2, y2), in pixels.
using Boxes = Rows<double, 4>;

using Points = Rows<double, 3>;

// Row-major 4x4 matrices of rigid transforms.
using Transforms = Rows<double, 16>;

// Write the point p, transformed by the row-major 4x4 matrix T.
ALWAYS_INLINE void transform(const double* T, const double* p, double* out)
{
  for (int r = 0; r < 3; ++r) {
    const double* row = T + 4 * r;
    out[r] = row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3];
  }
}

}  // namespace hoid
