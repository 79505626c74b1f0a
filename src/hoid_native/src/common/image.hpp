// What kernels are given: views of memory that somebody else keeps.
#pragma once

#include <cstddef>
#include <cstdint>

namespace hoid {

// An image without gaps between its rows.
template <typename T>
struct Image
{
  const T* data;
  int width, height;

  const T* row(int y) const { return data + static_cast<std::ptrdiff_t>(y) * width; }
};

// Tells the rows of flat pixels: half a pixel from every border of rows, which is more than the
// error of the product; faster than a division.
class RowOfPixel
{
public:
  explicit RowOfPixel(int width) : per_width_(1.0 / width) {}

  int64_t operator()(int64_t pixel) const
  {
    return static_cast<int64_t>((static_cast<double>(pixel) + 0.5) * per_width_);
  }

private:
  double per_width_;
};

// Boxes (x1, y1, x2, y2), finite.
struct Boxes
{
  const double* data;
  int count;

  const double* operator[](int n) const { return data + 4 * static_cast<std::ptrdiff_t>(n); }
};

}  // namespace hoid
